"""Figures as words: numbers, shares, prices, and AP with its interval."""

import math
from collections.abc import Iterable

from placement_env.report import content
from toolkit.display import describe_count

UNDEFINED_MARK = "–"  # for an undefined figure


def number_text(value: float | None, digits: int = 3) -> str:
    """Format a figure with this many decimals, a dash if it is None, NaN or infinite."""
    return f"{value:,.{digits}f}" if value is not None and math.isfinite(value) else UNDEFINED_MARK


def percent(share: float | None) -> str:
    """Format a share in percent; only an exact 0 or 1 reads 0% or 100%.

    share: from 0 to 1; None, NaN and infinity become a dash."""
    if share is None or not math.isfinite(share):
        return UNDEFINED_MARK
    if 0 < share < 0.01:
        return "under 1%"
    if 0.99 < share < 1:
        return "over 99%"
    return f"{100 * share:.0f}%"


def price_text(price: float, currency: str) -> str:
    """Format a price with its currency, whole or with two decimals.

    currency: "" for units of one ordinary pole, which have no zeros at the end."""
    digits = 0 if price == round(price) else 2
    text = f"{price:,.{digits}f}"
    if currency:
        return f"{text} {currency}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    unit = "unit" if price == 1 else "units"
    return f"{text} {unit}"


def ap_text(judged: content.Judgement) -> str:
    """Format an AP with its interval and number of vehicles."""
    return f"AP {ap_figure(judged)}"


def ap_figure(judged: content.Judgement) -> str:
    """Format an AP with its interval and number of vehicles, without the word AP."""
    return (
        f"{judged.format_ap()} ({interval_text(judged)}, "
        f"{describe_count(judged.vehicles, judged.kind)})"
    )


def list_aps(judgements: Iterable[tuple[str, content.Judgement]]) -> str:
    """List the AP of each name in one text, for screen readers. judgements: names and results."""
    return "; ".join(f"{name}: {ap_text(judgement)}" for name, judgement in judgements)


def interval_text(judged: content.Judgement) -> str:
    """Format both ends of the AP's interval, "no interval" if there is none."""
    if math.isnan(judged.low):
        return "no interval"
    return f"{number_text(judged.low, judged.digits)}–{number_text(judged.high, judged.digits)}"
