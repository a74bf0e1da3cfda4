"""Fit of boxes to the points of a frame, and the boxes that move.

A correct box has points just within its faces, none in its middle and nothing close around it but
ground. The fit of a box is the share of its points (those at least `CLEARANCE` above the ground)
that lie there, of all within the box and `SHELL` around it. A box with hardly any points has a fit
of 0."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from toolkit.arrays import BoxRows, Float, Float64, Int64, Points
from toolkit.boxes import count_points
from toolkit.calibration.ground import Ground, level
from toolkit.frame import Frame
from toolkit.geometry import invert, transform

CLEARANCE = 0.3  # m above the ground
SHELL = 0.5  # m
SLACK = 0.1  # m that a point may lie outside its box, as sensors err
HOLLOW = 0.6  # inner fraction of a box's length and width, where no sensor sees a vehicle
LEAST_ON_BOX = 15  # points in and around a box; its fit is 0 below this
LEAST_BOXES = 5  # boxes with a fit; nothing is suspected below this
STANDARD_ERRORS = 3.0  # least mean change of fits for a suspicion, in standard errors
GAIN = 0.02  # least gain in mean fit for a suspicion
GROUND_POINTS = 20_000  # evenly spaced points of a cloud for finding its ground
SHIFTS_S = (0.05, 0.1, 0.2, 0.3, 0.5, 1.0)  # tried delays of labels and clouds, late or early
MOVING = 2.0  # m/s
FASTEST = 60.0  # m/s: a faster track has jumped


@dataclass(frozen=True, eq=False)
class Seen:
    """Frame, its points above the ground, and the ground if found."""

    sample: Frame
    points: Float64[np.ndarray, "n 3"]
    ground: Ground | None = None

    @staticmethod
    def of(sample: Frame) -> "Seen":
        """Find the ground of a frame."""
        points = sample.points()
        try:
            ground = level(points[:: max(1, len(points) // GROUND_POINTS)], method="map")
        except ValueError:
            return Seen(sample, points)
        seen = Seen(sample, points, ground)
        return Seen(sample, seen.above_ground(points), ground)

    def above_ground(self, points: Points) -> Float64[np.ndarray, "_ 3"]:
        """Points (world frame) at least `CLEARANCE` above the ground, all if there is no ground."""
        if self.ground is None:
            return np.asarray(points, np.float64)
        return points[points[:, 2] - self.ground.height(points[:, :2]) > CLEARANCE]


def fits(some: Sequence[Seen], boxes: Sequence[np.ndarray]) -> Float64[np.ndarray, " n"]:
    """Fit of each frame's boxes (m, 7), one after another."""
    parts = [
        measure_fits(each.points, own) for each, own in zip(some, boxes, strict=True) if len(own)
    ]
    return np.concatenate([np.zeros(0), *parts])


def measure_fits(points: Points, boxes: Float[np.ndarray, "m 7"]) -> Float64[np.ndarray, " m"]:
    """Fit of boxes to points that stand on the ground."""
    around = np.array([0, 0, 0.5, 2, 2, 1, 0])  # one metre more on all sides and above
    hollow = boxes * [1, 1, 1, HOLLOW, HOLLOW, 1, 1] - np.array([0, 0, SLACK, 0, 0, 2 * SLACK, 0])
    hollow[:, 5] = np.maximum(hollow[:, 5], 1e-6)
    every = np.concatenate([boxes + SHELL * around, boxes + SLACK * around, hollow])
    near, on, inner = count_points(points, every).reshape(3, -1)
    return np.where(near >= LEAST_ON_BOX, (on - inner) / np.maximum(near, 1), 0.0)


def better(
    before: Float64[np.ndarray, " n"], after: Float64[np.ndarray, " n"], gain: float = GAIN
) -> bool:
    """True if boxes fit better by `gain` and beyond chance."""
    change = (after - before)[(after > 0) | (before > 0)]
    if len(change) < LEAST_BOXES or change.mean() < gain:
        return False
    return bool(change.mean() >= STANDARD_ERRORS * change.std() / np.sqrt(len(change)))


class Movers(NamedTuple):
    """Moving boxes of a frame, their velocities (m/s) and tracks."""

    boxes: BoxRows
    velocities: Float64[np.ndarray, "n 2"]
    ids: Int64[np.ndarray, " n"]


def find_movers(samples: Sequence[Frame], k: int) -> Movers:
    """Find the moving boxes of frame k by neighbours' tracks."""
    here = samples[k]
    rows = list[int]()
    velocities = list[np.ndarray]()
    for row, track in enumerate(here.objects.ids):
        for there in (samples[other] for other in (k + 1, k - 1) if 0 <= other < len(samples)):
            match = np.flatnonzero(there.objects.ids == track)
            seconds = there.time - here.time
            if len(match) == 1 and np.isfinite(seconds) and seconds != 0:
                place = transform(there.map_SE3_world, there.objects.boxes[match, :3])
                path = (
                    transform(invert(here.map_SE3_world), place)[0, :2]
                    - here.objects.boxes[row, :2]
                )
                if MOVING < np.linalg.norm(path / seconds) < FASTEST:
                    rows.append(row)
                    velocities.append(path / seconds)
                break
    moving = np.array(rows, np.int64)
    return Movers(
        here.objects.boxes[moving], np.array(velocities).reshape(-1, 2), here.objects.ids[moving]
    )
