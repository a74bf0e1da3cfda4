"""Detectors by the names that --detector takes.

A name may end in these suffixes, in any order:

    +background   a detector that knows the empty site and leaves out what is always there.
                  `general` has it at a site with known scenery, `general-background` has not.
                  For `general`, `coview detect` learns what is in most frames if the site is
                  unknown and the sensors do not move. If nothing is known about the site,
                  `general` reports pedestrians from a higher score on
    +phases4      a network on four shifted grids, whose boxes are averaged
    +bfloat16     a network in coarser numbers, in half the time, if the processor has
                  instructions for them; `coview detect` adds it unless +float32 is given"""

import re
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple, SupportsFloat, cast

BACKGROUND = "+background"
NO_BACKGROUND = "-background"
CLUSTER = "cluster"
QUICK = "+bfloat16"
EXACT = "+float32"
GENERAL = "general"
# shorter recordings would learn waiting vehicles as background
MIN_LEARNING_FRAMES = 10
MIN_LEARNING_S = 60.0
_SUFFIXES = re.compile(r"(.+?)((?:\+background|-background|\+phases\d{1,3}|\+bfloat16|\+float32)*)")

if TYPE_CHECKING:
    import numpy as np

    from models.detector import VoxelNetDetector
    from toolkit.calibration.place import Place
    from toolkit.calibration.recording_scenes import Scenes
    from toolkit.datasets.dataset import CoopDataset
    from toolkit.frame import Recording
    from toolkit.objects import Detections, Detector
    from toolkit.sites.site import Site


