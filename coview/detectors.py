"""Detectors that --detector names.

Behind the name may stand, in any order,

    +background   a detector that knows the empty site: it leaves out what always stands there.
                  `general` at a site whose scenery is known means that too, `general-background`
                  the bare network; `coview detect` learns what stands in most frames for `general`
                  where the site is unknown and the sensors stand still. Where nothing is known of
                  the site, `general` reports pedestrians from a higher score on
    +phases4      a network on four shifted grids, whose boxes are averaged
    +bfloat16     a network in coarser numbers, in half the time, where the processor has
                  instructions for them; `coview detect` does so by itself, unless +float32 stands
                  there"""

import re
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, SupportsFloat, cast

BACKGROUND = "+background"
BARE = "-background"
CLUSTER = "cluster"
QUICK = "+bfloat16"
EXACT = "+float32"
GENERAL = "general"
# and seconds, of recordings whose background is learnt: else all that waits is part
FEWEST_FRAMES = 10
SHORTEST = 60.0

if TYPE_CHECKING:
    import numpy as np

    from models.detector import VoxelNetDetector
    from toolkit.calibration.empty_scene import Scenes
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.detection.place import Place
    from toolkit.frame import Recording
    from toolkit.objects import Detections, Detector
    from toolkit.sites.site import Site


class CloudDetector:
    """Detector in clouds of any kind: Open3D's, tensor or legacy, or an array (n, 3) or (n, 4) that
    begins x, y, z.

    network: the detector of level points; level: "map" or "plane" puts each cloud on level ground
    first, and boxes come back in the cloud's own frame. With None the ground is taken to be at
    z = 0, and a warning says where the ground of the first cloud lies if that is elsewhere."""

    def __init__(
        self, network: "VoxelNetDetector", level: Literal["map", "plane"] | None = None
    ) -> None:
        if level not in ("map", "plane", None):
            raise ValueError(f'level must be "map", "plane" or None, got {level!r}')
        self.network = network
        self.level = level
        self._checked = level is not None
        self.labels = network.labels
        self.area = network.area
        self.name = network.name
        self.digest = network.digest if level is None else f"{network.digest} {level}"

    def __call__(self, cloud: object, /) -> "Detections":
        """Detect in one cloud. Raises ValueError for what is no cloud, or where no ground is found
        to level."""
        from dataclasses import replace

        import numpy as np

        from toolkit.calibration.ground import level, plain_points

        points = plain_points(cloud)
        if self.level is not None and len(points):
            points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
            ground = level(points, method=self.level)
            found = self.network(ground.points(points).astype(np.float32))
            return replace(found, boxes=ground.boxes_back(found.boxes)) if len(found) else found
        if not self._checked and len(points):
            self._checked = True
            self._warn(points)
        return self.network(points)

    def unions(
        self, clouds: "Sequence[np.ndarray]", unions: "np.ndarray"
    ) -> "Sequence[Detections]":
        """Detect in each union of clouds, rows of a mask."""
        from toolkit.points import join_clouds

        if self.level is None:
            return self.network.unions(clouds, unions)
        return [self(join_clouds(clouds, union)) for union in unions]

    def _warn(self, points: "np.ndarray") -> None:
        from toolkit.calibration.ground import level_warning

        said = level_warning(points)
        if said is not None:
            ours = said.removesuffix(": level the points first")
            warnings.warn(
                f'not levelled: {ours}: load_detector(..., level="map") levels clouds', stacklevel=3
            )


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
    """Load a detector by shipped name ("tjunction", "roundabout", "general") or path of its
    weights.

    level: see `CloudDetector`; the rest: see `models.load_detector`, which returns the bare
    network. Raises FileNotFoundError for unknown weights, ValueError if they are damaged or for
    another place."""
    from models import detector

    if Path(name).suffix == ".onnx":
        from models.onnx_files import OnnxDetector

        onnx = OnnxDetector(
            name, area, score_threshold=score_threshold, nms_threshold=nms_threshold
        )
        return CloudDetector(onnx, level)
    network = detector.load_detector(
        name,
        site=site,
        area=area,
        device=device,
        score_threshold=score_threshold,
        nms_threshold=nms_threshold,
    )
    return CloudDetector(network, level)


class NamedDetector(NamedTuple):
    """Detector as its name asks for it: without what stands behind the name, and that."""

    bare: str
    known: bool = False  # the background of the site
    phases: int = 1
    bfloat16: bool = False
    unknown_site: bool = False  # nothing is known of what stands there

    def tune(self, detector: "Detector") -> "Detector":
        """Return a detector on the grids and in the numbers asked for. Raises ValueError for one
        that has no grid."""
        from toolkit.objects import quick_detector

        if self.phases != 1:
            if not hasattr(detector, "shift_grids"):
                raise ValueError(
                    f"+phases shifts the grid of a network, which {self.bare} is not: leave it out"
                )
            detector = detector.shift_grids(self.phases)
        if self.unknown_site:
            detector = cast("VoxelNetDetector", detector).at_unknown_site()
        return quick_detector(detector) if self.bfloat16 else detector


