"""Figures as words and table cells. They are the same throughout the report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from placement_env.cases import IoUs, iou_text
from placement_env.report.content import CONFIDENCE, Judgement
from placement_env.report.pages.document import NONE, Cell, Column, number

JUDGED_COLUMNS = (
    Column("AP", digits=3),
    Column(f"{CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles", digits=0),
    Column("frames", digits=0),
)


def judged_cells(judged: Judgement | None) -> tuple[Cell | str | float | None, ...]:
    """Values of `JUDGED_COLUMNS`; dashes without anything to detect."""
    if judged is None:
        return None, "no vehicle", None, 0, None
    interval = Cell(interval_text(judged), judged.low)
    return judged.ap, interval, 100 * judged.recall, judged.vehicles, judged.frames


def text_columns(*titles: str) -> tuple[Column, ...]:
    """Columns of texts."""
    return tuple(Column(title, digits=None) for title in titles)


def price_column(title: str, currency: str) -> Column:
    """Column of prices."""
    return Column(title, currency or "units", 2)


def in_percent(share: float | None) -> float | None:
    """Share in percent, for a cell."""
    return None if share is None else 100 * share


def iou_value(iou: IoUs) -> float | str:
    """IoU threshold for a cell; words for several, whose mean counts."""
    return iou if isinstance(iou, float) else iou_text(iou)


def percent(share: float | None) -> str:
    """Format a share in percent. A share that is neither 0 nor 100 % is never rounded to it.

    >>> percent(0.934), percent(0.0004), percent(1.0)
    ('93%', 'under 1%', '100%')
    """
    if share is None or not math.isfinite(share):
        return NONE
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def price_text(price: float, currency: str) -> str:
    """Format a price. Without a currency it is in units of one ordinary pole.

    >>> price_text(1250.0, "EUR"), price_text(1.0, ""), price_text(2.5, "")
    ('1,250 EUR', '1 unit', '2.5 units')
    """
    text = f"{price:,.{0 if price == round(price) else 2}f}"
    if currency:
        return f"{text} {currency}"
    return f"{text.rstrip('0').rstrip('.') if '.' in text else text} unit{'s' * (price != 1)}"


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
    """AP with interval and number of vehicles, without the word AP."""
    return f"{number(judged.ap)} ({interval_text(judged)}, {count_text(judged.vehicles, judged.kind)})"


def list_aps(judged: Iterable[tuple[str, Judgement]]) -> str:
    """AP of each name, for screen readers."""
    return "; ".join(f"{name}: {ap_text(each)}" for name, each in judged)


def interval_text(judged: Judgement) -> str:
    """Both ends of the interval."""
    return f"{number(judged.low)}–{number(judged.high)}"
