"""How well boxes fit the points of their cloud, and whether other boxes fit better by more than chance explains.

A box that is right has points just within its faces, none in the middle of it and nothing close around it but ground.
The fit of a box is the share of its points (those no lower than `CLEARANCE` above the ground) that lie there, of all
within the box and `SHELL` it; a box that has hardly any has a fit of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.boxes import points_in_boxes
from toolkit.calibration.ground import Ground, level
from toolkit.datasets.sample import Sample

CLEARANCE = 0.3  # m above the ground
SHELL = 0.5  # m
SLACK = 0.1  # m that a point may lie outside its box, as sensors err
HOLLOW = 0.6  # of a box's length and width, in which a sensor sees nothing of a vehicle
LEAST_ON_BOX = 15  # points in and around a box, below which its fit is 0
LEAST_BOXES = 5  # with a fit, below which nothing is said
STANDARD_ERRORS = 3.0  # of the mean change of fits, from which on a mistake is suspected
GAIN = 0.02  # of the mean fit, that there must be as well
GROUND_POINTS = 20_000  # of a cloud, evenly taken, among which its ground is looked for


@dataclass(frozen=True, eq=False)
class Seen:
    """A sample, its points that stand on the ground, and that ground; all its points and None where there is none."""

    sample: Sample
    points: Float64[np.ndarray, "n 3"]
    ground: Ground | None = None

    @staticmethod
    def of(sample: Sample) -> Seen:
        """A sample with its ground found."""
        points = sample.points()
        try:
            ground = level(points[:: max(1, len(points) // GROUND_POINTS)], method="map")
        except ValueError:
            return Seen(sample, points)
        standing = points[points[:, 2] - ground.height(points[:, :2]) > CLEARANCE]
        return Seen(sample, standing, ground)

    def heights(self, boxes: Float64[np.ndarray, "m 7"]) -> Float64[np.ndarray, " _"]:
        """How high (m) the centres of boxes are above the ground; of none where there is no ground."""
        return np.zeros(0) if self.ground is None else boxes[:, 2] - self.ground.height(boxes[:, :2])


def fits(some: Sequence[Seen], boxes: Sequence[np.ndarray]) -> Float64[np.ndarray, " n"]:
    """The fit of every box, (m, 7) of each sample, of all samples one after the other."""
    parts = [fits_in(each.points, own) for each, own in zip(some, boxes, strict=True) if len(own)]
    return np.concatenate([np.zeros(0), *parts])


def fits_in(points: Float[np.ndarray, "n 3"], boxes: Float[np.ndarray, "m 7"]) -> Float64[np.ndarray, " m"]:
    """The fit of every box to points that stand on the ground."""
    wide = boxes + np.array([0, 0, SHELL / 2, 2 * SHELL, 2 * SHELL, SHELL, 0])
    inside = points_in_boxes(points, wide)
    fitting = np.zeros(len(boxes))
    for k, (x, y, z, length, width, height, yaw) in enumerate(boxes):
        near = points[inside[:, k]]
        if len(near) < LEAST_ON_BOX:
            continue
        dx, dy, dz = (near - [x, y, z]).T
        ahead, aside = np.abs(dx * np.cos(yaw) + dy * np.sin(yaw)), np.abs(dy * np.cos(yaw) - dx * np.sin(yaw))
        in_box = (ahead <= length / 2 + SLACK) & (aside <= width / 2 + SLACK) & (dz <= height / 2 + SLACK)
        inner = (ahead < HOLLOW * length / 2) & (aside < HOLLOW * width / 2) & (dz < height / 2 - 2 * SLACK)
        fitting[k] = (in_box & ~inner).mean()
    return fitting


def better(before: Float64[np.ndarray, " n"], after: Float64[np.ndarray, " n"], gain: float = GAIN) -> bool:
    """Whether boxes fit better, by `gain` at least and by more than chance explains.

    >>> better(np.full(9, 0.2), np.full(9, 0.8)), better(np.full(9, 0.8), np.full(9, 0.2))
    (True, False)
    """
    change = (after - before)[(after > 0) | (before > 0)]
    if len(change) < LEAST_BOXES or change.mean() < gain:
        return False
    return bool(change.mean() >= STANDARD_ERRORS * change.std() / np.sqrt(len(change)))
