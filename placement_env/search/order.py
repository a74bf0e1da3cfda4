"""`SearchOrder` and `run_search`, which answers it. An order describes one search."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from placement_env.fidelity.preparation import check_scorable
from placement_env.fidelity.table import hash_site
from placement_env.objective import Objective, Score
from placement_env.protocol import FidelityName
from placement_env.search.checkpoint import NOWHERE, Checkpoint, unfinished
from placement_env.search.description import (
    check_present,
    describe_assessment,
    describe_by_errors,
    describe_doubts,
    describe_empty,
    describe_exclusions,
    describe_money,
    describe_profiles,
    describe_score,
    describe_sensors,
)
from placement_env.search.exact.demand import Demand
from placement_env.search.methods import METHODS, check_search, load_search
from placement_env.search.portfolio.curve import CurvePoint, budget_curve, list_amounts
from placement_env.search.portfolio.portfolio import JUDGED_FRAMES, RACE_FRAMES, Judging
from placement_env.search.result import Result
from placement_env.search.verification import ap_at_profiles, verify_best
from placement_env.setting import Setting
from toolkit.detection.codec import PAPER
from toolkit.detection.provenance import detector_origin
from toolkit.runtime.files import replace_infinite
from toolkit.runtime.run import Run

PORTFOLIO = "portfolio"
UNFINISHED = ".parts"  # after the name of a folder: where the search for it is unfinished
USUAL_FRAMES = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOrder:
    """Specification of a search.

    setting: the question, with the errors of the detecting fidelities; run: how it is computed; method: of
    `placement_env.search.methods`; budget: most sensors; verify: fidelity that scores an answer and its neighbours,
    None for none; judge, confidence: of a portfolio's race and assessment; seconds, evaluations: limits; demand: of the
    cheapest set; curve: the best set of every number of sensors up to the budget, or for every amount of money where it
    is limited, by a portfolio; currency: of prices, "" for those of one ordinary pole.

    Raises ValueError and ImportError, before anything is rendered, where these do not fit.
    """

    setting: Setting
    run: Run = Run()
    method: str = PORTFOLIO
    budget: int = 4
    verify: Literal["detector"] | None = None
    judge: FidelityName = "detector"
    confidence: float = 0.95
    seconds: float | None = None
    evaluations: int | None = None
    demand: Demand | None = None
    curve: bool = False
    currency: str = ""

    def __post_init__(self) -> None:
        setting = self.setting
        check_search(self.method, self.fidelity, setting.pool, setting.cases)
        if self.fidelity == "table" and setting.codec != PAPER:
            raise ValueError(f"tables hold kbit of the paper's codec, got {setting.codec}: say --codec paper")
        for path, own in ((setting.surrogate, "surrogate"), (setting.table, "table")):
            if path is not None and own != self.fidelity:
                raise ValueError(f"this file is for fidelity {own}, got {self.fidelity!r}: leave one of them out")
        check_scorable(self.searched)
        if self.verify is not None:
            check_scorable(setting.with_fidelity(self.verify))
        if self.method == PORTFOLIO:
            check_scorable(setting.with_fidelity(self.judge))

    @property
    def fidelity(self) -> FidelityName:
        """Fidelity that is searched."""
        if not isinstance(self.setting.fidelity, str):
            raise ValueError(f"a search is ordered by the name of a fidelity, got {self.setting.fidelity!r}")
        return self.setting.fidelity

    @property
    def searched(self) -> Setting:
        """Setting of the search itself. A fidelity that does not detect knows no errors but the sensors' own noise."""
        return self.setting.with_fidelity(self.fidelity)

    @property
    def detects(self) -> bool:
        """True where the detector scores anything."""
        judge = self.judge if self.method == PORTFOLIO else None
        return "detector" in (self.fidelity, self.verify, judge)

    @property
    def question(self) -> dict[str, Any]:
        """Everything the answer depends on, as JSON values. These must be equal for a search to resume."""
        setting = self.setting
        files = {"surrogate": setting.surrogate, "table": setting.table}
        own = ("method", "budget", "verify", "judge", "confidence", "seconds", "evaluations", "currency", "curve")
        return {
            **{name: getattr(self, name) for name in own},
            **({} if self.demand is None else asdict(self.demand)),
            **{name: None if path is None else _digest(Path(path)) for name, path in files.items()},
            "fidelity": self.fidelity,
            "frames": self.run.frames_or(USUAL_FRAMES),
            "seed": self.run.seed,
            "site": hash_site(setting.place, setting.place.sensors),
            "candidates": setting.pool.digest(),
            "scheme": setting.fusion.digest,
            "codec": setting.codec.digest,
            "weights": asdict(setting.weights),
            "cases": setting.cases.origin,
            "errors": setting.cases.errors_origin,
            "detector": None if setting.detector is None else detector_origin(setting.detector),
            "classes": setting.counted.origin,
            "most_price": setting.most_price,
        }

    @contextmanager
    def keeping(self, out: Path | None, *, overwrite: bool = False) -> Iterator[tuple[SearchOrder, Checkpoint]]:
        """The order with the checkpoint of its answer.

        The checkpoint is in a folder, None for nowhere; the block must write the answer. Until the block ends normally,
        the state of the search stands beside the folder, in one named with the suffix `UNFINISHED`. If the search is
        killed, the same question resumes there. Raises FileExistsError where another search is unfinished there and may
        not be overwritten.
        """
        if out is None:
            yield self, NOWHERE
            return
        place = out.with_name(out.name + UNFINISHED)
        code = budget_curve.__module__ if self.curve else METHODS[self.method].module
        with unfinished(place, self.question, code=code, overwrite=overwrite) as checkpoint:
            known = self.setting.detector is None or hasattr(self.setting.detector, "digest")
            cache = self.run.cache or (checkpoint.place("cache") if known else None)
            yield replace(self, run=replace(self.run, cache=cache)), checkpoint


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer to an order.

    summary: for JSON; lines: to print; met: True where any sensor is to be built; result, chosen: of one search, and
    the set to hand over, which a check may have changed; points: of a curve.
    """

    objective: Objective
    summary: dict[str, Any]
    lines: tuple[str, ...]
    met: bool
    result: Result | None = None
    chosen: tuple[int, ...] = ()
    points: tuple[CurvePoint, ...] = ()


def run_search(order: SearchOrder, checkpoint: Checkpoint = NOWHERE) -> Answer:
    """Search as ordered, and check the answer. checkpoint: where the state of the search is kept."""
    objective = Objective(order.searched, order.run)
    check_present(objective)
    if not objective.allowed([]).any():
        reasons = describe_exclusions(objective, currency=order.currency)
        line = f"none may be built: {' '.join(reasons)}"
        return Answer(objective, {"sensors": [], "reasons": reasons}, (line,), False)
    if order.curve:
        return _run_curve(order, objective, checkpoint)
    own: dict[str, object] = {} if order.demand is None else {"demand": order.demand}
    if order.method == PORTFOLIO:
        own["judging"] = _judging(order)
    if METHODS[order.method].resumes:
        own["checkpoint"] = checkpoint
    limits = {"seconds": order.seconds, "evaluations": order.evaluations}
    result: Result = load_search(order.method)(objective, order.budget, seed=order.run.seed, **limits, **own)
    by_errors = ap_at_profiles(objective, result.best.subset, result.sensors)
    summary: dict[str, Any] = _summarize(objective, result) | _state_errors(order, by_errors)
    lines = [*_describe(objective, result), *describe_by_errors(by_errors)]
    if not result.best.subset:
        why = describe_empty(objective) if order.demand is None else result.certificate.note
        return Answer(objective, summary, (f"no sensors: {why}",), False)
    chosen = result.best.subset
    if order.verify is not None:
        exact = Objective(order.setting.with_fidelity(order.verify), order.run)
        checked, sets = verify_best(objective, exact, result)
        chosen = checked.subset
        by_errors = ap_at_profiles(exact, chosen, result.sensors)
        summary["verified"] = _check_summary(objective, exact, checked) | (
            {"by_errors": by_errors} if by_errors else {}
        )
        lines += [f"by the {order.verify}, {'moved' if result.sensors else f'best of {sets} sets'}:"]
        lines += [*(f"  {objective.names[c]}" for c in chosen), describe_score(checked), *describe_by_errors(by_errors)]
    return Answer(objective, replace_infinite(summary), tuple(line for line in lines if line), True, result, chosen)


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _judging(order: SearchOrder) -> Judging:
    frames = order.run.frames_or(USUAL_FRAMES)
    return Judging(
        by=order.judge,
        confidence=order.confidence,
        race_frames=min(RACE_FRAMES, frames),
        final_frames=min(JUDGED_FRAMES, frames),
        setting=order.setting.with_fidelity(order.judge),
    )


def _run_curve(order: SearchOrder, objective: Objective, checkpoint: Checkpoint) -> Answer:
    """Budget curve over numbers of sensors or money.

    It has a row for each number of sensors, or for each amount where money is limited.
    """
    limited = not math.isinf(objective.most_price)
    points = budget_curve(
        objective,
        order.budget,
        amounts=list_amounts(objective, order.budget, objective.most_price) if limited else (),
        seed=order.run.seed,
        seconds=order.seconds,
        evaluations=order.evaluations,
        judging=_judging(order),
        checkpoint=checkpoint,
    )
    rows = [asdict(point) | {"sensors": [objective.names[c] for c in point.subset]} for point in points]
    summary = {
        "curve": replace_infinite(rows),
        "judge": order.judge,
        "provenance": objective.provenance,
        **_state_errors(order),
    }
    if not points:
        return Answer(objective, replace_infinite(summary), (f"no sensors: {describe_empty(objective)}",), False)
    of = "for each amount of money" if limited else "of each number of sensors"
    lines = [f"best set {of}, by the {order.judge} on traffic that neither searches nor race saw:"]
    for point in points:
        names = ", ".join(objective.names[c] for c in point.subset)
        lines.append(
            f"  {point.sensors} for {describe_money(point.price, order.currency)}: AP {point.ap:.4f} ({point.low:.4f} "
            f"to {point.high:.4f}){'' if point.pays else ', no more than a cheaper one'}: {names}"
        )
        lines += [f"    at each error profile: {describe_profiles(point.by_errors)}"] if point.by_errors else []
    return Answer(objective, replace_infinite(summary), tuple(lines), True, points=points)


def _state_errors(order: SearchOrder, by_errors: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Error profiles of the detections.

    `provenance` is that of the search, which may not detect. by_errors: AP at each of several profiles, where the
    search itself knew them.
    """
    if not order.detects:
        return {}
    return {"errors": order.setting.cases.errors_origin} | ({"by_errors": dict(by_errors)} if by_errors else {})


