"""A search's result in words: sensors, their moves and their figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from placement_env.candidates.candidates import aims
from placement_env.objective import Objective, Score
from placement_env.protocol import Doubting
from placement_env.search.result import Assessment, ProfileAP
from toolkit.sensors.sensor import Sensor


def describe_sensors(names: Sequence[str], moved: Sequence[Sensor] = ()) -> list[str]:
    """Names of sensors, with any new poses (degrees)."""
    if not moved:
        return list(names)
    degrees = np.rad2deg(np.stack(aims(moved), axis=1))
    text = "{} moved to x {:.2f} y {:.2f} z {:.2f} m, heading {:.1f} tilt {:.1f} degrees"
    rows = zip(names, moved, degrees, strict=True)
    return [text.format(name, *sensor.position, *aim) for name, sensor, aim in rows]


def describe_score(score: Score) -> str:
    """The figures of a set in one line."""
    each = ", ".join(f"{name} {ap:.4f}" for name, ap in score.class_ap.items()) if len(score.class_ap) > 1 else ""
    return (
        f"AP {score.ap:.4f}{each and f' ({each})'}, recall {score.recall:.4f}, {score.kbit_per_sensor:.1f} kbit per "
        f"sensor, {score.kbit:.1f} kbit, price {score.price:g} ({score.fidelity})"
    )


def describe_assessment(assessment: Assessment) -> list[str]:
    """Lines on the answer's judgement and each search's own."""
    fresh = "" if assessment.by == "detector" else ", not a detector: it may err alike everywhere"
    sure = "" if assessment.confidence >= assessment.asked else f", short of the {assessment.asked:.0%} asked for"
    lines = [
        f"by the {assessment.by} on {assessment.frames} frames that neither searches nor race saw{fresh}:",
        f"  AP {assessment.ap:.4f} ({assessment.low:.4f} to {assessment.high:.4f}) on {assessment.objects} objects, "
        f"{assessment.kbit:.1f} kbit; predicted {assessment.predicted:.4f}, after the race {assessment.expected:.4f}",
        f"  {assessment.confidence:.0%} sure that none of the {assessment.entrants} entrants is better by more than "
        f"{assessment.tolerance:g}{sure}",
    ]
    if assessment.by_errors:
        lines.append(f"  the {assessment.errors_by} over error profiles: {describe_profiles(assessment.by_errors)}")
    return lines + [
        f"  {' and '.join(each.searches)}: AP {each.ap:.4f} ({each.low:.4f} to {each.high:.4f}), predicted "
        f"{each.predicted:.4f}, overrated by {each.curse:+.4f}"
        for each in assessment.contenders
    ]


def describe_profiles(by_errors: Sequence[ProfileAP]) -> str:
    """AP at each error profile by itself."""
    return ", ".join(f"{each.name} AP {each.ap:.4f} ({each.low:.4f} to {each.high:.4f})" for each in by_errors)


def describe_by_errors(by_errors: Mapping[str, float]) -> list[str]:
    """A line of the AP at each error profile. Empty without error profiles."""
    said = [f"{name} {ap:.4f}" for name, ap in by_errors.items()]
    return [f"AP at each error profile: {', '.join(said)}"] if said else []


def describe_doubts(objective: Objective, subset: Sequence[int]) -> list[str]:
    """Lines on the surrogate's uncertainty about a set and on what it was not trained for. Empty for others."""
    surrogate = objective.scored_by
    if not isinstance(surrogate, Doubting):
        return []
    spread = float(surrogate.spread(objective.row(subset)[None])[0]) if subset else np.nan
    sure = [] if np.isnan(spread) else [f"the surrogate's AP is sure to about {spread:.3f} as far as its fit goes"]
    kinds = {type(sensor.model).__name__ for sensor in objective.candidates.sensors}
    return [*sure, *(f"warning: {doubt}" for doubt in surrogate.doubts(kinds))]


def describe_empty(objective: Objective) -> str:
    """Likely reasons for an empty answer, with remedies."""
    linked = objective.linked
    if not linked.any():
        least, most = float(objective.sent.min()), float(objective.candidates.capacity.max())
        return (
            f"none of the {len(linked)} candidates fits its link: they send {least:.0f} kbit per frame or more, and no "
            f"link carries more than {most:.0f}: give mounts more, or say --scheme late, which sends boxes"
        )
    alone = objective.scores(np.eye(len(linked), dtype=np.bool_)[linked])
    if float(alone.ap.max()) <= 0:
        there = " or a ".join(objective.classes.names)
        return f"no candidate that fits its link detects a {there} in these frames: more --frames, other --candidates?"
    if float(alone.reward.max()) <= 0:
        return "no sensor is worth what it costs: lower --comm and --price"
    return "the search stopped before it had scored a set that may be built: give it more --seconds or --evaluations"


def check_present(objective: Objective) -> None:
    """Raise ValueError where a counted class has no objects."""
    classes, seen = objective.classes, objective.visibility
    if seen is not None:
        there = [bool((seen.labels == label).any()) for label in classes.labels]
    else:
        there = (~np.isnan(objective.class_ap(np.ones((1, len(objective.candidates)), np.bool_))[0])).tolist()
    if missing := [name for name, is_there in zip(classes.names, there, strict=True) if not is_there]:
        raise ValueError(
            f"there is no {' and no '.join(missing)} to find in these frames: say more --frames or another --seed, or "
            "leave out the class"
        )


def describe_exclusions(objective: Objective, max_kbit: float | None = None, currency: str = "") -> tuple[str, ...]:
    """Sentences on what excludes candidates, with their number and the requirement of the least demanding one."""
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
        money, least_price = (describe_money(x, currency) for x in (objective.most_price, candidates.prices.min()))
        excluded = int((~affordable).sum())
        reasons.append(
            f"The sum of {money} excludes {excluded} of {count} candidates: the cheapest of all costs {least_price}."
        )
    return tuple(reasons)


def describe_money(amount: float, currency: str) -> str:
    """A sum in words.

    >>> describe_money(5500.0, "EUR"), describe_money(1.0, ""), describe_money(2.5, "")
    ('5,500 EUR', 'the price of 1 ordinary pole', 'the price of 2.5 ordinary poles')
    """
    if currency:
        return f"{round(amount, 2):,.10g} {currency}"
    return f"the price of {round(amount, 2):g} ordinary {'pole' if amount == 1 else 'poles'}"
