"""The classic mistakes of labels, found by how points lie in boxes: undo each, and see which box fits better.

A box that is right has points just within its faces, none in the middle of it and nothing close around it but ground.
The fit of a box is the share of its points (those no lower than `CLEARANCE` above the ground) that lie there, of all
within the box and `SHELL` it; a box that has hardly any has a fit of 0. A mistake is suspected where undoing it raises
the fits box by box, by so many `STANDARD_ERRORS` of their mean change; of several that do, the one that raises them
most.

How high boxes stand is seen by the ground: the centre of a box is half its height above it, not on it or its whole
height above it. Labels of another time than the cloud are seen by what moves: boxes of tracks in two samples are moved
along their way. Yaws in degrees read as radians are seen in the numbers: radians do not go beyond a full turn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.boxes import points_in_boxes
from toolkit.calibration.ground import level
from toolkit.datasets.doctor.checks import Finding
from toolkit.datasets.records.labels import FULL_TURNS
from toolkit.datasets.sample import Sample

CLEARANCE = 0.3  # m above the ground
SHELL = 0.5  # m
SLACK = 0.1  # m that a point may lie outside its box, as sensors err
HOLLOW = 0.6  # of a box's length and width, in which a sensor sees nothing of a vehicle
LEAST_ON_BOX = 15  # points in and around a box, below which its fit is 0
LEAST_BOXES = 5  # with a fit, below which nothing is said
STANDARD_ERRORS = 3.0  # of the mean change of fits, from which on a mistake is suspected
GAIN = 0.02  # of the mean fit, that there must be as well
SUNK = 0.3  # of a box's height, that the middle box may be off its place above the ground
ALIKE = 0.01  # of the mean fit, within which the mistake that comes first in the list is named
TURNED_TOO_FAR = 0.2  # share of yaws beyond a full turn
SHIFTS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)  # s that labels may be late or early
MOVING = 2.0  # m/s

Change = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class LabelMistake:
    """What may be wrong with boxes, (n, 7), and how it is undone."""

    name: str
    remedy: str
    undo: Change


def _changed(**columns: Callable[[np.ndarray], np.ndarray]) -> Change:
    places = {name: k for k, name in enumerate(("x", "y", "z", "length", "width", "height", "yaw"))}

    def undo(boxes: np.ndarray) -> np.ndarray:
        made = boxes.copy()
        for name, column in columns.items():
            made[:, places[name]] = column(boxes)
        return made

    return undo


def _sized(factor: float) -> Change:
    sizes = (("length", 3), ("width", 4), ("height", 5))
    return _changed(**{name: lambda boxes, k=k: boxes[:, k] * factor for name, k in sizes})


LABEL_MISTAKES = (
    LabelMistake(
        "mirrored: y points the other way", "negate y and yaw",
        _changed(y=lambda b: -b[:, 1], yaw=lambda b: -b[:, 6]),
    ),
    LabelMistake(
        "mirrored: x points the other way", "negate x, and take 180 degrees minus yaw",
        _changed(x=lambda b: -b[:, 0], yaw=lambda b: np.pi - b[:, 6]),
    ),
    LabelMistake("y of the positions alone negated", "negate y", _changed(y=lambda b: -b[:, 1])),
    LabelMistake(
        "x and y swapped", "swap x and y, and take 90 degrees minus yaw",
        _changed(x=lambda b: b[:, 1], y=lambda b: b[:, 0], yaw=lambda b: np.pi / 2 - b[:, 6]),
    ),
    LabelMistake("half extents where full ones belong: the boxes are half as large", "double the sizes", _sized(2.0)),
    LabelMistake("doubled extents: the boxes are twice as large", "halve the sizes", _sized(0.5)),
    LabelMistake(
        "length and width swapped, or yaw a quarter turn off", "swap length and width, or add 90 degrees to yaw",
        _changed(length=lambda b: b[:, 4], width=lambda b: b[:, 3]),
    ),
    LabelMistake("yaw counted the other way round", "negate yaw", _changed(yaw=lambda b: -b[:, 6])),
    LabelMistake(
        "yaw in radians where degrees belong", "multiply yaw by 180 / pi",
        _changed(yaw=lambda b: np.rad2deg(b[:, 6])),
    ),
)  # fmt: skip


def diagnose_samples(samples: Iterable[Sample]) -> list[Finding]:
    """What looks wrong with the labels of some samples, consecutive ones; an empty list for healthy ones."""
    some = [_seen(sample) for sample in samples]
    boxes = [each.sample.objects.boxes for each in some]
    findings = _turned_too_far(some)
    current = _fits(some, boxes)
    undone = {mistake.name: _fits(some, [mistake.undo(each) for each in boxes]) for mistake in LABEL_MISTAKES}
    surer = [mistake for mistake in LABEL_MISTAKES if _better(current, undone[mistake.name])]
    if surer:
        most = max(undone[mistake.name].mean() for mistake in surer)
        best = next(mistake for mistake in surer if undone[mistake.name].mean() >= most - ALIKE)
        findings.append(_finding(best.name, current, undone[best.name], best.remedy))
        boxes = [best.undo(each) for each in boxes]
    findings += _sunk(some, boxes)
    return findings or _late(some)


def _better(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether boxes fit better, by more than chance explains."""
    change = (after - before)[(after > 0) | (before > 0)]
    if len(change) < LEAST_BOXES or change.mean() < GAIN:
        return False
    return bool(change.mean() >= STANDARD_ERRORS * change.std() / np.sqrt(len(change)))


@dataclass(frozen=True, eq=False)
class _Seen:
    """A sample, its points that stand on the ground, and how high (m) the centres of its boxes are above that; none of
    them where there is no ground."""

    sample: Sample
    points: np.ndarray
    heights: np.ndarray


