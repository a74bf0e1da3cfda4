"""What became of detections and labels: hits, misses and false alarms, by the rules of `coview evaluate --layout`.

A detection is true where its IoU by volume with a label of its class, which no surer detection took, is at least
`toolkit.detection.metrics.TRUE_IOU`. Labels without a point, and what lies where the labels are not complete, are
neither missed nor false (`toolkit.detection.samples.scoring`).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from toolkit.arrays import Float64
from toolkit.detection.metrics import TRUE_IOU, match
from toolkit.detection.samples.detected import Detected
from toolkit.detection.samples.scoring import judged
from toolkit.objects import LABELS
from toolkit.plots.palette import Outcome

Marked = Literal["hits", "missed", "false alarms"]
MARKED: dict[Marked, Outcome] = {"hits": "hit", "missed": "missed", "false alarms": "false alarm"}

BoxesByKind = dict[str, Float64[np.ndarray, "_ 7"]]


def outcomes_of(each: Detected, half: tuple[float, float]) -> dict[Marked, BoxesByKind]:
    """Boxes of each outcome and class, world frame; none where nothing is labelled. half: of the area's sides (m)."""
    made: dict[Marked, BoxesByKind] = {name: {} for name in MARKED}
    if not len(each.sample.objects):
        return {}
    scored = judged(each, half)
    for label, name in enumerate(LABELS):
        what = match(scored.found, scored.truths, TRUE_IOU[label], label=label, counted=scored.counted)
        rows = {
            "hits": scored.found.boxes[~what.ignored & (what.truth >= 0)],
            "missed": scored.truths.boxes[what.scored & ~what.hit],
            "false alarms": scored.found.boxes[~what.ignored & (what.truth < 0)],
        }
        for outcome, so_far in made.items():
            so_far |= {name: rows[outcome]} if len(rows[outcome]) else {}
    return made
