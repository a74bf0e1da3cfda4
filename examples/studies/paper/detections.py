"""Detections of the paper's experiments, and their AP.

Two kinds of value are kept on disk for each frame:

    truth    scored vehicles, and the points of each sensor on each of them
    run      detections of one sensor set in one scheme: boxes and scores after fusion, their hits
             at each IoU of `IOUS` by the exact and by the published protocol, the IoU of each
             scored vehicle with the detection that fits it best, bits sent and milliseconds

All experiments are computed from these values without a detector. The values of a frame are stored
together: an interrupted run resumes at its last frame, and a run with more frames or sets computes
only what is new."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, cast

import numpy as np

from examples.studies.paper.comparison import Compared, RowEvidence, explain_difference
from placement_env.analysis.intervals import Interval, Tally
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, IOUS, Measured
from placement_env.fidelity.traffic import scored
from toolkit.arrays import Float64, Int64, Mask
from toolkit.boxes import iou_3d
from toolkit.detection.metrics import Curve, average_precision, matches, precision_recall
from toolkit.detection.scheme import Fused
from toolkit.detection.schemes import find_scheme
from toolkit.detection.view import View, together
from toolkit.geometry import invert, transform
from toolkit.objects import Detector, Objects
from toolkit.points import count_on_ground, detect_on_ground, has_centre_inside, is_beyond
from toolkit.runtime.cache import Arrays, Cache, code_digest, make_key
from toolkit.runtime.run import Processes
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site


class SchemeRun(NamedTuple):
    """Fusion of one sensor set by one scheme.

    Attributes:
        scheme: Name of the scheme.
        sensors: Indices of the sensors, ascending.
    """

    scheme: str
    sensors: tuple[int, ...]


class StoredTruth(NamedTuple):
    """Scored vehicles of one frame.

    Attributes:
        boxes: Boxes of the m vehicles.
        points: Number of each sensor's points on each vehicle.
        sent: Number of each sensor's points, in rows: in the crop, beyond the hybrid radius in the
            horizontal plane, and beyond it as the published code measures
            (`toolkit.points.is_beyond`).
    """

    boxes: Float64[np.ndarray, "m 7"]
    points: Int64[np.ndarray, "m sensors"]
    sent: Int64[np.ndarray, "3 sensors"]


class FrameRun(NamedTuple):
    """Detections of one run in one frame.

    Attributes:
        boxes: Boxes of the detections.
        scores: Scores of the detections.
        truth: Index of the scored vehicle that each detection hits at each of `IOUS`, or
            FALSE_ALARM or IGNORED.
        published: Outcome by the protocol `published`: 0 for a hit, or FALSE_ALARM or IGNORED.
        best: IoU of each scored vehicle with the detection that overlaps it most.
        bits: Bits that each sensor sends.
        ms: Milliseconds from measurement to fused boxes."""

    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    truth: Int64[np.ndarray, "ious n"]
    published: Int64[np.ndarray, "ious n"]
    best: Float64[np.ndarray, " m"]
    bits: Int64[np.ndarray, " sensors"]
    ms: Float64[np.ndarray, " 1"]


@dataclass(frozen=True, eq=False)
class StoredDetections:
    """Everything that the experiments are computed from.

    Attributes:
        site: The site.
        sensors: The sensors.
        truths: Scored vehicles of each frame, in order.
        runs: Detections of each frame, in order, by run.
        detector: Digest of the detector.
        recording: Digest of the recording."""

    site: Site
    sensors: tuple[Sensor, ...]
    truths: tuple[StoredTruth, ...]
    runs: dict[SchemeRun, tuple[FrameRun, ...]]
    detector: str
    recording: str

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.truths)

    @cached_property
    def to_find(self) -> tuple[int, ...]:
        """Number of scored vehicles in each frame."""
        return tuple(len(truth.boxes) for truth in self.truths)

    @property
    def vehicles(self) -> int:
        """Number of scored vehicles in all frames."""
        return sum(self.to_find)

    def points(self, sensors: tuple[int, ...]) -> Int64[np.ndarray, " vehicles"]:
        """Count the points on each vehicle in a set's fused cloud, frame after frame.

        sensors: indices of the set's sensors."""
        counts = [truth.points[:, list(sensors)].sum(axis=1) for truth in self.truths]
        return np.concatenate([np.zeros(0, np.int64), *counts])


