"""AP with an interval over the ways of true objects.

A way is one object of one recording. Frames of one way are not independent, so ways are drawn with
replacement, a way's hits and frames as often as it is drawn. False alarms stay as they are."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.detection.metrics import matches
from toolkit.objects import Detections, Objects

DRAWS = 200
LEVELS = (5.0, 95.0)  # percentiles of the interval
WAY_STEP = 2**32  # between the numbers of two recordings


class PooledHits(NamedTuple):
    """Detections of a class in all frames at one IoU, in descending order of their scores.

    Attributes:
        ways: Way that each detection hit, -1 for a false alarm.
        scores: Score of each.
        truths: Way of each object to find, in each frame."""

    ways: Int64[np.ndarray, " n"]
    scores: Float64[np.ndarray, " n"]
    truths: Int64[np.ndarray, " m"]

    @staticmethod
    def pool(parts: "Sequence[PooledHits]") -> "PooledHits":
        """Pool the detections of several recordings, whose ways become different."""
        ways = []
        truths = []
        for number, part in enumerate(parts):
            offset = number * WAY_STEP
            ways.append(np.where(part.ways >= 0, part.ways + offset, -1))
            truths.append(part.truths + offset)
        scores = np.concatenate([part.scores for part in parts])
        order = np.argsort(-scores, kind="stable")
        return PooledHits(np.concatenate(ways)[order], scores[order], np.concatenate(truths))


def collect_hits(
    frames: Sequence[Detections], truths: Sequence[Objects], label: int, iou: float
) -> PooledHits:
    """Match the detections of a recording with its objects, frame by frame."""
    ways = [np.zeros(0, np.int64)]
    scores = [np.zeros(0)]
    found = [np.zeros(0, np.int64)]
    for detections, objects in zip(frames, truths, strict=True):
        (match,) = matches(detections, objects, [iou], label=label)
        rows = np.flatnonzero(~match.ignored)
        truth = match.truth[rows]
        ids = np.append(objects.ids, -1)  # the last one for false alarms
        ways.append(ids[truth])
        scores.append(detections.scores[rows])
        found.append(objects.ids[match.scored])
    return PooledHits(np.concatenate(ways), np.concatenate(scores), np.concatenate(found))


def measure_ap(hits: PooledHits, counts: dict[int, int] | None = None) -> float:
    """AP of pooled detections.

    counts: how often each way counts, 1 for all if None. Ties of scores are broken by order."""
    names, frames = np.unique(hits.truths, return_counts=True)
    weights = np.ones(len(names))
    if counts is not None:
        weights = np.array([counts.get(name, 0) for name in names.tolist()], np.float64)
    total = float((weights * frames).sum())
    if not total:
        return float("nan")
    is_hit = hits.ways >= 0
    position = np.searchsorted(names, hits.ways[is_hit])
    gained = np.zeros(len(hits.ways))
    gained[is_hit] = weights[position]
    true_positives = np.cumsum(gained)
    false_alarms = np.cumsum(~is_hit)
    everything = np.maximum(true_positives + false_alarms, 1e-9)
    precision = np.maximum.accumulate((true_positives / everything)[::-1])[::-1]
    return float((gained * precision).sum() / total)


def interval(hits: PooledHits, seed: int = 0) -> tuple[float, float]:
    """Percentiles `LEVELS` of AP over draws of the ways."""
    rng = np.random.default_rng(seed)
    names = np.unique(hits.truths)
    aps = []
    for _ in range(DRAWS):
        drawn, times = np.unique(rng.choice(names, len(names)), return_counts=True)
        counts = dict(zip(drawn.tolist(), times.tolist(), strict=True))
        aps.append(measure_ap(hits, counts))
    low, high = np.percentile(aps, LEVELS).tolist()
    return low, high
