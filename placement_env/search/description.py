"""A search's result in words: its sensors, where they were moved to, its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from placement_env.candidates.candidates import aims
from placement_env.objective import Objective, Score
from placement_env.protocol import Doubting
from placement_env.search.result import Assessment, ProfileAP
from toolkit.sensors.sensor import Sensor


def described_sensors(names: Sequence[str], moved: Sequence[Sensor] = ()) -> list[str]:
    """Names of sensors, with where they were moved to, if they were (degrees)."""
    if not moved:
        return list(names)
    degrees = np.rad2deg(np.stack(aims(moved), axis=1))
    where = [(*sensor.position, *aim) for sensor, aim in zip(moved, degrees, strict=True)]
    text = "{} moved to x {:.2f} y {:.2f} z {:.2f} m, heading {:.1f} tilt {:.1f} degrees"
    return [text.format(name, *numbers) for name, numbers in zip(names, where, strict=True)]


def described_score(score: Score) -> str:
    """The figures of a set in one line."""
    each = ", ".join(f"{name} {ap:.4f}" for name, ap in score.class_ap.items()) if len(score.class_ap) > 1 else ""
    return (
        f"AP {score.ap:.4f}{each and f' ({each})'}, recall {score.recall:.4f}, {score.kbit_per_sensor:.1f} kbit per "
        f"sensor, {score.kbit:.1f} kbit, price {score.price:g} ({score.fidelity})"
    )


def described_assessment(assessment: Assessment) -> list[str]:
    """What a portfolio's judge says of the answer and of each search's own, a line each."""
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
        lines.append(f"  the {assessment.errors_by} over error profiles: {described_profiles(assessment.by_errors)}")
    return lines + [
        f"  {' and '.join(each.searches)}: AP {each.ap:.4f} ({each.low:.4f} to {each.high:.4f}), predicted "
        f"{each.predicted:.4f}, overrated by {each.curse:+.4f}"
        for each in assessment.contenders
    ]


def described_profiles(by_errors: Sequence[ProfileAP]) -> str:
    """AP at each error profile by itself."""
    return ", ".join(f"{each.name} AP {each.ap:.4f} ({each.low:.4f} to {each.high:.4f})" for each in by_errors)


def described_by_errors(by_errors: Mapping[str, float]) -> list[str]:
    """A line of the AP at each error profile; none where there are none."""
    said = ", ".join(f"{name} {ap:.4f}" for name, ap in by_errors.items())
    return [f"AP at each error profile: {said}"] if said else []


def described_doubts(objective: Objective, subset: Sequence[int]) -> list[str]:
    """How sure a surrogate is of a set, and where it is asked about something else than it was fitted to, a line each;
    none for other fidelities."""
    surrogate = objective.scored_by
    if not isinstance(surrogate, Doubting):
        return []
    spread = float(surrogate.spread(objective.row(subset)[None])[0]) if subset else np.nan
    sure = [] if np.isnan(spread) else [f"the surrogate's AP is sure to about {spread:.3f} as far as its fit goes"]
    kinds = {type(sensor.model).__name__ for sensor in objective.candidates.sensors}
    return [*sure, *(f"warning: {doubt}" for doubt in surrogate.doubts(kinds))]


def described_empty(objective: Objective) -> str:
    """Why a search may have answered with no sensor, and what to change."""
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
