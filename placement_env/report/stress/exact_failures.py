"""What is left of all sensors when one or two fail for good, exactly: from a table of the AP of every set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from placement_env.analysis.failures import failures
from placement_env.fidelity.table import Table, class_column
from toolkit.arrays import Bool, Float64
from toolkit.detection.schemes import PAPER_SCHEMES
from toolkit.objects import LABELS, VEHICLE


@dataclass(frozen=True)
class ExactFailure:
    """AP of all sensors, and its mean and least when every `failing` of them fail in turn; without: the names of those
    whose failure leaves the least."""

    scheme: str
    iou: float
    failing: int
    intact: float
    mean: float
    worst: float
    without: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def exact_failures(
    table: Table, *, ious: Sequence[float] = (0.7,), label: str = LABELS[VEHICLE]
) -> tuple[ExactFailure, ...]:
    """N-1 and N-2 of every scheme that the table has, at those IoUs that it has. Raises ValueError where it has none of
    them, or not this class."""
    names = table.origin.sensors
    at = table.origin.ious[table.origin.classes.index(label)] if label in table.origin.classes else table.origin.ious[0]
    known = [iou for iou in ious if iou in at]
    if not known:
        held, asked = (", ".join(map(str, dict.fromkeys(each))) for each in (at, ious))
        raise ValueError(f"this table holds AP at IoU {held}, none of {asked}: say --iou")
    made: list[ExactFailure] = []
    for scheme in PAPER_SCHEMES:
        for iou in known:
            ap = class_column(table, scheme, label, iou)[0]
            for failing in range(1, min(2, len(names)) + 1):
                left = failures(partial(_looked_up, table, ap), np.ones(len(names), bool), failing=failing)
                without = tuple(names[k] for k in left.most_missed)
                made.append(ExactFailure(scheme, iou, failing, left.intact, left.mean, left.worst, without))
    return tuple(made)


def _looked_up(
    table: Table, ap: Float64[np.ndarray, " sets"], sets: Bool[np.ndarray, "n C"]
) -> Float64[np.ndarray, " n"]:
    return ap[table.row(sets)]
