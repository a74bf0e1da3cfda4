"""Searching: one search as the command line asks for it, from its settings to what is printed and handed over."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from placement_env.candidates.candidates import Candidates
from placement_env.classes import VEHICLES, classes_of
from placement_env.fidelity.combined.error_profiles import AskedErrors, errors_of
from placement_env.fidelity.combined.prepared import Counting
from placement_env.fidelity.preparation import check_fidelity_for
from placement_env.fidelity.table import digest_of
from placement_env.objective import Objective, Score, Stages
from placement_env.protocol import FidelityName
from placement_env.report.curve_answer import CURVE_TABLES, write_curve
from placement_env.report.planning.refusals import check_present, exclusions
from placement_env.report.planning.sentences import money
from placement_env.report.search_answer import ANSWER_FILES, write_answer
from placement_env.search.checkpoint import NOWHERE, Checkpoint, unfinished
from placement_env.search.description import (
    described_assessment,
    described_by_errors,
    described_doubts,
    described_empty,
    described_profiles,
    described_score,
    described_sensors,
)
from placement_env.search.exact.demand import Demand
from placement_env.search.methods import METHODS, check_search, search_of
from placement_env.search.portfolio.curve import amounts_up_to, budget_curve
from placement_env.search.portfolio.portfolio import JUDGED_FRAMES, RACE_FRAMES
from placement_env.search.result import Result
from placement_env.search.verification import ap_at_profiles, verified_best
from placement_env.setting import Weights
from toolkit.detection.codec import PAPER
from toolkit.detection.provenance import detector_origin
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.objects import Detector
from toolkit.runtime.files import replace_infinite
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sites.site import Site

PORTFOLIO = "portfolio"
UNFINISHED = ".parts"  # after the name of a folder: where the search for it is unfinished


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOrder:
    """What is to be searched, and how. method: of `placement_env.search.methods`; verify: fidelity by which an answer
    and its neighbours are scored, None for none; judge: fidelity of a portfolio's race and assessment; errors: of the
    sensors, for what detects, as of `Objective`; limits: seconds and evaluations; demand: what a method beside
    these is asked for; currency: of prices, "" for those of one ordinary pole; curve: the best set of every number
    of sensors up to the budget, or for every amount of money where it is limited, by a portfolio; settings: of
    `Objective` beside these.

    Raises ValueError and ImportError, before anything is rendered, where these do not fit.
    """

    site: Site
    candidates: Candidates
    method: str
    budget: int
    scheme: Scheme | str = "early"
    fidelity: FidelityName = "surrogate"
    verify: Literal["detector"] | None = None
    judge: FidelityName = "detector"
    confidence: float = 0.95
    weights: Weights = field(default_factory=Weights)
    frames: int = 200
    errors: AskedErrors = PAPER_ERRORS
    detector: Detector | None = None
    surrogate: Path | None = None
    table: Path | None = None
    limits: Mapping[str, Any] = field(default_factory=dict)
    demand: Mapping[str, Any] = field(default_factory=dict)
    currency: str = ""
    curve: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        counting = counting_of(self.settings)
        Demand(**self.demand)
        check_search(self.method, self.fidelity, self.candidates, counting)
        if self.fidelity == "table" and self.settings.get("codec", PAPER) != PAPER:
            raise ValueError(f"tables hold kbit of the paper's codec, got {self.settings['codec']}: say --codec paper")
        for iou in counting.ious:
            self._check(iou)

    def _check(self, iou: float) -> None:
        """That its fidelities score these candidates at an IoU threshold."""
        place, pool, scheme = self.site, self.candidates, self.scheme
        asked: dict[str, Any] = {"iou": iou, "detector": self.detector}
        if "classes" in self.settings:
            asked["classes"] = self.settings["classes"]
        check_fidelity_for(place, pool, scheme, self.fidelity, **asked, surrogate=self.surrogate, table=self.table)
        if self.verify is not None:
            check_fidelity_for(place, pool, scheme, self.verify, **asked)
        if self.method == PORTFOLIO:
            own: dict[str, Any] = {"surrogate": self.surrogate} if self.judge == "surrogate" else {}
            check_fidelity_for(place, pool, scheme, self.judge, **asked, **own)

    @property
    def detects(self) -> bool:
        """Whether the detector scores anything."""
        judge = self.judge if self.method == PORTFOLIO else None
        return "detector" in (self.fidelity, self.verify, judge)


@dataclass(frozen=True)
class Answered:
    """What a search comes to. summary: for JSON; lines: to print; met: whether any sensor is to be built."""

    summary: dict[str, Any]
    lines: tuple[str, ...]
    met: bool


def answered(
    order: SearchOrder, *, out: Path | None = None, overwrite: bool = False, progress: Stages | None = None
) -> Answered:
    """Search, check what was found and write it to a folder, None for nowhere.

    Until it is written, how far the search is stands beside the folder, in one named `UNFINISHED` after it: killed and
    asked again, the same question goes on there. Raises FileExistsError where another one is unfinished there and is
    not to be overwritten.
    """
    if out is None:
        return _answered(order, None, NOWHERE, progress)
    place = out.with_name(out.name + UNFINISHED)
    code = budget_curve.__module__ if order.curve else METHODS[order.method].module
    with unfinished(place, question_of(order), code=code, overwrite=overwrite) as checkpoint:
        known = order.detector is None or hasattr(order.detector, "digest")
        kept = order.settings.get("cache") or (checkpoint.place("cache") if known else None)
        return _answered(replace(order, settings={**order.settings, "cache": kept}), out, checkpoint, progress)


def question_of(order: SearchOrder) -> dict[str, Any]:
    """All that the answer depends on, as values of JSON: what must be the same for a search to go on."""
    plain: dict[str, Any] = {
        name: getattr(order, name)
        for name in ("method", "budget", "fidelity", "verify", "judge", "confidence", "frames", "currency", "curve")
    }
    settings = order.settings
    files = {"surrogate": order.surrogate, "table": order.table}
    counting = counting_of(settings)
    codec, scheme = settings.get("codec", PAPER), find_scheme(order.scheme)
    return {
        **plain,
        **order.limits,
        **order.demand,
        **{name: None if path is None else sha256(path.read_bytes()).hexdigest() for name, path in files.items()},
        "site": digest_of(order.site, order.site.sensors),
        "candidates": order.candidates.digest(),
        "scheme": scheme.digest,
        "codec": codec.digest,
        "weights": asdict(order.weights),
        "counting": counting.origin,
        "errors": errors_of(order.errors).origin,
        "detector": None if order.detector is None else detector_origin(order.detector),
        "classes": classes_of(settings.get("classes", VEHICLES)).origin,
        "most_price": settings.get("most_price", math.inf),
        "seed": settings.get("seed", 0),
    }


def counting_of(settings: Mapping[str, Any]) -> Counting:
    """What of a set counts, by the settings of an objective."""
    return Counting.of(settings.get("iou", 0.7), settings.get("failing", 0), settings.get("levels", 1))


def _answered(order: SearchOrder, out: Path | None, checkpoint: Checkpoint, progress: Stages | None) -> Answered:
    objective = _objective(order, order.fidelity, progress)
    check_present(objective)
    if not objective.allowed([]).any():
        reasons = exclusions(objective, currency=order.currency)
        return Answered({"sensors": [], "reasons": reasons}, (f"none may be built: {' '.join(reasons)}",), False)
    own = _judging(order, objective, progress) if order.method == PORTFOLIO else dict(order.demand)
    if order.curve:
        return _curve(order, objective, own, out, checkpoint)
    seed = order.settings.get("seed", 0)
    if METHODS[order.method].resumes:
        own["checkpoint"] = checkpoint
    result = search_of(order.method)(objective, order.budget, seed=seed, **order.limits, **own)
    by_errors = ap_at_profiles(objective, result.best.subset, result.sensors)
    summary = _summary(objective, result) | _over_errors(order, by_errors)
    lines = [*_lines(objective, result), *described_by_errors(by_errors)]
    if not result.best.subset:
        why = result.certificate.note if order.demand else described_empty(objective)
        return Answered(summary, (f"no sensors: {why}",), False)
    chosen = result.best.subset
    if order.verify is not None:
        exact = _objective(order, order.verify, progress)
        checked, sets = verified_best(objective, exact, result)
        chosen = checked.subset
        summary["verified"] = _verified(objective, exact, checked)
        lines += [f"by the {order.verify}, {'moved' if result.sensors else f'best of {sets} sets'}:"]
        lines += [*(f"  {objective.names[c]}" for c in chosen), described_score(checked)]
        by_errors = ap_at_profiles(exact, chosen, result.sensors)
        summary["verified"] |= {"by_errors": by_errors} if by_errors else {}
        lines += described_by_errors(by_errors)
    if out is not None:
        write_answer(out, objective, result, replace_infinite(summary), chosen=chosen)
        lines.append(f"written to {out}: {', '.join(ANSWER_FILES)}")
    return Answered(summary, tuple(line for line in lines if line), True)


def _over_errors(order: SearchOrder, by_errors: Mapping[str, float] | None = None) -> dict[str, Any]:
    """What the summary says of the error profiles that something was detected at; `provenance` is that of the search,
    which may have detected nothing. by_errors: AP at each of several, where the search itself knew them."""
    if not order.detects:
        return {}
    return {"errors": errors_of(order.errors).origin} | ({"by_errors": dict(by_errors)} if by_errors else {})


def _objective(order: SearchOrder, fidelity: FidelityName, progress: Stages | None) -> Objective:
    """Of the search, or of its check; what does not detect knows no errors but the sensors' own noise."""
    errors = order.errors if fidelity == "detector" else PAPER_ERRORS
    files: dict[str, Any] = {} if fidelity != order.fidelity else {"surrogate": order.surrogate, "table": order.table}
    if order.detector is not None:
        files["detector"] = order.detector
    return Objective(
        order.site, order.frames, order.scheme, fidelity, order.weights, candidates=order.candidates, errors=errors,
        progress=progress, **files, **order.settings,
    )  # fmt: skip