def detect_runs(
    renders: Measured,
    detector: Detector,
    runs: Sequence[SchemeRun],
    *,
    memo: Cache,
    frames: int,
    processes: Processes = Processes(),
    stage: str = "frames detected",
) -> StoredDetections:
    """Detect each run in the first `frames` frames.

    Runs in the memo are not detected again; new ones are added to it frame by frame. renders:
    recording; runs: sets and schemes, may be empty for the truth only; stage: name of this work for
    the progress callback, which is not called if the memo has all frames. Raises ValueError for a
    detector without `digest`, or if fewer frames were recorded."""
    digest = getattr(detector, "digest", None)
    if digest is None:
        raise ValueError(
            f"detections are kept by the detector's digest, {type(detector).__name__} has none: "
            "add one"
        )
    if not 1 <= frames <= renders.frames:
        raise ValueError(f"frames must be from 1 to the {renders.frames} recorded, got {frames}")
    runs = tuple(dict.fromkeys(runs))
    code = code_digest(__name__, type(detector).__module__)
    depends_on = make_key(renders.digest, digest, code).hex()
    needed = [(k, run) for k in range(frames) for run in (None, *runs)]  # None: the truth
    keys = {frame_run: make_key("paper", depends_on, *frame_run) for frame_run in needed}
    stored = dict(zip(keys, memo.get(list(keys.values())), strict=True))
    tasks = []  # frames with missing values, and their missing runs
    for k in range(frames):
        missing_runs = tuple(run for run in runs if stored[k, run] is None)
        if missing_runs or stored[k, None] is None:
            tasks.append((k, missing_runs))
    job = _FrameJob(renders, detector)
    results = processes.map(job, tasks, progress=processes.stage(stage, len(tasks)))
    for (k, missing_runs), (truth, run_arrays) in zip(tasks, results, strict=True):
        frame_arrays: dict[tuple[int, SchemeRun | None], Arrays] = {(k, None): truth}
        for run, values in zip(missing_runs, run_arrays, strict=True):
            frame_arrays[k, run] = values
        memo.put({keys[frame_run]: values for frame_run, values in frame_arrays.items()})
        stored |= frame_arrays
    arrays = cast("dict[tuple[int, SchemeRun | None], Arrays]", stored)
    truths = tuple(StoredTruth(*arrays[k, None]) for k in range(frames))
    by_run = {}
    for run in runs:
        by_run[run] = tuple(FrameRun(*arrays[k, run]) for k in range(frames))
    return StoredDetections(
        renders.site, tuple(renders.sensors), truths, by_run, digest, renders.digest
    )


