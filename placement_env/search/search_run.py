"""`run_search`: from an order to its answer, in figures and words."""

import math
from dataclasses import asdict, replace
from typing import NamedTuple

from placement_env.fidelity.preparation import BY_LEVELS
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.search.answer_summary import (
    Answer,
    list_names,
    report_curve,
    report_result,
    state_errors,
)
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.description import describe_by_errors, describe_mounted, describe_score
from placement_env.search.early_answers import BetterReport, find_first_answer
from placement_env.search.exclusions import (
    check_present,
    describe_empty,
    describe_exclusions,
    explain_kept,
)
from placement_env.search.first_look import describe_narrowing, narrow_pool, prepare_first_look
from placement_env.search.methods import METHODS, load_search
from placement_env.search.order import DEFAULT_FRAMES, PORTFOLIO, SearchOrder, Summary
from placement_env.search.portfolio.curve import budget_curve, list_amounts
from placement_env.search.portfolio.portfolio import JUDGED_FRAMES, RACE_FRAMES, Judging
from placement_env.search.result import Result
from placement_env.search.verification import ap_at_profiles, verify_best
from toolkit.runtime.text_values import replace_infinite

SEARCH_FRAMES = 48  # frames that a portfolio's searches use, spread evenly over all


def run_search(order: SearchOrder, checkpoint: Checkpoint = NOWHERE) -> Answer:
    """Run the ordered search, and verify its answer if that is ordered.

    If no candidate may be built, the answer gives the reasons and is not met. Raises ValueError if
    a counted class has no objects. checkpoint: keeps the state of the search."""
    stride = _choose_stride(order)
    order, narrowing = _narrow_candidates(order, stride)
    objective = _build_objective(order, stride)
    check_present(objective)
    is_allowed = objective.allowed([])
    reasons = explain_kept(objective, is_allowed, currency=order.currency)
    if reasons or not is_allowed.any():
        reasons = reasons or describe_exclusions(objective, currency=order.currency)
        return Answer(
            objective=objective,
            summary={"sensors": [], "reasons": reasons},
            lines=(f"none may be built: {' '.join(reasons)}",),
            met=False,
        )
    judging = _build_judging(order)
    limits: Summary = {
        "seed": order.run.seed,
        "seconds": order.seconds,
        "evaluations": order.evaluations,
    }
    if order.curve:
        answer = _search_curve(order, objective, judging, limits, checkpoint)
        return replace(answer, lines=(*answer.lines, narrowing)) if narrowing else answer
    options: Summary = {} if order.demand is None else {"demand": order.demand}
    if order.method == PORTFOLIO:
        options["judging"] = judging
    if METHODS[order.method].resumes:
        options["checkpoint"] = checkpoint
    result = load_search(order.method)(objective, order.budget, **limits, **options)
    return _build_answer(order, objective, result, narrowing)


