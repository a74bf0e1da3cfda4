"""Breakdown: AP and recall of the chosen set by zone, range, lane approach, level, errors, and what of classes is seen.

Vehicles and false alarms are sorted by where their boxes' centres are; a detection that hits belongs to the group of
the vehicle it hit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement_env.analysis.approaches import compass, find_approaches
from placement_env.analysis.intervals import Tally
from placement_env.classes import Classes
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.detector import FALSE_ALARM, Detected
from placement_env.report.content import BreakdownRow, ClassSeen
from placement_env.report.planning.judging import Judge, mean_judgement
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import label_index
from toolkit.points import count_on_ground, has_centre_inside
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

RANGE_ENDS = (10.0, 20.0, 30.0, 40.0)  # m from the nearest sensor, where groups end
CENTRE = 0.25  # of the shorter side of the area: radius of the zone in its middle

GroupOf = Callable[[Float64[np.ndarray, "n 7"]], Int64[np.ndarray, " n"]]


@dataclass(frozen=True, eq=False)
class Scored:
    """What one set detects, box by box. truths: scored objects of all frames, in order; truth_frame, truth_label: of
    each; points: that the set has on each; boxes, scores, truth: of the detections that count, and which of the truths
    each hit, -1 for a false alarm; frame, label: of each; frames: how many there are; classes: that count; others:
    the same at the other IoU thresholds over which the mean is taken."""

    truths: Float64[np.ndarray, "t 7"]
    truth_frame: Int64[np.ndarray, " t"]
    points: Int64[np.ndarray, " t"]
    boxes: Float64[np.ndarray, "n 7"]
    scores: Float64[np.ndarray, " n"]
    truth: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    frames: int
    truth_label: Int64[np.ndarray, " t"]
    label: Int64[np.ndarray, " n"]
    classes: Classes
    others: tuple[Scored, ...] = ()

    def part(self, truths: Bool[np.ndarray, " t"], detections: Bool[np.ndarray, " n"]) -> list[Tally]:
        """The tally of some truths and detections for each class."""
        return [
            self._tally(truths & (self.truth_label == label), detections & (self.label == label))
            for label in self.classes.labels
        ]

    def _tally(self, truths: Bool[np.ndarray, " t"], detections: Bool[np.ndarray, " n"]) -> Tally:
        there = np.bincount(self.truth_frame[truths], minlength=self.frames)
        return Tally(self.scores[detections], self.truth[detections] >= 0, self.frame[detections], there)


def scored_boxes(judge: Judge, chosen: tuple[int, ...]) -> Scored:
    """What the chosen set detects in all frames of a judge."""
    first, *others = judge.ious
    scored = _scored_at(judge, chosen, judge.detected.ious.index(first))
    return replace(scored, others=tuple(_hit_at(judge, chosen, scored, judge.detected.ious.index(o)) for o in others))


def _hit_at(judge: Judge, chosen: tuple[int, ...], scored: Scored, at: int) -> Scored:
    """The same at another IoU threshold, which changes what hits alone."""
    firsts = np.searchsorted(scored.truth_frame, np.arange(scored.frames))
    outcomes = judge.outcomes(chosen)
    rows = [outcome.truth[at].astype(np.int64) for outcome in outcomes]
    truth = np.concatenate([np.where(row >= 0, first + row, row) for first, row in zip(firsts, rows, strict=True)])
    counts = truth >= FALSE_ALARM
    found = [judge.detected.detections(chosen, k) for k in range(scored.frames)]
    return replace(
        scored,
        boxes=np.concatenate([each.boxes for each in found])[counts],
        scores=np.concatenate([each.scores for each in outcomes])[counts],
        truth=truth[counts],
        frame=np.repeat(np.arange(scored.frames), [len(row) for row in rows])[counts],
        label=np.concatenate([each.labels for each in found])[counts],
    )


def _scored_at(judge: Judge, chosen: tuple[int, ...], at: int) -> Scored:
    """At the IoU threshold of an index, with the points on the truths."""
    detected, outcomes = judge.detected, judge.outcomes(chosen)
    truths, points, boxes, scores, truth, truth_label, label = [], [], [], [], [], [], []
    first = 0
    for k, outcome in enumerate(outcomes):
        counts = outcome.truth[at] >= FALSE_ALARM
        hit = outcome.truth[at, counts].astype(np.int64)
        objects = detected.renders.objects(k)[detected.scored(k)]
        there = objects.boxes
        truth_label.append(objects.labels)
        truths.append(there)
        points.append(count_on_ground(fused_cloud(detected, chosen, k), there, detected.renders.site))
        found = detected.detections(chosen, k)[counts]
        boxes.append(found.boxes)
        label.append(found.labels)
        scores.append(outcome.scores[counts])
        truth.append(np.where(hit >= 0, first + hit, FALSE_ALARM))
        first += len(there)
    frames = np.arange(len(outcomes))
    return Scored(
        np.concatenate(truths),
        np.repeat(frames, [len(each) for each in truths]),
        np.concatenate(points),
        np.concatenate(boxes),
        np.concatenate(scores),
        np.concatenate(truth),
        np.repeat(frames, [len(each) for each in scores]),
        len(frames),
        np.concatenate(truth_label),
        np.concatenate(label),
        detected.classes,
    )


def fused_cloud(detected: Detected, chosen: Sequence[int], k: int) -> np.ndarray:
    """The points of all sensors of a set in frame k."""
    clouds = [detected.renders.clouds(k, c) for c in chosen]
    return np.concatenate([np.zeros((0, 3), np.float32), *clouds])


def by_group(scored: Scored, names: Sequence[str], group_of: GroupOf, seed: int) -> tuple[BreakdownRow, ...]:
    """A row for each group."""
    of_truth = group_of(scored.truths)
    groups = [(each, _of_detections(each, of_truth, group_of)) for each in (scored, *scored.others)]
    rows = []
    for number, name in enumerate(names):
        here = of_truth == number
        parts = [each.part(here, of_detection == number) for each, of_detection in groups]
        judged = mean_judgement(parts, scored.classes, seed) if here.any() else None
        rows.append(BreakdownRow(name, judged, float(scored.points[here].mean()) if here.any() else None))
    return tuple(rows)


def _of_detections(scored: Scored, of_truth: Int64[np.ndarray, " t"], group_of: GroupOf) -> Int64[np.ndarray, " n"]:
    """Group of each detection: of the truth that it hits, else of where it is."""
    hits = scored.truth >= 0
    groups = group_of(scored.boxes)
    groups[hits] = of_truth[scored.truth[hits]]
    return groups


def by_zone(scored: Scored, site: Site, seed: int) -> tuple[BreakdownRow, ...]:
    """The middle of the area, and its quarters round that, named by the compass."""
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
    """By horizontal distance to the nearest sensor of the set."""
    places = np.array([sensor.position[:2] for sensor in sensors])
    edges = (0.0, *RANGE_ENDS)
    names = [*(f"{a:g} to {b:g} m" for a, b in zip(edges, RANGE_ENDS, strict=False)), f"beyond {RANGE_ENDS[-1]:g} m"]

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        nearest = np.linalg.norm(boxes[:, None, :2] - places, axis=2).min(axis=1)
        return np.searchsorted(RANGE_ENDS, nearest, side="left").astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_approach(scored: Scored, site: Site, seed: int) -> tuple[BreakdownRow, ...]:
    """By the lane that each vehicle is nearest to; places without any vehicle are left out."""
    places = find_approaches(site)
    rows = by_group(scored, places.names, places.locate, seed)
    return tuple(row for row in rows if row.judged is not None)


def by_level(scored: Scored, judge: Judge, chosen: tuple[int, ...]) -> tuple[BreakdownRow, ...]:
    """At each level of traffic; no row where all traffic is one."""
    if judge.cases is None or not judge.parts:
        return ()
    rows = []
    for name, part, judged in zip(judge.cases.level_names, judge.parts, judge.by_level(chosen), strict=False):
        points = scored.points[np.isin(scored.truth_frame, part)]
        rows.append(BreakdownRow(name, judged, float(points.mean()) if len(points) else None))
    return tuple(rows)


def by_errors(judge: Judge, chosen: tuple[int, ...]) -> tuple[BreakdownRow, ...]:
    """At each error profile, with failures and levels where such count; no row where there is one profile."""
    rows = zip(judge.by_errors(chosen).items(), (judge, *judge.others), strict=False)
    return tuple(BreakdownRow(name, judged, mean_points(at, chosen)) for (name, judged), at in rows)


def mean_points(judge: Judge, chosen: tuple[int, ...]) -> float | None:
    """Points that a set has on a scored object, in the mean; None without any object."""
    detected, points = judge.detected, [np.zeros(0, np.int64)]
    for k in range(judge.frames):
        boxes = detected.renders.objects(k).boxes[detected.scored(k)]
        points.append(count_on_ground(fused_cloud(detected, chosen, k), boxes, detected.renders.site))
    every = np.concatenate(points)
    return float(every.mean()) if len(every) else None


def by_class(judge: Judge, chosen: tuple[int, ...], labels: Sequence[str]) -> tuple[ClassSeen, ...]:
    """Of the road users of each class centred in the area, the share with `LEAST` points or more."""
    detected = judge.detected
    points: dict[str, list[np.ndarray]] = {label: [np.zeros(0, np.int64)] for label in labels}
    for k in range(judge.frames):
        objects, cloud = detected.renders.objects(k), fused_cloud(detected, chosen, k)
        inside = has_centre_inside(objects.boxes, detected.renders.site.area)
        for label in labels:
            boxes = objects.boxes[inside & (objects.labels == label_index(label))]
            points[label].append(count_on_ground(cloud, boxes, detected.renders.site))
    rows = {label: np.concatenate(counts) for label, counts in points.items()}
    return tuple(
        ClassSeen(label, len(row), int(LEAST), float((row >= LEAST).mean()) if len(row) else None)
        for label, row in rows.items()
    )
