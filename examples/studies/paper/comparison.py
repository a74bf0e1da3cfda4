"""Comparison of a paper's experiment with ours, with reasons for large differences.

A reason consists of measurements of its row: the share of vehicles on which the sensors have a
point, which no detector can exceed, the share of these vehicles that is found, how well the boxes
fit, and the AP of the same detections as the published code counts. The letters refer to the causes
listed on the page; each cause is measured in `docs/figures.md` or `docs/model-card.md`, or stated
by the paper."""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from math import isnan
from pathlib import Path
from typing import Literal, NamedTuple

from examples.studies.paper.paper_rows import Relation
from placement_env.analysis.intervals import Interval
from toolkit.frozen import set_fields

LARGE_AP_DIFFERENCE = 0.05  # a reason is given for larger differences
MAX_COUNTING_SHARE = 0.6  # counting comes first in a reason if it leaves less of the difference
MIN_BOX_IOU = 0.75  # from which the fit of the boxes matters more than whether vehicles are seen
HEADS = ("unit", "ours", "low", "high", "paper", "difference", "reason")
Unit = Literal["AP", "share", "IoU", "kbit", "ms", "points", "rank correlation"]
DIGITS: dict[Unit, int] = {
    "AP": 4,
    "share": 4,
    "IoU": 4,
    "kbit": 2,
    "ms": 1,
    "points": 0,
    "rank correlation": 3,
}
BOUND: dict[Relation, str] = {"is": "", "more than": "> ", "less than": "< "}
TableRow = tuple[str | float, ...]


@dataclass(frozen=True)
class Compared:
    """One of our figures and the paper's.

    Attributes:
        labels: A cell for each of the experiment's heads.
        unit: Unit of both figures.
        ours: Our figure, None if missing.
        paper: The paper's figure, None if missing.
        interval: Interval of our figure; an interval that is NaN becomes None.
        relation: "is" if the paper states its figure, or "more than" or "less than" for a bound.
        reason: Reason for a large difference, "" without one."""

    labels: tuple[str, ...]
    unit: Unit
    ours: float | None
    paper: float | None
    interval: Interval | None = None
    relation: Relation = "is"
    reason: str = ""

    def __post_init__(self) -> None:
        if self.interval is not None and isnan(self.interval.low):
            set_fields(self, interval=None)

    @property
    def difference(self) -> float | None:
        """Our figure minus the paper's.

        It is 0 if our figure keeps a bound in the paper, None if a figure is missing."""
        if self.ours is None or self.paper is None or isnan(self.ours):
            return None
        difference = self.ours - self.paper
        keeps_bound = difference > 0 if self.relation == "more than" else difference < 0
        return 0.0 if keeps_bound and self.relation != "is" else difference

    @property
    def large(self) -> bool:
        """True for an AP that differs by more than `LARGE_AP_DIFFERENCE`."""
        if self.unit != "AP" or self.difference is None:
            return False
        return abs(self.difference) > LARGE_AP_DIFFERENCE

    @property
    def cells(self) -> tuple[str, ...]:
        """The row as text: labels, unit, ours, interval, paper's, difference, reason."""
        digits = DIGITS[self.unit]
        ours = "–" if self.ours is None or isnan(self.ours) else f"{self.ours:.{digits}f}"
        interval = "–"
        if self.interval is not None:
            interval = f"{self.interval.low:.{digits}f}–{self.interval.high:.{digits}f}"
        paper = "–" if self.paper is None else f"{BOUND[self.relation]}{self.paper:.{digits}f}"
        difference = "–" if self.difference is None else f"{self.difference:+.{digits}f}"
        return (*self.labels, self.unit, ours, interval, paper, difference, self.reason)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Experiment of the paper.

    Attributes:
        name: Name of its files.
        title: Title.
        source: Table or figure, and section, of the paper.
        heads: Heads of the labels of its rows.
        rows: Our figures and the paper's.
        basis: Data behind our figures.
        conclusion: Conclusion in a sentence or two.
        draw: Function that writes its picture to a path.
        curves: More tables, each with the name of its file, and rows with the heads first."""

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
            values = (row.ours, low, high, row.paper, row.difference)
            figures = ["" if value is None else str(value) for value in values]
            rows.append((*row.labels, row.unit, *figures, row.reason))
        return to_csv(rows)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        rows = []
        for row in self.rows:
            values: dict[str, object] = dict(zip(self.heads, row.labels, strict=True))
            for name in ("unit", "ours", "interval", "paper", "relation", "difference", "reason"):
                values[name] = getattr(row, name)
            rows.append(values)
        return {
            "name": self.name,
            "title": self.title,
            "source": self.source,
            "basis": self.basis,
            "conclusion": self.conclusion,
            "rows": rows,
        }


def to_csv(rows: Sequence[TableRow]) -> str:
    """Format rows of cells as CSV."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class RowEvidence(NamedTuple):
    """Measurements with the row's sensors, NaN if not measured.

    Attributes:
        visible: Share of the vehicles with a point.
        recall: Share of the vehicles that are found.
        hit_iou: Mean IoU of the hits.
        published: AP by the published protocol.
    """

    visible: float
    recall: float
    hit_iou: float = float("nan")
    published: float = float("nan")


def explain_difference(
    ours: float, paper: float, evidence: RowEvidence, *, iou: float = 0.7
) -> str:
    """Explain in one line a difference from the paper's AP.

    ours, paper: both AP at the threshold `iou`. Letters in the text are the causes on the page.
    Returns "" if the difference is no more than `LARGE_AP_DIFFERENCE`."""
    if isnan(ours) or abs(ours - paper) <= LARGE_AP_DIFFERENCE:
        return ""
    visible_share = evidence.visible
    found_share = min(evidence.recall / visible_share, 1.0) if visible_share else 0.0
    if visible_share < paper and ours < paper:
        words = (
            f"only {percent(visible_share)} of the vehicles have a point here: no detector can "
            "reach the paper's figure (C)"
        )
    elif iou > MIN_BOX_IOU:
        fit = "" if isnan(evidence.hit_iou) else f", mean IoU of the hits {evidence.hit_iou:.3f}"
        words = f"{percent(evidence.recall)} of the vehicles are found at this IoU{fit} (B)"
    else:
        cause = "A" if ours > paper else "A, C"
        words = (
            f"{percent(visible_share)} of the vehicles have a point here and "
            f"{percent(found_share)} of these are found; the paper's AP is {percent(paper)} "
            f"({cause})"
        )
    if isnan(evidence.published):
        return words
    counting = f"by the published code's counting ours is {evidence.published:.4f} (D)"
    remaining = abs(evidence.published - paper)
    if remaining < abs(ours - paper) * MAX_COUNTING_SHARE:
        return f"{counting}; {words}"
    return f"{words}; {counting}"


def percent(share: float | None) -> str:
    """Format a share in percent; a dash for None."""
    return "–" if share is None else f"{100 * share:.1f} %"
