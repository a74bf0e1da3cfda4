"""Detections of the paper's experiments, and their AP.

Two kinds of value are kept on disk for each frame:

    truth    scored vehicles, and the points of each sensor on each of them
    run      detections of one sensor set in one scheme: boxes and scores after fusion, their hits
             at each IoU of `IOUS` by the exact and by the published protocol, the IoU of each
             scored vehicle with the detection that fits it best, bits sent and milliseconds

All experiments are computed from these without a detector. The values of a frame are stored
together, so an interrupted run resumes with the frame it was at, and a run with more frames or sets
computes only those."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple, cast

import numpy as np

from coview.studies.paper.comparison import Compared, RowEvidence, explain_difference
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
    """Name of a scheme, and its sensors as ascending numbers."""

    scheme: str
    sensors: tuple[int, ...]


class FrameTruth(NamedTuple):
    """Scored vehicles of one frame.

    boxes: of the vehicles; points: of each sensor on each vehicle; sent: per sensor the points in
    the crop, those beyond the hybrid radius in the horizontal plane, and those beyond it as the
    published code measures (`toolkit.points.is_beyond`)."""

    boxes: Float64[np.ndarray, "m 7"]
    points: Int64[np.ndarray, "m sensors"]
    sent: Int64[np.ndarray, "3 sensors"]


class FrameRun(NamedTuple):
    """Detections of one run in one frame.

    boxes, scores: of the detections; truth: at each of `IOUS` the scored vehicle that each hit, or
    FALSE_ALARM or IGNORED; published: the same by the protocol `published`, where 0 is a hit; best:
    IoU of each scored vehicle with the detection that overlaps it most; bits: sent by each sensor;
    ms: from measurement to fused boxes."""

    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    truth: Int64[np.ndarray, "ious n"]
    published: Int64[np.ndarray, "ious n"]
    best: Float64[np.ndarray, " m"]
    bits: Int64[np.ndarray, " sensors"]
    ms: Float64[np.ndarray, " 1"]


@dataclass(frozen=True, eq=False)
class StoredDetections:
    """Everything that the experiments are computed from."""

    site: Site
    sensors: tuple[Sensor, ...]
    truths: tuple[FrameTruth, ...]
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
        """Points on each vehicle in a set's fused cloud."""
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

    Runs in the memo are taken from it. stage: name of this work for the progress callback, which is
    not called if all frames are kept. Raises ValueError for a detector without `digest`, or if
    fewer frames were recorded."""
    digest = getattr(detector, "digest", None)
    if digest is None:
        raise ValueError(
            f"detections are kept by the detector's digest, {type(detector).__name__} has none: "
            "add one"
        )
    if not 1 <= frames <= renders.frames:
        raise ValueError(f"frames must be from 1 to the {renders.frames} recorded, got {frames}")
    runs = tuple(dict.fromkeys(runs))
    depends_on = make_key(
        renders.digest, digest, code_digest(__name__, type(detector).__module__)
    ).hex()
    wanted = [(k, run) for k in range(frames) for run in (None, *runs)]  # None: the truth
    keys = {each: make_key("paper", depends_on, *each) for each in wanted}
    kept = dict(zip(keys, memo.get(list(keys.values())), strict=True))
    missing = [tuple(run for run in runs if kept[k, run] is None) for k in range(frames)]
    tasks = [(k, some) for k, some in enumerate(missing) if some or kept[k, None] is None]
    job = _FrameJob(renders, detector, alone=processes.alone)
    results = processes.map(job, tasks, progress=processes.stage(stage, len(tasks)))
    for (k, some), (truth, found) in zip(tasks, results, strict=True):
        new: dict[tuple[int, SchemeRun | None], Arrays] = {(k, None): truth}
        new |= {(k, run): values for run, values in zip(some, found, strict=True)}
        memo.put({keys[each]: values for each, values in new.items()})
        kept |= new
    whole = cast("dict[tuple[int, SchemeRun | None], Arrays]", kept)
    truths = tuple(FrameTruth(*whole[k, None]) for k in range(frames))
    by_run = {run: tuple(FrameRun(*whole[k, run]) for k in range(frames)) for run in runs}
    return StoredDetections(
        renders.site, tuple(renders.sensors), truths, by_run, digest, renders.digest
    )


@dataclass(frozen=True)
class _FrameJob:
    """Truth of one frame, and the runs missing there."""

    renders: Measured
    detector: Detector
    alone: bool

    def __call__(self, task: tuple[int, tuple[SchemeRun, ...]]) -> tuple[Arrays, list[Arrays]]:
        if not self.alone and "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)  # each core has a process already
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
        for cloud, sensor in zip(clouds, renders.sensors, strict=True):
            radius = renders.site.hybrid_radius
            far = [
                is_beyond(cloud, sensor, radius, metric).sum()
                for metric in ("horizontal", "published")
            ]
            sent.append([len(cloud), *far])
        truth = FrameTruth(
            boxes, np.stack(points, axis=1).astype(np.int64), np.transpose(sent).astype(np.int64)
        )
        return truth, [self._run(run, view, objects, counted) for run in runs]

    def _run(self, run: SchemeRun, view: View, objects: Objects, counted: Mask) -> Arrays:
        fused: Fused = find_scheme(run.scheme).fuse(view, run.sensors)
        found = fused.detections
        # among the scored; index -1 stands for no truth
        place = np.append(np.cumsum(counted) - 1, FALSE_ALARM)
        there = objects[has_centre_inside(objects.boxes, self.renders.site.area)]
        exact = matches(found, objects, IOUS, counted=counted)
        theirs = matches(found, there, IOUS, protocol="published")
        truth = np.array([np.where(at.ignored, IGNORED, place[at.truth]) for at in exact])
        published = [
            np.select([at.ignored, at.truth >= 0], [IGNORED, 0], FALSE_ALARM) for at in theirs
        ]
        best = iou_3d(found.boxes, objects.boxes[counted]).max(axis=0, initial=0.0)
        return FrameRun(
            found.boxes,
            found.scores,
            truth,
            np.array(published),
            best,
            fused.bits,
            np.array([fused.ms]),
        )


class ApScore(NamedTuple):
    """AP of a run at one IoU, with its interval and companions. NaN where a figure is undefined.

    recall: of all detections; vehicles: to find; hit_iou: mean IoU, over all frames, of the
    vehicles that were hit with the detection that overlaps them most; tally: of the detections that
    are not ignored."""

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
    """Select boxes whose centre every sensor has in its field of view, occluded or not, as in the
    paper's table 3."""
    views = [s.model.in_view(transform(invert(s.pose), boxes[:, :3])) for s in sensors]
    return np.logical_and.reduce([np.ones(len(boxes), bool), *views])