def _choose_stride(order: SearchOrder) -> int:
    """Step between the frames of the search, 1 for every frame.

    A portfolio's searches use about `SEARCH_FRAMES` of all frames, evenly spread."""
    if order.method != PORTFOLIO or order.fidelity not in BY_LEVELS:
        return 1
    return max(1, order.run.frames_or(DEFAULT_FRAMES) // SEARCH_FRAMES)


def _narrow_candidates(order: SearchOrder, stride: int) -> tuple[SearchOrder, str]:
    """Order with fewer candidates if they are too many, and a sentence on that or "".

    The sentence is also reported (`SearchOrder.tell`). stride: step between the frames of the
    search."""
    pool = order.setting.pool
    poses = narrow_pool(order.search_setting, order.run, stride)
    if poses is None:
        return order, ""
    search_frames = -(-order.run.frames_or(DEFAULT_FRAMES) // stride)  # rounded up
    narrowing = describe_narrowing(pool, poses, search_frames)
    setting = replace(order.setting, candidates=pool.select(poses))
    if order.tell is not None:
        order.tell(narrowing)
    return replace(order, setting=setting), narrowing


def _build_objective(order: SearchOrder, stride: int) -> Objective:
    """Objective of the search, which reports better sets as they are found if it is asked to.

    A first answer, by greedy on few frames, is then reported before. There are reports if the order
    has `tell`, only some frames are used, traffic is undivided, and one set is sought.

    stride: step between the frames of the search."""
    first_score = None
    is_undivided = order.setting.cases.levels == 1
    if order.tell is not None and stride > 1 and is_undivided and not order.curve:
        first_look = prepare_first_look(order.search_setting, order.run, stride)
        first_score = find_first_answer(order, first_look)
    # after the first answer, because all candidates are rendered here
    objective = Objective(order.search_setting, order.run, stride=stride)
    if order.tell is not None and first_score is not None:
        objective.watch = BetterReport(objective, first_score, order.tell)
    return objective


def _build_judging(order: SearchOrder) -> Judging:
    """Settings of a portfolio's race and assessment, on no more frames than the order has."""
    frames = order.run.frames_or(DEFAULT_FRAMES)
    return Judging(
        by=order.judge,
        confidence=order.confidence,
        contenders=order.contenders,
        race_frames=min(RACE_FRAMES, frames),
        final_frames=min(JUDGED_FRAMES, frames),
        setting=order.setting.with_fidelity(order.judge) if order.method == PORTFOLIO else None,
    )


def _search_curve(
    order: SearchOrder,
    objective: Objective,
    judging: Judging,
    limits: Summary,
    checkpoint: Checkpoint,
) -> Answer:
    """Answer with the points of a budget curve: over amounts of money if the price is limited.

    Otherwise the points are for numbers of sensors. judging: how sets are compared by the judge;
    limits: seed, seconds and evaluations, as arguments of the search; checkpoint: keeps states to
    resume from."""
    max_price = objective.most_price
    amounts = () if math.isinf(max_price) else list_amounts(objective, order.budget, max_price)
    points = budget_curve(
        objective, order.budget, amounts=amounts, judging=judging, checkpoint=checkpoint, **limits
    )
    return report_curve(order, objective, points)


def _build_answer(
    order: SearchOrder, objective: Objective, result: Result, narrowing: str
) -> Answer:
    """Answer from the result of one search, verified if that is ordered.

    narrowing: sentence on the candidates that were left out, "" if none were. An empty set is an
    answer that is not met, with the likely reason."""
    members = result.best.subset
    by_errors = ap_at_profiles(objective, members, result.sensors)
    summary, lines = report_result(objective, result)
    if narrowing:
        summary["narrowed"] = narrowing
        lines.append(narrowing)
    if order.setting.keep:
        lines.append(f"asked to build on: {', '.join(order.setting.keep)}")
    summary |= state_errors(order, by_errors)
    if not members:
        reason = describe_empty(objective) if order.demand is None else result.certificate.note
        line = f"no sensors: {reason}"
        return Answer(objective=objective, summary=summary, lines=(line,), met=False)
    lines += describe_by_errors(by_errors)
    if order.verify is not None:
        verification = _verify(order, fidelity=order.verify, objective=objective, result=result)
        members = verification.members
        summary["verified"] = verification.summary
        lines += verification.lines
    return Answer(
        objective=objective,
        summary=replace_infinite(summary),
        lines=tuple(line for line in lines if line),
        met=True,
        result=result,
        chosen=members,
    )


class _Verification(NamedTuple):
    """Answer by another fidelity: its set, its figures for JSON and its lines of text."""

    members: tuple[int, ...]
    summary: Summary
    lines: list[str]


def _verify(
    order: SearchOrder, fidelity: FidelityName, objective: Objective, result: Result
) -> _Verification:
    """Score the answer of a search and its neighbours by another fidelity, and keep the best.

    Neighbours differ in one sensor; moved sensors have no neighbours. order: the ordered search;
    fidelity: name of the other fidelity; objective: objective of the search; result: its answer."""
    verifier = Objective(order.setting.with_fidelity(fidelity), order.run)
    score, set_count = verify_best(objective, verifier, result)
    names = list_names(objective, score.subset)
    by_errors = ap_at_profiles(verifier, score.subset, result.sensors)
    summary = {**asdict(score), "sensors": names, "provenance": verifier.provenance}
    if by_errors:
        summary["by_errors"] = by_errors
    sensor_lines = names if result.sensors else describe_mounted(objective, score.subset)
    change = "moved" if result.sensors else f"best of {set_count} sets"
    lines = [f"by the {fidelity}, {change}:"]
    lines += [f"  {line}" for line in sensor_lines]
    lines.append(describe_score(score))
    lines += describe_by_errors(by_errors)
    return _Verification(members=score.subset, summary=summary, lines=lines)
