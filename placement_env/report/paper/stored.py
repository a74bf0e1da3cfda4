"""What every scheme and sensor set of the paper's experiments detects, frame by frame, kept on disk as it comes.

Two kinds of value are kept, of one frame each:

    truth    what is there, which of it is scored, and the points of each sensor on each scored vehicle
    run      what one sensor set detects in one scheme: boxes and scores after fusion, what they hit at each IoU of
             `IOUS` by the exact and by the published protocol, the IoU of each scored vehicle with the detection that
             fits it best, bits sent and milliseconds

All experiments are computed from these without a detector. A frame's values are kept together, so a run that was killed
goes on with the frame it was at; one that asks for more frames or sets computes these alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, IOUS
from placement_env.fidelity.frame_detections import Measured
from placement_env.fidelity.traffic import scored
from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.boxes import iou_3d
from toolkit.detection.metrics import match
from toolkit.detection.scheme import Fused
from toolkit.detection.schemes import scheme_of
from toolkit.detection.view import View, together
from toolkit.objects import Detections, Detector, Objects
from toolkit.points import beyond, centred_in, detect_on_ground, points_on
from toolkit.runtime.cache import Arrays, Cache, key_of
from toolkit.runtime.code_digest import code_digest
from toolkit.runtime.parallel import spread
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site


class SchemeRun(NamedTuple):
    """A scheme, by its name, and the sensors (ascending numbers) that take part."""

    scheme: str
    sensors: tuple[int, ...]


class FrameTruth(NamedTuple):
    """One frame: boxes of the scored vehicles, points of each sensor on each of them, and of each sensor the points in
    the crop, those beyond the hybrid radius in the horizontal plane, and those beyond it as the published code measures
    (`toolkit.points.beyond`)."""

    boxes: Float64[np.ndarray, "m 7"]
    points: Int64[np.ndarray, "m sensors"]
    sent: Int64[np.ndarray, "3 sensors"]


class FrameRun(NamedTuple):
    """What one run detected in one frame.

    boxes, scores: of the detections; truth: at each of `IOUS`, which scored vehicle each hit, or FALSE_ALARM or
    IGNORED; published: the same by the protocol `published`, of which 0 is a hit; best: IoU of each scored vehicle with
    the detection that overlaps it most; bits: sent by each sensor; ms: from measurement to fused boxes.
    """

    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    truth: Int64[np.ndarray, "ious n"]
    published: Int64[np.ndarray, "ious n"]
    best: Float64[np.ndarray, " m"]
    bits: Int64[np.ndarray, " sensors"]
    ms: Float64[np.ndarray, " 1"]


@dataclass(frozen=True, eq=False)
class StoredDetections:
    """All that the experiments are computed from."""

    site: Site
    sensors: tuple[Sensor, ...]
    truths: tuple[FrameTruth, ...]
    runs: dict[SchemeRun, tuple[FrameRun, ...]]
    detector: str
    recording: str

    @property
    def frames(self) -> int:
        """How many."""
        return len(self.truths)

    @cached_property
    def to_find(self) -> tuple[int, ...]:
        """Scored vehicles of each frame."""
        return tuple(len(truth.boxes) for truth in self.truths)

    @property
    def vehicles(self) -> int:
        """Scored vehicles of all frames."""
        return sum(self.to_find)

    def points(self, sensors: tuple[int, ...]) -> Int64[np.ndarray, " vehicles"]:
        """Point density of each vehicle in the fused cloud of a sensor set, frame after frame."""
        counts = [truth.points[:, list(sensors)].sum(axis=1) for truth in self.truths]
        return np.concatenate([np.zeros(0, np.int64), *counts])


def detect_runs(
    renders: Measured,
    detector: Detector,
    runs: Sequence[SchemeRun],
    *,
    memo: Cache,
    frames: int,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> StoredDetections:
    """What each run detects in the first `frames` frames: from the memo, or else detected and kept there.

    progress: called with the frames done and to be done; never where all is kept. Raises ValueError for a detector
    without `digest`, or fewer frames recorded than asked for.
    """
    says = getattr(detector, "digest", None)
    if says is None:
        raise ValueError(f"{type(detector).__name__} needs a property digest: what it detects is kept under it")
    if not 1 <= frames <= renders.frames:
        raise ValueError(f"frames must be from 1 to the {renders.frames} recorded, got {frames}")
    runs = tuple(dict.fromkeys(runs))
    wanted: tuple[SchemeRun | None, ...] = (None, *runs)  # None: the truth
    depends_on = key_of(renders.digest, says, code_digest(__name__, type(detector).__module__)).hex()
    keys = {(k, run): key_of("paper", depends_on, k, run) for k in range(frames) for run in wanted}
    kept = dict(zip(keys, memo.get(list(keys.values())), strict=True))
    tasks = []
    for k in range(frames):
        missing = tuple(run for run in runs if kept[k, run] is None)
        if missing or kept[k, None] is None:
            tasks.append((k, missing))
    report = None if progress is None else partial(_report, progress, len(tasks))
    job = _Detecting(renders, detector, alone=workers == 1)
    for (k, missing), (truth, found) in zip(tasks, spread(job, tasks, workers=workers, progress=report), strict=True):
        new: dict[tuple[int, SchemeRun | None], Arrays] = {(k, None): truth}
        new |= {(k, run): values for run, values in zip(missing, found, strict=True)}
        memo.put({keys[each]: values for each, values in new.items()})
        kept |= new
    whole: dict[tuple[int, SchemeRun | None], Any] = kept
    return StoredDetections(
        renders.site,
        tuple(renders.sensors),
        tuple(FrameTruth(*whole[k, None]) for k in range(frames)),
        {run: tuple(FrameRun(*whole[k, run]) for k in range(frames)) for run in runs},
        says,
        renders.digest,
    )


@dataclass(frozen=True)
class _Detecting:
    """The job of one frame: its truth, and what the runs that are missing detect there."""

    renders: Measured
    detector: Detector
    alone: bool

    def __call__(self, task: tuple[int, tuple[SchemeRun, ...]]) -> tuple[Arrays, list[Arrays]]:
        if not self.alone and "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)  # a process is given to each core already
        k, runs = task
        renders = self.renders
        objects = renders.objects(k)  # reads the frame, so that this is in no run's time
        counted = scored(objects, renders.site)
        view = View(
            renders.site,
            renders.sensors,
            measure=partial(renders.clouds, k),
            run=lambda clouds: detect_on_ground(self.detector, together(clouds), renders.site),
        )
        boxes = objects.boxes[counted]
        clouds = [view.cloud(c).points for c in range(len(renders.sensors))]
        points = [points_on(cloud, boxes, renders.site) for cloud in clouds]
        sent = [self._sent(cloud, sensor) for cloud, sensor in zip(clouds, renders.sensors, strict=True)]
        truth = FrameTruth(boxes, np.stack(points, axis=1).astype(np.int64), np.transpose(sent).astype(np.int64))
        return truth, [self._run(run, view, objects, counted) for run in runs]

    def _sent(self, cloud: Float32[np.ndarray, "n 3"], sensor: Sensor) -> list[int]:
        radius = self.renders.site.hybrid_radius
        far = [int(beyond(cloud, sensor, radius, metric).sum()) for metric in ("horizontal", "published")]
        return [len(cloud), *far]

    def _run(self, run: SchemeRun, view: View, objects: Objects, counted: Bool[np.ndarray, " n"]) -> Arrays:
        fused: Fused = scheme_of(run.scheme).fuse(view, run.sensors)
        found = fused.detections
        place = np.append(np.cumsum(counted) - 1, FALSE_ALARM)  # among the scored; the last one is that of no truth
        there = objects[centred_in(objects.boxes, self.renders.site.area)]
        truth = np.empty((len(IOUS), len(found)), np.int64)
        published = np.empty_like(truth)
        for row, iou in enumerate(IOUS):
            exact = match(found, objects, iou, counted=counted)
            truth[row] = np.where(exact.ignored, IGNORED, place[exact.truth])
            theirs = match(found, there, iou, protocol="published")
            published[row] = np.where(theirs.ignored, IGNORED, np.where(theirs.truth >= 0, 0, FALSE_ALARM))
        return FrameRun(
            found.boxes, found.scores, truth, published, _best(found, objects.boxes[counted]),
            fused.bits, np.array([fused.ms]),
        )  # fmt: skip


def _best(found: Detections, boxes: Float64[np.ndarray, "m 7"]) -> Float64[np.ndarray, " m"]:
    return iou_3d(found.boxes, boxes).max(axis=0, initial=0.0)


def _report(progress: Callable[[int, int], None], total: int, done: int) -> None:
    progress(done, total)