def _judging(order: SearchOrder, objective: Objective, progress: Stages | None) -> dict[str, Any]:
    """What a portfolio needs to know beside the objective."""
    made = objective.preparation
    if made is None:
        raise ValueError("a portfolio needs an objective made from a site: Objective(site, ...)")
    detects = order.judge == "detector"
    surrogate = order.surrogate if order.judge == "surrogate" else None
    errors = errors_of(order.errors) if detects else PAPER_ERRORS
    return {
        "confidence": order.confidence,
        "judge": order.judge,
        "race_frames": min(RACE_FRAMES, order.frames),
        "final_frames": min(JUDGED_FRAMES, order.frames),
        "preparation": replace(made, errors=errors, surrogate=surrogate),
        "progress": progress,
    }


def _curve(
    order: SearchOrder, objective: Objective, own: dict[str, Any], out: Path | None, checkpoint: Checkpoint
) -> Answered:
    """The budget curve: a row for each number of sensors, or where money is limited for each amount of it."""
    limited = not math.isinf(objective.most_price)
    amounts = amounts_up_to(objective, order.budget, objective.most_price) if limited else ()
    seed = order.settings.get("seed", 0)
    points = budget_curve(
        objective, order.budget, amounts=amounts, seed=seed, checkpoint=checkpoint, **order.limits, **own
    )
    rows = [asdict(point) | {"sensors": [objective.names[c] for c in point.subset]} for point in points]
    summary = {
        "curve": replace_infinite(rows),
        "judge": order.judge,
        "provenance": objective.provenance,
        **_over_errors(order),
    }
    if not points:
        return Answered(summary, (f"no sensors: {described_empty(objective)}",), False)
    of = "for each amount of money" if limited else "of each number of sensors"
    lines = [f"best set {of}, by the {order.judge} on traffic that neither searches nor race saw:"]
    for point in points:
        names = ", ".join(objective.names[c] for c in point.subset)
        lines.append(
            f"  {point.sensors} for {money(point.price, order.currency)}: AP {point.ap:.4f} ({point.low:.4f} to "
            f"{point.high:.4f}){'' if point.pays else ', no more than a cheaper one'}: {names}"
        )
        lines += [f"    at each error profile: {described_profiles(point.by_errors)}"] if point.by_errors else []
    if out is not None:
        write_curve(out, objective, points, replace_infinite(summary), judge=order.judge, currency=order.currency)
        lines.append(f"written to {out}: {', '.join(CURVE_TABLES)}, and the site with each set")
    return Answered(summary, tuple(lines), True)


