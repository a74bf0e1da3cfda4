"""Figures in words and cells, the same way all over the report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from placement_env.cases import IoUs
from placement_env.fidelity.combined.mean_iou import iou_text
from placement_env.report.content import CONFIDENCE, Judgement
from placement_env.report.pages.document import Cell, Column

NONE = "–"  # where a figure is undefined
JUDGED_COLUMNS = (
    Column("AP"),
    Column(f"{CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles"),
    Column("frames"),
)


def number(value: float | None, digits: int = 3) -> str:
    """A figure with so many digits after the point.

    >>> number(0.9), number(None), number(float("nan"))
    ('0.900', '–', '–')
    """
    return f"{value:,.{digits}f}" if value is not None and math.isfinite(value) else NONE


def figure_cell(value: float | None, digits: int = 1) -> Cell:
    """A figure in a table."""
    defined = value is not None and math.isfinite(value)
    return Cell(number(value, digits), value if defined else None)


def iou_cell(iou: IoUs) -> Cell:
    """An IoU threshold, or several over which the mean is taken, in a table."""
    return figure_cell(iou) if isinstance(iou, float) else Cell(iou_text(iou))


def text_cell(text: object) -> Cell:
    """A text in a table."""
    return Cell(str(text))


def percent(share: float | None) -> str:
    """A share in percent: a share that is not 0 or 1 is never rounded to it.

    >>> percent(0.934), percent(0.0004), percent(1.0)
    ('93%', 'under 1%', '100%')
    """
    if share is None or not math.isfinite(share):
        return NONE
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def share_cell(share: float | None) -> Cell:
    """A share in a table, in percent without the sign."""
    return figure_cell(None if share is None else 100 * share)


def price_text(price: float, currency: str) -> str:
    """A price; without a currency in units of one ordinary pole.

    >>> price_text(1250.0, "EUR"), price_text(1.0, ""), price_text(2.5, "")
    ('1,250 EUR', '1 unit', '2.5 units')
    """
    digits = 0 if price == round(price) else 2
    text = f"{price:,.{digits}f}"
    text = text.rstrip("0").rstrip(".") if "." in text and not currency else text
    return f"{text} {currency}" if currency else f"{text} unit{'s' * (price != 1)}"


def price_column(title: str, currency: str) -> Column:
    """A column of prices."""
    return Column(title, currency or "units")


def counted(count: int, noun: str) -> str:
    """A number of things.

    >>> counted(1, "sensor"), counted(1200, "vehicle")
    ('1 sensor', '1,200 vehicles')
    """
    return f"{count:,} {noun}{'s' * (count != 1)}"


def listed(names: Sequence[str]) -> str:
    """Names in a row.

    >>> listed(["a", "b", "c"]), listed(["a"]), listed([])
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
    return f"AP {measured(judged)}"


def measured(judged: Judgement) -> str:
    """An AP with interval and number of vehicles, where it is clear that it is one."""
    return f"{number(judged.ap)} ({interval(judged)}, {counted(judged.vehicles, judged.kind)})"


def interval(judged: Judgement) -> str:
    """Both ends of the interval."""
    return f"{number(judged.low)}–{number(judged.high)}"


def judged_cells(judged: Judgement | None) -> tuple[Cell, ...]:
    """The cells of `JUDGED_COLUMNS`; dashes where nothing was to be detected."""
    if judged is None:
        return (Cell(NONE), Cell("no vehicle"), Cell(NONE), Cell("0", 0.0), Cell(NONE))
    return (
        figure_cell(judged.ap, 3),
        Cell(interval(judged), judged.low),
        share_cell(judged.recall),
        Cell(f"{judged.vehicles:,}", float(judged.vehicles)),
        Cell(f"{judged.frames:,}", float(judged.frames)),
    )
