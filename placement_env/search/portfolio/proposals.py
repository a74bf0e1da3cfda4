"""Proposals: sets that somebody proposes before any search, such as a policy that knows the map alone.

A portfolio's local searches start from them too, and they race with the answers of the searches. Who has none to make
says why, once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

from placement_env.objective import Objective


class Proposal(NamedTuple):
    """members: candidates of a set, by index, none where there is none to propose; note: why not, "" where nothing is
    to be said."""

    members: tuple[int, ...]
    note: str = ""


@runtime_checkable
class Proposer(Protocol):
    """Who proposes. The same objective and budget have the same proposal."""

    @property
    def name(self) -> str:
        """In results, beside those of searches."""
        ...

    def __call__(self, objective: Objective, budget: int) -> Proposal:
        """A set of at most `budget` candidates that may be built."""
        ...


@dataclass(frozen=True)
class Proposals:
    """What one proposes for several budgets. name: whose; sets: members by budget; notes: why there is none, each
    once."""

    name: str = ""
    sets: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @staticmethod
    def of(proposer: Proposer | None, objective: Objective, budgets: Sequence[int]) -> Proposals:
        """All of them; none where there is nobody to ask."""
        if proposer is None:
            return Proposals()
        made = {budget: proposer(objective, budget) for budget in budgets}
        notes = dict.fromkeys(each.note for each in made.values() if each.note)
        return Proposals(proposer.name, {budget: each.members for budget, each in made.items()}, tuple(notes))

    @property
    def origin(self) -> dict[str, Any]:
        """For keys of what depends on them, as values of JSON."""
        sets = sorted((int(budget), [int(member) for member in members]) for budget, members in self.sets.items())
        return {"name": self.name, "sets": sets, "notes": list(self.notes)}

    def starts(self, budget: int) -> tuple[tuple[int, ...], ...]:
        """For a local search: the set that is proposed for a budget, if there is one."""
        members = self.sets.get(budget, ())
        return (members,) if members else ()
