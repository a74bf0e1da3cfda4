"""`SearchOrder`, which describes one search, and `run_search`, which answers it, also in words."""

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
FEWEST_AT_LEVEL = 100  # objects, below which a level of traffic is warned about
UNFINISHED = ".parts"  # after the name of a folder: where the search for it is unfinished
USUAL_FRAMES = 200
BETTER = 0.001  # AP by which an answer must be better than the last one that was said
SEARCHED = 48  # frames, spread over all, that a portfolio's searches look at if there are as many
Summary = dict[str, Any]  # JSON values


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOrder:
    """Specification of a search. Raises ValueError and ImportError, before anything is rendered,
    where it does not fit.

    setting: the question, with the errors of the detecting fidelities; method: of
    `placement_env.search.methods`; budget: most sensors; verify: fidelity that scores an answer and
    its neighbours; judge, confidence, contenders: of a portfolio's race and assessment; demand: of
    the cheapest set; curve: the best set of every number of sensors up to the budget, or for every
    amount of money where it is limited, by a portfolio; currency: of prices, "" for those of one
    ordinary pole; tell: takes a line with a first answer."""

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
        check_search(self.method, self.fidelity, setting.pool, setting.cases)
        setting.check_budget(self.budget)
        if setting.keep and self.method == "ppo":
            raise ValueError(
                "method ppo does not know poles that must carry a sensor: say --method portfolio "
                "or swap"
            )
        if self.fidelity == "table" and setting.codec != PAPER:
            raise ValueError(
                f"tables hold kbit of the paper's codec, got {setting.codec}: say --codec paper"
            )
        for path, own in ((setting.surrogate, "surrogate"), (setting.table, "table")):
            if path is not None and own != self.fidelity:
                raise ValueError(
                    f"this file is for fidelity {own}, got {self.fidelity!r}: leave one of them out"
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
        """Setting of the search itself. A fidelity that does not detect knows no errors but the
        sensors' own noise."""
        return self.setting.with_fidelity(self.fidelity)

    @property
    def detects(self) -> bool:
        """True where the detector scores anything."""
        return "detector" in (
            self.fidelity,
            self.verify,
            self.judge if self.method == PORTFOLIO else None,
        )

    @property
    def question(self) -> Summary:
        """Everything the answer depends on, as JSON values. These must be equal for a search to
        resume."""
        setting = self.setting
        files = {"surrogate": setting.surrogate, "table": setting.table}
        own = (
            "method",
            "budget",
            "verify",
            "judge",
            "confidence",
            "contenders",
            "seconds",
            "evaluations",
        )
        return {
            **{name: getattr(self, name) for name in (*own, "currency", "curve")},
            **({} if self.demand is None else asdict(self.demand)),
            **{
                name: path and sha256(Path(path).read_bytes()).hexdigest()
                for name, path in files.items()
            },
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
            **({"keep": setting.keep} if setting.keep else {}),
        }

    def resumes(self, out: Path) -> bool:
        """True where a search with this question was killed that had not ended normally."""
        kept = find_unfinished(out.with_name(out.name + UNFINISHED), self.question)
        return kept.found == kept.plan

    @contextmanager
    def keeping(
        self, out: Path | None, *, overwrite: bool = False
    ) -> "Iterator[tuple[SearchOrder, Checkpoint]]":
        """The order with the checkpoint of its answer in a folder, None for nowhere. The block must
        write the answer.

        Until it ends normally, the state of the search stands beside the folder, in one with the
        suffix `UNFINISHED`, where the same question resumes. Raises FileExistsError where another
        search is unfinished and may not be overwritten."""
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
    """Answer to an order. summary: for JSON; lines: to print; met: True where any sensor is to be
    built. result, chosen: of one search, and the set to hand over, which a check may have changed;
    points: of a curve."""

    objective: Objective
    summary: Summary
    lines: tuple[str, ...]
    met: bool
    result: Result | None = None
    chosen: tuple[int, ...] = ()
    points: tuple[CurvePoint, ...] = ()


def run_search(order: SearchOrder, checkpoint: Checkpoint = NOWHERE) -> Answer:
    """Search as ordered, and check the answer. checkpoint: where the state of the search is
    kept."""
    frames = order.run.frames_or(USUAL_FRAMES)
    stride = (
        max(1, frames // SEARCHED)
        if order.method == PORTFOLIO and order.fidelity in BY_LEVELS
        else 1
    )
    tells = (
        order.tell is not None
        and stride > 1
        and order.setting.cases.levels == 1
        and not order.curve
    )
    first = None
    narrowed = ""
    pool = order.setting.pool
    chosen_poses = narrow_pool(order.searched, order.run, stride)
    if chosen_poses is not None:
        narrowed = describe_narrowing(pool, chosen_poses)
        order = replace(order, setting=replace(order.setting, candidates=pool.select(chosen_poses)))
        if order.tell is not None:
            order.tell(narrowed)
    if tells:
        first = _find_first(order, prepare_first_look(order.searched, order.run, stride))
    objective = Objective(order.searched, order.run, stride=stride)
    if order.tell is not None and first is not None:
        objective.watch = _Better(objective, first, order.tell)
    check_present(objective)
    alone = objective.allowed([])
    reasons = explain_kept(objective, alone, currency=order.currency)
    if reasons or not alone.any():
        reasons = reasons or describe_exclusions(objective, currency=order.currency)
        line = f"none may be built: {' '.join(reasons)}"
        return Answer(objective, {"sensors": [], "reasons": reasons}, (line,), False)
    judging = Judging(
        by=order.judge,
        confidence=order.confidence,
        contenders=order.contenders,
        race_frames=min(RACE_FRAMES, frames),
        final_frames=min(JUDGED_FRAMES, frames),
        setting=order.setting.with_fidelity(order.judge) if order.method == PORTFOLIO else None,
    )
    limits: Summary = {
        "seed": order.run.seed,
        "seconds": order.seconds,
        "evaluations": order.evaluations,
    }
    if order.curve:
        most = objective.most_price
        amounts = () if math.isinf(most) else list_amounts(objective, order.budget, most)
        curve = budget_curve(
            objective,
            order.budget,
            amounts=amounts,
            judging=judging,
            checkpoint=checkpoint,
            **limits,
        )
        reported = _report_curve(order, objective, curve)
        return replace(reported, lines=(*reported.lines, narrowed)) if narrowed else reported
    own: Summary = {} if order.demand is None else {"demand": order.demand}
    own |= {"judging": judging} if order.method == PORTFOLIO else {}
    own |= {"checkpoint": checkpoint} if METHODS[order.method].resumes else {}
    result = load_search(order.method)(objective, order.budget, **limits, **own)
    chosen = result.best.subset
    by_errors = ap_at_profiles(objective, chosen, result.sensors)
    summary, lines = _report(objective, result)
    if narrowed:
        summary["narrowed"] = narrowed
        lines.append(narrowed)
    lines += [f"asked to build on: {', '.join(order.setting.keep)}"] if order.setting.keep else []
    summary |= _state_errors(order, by_errors)
    if not chosen:
        why = describe_empty(objective) if order.demand is None else result.certificate.note
        return Answer(objective, summary, (f"no sensors: {why}",), False)
    lines += describe_by_errors(by_errors)
    if order.verify is not None:
        exact = Objective(order.setting.with_fidelity(order.verify), order.run)
        checked, sets = verify_best(objective, exact, result)
        chosen = checked.subset
        names = _names(objective, chosen)
        by_errors = ap_at_profiles(exact, chosen, result.sensors)
        mounted = names if result.sensors else describe_mounted(objective, chosen)
        summary["verified"] = {**asdict(checked), "sensors": names, "provenance": exact.provenance}
        summary["verified"] |= {"by_errors": by_errors} if by_errors else {}
        lines += [
            f"by the {order.verify}, {'moved' if result.sensors else f'best of {sets} sets'}:"
        ]
        lines += [
            *(f"  {line}" for line in mounted),
            describe_score(checked),
            *describe_by_errors(by_errors),
        ]
    return Answer(
        objective,
        replace_infinite(summary),
        tuple(line for line in lines if line),
        True,
        result,
        chosen,
    )


def _find_first(order: SearchOrder, few: Preparation) -> Score:
    """Tell greedy's answer from the first frames that are looked at, in seconds, and return its
    score there."""
    objective = Objective.of_moved(few, few.setting.pool, few.visibility, order.setting.weights)
    best = load_search("greedy")(objective, order.budget, seed=order.run.seed).best
    names = ", ".join(set_names(objective.candidates, best.subset)) or "no sensors"
    if order.tell is not None:
        order.tell(
            f"first answer, by greedy on {len(few.traffic)} frames: {names}, predicted AP "
            f"{best.ap:.3f}"
        )
    return best


class _Better:
    """Watch of a search that tells each better set: by its prediction, then the one ahead in the
    race."""

    def __init__(self, objective: Objective, first: Score, tell: Callable[[str], None]) -> None:
        self._objective = objective
        self._tell = tell
        self._last = first.subset
        self._reward = objective.score(first.subset).reward

    def __call__(self, subset: tuple[int, ...], reward: float, raced: int) -> None:
        if subset == self._last or (not raced and reward < self._reward + BETTER):
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
    lines = [str(result), result.certificate.note, *(f"  {line}" for line in mounted)]
    if assessment is not None:
        said = asdict(assessment) | {"curse": assessment.curse}
        for row, contender in zip(said["contenders"], assessment.contenders, strict=True):
            row |= {"sensors": _names(objective, contender.subset), "curse": contender.curse}
        summary["assessment"] = said
        lines += describe_assessment(assessment)
    lines += [
        f"{'' if assessment is None else 'estimate of the search: '}{describe_score(best)}",
        *doubts,
    ]
    return summary, lines + [
        f"front: {describe_score(score)} {score.subset}" for score in result.front
    ]


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
    of = (
        "of each number of sensors"
        if math.isinf(objective.most_price)
        else "for each amount of money"
    )
    lines = [
        f"best set {of}, judged by the {order.judge} on traffic that had no part in the choice:"
    ]
    for point, names in zip(points, named, strict=True):
        price = describe_money(point.price, order.currency)
        pays = "" if point.pays else ", no more than a cheaper one"
        judged = _judged(point, order.judge, point.objects)
        lines.append(f"  {point.sensors} for {price}: {judged}{pays}: {', '.join(names)}")
        lines += (
            [f"    at each error profile: {describe_profiles(point.by_errors, point.objects)}"]
            if point.by_errors
            else []
        )
    return Answer(objective, replace_infinite(summary), tuple(lines), True, points=points)


def _names(objective: Objective, subset: Iterable[int]) -> list[str]:
    return [objective.names[c] for c in subset]


def _state_errors(order: SearchOrder, by_errors: dict[str, float] | None = None) -> Summary:
    """Error profiles of the detections, where there are any. by_errors: AP at each of several,
    where it is known."""
    if not order.detects:
        return {}
    return {"errors": order.setting.cases.errors_origin} | (
        {"by_errors": by_errors} if by_errors else {}
    )


def describe_sensors(
    names: Sequence[str], moved: Sequence[Sensor] = (), site: Site | None = None
) -> list[str]:
    """Names of sensors, with any new poses (degrees): compass bearings at a site, else headings
    from +x."""
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


def _judged(each: Assessment | CurvePoint | Contender | ProfileAP, by: str, objects: int) -> str:
    """The figure that a fidelity gives, with its interval and as many decimals as the objects
    support. Coverage is no AP."""
    ends = describe_interval(each.low, each.high, figure_digits(objects))
    return f"{'coverage' if by == 'coverage' else 'AP'} {format_share(each.ap, objects)} ({ends})"


def describe_score(score: Score) -> str:
    """The figures of a set in one line."""
    each = (
        ", ".join(f"{name} {ap:.4f}" for name, ap in score.class_ap.items())
        if len(score.class_ap) > 1
        else ""
    )
    sent = (
        f"{score.kbit_per_sensor:.1f} kbit per sensor, {score.kbit:.1f} kbit, price {score.price:g}"
    )
    if score.fidelity == "coverage":
        return f"coverage {score.ap:.4f}{each and f' ({each})'}, {sent}"
    return (
        f"AP {score.ap:.4f}{each and f' ({each})'}, recall {score.recall:.4f}, {sent} "
        f"({score.fidelity})"
    )


def describe_assessment(assessment: Assessment) -> list[str]:
    """Lines on the answer's judgement and each search's own."""
    fresh = "" if assessment.by == "detector" else ", not a detector: it may err alike everywhere"
    objects = assessment.objects
    compared = (
        f"{assessment.entrants} compared sets is better by more than {assessment.tolerance:g}"
    )
    sure = f"  {describe_sureness(assessment.confidence)} sure that none of the {compared}"
    if math.isnan(assessment.confidence):
        sure = f"  too few frames or objects to say how sure it is that none of the {compared}"
    elif assessment.confidence < assessment.asked:
        sure += f", short of the {assessment.asked:.0%} asked for"
    lines = [
        (
            f"judged by the {assessment.by} on {assessment.frames} frames that had no part in the "
            f"choice{fresh}:"
        ),
        f"  {_judged(assessment, assessment.by, objects)} on {objects} objects, "
        f"{assessment.kbit:.1f} kbit a frame; estimated "
        f"{format_share(assessment.predicted, objects)} by the search, "
        f"{format_share(assessment.expected, objects)} after the race",
        sure,
    ]
    if assessment.by_errors:
        lines.append(
            f"  the {assessment.errors_by} over error profiles: "
            f"{describe_profiles(assessment.by_errors, objects)}"
        )
    return lines + [
        f"  {' and '.join(each.searches)}: {_judged(each, assessment.by, objects)}, predicted "
        f"{format_share(each.predicted, objects)}, "
        f"{format_share(each.curse, objects, signed=True)} too much"
        for each in assessment.contenders
    ]


def describe_profiles(by_errors: Sequence[ProfileAP], objects: int) -> str:
    """AP at each error profile by itself."""
    return ", ".join(f"{each.name} {_judged(each, 'detector', objects)}" for each in by_errors)


def describe_by_errors(by_errors: Mapping[str, float]) -> list[str]:
    """A line of the AP at each error profile. Empty without error profiles."""
    said = [f"{name} {ap:.4f}" for name, ap in by_errors.items()]
    return [f"AP at each error profile: {', '.join(said)}"] if said else []


def describe_doubts(objective: Objective, subset: Sequence[int]) -> list[str]:
    """Lines on the surrogate's uncertainty about a set and on what it was not trained for. Empty
    for others."""
    surrogate = objective.scored_by
    if not isinstance(surrogate, Doubting):
        return []
    spread = float(surrogate.spread(objective.row(subset)[None])[0]) if subset else np.nan
    error = "an unknown error" if np.isnan(spread) else f"a standard error of {spread:.3f}"
    sure = [f"the surrogate predicts the detector's AP with {error}"]
    kinds = {type(sensor.model).__name__ for sensor in objective.candidates.sensors}
    return [
        *sure,
        *(f"warning: {doubt}" for doubt in (*surrogate.doubts(kinds), *_describe_few(objective))),
    ]


def _describe_few(objective: Objective) -> list[str]:
    """Levels of traffic with too few objects."""
    counts = {} if objective.preparation is None else objective.preparation.count_at_levels()
    few = [f"{name} has {count}" for name, count in counts.items() if count < FEWEST_AT_LEVEL]
    least = f"fewer than {FEWEST_AT_LEVEL} objects at a level say little: increase --frames"
    return [f"{' and '.join(few)} objects to find; {least}"] if few else []


def describe_empty(objective: Objective) -> str:
    """Likely reasons for an empty answer, with remedies."""
    linked = objective.linked
    if not linked.any():
        frames = describe_share(objective.setting.link_share)
        least = float(objective.loads.min())
        most = float(objective.candidates.capacity.max())
        return (
            f"none of the {len(linked)} candidates fits its link: in {frames} they send up to "
            f"{least:.0f} kbit or more, and no link carries more than {most:.0f}: give mounts "
            "more, or say --scheme late, which sends boxes"
        )
    alone = objective.scores(np.eye(len(linked), dtype=np.bool_)[linked])
    if float(alone.ap.max()) <= 0:
        there = " or a ".join(objective.classes.names)
        return (
            f"no candidate that fits its link detects a {there} in these frames: more --frames, "
            "other --candidates?"
        )
    if float(alone.reward.max()) <= 0:
        return "no sensor is worth what it costs: lower --comm and --price"
    return (
        "the search stopped before it had scored a set that may be built: give it more --seconds "
        "or --evaluations"
    )


def check_present(objective: Objective) -> None:
    """Raise ValueError where a counted class has no objects."""
    classes = objective.classes
    seen = objective.visibility
    if seen is not None:
        there = [bool((seen.labels == label).any()) for label in classes.labels]
    else:
        there = (
            ~np.isnan(objective.class_ap(np.ones((1, len(objective.candidates)), np.bool_))[0])
        ).tolist()
    if missing := [
        name for name, is_there in zip(classes.names, there, strict=True) if not is_there
    ]:
        said = f"there is no {' and no '.join(missing)} to find in these frames"
        raise ValueError(f"{said}: say more --frames or another --seed, or leave out the class")


def describe_exclusions(
    objective: Objective, max_kbit: float | None = None, currency: str = ""
) -> tuple[str, ...]:
    """Sentences on what excludes candidates, with their number and the requirement of the least
    demanding one."""
    candidates = objective.candidates
    sent = objective.loads
    linked = objective.linked
    count = len(candidates)
    reasons = []
    frames = describe_share(objective.setting.link_share)
    if not linked.all():
        least = int(np.flatnonzero(~linked)[np.argmin(sent[~linked])])
        reasons.append(
            f"The links exclude {int((~linked).sum())} of {count} candidates: the least that any "
            f"of these sends in {frames} is up to {sent[least]:.1f} kbit, over a link of "
            f"{candidates.capacity[least]:g} kbit."
        )
    if max_kbit is not None and (sent > max_kbit).any():
        reasons.append(
            f"The limit of {max_kbit:g} kbit per sensor and frame excludes "
            f"{int((sent > max_kbit).sum())} of {count} candidates: the least that any candidate "
            f"sends in {frames} is up to {sent.min():.1f} kbit."
        )
    affordable = objective.affordable(candidates.prices)
    if not affordable.all():
        money, least_price = (
            describe_money(x, currency) for x in (objective.most_price, candidates.prices.min())
        )
        excluded = int((~affordable).sum())
        costs = f"the cheapest of all costs {least_price}"
        reasons.append(f"The sum of {money} excludes {excluded} of {count} candidates: {costs}.")
    return tuple(reasons)


def explain_kept(
    objective: Objective,
    alone: Bool[np.ndarray, " C"],
    max_kbit: float = math.inf,
    currency: str = "",
) -> tuple[str, ...]:
    """Sentences on why the poles that must carry a sensor cannot all have one. alone: candidates
    that may be built."""
    candidates = objective.candidates
    least = 0.0
    reasons = list[str]()

    def cost(amount: float) -> str:
        needed, most = (describe_money(x, currency) for x in (amount, objective.most_price))
        return f"{needed} or more, and {most} may be spent"

    for mount in objective.kept.tolist():
        name = candidates.mounts[mount].name
        own = np.flatnonzero(candidates.mount == mount)
        if not len(own):
            why = "no pose on it sees the detection area"
        elif not objective.linked[own].any():
            why = (
                f"each pose sends more than its link of {candidates.capacity[own[0]]:g} kbit per "
                "frame carries"
            )
        elif (objective.loads[own] > max_kbit).all():
            why = (
                f"each pose sends {objective.loads[own].min():.1f} kbit per frame or more; "
                f"{max_kbit:g} are allowed"
            )
        elif not objective.affordable(candidates.prices[own]).any():
            why = f"a sensor there costs {cost(float(candidates.prices[own].min()))}"
        elif not alone[own].any():
            why = "links, money and drawings of the site leave no pose"
        else:
            least += float(candidates.prices[own][alone[own]].min())
            continue
        reasons.append(f"Pole {name} must carry a sensor, but cannot: {why}.")
    if not reasons and not objective.affordable(np.array([least]))[0]:
        names = join_names([candidates.mounts[mount].name for mount in objective.kept])
        reasons.append(f"Sensors on {names}, as asked, cost together {cost(least)}.")
    return tuple(reasons)


def describe_money(amount: float, currency: str) -> str:
    """A sum in words."""
    if currency:
        return f"{round(amount, 2):,.10g} {currency}"
    return f"the price of {round(amount, 2):g} ordinary {'pole' if amount == 1 else 'poles'}"