def _summarize(objective: Objective, result: Result) -> dict[str, Any]:
    sensors = describe_sensors([objective.names[c] for c in result.best.subset], result.sensors)
    summary = {
        **asdict(result.best),
        "sensors": sensors,
        "certificate": asdict(result.certificate),
        "evaluations": result.evaluations,
        "seconds": result.seconds,
        "provenance": objective.provenance,
        "doubts": describe_doubts(objective, result.best.subset),
    }
    if result.assessment is not None:
        said = asdict(result.assessment) | {"curse": result.assessment.curse}
        for row, contender in zip(said["contenders"], result.assessment.contenders, strict=True):
            row |= {"sensors": [objective.names[c] for c in contender.subset], "curse": contender.curse}
        summary["assessment"] = said
    return summary


def _describe(objective: Objective, result: Result) -> list[str]:
    sensors = describe_sensors([objective.names[c] for c in result.best.subset], result.sensors)
    judged = [] if result.assessment is None else describe_assessment(result.assessment)
    score = f"{'searched by: ' if judged else ''}{describe_score(result.best)}"
    doubts = describe_doubts(objective, result.best.subset)
    lines = [str(result), result.certificate.note, *(f"  {name}" for name in sensors), *judged, score, *doubts]
    return lines + [f"front: {describe_score(score)} {score.subset}" for score in result.front]


def _check_summary(objective: Objective, exact: Objective, checked: Score) -> dict[str, Any]:
    there = [objective.names[c] for c in checked.subset]
    return {**asdict(checked), "sensors": there, "provenance": exact.provenance}
