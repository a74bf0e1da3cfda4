"""Detectors that --detector names.

A name followed by `+background` means a detector that knows the empty site: it leaves out what always stands there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

BACKGROUND, CLUSTER = "+background", "cluster"

if TYPE_CHECKING:
    from toolkit.calibration.empty_scene import Scenes
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.detection.place import Place
    from toolkit.frame import Recording
    from toolkit.objects import Detector
    from toolkit.sites.site import Site


def recording_detector(
    name: str | None, recording: Recording, place: Place | None = None, scenes: Scenes | None = None
) -> Detector:
    """Return the detector for a recording: cluster, which learns its empty site, or one of `site_detector`.

    name: None for cluster at a known site, else general; +background: that of the site, or where the site has no
    scenery, of what the recording shows behind all that moves; place: where it will detect, if not at the site itself;
    scenes: empty ones to learn from.
    """
    from toolkit.detection.background import KnownBackground, recording_background
    from toolkit.detection.cluster import ClusterDetector, learn_cluster_detector
    from toolkit.detection.place import Place

    place, site = place or Place(), recording.site
    at_site = site is not None and place.at(site)
    bare, known = split_background(name or (CLUSTER if at_site else "general"))
    if site is not None and at_site:
        dataset = cast("CoopDataset", recording)
        if bare == CLUSTER:
            return ClusterDetector.of(dataset)
        detector = site_detector(bare, site)
        return KnownBackground(detector, recording_background(dataset)) if known else detector
    if bare != CLUSTER and not known:
        return place_detector(bare, place)
    from toolkit.calibration import empty_scene

    if not len(recording):
        raise ValueError("there is no frame to evaluate: check the path and the layout")
    if known and len(recording) == 1:
        raise ValueError("in a single frame everything stands still: give more of them, or leave +background out")
    learnt = learn_cluster_detector(scenes or empty_scene.Scenes(recording), recording[0], place)
    return learnt if bare == CLUSTER else KnownBackground(place_detector(bare, place), learnt.background)


def check_detector(name: str, place: Place | None = None) -> None:
    """Raise FileNotFoundError for a name that stands for no detector, before any work.

    place: where it will detect. Raises ValueError if its area is not that of the weights.
    """
    bare = split_background(name)[0]
    if bare not in ("voxelnet", CLUSTER) and ":" not in bare:
        from models.detector import weights_file

        if not weights_file(bare).is_file():
            raise FileNotFoundError(f"no such file of weights: {bare}")
    if place is not None and place.area is not None and bare not in ("voxelnet", CLUSTER):
        place_detector(bare, place)


def site_detector(name: str, site: Site) -> Detector:
    """Return a detector for a site.

    name: voxelnet for the site's own shipped network, a shipped name, a weights file, or package.module:callable;
    +background: of the site's scenery.
    """
    bare, known = split_background(name)
    if known:
        from toolkit.detection.background import add_background

        return add_background(site_detector(bare, site), site)
    if name == CLUSTER:
        raise ValueError("detector cluster learns from a recording, of which there is none here: take voxelnet")
    if ":" in name:
        from toolkit.detection.detect import ImportedDetector

        return ImportedDetector(name, site)
    from models.detector import load_detector, load_site_detector

    return load_site_detector(site.name, site.area) if name == "voxelnet" else load_detector(name, area=site.area)


def place_detector(name: str, place: Place) -> Detector:
    """Return a detector for frames of any recording, of points counted from the middle of the place."""
    import numpy as np

    from toolkit.sites.site import Site

    if split_background(name)[1]:
        raise ValueError(f"{name} must see the site empty first: take coview detect, or leave {BACKGROUND} out")
    if name in ("voxelnet", CLUSTER):
        raise ValueError(f"{name} needs a site: take general, another shipped network, a weights file or your own")
    x, y = place.half
    return site_detector(name, Site("recording", np.array([-x, -y, x, y])))


def split_background(name: str) -> tuple[str, bool]:
    """Split a detector's name from `BACKGROUND`, and tell whether that followed it.

    >>> split_background("general+background")
    ('general', True)
    """
    return name.removesuffix(BACKGROUND), name.endswith(BACKGROUND)


def check_digest(name: str, detector: Detector, remedy: str) -> None:
    """Raise ValueError for a detector without a digest."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it depends on{remedy}"
        )