def _seen(sample: Sample) -> _Seen:
    points, boxes = sample.points(), sample.objects.boxes
    try:
        ground = level(points, method="map")
    except ValueError:
        return _Seen(sample, points, np.zeros(0))
    standing = points[points[:, 2] - ground.height(points[:, :2]) > CLEARANCE]
    return _Seen(sample, standing, boxes[:, 2] - ground.height(boxes[:, :2]))


def _fits(some: Sequence[_Seen], boxes: Sequence[np.ndarray]) -> np.ndarray:
    """The fit of every box of every sample."""
    parts = [_fit(each.points, own) for each, own in zip(some, boxes, strict=True) if len(own)]
    return np.concatenate([np.zeros(0), *parts])


def _fit(points: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    wide = boxes + np.array([0, 0, SHELL / 2, 2 * SHELL, 2 * SHELL, SHELL, 0])
    inside = points_in_boxes(points, wide)
    fits = np.zeros(len(boxes))
    for k, (x, y, z, length, width, height, yaw) in enumerate(boxes):
        near = points[inside[:, k]]
        if len(near) < LEAST_ON_BOX:
            continue
        dx, dy, dz = (near - [x, y, z]).T
        ahead, aside = np.abs(dx * np.cos(yaw) + dy * np.sin(yaw)), np.abs(dy * np.cos(yaw) - dx * np.sin(yaw))
        in_box = (ahead <= length / 2 + SLACK) & (aside <= width / 2 + SLACK) & (dz <= height / 2 + SLACK)
        inner = (ahead < HOLLOW * length / 2) & (aside < HOLLOW * width / 2) & (dz < height / 2 - 2 * SLACK)
        fits[k] = (in_box & ~inner).mean()
    return fits


def _turned_too_far(some: Sequence[_Seen]) -> list[Finding]:
    total = sum(len(each.sample.objects) for each in some)
    beyond = sum(each.sample.problems.get(FULL_TURNS, 0) for each in some)
    if not beyond or beyond < TURNED_TOO_FAR * total:
        return []
    evidence = f"{beyond} of {total} yaws are beyond a full turn in radians"
    return [Finding("error", "labels", "yaw in degrees where radians belong", evidence, "multiply yaw by pi / 180")]


def _sunk(some: Sequence[_Seen], boxes: Sequence[np.ndarray]) -> list[Finding]:
    """Whether the centres of boxes stand on the ground, or by a whole height above it."""
    parts = [each.heights / own[:, 5] for each, own in zip(some, boxes, strict=True) if len(each.heights)]
    shares = np.concatenate([np.zeros(0), *parts])
    if len(shares) < LEAST_BOXES or abs(np.median(shares) - 0.5) < SUNK:
        return []
    share = float(np.median(shares))
    name, remedy = ("floor", "add half the height to z") if share < 0.5 else ("roof", "take half the height off z")
    evidence = f"the stored centres stand {share:.0%} of the boxes' heights above the ground, median of {len(shares)}"
    where = f"the centre of the {name} where the centre of the box belongs"
    return [Finding("error", "labels", where, evidence, remedy)]


def _late(some: Sequence[_Seen]) -> list[Finding]:
    """Whether labels fit better when they are moved along the way of their tracks."""
    movers = [_movers(some, k) for k in range(len(some))]
    if sum(len(boxes) for boxes, _ in movers) < LEAST_BOXES:
        return []

    def fits_at(shift: float) -> np.ndarray:
        return _fits(some, [boxes + np.column_stack([shift * v, np.zeros((len(v), 5))]) for boxes, v in movers])

    now = fits_at(0.0)
    shifted = {sign * seconds: fits_at(sign * seconds) for seconds in SHIFTS for sign in (1, -1)}
    shift = max(shifted, key=lambda each: shifted[each].mean())
    if not _better(now, shifted[shift]):
        return []
    name = f"labels lie about {abs(shift):g} s {'behind' if shift > 0 else 'ahead of'} the clouds"
    return [_finding(name, now, shifted[shift], f"move labels by {shift:+g} s along their way, or pair other clouds")]


def _movers(some: Sequence[_Seen], k: int) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of a sample that move, and their velocities (m/s), by the nearest sample that has the track too."""
    here = some[k].sample
    boxes, velocities = [], []
    for row, track in enumerate(here.objects.ids):
        for other in (k + 1, k - 1):
            if not 0 <= other < len(some):
                continue
            there = some[other].sample
            match = np.flatnonzero(there.objects.ids == track)
            seconds = there.time - here.time
            if len(match) == 1 and np.isfinite(seconds) and seconds != 0:
                path = _in_frame(there, here, there.objects.boxes[match[0], :3])[:2] - here.objects.boxes[row, :2]
                velocity = path / seconds
                if MOVING < np.linalg.norm(velocity) < 60:
                    boxes.append(here.objects.boxes[row])
                    velocities.append(velocity)
                break
    return np.array(boxes).reshape(-1, 7), np.array(velocities).reshape(-1, 2)


def _in_frame(source: Sample, target: Sample, place: np.ndarray) -> np.ndarray:
    """A place of one sample's world frame in another's."""
    in_map = source.map_SE3_world[:3, :3] @ place + source.map_SE3_world[:3, 3]
    return target.map_SE3_world[:3, :3].T @ (in_map - target.map_SE3_world[:3, 3])


def _finding(name: str, before: np.ndarray, after: np.ndarray, remedy: str) -> Finding:
    share = f"{before.mean():.0%} as they are, {after.mean():.0%} with that undone"
    return Finding("error", "labels", name, f"mean fit of {len(before)} boxes to the points: {share}", remedy)
