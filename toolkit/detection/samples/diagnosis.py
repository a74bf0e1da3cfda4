"""The classic mistakes of labels, found by how points lie in boxes: undo each, and see which box fits better.

A mistake is suspected where undoing it raises the fits (`toolkit.detection.samples.label_fits`) box by box, by so many
`STANDARD_ERRORS` of their mean change; of several that do, the one that raises them most.

How high boxes stand is seen by the ground: the centre of a box is half its height above it, not on it or its whole
height above it. Labels of another time than the cloud are seen by what moves, and by the clouds of other samples. Yaws
in degrees read as radians are seen in the numbers, as radians do not go beyond a full turn; where a file keeps no
angle but its sine and cosine, by boxes that all fit once they are turned, each by another angle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.datasets.doctor.checks import Finding
from toolkit.datasets.records.labels import FULL_TURNS
from toolkit.datasets.sample import Sample
from toolkit.detection.samples.label_fits import LEAST_BOXES, Seen, better, fits, fits_in
from toolkit.detection.samples.label_mistakes import (
    LABEL_MISTAKES,
    LOST_DEGREES,
    YAW_SIGN,
    LabelMistake,
    degrees_of_turns,
    undone_in,
)
from toolkit.detection.samples.label_times import against_their_way, shift_of
from toolkit.geometry import invert

SUNK = 0.3  # of a box's height, that the middle box may be off its place above the ground
ALIKE = 0.04  # of the mean fit, within which the mistake that comes first in the list is named
TURNED_TOO_FAR = 0.2  # share of yaws beyond a full turn
FREER = 0.1  # of the mean fit, that explanations which choose a sensor for each box must be better by
TURNED_GAIN = 0.15  # of the mean fit, that those which turn each box as it fits best must be better by


def diagnose_samples(samples: Iterable[Sample]) -> list[Finding]:
    """What looks wrong with the labels of some samples, consecutive ones; an empty list for healthy ones."""
    some = [Seen.of(sample) for sample in samples]
    findings = _turned_too_far(some)
    if findings:
        return findings
    boxes = [each.sample.objects.boxes for each in some]
    current = fits(some, boxes)
    best = _best(some, current)
    if best is not None:
        findings.append(_finding(best.mistake.name, current, best.fits, best.mistake.remedy))
        boxes = best.boxes
    findings += _sunk(some, boxes)
    if findings:
        return findings
    return _late(some) or _misfits(some, current) or _headed(some)


class _Undone(NamedTuple):
    """A mistake, the boxes without it, and how they fit."""

    mistake: LabelMistake
    boxes: list[np.ndarray]
    fits: np.ndarray


def _best(some: Sequence[Seen], current: np.ndarray) -> _Undone | None:
    """The mistake that, undone, raises the fits most: in the frame of the world or the map, or else, where that fits
    clearly better, in those of the sensors or of angles that were lost."""
    everywhere = [np.eye(4)] * len(some)
    attempts = [_undone(some, mistake, everywhere) for mistake in LABEL_MISTAKES]
    maps = [each.sample.map_SE3_world for each in some]
    if any(not np.allclose(each, np.eye(4)) for each in maps):
        attempts += [_undone(some, mistake, maps) for mistake in LABEL_MISTAKES if mistake.axes]
    plain = _most(attempts, current)
    in_sensors = [_undone_in_sensors(some, mistake) for mistake in LABEL_MISTAKES if mistake.axes]
    best = _clearer(plain, _most(in_sensors, current, FREER), FREER)
    return best if best is None else _clearer(best, _each_turned(some), TURNED_GAIN if best is plain else FREER)


def _clearer(best: _Undone | None, freer: _Undone | None, margin: float) -> _Undone | None:
    """An explanation, or another that chooses for each box, where that fits better by a margin."""
    if best is None or freer is None:
        return best or freer
    one, other = _means([best, freer])
    return freer if other > one + margin else best


def _means(attempts: Sequence[_Undone]) -> list[float]:
    """The mean fit under each of some explanations, of the boxes that have one under any: of many nothing is seen."""
    known = np.any([attempt.fits > 0 for attempt in attempts], axis=0)
    return [float(attempt.fits[known].mean()) for attempt in attempts]


def _undone(some: Sequence[Seen], mistake: LabelMistake, frames: Sequence[np.ndarray]) -> _Undone:
    """A mistake undone, in a frame for each sample: where that is in the map or the sensor, from the world."""
    boxes = [undone_in(mistake, each.sample.objects.boxes, frame) for each, frame in zip(some, frames, strict=True)]
    return _Undone(mistake, boxes, fits(some, boxes))


def _undone_in_sensors(some: Sequence[Seen], mistake: LabelMistake) -> _Undone:
    """A mistake undone in the frame of that sensor, of each box, in which it fits best then."""
    boxes = []
    for each in some:
        frames = [invert(cloud.world_SE3_sensor) for cloud in each.sample.clouds] or [np.eye(4)]
        boxes.append(_fitting_best(each, [undone_in(mistake, each.sample.objects.boxes, frame) for frame in frames]))
    return _Undone(mistake, boxes, fits(some, boxes))


def _each_turned(some: Sequence[Seen]) -> _Undone:
    """Each box turned by that of the angles which degrees taken for radians leave open, by which it fits best."""
    boxes = []
    for each in some:
        rows = each.sample.objects.boxes
        boxes.append(_fitting_best(each, [np.column_stack([rows[:, :6], yaw]) for yaw in degrees_of_turns(rows[:, 6])]))
    return _Undone(LOST_DEGREES, boxes, fits(some, boxes))


def _fitting_best(each: Seen, choices: Sequence[np.ndarray]) -> np.ndarray:
    """Of every box the one among its choices that fits best."""
    if not len(choices[0]):
        return choices[0]
    best = np.argmax([fits_in(each.points, boxes) for boxes in choices], axis=0)
    return np.stack(choices)[best, np.arange(len(best))]


def _most(attempts: Sequence[_Undone], current: np.ndarray, *gain: float) -> _Undone | None:
    surer = [attempt for attempt in attempts if better(current, attempt.fits, *gain)]
    if not surer:
        return None
    means = _means(surer)
    return next(attempt for attempt, mean in zip(surer, means, strict=True) if mean >= max(means) - ALIKE)


def _turned_too_far(some: Sequence[Seen]) -> list[Finding]:
    total = sum(len(each.sample.objects) for each in some)
    beyond = sum(each.sample.problems.get(FULL_TURNS, 0) for each in some)
    if not beyond or beyond < TURNED_TOO_FAR * total:
        return []
    evidence = f"{beyond} of {total} yaws are beyond a full turn in radians"
    return [Finding("error", "labels", "yaw in degrees where radians belong", evidence, "multiply yaw by pi / 180")]


def _sunk(some: Sequence[Seen], boxes: Sequence[np.ndarray]) -> list[Finding]:
    """Whether the centres of boxes stand on the ground, or by a whole height above it."""
    parts = [each.heights(own) / own[:, 5] for each, own in zip(some, boxes, strict=True) if each.ground is not None]
    shares = np.concatenate([np.zeros(0), *parts])
    if len(shares) < LEAST_BOXES or abs(np.median(shares) - 0.5) < SUNK:
        return []
    share = float(np.median(shares))
    name, remedy = ("floor", "add half the height to z") if share < 0.5 else ("roof", "take half the height off z")
    evidence = f"the stored centres stand {share:.0%} of the boxes' heights above the ground, median of {len(shares)}"
    where = f"the centre of the {name} where the centre of the box belongs"
    return [Finding("error", "labels", where, evidence, remedy)]


def _headed(some: Sequence[Seen]) -> list[Finding]:
    """Whether things head where they go once yaw is counted the other way round."""
    samples = [each.sample for each in some]
    for in_map in (False, True):

        def undo(sample: Sample, boxes: np.ndarray, in_map: bool = in_map) -> np.ndarray:
            return undone_in(YAW_SIGN, boxes, sample.map_SE3_world if in_map else np.eye(4))

        headed = against_their_way(samples, undo)
        if headed is not None:
            evidence = (
                f"{headed.against} of {headed.of} boxes that move, of {headed.tracks} objects, head against their way, "
                "and along it with that undone"
            )
            return [Finding("error", "labels", YAW_SIGN.name, evidence, YAW_SIGN.remedy)]
    return []


def _late(some: Sequence[Seen]) -> list[Finding]:
    """Whether labels fit better at another time."""
    shift = shift_of(some)
    if shift is None:
        return []
    name = f"labels lie about {shift.amount} {'behind' if shift.behind else 'ahead of'} the clouds"
    remedy = f"move labels by {'+' if shift.behind else '-'}{shift.amount} along their way, or pair other clouds"
    return [_finding(name, shift.before, shift.after, remedy)]


def _misfits(some: Sequence[Seen], current: np.ndarray) -> list[Finding]:
    """Whether boxes fit once each is turned, where nothing else explains why they do not."""
    turned = _each_turned(some)
    if not better(current, turned.fits, TURNED_GAIN):
        return []
    return [_finding(LOST_DEGREES.name, current, turned.fits, LOST_DEGREES.remedy)]


def _finding(name: str, before: np.ndarray, after: np.ndarray, remedy: str) -> Finding:
    share = f"{before.mean():.0%} as they are, {after.mean():.0%} with that undone"
    return Finding("error", "labels", name, f"mean fit of {len(before)} boxes to the points: {share}", remedy)
