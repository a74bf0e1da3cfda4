"""Breakdown of the chosen set's results: AP by group, coverage by class, and moments for pictures.

Vehicles and false alarms belong to the group of their box's centre; a hit belongs to the group of the vehicle it hit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from placement_env.analysis.approaches import compass, find_approaches
from placement_env.analysis.intervals import Tally
from placement_env.cases import LEVEL_NAMES
from placement_env.classes import Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Detected
from placement_env.report.content import BreakdownRow, ClassSeen, Judgement, Moment
from placement_env.report.planning.judging import Judge, judge_tallies
from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.objects import LABELS, label_index
from toolkit.points import count_on_ground, has_centre_inside
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

RANGE_ENDS = (10.0, 20.0, 30.0, 40.0)  # m from the nearest sensor, where groups end
CENTRE = 0.25  # of the shorter side of the area: radius of the zone in its middle
MOMENTS = 8  # frames of pictures
MOMENT_POINTS = 2500  # of each sensor in such a frame, at most

GroupOf = Callable[[Float64[np.ndarray, "n 7"]], Int64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Scored:
    """Detections of one set, box by box.

    truths: scored objects of all frames, in order; points: of the set on each; boxes: of the detections; hits: the
    truth that each hit at each IoU threshold, or FALSE_ALARM or IGNORED; frames: their number; classes: that count.
    """

    truths: Float64[np.ndarray, "t 7"]
    truth_frame: Int64[np.ndarray, " t"]
    truth_label: Int64[np.ndarray, " t"]
    points: Int64[np.ndarray, " t"]
    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    label: Int64[np.ndarray, " n"]
    hits: Int64[np.ndarray, "ious n"]
    frames: int
    classes: Classes

    def tally(self, label: int, truths: Bool[np.ndarray, " t"], chosen: Bool[np.ndarray, " n"], at: int) -> Tally:
        """Tally some truths and detections of one class at one IoU threshold."""
        there, found = truths & (self.truth_label == label), chosen & (self.label == label)
        count = np.bincount(self.truth_frame[there], minlength=self.frames)
        return Tally(self.scores[found], self.hits[at, found] >= 0, self.frame[found], count)


def score_boxes(judge: Judge, chosen: tuple[int, ...]) -> Scored:
    """Collect detections of the chosen set in all frames of a judge."""
    detected, outcomes = judge.detected, judge.outcomes(chosen)
    objects = [detected.renders.objects(k)[detected.scored(k)] for k in range(judge.frames)]
    found = [detected.detections(chosen, k) for k in range(judge.frames)]
    frame = np.repeat(np.arange(judge.frames), [len(outcome.scores) for outcome in outcomes])
    first = np.cumsum([0, *map(len, objects)])[frame]
    truth = np.concatenate([each.truth for each in outcomes], axis=1)[[*map(detected.ious.index, judge.cases.ious)]]
    return Scored(
        truths=np.concatenate([each.boxes for each in objects]),
        truth_frame=np.repeat(np.arange(judge.frames), [len(each) for each in objects]),
        truth_label=np.concatenate([each.labels for each in objects]),
        points=_count_points(detected, chosen),
        boxes=np.concatenate([each.boxes for each in found]),
        scores=np.concatenate([outcome.scores for outcome in outcomes]),
        frame=frame,
        label=np.concatenate([each.labels for each in found]),
        hits=np.where(truth >= 0, first + truth, truth).astype(np.int64),
        frames=judge.frames,
        classes=detected.classes,
    )


def fuse_clouds(detected: Detected, chosen: Sequence[int], k: int) -> Float32[np.ndarray, "n 3"]:
    """Join the points of a set's sensors in frame k."""
    return np.concatenate([np.zeros((0, 3), np.float32), *(detected.renders.clouds(k, c) for c in chosen)])


def _count_points(detected: Detected, chosen: Sequence[int]) -> Int64[np.ndarray, " t"]:
    """Points of a set on each scored object, frame after frame."""
    counts = [np.zeros(0, np.int64)]
    for k in range(detected.frames):
        boxes = detected.renders.objects(k).boxes[detected.scored(k)]
        counts.append(count_on_ground(fuse_clouds(detected, chosen, k), boxes, detected.renders.site))
    return np.concatenate(counts)


def _row(name: str, judged: Judgement | None, points: Int64[np.ndarray, " t"]) -> BreakdownRow:
    return BreakdownRow(name, judged, float(points.mean()) if len(points) else None)


def by_group(scored: Scored, names: Sequence[str], group_of: GroupOf, seed: int) -> tuple[BreakdownRow, ...]:
    """Judge each group. group_of: index of the group of each box."""
    of_truth, groups = group_of(scored.truths), np.where(scored.hits == IGNORED, -1, group_of(scored.boxes))
    hit = scored.hits >= 0
    groups[hit] = of_truth[scored.hits[hit]]
    rows = []
    for number, name in enumerate(names):
        here = of_truth == number
        parts = [
            [scored.tally(label, here, group == number, at) for label in scored.classes.labels]
            for at, group in enumerate(groups)
        ]
        judged = judge_tallies(parts, scored.classes, seed) if here.any() else None
        rows.append(_row(name, judged, scored.points[here]))
    return tuple(rows)


