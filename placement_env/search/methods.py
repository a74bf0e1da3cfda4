"""Searches by name, with checks of their abilities that run before anything is rendered."""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec

from placement_env.candidates.candidates import Candidates
from placement_env.cases import Cases
from placement_env.checks import check_choice
from placement_env.search.exact.exhaustive import MAX_CANDIDATES
from placement_env.search.method_entry import Method
from placement_env.search.result import Result

NEEDS_VISIBILITY = ("cpsat", "cmaes", "portfolio", "hits", "cheapest")  # which a table lacks
PLAIN_CASES_ONLY = ("cmaes", "hits", "cheapest")  # one IoU threshold, no cases of failure
_SEARCH = "placement_env.search"
METHODS: dict[str, Method] = {
    "portfolio": Method(f"{_SEARCH}.portfolio.portfolio", resumes=True),
    "exhaustive": Method(f"{_SEARCH}.exact.exhaustive"),
    "greedy": Method(f"{_SEARCH}.greedy"),
    "raced": Method(f"{_SEARCH}.greedy", "search_by_races"),
    "swap": Method(f"{_SEARCH}.swap", resumes=True),
    "cpsat": Method(f"{_SEARCH}.exact.cpsat", needs="ortools"),
    "hits": Method(f"{_SEARCH}.exact.hits", needs="ortools"),
    "cheapest": Method(f"{_SEARCH}.exact.cheapest", needs="ortools"),
    "cmaes": Method(f"{_SEARCH}.cmaes", needs="cma", resumes=True),
    "ppo": Method("placement_env.rl.training", needs="sb3_contrib", extra="rl", resumes=True),
}


def load_search(method: str) -> Callable[..., Result]:
    """Function of a search, called with an objective and a budget. method: key of `METHODS`."""
    entry = METHODS[method]
    return getattr(import_module(entry.module), entry.function)


def usual_method(fidelity: str, *, verify: bool = False, at_least: bool = False) -> str:
    """Name of the default search method for a fidelity.

    Greedy is used if an answer is verified, or if scoring a set takes a detector.

    fidelity: name of the searched fidelity; verify: True if another fidelity scores the answer;
    at_least: True if the cheapest set with some AP is sought."""
    if at_least:
        return "cheapest"
    if fidelity == "table":
        return "exhaustive"
    if verify or fidelity == "detector":
        return "greedy"
    return "portfolio"


def check_search(
    method: str, fidelity: str, candidates: Candidates, cases: Cases | None = None
) -> None:
    """Raise ValueError if a method cannot search these candidates, ImportError without its package.

    fidelity: name of the scorer; cases: thresholds, failures and levels that a set is scored at,
    None not to check them."""
    check_choice("method", method, METHODS)
    entry = METHODS[method]
    if entry.needs and not find_spec(entry.needs):
        raise ImportError(f"method {method} needs {entry.needs}: pip install coview[{entry.extra}]")
    if method == "exhaustive" and len(candidates) > MAX_CANDIDATES:
        rule = f"method exhaustive takes at most {MAX_CANDIDATES} candidates, got {len(candidates)}"
        raise ValueError(f"{rule}: say --method greedy or swap")
    if method == "raced" and fidelity != "detector":
        raise ValueError(
            f"method raced needs fidelity detector, got {fidelity}, which is quick: pass --method "
            "greedy"
        )
    if method in PLAIN_CASES_ONLY and cases is not None and not cases.is_one_case:
        raise ValueError(
            f"method {method} knows one IoU threshold and no failures: pass --method portfolio or "
            "swap"
        )
    if method in NEEDS_VISIBILITY and fidelity == "table":
        rule = f"method {method} asks what candidates see, which a table does not know"
        raise ValueError(f"{rule}: say --fidelity coverage")
