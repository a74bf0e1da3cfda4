"""Moments: some consecutive frames of the final traffic for pictures and the 3D scene."""

from __future__ import annotations

import numpy as np

from placement_env.fidelity.detector import FALSE_ALARM, IGNORED, Detected
from placement_env.report.content import Moment
from toolkit.arrays import Float32

MOMENTS = 8
POINTS = 2500  # of each sensor in a frame, at most


def moments(
    detected: Detected, chosen: tuple[int, ...], *, count: int = MOMENTS, points: int = POINTS, seed: int = 0
) -> tuple[Moment, ...]:
    """`count` consecutive frames, those with most vehicles to be found; of equal ones the first. points: that stay of
    each sensor's cloud, drawn from the seed."""
    found = np.array([detected.scored(k).sum() for k in range(detected.frames)], np.int64)
    count = min(count, detected.frames)
    sums = np.convolve(found, np.ones(count, np.int64), mode="valid")
    first = int(sums.argmax())
    return tuple(_moment(detected, chosen, k, points, seed) for k in range(first, first + count))


def _moment(detected: Detected, chosen: tuple[int, ...], k: int, points: int, seed: int) -> Moment:
    outcome = detected.outcomes([chosen], [k])[chosen][0]
    truth = outcome.truth[detected.ious.index(detected.iou)]
    objects, scored = detected.renders.objects(k), detected.scored(k)
    hit = np.zeros(len(objects), np.bool_)
    hit[np.flatnonzero(scored)[truth[truth > FALSE_ALARM]]] = True
    clouds = tuple(thinned(detected.renders.clouds(k, c), points, [seed, k, c]) for c in chosen)
    return Moment(clouds, objects, detected.detections(chosen, k), hit, ~scored, truth >= 0, truth == IGNORED)


def thinned(cloud: Float32[np.ndarray, "n 3"], points: int, seed: list[int]) -> Float32[np.ndarray, "m 3"]:
    """At most so many points of a cloud, drawn at random, in their order."""
    if len(cloud) <= points:
        return cloud
    return cloud[np.sort(np.random.default_rng(seed).choice(len(cloud), points, replace=False))]