def recording_detector(
    name: str | None,
    recording: "Recording",
    place: "Place | None" = None,
    scenes: "Scenes | None" = None,
) -> "Detector":
    """Return the detector for a recording: cluster, which learns its empty site, or one of
    `site_detector`.

    name: None for the one that plans take, `find_network`, at a known site, else general;
    +background: the site's, or where the site has no scenery, of what the recording shows behind
    all that moves; place: where it will detect, if not at the site itself; scenes: empty ones to
    learn from."""
    from toolkit.detection.background import KnownBackground, recording_background
    from toolkit.detection.cluster import ClusterDetector, learn_cluster_detector
    from toolkit.detection.place import Place

    place = place or Place()
    site = recording.site
    at_site = site is not None and place.at(site)
    if name is None and site is not None and at_site:
        from placement_env.fidelity.preparation import find_network, load_shipped_detector

        sensors = recording[0].sensors if len(recording) else site.sensors
        return load_shipped_detector(find_network(site, sensors), site)
    name = name or GENERAL
    asked = parse_detector(name, site if at_site else None)
    if site is not None and at_site:
        dataset = cast("CoopDataset", recording)
        if asked.bare == CLUSTER:
            return asked.tune(ClusterDetector.of(dataset))
        detector = _bare_detector(asked, site)
        return KnownBackground(detector, recording_background(dataset)) if asked.known else detector
    if asked.bare != CLUSTER and not asked.known:
        return place_detector(name, place)
    from toolkit.calibration import empty_scene

    if not len(recording):
        raise ValueError("there is no frame to evaluate: check the path and the layout")
    if asked.known:
        _check_long(recording)
    learnt = learn_cluster_detector(scenes or empty_scene.Scenes(recording), recording[0], place)
    if asked.bare == CLUSTER:
        return asked.tune(learnt)
    return KnownBackground(place_detector(name.replace(BACKGROUND, BARE), place), learnt.background)


def _check_long(recording: "Recording") -> None:
    """Raise ValueError for a recording in which vehicles that wait cannot be told from the
    scene."""
    number = len(recording)
    seconds = recording[len(recording) - 1].time - recording[0].time
    if number < FEWEST_FRAMES or 0 < seconds < SHORTEST:
        lasting = f" in {seconds:.0f} s" if seconds > 0 else ""
        raise ValueError(
            f"{number} frames{lasting} do not tell what waits from what belongs to the site: give "
            f"at least {FEWEST_FRAMES} frames over {SHORTEST:.0f} s, or leave {BACKGROUND} out"
        )


def check_detector(name: str, place: "Place | None" = None) -> None:
    """Raise FileNotFoundError for a name that stands for no detector, before any work. place: where
    it will detect. Raises ValueError if its area is not that of the weights."""
    bare = parse_detector(name).bare
    if bare not in ("voxelnet", CLUSTER) and ":" not in bare:
        from models.detector import weights_file

        if not weights_file(bare).is_file():
            raise FileNotFoundError(f"no such file of weights: {bare}")
        if bare.endswith(".onnx"):
            from models.onnx_files import OnnxDetector

            OnnxDetector(bare)
    if ":" in bare:
        from toolkit.detection.detect import resolve_detector

        resolve_detector(bare)
    if place is not None and place.area is not None and bare not in ("voxelnet", CLUSTER):
        place_detector(bare, place)


def site_detector(name: str, site: "Site") -> "Detector":
    """Return a detector for a site. name: voxelnet for the site's own shipped network, a shipped
    name, a file of weights or in ONNX, or package.module:callable, and what may stand behind it;
    +background: of the site's scenery."""
    asked = parse_detector(name, site)
    detector = _bare_detector(asked, site)
    if not asked.known:
        return detector
    from toolkit.detection.background import add_background

    return add_background(detector, site)


def _bare_detector(asked: NamedDetector, site: "Site") -> "Detector":
    """Detector for a site that knows no background."""
    from models.detector import load_detector, load_site_detector

    name = asked.bare
    if name == CLUSTER:
        raise ValueError(
            "detector cluster learns from a recording, of which there is none here: take voxelnet"
        )
    if ":" in name:
        from toolkit.detection.detect import ImportedDetector

        return asked.tune(ImportedDetector(name, site))
    if name.endswith(".onnx"):
        from models.onnx_files import OnnxDetector

        return asked.tune(OnnxDetector(name, site.area))
    found = (
        load_site_detector(site.name, site.area)
        if name == "voxelnet"
        else load_detector(name, area=site.area)
    )
    return asked.tune(found)


def place_detector(name: str, place: "Place") -> "Detector":
    """Return a detector for frames of any recording, of points counted from the middle of the
    place."""
    import numpy as np

    from toolkit.sites.site import Site

    asked = parse_detector(name)
    if asked.known:
        raise ValueError(
            f"{name} must see the site empty first: take coview detect, or leave {BACKGROUND} out"
        )
    if asked.bare in ("voxelnet", CLUSTER):
        raise ValueError(
            f"{name} needs a site: take general, another shipped network, a weights file or your "
            "own"
        )
    x, y = place.half
    return _bare_detector(asked, Site("recording", np.array([-x, -y, x, y])))


_BEHIND = re.compile(r"(.+?)((?:\+background|-background|\+phases\d{1,3}|\+bfloat16|\+float32)*)")


def parse_detector(name: str, site: "Site | None" = None) -> NamedDetector:
    """Parse a detector's name."""
    found = _BEHIND.fullmatch(name)
    bare, behind = found.groups() if found else (name, "")
    by_default = (
        bare == GENERAL and BARE not in behind and site is not None and len(site.solids) > 0
    )
    phases = re.search(r"phases(\d+)", behind)
    known = BACKGROUND in behind or by_default
    coarse = QUICK in behind and EXACT not in behind
    unknown_site = bare == GENERAL and BARE not in behind and site is None and not known
    return NamedDetector(bare, known, int(phases[1]) if phases else 1, coarse, unknown_site)


def learns_background(name: str) -> bool:
    """Return True for a detector that learns what stands in a recording of an unknown site, by
    default."""
    parsed = parse_detector(name)
    return parsed.bare == GENERAL and not parsed.known and BARE not in name


def check_digest(name: str, detector: "Detector", remedy: str) -> None:
    """Raise ValueError for a detector without a digest."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it "
            f"uses{remedy}"
        )