def by_zone(scored: Scored, site: Site, seed: int) -> tuple[BreakdownRow, ...]:
    """Judge the middle and quarters of the area. The quarters around the middle are named by the compass."""
    xmin, ymin, xmax, ymax = site.area
    middle, radius = np.array([xmin + xmax, ymin + ymax]) / 2, CENTRE * min(xmax - xmin, ymax - ymin)
    quarters = [np.array([x, y]) for y in (1.0, -1.0) for x in (1.0, -1.0)]
    names = (f"centre (within {radius:g} m)", *(compass(site, quarter) for quarter in quarters))

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        offset = boxes[:, :2] - middle
        quarter = 1 + (offset[:, 0] < 0) + 2 * (offset[:, 1] < 0)
        return np.where(np.hypot(*offset.T) <= radius, 0, quarter).astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_range(scored: Scored, sensors: Sequence[Sensor], seed: int) -> tuple[BreakdownRow, ...]:
    """Judge by horizontal distance to the nearest sensor of the set."""
    places = np.array([sensor.position[:2] for sensor in sensors])
    edges = (0.0, *RANGE_ENDS)
    names = [*(f"{a:g} to {b:g} m" for a, b in zip(edges, RANGE_ENDS, strict=False)), f"beyond {RANGE_ENDS[-1]:g} m"]

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        nearest = np.linalg.norm(boxes[:, None, :2] - places, axis=2).min(axis=1)
        return np.searchsorted(RANGE_ENDS, nearest, side="left").astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_approach(scored: Scored, site: Site, seed: int) -> tuple[BreakdownRow, ...]:
    """Judge by the lane nearest to each vehicle. Approaches without vehicles are left out."""
    places = find_approaches(site)
    rows = by_group(scored, places.names, places.locate, seed)
    return tuple(row for row in rows if row.judged is not None)


def by_level(scored: Scored, judge: Judge, chosen: tuple[int, ...]) -> tuple[BreakdownRow, ...]:
    """Judge each level of traffic. No row if it is undivided."""
    each = zip(LEVEL_NAMES[judge.cases.levels], judge.by_level(chosen), judge.levels, strict=False)
    frame, points = scored.truth_frame, scored.points
    return tuple(_row(name, judged, points[np.isin(frame, part)]) for name, judged, part in each)


def by_errors(judge: Judge, chosen: tuple[int, ...]) -> tuple[BreakdownRow, ...]:
    """Judge each error profile. Failures and levels are included if they count; no row for one profile."""
    rows = zip(judge.by_errors(chosen).items(), judge.profiles, strict=False)
    return tuple(_row(*row, _count_points(at, chosen)) for row, at in rows)


def by_class(judge: Judge, chosen: tuple[int, ...], labels: Sequence[str] = LABELS) -> tuple[ClassSeen, ...]:
    """Coverage of each class: share of its road users in the area with `LEAST` points or more."""
    detected, site = judge.detected, judge.detected.renders.site
    inside, seen = [], []
    for k in range(judge.frames):
        objects = detected.renders.objects(k)
        objects = objects[has_centre_inside(objects.boxes, site.area)]
        inside.append(objects.labels)
        seen.append(count_on_ground(fuse_clouds(detected, chosen, k), objects.boxes, site) >= LEAST)
    of_class, all_seen = np.concatenate(inside), np.concatenate(seen)
    rows = {label: all_seen[of_class == label_index(label)] for label in labels}
    return tuple(
        ClassSeen(label, len(row), int(LEAST), float(row.mean()) if len(row) else None) for label, row in rows.items()
    )


def pick_moments(
    detected: Detected, chosen: tuple[int, ...], *, count: int = MOMENTS, points: int = MOMENT_POINTS, seed: int = 0
) -> tuple[Moment, ...]:
    """Pick the first run of `count` frames with most vehicles. points: kept of each cloud, drawn from the seed."""
    found = np.array([detected.scored(k).sum() for k in range(detected.frames)], np.int64)
    count = min(count, detected.frames)
    first = int(np.convolve(found, np.ones(count, np.int64), mode="valid").argmax())
    return tuple(_moment(detected, chosen, k, points, seed) for k in range(first, first + count))


def _moment(detected: Detected, chosen: tuple[int, ...], k: int, points: int, seed: int) -> Moment:
    truth = detected.outcomes([chosen], [k])[chosen][0].truth[detected.ious.index(detected.iou)]
    objects, scored = detected.renders.objects(k), detected.scored(k)
    hit = np.zeros(len(objects), np.bool_)
    hit[np.flatnonzero(scored)[truth[truth > FALSE_ALARM]]] = True
    clouds = tuple(thin(detected.renders.clouds(k, c), points, [seed, k, c]) for c in chosen)
    return Moment(clouds, objects, detected.detections(chosen, k), hit, ~scored, truth >= 0, truth == IGNORED)


def thin(cloud: Float32[np.ndarray, "n 3"], points: int, seed: list[int]) -> Float32[np.ndarray, "m 3"]:
    """Draw at most this many points of a cloud. They keep their order."""
    if len(cloud) <= points:
        return cloud
    return cloud[np.sort(np.random.default_rng(seed).choice(len(cloud), points, replace=False))]
