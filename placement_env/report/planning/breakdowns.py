"""Figures of the chosen set by place, distance, approach, traffic level, error profile and class.

Vehicles and false alarms belong to the group of their box's centre, and a hit belongs to the group
of the vehicle it hit."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from placement_env.analysis.approaches import compass, find_approaches, find_streets
from placement_env.analysis.intervals import Tally
from placement_env.cases import LEVEL_NAMES
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.detector import IGNORED
from placement_env.handover.ground import GroundGrid
from placement_env.report import content
from placement_env.report.planning import judging
from placement_env.report.planning.scored_boxes import (
    ScoredBoxes,
    count_frame_points,
    count_set_points,
)
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import LABELS, label_index
from toolkit.points import has_centre_inside
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

RANGE_ENDS_M = (10.0, 20.0, 30.0, 40.0)  # distances from the nearest sensor that end groups
CENTRE_SHARE = 0.25  # radius of the middle zone, as a share of the area's shorter side
# index of the group of each box, from its centre
GroupOf = Callable[[Float64[np.ndarray, "n 7"]], Int64[np.ndarray, " n"]]


def _row(
    name: str, judged: content.Judgement | None, points: Int64[np.ndarray, " t"]
) -> content.BreakdownRow:
    """Row of a breakdown by groups of objects, without a mean of points if the group is empty.

    judged: result of the set on the group, None if it was not judged; points: number of the set's
    points on each object of the group."""
    mean_points = float(points.mean()) if len(points) else None
    return content.BreakdownRow(name, judged, mean_points)


def by_group(
    scored: ScoredBoxes, names: Sequence[str], group_of: GroupOf, seed: int
) -> tuple[content.BreakdownRow, ...]:
    """Judge the objects and detections of each group.

    An object is in the group of its box's centre. A detection that hits is in the group of its
    object, a false alarm in the group of its centre, an ignored one in none. A group without
    objects has no judgement.

    Args:
        scored: Objects and detections of one set.
        names: Name of each group, in the order of its index.
        group_of: Function that returns the index of the group of each box.
        seed: Seed of the bootstrap."""
    truth_groups = group_of(scored.truths)
    # `hits`: index of the object that each detection hits, negative without one
    # axes: IoU threshold, detection; -1 is no group
    detection_groups = np.where(scored.hits == IGNORED, -1, group_of(scored.boxes))
    is_hit = scored.hits >= 0
    detection_groups[is_hit] = truth_groups[scored.hits[is_hit]]
    rows = []
    for number, name in enumerate(names):
        is_truth = truth_groups == number
        judgement = None
        if is_truth.any():
            tallies = []
            for iou_index, groups in enumerate(detection_groups):
                is_counted = groups == number
                tallies.append(_tally_classes(scored, is_truth, is_counted, iou_index))
            judgement = judging.judge_tallies(tallies, scored.classes, seed)
        rows.append(_row(name, judgement, scored.points[is_truth]))
    return tuple(rows)


def _tally_classes(
    scored: ScoredBoxes,
    is_truth: Bool[np.ndarray, " t"],
    is_counted: Bool[np.ndarray, " n"],
    iou_index: int,
) -> list[Tally]:
    """Tally the objects and detections of a group, in a tally for each class that counts.

    is_truth, is_counted: True for the objects and detections of the group; iou_index: row of
    `ScoredBoxes.hits`, which has the hits at one IoU threshold."""
    labels = scored.classes.labels
    return [scored.tally(label, is_truth, is_counted, iou_index) for label in labels]


def by_zone(scored: ScoredBoxes, site: Site, seed: int) -> tuple[content.BreakdownRow, ...]:
    """Judge the middle of the area and the quarters around it, named by the compass.

    The middle is a circle whose radius is `CENTRE_SHARE` of the area's shorter side.

    scored: objects and detections of one set; seed: for the bootstrap."""
    xmin, ymin, xmax, ymax = site.area
    middle = np.array([xmin + xmax, ymin + ymax]) / 2
    radius = CENTRE_SHARE * min(xmax - xmin, ymax - ymin)
    # directions x, y of quarters 1 to 4; the sign of x changes first, as in `group_of`
    quarters = [np.array([x, y]) for y in (1.0, -1.0) for x in (1.0, -1.0)]
    names = (f"centre (within {radius:g} m)", *(compass(site, quarter) for quarter in quarters))

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        """Number of each box's group: 0 in the middle circle, else 1 to 4 for its quarter.

        Quarters have the order of `quarters`."""
        dx, dy = (boxes[:, :2] - middle).T
        quarter = 1 + (dx < 0) + 2 * (dy < 0)
        return np.where(np.hypot(dx, dy) <= radius, 0, quarter).astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_range(
    scored: ScoredBoxes, sensors: Sequence[Sensor], seed: int
) -> tuple[content.BreakdownRow, ...]:
    """Judge by horizontal distance to the nearest sensor of the set.

    Groups end at `RANGE_ENDS_M`; the last has no end. seed: for the bootstrap."""
    sensor_xy = np.array([sensor.position[:2] for sensor in sensors])
    ranges = pairwise((0.0, *RANGE_ENDS_M))
    names = [f"{start:g} to {end:g} m" for start, end in ranges]
    names.append(f"beyond {RANGE_ENDS_M[-1]:g} m")

    def group_of(boxes: Float64[np.ndarray, "n 7"]) -> Int64[np.ndarray, " n"]:
        """Number of each box's group, from 0 for the nearest range."""
        offsets = boxes[:, None, :2] - sensor_xy  # axes: box, sensor, (x, y)
        nearest_distance = np.linalg.norm(offsets, axis=2).min(axis=1)
        return np.searchsorted(RANGE_ENDS_M, nearest_distance).astype(np.int64)

    return by_group(scored, names, group_of, seed)


