"""`coview search`: which sensors to build."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from coview.arguments import check_least, check_positive, check_schemes, check_share, site_file
from coview.options import Output, SettingOptions
from coview.outputs import NOT_MET, OK, check_folder, check_writable, print_result
from coview.progress_bar import progress_bar
from placement_env.defaults import USUAL_CASES
from placement_env.search.methods import usual_method
from toolkit.runtime.run import USUAL_WORKERS, Run
from toolkit.sites.files import load_site

if TYPE_CHECKING:
    from placement_env.search.order import SearchOrder

SEARCH_STEPS = {  # shares of a search's time
    "poses rendered": 0.3,
    "searches": 0.2,
    "frames raced": 0.35,
    "frames judged": 0.15,
}
Method = Literal[
    "portfolio",
    "exhaustive",
    "greedy",
    "raced",
    "swap",
    "cpsat",
    "hits",
    "cheapest",
    "cmaes",
    "ppo",
]


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Search, and check of its answer."""

    method: Method | None = None
    """Search method: portfolio races several searches on fresh traffic; chosen by the other options
    when left out."""
    budget: int = 4
    """Maximum number of sensors."""
    verify: Literal["detector"] | None = None
    """Score the answer of one method, and its best neighbours, with the detector."""
    judge: Literal["detector", "surrogate", "coverage"] | None = None
    """What judges a portfolio: the detector when left out; another where no detector knows the
    classes."""
    contenders: bool = False
    """Judge the answer of each of a portfolio's searches too, to see how far each overrates it."""
    confidence: float = 0.95
    """Confidence, at the end of a portfolio's race, that no other set is better by more than
    0.01."""
    curve: bool = False
    """Print the best AP for every number of sensors up to --budget, or for every sum up to
    --money."""
    at_least: float | None = None
    """Score to reach, whichever sensor fails and at every traffic level; finds the cheapest set
    that does."""
    parts: int = 1
    """Number of consecutive parts of the traffic that must each reach --at-least."""
    seconds: float | None = None
    """Time limit after the candidates are rendered."""
    evaluations: int | None = None
    """Maximum number of sets to score."""

    def __post_init__(self) -> None:
        """Raise ValueError for an option out of range."""
        check_least("--budget", self.budget, 1)
        check_least("--parts", self.parts, 1)
        check_positive("--seconds", self.seconds)
        check_positive("--evaluations", self.evaluations)
        check_share("--confidence", self.confidence)


def search_command(
    site: Positional[str],
    /,
    *,
    search: SearchOptions = SearchOptions(),
    setting: Annotated[SettingOptions, tyro.conf.arg(name="")] = SettingOptions(),
    run: Run = Run(frames=200, cache=Path("out/cache"), workers=USUAL_WORKERS),
    output: Output = Output(),
) -> int:
    """Search for the sensors to build: which poles, headings and tilts.

    With --out, the folder gets the site with its sensors, a schedule, a map and a picture; with
    --curve, a table, a picture and the site with each set. A portfolio uses up to 96 more frames
    for its race and 120 to judge the winner.

    The methods cpsat and hits prove how much more could be covered or hit, exhaustive needs at most
    16 candidates, raced needs --fidelity detector, cmaes turns and lifts what greedy found, and ppo
    learns a policy first. Left out, the method is portfolio, or exhaustive for --fidelity table,
    greedy with --verify, cheapest with --at-least.

    Example: coview search tjunction --budget 4 --scheme early --confidence 0.9 --out answer

    Args:
        site: tjunction, roundabout, or a site file."""
    from placement_env.search.answer import check_georeference, write_answer
    from placement_env.search.exact.cheapest import Demand
    from placement_env.search.order import SearchOrder
    from placement_env.search.search_run import run_search

    method = _check(search, setting)
    if run.cache is not None:
        check_writable(run.cache.resolve(), run.cache)
    loaded_site = load_site(site)
    if output.out is not None:
        check_georeference(loaded_site)
    demand = None
    if search.at_least is not None:  # the demand takes failures and levels out of the setting
        demand = Demand(search.at_least, setting.cases.failing, search.parts, setting.cases.levels)
        setting = replace(setting, cases=replace(setting.cases, failing=0, levels=1))
    built_setting, currency = setting.build(loaded_site, run)
    with progress_bar("", hidden=output.json, steps=SEARCH_STEPS) as bar:
        order = SearchOrder(
            setting=built_setting,
            run=replace(run, progress=bar.stage),
            method=method,
            budget=search.budget,
            verify=search.verify,
            judge=search.judge or "detector",
            confidence=search.confidence,
            contenders=search.contenders,
            seconds=search.seconds,
            evaluations=search.evaluations,
            demand=demand,
            curve=search.curve,
            currency=currency,
            tell=bar.line,
        )
        inputs = [*site_file(site), *site_file(setting.candidates.candidates)]
        if output.out is not None:
            _check_answer_folder(output.out, order, inputs, overwrite=output.overwrite)
        with order.keeping(output.out, overwrite=output.overwrite) as (kept_order, checkpoint):
            answer = run_search(kept_order, checkpoint)
            lines = list(answer.lines)
            if output.out is not None and answer.met:
                lines.append(write_answer(output.out, kept_order, answer))
    print_result(answer.summary, "\n".join(lines), as_json=output.json)
    return OK if answer.met else NOT_MET


def _check_answer_folder(
    out: Path, order: "SearchOrder", inputs: Sequence[Path], *, overwrite: bool
) -> None:
    """Check that the answer to an order may be written into a folder.

    inputs: files that the command reads; overwrite: True to replace an earlier answer, as one that
    is resumed always is. Raises what `check_folder` raises."""
    from placement_env.search.answer import ANSWER_JSON, CURVE_JSON, answer_files

    check_folder(
        out,
        holds=CURVE_JSON if order.curve else ANSWER_JSON,
        inputs=inputs,
        overwrite=overwrite or order.resumes(out),
        writes=answer_files(order),
    )


def _check(query: SearchOptions, setting: SettingOptions) -> str:
    """Return the method to use. Raises ValueError if options conflict."""
    check_schemes([setting.scheme])
    demands = query.at_least is not None
    verifies = query.verify is not None
    method: str = query.method or usual_method(setting.fidelity, verify=verifies, at_least=demands)
    if (method == "cheapest") != demands or (query.parts > 1 and not demands):
        raise ValueError(
            "--method cheapest and --parts go with --at-least 0.9, and no other method does"
        )
    if demands and "mean" in (setting.cases.failures, setting.cases.levels_by):
        raise ValueError(
            "--at-least asks for the worst case: leave --failures mean and --levels-by mean out"
        )
    if verifies and method == "portfolio":
        raise ValueError(
            "--verify is for one method: portfolio is judged by --judge on fresh traffic anyway"
        )
    portfolio_options = (
        ("--judge", query.judge),
        ("--curve", query.curve or None),
        ("--contenders", query.contenders or None),
    )
    for option, value in portfolio_options:
        if value is not None and method != "portfolio":
            raise ValueError(f"{option} is for --method portfolio, got {method}: leave one out")
    is_judged = method == "portfolio" and query.judge in (None, "detector")
    detects = "detector" in (setting.fidelity, query.verify) or is_judged
    has_errors = setting.cases.errors != USUAL_CASES.errors
    has_detector = setting.detector is not None
    for option, is_given in (("--errors", has_errors), ("--detector", has_detector)):
        if is_given and not detects:
            raise ValueError(
                f"{option} is for --fidelity, --verify or --judge detector: pass one of these"
            )
    return method
