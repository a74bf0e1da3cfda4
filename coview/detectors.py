"""The detector that --detector names.

A name with `+background` behind it is of a detector that knows the empty site: what it takes for somebody and stands
there in every frame is left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

BACKGROUND = "+background"

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.objects import Detector
    from toolkit.sites.site import Site


def recording_detector(name: str, recording: CoopDataset) -> Detector:
    """cluster, which learns the recording's empty site, or one of `site_detector`; where that site has no scenery,
    +background is of what the recording shows behind all that moves."""
    bare, known = of_background(name)
    if bare == "cluster":
        from toolkit.detection.cluster import ClusterDetector

        return ClusterDetector.of(recording)
    detector = site_detector(bare, recording.site)
    if not known:
        return detector
    from toolkit.detection.background import KnownBackground
    from toolkit.detection.site_background import recording_background

    return KnownBackground(detector, recording_background(recording))


def site_detector(name: str, site: Site) -> Detector:
    """voxelnet for the site's own shipped network, a shipped name, a weights file, or package.module:callable;
    +background: of the site's scenery."""
    bare, known = of_background(name)
    if known:
        from toolkit.detection.site_background import add_background

        return add_background(site_detector(bare, site), site)
    if name == "cluster":
        raise ValueError("detector cluster learns from a recording, of which there is none here: take voxelnet")
    if ":" in name:
        from toolkit.detection.imported import ImportedDetector

        return ImportedDetector(name, site)
    from models.detector import load_detector, load_site_detector

    return load_site_detector(site.name, site.area) if name == "voxelnet" else load_detector(name, area=site.area)


def of_background(name: str) -> tuple[str, bool]:
    """The name of a detector without `BACKGROUND`, and whether that was behind it.

    >>> of_background("general+background")
    ('general', True)
    """
    return name.removesuffix(BACKGROUND), name.endswith(BACKGROUND)


def area_about(
    area: tuple[float, float, float, float] | None,
) -> tuple[tuple[float, float] | None, tuple[float, float]]:
    """The middle of an area and half its sides; without one there is no middle, and it reaches `DETECTION_REACH` about
    wherever the sensors are."""
    from toolkit.detection.detect import DETECTION_REACH
    from toolkit.sites.site import check_area

    if area is None:
        return None, (DETECTION_REACH, DETECTION_REACH)
    xmin, ymin, xmax, ymax = check_area(area, "--area").tolist()
    return ((xmin + xmax) / 2, (ymin + ymax) / 2), ((xmax - xmin) / 2, (ymax - ymin) / 2)


def sample_detector(
    name: str, area: tuple[float, float, float, float] | None
) -> tuple[Detector, tuple[float, float] | None, tuple[float, float]]:
    """A detector for clouds of any recording, the middle of its area and half its sides, as `area_about`."""
    import numpy as np

    from toolkit.sites.site import Site

    middle, (x, y) = area_about(area)
    if of_background(name)[1]:
        raise ValueError(f"{name} must see the site empty first: take coview evaluate, or leave {BACKGROUND} out")
    if name in ("voxelnet", "cluster"):
        raise ValueError(f"{name} needs a site: take general, another shipped network, a weights file or your own")
    return site_detector(name, Site("recording", np.array([-x, -y, x, y]))), middle, (x, y)


def check_digest(name: str, detector: Detector, remedy: str) -> None:
    """Raise ValueError where detections are to be kept and the detector does not say what they depend on."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it depends on{remedy}"
        )
