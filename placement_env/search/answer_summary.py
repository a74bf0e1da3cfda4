"""`Answer`: the answer to an order, as JSON values and lines of text."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from placement_env.handover.mounted import set_names
from placement_env.objective import Objective
from placement_env.search.description import (
    describe_assessment,
    describe_doubts,
    describe_estimate,
    describe_mounted,
    describe_profiles,
    describe_score,
    describe_sensors,
)
from placement_env.search.exclusions import describe_empty, describe_money
from placement_env.search.order import SearchOrder, Summary
from placement_env.search.portfolio.curve import CurvePoint
from placement_env.search.result import Result
from toolkit.runtime.text_values import replace_infinite


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer to an order.

    Attributes:
        objective: Objective of the search.
        summary: Figures for JSON.
        lines: Text to print.
        met: Whether any sensor is to be built.
        result: Result of one search, None for a curve.
        chosen: Set to hand over, which verification may have changed.
        points: Points of a budget curve.
    """

    objective: Objective
    summary: Summary
    lines: tuple[str, ...]
    met: bool
    result: Result | None = None
    chosen: tuple[int, ...] = ()
    points: tuple[CurvePoint, ...] = ()


def report_result(objective: Objective, result: Result) -> tuple[Summary, list[str]]:
    """Return the figures of one search as JSON values, and its lines of text.

    objective: objective of the search, which names the sensors. The figures may still have infinite
    numbers and NaN, which JSON lacks."""
    best = result.best
    assessment = result.assessment
    sensors = describe_sensors(list_names(objective, best.subset), result.sensors, objective.site)
    doubts = describe_doubts(objective, best.subset)
    summary = {
        **asdict(best),
        "sensors": sensors,
        "certificate": asdict(result.certificate),
        "evaluations": result.evaluations,
        "seconds": result.seconds,
        "provenance": objective.provenance,
        "doubts": doubts,
    }
    mounted = sensors if result.sensors else describe_mounted(objective, best.subset)
    lines = [str(result), result.certificate.note]
    lines += [f"  {line}" for line in mounted]
    prefix = ""
    if assessment is not None:
        # `curse`: by how much the search overrates the AP
        figures = asdict(assessment) | {"curse": assessment.curse}
        for row, contender in zip(figures["contenders"], assessment.contenders, strict=True):
            row["sensors"] = list_names(objective, contender.subset)
            row["curse"] = contender.curse
        summary["assessment"] = figures
        lines += describe_assessment(assessment)
        prefix = "estimate of the search: "
    lines.append(prefix + describe_score(best))
    lines += doubts
    lines += [f"front: {describe_score(score)} {score.subset}" for score in result.front]
    return summary, lines


def report_curve(
    order: SearchOrder, objective: Objective, points: tuple[CurvePoint, ...]
) -> Answer:
    """Return the points of a budget curve as an answer; without points it is not met."""
    point_names = [set_names(objective.candidates, point.subset) for point in points]
    rows = []
    for point, names in zip(points, point_names, strict=True):
        rows.append(asdict(point) | {"sensors": [*names]})
    summary = {
        "curve": rows,
        "judge": order.judge,
        "provenance": objective.provenance,
        **state_errors(order),
    }
    if not points:
        return Answer(
            objective=objective,
            summary=replace_infinite(summary),
            lines=(f"no sensors: {describe_empty(objective)}",),
            met=False,
        )
    budget_text = "for each amount of money"
    if math.isinf(objective.most_price):
        budget_text = "of each number of sensors"
    lines = [
        (
            f"best set {budget_text}, judged by the {order.judge} on traffic that had no part in "
            "the choice:"
        )
    ]
    for point, names in zip(points, point_names, strict=True):
        price = describe_money(point.price, order.currency)
        pays = "" if point.pays else ", no more than a cheaper one"
        estimate = describe_estimate(point, order.judge, point.objects)
        lines.append(f"  {point.sensors} for {price}: {estimate}{pays}: {', '.join(names)}")
        if point.by_errors:
            profiles = describe_profiles(point.by_errors, point.objects)
            lines.append(f"    at each error profile: {profiles}")
    return Answer(
        objective=objective,
        summary=replace_infinite(summary),
        lines=tuple(lines),
        met=True,
        points=points,
    )


def list_names(objective: Objective, subset: Iterable[int]) -> list[str]:
    """Return the names of a set's candidates, from their indices."""
    return [objective.names[c] for c in subset]


def state_errors(order: SearchOrder, by_errors: dict[str, float] | None = None) -> Summary:
    """Error profiles of the sensors for JSON, empty if the detector scores nothing.

    order: has the profiles; by_errors: AP at each profile by its name, None or empty for a single
    profile."""
    if not order.detects:
        return {}
    errors: Summary = {"errors": order.setting.cases.errors_origin}
    if by_errors:
        errors["by_errors"] = by_errors
    return errors
