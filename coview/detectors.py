"""The detector that --detector names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.objects import Detector
    from toolkit.sites.site import Site


def recording_detector(name: str, recording: CoopDataset) -> Detector:
    """cluster, which learns the recording's empty site, or one of `site_detector`."""
    if name == "cluster":
        from toolkit.detection.cluster import ClusterDetector

        return ClusterDetector.of(recording)
    return site_detector(name, recording.site)


def site_detector(name: str, site: Site) -> Detector:
    """voxelnet for the site's own shipped network, a shipped name, a weights file, or package.module:callable."""
    if name == "cluster":
        raise ValueError("detector cluster learns from a recording, of which there is none here: take voxelnet")
    if ":" in name:
        from toolkit.detection.imported import ImportedDetector

        return ImportedDetector(name, site)
    from models.detector import load_detector, load_site_detector

    return load_site_detector(site.name, site.area) if name == "voxelnet" else load_detector(name, area=site.area)


def sample_detector(
    name: str, area: tuple[float, float, float, float] | None
) -> tuple[Detector, tuple[float, float] | None, tuple[float, float]]:
    """A detector for clouds of any recording, the middle of its area, and half its sides; without an area it reaches
    `DETECTION_REACH` around wherever the sensors are, and there is no middle."""
    from toolkit.detection.samples.detected import DETECTION_REACH
    from toolkit.sites.site import Site, check_area

    xmin, ymin, xmax, ymax = (
        (-DETECTION_REACH, -DETECTION_REACH, DETECTION_REACH, DETECTION_REACH)
        if area is None
        else check_area(area).tolist()
    )
    x, y = (xmin + xmax) / 2, (ymin + ymax) / 2
    around = Site("recording", np.array([xmin - x, ymin - y, xmax - x, ymax - y]))
    if name in ("voxelnet", "cluster"):
        raise ValueError(f"{name} needs a site: take general, another shipped network, a weights file or your own")
    return site_detector(name, around), None if area is None else (x, y), (xmax - x, ymax - y)


def check_digest(name: str, detector: Detector, remedy: str) -> None:
    """Raise ValueError where detections are to be kept and the detector does not say what they depend on."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it depends on{remedy}"
        )
