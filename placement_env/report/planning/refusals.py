"""Refusals: why no set may be built, or none reaches what is required, a sentence for each thing that excludes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from placement_env.fidelity.combined.mean_iou import iou_text
from placement_env.objective import Objective
from placement_env.report.content import Judgement, PlanOption
from placement_env.report.planning.question import Question
from placement_env.report.planning.sentences import money, of_what, plural
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


def check_present(objective: Objective) -> None:
    """Raises ValueError where there is nothing to find of a class that counts, so that nothing is said of it."""
    if missing := absent_classes(objective):
        raise ValueError(
            f"there is no {' and no '.join(missing)} to find in these frames: say more --frames or another --seed, or "
            "leave out the class"
        )


def absent_classes(objective: Objective) -> tuple[str, ...]:
    """Classes that count and of which there is nothing to find."""
    classes, seen = objective.classes, objective.visibility
    if seen is not None:
        return tuple(
            n for n, label in zip(classes.names, classes.labels, strict=True) if not (seen.labels == label).any()
        )
    figures = objective.class_ap(np.ones((1, len(objective.candidates)), np.bool_))[0]
    return tuple(name for name, ap in zip(classes.names, figures, strict=True) if np.isnan(ap))


def buildable(objective: Objective, max_kbit: float | None) -> Bool[np.ndarray, " C"]:
    """Which candidates may be built alone and send no more than is allowed in the mean frame."""
    return np.asarray(objective.allowed([]) & (objective.sent <= (np.inf if max_kbit is None else max_kbit)))


def exclusions(objective: Objective, max_kbit: float | None = None, currency: str = "") -> tuple[str, ...]:
    """What excludes candidates, how many, and what the least demanding of them would take."""
    candidates, sent, linked = objective.candidates, objective.sent, objective.linked
    count, reasons = len(candidates), []
    if not linked.all():
        least = int(np.flatnonzero(~linked)[np.argmin(sent[~linked])])
        reasons.append(
            f"The links exclude {int((~linked).sum())} of {count} candidates: the least that any of these sends is "
            f"{sent[least]:.1f} kbit per frame, over a link of {candidates.capacity[least]:g} kbit."
        )
    if max_kbit is not None and (sent > max_kbit).any():
        reasons.append(
            f"The limit of {max_kbit:g} kbit per sensor and frame excludes {int((sent > max_kbit).sum())} of {count} "
            f"candidates: the least that any candidate sends is {sent.min():.1f} kbit."
        )
    affordable = objective.affordable(candidates.prices)
    if not affordable.all():
        reasons.append(
            f"The sum of {money(objective.most_price, currency)} excludes {int((~affordable).sum())} of {count} "
            f"candidates: the cheapest of all costs {money(float(candidates.prices.min()), currency)}."
        )
    return tuple(reasons)


def short_of(question: Question, best: PlanOption, final: Judgement, excluded: tuple[str, ...]) -> tuple[str, ...]:
    """Why the required AP is not reached. best: as it was chosen; final: the same set in the final traffic."""
    price = money(best.price, question.currency)
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
        left = money(question.money - best.price, question.currency)
        reasons.append(f"Of {money(question.money, question.currency)} it leaves {left}.")
    return (*reasons, *excluded)
