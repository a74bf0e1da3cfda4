"""Detectors by name (`coview.detector_spec`), opened for a site, a place or a recording."""

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, SupportsFloat, cast

from coview.detector_spec import CLUSTER, GENERAL, VOXELNET, DetectorSpec

# shorter recordings would learn waiting vehicles as background
MIN_LEARNING_FRAMES = 10
MIN_LEARNING_S = 60.0
_USUAL_SPEC = DetectorSpec.from_name(GENERAL)

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
    gives the height of the first cloud's ground if it is elsewhere.

    Attributes:
        labels: Classes that the network detects.
        area: Area that it covers, in the frame of the level points.
        name: Name of the network.
        digest: Text that changes with all that the detections depend on.
    """

    def __init__(
        self, network: "VoxelNetDetector", level: Literal["map", "plane"] | None = None
    ) -> None:
        """Wrap a network. level: way to level clouds, None to take them as they are."""
        if level not in ("map", "plane", None):
            raise ValueError(f'level must be "map", "plane" or None, got {level!r}')
        self.network = network
        self.level = level  # way to level clouds, None to take them as they are
        self._is_level_checked = level is not None
        self.labels = network.labels
        self.area = network.area
        self.name = network.name
        self.digest = network.digest if level is None else f"{network.digest} {level}"

    def __call__(self, cloud: object, /) -> "Detections":
        """Detect in one cloud; boxes are in the cloud's frame.

        With `level`, points that are not finite are left out. Raises ValueError for another type,
        and if no ground to level is found."""
        from dataclasses import replace

        import numpy as np

        from toolkit.calibration.ground import level, plain_points

        points = plain_points(cloud)
        if self.level is not None and len(points):
            points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
            ground = level(points, method=self.level)
            # the network sees the points with the ground at z = 0
            detections = self.network(ground.points(points).astype(np.float32))
            if not len(detections):
                return detections
            return replace(detections, boxes=ground.boxes_back(detections.boxes))
        if not self._is_level_checked and len(points):  # checked for the first cloud only
            self._is_level_checked = True
            self._warn_unless_level(points)
        return self.network(points)

    def unions(
        self, clouds: "Sequence[np.ndarray]", unions: "np.ndarray"
    ) -> "Sequence[Detections]":
        """Detect in each union of clouds.

        unions: a row for each union, with True for each cloud that belongs to it."""
        from toolkit.points import join_clouds

        # points that need not be levelled go to the network as they are, which shares work
        if self.level is None:
            return self.network.unions(clouds, unions)
        return [self(join_clouds(clouds, union)) for union in unions]

    def _warn_unless_level(self, points: "np.ndarray") -> None:
        """Warn if the ground of a cloud is not at z = 0. points: rows of x, y, z (m)."""
        from toolkit.calibration.level_warning import level_warning

        warning = level_warning(points)
        if warning is not None:
            problem = warning.removesuffix(": level the points first")
            warnings.warn(
                f'not levelled: {problem}: load_detector(..., level="map") levels clouds',
                stacklevel=3,  # the place at which the detector was called
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

    name: "tjunction", "roundabout", "general" or a path; level: "map" or "plane" to put clouds on
    level ground first, None for clouds whose ground is at z = 0; site: site that the weights must
    be for, None for any; area: xmin, ymin, xmax, ymax (m), None for the weights' area;
    score_threshold: lowest score of a detection, None for the weights' thresholds; nms_threshold:
    footprint IoU above which the weaker of two boxes is dropped. Raises FileNotFoundError for
    unknown weights, ValueError if they are damaged or for another place."""
    from models import detector_loading

    if Path(name).suffix == ".onnx":
        from models.onnx_files import OnnxDetector

        onnx = OnnxDetector(
            name, area, score_threshold=score_threshold, nms_threshold=nms_threshold
        )
        return CloudDetector(onnx, level)
    network = detector_loading.load_detector(
        name,
        site=site,
        area=area,
        device=device,
        score_threshold=score_threshold,
        nms_threshold=nms_threshold,
    )
    return CloudDetector(network, level)


