"""Description of one search (`SearchOrder`), and its answer in figures and words (`run_search`)."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np

from placement_env.analysis.intervals import describe_interval, describe_sureness
from placement_env.candidates.candidates import aims
from placement_env.classes import join_names
from placement_env.fidelity.preparation import BY_LEVELS, Preparation, check_scorable
from placement_env.fidelity.table import hash_site
from placement_env.handover.mounted import set_names
from placement_env.links import describe_share
from placement_env.objective import Objective, Score
from placement_env.protocol import Doubting, FidelityName
from placement_env.search.checkpoint import NOWHERE, Checkpoint, find_unfinished, unfinished
from placement_env.search.exact.cheapest import Demand
from placement_env.search.first_look import describe_narrowing, narrow_pool, prepare_first_look
from placement_env.search.methods import METHODS, check_search, load_search
from placement_env.search.portfolio.curve import CurvePoint, budget_curve, list_amounts
from placement_env.search.portfolio.portfolio import JUDGED_FRAMES, RACE_FRAMES, Judging
from placement_env.search.result import Assessment, Contender, ProfileAP, Result
from placement_env.search.verification import ap_at_profiles, verify_best
from placement_env.setting import Setting
from toolkit.arrays import Bool
from toolkit.detection.codec import PAPER
from toolkit.detection.provenance import detector_origin
from toolkit.display import figure_digits, format_share
from toolkit.runtime.files import replace_infinite
from toolkit.runtime.run import Run
from toolkit.sensors.models import name_in_words
from toolkit.sensors.sensor import Sensor
from toolkit.sites.georeference import bearing_deg
from toolkit.sites.site import Site

PORTFOLIO = "portfolio"
MIN_LEVEL_OBJECTS = 100  # a level of traffic with fewer objects gets a warning
UNFINISHED_SUFFIX = ".parts"  # suffix of the folder that keeps the state of a search
DEFAULT_FRAMES = 200
MIN_GAIN_AP = 0.001  # smallest improvement that is reported during the search
SEARCH_FRAMES = 48  # frames that a portfolio's searches use, spread evenly over all
Summary = dict[str, Any]  # JSON values


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOrder:
    """Specification of a search, checked before anything is rendered.

    Attributes:
        setting: The question, with the errors of the detecting fidelities.
        run: Frames, seed, cache and processes.
        method: Name of a search in `placement_env.search.methods`.
        budget: Largest number of sensors.
        verify: Fidelity that scores an answer and its neighbours.
        judge: Fidelity of a portfolio's race and assessment.
        confidence: Confidence at which a portfolio's race ends.
        contenders: Whether a portfolio also assesses the answer of each search.
        seconds: Time limit, None for no limit.
        evaluations: Largest number of scored sets, None for no limit.
        demand: Conditions for the cheapest set.
        curve: Whether to search a budget curve with a portfolio: one set for each number of
            sensors up to the budget, or for each amount if the price is limited.
        currency: Currency of prices, "" for prices of one ordinary pole.
        tell: Called with a line for each early answer.

    Raises ValueError or ImportError if the parts do not fit together.
    """

    setting: Setting
    run: Run = Run()
    method: str = PORTFOLIO
    budget: int = 4
    verify: Literal["detector"] | None = None
    judge: FidelityName = "detector"
    confidence: float = 0.95
    contenders: bool = False
    seconds: float | None = None
    evaluations: int | None = None
    demand: Demand | None = None
    curve: bool = False
    currency: str = ""
    tell: Callable[[str], None] | None = None

    def __post_init__(self) -> None:
        setting = self.setting
        if not 0 < self.confidence < 1:
            raise ValueError(
                f"confidence must lie between 0 and 1, got {self.confidence}: 0.95 is usual"
            )
        check_search(self.method, self.fidelity, setting.pool, setting.cases)
        setting.check_budget(self.budget)
        if setting.keep and self.method == "ppo":
            raise ValueError(
                "method ppo does not know poles that must carry a sensor: pass --method portfolio "
                "or swap"
            )
        if self.fidelity == "table" and setting.codec != PAPER:
            raise ValueError(
                f"tables hold kbit of the paper's codec, got {setting.codec}: pass --codec paper"
            )
        for path, fidelity in ((setting.surrogate, "surrogate"), (setting.table, "table")):
            if path is not None and fidelity != self.fidelity:
                raise ValueError(
                    f"this file is for fidelity {fidelity}, got {self.fidelity!r}: leave one of "
                    "them out"
                )
        check_scorable(self.searched)
        if self.verify is not None:
            check_scorable(setting.with_fidelity(self.verify))
        if self.method == PORTFOLIO:
            check_scorable(setting.with_fidelity(self.judge))

    @property
    def fidelity(self) -> FidelityName:
        """Fidelity that is searched."""
        if not isinstance(self.setting.fidelity, str):
            raise ValueError(
                f"a search is ordered by the name of a fidelity, got {self.setting.fidelity!r}"
            )
        return self.setting.fidelity

    @property
    def searched(self) -> Setting:
        """Setting with the searched fidelity; only detecting fidelities keep error profiles."""
        return self.setting.with_fidelity(self.fidelity)

    @property
    def detects(self) -> bool:
        """True if the detector scores anything."""
        judge = self.judge if self.method == PORTFOLIO else None
        return "detector" in (self.fidelity, self.verify, judge)

    @property
    def question(self) -> Summary:
        """Everything the answer depends on, as JSON values; a search resumes only if they are
        equal."""
        setting = self.setting
        options = (
            "method",
            "budget",
            "verify",
            "judge",
            "confidence",
            "contenders",
            "seconds",
            "evaluations",
            "currency",
            "curve",
        )
        question: Summary = {name: getattr(self, name) for name in options}
        if self.demand is not None:
            question |= asdict(self.demand)
        files = {"surrogate": setting.surrogate, "table": setting.table}
        for name, path in files.items():
            question[name] = path and sha256(Path(path).read_bytes()).hexdigest()
        question |= {
            "fidelity": self.fidelity,
            "frames": self.run.frames_or(DEFAULT_FRAMES),
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
        if setting.keep:
            question["keep"] = setting.keep
        return question

    def resumes(self, out: Path) -> bool:
        """True if a search with this question was interrupted and can resume."""
        folder = find_unfinished(out.with_name(out.name + UNFINISHED_SUFFIX), self.question)
        return folder.found == folder.plan

    @contextmanager
    def keeping(
        self, out: Path | None, *, overwrite: bool = False
    ) -> "Iterator[tuple[SearchOrder, Checkpoint]]":
        """Yield the order and the checkpoint of its answer's folder; the block must write the
        answer.

        out: folder of the answer, None to keep no state. Until the block ends normally, the state
        of the search is kept next to that folder, in one with the suffix `UNFINISHED_SUFFIX`. The
        same question resumes there. Raises FileExistsError if another search is unfinished and may
        not be overwritten.
        """
        if out is None:
            yield self, NOWHERE
            return
        state_folder = out.with_name(out.name + UNFINISHED_SUFFIX)
        code = budget_curve.__module__ if self.curve else METHODS[self.method].module
        with unfinished(state_folder, self.question, code=code, overwrite=overwrite) as checkpoint:
            is_cacheable = self.setting.detector is None or hasattr(self.setting.detector, "digest")
            cache = self.run.cache or (checkpoint.place("cache") if is_cacheable else None)
            yield replace(self, run=replace(self.run, cache=cache)), checkpoint


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


def run_search(order: SearchOrder, checkpoint: Checkpoint = NOWHERE) -> Answer:
    """Run the ordered search and verify its answer. checkpoint: keeps the state of the search."""
    stride = _choose_stride(order)
    order, narrowing = _narrow(order, stride)
    objective = _build_objective(order, stride)
    check_present(objective)
    is_allowed = objective.allowed([])
    reasons = explain_kept(objective, is_allowed, currency=order.currency)
    if reasons or not is_allowed.any():
        reasons = reasons or describe_exclusions(objective, currency=order.currency)
        line = f"none may be built: {' '.join(reasons)}"
        return Answer(objective, {"sensors": [], "reasons": reasons}, (line,), False)
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
    return _answer(order, objective, result, narrowing)


def _choose_stride(order: SearchOrder) -> int:
    """Step between the frames of the search; a portfolio's searches use few of them."""
    if order.method != PORTFOLIO or order.fidelity not in BY_LEVELS:
        return 1
    return max(1, order.run.frames_or(DEFAULT_FRAMES) // SEARCH_FRAMES)


def _narrow(order: SearchOrder, stride: int) -> tuple[SearchOrder, str]:
    """Order with fewer candidates if they are too many, and a sentence on that or ""."""
    pool = order.setting.pool
    poses = narrow_pool(order.searched, order.run, stride)
    if poses is None:
        return order, ""
    narrowing = describe_narrowing(pool, poses)
    setting = replace(order.setting, candidates=pool.select(poses))
    if order.tell is not None:
        order.tell(narrowing)
    return replace(order, setting=setting), narrowing


def _build_objective(order: SearchOrder, stride: int) -> Objective:
    """Objective of the search, which reports a first answer and better ones if asked."""
    first_score = None
    if (
        order.tell is not None
        and stride > 1
        and order.setting.cases.levels == 1
        and not order.curve
    ):
        first_score = _find_first(order, prepare_first_look(order.searched, order.run, stride))
    objective = Objective(order.searched, order.run, stride=stride)
    if order.tell is not None and first_score is not None:
        objective.watch = _Better(objective, first_score, order.tell)
    return objective


def _build_judging(order: SearchOrder) -> Judging:
    """Race and assessment of a portfolio."""
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
    """Search a budget curve and report its points."""
    max_price = objective.most_price
    amounts = () if math.isinf(max_price) else list_amounts(objective, order.budget, max_price)
    points = budget_curve(
        objective, order.budget, amounts=amounts, judging=judging, checkpoint=checkpoint, **limits
    )
    return _report_curve(order, objective, points)


def _answer(order: SearchOrder, objective: Objective, result: Result, narrowing: str) -> Answer:
    """Answer from the result of one search, verified if that is ordered."""
    members = result.best.subset
    by_errors = ap_at_profiles(objective, members, result.sensors)
    summary, lines = _report(objective, result)
    if narrowing:
        summary["narrowed"] = narrowing
        lines.append(narrowing)
    if order.setting.keep:
        lines.append(f"asked to build on: {', '.join(order.setting.keep)}")
    summary |= _state_errors(order, by_errors)
    if not members:
        reason = describe_empty(objective) if order.demand is None else result.certificate.note
        return Answer(objective, summary, (f"no sensors: {reason}",), False)
    lines += describe_by_errors(by_errors)
    if order.verify is not None:
        verifier = Objective(order.setting.with_fidelity(order.verify), order.run)
        verified, set_count = verify_best(objective, verifier, result)
        members = verified.subset
        names = _names(objective, members)
        by_errors = ap_at_profiles(verifier, members, result.sensors)
        mounted = names if result.sensors else describe_mounted(objective, members)
        summary["verified"] = {
            **asdict(verified),
            "sensors": names,
            "provenance": verifier.provenance,
        }
        if by_errors:
            summary["verified"]["by_errors"] = by_errors
        moved = "moved" if result.sensors else f"best of {set_count} sets"
        lines.append(f"by the {order.verify}, {moved}:")
        lines += [f"  {line}" for line in mounted]
        lines.append(describe_score(verified))
        lines += describe_by_errors(by_errors)
    return Answer(
        objective=objective,
        summary=replace_infinite(summary),
        lines=tuple(line for line in lines if line),
        met=True,
        result=result,
        chosen=members,
    )


def _find_first(order: SearchOrder, preparation: Preparation) -> Score:
    """Report greedy's answer on the first frames and return its score there."""
    objective = Objective.from_view(
        preparation, preparation.setting.pool, preparation.visibility, order.setting.weights
    )
    best = load_search("greedy")(objective, order.budget, seed=order.run.seed).best
    names = ", ".join(set_names(objective.candidates, best.subset)) or "no sensors"
    if order.tell is not None:
        order.tell(
            f"first answer, by greedy on {len(preparation.traffic)} frames: {names}, predicted AP "
            f"{best.ap:.3f}"
        )
    return best


class _Better:
    """Report each better set: first by its prediction, then the leader of the race."""

    def __init__(self, objective: Objective, first: Score, tell: Callable[[str], None]) -> None:
        self._objective = objective
        self._tell = tell
        self._last = first.subset
        self._reward = objective.score(first.subset).reward

    def __call__(self, subset: tuple[int, ...], reward: float, raced: int) -> None:
        if subset == self._last or (not raced and reward < self._reward + MIN_GAIN_AP):
            return
        self._last = subset
        self._reward = reward
        names = ", ".join(set_names(self._objective.candidates, subset))
        if raced:
            self._tell(f"ahead after {raced} frames of the race: {names}")
        else:
            self._tell(f"better: {names}, predicted AP {self._objective.score(subset).ap:.3f}")


def _report(objective: Objective, result: Result) -> tuple[Summary, list[str]]:
    best = result.best
    assessment = result.assessment
    sensors = describe_sensors(_names(objective, best.subset), result.sensors, objective.site)
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
        figures = asdict(assessment) | {"curse": assessment.curse}
        for row, contender in zip(figures["contenders"], assessment.contenders, strict=True):
            row |= {"sensors": _names(objective, contender.subset), "curse": contender.curse}
        summary["assessment"] = figures
        lines += describe_assessment(assessment)
        prefix = "estimate of the search: "
    lines.append(prefix + describe_score(best))
    lines += doubts
    lines += [f"front: {describe_score(score)} {score.subset}" for score in result.front]
    return summary, lines


def _report_curve(
    order: SearchOrder, objective: Objective, points: tuple[CurvePoint, ...]
) -> Answer:
    named = [set_names(objective.candidates, point.subset) for point in points]
    rows = [
        asdict(point) | {"sensors": [*names]} for point, names in zip(points, named, strict=True)
    ]
    summary = {
        "curve": rows,
        "judge": order.judge,
        "provenance": objective.provenance,
        **_state_errors(order),
    }
    if not points:
        return Answer(
            objective,
            replace_infinite(summary),
            (f"no sensors: {describe_empty(objective)}",),
            False,
        )
    budgets = (
        "of each number of sensors"
        if math.isinf(objective.most_price)
        else "for each amount of money"
    )
    lines = [
        (
            f"best set {budgets}, judged by the {order.judge} on traffic that had no part in the "
            "choice:"
        )
    ]
    for point, names in zip(points, named, strict=True):
        price = describe_money(point.price, order.currency)
        pays = "" if point.pays else ", no more than a cheaper one"
        judged = _judged(point, order.judge, point.objects)
        lines.append(f"  {point.sensors} for {price}: {judged}{pays}: {', '.join(names)}")
        if point.by_errors:
            profiles = describe_profiles(point.by_errors, point.objects)
            lines.append(f"    at each error profile: {profiles}")
    return Answer(objective, replace_infinite(summary), tuple(lines), True, points=points)


def _names(objective: Objective, subset: Iterable[int]) -> list[str]:
    return [objective.names[c] for c in subset]


def _state_errors(order: SearchOrder, by_errors: dict[str, float] | None = None) -> Summary:
    """Error profiles of the detections, empty without detection. by_errors: AP at each profile."""
    if not order.detects:
        return {}
    errors: Summary = {"errors": order.setting.cases.errors_origin}
    if by_errors:
        errors["by_errors"] = by_errors
    return errors


def describe_sensors(
    names: Sequence[str], moved: Sequence[Sensor] = (), site: Site | None = None
) -> list[str]:
    """Names of sensors, with any new positions (m) and directions (degrees).

    Directions are compass bearings at a site, otherwise headings from +x.
    """
    if not moved:
        return list(names)
    headings, tilts = aims(moved)
    if site is None:
        directions = [
            f"heading {degrees:.1f} (from +x)" for degrees in np.rad2deg(headings).tolist()
        ]
    else:
        directions = [
            f"bearing {round(bearing_deg(site, heading), 1) % 360:.1f}"
            for heading in headings.tolist()
        ]
    text = "{} moved to x {:.2f} y {:.2f} z {:.2f} m, {} tilt {:.1f} degrees"
    rows = zip(names, moved, directions, np.rad2deg(tilts).tolist(), strict=True)
    return [
        text.format(name, *sensor.position, direction, tilt)
        for name, sensor, direction, tilt in rows
    ]


def describe_mounted(objective: Objective, subset: Sequence[int]) -> list[str]:
    """Describe each sensor of a set: its name, model, height and direction."""
    candidates = objective.candidates
    site = objective.site
    sensors = [candidates.sensors[c] for c in subset]
    headings, tilts = aims(sensors)
    lines = []
    for k, name in enumerate(set_names(candidates, subset)):
        foot = candidates.mounts[candidates.mount[subset[k]]].position[2]
        height = f"{sensors[k].position[2] - foot:.1f} m up"
        if site is None:
            facing = f"facing {np.rad2deg(headings[k]):.0f} degrees from +x"
        else:
            facing = f"facing {bearing_deg(site, float(headings[k])):.0f} degrees from north"
        down = f"{np.rad2deg(tilts[k]):.0f} degrees down"
        lines.append(
            f"{name}: {name_in_words(type(sensors[k].model).__name__)}, {height}, {facing}, {down}"
        )
    return lines


def _judged(
    figure: Assessment | CurvePoint | Contender | ProfileAP, fidelity: str, objects: int
) -> str:
    """AP or coverage of a set with its interval, in as many decimals as the objects support."""
    interval = describe_interval(figure.low, figure.high, figure_digits(objects))
    name = "coverage" if fidelity == "coverage" else "AP"
    return f"{name} {format_share(figure.ap, objects)} ({interval})"


def describe_score(score: Score) -> str:
    """Figures of a set in one line."""
    by_class = (
        ", ".join(f"{name} {ap:.4f}" for name, ap in score.class_ap.items())
        if len(score.class_ap) > 1
        else ""
    )
    costs = (
        f"{score.kbit_per_sensor:.1f} kbit per sensor, {score.kbit:.1f} kbit, price {score.price:g}"
    )
    if score.fidelity == "coverage":
        return f"coverage {score.ap:.4f}{by_class and f' ({by_class})'}, {costs}"
    return (
        f"AP {score.ap:.4f}{by_class and f' ({by_class})'}, recall {score.recall:.4f}, {costs} "
        f"({score.fidelity})"
    )


def describe_assessment(assessment: Assessment) -> list[str]:
    """Lines on the assessment of the answer and of each search's answer."""
    fresh = "" if assessment.by == "detector" else ", not a detector: it may err alike everywhere"
    objects = assessment.objects
    rivals = f"{assessment.entrants} compared sets is better by more than {assessment.tolerance:g}"
    sureness = f"  {describe_sureness(assessment.confidence)} sure that none of the {rivals}"
    if math.isnan(assessment.confidence):
        sureness = f"  too few frames or objects to say how sure it is that none of the {rivals}"
    elif assessment.confidence < assessment.asked:
        sureness += f", short of the {assessment.asked:.0%} asked for"
    lines = [
        (
            f"judged by the {assessment.by} on {assessment.frames} frames that had no part in the "
            f"choice{fresh}:"
        ),
        f"  {_judged(assessment, assessment.by, objects)} on {objects} objects, "
        f"{assessment.kbit:.1f} kbit a frame; estimated "
        f"{format_share(assessment.predicted, objects)} by the search, "
        f"{format_share(assessment.expected, objects)} after the race",
        sureness,
    ]
    if assessment.by_errors:
        lines.append(
            f"  the {assessment.errors_by} over error profiles: "
            f"{describe_profiles(assessment.by_errors, objects)}"
        )
    return lines + [
        f"  {' and '.join(contender.searches)}: {_judged(contender, assessment.by, objects)}, "
        f"predicted {format_share(contender.predicted, objects)}, "
        f"{format_share(contender.curse, objects, signed=True)} too much"
        for contender in assessment.contenders
    ]


def describe_profiles(by_errors: Sequence[ProfileAP], objects: int) -> str:
    """AP at each error profile separately."""
    return ", ".join(
        f"{profile.name} {_judged(profile, 'detector', objects)}" for profile in by_errors
    )


def describe_by_errors(by_errors: Mapping[str, float]) -> list[str]:
    """Line with the AP at each error profile; empty without error profiles."""
    figures = [f"{name} {ap:.4f}" for name, ap in by_errors.items()]
    return [f"AP at each error profile: {', '.join(figures)}"] if figures else []


def describe_doubts(objective: Objective, subset: Sequence[int]) -> list[str]:
    """Lines on a surrogate's standard error for a set, and warnings about extrapolation.

    Empty for other fidelities."""
    surrogate = objective.scored_by
    if not isinstance(surrogate, Doubting):
        return []
    spread = float(surrogate.spread(objective.row(subset)[None])[0]) if subset else np.nan
    error = "an unknown error" if np.isnan(spread) else f"a standard error of {spread:.3f}"
    kinds = {type(sensor.model).__name__ for sensor in objective.candidates.sensors}
    warnings = [*surrogate.doubts(kinds), *_describe_few(objective)]
    lines = [f"the surrogate predicts the detector's AP with {error}"]
    return lines + [f"warning: {warning}" for warning in warnings]


def _describe_few(objective: Objective) -> list[str]:
    """Warning about levels of traffic with too few objects; empty if all have enough."""
    counts = {} if objective.preparation is None else objective.preparation.count_at_levels()
    rare = [f"{name} has {count}" for name, count in counts.items() if count < MIN_LEVEL_OBJECTS]
    remedy = f"fewer than {MIN_LEVEL_OBJECTS} objects at a level say little: increase --frames"
    return [f"{' and '.join(rare)} objects to find; {remedy}"] if rare else []


def describe_empty(objective: Objective) -> str:
    """Likely reasons for an empty answer, with remedies."""
    linked = objective.linked
    if not linked.any():
        frames = describe_share(objective.setting.link_share)
        min_kbit = float(objective.loads.min())
        max_capacity = float(objective.candidates.capacity.max())
        return (
            f"none of the {len(linked)} candidates fits its link: in {frames} they send up to "
            f"{min_kbit:.0f} kbit or more, and no link carries more than {max_capacity:.0f}: give "
            "mounts more, or pass --scheme late, which sends boxes"
        )
    singles = objective.scores(np.eye(len(linked), dtype=np.bool_)[linked])
    if float(singles.ap.max()) <= 0:
        nouns = " or a ".join(objective.classes.names)
        return (
            f"no candidate that fits its link detects a {nouns} in these frames: more --frames, "
            "other --candidates?"
        )
    if float(singles.reward.max()) <= 0:
        return "no sensor is worth what it costs: lower --comm and --price"
    return (
        "the search stopped before it had scored a set that may be built: give it more --seconds "
        "or --evaluations"
    )


def check_present(objective: Objective) -> None:
    """Raise ValueError if a counted class has no objects."""
    classes = objective.classes
    visibility = objective.visibility
    if visibility is not None:
        is_present = [bool((visibility.labels == label).any()) for label in classes.labels]
    else:
        everything = np.ones((1, len(objective.candidates)), np.bool_)
        is_present = (~np.isnan(objective.class_ap(everything)[0])).tolist()
    rows = zip(classes.names, is_present, strict=True)
    missing = [name for name, present in rows if not present]
    if missing:
        problem = f"there is no {' and no '.join(missing)} to find in these frames"
        raise ValueError(f"{problem}: say more --frames or another --seed, or leave out the class")


def describe_exclusions(
    objective: Objective, max_kbit: float | None = None, currency: str = ""
) -> tuple[str, ...]:
    """Sentences on what excludes candidates: how many, and the requirement that is closest to being
    met."""
    candidates = objective.candidates
    loads = objective.loads
    linked = objective.linked
    count = len(candidates)
    reasons = []
    frames = describe_share(objective.setting.link_share)
    if not linked.all():
        closest = int(np.flatnonzero(~linked)[np.argmin(loads[~linked])])
        reasons.append(
            f"The links exclude {int((~linked).sum())} of {count} candidates: the least that any "
            f"of these sends in {frames} is up to {loads[closest]:.1f} kbit, over a link of "
            f"{candidates.capacity[closest]:g} kbit."
        )
    if max_kbit is not None and (loads > max_kbit).any():
        reasons.append(
            f"The limit of {max_kbit:g} kbit per sensor and frame excludes "
            f"{int((loads > max_kbit).sum())} of {count} candidates: the least that any candidate "
            f"sends in {frames} is up to {loads.min():.1f} kbit."
        )
    affordable = objective.affordable(candidates.prices)
    if not affordable.all():
        money = describe_money(objective.most_price, currency)
        excluded = int((~affordable).sum())
        costs = f"the cheapest of all costs {describe_money(candidates.prices.min(), currency)}"
        reasons.append(f"The sum of {money} excludes {excluded} of {count} candidates: {costs}.")
    return tuple(reasons)


def explain_kept(
    objective: Objective,
    is_allowed: Bool[np.ndarray, " C"],
    max_kbit: float = math.inf,
    currency: str = "",
) -> tuple[str, ...]:
    """Sentences on why the poles that must carry a sensor cannot all have one.

    is_allowed: candidates that may be built.
    """
    candidates = objective.candidates
    min_price = 0.0
    reasons = list[str]()

    def cost(amount: float) -> str:
        available = describe_money(objective.most_price, currency)
        return f"{describe_money(amount, currency)} or more, and {available} may be spent"

    for mount in objective.kept.tolist():
        name = candidates.mounts[mount].name
        poses = np.flatnonzero(candidates.mount == mount)
        if not len(poses):
            cause = "no pose on it sees the detection area"
        elif not objective.linked[poses].any():
            cause = (
                f"each pose sends more than its link of {candidates.capacity[poses[0]]:g} kbit per "
                "frame carries"
            )
        elif (objective.loads[poses] > max_kbit).all():
            cause = (
                f"each pose sends {objective.loads[poses].min():.1f} kbit per frame or more; "
                f"{max_kbit:g} are allowed"
            )
        elif not objective.affordable(candidates.prices[poses]).any():
            cause = f"a sensor there costs {cost(float(candidates.prices[poses].min()))}"
        elif not is_allowed[poses].any():
            cause = "links, money and drawings of the site leave no pose"
        else:
            min_price += float(candidates.prices[poses][is_allowed[poses]].min())
            continue
        reasons.append(f"Pole {name} must carry a sensor, but cannot: {cause}.")
    if not reasons and not objective.affordable(np.array([min_price]))[0]:
        names = join_names([candidates.mounts[mount].name for mount in objective.kept])
        reasons.append(f"Sensors on {names}, as asked, cost together {cost(min_price)}.")
    return tuple(reasons)


def describe_money(amount: float, currency: str) -> str:
    """Amount of money in words."""
    if currency:
        return f"{round(amount, 2):,.10g} {currency}"
    return f"the price of {round(amount, 2):g} ordinary {'pole' if amount == 1 else 'poles'}"
