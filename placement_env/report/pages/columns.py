"""Columns and cells that several tables of the report share."""

from placement_env.analysis.intervals import is_comparable
from placement_env.cases import IoUs, iou_text
from placement_env.report import content
from placement_env.report.pages.document import Cell, Column
from placement_env.report.pages.figure_texts import interval_text

JUDGED_COLUMNS = (
    Column("AP", digits=3),
    Column(f"{content.CONFIDENCE:.0%} interval"),
    Column("found", "%"),
    Column("vehicles", digits=0),
    Column("frames", digits=0),
)


def judgement_cells(judged: content.Judgement | None) -> tuple[Cell | str | float | None, ...]:
    """Return the values of `JUDGED_COLUMNS`, undefined if there is nothing to detect.

    Cells of AP and interval are sorted by their numbers, not by their texts.

    judged: None if there is no vehicle to detect."""
    if judged is None:
        return None, "no vehicle", None, 0, None
    ap = Cell(judged.format_ap(), judged.ap)
    interval = Cell(interval_text(judged), judged.low)
    return ap, interval, judged.recall, judged.vehicles, judged.frames


def text_columns(*titles: str) -> tuple[Column, ...]:
    """Return a column of texts for each title."""
    return tuple(Column(title, digits=None) for title in titles)


def price_column(title: str, currency: str) -> Column:
    """Return a column of prices with two decimals. currency: "" for units of an ordinary pole."""
    return Column(title, currency or "units", 2)


def iou_value(iou: IoUs) -> float | str:
    """Return an IoU threshold as a number for a cell, or in words for several thresholds."""
    return iou if isinstance(iou, float) else iou_text(iou)


def is_comparable_judgement(judged: content.Judgement) -> bool:
    """Return True if an AP has an interval, and enough frames and road users to be compared."""
    return judged.known and is_comparable(judged.frames, judged.vehicles)