def score_run(
    stored: StoredDetections, run: SchemeRun, iou: float = 0.7, region: tuple[int, ...] = ()
) -> ApScore:
    """Compute the AP of a run by the exact protocol. See `toolkit.detection.metrics.evaluate`.

    region: in view of all these sensors, () for the whole area. Vehicles there are to be found, a
    hit counts if it hits one of them, and a false alarm if its centre lies there."""
    row = IOUS.index(iou)
    sensors = [stored.sensors[c] for c in region]
    scores = []
    hits = []
    to_find = []
    ious = [np.zeros(0)]
    for truth, found in zip(stored.truths, stored.runs[run], strict=True):
        hit_of = found.truth[row]
        there = in_view_of_all(sensors, truth.boxes)
        hit = hit_of >= 0
        of_truth = np.append(there, False)[np.where(hit, hit_of, -1)]
        own = in_view_of_all(sensors, found.boxes)
        in_region = np.where(hit, of_truth, own)
        counts = in_region & (hit_of != IGNORED)
        scores.append(found.scores[counts])
        hits.append(hit[counts])
        to_find.append(int(there.sum()))
        ious.append(found.best[hit_of[counts & hit]])
    tally = Tally.of_frames(scores, hits, to_find)
    all_ious = np.concatenate(ious)
    hit_iou = float(all_ious.mean()) if len(all_ious) else float("nan")
    return ApScore(tally.ap, tally.interval(), tally.recall, sum(to_find), hit_iou, tally)


def compute_published_ap(stored: StoredDetections, run: SchemeRun, iou: float = 0.7) -> float:
    """Compute the AP of a run by protocol `published`. See `toolkit.detection.metrics`. NaN without
    vehicles."""
    frames = [
        f for truth, f in zip(stored.truths, stored.runs[run], strict=True) if len(truth.boxes)
    ]
    if not frames:
        return float("nan")
    scores = np.concatenate([f.scores for f in frames])
    outcome = np.concatenate([f.published[IOUS.index(iou)] for f in frames])
    counts = outcome != IGNORED
    return average_precision(
        precision_recall(scores[counts], outcome[counts] >= 0, stored.vehicles)
    )


def compare_run(
    stored: StoredDetections,
    run: SchemeRun,
    labels: tuple[str, ...],
    paper: float,
    *,
    iou: float = 0.7,
    region: tuple[int, ...] = (),
) -> Compared:
    """Compare the AP of a run with the paper's. labels: of the row; {} in the first stands for the
    vehicles to find."""
    ours = score_run(stored, run, iou, region)
    published = float("nan") if region else compute_published_ap(stored, run, iou)
    evidence = RowEvidence(
        visible_share(stored, run.sensors, region), ours.recall, ours.hit_iou, published
    )
    reason = explain_difference(ours.ap, paper, evidence, iou=iou)
    labels = (labels[0].format(ours.vehicles), *labels[1:])
    return Compared(labels, "AP", ours.ap, paper, ours.interval, reason=reason)


def kbit_per_sensor(stored: StoredDetections, run: SchemeRun) -> float:
    """Mean kbit that a sensor sends per frame."""
    return float(np.mean([f.bits.mean() for f in stored.runs[run]])) / 1000


def ms_per_frame(stored: StoredDetections, run: SchemeRun) -> float:
    """Median time from measurement to fused boxes, sensors in parallel."""
    return float(np.median([f.ms[0] for f in stored.runs[run]]))


def visible_share(
    stored: StoredDetections, sensors: tuple[int, ...], region: tuple[int, ...] = ()
) -> float:
    """Share of vehicles on which a set has a point, of those of a region if given. NaN without
    vehicles."""
    boxes = np.concatenate([np.zeros((0, 7)), *(truth.boxes for truth in stored.truths)])
    points = stored.points(sensors)[in_view_of_all([stored.sensors[c] for c in region], boxes)]
    return float((points > 0).mean()) if len(points) else float("nan")
