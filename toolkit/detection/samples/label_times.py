"""Labels of another time than their cloud, and headings that are not the way things go.

Where objects have tracks and samples have times, boxes that move are moved along their way and fit best at one shift.
Where there is neither, the labels of one sample are held against the clouds of those before and after it. What moves
also shows which way it heads: along the axes of a frame a wrong sign of yaw turns no box, but it does turn its front.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.datasets.sample import Sample
from toolkit.detection.samples.label_fits import LEAST_BOXES, Seen, better, fits
from toolkit.detection.samples.label_mistakes import boxes_through
from toolkit.geometry import invert, transform

SHIFTS = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)  # s that labels may be late or early
MOST_SAMPLES = 3  # that labels may be late or early, where there are no times
MOVING = 2.0  # m/s
STANDING = 0.2  # m between samples, within which an object stands
FASTEST = 60.0  # m/s, beyond which a track has jumped
ALONG = 0.7  # cosine between heading and way, from which on the two agree
LEAST_TRACKS = 2  # that must head where they go once a mistake is undone, and did not before


class Shift(NamedTuple):
    """By how much labels lie behind their clouds, less than 0 for ahead, in words; and the fits before and after."""

    amount: str
    behind: bool
    before: Float64[np.ndarray, " n"]
    after: Float64[np.ndarray, " n"]


def shift_of(some: Sequence[Seen]) -> Shift | None:
    """How late or early labels are, None where they are not or nobody can say."""
    return _along_tracks(some) or _of_other_clouds(some)


def _along_tracks(some: Sequence[Seen]) -> Shift | None:
    samples = [each.sample for each in some]
    movers = [movers_in(samples, k) for k in range(len(some))]
    if sum(len(boxes) for boxes, *_ in movers) < LEAST_BOXES:
        return None

    def fits_at(shift: float) -> np.ndarray:
        return fits(some, [boxes + np.column_stack([shift * v, np.zeros((len(v), 5))]) for boxes, v, _ in movers])

    now = fits_at(0.0)
    shifted = {sign * seconds: fits_at(sign * seconds) for seconds in SHIFTS for sign in (1, -1)}
    best = max(shifted, key=lambda each: shifted[each].mean())
    if not better(now, shifted[best]):
        return None
    return Shift(f"{abs(best):g} s", best > 0, now, shifted[best])


def _of_other_clouds(some: Sequence[Seen]) -> Shift | None:
    """Whether the labels of samples fit the clouds of others, some places before or after them, better: those labels
    that are not in the same place in both."""
    found: Shift | None = None
    for places in [sign * k for k in range(1, MOST_SAMPLES + 1) for sign in (1, -1)]:
        pairs = [(some[k], some[k + places]) for k in range(len(some)) if 0 <= k + places < len(some)]
        moving = [_not_there(labels.sample, cloud.sample) for labels, cloud in pairs]
        own = [labels.sample.objects.boxes[rows] for (labels, _), rows in zip(pairs, moving, strict=True)]
        there = [
            _boxes_in(labels.sample, cloud.sample)[rows] for (labels, cloud), rows in zip(pairs, moving, strict=True)
        ]
        before, after = fits([labels for labels, _ in pairs], own), fits([cloud for _, cloud in pairs], there)
        if better(before, after) and (found is None or after.mean() - before.mean() > _gain(found)):
            found = Shift(f"{abs(places)} sample{'s' * (abs(places) > 1)}", places < 0, before, after)
    return found


def _not_there(labels: Sample, other: Sample) -> Bool[np.ndarray, " n"]:
    """Which objects of a sample have none of another within `STANDING` of their places."""
    from scipy.spatial import cKDTree

    here, there = _boxes_in(labels, other)[:, :3], other.objects.boxes[:, :3]
    if not len(there):
        return np.ones(len(here), bool)
    return np.asarray(cKDTree(there).query(here)[0] > STANDING) if len(here) else np.zeros(0, bool)


def _gain(shift: Shift) -> float:
    return float(shift.after.mean() - shift.before.mean())


def _boxes_in(labels: Sample, cloud: Sample) -> np.ndarray:
    return boxes_through(labels.objects.boxes, invert(cloud.map_SE3_world) @ labels.map_SE3_world)


class Headed(NamedTuple):
    """Boxes that move: of how many of how many tracks, how many head against their way, and no more once undone."""

    tracks: int
    against: int
    of: int


def against_their_way(samples: Sequence[Sample], undo: Callable[[Sample, np.ndarray], np.ndarray]) -> Headed | None:
    """Whether boxes that head against their way head along it once a mistake is undone, and hardly any other way
    round; None where not."""
    tracks: set[int] = set()
    mended = spoilt = total = 0
    for k, sample in enumerate(samples):
        boxes, velocities, ids = movers_in(samples, k)
        before, after = (_cosines(each, velocities) for each in (boxes, undo(sample, boxes)))
        turned = (before < 0) & (after > ALONG)
        tracks |= set(ids[turned].tolist())
        mended, total = mended + int(turned.sum()), total + len(boxes)
        spoilt += int(((before > ALONG) & (after < 0)).sum())
    if len(tracks) < LEAST_TRACKS or mended < LEAST_BOXES or spoilt > mended / 10:
        return None
    return Headed(len(tracks), mended, total)


def _cosines(boxes: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])])
    return np.asarray((ahead * velocities).sum(axis=1) / np.maximum(np.linalg.norm(velocities, axis=1), 1e-9))


class Movers(NamedTuple):
    """Boxes of a sample that move, their velocities (m/s), and their tracks."""

    boxes: Float64[np.ndarray, "n 7"]
    velocities: Float64[np.ndarray, "n 2"]
    ids: Int64[np.ndarray, " n"]


def movers_in(samples: Sequence[Sample], k: int) -> Movers:
    """What moves in sample k, by the nearest sample that has the track too and another time."""
    here = samples[k]
    boxes, velocities, ids = [], [], []
    for row, track in enumerate(here.objects.ids):
        for other in (k + 1, k - 1):
            if not 0 <= other < len(samples):
                continue
            there = samples[other]
            match = np.flatnonzero(there.objects.ids == track)
            seconds = there.time - here.time
            if len(match) == 1 and np.isfinite(seconds) and seconds != 0:
                place = transform(there.map_SE3_world, there.objects.boxes[match, :3])
                path = transform(invert(here.map_SE3_world), place)[0, :2] - here.objects.boxes[row, :2]
                velocity = path / seconds
                if MOVING < np.linalg.norm(velocity) < FASTEST:
                    boxes.append(here.objects.boxes[row])
                    velocities.append(velocity)
                    ids.append(track)
                break
    return Movers(np.array(boxes).reshape(-1, 7), np.array(velocities).reshape(-1, 2), np.array(ids, np.int64))
