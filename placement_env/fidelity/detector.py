"""`Detected`: score sensor sets by running the detector.

Each set is fused, detected in and matched against the truth. The result equals the one from
`toolkit.detection.evaluation.evaluate_recording` for the same sensors and frames, by protocol
`exact`: objects centred outside the site's area are present but not scored. Every run of the
detector and every match is kept in a `Cache` under all that it depends on. So a set costs detection
once, for any caller and any number of frames.

Two kinds of value are kept, of one frame each:

    detections   the detector's result for the points of some sensors together, under their
                 processing. Sensors that add no point are left out of the key; schemes and codecs
                 with the same points share it.
    outcome      detections of one set in one scheme with one codec, fused and matched at each IoU
                 threshold, class by class: vehicles at `Detected.ious`, the others at
                 those that `Classes.get_iou` gives"""

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import cached_property, partial
from multiprocessing import parent_process
from pathlib import Path
from typing import NamedTuple, Protocol, cast, runtime_checkable

import numpy as np

from placement_env.checks import check_iou
from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.traffic import scored
from placement_env.protocol import ClassEstimates, Estimate
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.metrics import average_precision, matches, precision_recall
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.detection.view import Captured, Cloud, Images, View, together
from toolkit.objects import LABELS, Detections, Detector, Objects, UnionDetector, check_known
from toolkit.points import detect_on_ground, detect_unions_on_ground
from toolkit.runtime.cache import Arrays, Cache, code_digest, make_key
from toolkit.runtime.run import Processes
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site
from toolkit.traffic.spawner import LIFE

IOUS = (0.7, 0.8, 0.9)  # thresholds for vehicles at which every outcome is matched
FALSE_ALARM = -1  # for a detection that hits no object
IGNORED = -2  # for a detection that counts neither as hit nor as false alarm
MAX_SETS_HELD = 500  # sets whose outcomes are held in memory together


@runtime_checkable
class Measured(Protocol):
    """Measurements of candidates in frames at a site.

    One is `placement_env.fidelity.renders.Renders`. Frames and candidates are numbered from 0."""

    site: Site
    sensors: tuple[Sensor, ...]
    frames: int

    @property
    def digest(self) -> str:
        """Digest of everything that the measurements depend on except the sensors."""

    def clouds(self, k: int, c: int) -> Float32[np.ndarray, "n 3"]:
        """Noisy points of candidate c in frame k inside the crop (m, world frame)."""

    def objects(self, k: int) -> Objects:
        """All objects present in frame k."""


@runtime_checkable
class MeasuredImages(Protocol):
    """Images of candidates in frames, for schemes and codecs that send images."""

    @property
    def scene(self) -> Callable[[int], EmptyScene]:
        """Function that returns the scene without moving objects of candidate c."""

    def captured(self, k: int, c: int) -> Captured:
        """Image of candidate c in frame k, from which its points come."""


@runtime_checkable
class MeasuredWays(Protocol):
    """Measurements in frames in which not all objects of a class count."""

    def counted(self, k: int) -> Bool[np.ndarray, " objects"]:
        """Mask of the objects of frame k that count, if their class and place do."""


class Outcome(NamedTuple):
    """The n detections of one set in one frame, matched with the frame's objects.

    Attributes:
        scores: Score of each detection.
        truth: At each IoU threshold and for each detection, the index of the object that it hits
            among the frame's scored objects, or `FALSE_ALARM` or `IGNORED`.
        bits: Bits sent by each sensor of the set.
        labels: Class (number) of each detection."""

    scores: Float64[np.ndarray, " n"]
    truth: Shaped[np.ndarray, "ious n"]
    bits: Shaped[np.ndarray, " sensors"]
    labels: Shaped[np.ndarray, " n"]

    def of_class(self, label: int) -> "Outcome":
        """Outcome of the detections of one class (number).

        Indices in `truth` remain those among the scored objects of all classes; `bits` stay."""
        has_label = self.labels == label
        return Outcome(
            scores=self.scores[has_label],
            truth=self.truth[:, has_label],
            bits=self.bits,
            labels=self.labels[has_label],
        )