@dataclass(frozen=True)
class _FrameJob:
    """Work on one frame: its truth and its missing runs.

    It is called with the number of a frame and the runs to detect, and returns the fields of
    `StoredTruth`, and of `FrameRun` for each run."""

    renders: Measured
    detector: Detector

    def __call__(self, task: tuple[int, tuple[SchemeRun, ...]]) -> tuple[Arrays, list[Arrays]]:
        k, runs = task
        renders = self.renders
        objects = renders.objects(k)  # read the frame now, so that a run's time leaves it out
        counted = scored(objects, renders.site)
        view = View(
            renders.site,
            renders.sensors,
            measure=partial(renders.clouds, k),
            run=lambda clouds: detect_on_ground(self.detector, together(clouds), renders.site),
        )
        boxes = objects.boxes[counted]
        clouds = [view.cloud(c).points for c in range(len(renders.sensors))]
        points = [count_on_ground(cloud, boxes, renders.site) for cloud in clouds]
        sent = []
        radius = renders.site.hybrid_radius
        for cloud, sensor in zip(clouds, renders.sensors, strict=True):
            far = is_beyond(cloud, sensor, radius, "horizontal").sum()
            far_published = is_beyond(cloud, sensor, radius, "published").sum()
            sent.append([len(cloud), far, far_published])
        truth = StoredTruth(
            boxes, np.stack(points, axis=1).astype(np.int64), np.transpose(sent).astype(np.int64)
        )
        return truth, [self._run(run, view, objects, counted) for run in runs]

    def _run(self, run: SchemeRun, view: View, objects: Objects, counted: Mask) -> Arrays:
        # detections of one run in one frame; counted: mask of the objects that are scored
        fused: Fused = find_scheme(run.scheme).fuse(view, run.sensors)
        detections = fused.detections
        # index among the scored vehicles; the last entry is for index -1, no truth
        scored_index = np.append(np.cumsum(counted) - 1, FALSE_ALARM)
        truth = [
            np.where(at_iou.ignored, IGNORED, scored_index[at_iou.truth])
            for at_iou in matches(detections, objects, IOUS, counted=counted)
        ]
        in_area = objects[has_centre_inside(objects.boxes, self.renders.site.area)]
        published = [
            np.select([at_iou.ignored, at_iou.truth >= 0], [IGNORED, 0], FALSE_ALARM)
            for at_iou in matches(detections, in_area, IOUS, protocol="published")
        ]
        return FrameRun(
            boxes=detections.boxes,
            scores=detections.scores,
            truth=np.array(truth),
            published=np.array(published),
            best=iou_3d(detections.boxes, objects.boxes[counted]).max(axis=0, initial=0.0),
            bits=fused.bits,
            ms=np.array([fused.ms]),
        )


class ApScore(NamedTuple):
    """AP of a run at one IoU, with its interval and related figures, NaN if undefined.

    Attributes:
        ap: Average precision.
        interval: Interval of the AP.
        recall: Share of the vehicles that are hit at this IoU.
        vehicles: Number of vehicles to find in all frames.
        hit_iou: Mean IoU of the vehicles that are hit with the detection that overlaps them most.
        tally: Tally of the detections that are not ignored."""

    ap: float
    interval: Interval
    recall: float
    vehicles: int
    hit_iou: float
    tally: Tally

    @property
    def curve(self) -> Curve:
        """Precision over recall."""
        return precision_recall(self.tally.scores, self.tally.hit, self.vehicles)


def in_view_of_all(sensors: list[Sensor], boxes: Float64[np.ndarray, "n 7"]) -> Mask:
    """Mask of boxes with their centre in every sensor's field of view, as in the paper's table 3.

    The centre may be occluded. Without sensors all boxes are selected."""
    is_in_view = np.ones(len(boxes), bool)
    for sensor in sensors:
        is_in_view &= sensor.model.in_view(transform(invert(sensor.pose), boxes[:, :3]))
    return is_in_view


