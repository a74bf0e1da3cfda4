"""Figures as words and table cells. They are the same throughout the report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from placement_env.cases import IoUs, iou_text
from placement_env.report.content import CONFIDENCE, Judgement
from placement_env.report.pages.document import Cell, Column

NONE = "–"  # for an undefined figure
NOTHING_CHOSEN = "No set of sensors may be built, so there is nothing to show here."
JUDGED_COLUMNS = (
    Column("AP"),
    Column(f"{CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles"),
    Column("frames"),
)


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with this many decimals.

    >>> number(0.9), number(None), number(float("nan"))
    ('0.900', '–', '–')
    """
    return f"{value:,.{digits}f}" if value is not None and math.isfinite(value) else NONE


def figure_cell(value: float | None, digits: int = 1) -> Cell:
    """Cell of a figure."""
    defined = value is not None and math.isfinite(value)
    return Cell(number(value, digits), value if defined else None)


def iou_cell(iou: IoUs) -> Cell:
    """Cell of an IoU threshold, or of several. Of several the mean counts."""
    return figure_cell(iou) if isinstance(iou, float) else Cell(iou_text(iou))


def text_cell(text: object) -> Cell:
    """Cell of a text."""
    return Cell(str(text))


def percent(share: float | None) -> str:
    """Format a share in percent.

    A share that is neither 0 nor 100 % is never rounded to it.

    >>> percent(0.934), percent(0.0004), percent(1.0)
    ('93%', 'under 1%', '100%')
    """
    if share is None or not math.isfinite(share):
        return NONE
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def share_cell(share: float | None) -> Cell:
    """Cell of a share, in percent without the sign."""
    return figure_cell(None if share is None else 100 * share)


def price_text(price: float, currency: str) -> str:
    """Format a price.

    Without a currency it is in units of one ordinary pole.

    >>> price_text(1250.0, "EUR"), price_text(1.0, ""), price_text(2.5, "")
    ('1,250 EUR', '1 unit', '2.5 units')
    """
    digits = 0 if price == round(price) else 2
    text = f"{price:,.{digits}f}"
    text = text.rstrip("0").rstrip(".") if "." in text and not currency else text
    return f"{text} {currency}" if currency else f"{text} unit{'s' * (price != 1)}"


def price_column(title: str, currency: str) -> Column:
    """Column of prices."""
    return Column(title, currency or "units")


def count_text(count: int, noun: str) -> str:
    """Number of things, in words.

    >>> count_text(1, "sensor"), count_text(1200, "vehicle")
    ('1 sensor', '1,200 vehicles')
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"


def join_names(names: Sequence[str]) -> str:
    """Names in a row.

    >>> join_names(["a", "b", "c"]), join_names(["a"]), join_names([])
    ('a, b and c', 'a', 'none')
    """
    if len(names) < 2:
        return names[0] if names else "none"
    return f"{', '.join(names[:-1])} and {names[-1]}"


def ap_text(judged: Judgement) -> str:
    """AP with interval and number of vehicles.

    >>> ap_text(Judgement(0.95, 0.91, 0.98, 0.96, 0.97, 40, 20))
    'AP 0.950 (0.910–0.980, 40 vehicles)'
    """
    return f"AP {ap_figure(judged)}"


def ap_figure(judged: Judgement) -> str:
    """AP with interval and number of vehicles. The word AP is left out."""
    return f"{number(judged.ap)} ({interval_text(judged)}, {count_text(judged.vehicles, judged.kind)})"


def interval_text(judged: Judgement) -> str:
    """Both ends of the interval."""
    return f"{number(judged.low)}–{number(judged.high)}"


def format_cells(judged: Judgement | None) -> tuple[Cell, ...]:
    """Cells of `JUDGED_COLUMNS`; dashes without anything to detect."""
    if judged is None:
        return (Cell(NONE), Cell("no vehicle"), Cell(NONE), Cell("0", 0.0), Cell(NONE))
    return (
        figure_cell(judged.ap, 3),
        Cell(interval_text(judged), judged.low),
        share_cell(judged.recall),
        Cell(f"{judged.vehicles:,}", float(judged.vehicles)),
        Cell(f"{judged.frames:,}", float(judged.frames)),
    )
