"""Recordings: published and own files, simulated ones, samples of clouds in any layout, and the doctor."""

from typing import TYPE_CHECKING

from toolkit.runtime.lazy import lazily

if TYPE_CHECKING:
    from toolkit.datasets.recordings import open_samples as open_samples
    from toolkit.datasets.recordings import read as read
    from toolkit.datasets.recordings import write_samples as write_samples
    from toolkit.datasets.sample import Sample as Sample
    from toolkit.datasets.sample import SensorCloud as SensorCloud
else:
    __getattr__, __dir__, __all__ = lazily(
        __name__, {"sample": ("Sample", "SensorCloud"), "samples": ("open_samples", "read", "write_samples")}
    )
