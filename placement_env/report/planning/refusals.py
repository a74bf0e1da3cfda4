"""Refusals: why no set may be built, or none reaches what is required, a sentence for each thing that excludes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from placement_env.cases import iou_text
from placement_env.objective import Objective
from placement_env.report.content import Judgement, PlanOption
from placement_env.report.planning.question import Question
from placement_env.report.planning.sentences import of_what, plural
from placement_env.search.description import describe_money
from toolkit.arrays import Bool


def without_traffic(question: Question) -> tuple[str, ...]:
    """Reasons that need no simulation."""
    if question.sensors == 0:
        return ("The budget is 0 sensors, so there is nothing to build: allow 1 or more.",)
    if not question.site.network:
        return (
            f"Site {question.site.name!r} has no road network, so there is no traffic to plan for: "
            "import one from a map, or build one with toolkit.sites.network.",
        )
    return ()


def without_objects(question: Question, missing: Sequence[str], frames: int, part: str) -> tuple[str, ...]:
    """There was nothing to detect, of some classes that count, in a part of the traffic."""
    return (
        f"No {' and no '.join(missing)} comes into the detection area of site {question.site.name!r} in "
        f"{plural(frames, 'frame')} of {part} traffic: say more --frames, another --seed, or a larger area.",
    )


def buildable(objective: Objective, max_kbit: float | None) -> Bool[np.ndarray, " C"]:
    """Which candidates may be built alone and send no more than is allowed in the mean frame."""
    return np.asarray(objective.allowed([]) & (objective.sent <= (np.inf if max_kbit is None else max_kbit)))


def short_of(question: Question, best: PlanOption, final: Judgement, excluded: tuple[str, ...]) -> tuple[str, ...]:
    """Why the required AP is not reached. best: as it was chosen; final: the same set in the final traffic."""
    price = describe_money(best.price, question.currency)
    reasons = [
        f"The best set found, {plural(len(best.sensors), 'sensor')} for {price}, has AP {final.ap:.3f} "
        f"({final.low:.3f} to {final.high:.3f}){of_what(question)} on "
        f"{plural(final.vehicles, final.kind)} in the final traffic"
        + (f" and {best.counted.ap:.3f} in the traffic it was chosen on" if best.counted else "")
        + f"; {question.min_ap:g} is required at IoU {iou_text(question.iou)}."
    ]
    if question.sensors is not None and len(best.sensors) >= question.sensors:
        reasons.append(f"The budget of {plural(question.sensors, 'sensor')} is used up: more might reach it.")
    if question.money is not None:
        left = describe_money(question.money - best.price, question.currency)
        reasons.append(f"Of {describe_money(question.money, question.currency)} it leaves {left}.")
    return (*reasons, *excluded)
