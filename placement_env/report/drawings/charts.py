"""Charts of a plan as SVG text. Where AP is shown, so are its interval and the number of vehicles."""

from __future__ import annotations

from collections.abc import Sequence

from placement_env.report.content import (
    BuildStep,
    FailureCase,
    Judgement,
    LinkLoad,
    PlanOption,
    SchemeFigures,
    SensorWorth,
)
from placement_env.report.drawings.maps import _STUB


def front_chart(options: Sequence[PlanOption], chosen: PlanOption, currency: str) -> str:
    """AP over kbit per sensor and over price; the chosen set is marked."""
    return _STUB


def interval_bars(rows: Sequence[tuple[str, Judgement]], title: str) -> str:
    """AP with its interval and the number of vehicles, a bar for each row."""
    return _STUB


def scheme_chart(schemes: Sequence[SchemeFigures]) -> str:
    """AP of the fusion schemes at each IoU, and what they send."""
    return _STUB


def link_chart(links: Sequence[LinkLoad]) -> str:
    """Mbit/s of each link, mean and greatest frame, against its capacity."""
    return _STUB


def worth_chart(worth: Sequence[SensorWorth]) -> str:
    """Shapley value of each sensor, and how well each two go together."""
    return _STUB


def failure_chart(intact: Judgement, failures: Sequence[FailureCase]) -> str:
    """AP that is left when sensors fail, beside that of the whole set."""
    return _STUB


def order_chart(order: Sequence[BuildStep], currency: str) -> str:
    """AP after each sensor built, over what is spent by then."""
    return _STUB
