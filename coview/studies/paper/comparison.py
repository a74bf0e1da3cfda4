"""Comparison of one paper experiment with ours: figures side by side, with reasons for large differences.

A reason is put together from measurements of its own row: the share of vehicles on which the sensors have a point,
which no detector can exceed, the share of these that is found, how well the boxes fit, and the AP of the same
detections by the published code's counting. The letters stand for the causes listed on the page; each is measured in
`docs/figures.md` or `docs/model-card.md`, or stated by the paper.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from math import isnan
from pathlib import Path
from typing import Literal, NamedTuple

from coview.studies.paper.published import Relation
from placement_env.analysis.intervals import Interval

LARGE = 0.05  # difference in AP from which a reason is stated
Unit = Literal["AP", "share", "IoU", "kbit", "ms", "points", "rank correlation"]
DIGITS: dict[Unit, int] = {"AP": 4, "share": 4, "IoU": 4, "kbit": 2, "ms": 1, "points": 0, "rank correlation": 3}
BOUND: dict[Relation, str] = {"is": "", "more than": "> ", "less than": "< "}
HEADS = ("unit", "ours", "low", "high", "paper", "difference", "reason")
MOSTLY_COUNTING = 0.6  # share of a difference left by the published counting, below which counting is named first
BOXES_FROM = 0.75  # IoU from which the fit of the boxes matters more than whether a vehicle is seen

TableRow = tuple[str | float, ...]


@dataclass(frozen=True)
class Compared:
    """Figure of ours beside the paper's.

    labels: a cell for each of the experiment's heads; ours, paper: None if missing; interval: of ours; relation: of the
    paper's statement to its figure; an interval that is NaN is None; reason: for a large difference, "" for none.
    """

    labels: tuple[str, ...]
    unit: Unit
    ours: float | None
    paper: float | None
    interval: Interval | None = None
    relation: Relation = "is"
    reason: str = ""

    def __post_init__(self) -> None:
        if self.interval is not None and isnan(self.interval.low):
            object.__setattr__(self, "interval", None)

    @property
    def difference(self) -> float | None:
        """Our figure minus the paper's. 0 if ours keeps a bound in the paper; None if one is missing."""
        if self.ours is None or self.paper is None or isnan(self.ours):
            return None
        difference = self.ours - self.paper
        kept = difference > 0 if self.relation == "more than" else difference < 0
        return 0.0 if kept and self.relation != "is" else difference

    @property
    def large(self) -> bool:
        """True for an AP that differs by more than `LARGE`."""
        return self.unit == "AP" and self.difference is not None and abs(self.difference) > LARGE

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the row as text: labels, unit, ours, interval, paper's, difference, reason."""
        digits = DIGITS[self.unit]
        ours = "–" if self.ours is None or isnan(self.ours) else f"{self.ours:.{digits}f}"
        interval = "–" if self.interval is None else "–".join(f"{end:.{digits}f}" for end in self.interval)
        paper = "–" if self.paper is None else f"{BOUND[self.relation]}{self.paper:.{digits}f}"
        difference = "–" if self.difference is None else f"{self.difference:+.{digits}f}"
        return (*self.labels, self.unit, ours, interval, paper, difference, self.reason)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Experiment of the paper.

    name: of its files; source: place in the paper; heads: of the labels of its rows; basis: data behind our figures;
    conclusion: a sentence or two; draw: writes its picture; curves: more tables by file name, heads first.
    """

    name: str
    title: str
    source: str
    heads: tuple[str, ...]
    rows: tuple[Compared, ...]
    basis: str
    conclusion: str
    draw: Callable[[Path], None]
    curves: tuple[tuple[str, tuple[TableRow, ...]], ...] = ()

    @property
    def csv(self) -> str:
        """Rows as CSV, figures unrounded."""
        rows: list[TableRow] = [(*self.heads, *HEADS)]
        for row in self.rows:
            low, high = row.interval or ("", "")
            figures = ["" if each is None else each for each in (row.ours, low, high, row.paper, row.difference)]
            rows.append((*row.labels, row.unit, *map(str, figures), row.reason))
        return to_csv(rows)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        names = ("unit", "ours", "interval", "paper", "relation", "difference", "reason")
        rows = [
            dict(zip(self.heads, row.labels, strict=True)) | {name: getattr(row, name) for name in names}
            for row in self.rows
        ]
        about = {name: getattr(self, name) for name in ("name", "title", "source", "basis", "conclusion")}
        return about | {"rows": rows}


def to_csv(rows: Sequence[TableRow]) -> str:
    """Format rows of cells as CSV.

    >>> to_csv([("sensors", "AP"), ("0,2,5", 0.5)]).splitlines()
    ['sensors,AP', '"0,2,5",0.5']
    """
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class RowEvidence(NamedTuple):
    """Measurements with the row's sensors; NaN if not measured.

    visible: share of the vehicles with a point; hit_iou: mean IoU of the hits; published: AP by the published protocol.
    """

    visible: float
    recall: float
    hit_iou: float = float("nan")
    published: float = float("nan")


CAUSES = {
    "A": (
        "Detector with few points. Half of the training of the shipped network used random subsets of the sensors "
        "(model card, training). The paper's network was trained on fused clouds of several sensors (section III), yet "
        "it must detect in the clouds of single sensors under late fusion and in small sets. A detector alone can move "
        "AP this far: the classical detector, on the same recordings, has 0.79, 0.84 and 0.94 with late, hybrid and "
        "early fusion at the T-junction and 0.69, 0.81 and 0.85 at the roundabout (figures, first table)."
    ),
    "B": (
        "Fit of the boxes. The shipped network predicts the IoU of its boxes and averages overlapping candidates "
        "(model card), with voxels of 0.2 m at both sites; the paper's network does neither and has voxels of 0.4 m at "
        "the roundabout (section III). On car bodies that it was not trained on, its AP at IoU 0.9 is 0.12 lower at "
        "the T-junction and 0.13 lower at the roundabout (model card); the paper tests on the same twenty CARLA cars "
        "that it trains on."
    ),
    "C": (
        "Place and traffic. The sensors' poses were read off the paper's overview picture (0.5 m, 5°), their tilt is "
        "not published, the heights of houses are plausible guesses, and the traffic is SUMO's with traffic lights, so "
        "that queues stand where sensors 3 and 4 of the T-junction do not look (figures, tables); the paper's is "
        "CARLA's."
    ),
    "D": (
        "Counting. The code published with the paper skips frames without vehicles, lets a stray box invalidate a good "
        "one, and multiplies the IoU of footprints by an overlap of heights; ours is exact. The rows say how the "
        "published code would count our own detections; at IoU 0.9 its counting removes most of the AP."
    ),
}
GIVEN = "The detector is not the shipped one: what the causes say about the shipped network does not apply to it."


def explain_difference(ours: float, paper: float, evidence: RowEvidence, *, iou: float = 0.7) -> str:
    """Explain in one line a difference from the paper's AP, "" if it is no more than `LARGE`.

    >>> explain_difference(0.24, 0.29, RowEvidence(0.25, 0.25))
    ''
    >>> explain_difference(0.24, 0.30, RowEvidence(0.25, 0.245))
    "only 25.0 % of the vehicles have a point here: no detector can reach the paper's figure (C)"
    """
    if isnan(ours) or abs(ours - paper) <= LARGE:
        return ""
    seen = evidence.visible
    found = min(evidence.recall / seen, 1.0) if seen else 0.0
    if seen < paper and ours < paper:
        words = f"only {percent(seen)} of the vehicles have a point here: no detector can reach the paper's figure (C)"
    elif iou > BOXES_FROM:
        fit = "" if isnan(evidence.hit_iou) else f", mean IoU of the hits {evidence.hit_iou:.3f}"
        words = f"{percent(evidence.recall)} of the vehicles are found at this IoU{fit} (B)"
    else:
        cause = "A" if ours > paper else "A, C"
        words = (
            f"{percent(seen)} of the vehicles have a point here and {percent(found)} of these are found; "
            f"the paper's AP is {percent(paper)} ({cause})"
        )
    counted = f"by the published code's counting ours is {evidence.published:.4f} (D)"
    if isnan(evidence.published):
        return words
    mostly = abs(evidence.published - paper) < abs(ours - paper) * MOSTLY_COUNTING
    return f"{counted}; {words}" if mostly else f"{words}; {counted}"


def percent(share: float | None) -> str:
    """Format a share in percent; a dash for None.

    >>> percent(0.254), percent(None)
    ('25.4 %', '–')
    """
    return "–" if share is None else f"{100 * share:.1f} %"
