"""`Experiment`: one of the paper's experiments as rows of figures, ours beside the paper's, and how it is drawn."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from io import StringIO
from math import isnan
from pathlib import Path
from typing import Any, Literal

from placement_env.analysis.intervals import Interval
from placement_env.report.paper.published import Relation

LARGE = 0.05  # difference in AP from which on a reason is stated
Unit = Literal["AP", "share", "IoU", "kbit", "ms", "points", "rank correlation"]
DIGITS: dict[Unit, int] = {"AP": 4, "share": 4, "IoU": 4, "kbit": 2, "ms": 1, "points": 0, "rank correlation": 3}
BOUND: dict[Relation, str] = {"is": "", "more than": "> ", "less than": "< "}
HEADS = ("unit", "ours", "low", "high", "paper", "difference", "reason")


@dataclass(frozen=True)
class Compared:
    """One figure. labels: which it is, a cell for each of the experiment's heads; ours, paper: None where there is
    none; interval: of ours; relation: what the paper says of its figure; reason: of a large difference, "" for none."""

    labels: tuple[str, ...]
    unit: Unit
    ours: float | None
    paper: float | None
    interval: Interval | None = None
    relation: Relation = "is"
    reason: str = ""

    @property
    def difference(self) -> float | None:
        """Ours less the paper's; 0 where the paper gives a bound that ours keeps; None where one is missing."""
        if self.ours is None or self.paper is None or isnan(self.ours):
            return None
        difference = self.ours - self.paper
        kept = {"is": False, "more than": difference > 0, "less than": difference < 0}
        return 0.0 if kept[self.relation] else difference

    @property
    def large(self) -> bool:
        """Whether it is an AP that differs by more than `LARGE`."""
        return self.unit == "AP" and self.difference is not None and abs(self.difference) > LARGE

    @property
    def cells(self) -> tuple[str, ...]:
        """The row for people: labels, ours, interval, paper's, difference, reason."""
        digits, blank = DIGITS[self.unit], "–"
        ours = blank if self.ours is None or isnan(self.ours) else f"{self.ours:.{digits}f}"
        interval = blank if self.interval is None else "–".join(f"{end:.{digits}f}" for end in self.interval)
        paper = blank if self.paper is None else f"{BOUND[self.relation]}{self.paper:.{digits}f}"
        difference = blank if self.difference is None else f"{self.difference:+.{digits}f}"
        return (*self.labels, self.unit, ours, interval, paper, difference, self.reason)


@dataclass(frozen=True, eq=False)
class Experiment:
    """name: of its files; source: where in the paper; heads: what the labels of its rows say; basis: what ours is
    measured on; conclusion: a sentence or two; draw: writes its picture; curves: more data by file name, heads first.
    """

    name: str
    title: str
    source: str
    heads: tuple[str, ...]
    rows: tuple[Compared, ...]
    basis: str
    conclusion: str
    draw: Callable[[Path], None]
    curves: tuple[tuple[str, tuple[tuple[Any, ...], ...]], ...] = ()

    @property
    def csv(self) -> str:
        """The rows as CSV, numbers whole."""
        rows = [(*self.heads, *HEADS)]
        for row in self.rows:
            low, high = row.interval or ("", "")
            figures = ["" if each is None else each for each in (row.ours, low, high, row.paper, row.difference)]
            rows.append((*row.labels, row.unit, *map(str, figures), row.reason))
        return as_csv(rows)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        rows = [
            dict(zip(self.heads, row.labels, strict=True))
            | {"unit": row.unit, "ours": row.ours, "interval": row.interval, "paper": row.paper}
            | {"relation": row.relation, "difference": row.difference, "reason": row.reason}
            for row in self.rows
        ]
        about = {"name": self.name, "title": self.title, "source": self.source, "basis": self.basis}
        return about | {"conclusion": self.conclusion, "rows": rows}


def as_csv(rows: list[tuple[Any, ...]]) -> str:
    """Rows of cells as CSV.

    >>> as_csv([("sensors", "AP"), ("0,2,5", 0.5)]).splitlines()
    ['sensors,AP', '"0,2,5",0.5']
    """
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
