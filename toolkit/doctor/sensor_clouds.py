"""Clouds of one sensor in several frames."""

from collections.abc import Sequence

from toolkit.frame import Frame, SensorCloud


def sensor_names(samples: Sequence[Frame]) -> list[str]:
    """Names of all sensors with a cloud, in alphabetical order."""
    return sorted({cloud.name for sample in samples for cloud in sample.clouds})


def list_clouds(samples: Sequence[Frame], name: str) -> list[SensorCloud | None]:
    """Cloud of one sensor in each frame, None if the frame lacks it."""
    return [find_cloud(sample, name) for sample in samples]


def find_cloud(sample: Frame, name: str) -> SensorCloud | None:
    """Cloud of a sensor in a frame, None without one."""
    return next((cloud for cloud in sample.clouds if cloud.name == name), None)
