"""The searches by name, with checks of their abilities that run before anything is rendered."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

from placement_env.candidates.candidates import Candidates
from placement_env.cases import Cases
from placement_env.checks import check_choice
from placement_env.search.exact.exhaustive import LARGEST
from placement_env.search.result import Result


@dataclass(frozen=True)
class Method:
    """Place of a search. needs: package; extra: that installs it; resumes: whether it takes a
    checkpoint."""

    module: str
    function: str = "search"
    needs: str = ""
    extra: str = "search"
    resumes: bool = False


_SEARCH = "placement_env.search"
METHODS: dict[str, Method] = {
    "portfolio": Method(f"{_SEARCH}.portfolio.portfolio", resumes=True),
    "exhaustive": Method(f"{_SEARCH}.exact.exhaustive"),
    "greedy": Method(f"{_SEARCH}.greedy"),
    "raced": Method(f"{_SEARCH}.greedy", "raced"),
    "swap": Method(f"{_SEARCH}.swap", resumes=True),
    "cpsat": Method(f"{_SEARCH}.exact.cpsat", needs="ortools"),
    "hits": Method(f"{_SEARCH}.exact.hits", needs="ortools"),
    "cheapest": Method(f"{_SEARCH}.exact.cheapest", needs="ortools"),
    "cmaes": Method(f"{_SEARCH}.cmaes", needs="cma", resumes=True),
    "ppo": Method("placement_env.rl.training", needs="sb3_contrib", extra="rl", resumes=True),
}
# they need visibility, which a table lacks
RENDERED = ("cpsat", "cmaes", "portfolio", "hits", "cheapest")
# they handle one IoU threshold, and failures by themselves
ONE_COUNTED = ("cmaes", "hits", "cheapest")


def load_search(method: str) -> Callable[..., Result]:
    """Search of that name. Call it with an objective and a budget; it returns a result."""
    found = METHODS[method]
    return getattr(import_module(found.module), found.function)


def usual_method(fidelity: str, *, verify: bool = False, at_least: bool = False) -> str:
    """Default search method. Greedy is used where an answer is verified, or scoring a set takes a
    detector."""
    if at_least:
        return "cheapest"
    return (
        "exhaustive"
        if fidelity == "table"
        else "greedy"
        if verify or fidelity == "detector"
        else "portfolio"
    )


def check_search(
    method: str, fidelity: str, candidates: Candidates, cases: Cases | None = None
) -> None:
    """Raise ValueError where a method cannot search these candidates, ImportError where its package
    is missing."""
    check_choice("method", method, METHODS)
    needs = METHODS[method]
    if needs.needs and not find_spec(needs.needs):
        raise ImportError(f"method {method} needs {needs.needs}: pip install coview[{needs.extra}]")
    if method == "exhaustive" and len(candidates) > LARGEST:
        said = f"method exhaustive takes at most {LARGEST} candidates, got {len(candidates)}"
        raise ValueError(f"{said}: say --method greedy or swap")
    if method == "raced" and fidelity != "detector":
        raise ValueError(
            f"method raced needs fidelity detector, got {fidelity}, which is quick: say --method "
            "greedy"
        )
    if method in ONE_COUNTED and cases is not None and not cases.plain:
        raise ValueError(
            f"method {method} knows one IoU threshold and no failures: say --method portfolio or "
            "swap"
        )
    if method in RENDERED and fidelity == "table":
        said = f"method {method} asks what candidates see, which a table does not know"
        raise ValueError(f"{said}: say --fidelity coverage")