def open_detector(
    spec: DetectorSpec | None,
    at: "Site | Place | Recording",
    place: "Place | None" = None,
    scenes: "Scenes | None" = None,
) -> "Detector":
    """Open a detector for a site, a place in any recording, or a recording.

    At a site, +background is the site's scenery. In a recording, it is what the recording shows
    behind all that moves, and cluster learns the empty scene.

    Args:
        spec: Parsed name. None for the network that plans use in a recording of a known site, and
            for general elsewhere.
        at: What the detector is for.
        place: Place of detection in a recording, None for the whole site.
        scenes: Empty scenes to learn from, None for the recording's.

    Raises:
        ValueError: For a detector that does not fit.
    """
    from toolkit.calibration.place import Place
    from toolkit.sites.site import Site

    if isinstance(at, Site):
        return _open_at_site(spec or _USUAL_SPEC, at)
    if isinstance(at, Place):
        return _open_at_place(spec or _USUAL_SPEC, at)
    place = place or Place()
    if at.site is not None and place.uses_site(at.site):
        return _open_for_known_site(spec, at, at.site)
    return _open_for_recording(spec or _USUAL_SPEC, recording=at, place=place, scenes=scenes)


def check_detector(spec: DetectorSpec, place: "Place | None" = None) -> None:
    """Raise FileNotFoundError for an unknown detector, before long work begins.

    place: area and ground of detection, None if it detects at a site. Raises ValueError if its area
    differs from the area of the weights."""
    if spec.is_imported:
        from toolkit.detection.detect import resolve_detector

        resolve_detector(spec.base)  # raises if it cannot be imported
    elif not spec.needs_site:
        from models.detector_loading import weights_file

        if not weights_file(spec.base).is_file():
            raise FileNotFoundError(f"no such file of weights: {spec.base}")
        if spec.is_onnx:
            from models.onnx_files import OnnxDetector

            OnnxDetector(spec.base)
    if place is not None and place.area is not None and not spec.needs_site:
        _open_at_place(spec.without_suffixes(), place)  # opened only for its errors


def check_digest(name: str, detector: "Detector", remedy: str) -> None:
    """Raise ValueError for a detector without a digest.

    name: name of the detector in the error; remedy: end of the error's text, with what helps."""
    if not hasattr(detector, "digest"):
        raise ValueError(
            f"detector {name} needs an attribute digest, a text that changes with all it "
            f"uses{remedy}"
        )


def _open_for_known_site(
    spec: DetectorSpec | None, recording: "Recording", site: "Site"
) -> "Detector":
    """Open a detector for a recording of a known site.

    spec: parsed name; None for the network that plans use for these sensors."""
    from toolkit.detection.background import KnownBackground, recording_background
    from toolkit.detection.cluster import ClusterDetector

    if spec is None:
        from placement_env.fidelity.shipped import find_network, load_shipped_detector

        sensors = recording[0].sensors if len(recording) else site.sensors
        return load_shipped_detector(find_network(site, sensors), site)
    dataset = cast("CoopDataset", recording)
    if spec.base == CLUSTER:
        return _tune(spec, ClusterDetector.from_recording(dataset))
    detector = _tune(spec, _load_network(spec, site))
    if not spec.knows_background(site):
        return detector
    return KnownBackground(detector, recording_background(dataset))


def _open_for_recording(
    spec: DetectorSpec, recording: "Recording", place: "Place", scenes: "Scenes | None"
) -> "Detector":
    """Open a detector for a recording of an unknown site.

    cluster, and detectors that know the background, learn the empty scene first. spec: parsed name
    of the detector; place: area and ground; scenes: empty scenes to learn from, None for the
    recording's."""
    from toolkit.calibration import recording_scenes
    from toolkit.detection.background import KnownBackground
    from toolkit.detection.cluster import learn_cluster_detector

    if spec.base != CLUSTER and not spec.knows_background():
        return _open_at_place(spec, place)
    if not len(recording):
        raise ValueError("there is no frame to evaluate: check the path and the layout")
    if spec.knows_background():
        _check_long(recording)
    learnt = learn_cluster_detector(
        scenes or recording_scenes.Scenes(recording), recording[0], place
    )
    if spec.base == CLUSTER:
        return _tune(spec, learnt)
    return KnownBackground(_open_at_place(spec.without_background(), place), learnt.background)