def score_run(
    stored: StoredDetections, run: SchemeRun, iou: float = 0.7, region: tuple[int, ...] = ()
) -> ApScore:
    """Compute the AP of a run by the exact protocol. See `toolkit.detection.metrics.evaluate`.

    iou: one of `IOUS`; region: indices of sensors that must all have a place in view, () for the
    whole area. Only vehicles in the region are to be found; a hit counts if it hits one of them, a
    false alarm if its centre is in the region."""
    row = IOUS.index(iou)
    sensors = [stored.sensors[c] for c in region]
    scores = []
    hits = []
    to_find = []
    ious = [np.zeros(0)]
    for truth, frame_run in zip(stored.truths, stored.runs[run], strict=True):
        hit_truth = frame_run.truth[row]
        is_hit = hit_truth >= 0
        truth_in_region = in_view_of_all(sensors, truth.boxes)
        # index -1, for no hit, reads the appended False
        hits_region = np.append(truth_in_region, False)[np.where(is_hit, hit_truth, -1)]
        centre_in_region = in_view_of_all(sensors, frame_run.boxes)
        is_in_region = np.where(is_hit, hits_region, centre_in_region)
        counts = is_in_region & (hit_truth != IGNORED)
        scores.append(frame_run.scores[counts])
        hits.append(is_hit[counts])
        to_find.append(int(truth_in_region.sum()))
        ious.append(frame_run.best[hit_truth[counts & is_hit]])
    tally = Tally.of_frames(scores, hits, to_find)
    all_ious = np.concatenate(ious)
    hit_iou = float(all_ious.mean()) if len(all_ious) else float("nan")
    return ApScore(tally.ap, tally.interval(), tally.recall, sum(to_find), hit_iou, tally)


def compute_published_ap(stored: StoredDetections, run: SchemeRun, iou: float = 0.7) -> float:
    """Compute the AP of a run by protocol `published`, NaN without vehicles.

    Frames without vehicles do not count. iou: one of `IOUS`. See `toolkit.detection.metrics`."""
    row = IOUS.index(iou)
    frames = [
        frame_run
        for truth, frame_run in zip(stored.truths, stored.runs[run], strict=True)
        if len(truth.boxes)
    ]
    if not frames:
        return float("nan")
    scores = np.concatenate([frame_run.scores for frame_run in frames])
    outcome = np.concatenate([frame_run.published[row] for frame_run in frames])
    counts = outcome != IGNORED
    curve = precision_recall(scores[counts], outcome[counts] >= 0, stored.vehicles)
    return average_precision(curve)


def compare_run(
    stored: StoredDetections,
    run: SchemeRun,
    labels: tuple[str, ...],
    paper: float,
    *,
    iou: float = 0.7,
    region: tuple[int, ...] = (),
) -> Compared:
    """Compare the AP of a run with the paper's.

    labels: labels of the row; {} in the first becomes the number of vehicles to find; paper: the
    paper's AP; iou: one of `IOUS`; region: indices of sensors that must all have a vehicle in view,
    () for the whole area."""
    ours = score_run(stored, run, iou, region)
    published = float("nan") if region else compute_published_ap(stored, run, iou)
    visible = visible_share(stored, run.sensors, region)
    evidence = RowEvidence(visible, ours.recall, ours.hit_iou, published)
    reason = explain_difference(ours.ap, paper, evidence, iou=iou)
    labels = (labels[0].format(ours.vehicles), *labels[1:])
    return Compared(labels, "AP", ours.ap, paper, ours.interval, reason=reason)


def kbit_per_sensor(stored: StoredDetections, run: SchemeRun) -> float:
    """Return the data (kbit) that a sensor of a run sends per frame, on average."""
    return float(np.mean([frame_run.bits.mean() for frame_run in stored.runs[run]])) / 1000


def ms_per_frame(stored: StoredDetections, run: SchemeRun) -> float:
    """Return the median time (ms) from measurement to fused boxes, with sensors in parallel."""
    return float(np.median([frame_run.ms[0] for frame_run in stored.runs[run]]))


def visible_share(
    stored: StoredDetections, sensors: tuple[int, ...], region: tuple[int, ...] = ()
) -> float:
    """Return the share of vehicles on which a set has a point, NaN without vehicles.

    sensors: indices of the set's sensors; region: indices of sensors that must all have a vehicle
    in view, () for all vehicles."""
    boxes = np.concatenate([np.zeros((0, 7)), *(truth.boxes for truth in stored.truths)])
    is_in_region = in_view_of_all([stored.sensors[c] for c in region], boxes)
    points = stored.points(sensors)[is_in_region]
    return float((points > 0).mean()) if len(points) else float("nan")
