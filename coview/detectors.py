"""Detectors that --detector names.

A name followed by `+background` means a detector that knows the empty site: it leaves out what always stands there.
`general` at a site whose scenery is known means that too, `general-background` the bare network.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, SupportsFloat, cast

import numpy as np

from toolkit.calibration.empty_scene import Scenes
from toolkit.calibration.ground import level_warning
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.background import KnownBackground, add_background, recording_background
from toolkit.detection.detect import ImportedDetector, resolve_detector
from toolkit.detection.place import Place
from toolkit.frame import Recording
from toolkit.objects import Detections, Detector
from toolkit.points import join_clouds
from toolkit.sites.site import Site

BACKGROUND, BARE, CLUSTER = "+background", "-background", "cluster"
GENERAL = "general"
FEWEST_FRAMES, SHORTEST = 10, 60.0  # and seconds, of recordings whose background is learnt: else all that waits is part

if TYPE_CHECKING:
    from models.detector import VoxelNetDetector


class CloudDetector:
    """Detector in clouds of any kind: Open3D's, tensor or legacy, or an array (n, 3) or (n, 4) that begins x, y, z.

    network: the detector of level points; level: "map" or "plane" puts each cloud on level ground first, and boxes come
    back in the cloud's own frame. With None the ground is taken to be at z = 0, and a warning says where the ground of
    the first cloud lies if that is elsewhere.
    """

    def __init__(self, network: VoxelNetDetector, level: Literal["map", "plane"] | None = None) -> None:
        if level not in ("map", "plane", None):
            raise ValueError(f'level must be "map", "plane" or None, got {level!r}')
        self.network, self.level, self._checked = network, level, level is not None
        self.labels, self.area, self.name = network.labels, network.area, network.name
        self.digest = network.digest if level is None else f"{network.digest} {level}"

    def __call__(self, cloud: object, /) -> Detections:
        """Detect in one cloud. Raises ValueError for what is no cloud, or where no ground is found to level."""
        from toolkit.calibration.ground import level, plain_points

        points = plain_points(cloud)
        if self.level is not None and len(points):
            points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
            ground = level(points, method=self.level)
            found = self.network(ground.points(points).astype(np.float32))
            return replace(found, boxes=ground.boxes_back(found.boxes)) if len(found) else found
        if not self._checked and len(points):
            self._checked = True
            if said := level_warning(points):
                ours = said.removesuffix(": level the points first")
                warnings.warn(f'not levelled: {ours}: load_detector(..., level="map") levels clouds', stacklevel=2)
        return self.network(points)

    def unions(self, clouds: Sequence[np.ndarray], unions: np.ndarray) -> Sequence[Detections]:
        """Detect in each union of clouds, rows of a mask."""
        if self.level is None:
            return self.network.unions(clouds, unions)
        return [self(join_clouds(clouds, union)) for union in unions]


def load_detector(
    name: str | Path,
    *,
    level: Literal["map", "plane"] | None = None,
    site: str | None = None,
    area: Iterable[SupportsFloat] | None = None,
    device: str = "cpu",
    score_threshold: float | None = None,
    nms_threshold: float = 0.1,
) -> CloudDetector:
    """Load a detector by shipped name ("tjunction", "roundabout", "general") or path of its weights.

    level: see `CloudDetector`; the rest: see `models.load_detector`, which returns the bare network. Raises
    FileNotFoundError for unknown weights, ValueError if they are damaged or for another place.
    """
    from models import detector

    network = detector.load_detector(
        name, site=site, area=area, device=device, score_threshold=score_threshold, nms_threshold=nms_threshold
    )
    return CloudDetector(network, level)


def recording_detector(
    name: str | None, recording: Recording, place: Place | None = None, scenes: Scenes | None = None
) -> Detector:
    """Return the detector for a recording: cluster, which learns its empty site, or one of `site_detector`.

    name: None for cluster at a known site, else general; +background: that of the site, or where the site has no
    scenery, of what the recording shows behind all that moves; place: where it will detect, if not at the site itself;
    scenes: empty ones to learn from.
    """
    from toolkit.detection.cluster import ClusterDetector, learn_cluster_detector

    place, site = place or Place(), recording.site
    at_site = site is not None and place.at(site)
    bare, known = split_background(name or (CLUSTER if at_site else GENERAL), site if at_site else None)
    if site is not None and at_site:
        dataset = cast("CoopDataset", recording)
        if bare == CLUSTER:
            return _on_grids(ClusterDetector.of(dataset), place)
        detector = _on_grids(site_detector(bare + BARE, site), place)
        return KnownBackground(detector, recording_background(dataset)) if known else detector
    known = known and (name or GENERAL).endswith(BACKGROUND)
    if bare != CLUSTER and not known:
        return place_detector(bare, place)
    if not len(recording):
        raise ValueError("there is no frame to evaluate: check the path and the layout")
    if known:
        _check_long(recording)
    learnt = learn_cluster_detector(scenes or Scenes(recording), recording[0], place)
    if bare == CLUSTER:
        return _on_grids(learnt, place)
    return KnownBackground(place_detector(bare, place), learnt.background)


def _check_long(recording: Recording) -> None:
    """Raise ValueError for a recording in which vehicles that wait cannot be told from the scene."""
    number, seconds = len(recording), recording[len(recording) - 1].time - recording[0].time
    if number < FEWEST_FRAMES or 0 < seconds < SHORTEST:
        lasting = f" in {seconds:.0f} s" if seconds > 0 else ""
        raise ValueError(
            f"{number} frames{lasting} do not tell what waits from what belongs to the site: give at least "
            f"{FEWEST_FRAMES} frames over {SHORTEST:.0f} s, or leave {BACKGROUND} out"
        )


def check_detector(name: str, place: Place | None = None) -> None:
    """Raise FileNotFoundError for a name that stands for no detector, before any work.

    place: where it will detect. Raises ValueError if its area is not that of the weights.
    """
    bare = split_background(name)[0]
    if bare not in ("voxelnet", CLUSTER) and ":" not in bare:
        from models.detector import weights_file

        if not weights_file(bare).is_file():
            raise FileNotFoundError(f"no such file of weights: {bare}")
    if ":" in bare:
        resolve_detector(bare)
    if place is not None and place.area is not None and bare not in ("voxelnet", CLUSTER):
        place_detector(bare, place)


def site_detector(name: str, site: Site) -> Detector:
    """Return a detector for a site.

    name: voxelnet for the site's own shipped network, a shipped name, a weights file, or package.module:callable;
    +background: of the site's scenery.
    """
    name, known = split_background(name, site)
    if known:
        return add_background(site_detector(name + BARE, site), site)
    if name == CLUSTER:
        raise ValueError("detector cluster learns from a recording, of which there is none here: take voxelnet")
    if ":" in name:
        return ImportedDetector(name, site)
    from models.detector import load_detector, load_site_detector

    return load_site_detector(site.name, site.area) if name == "voxelnet" else load_detector(name, area=site.area)


def place_detector(name: str, place: Place) -> Detector:
    """Return a detector for frames of any recording, of points counted from the middle of the place."""
    if name.endswith(BACKGROUND):
        raise ValueError(f"{name} must see the site empty first: take coview detect, or leave {BACKGROUND} out")
    if name in ("voxelnet", CLUSTER):
        raise ValueError(f"{name} needs a site: take general, another shipped network, a weights file or your own")
    x, y = place.half
    return _on_grids(site_detector(name, Site("recording", np.array([-x, -y, x, y]))), place)


def _on_grids(detector: Detector, place: Place) -> Detector:
    """Detector on as many shifted grids as the place asks for. Raises ValueError for one that has no grid."""
    if place.phases == 1:
        return detector
    if not hasattr(detector, "shift_grids"):
        raise ValueError("--phases shifts the grid of a network, which this detector is not: leave it out")
    on_grids: Detector = detector.shift_grids(place.phases)
    return on_grids


def split_background(name: str, site: Site | None = None) -> tuple[str, bool]:
    """Split a detector's name from `BACKGROUND` or `BARE`; tell whether the background of the site is to be known.

    >>> split_background("general+background"), split_background("general-background")
    (('general', True), ('general', False))
    """
    bare = name.removesuffix(BACKGROUND).removesuffix(BARE)
    by_default = name == GENERAL and site is not None and len(site.solids) > 0
    return bare, name.endswith(BACKGROUND) or by_default


def check_digest(name: str, detector: Detector, remedy: str) -> None:
    """Raise ValueError for a detector without a digest."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it depends on{remedy}"
        )