class CloudDetector:
    """Detector in clouds of Open3D (tensor or legacy) and in arrays (n, 3) or (n, 4) of x, y, z, ….

    network: detector in level points; level: "map" or "plane" puts each cloud on level ground
    first, and boxes are in the cloud's frame. With None the ground must be at z = 0, and a warning
    gives the height of the first cloud's ground if it is elsewhere."""

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
        """Detect in one cloud.

        Raises ValueError for another type, and if no ground to level is found."""
        from dataclasses import replace

        import numpy as np

        from toolkit.calibration.ground import level, plain_points

        points = plain_points(cloud)
        if self.level is not None and len(points):
            points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
            ground = level(points, method=self.level)
            detections = self.network(ground.points(points).astype(np.float32))
            if not len(detections):
                return detections
            return replace(detections, boxes=ground.boxes_back(detections.boxes))
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
        from toolkit.calibration.level_warning import level_warning

        warning = level_warning(points)
        if warning is not None:
            problem = warning.removesuffix(": level the points first")
            warnings.warn(
                f'not levelled: {problem}: load_detector(..., level="map") levels clouds',
                stacklevel=3,
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
    """Load a detector by shipped name or by the path of its weights.

    name: "tjunction", "roundabout", "general" or a path; level: see `CloudDetector`; other
    parameters: see `models.load_detector`, which returns the bare network. Raises
    FileNotFoundError for unknown weights, ValueError if they are damaged or for another place."""
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
    """Parsed detector name: base name and options."""

    bare: str
    known: bool = False  # whether it knows the site's background
    phases: int = 1  # number of shifted grids
    bfloat16: bool = False
    unknown_site: bool = False  # nothing is known about the background

    def tune(self, detector: "Detector") -> "Detector":
        """Return a detector with these grids and numbers.

        Raises ValueError for a detector without a grid."""
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
    """Return the detector for a recording: cluster, or a detector of `site_detector`.

    Cluster learns the recording's empty site. With +background the detector knows the site's
    scenery, or what the recording shows behind all that moves.

    name: name of the detector; None for `find_network`, which plans use, at a known site, else for
    general; place: place of detection, if not at the site itself; scenes: empty scenes to learn
    from."""
    from toolkit.calibration.place import Place
    from toolkit.detection.background import KnownBackground, recording_background
    from toolkit.detection.cluster import ClusterDetector, learn_cluster_detector

    place = place or Place()
    site = recording.site
    at_site = site is not None and place.at(site)
    if name is None and site is not None and at_site:
        from placement_env.fidelity.preparation import find_network, load_shipped_detector

        sensors = recording[0].sensors if len(recording) else site.sensors
        return load_shipped_detector(find_network(site, sensors), site)
    name = name or GENERAL
    parsed = parse_detector(name, site if at_site else None)
    if site is not None and at_site:
        dataset = cast("CoopDataset", recording)
        if parsed.bare == CLUSTER:
            return parsed.tune(ClusterDetector.of(dataset))
        detector = _bare_detector(parsed, site)
        if not parsed.known:
            return detector
        return KnownBackground(detector, recording_background(dataset))
    if parsed.bare != CLUSTER and not parsed.known:
        return place_detector(name, place)

    from toolkit.calibration import recording_scenes

    if not len(recording):
        raise ValueError("there is no frame to evaluate: check the path and the layout")
    if parsed.known:
        _check_long(recording)
    learnt = learn_cluster_detector(
        scenes or recording_scenes.Scenes(recording), recording[0], place
    )
    if parsed.bare == CLUSTER:
        return parsed.tune(learnt)
    return KnownBackground(
        place_detector(name.replace(BACKGROUND, NO_BACKGROUND), place), learnt.background
    )


def _check_long(recording: "Recording") -> None:
    """Raise ValueError for a recording too short to distinguish waiting vehicles."""
    number = len(recording)
    seconds = recording[len(recording) - 1].time - recording[0].time
    if number < MIN_LEARNING_FRAMES or 0 < seconds < MIN_LEARNING_S:
        duration = f" in {seconds:.0f} s" if seconds > 0 else ""
        raise ValueError(
            f"{number} frames{duration} do not distinguish what waits from what belongs to the "
            f"site: give at least {MIN_LEARNING_FRAMES} frames over {MIN_LEARNING_S:.0f} s, or "
            f"leave {BACKGROUND} out"
        )


def check_detector(name: str, place: "Place | None" = None) -> None:
    """Raise FileNotFoundError for an unknown detector.

    place: place of detection. Raises ValueError if its area differs from the area of the
    weights."""
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
    """Return a detector for a site.

    name: voxelnet for the site's shipped network, a shipped name, a file of weights or in ONNX, or
    package.module:callable, with suffixes. With +background it knows the site's scenery."""
    parsed = parse_detector(name, site)
    detector = _bare_detector(parsed, site)
    if not parsed.known:
        return detector
    from toolkit.detection.background import add_background

    return add_background(detector, site)


def _bare_detector(parsed: NamedDetector, site: "Site") -> "Detector":
    """Return a detector for a site, without its background."""
    from models.detector import load_detector, load_site_detector

    name = parsed.bare
    if name == CLUSTER:
        raise ValueError(
            "detector cluster learns from a recording, and here is no recording: take voxelnet"
        )
    if ":" in name:
        from toolkit.detection.detect import ImportedDetector

        return parsed.tune(ImportedDetector(name, site))
    if name.endswith(".onnx"):
        from models.onnx_files import OnnxDetector

        return parsed.tune(OnnxDetector(name, site.area))
    network = (
        load_site_detector(site.name, site.area)
        if name == "voxelnet"
        else load_detector(name, area=site.area)
    )
    return parsed.tune(network)


def place_detector(name: str, place: "Place") -> "Detector":
    """Return a detector for frames of any recording, with points relative to the place."""
    import numpy as np

    from toolkit.sites.site import Site

    parsed = parse_detector(name)
    if parsed.known:
        raise ValueError(
            f"{name} must see the site empty first: take coview detect, or leave {BACKGROUND} out"
        )
    if parsed.bare in ("voxelnet", CLUSTER):
        raise ValueError(
            f"{name} needs a site: take general, another shipped network, a weights file or your "
            "own"
        )
    x, y = place.half
    return _bare_detector(parsed, Site("recording", np.array([-x, -y, x, y])))


def parse_detector(name: str, site: "Site | None" = None) -> NamedDetector:
    """Parse a detector's name. site: site of detection, if it is known."""
    match = _SUFFIXES.fullmatch(name)
    bare, suffixes = match.groups() if match else (name, "")
    has_scenery = site is not None and len(site.solids) > 0
    knows_by_default = bare == GENERAL and NO_BACKGROUND not in suffixes and has_scenery
    phases = re.search(r"phases(\d+)", suffixes)
    known = BACKGROUND in suffixes or knows_by_default
    is_bare = NO_BACKGROUND in suffixes
    return NamedDetector(
        bare,
        known=known,
        phases=int(phases[1]) if phases else 1,
        bfloat16=QUICK in suffixes and EXACT not in suffixes,
        unknown_site=bare == GENERAL and site is None and not known and not is_bare,
    )


def learns_background(name: str) -> bool:
    """Return whether a detector learns the background of an unknown site by default."""
    parsed = parse_detector(name)
    return parsed.bare == GENERAL and not parsed.known and NO_BACKGROUND not in name


def check_digest(name: str, detector: "Detector", remedy: str) -> None:
    """Raise ValueError for a detector without a digest."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it "
            f"uses{remedy}"
        )
