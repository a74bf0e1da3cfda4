"""`coview search`: which sensors to build."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from coview.arguments import check_least, check_positive, check_schemes, check_share, site_file
from coview.exits import NOT_MET, OK
from coview.options import Output, SettingOptions
from coview.outputs import check_folder, check_writable
from coview.printing import print_result
from coview.progress_bar import progress_bar
from placement_env.cases import USUAL_CASES
from toolkit.runtime.run import Run

if TYPE_CHECKING:
    from placement_env.search.exact.cheapest import Demand

Method = Literal["portfolio", "exhaustive", "greedy", "raced", "swap", "cpsat", "hits", "cheapest", "cmaes", "ppo"]


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Search for an answer, and check of it."""

    method: Method | None = None
    """Search: portfolio runs several, lets their answers race on fresh traffic and judges the winner on other; cpsat
    proves how much more could be covered, hits how much more be hit, exhaustive needs 16 candidates or fewer, raced
    needs fidelity detector, cmaes turns and lifts what greedy found, ppo learns a policy first. Left out: portfolio;
    exhaustive for fidelity table, greedy with --verify, cheapest with --at-least."""
    budget: int = 4
    """Most sensors."""
    verify: Literal["detector"] | None = None
    """Score what one method found, and its best neighbours, with the detector."""
    judge: Literal["detector", "surrogate", "coverage"] | None = None
    """Fidelity of a portfolio's race and answer: the detector when left out, another where none knows the classes."""
    confidence: float = 0.95
    """Confidence at which the race ends: that no entrant is better by more than 0.01."""
    curve: bool = False
    """Print the best AP of every number of sensors up to the budget, or for every amount of --money up to that."""
    at_least: float | None = None
    """AP, or share covered, to reach: the answer is the cheapest set that does, whichever sensor fails and at each of
    the --levels, and a proven bound."""
    parts: int = 1
    """Consecutive parts of the traffic, in each of which --at-least must be reached."""
    seconds: float | None = None
    """Time limit after the candidates are rendered; a portfolio races and judges within it too."""
    evaluations: int | None = None
    """Most sets to score."""

    def __post_init__(self) -> None:
        check_least("--budget", self.budget, 1)
        check_least("--parts", self.parts, 1)
        check_positive("--seconds", self.seconds)
        check_positive("--evaluations", self.evaluations)
        check_share("--confidence", self.confidence)


def search(
    site: Positional[str],
    /,
    *,
    how: SearchOptions = SearchOptions(),
    setting: SettingOptions = SettingOptions(),
    run: Run = Run(frames=200, cache=Path("out/cache")),
    output: Output = Output(),
) -> int:
    """Search the sensors to build: which poles, headings and tilts, at most a budget of them.

    With --out the folder gets the site with its sensors, schedule, map, picture and origin; with --curve a table,
    picture, origin, and the site with each set. Of the frames, a portfolio has up to 96 more to race on and 120 to
    judge by.

    Example: coview search tjunction --budget 4 --scheme early --confidence 0.9 --out answer

    Args:
        site: tjunction, roundabout, or a site file.
    """
    from placement_env.search.answer import answer_files, check_georeference, write_answer
    from placement_env.search.order import SearchOrder, run_search
    from toolkit.sites.files import load_site

    method = _check(how, setting)
    if run.cache is not None:
        check_writable(run.cache.resolve(), run.cache)
    place = load_site(site)
    if output.out is not None:
        check_georeference(place)
    demand, asked = _demand(how, setting)
    built, currency = asked.build(place, run)
    with progress_bar("", hidden=output.json) as bar:
        order = SearchOrder(
            setting=built,
            run=replace(run, progress=bar.stage),
            method=method,
            budget=how.budget,
            verify=how.verify,
            judge=how.judge or "detector",
            confidence=how.confidence,
            seconds=how.seconds,
            evaluations=how.evaluations,
            demand=demand,
            curve=how.curve,
            currency=currency,
        )
        inputs = [*site_file(site), *site_file(setting.candidates.candidates)]
        if output.out is not None:
            for name in answer_files(order):
                check_folder(output.out, holds=name, inputs=inputs, overwrite=output.overwrite)
        with order.keeping(output.out, overwrite=output.overwrite) as (kept, checkpoint):
            answer = run_search(kept, checkpoint)
            written = [] if output.out is None or not answer.met else [write_answer(output.out, kept, answer)]
    print_result(answer.summary, "\n".join([*answer.lines, *written]), as_json=output.json)
    return OK if answer.met else NOT_MET


def _check(how: SearchOptions, setting: SettingOptions) -> str:
    """Method to use. Raises ValueError where options do not fit each other."""
    from placement_env.search.methods import usual_method

    check_schemes([setting.scheme])
    method: str = how.method or usual_method(
        setting.fidelity, verify=how.verify is not None, at_least=how.at_least is not None
    )
    if (method == "cheapest") != (how.at_least is not None) or (how.at_least is None and how.parts > 1):
        raise ValueError("--method cheapest and --parts go with --at-least 0.9, and no other method does")
    if how.at_least is not None and "mean" in (setting.cases.failures, setting.cases.levels_by):
        raise ValueError("--at-least asks for the worst case: leave --failures mean and --levels-by mean out")
    if how.verify is not None and method == "portfolio":
        raise ValueError("--verify is for one method: portfolio is judged by --judge on fresh traffic anyway")
    for option, said in (("--judge", how.judge), ("--curve", how.curve or None)):
        if said is not None and method != "portfolio":
            raise ValueError(f"{option} is for --method portfolio, got {method}: leave one of them out")
    judged = method == "portfolio" and how.judge in (None, "detector")
    detects = "detector" in (setting.fidelity, how.verify) or judged
    errors = setting.cases.errors != USUAL_CASES.errors
    for option, given in (("--errors", errors), ("--detector", setting.detector is not None)):
        if given and not detects:
            raise ValueError(f"{option} is for --fidelity, --verify or --judge detector: say one of them")
    return method


def _demand(how: SearchOptions, setting: SettingOptions) -> tuple[Demand | None, SettingOptions]:
    """Demand on the cheapest set, which takes failures and levels out of the setting; None where a budget is given."""
    from placement_env.search.exact.cheapest import Demand

    if how.at_least is None:
        return None, setting
    demand = Demand(how.at_least, setting.cases.failing, how.parts, setting.cases.levels)
    return demand, replace(setting, cases=replace(setting.cases, failing=0, levels=1))
