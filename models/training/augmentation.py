"""Augmentations of whole scenes: fewer points, and ground that lies a little off zero or slopes."""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Float, Float32

FEWEST_KEPT = 0.1  # share of the points
LIFT = 0.07  # m, deviation of the ground's height; surveys and imported sites are so far off
SLOPE = 0.006  # deviation of the ground's slope along x and along y; at 20 m that is 12 cm


def thinned(points: Float32[np.ndarray, "n 3"], rng: np.random.Generator) -> Float32[np.ndarray, "k 3"]:
    """A random share of the points, from a tenth to all of them."""
    return points[rng.random(len(points)) < rng.uniform(FEWEST_KEPT, 1.0)]


def tilted(
    points: Float32[np.ndarray, "n 3"],
    boxes: Float[np.ndarray, "m 7"],
    centre: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "n 3"], Float[np.ndarray, "m 7"]]:
    """Everything on ground that is lifted by N(0, 7 cm) and slopes by N(0, 0.6 %) along x and along y about `centre`.
    Boxes stay upright."""
    lift, slope = rng.normal(0, LIFT), rng.normal(0, SLOPE, 2)
    points, boxes = points.copy(), boxes.copy()
    points[:, 2] += lift + (points[:, :2] - centre) @ slope
    boxes[:, 2] += lift + (boxes[:, :2] - centre) @ slope
    return points, boxes