def _summary(objective: Objective, result: Result) -> dict[str, Any]:
    sensors = described_sensors([objective.names[c] for c in result.best.subset], result.sensors)
    summary = {
        **asdict(result.best),
        "sensors": sensors,
        "certificate": asdict(result.certificate),
        "evaluations": result.evaluations,
        "seconds": result.seconds,
        "provenance": objective.provenance,
        "doubts": described_doubts(objective, result.best.subset),
    }
    if result.assessment is not None:
        said = asdict(result.assessment) | {"curse": result.assessment.curse}
        for row, contender in zip(said["contenders"], result.assessment.contenders, strict=True):
            row |= {"sensors": [objective.names[c] for c in contender.subset], "curse": contender.curse}
        summary["assessment"] = said
    return summary


def _lines(objective: Objective, result: Result) -> list[str]:
    sensors = described_sensors([objective.names[c] for c in result.best.subset], result.sensors)
    judged = [] if result.assessment is None else described_assessment(result.assessment)
    score = f"{'searched by: ' if judged else ''}{described_score(result.best)}"
    doubts = described_doubts(objective, result.best.subset)
    lines = [str(result), result.certificate.note, *(f"  {name}" for name in sensors), *judged, score, *doubts]
    return lines + [f"front: {described_score(score)} {score.subset}" for score in result.front]


def _verified(objective: Objective, exact: Objective, checked: Score) -> dict[str, Any]:
    there = [objective.names[c] for c in checked.subset]
    return {**asdict(checked), "sensors": there, "provenance": exact.provenance}