def _check_long(recording: "Recording") -> None:
    """Raise ValueError for a recording too short to distinguish waiting vehicles from the scene.

    A recording without times (0 s) needs only enough frames."""
    frames = len(recording)
    seconds = recording[frames - 1].time - recording[0].time
    if frames < MIN_LEARNING_FRAMES or 0 < seconds < MIN_LEARNING_S:
        duration = f" in {seconds:.0f} s" if seconds > 0 else ""
        raise ValueError(
            f"{frames} frames{duration} do not distinguish what waits from what belongs to the "
            f"site: give at least {MIN_LEARNING_FRAMES} frames over {MIN_LEARNING_S:.0f} s, or "
            "leave +background out"
        )


def _open_at_site(spec: DetectorSpec, site: "Site") -> "Detector":
    """Open a detector for a site. Its background is the site's scenery."""
    from toolkit.detection.background import add_background

    detector = _tune(spec, _load_network(spec, site))
    return add_background(detector, site) if spec.knows_background(site) else detector


def _open_at_place(spec: DetectorSpec, place: "Place") -> "Detector":
    """Open a detector for frames of any recording, with points relative to the place.

    Raises ValueError for a detector that needs a background, PlaceMismatch for one of another area
    or one that needs a site."""
    import numpy as np

    from toolkit.sites.site import PlaceMismatch, Site

    if spec.knows_background():
        raise ValueError(
            f"{spec.name} must see the site empty first: take coview detect, or leave +background "
            "out"
        )
    if spec.needs_site:
        raise PlaceMismatch(
            f"{spec.name} needs a site: take general, another shipped network, a weights file or "
            "your own"
        )
    half_length, half_width = place.half  # half sizes of the area along x and y (m)
    area = np.array([-half_length, -half_width, half_length, half_width])
    detector = _load_network(spec, Site("recording", area))
    # a detector that learns the empty scene is one for sites that it was not trained on
    return _tune(spec, detector, is_site_unknown=spec.learns_scene)


def _load_network(spec: DetectorSpec, site: "Site") -> "Detector":
    """Load the detector of a name without its suffixes, for the area of a site.

    Raises ValueError for cluster, which learns from a recording."""
    if spec.base == CLUSTER:
        raise ValueError(
            "detector cluster learns from a recording, and here is no recording: take voxelnet"
        )
    if spec.is_imported:
        from toolkit.detection.detect import ImportedDetector

        return ImportedDetector(spec.base, site)
    if spec.is_onnx:
        from models.onnx_files import OnnxDetector

        return OnnxDetector(spec.base, site.area)
    from models.detector_loading import load_detector, load_site_detector

    if spec.base == VOXELNET:
        return load_site_detector(site.name, site.area)
    return load_detector(spec.base, area=site.area)


def _tune(spec: DetectorSpec, detector: "Detector", *, is_site_unknown: bool = False) -> "Detector":
    """Detector with the shifted grids and the coarser numbers that its name asks for.

    is_site_unknown: True to report pedestrians only from a higher score on. Raises
    ValueError for shifted grids of a detector that has none."""
    from toolkit.objects import quick_detector

    if spec.phases != 1:
        if not hasattr(detector, "shift_grids"):
            raise ValueError(
                f"+phases shifts the grid of a network, which {spec.base} is not: leave it out"
            )
        detector = detector.shift_grids(spec.phases)
    if is_site_unknown:
        detector = cast("VoxelNetDetector", detector).at_unknown_site()
    return quick_detector(detector) if spec.numbers == "bfloat16" else detector