def by_approach(scored: ScoredBoxes, site: Site, seed: int) -> tuple[content.BreakdownRow, ...]:
    """Judge by the approach whose lane is nearest to each object, parked ones separately.

    Approaches without objects are left out. seed: for the bootstrap."""
    approaches = find_approaches(site)
    rows = by_group(scored, approaches.names, approaches.locate, seed)
    return tuple(row for row in rows if row.judged is not None)


def measure_blind_streets(site: Site, ground: GroundGrid) -> dict[str, float]:
    """Return the area of lanes that no sensor sees (m²) by street, the largest first.

    Streets that are seen completely are left out. Only open ground counts.

    ground: grid of the ground with the number of sensors that see each cell."""
    rows, columns = np.nonzero(ground.open_ground & ground.lanes & (ground.views == 0))
    # `locate` takes boxes, so cells become boxes of no size; columns 0 and 1 are x and y (m)
    boxes = np.zeros((len(rows), 7))
    boxes[:, 0] = ground.x[columns]
    boxes[:, 1] = ground.y[rows]
    streets = find_streets(site)
    cell_counts = np.bincount(streets.locate(boxes))
    areas = cell_counts * ground.cell**2  # `cell` is the edge length of a cell (m)
    order = np.argsort(-areas, kind="stable")
    return {streets.names[k]: float(areas[k]) for k in order if areas[k]}


def by_level(
    scored: ScoredBoxes, judge: judging.Judge, members: tuple[int, ...]
) -> tuple[content.BreakdownRow, ...]:
    """Judge one intact set at each level of traffic, thin traffic first.

    Empty if traffic is undivided.

    scored: objects of the same frames, for the mean number of the set's points on them; members:
    indices of the set's candidates."""
    names = LEVEL_NAMES[judge.cases.levels]
    judgements = judge.by_level(members)
    rows = []
    # undivided traffic has a name but no frames of levels
    for name, judgement, frames in zip(names, judgements, judge.levels, strict=False):
        points = scored.points[np.isin(scored.truth_frame, frames)]
        rows.append(_row(name, judgement, points))
    return tuple(rows)


def by_errors(judge: judging.Judge, members: tuple[int, ...]) -> tuple[content.BreakdownRow, ...]:
    """Judge each error profile, with failures and levels if they count; empty for one profile.

    members: indices of the set's candidates."""
    judgements = judge.by_errors(members)
    # a single profile has no judgement here
    return tuple(
        _row(name, judgements[name], count_set_points(detected, members))
        for name, detected in zip(judgements, judge.profiles, strict=False)
    )


def by_class(
    judge: judging.Judge, members: tuple[int, ...], labels: Sequence[str] = LABELS
) -> tuple[content.ClassSeen, ...]:
    """Return the coverage of each class: share of its road users with `LEAST` points or more.

    All road users whose centre is in the detection area count, also of classes that do not count
    for AP; one that stays is counted in every frame. A class without road users has no share.

    members: indices of the set's candidates; labels: names of the classes to return."""
    detected = judge.detected
    # class of each road user, and whether it is covered; an array for each frame
    frame_labels = []
    frame_seen = []
    for k, points in enumerate(count_frame_points(detected, members)):
        objects = detected.renders.objects(k)
        is_inside = has_centre_inside(objects.boxes, detected.renders.site.area)
        frame_labels.append(objects.labels[is_inside])
        frame_seen.append(points[is_inside] >= LEAST)
    object_labels = np.concatenate(frame_labels)
    is_seen = np.concatenate(frame_seen)
    rows = []
    for label in labels:
        label_seen = is_seen[object_labels == label_index(label)]
        share = float(label_seen.mean()) if len(label_seen) else None
        rows.append(content.ClassSeen(label, len(label_seen), int(LEAST), share))
    return tuple(rows)
