"""What is there: sites, traffic, sensors, clouds, fusion and metrics. Nothing heavy loads until it is used (SPEC 1)."""

from importlib import import_module
from typing import Any

_WHERE = {
    "Objects": "objects", "Detections": "objects", "Detector": "objects",
    "DepthCamera": "sensors", "SpinningLidar": "sensors", "Sensor": "sensors",
    "Frame": "frame", "Site": "site", "CoopDataset": "dataset", "ClusterDetector": "cluster",
    "fuse": "clouds", "crop": "clouds", "from_depth": "clouds",
    "early": "fusion", "late": "fusion", "hybrid": "fusion",
    "evaluate": "metrics",
}  # fmt: skip
_MODULES = (
    "bodies", "boxes", "cluster", "clouds", "dataset", "fusion", "geometry", "metrics", "objects", "plots",
    "render", "sensors", "site", "traffic",
)  # fmt: skip
__all__ = sorted([*_WHERE, *_MODULES])  # pyright: ignore


def __getattr__(name: str) -> Any:
    if name in _WHERE:
        return getattr(import_module(f"toolkit.{_WHERE[name]}"), name)
    if name in _MODULES:
        return import_module(f"toolkit.{name}")
    raise AttributeError(f"module 'toolkit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