class Detected:
    """Score sets by running the detector on all that their sensors measure.

    Other fidelities approximate this one.

    Args:
        renders: Measurements of the candidates.
        detector: The detector.
        scheme: Fusion scheme, or its name.
        codec: Codec of the sent data.
        iou: IoU from which a detection counts.
        memo: Keeps detections and outcomes, or the path of its file; None to keep them in this
            object's memory.
        processes: Processes that work on the frames, with the same figures.
        classes: Classes of the objects that count; several are combined.

    Raises ValueError if these do not fit, for a class that the detector does not know, and for a
    detector without `digest` with a memo that others share."""

    name = "detector"

    def __init__(
        self,
        renders: Measured,
        detector: Detector,
        scheme: Scheme | str,
        *,
        codec: Codec = PAPER,
        iou: float = 0.7,
        memo: Cache | str | Path | None = None,
        processes: Processes = Processes(),
        classes: Classes = VEHICLES,
    ) -> None:
        """Check and keep what the scores depend on; nothing is detected yet.

        Raises ValueError for an IoU threshold, class or codec that does not fit, and for a cache
        with a detector without digest."""
        check_iou(iou)
        check_known(detector, classes.names)
        self.classes = classes
        self.processes = processes
        self.renders = renders
        self.detector = detector
        self.iou = iou
        self.scheme = find_scheme(scheme)
        self.codec = check_codec(codec)
        self.frames = len(_list_frames(renders.frames, frames=None))  # ValueError if there are none
        self.ious = tuple(sorted({*IOUS, iou}))  # thresholds at which outcomes are matched
        self._scored: dict[int, np.ndarray] = {}  # mask of the objects to find, by frame
        self.memo = memo if isinstance(memo, Cache) else Cache(memo)
        if memo is not None and not hasattr(detector, "digest"):
            rule = "a shared memo needs a detector that says what it depends on"
            raise ValueError(
                f"{rule}, {type(detector).__name__} has no property digest: add one or pass "
                "memo=None"
            )

    def at(self, iou: float, also: Iterable[float] = ()) -> "Detected":
        """Copy whose figures are for another IoU threshold; it shares measurements and cache.

        Args:
            iou: IoU from which a detection counts.
            also: Further thresholds at which outcomes are matched, in addition to `ious`."""
        check_iou(iou)
        detected = copy(self)
        detected.iou = iou
        detected.ious = tuple(sorted({*self.ious, iou, *also}))
        return detected

    def of_classes(self, classes: Classes) -> "Detected":
        """Copy whose figures are for other classes; it shares measurements and kept detections."""
        check_known(self.detector, classes.names)
        detected = copy(self)
        detected.classes = classes
        detected._scored = {}
        return detected

    def __call__(self, subsets: Sets, /) -> Estimate:
        """AP, recall and kbit of each set over all frames at the IoU threshold `iou`.

        AP and recall are NaN if there is no object to find."""
        return self.estimates(subsets)[self.iou]

    def partial(self, subsets: Sets, frames: int | Sequence[int]) -> Estimate:
        """AP, recall and kbit of each set over some frames; only frames not scored before cost.

        frames: Number of frames from the first on, or a list of their indices."""
        return self.estimates(subsets, frames)[self.iou]

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """AP and recall of each set over all frames for each class, and kbit of the set."""
        return self.class_estimates(subsets)[self.iou]

    def estimates(
        self,
        subsets: Sets,
        frames: int | Sequence[int] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> dict[float, Estimate]:
        """AP, recall and kbit of each set, by IoU threshold (`ious`).

        Args:
            subsets: Sets as rows of booleans, one column per candidate.
            frames: Number of frames from the first on, or their indices; None for all.
            progress: Called with the number of new frames done."""
        by_class = self.class_estimates(subsets, frames, progress)
        return {iou: estimates.combined(self.classes) for iou, estimates in by_class.items()}

    def class_estimates(
        self,
        subsets: Sets,
        frames: int | Sequence[int] | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> dict[float, ClassEstimates]:
        """AP and recall of each set for each class, and its kbit, by IoU threshold of vehicles.

        Other classes are matched at the thresholds that `Classes.get_iou` gives for the keys.

        Args:
            subsets: Sets as rows of booleans, one column per candidate.
            frames: Number of frames from the first on, or their indices; None for all.
            progress: Called with the number of new frames done."""
        sets = self._list_members(subsets)
        frame_indices = _list_frames(self.frames, frames)
        to_find = [
            int(self.count_to_find(frame_indices, label).sum()) for label in self.classes.labels
        ]
        # axes: set, class, IoU threshold; the last one is AP, recall, kbit
        figures = np.zeros((len(sets), len(self.classes), len(self.ious), 3))
        for first in range(0, len(sets), MAX_SETS_HELD):
            block = sets[first : first + MAX_SETS_HELD]
            outcomes = self.outcomes(dict.fromkeys(block), frame_indices, progress)
            for row, members in enumerate(block, first):
                for c, label in enumerate(self.classes.labels):
                    of_class = [outcome.of_class(label) for outcome in outcomes[members]]
                    figures[row, c] = _compute_figures(of_class, to_find[c])
        ap, recall, kbit = np.moveaxis(figures, -1, 0).copy()  # each [set, class, IoU]
        # kbit are the same for all classes, so the first class's serve
        return {
            iou: ClassEstimates(
                ap=ap[:, :, i].copy(), recall=recall[:, :, i].copy(), kbit=kbit[:, 0, i].copy()
            )
            for i, iou in enumerate(self.ious)
        }

    def hits(self, subset: Bool[np.ndarray, " candidates"]) -> Bool[np.ndarray, "ious objects"]:
        """Mask of the scored objects that one set hits, a row for each of `ious`.

        Columns are the scored objects of all frames, frame after frame.

        subset: True for the candidates of the set."""
        (members,) = self._list_members(subset[None])
        masks = []  # one for each frame; axes are IoU threshold and scored object
        for k, outcome in enumerate(self.outcomes([members], range(self.frames))[members]):
            frame_mask = np.zeros((len(self.ious), int(self.scored(k).sum())), np.bool_)
            for hit_objects, truth in zip(frame_mask, outcome.truth, strict=True):
                hit_objects[truth[truth >= 0]] = True  # negative: no object
            masks.append(frame_mask)
        return np.concatenate(masks, axis=1)

    def outcomes(
        self,
        sets: Iterable[tuple[int, ...]],
        frames: Sequence[int],
        progress: Callable[[int], None] | None = None,
    ) -> dict[tuple[int, ...], list[Outcome]]:
        """Outcomes of each set, one per frame in the order of `frames`, cached or made now.

        Args:
            sets: Sets as ascending indices of candidates.
            frames: Indices of frames.
            progress: Called with the number of frames done that had an unknown outcome; None for
                silence."""
        # for each set its outcome in each of `frames`, None while unknown
        by_set: dict[tuple[int, ...], list[Outcome | None]] = {}
        for members in sets:
            cached = self.memo.get([self._outcome_key(members, k) for k in frames])
            by_set[members] = [None if arrays is None else Outcome(*arrays) for arrays in cached]
        tasks = []
        for position, k in enumerate(frames):
            unknown_sets = [members for members, row in by_set.items() if row[position] is None]
            if unknown_sets:
                tasks.append(_Task(position=position, k=k, sets=unknown_sets))
        job = partial(_score_frame, self)
        results = self.processes.map(job, tasks, home=_Task.choose_home, progress=progress)
        for task, (outcomes, new_detections) in zip(tasks, results, strict=True):
            new_values = dict(new_detections)
            for members, outcome in zip(task.sets, outcomes, strict=True):
                new_values[self._outcome_key(members, task.k)] = cast(Arrays, outcome)
                by_set[members][task.position] = outcome
            self.memo.put(new_values)
        return {members: cast(list[Outcome], row) for members, row in by_set.items()}

    def detections(self, members: tuple[int, ...], k: int) -> Detections:
        """Fused detections of a set (ascending indices of candidates) in frame k, not matched."""
        detections, new_detections = _fuse_frame(self, members, k)
        self.memo.put(new_detections)
        return detections

    def outcome(self, k: int, fused: Fused) -> Outcome:
        """Match the fused detections of a set with the objects of frame k at all IoU thresholds.

        fused: Detections in frame k, and the bits that each sensor of the set sent for them."""
        detections = fused.detections
        objects = self.renders.objects(k)
        is_scored = self.scored(k)
        # index among the scored objects of each object of the frame; a match of -1 (no object)
        # reads the last entry
        scored_index = np.append(np.cumsum(is_scored) - 1, FALSE_ALARM)
        truth = np.full((len(self.ious), len(detections)), IGNORED, np.int16)  # [IoU, detection]
        for label, ious in self.thresholds:  # number and IoU thresholds of each class
            at_each_iou = matches(detections, objects, ious, label=label, counted=is_scored)
            for row, matched in enumerate(at_each_iou):
                # detections of other classes are ignored here and keep their entry
                truth[row] = np.where(matched.ignored, truth[row], scored_index[matched.truth])
        return Outcome(
            scores=detections.scores,
            truth=truth,
            bits=fused.bits,
            labels=detections.labels.astype(np.int8),
        )

    def key(self, k: int, kind: str, sensors: Sequence[int], *more: object) -> bytes:
        """Cache key of a value of frame k.

        Args:
            k: Index of the frame.
            kind: Kind of value, "detections" or "outcome".
            sensors: Indices of the candidates that it depends on.
            more: Further things that it depends on."""
        return make_key(
            kind, self._shared_digest, k, [self._sensor_digests[c] for c in sensors], *more
        )

    def scored(self, k: int) -> Bool[np.ndarray, " objects"]:
        """Mask of the objects of frame k to be found: of the classes and centred in the area."""
        if k not in self._scored:
            mask = scored(self.renders.objects(k), self.renders.site, self.classes.labels)
            if isinstance(self.renders, MeasuredWays):
                mask = mask & self.renders.counted(k)
            self._scored[k] = mask
        return self._scored[k]

    def to_find(self, k: int, label: int) -> Bool[np.ndarray, " objects"]:
        """Mask of the objects of frame k to be found that have one class (number)."""
        return self.scored(k) & (self.renders.objects(k).labels == label)

    def count_to_find(self, frames: Iterable[int], label: int) -> Int64[np.ndarray, " frames"]:
        """Number of objects of one class (number) to be found in each of some frames (indices)."""
        return np.array([self.to_find(k, label).sum() for k in frames], np.int64)

    def _outcome_key(self, members: tuple[int, ...], k: int) -> bytes:
        """Key of the outcome of a set (indices of candidates) in frame k."""
        return self.key(
            k, "outcome", members, self.scheme.digest, self.codec.digest, self.thresholds
        )

    @property
    def thresholds(self) -> list[tuple[int, list[float]]]:
        """Number of each class, with its IoU thresholds in the order of `ious`."""
        thresholds = []
        for label in self.classes.labels:
            class_ious = [self.classes.get_iou(LABELS[label], iou) for iou in self.ious]
            thresholds.append((label, class_ious))
        return thresholds

    def _list_members(self, subsets: np.ndarray) -> list[tuple[int, ...]]:
        """Ascending indices of the candidates of each set (row of booleans)."""
        if subsets.shape[1] != len(self.renders.sensors):
            raise ValueError(
                f"sets must be rows of {len(self.renders.sensors)} candidates, got {subsets.shape}"
            )
        return [tuple(np.flatnonzero(row).tolist()) for row in subsets]

    @cached_property
    def _shared_digest(self) -> str:
        """Digest of everything that the values of all frames and sets depend on, code included."""
        inputs = [
            self.renders.digest,
            getattr(self.detector, "digest", ""),
            self.renders.site.hybrid_radius,
        ]
        # the inner detector, if this one wraps another to give it a known background
        bare_detector = getattr(self.detector, "detector", self.detector)
        used_objects = (self.detector, bare_detector, self.scheme, self.codec)
        code = code_digest(__name__, *(used.__module__ for used in used_objects))
        return make_key(*inputs, code).hex()

    @cached_property
    def _sensor_digests(self) -> list[str]:
        # digest of each candidate; the name counts, as errors may be drawn by it
        return [make_key(sensor.name, sensor.digest).hex()[:32] for sensor in self.renders.sensors]


class _Task(NamedTuple):
    """Sets to score in one frame.

    Attributes:
        position: Place of the frame in the caller's list of frames.
        k: Index of the frame.
        sets: Sets as ascending indices of candidates."""

    position: int
    k: int
    sets: list[tuple[int, ...]]

    def choose_home(self) -> int:
        """Number of the process that works on the frame."""
        return choose_home(self.k)


def _score_frame(detected: Detected, task: _Task) -> tuple[list[Outcome], dict[bytes, Arrays]]:
    """Outcomes of a task's sets in its frame, and the detections that were not cached, by key.

    It may run in another process than its caller.

    detected: Score by detections, with the measurements, detector, scheme, codec and cache."""
    frame = _FrameDetections(detected, task.k)
    frame.fuse_together(task.sets)
    outcomes = [detected.outcome(task.k, frame.fused(members)) for members in task.sets]
    _remember(detected, frame)
    return outcomes, frame.uncached_detections


def _fuse_frame(
    detected: Detected, members: tuple[int, ...], k: int
) -> tuple[Detections, dict[bytes, Arrays]]:
    """Fused detections of a set in frame k, and the detections that were not cached, by key.

    It may run in another process than its caller.

    detected: Score by detections, with the measurements, detector, scheme, codec and cache;
    members: ascending indices of the set's candidates."""
    frame = _FrameDetections(detected, k)
    detections = frame.fused(members).detections
    _remember(detected, frame)
    return detections, frame.uncached_detections


def choose_home(k: int) -> int:
    """Number of the process that works on frame k, always the same: it keeps what was measured.

    Successive frames alternate, and so do frames `2 * LIFE` apart, which are the first in a race of
    sets."""
    return k + k // (2 * LIFE)


def _remember(detected: Detected, frame: "_FrameDetections") -> None:
    """Keep new detections in a process of a pool, whose memory its parent does not share."""
    if parent_process() is not None and detected.memo.path is None:
        detected.memo.put(frame.uncached_detections)


def detect_in_frames(
    detected: Detected,
    members: tuple[int, ...],
    frames: Sequence[int],
    progress: Callable[[int], None] | None = None,
    *,
    are_known: bool = False,
) -> list[Detections]:
    """Fused detections of a set in each of some frames, not matched.

    Args:
        detected: Score by detections, whose processes work on the frames and whose cache keeps
            detections.
        members: Ascending indices of the set's candidates.
        frames: Indices of frames.
        progress: Called with the number of frames done; None for silence.
        are_known: True if the set has been scored in these frames, so that this is quick."""
    results = detected.processes.map(
        partial(_fuse_frame, detected, members),
        frames,
        home=choose_home,
        is_quick=are_known,
        progress=progress,
    )
    frame_detections = []
    for detections, new_detections in results:
        detected.memo.put(new_detections)
        frame_detections.append(detections)
    return frame_detections


class _FrameDetections:
    """Detections of sensor sets in frame k, each union of clouds detected in once.

    Attributes:
        uncached_detections: Arrays of the detections that were not cached, by key; the caller
            keeps them."""

    def __init__(self, rules: Detected, k: int) -> None:
        """Begin without any detections. rules: what they depend on; k: index of the frame."""
        self._rules = rules  # the fidelity: measurements, detector, scheme, codec and cache
        self._k = k
        self._site = rules.renders.site
        self._detected: dict[bytes, Detections] = {}  # by cache key
        # clouds of unknown detections by key, gathered in a round of `fuse_together`; else None
        self._requests: dict[bytes, list[Cloud]] | None = None
        # by set; without a sensor nothing is detected and nothing sent
        self._fused: dict[tuple[int, ...], Fused] = {
            (): Fused(Detections.empty(), np.zeros(0, np.int64))
        }
        self.uncached_detections: dict[bytes, Arrays] = {}
        renders = rules.renders
        images = Images(number=k)
        if isinstance(renders, MeasuredImages):
            images = Images(capture=partial(renders.captured, k), scene=renders.scene, number=k)
        self._view = View(
            renders.site,
            renders.sensors,
            measure=partial(renders.clouds, k),
            run=self._detect,
            codec=rules.codec,
            images=images,
        )

    def fused(self, members: tuple[int, ...]) -> Fused:
        """Fused detections of a set (ascending indices of candidates), made once and kept.

        Raises `_Unknown` within a round of `fuse_together` if a detection is missing."""
        if members not in self._fused:
            self._fused[members] = self._rules.scheme.fuse(self._view, members)
        return self._fused[members]

    def fuse_together(self, sets: Sequence[tuple[int, ...]]) -> None:
        """Fuse sets with shared batches of detections, if the detector is a `UnionDetector`.

        Such a detector detects in several unions of clouds in one call. In each round every set
        advances until it needs an unknown detection; these are then made together. When a round
        asks for fewer than two, the remaining sets are left to `fused`.

        sets: Sets as ascending indices of candidates."""
        detector = self._rules.detector
        waiting_sets = [members for members in sets if members]
        while isinstance(detector, UnionDetector) and len(waiting_sets) > 1:
            # `_try_fuse` calls `_detect`. While `_requests` is a dictionary, not None, `_detect`
            # notes there which clouds an unknown detection needs, by the detection's key in the
            # cache, and detects nothing.
            requests = self._requests = {}
            waiting_sets = [members for members in waiting_sets if not self._try_fuse(members)]
            self._requests = None
            clouds = list(
                dict.fromkeys(cloud for request in requests.values() for cloud in request)
            )
            if len(requests) < 2 or not clouds:
                return
            unions = np.zeros((len(requests), len(clouds)), np.bool_)  # clouds of each request
            for row, request in zip(unions, requests.values(), strict=True):
                row[:] = [cloud in request for cloud in clouds]
            points = [cloud.points for cloud in clouds]
            results = detect_unions_on_ground(detector, points, unions, self._site)
            for key, detections in zip(requests, results, strict=True):
                self._keep(key, detections)

    def _try_fuse(self, members: tuple[int, ...]) -> bool:
        """Fuse a set; return False if it waits for a detection, which is now in `_requests`."""
        try:
            self.fused(members)  # keeps its result
        except _Unknown:
            return False
        return True

    def _detect(self, clouds: Sequence[Cloud]) -> Detections:
        """Detections in the points of some clouds together: known, from the cache or made now.

        Raises `_Unknown` in a round of `fuse_together` if they are unknown, after noting them."""
        rules = self._rules
        filled_clouds = [cloud for cloud in clouds if len(cloud.points)]
        sensors = [cloud.sensor for cloud in filled_clouds]
        histories = [cloud.history for cloud in filled_clouds]
        key = rules.key(self._k, "detections", sensors, histories)
        if key not in self._detected:
            (cached_arrays,) = rules.memo.get([key])
            if cached_arrays is not None:
                self._detected[key] = Detections(*cached_arrays)
            elif self._requests is not None:
                self._requests[key] = filled_clouds
                raise _Unknown
            else:
                points = together(filled_clouds)
                self._keep(key, detect_on_ground(rules.detector, points, self._site))
        return self._detected[key]

    def _keep(self, key: bytes, detections: Detections) -> None:
        """Keep detections for this frame, and for the cache, which the caller writes."""
        self._detected[key] = detections
        columns = [detections.boxes, detections.scores, detections.labels]
        if detections.doubts is not None:
            columns.append(detections.doubts)
        self.uncached_detections[key] = tuple(columns)


class _Unknown(Exception):
    """Signal within `_FrameDetections` that a needed detection is left for the next batch."""


def _compute_figures(outcomes: Sequence[Outcome], to_find: int) -> Float64[np.ndarray, "ious 3"]:
    """Figures of one set over all frames: columns are AP, recall, kbit; rows IoU thresholds.

    Detections of all frames are ranked together, by score, and ignored ones are left out.

    Args:
        outcomes: Outcome of the set in each frame, of one class.
        to_find: Number of objects of this class in these frames; if 0, AP and recall are NaN."""
    scores = np.concatenate([outcome.scores for outcome in outcomes])
    truth = np.concatenate([outcome.truth for outcome in outcomes], axis=1)  # [IoU, detection]
    kbit = float(np.mean([outcome.bits.sum() for outcome in outcomes])) / 1000
    figures = []
    for hit_objects in truth:
        is_scored = hit_objects != IGNORED
        is_hit = hit_objects >= 0
        ap = recall = np.nan
        if to_find:
            curve = precision_recall(scores[is_scored], is_hit[is_scored], to_find)
            ap = average_precision(curve)
            recall = int(is_hit.sum()) / to_find
        figures.append((ap, recall, kbit))
    return np.array(figures)


def _list_frames(available: int, frames: int | Sequence[int] | None) -> list[int]:
    """Indices of the frames to score.

    Args:
        available: Number of all frames.
        frames: Number of frames from the first on, or their indices; None for all.

    Raises ValueError if there are no frames."""
    if isinstance(frames, float):
        raise ValueError(f"frames must be a whole number or a list of them, got {frames}")
    if frames is None or isinstance(frames, int):
        indices: Sequence[int] = range(available)[:frames]
    else:
        indices = frames
    if not len(indices) or (isinstance(frames, int) and frames < 1):
        raise ValueError(f"there must be a frame to score, got {frames} of {available}")
    return [int(k) for k in indices]
