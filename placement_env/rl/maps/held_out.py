"""How policies compare to greedy search at junctions that none of them was taught.

Greedy looks at traffic of its own first; every set is judged by the surrogate on the traffic of the junction's files,
which nobody saw. A sensor whose link does not carry what it sends in the traffic that was looked at is left out of a
set. A policy answers by the map
alone, and once more after looking at the empty site from the sensors of its answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from placement_env.candidates.outlook.outlook import outlook
from placement_env.checks import check_whole
from placement_env.envs.maps.junctions import Junction, JunctionSource, other_traffic
from placement_env.envs.maps.terms import Terms
from placement_env.objective import Objective
from placement_env.rl.maps.lessons import objective_of
from placement_env.rl.maps.link_check import sent_when_empty
from placement_env.rl.maps.map_policy import MapPolicy
from placement_env.rl.maps.schooling import JunctionFolder, SchoolProgress
from placement_env.search import greedy
from toolkit.arrays import Bool

HELD_OUT_BUDGETS = (2, 3, 4)
SEARCHED_FRAMES = 24  # of the traffic that greedy looks at
LINKS_LOOKED_AT = ", links looked at"


@dataclass(frozen=True)
class HeldOut:
    """AP of each answer, by the name of who gave it ("greedy" among them), at one junction for one budget."""

    junction: str
    budget: int
    ap: dict[str, float]


@dataclass(frozen=True)
class Comparison:
    """Of one answerer and budget: mean AP over junctions; what greedy has more in the mean, its standard error (NaN of
    one junction), and at worst."""

    name: str
    budget: int
    ap: float
    behind: float
    error: float
    worst: float


def tried(
    source: JunctionSource,
    junction: Junction,
    folder: str | Path,
    policies: Mapping[str, MapPolicy],
    *,
    budgets: Sequence[int] = HELD_OUT_BUDGETS,
    frames: int = SEARCHED_FRAMES,
) -> list[HeldOut]:
    """What greedy and the policies reach at a junction. folder: where what greedy looks at is kept; frames: of that."""
    looked_at = Junction(junction.site, junction.candidates, other_traffic(source, junction, folder, frames=frames))
    searched, judged = objective_of(looked_at), objective_of(junction)
    known, sends = outlook(junction.site, junction.candidates), sent_when_empty(junction.site, junction.candidates)
    rows = []
    for budget in budgets:
        terms = Terms.plain(junction.candidates, budget)
        answers = {"greedy": greedy.search(searched, budget).best.subset}
        for name, policy in policies.items():
            answers[name] = policy.answer_to(known, terms).members
            answers[name + LINKS_LOOKED_AT] = policy.answer_checked(known, terms, sends).members
        ap = {name: built_ap(judged, each, searched.linked) for name, each in answers.items()}
        rows.append(HeldOut(source.name, budget, ap))
    return rows


def tried_at(
    sources: Sequence[JunctionSource],
    junctions: JunctionFolder,
    policies: Mapping[str, MapPolicy],
    *,
    budgets: Sequence[int] = HELD_OUT_BUDGETS,
    progress: SchoolProgress | None = None,
) -> list[HeldOut]:
    """`tried` at several junctions, which are prepared where that is missing. Raises ValueError for budgets below 1."""
    for budget in budgets:
        check_whole("budget", budget, least=1)
    rows = []
    for number, source in enumerate(sources):
        rows += tried(source, junctions.junction(source), junctions.folder, policies, budgets=budgets)
        if progress:
            progress("held out", number + 1, len(sources), {})
    return rows


def built_ap(judged: Objective, members: Sequence[int], linked: Bool[np.ndarray, " C"]) -> float:
    """AP of a set without the sensors whose links do not carry what they send; linked: which links do."""
    return judged.score([member for member in members if linked[member]]).ap


def compared(rows: Sequence[HeldOut]) -> list[Comparison]:
    """The means, by budget and in the order of the answers."""
    found = []
    for budget in sorted({row.budget for row in rows}):
        of_budget = [row for row in rows if row.budget == budget]
        for name in of_budget[0].ap:
            ap, behind = np.array([(row.ap[name], row.ap["greedy"] - row.ap[name]) for row in of_budget]).T
            error = float(behind.std(ddof=1) / np.sqrt(len(behind))) if len(behind) > 1 else float("nan")
            found.append(Comparison(name, budget, float(ap.mean()), float(behind.mean()), error, float(behind.max())))
    return found


def tables(means: Sequence[Comparison]) -> list[str]:
    """As lines, those of a budget after the other."""
    width = max((len(each.name) for each in means), default=0)
    lines = []
    for budget in sorted({each.budget for each in means}):
        lines += ["", f"{budget} sensors, AP by the surrogate on traffic nobody saw, and what greedy has more"]
        lines += [
            f"{each.name:{width}}  {each.ap:.4f}  {each.behind:+.4f} ± {each.error:.4f}  at worst {each.worst:+.4f}"
            for each in means
            if each.budget == budget
        ]
    return lines
