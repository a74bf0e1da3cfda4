"""`MapStarts`: where local searches may start: what the map policy answers, before any set is scored.

A search has looked already, so what every candidate sends is known, and the proposal needs no look of its own. It costs
what the map and one answer cost (`docs/figures.md`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.outlook.ground_plan import ground_plan
from placement_env.candidates.outlook.outlook import outlook
from placement_env.envs.maps.terms import Terms
from placement_env.objective import Objective
from placement_env.rl.maps.map_policy import SHIPPED_POLICY, MapPolicy, Predicted
from placement_env.search.portfolio.proposals import Proposal
from toolkit.sites.site import Site

NO_START = "no start from the map"


class MapStarts:
    """Proposes what a policy answers; policy: None where there is none, and why then. It satisfies
    `placement_env.search.portfolio.proposals.Proposer`."""

    name = "map policy"

    def __init__(self, policy: MapPolicy | None, why: str = "") -> None:
        self._policy, self._why = policy, why
        self._last: tuple[Site, Candidates, Predicted | None] | None = None

    @staticmethod
    def shipped(path: Path = SHIPPED_POLICY) -> MapStarts:
        """By the shipped policy. Where its file is missing or damaged, every search goes on without a proposal."""
        try:
            return MapStarts(MapPolicy.load(path))
        except (OSError, ValueError) as error:
            return MapStarts(None, f"{NO_START}: {error}")

    def __call__(self, objective: Objective, budget: int) -> Proposal:
        """A set that the links carry and the money pays, or why there is none."""
        if self._policy is None:
            return Proposal((), self._why)
        if objective.site is None:
            return Proposal((), f"{NO_START}: it is not known of which site the candidates are")
        predicted = self._predicted(self._policy, objective.site, objective.candidates)
        if predicted is None:
            return Proposal((), f"{NO_START}: that of {objective.site.name} has no lane and no bay in its area")
        boxes = not objective.scheme.sends_points
        sent = np.zeros(len(objective.candidates)) if boxes else objective.sent
        terms = Terms.plain(objective.candidates, budget, weights=objective.weights, most_price=objective.most_price)
        return Proposal(replace(predicted, sent=sent).answer(terms).members)

    def _predicted(self, policy: MapPolicy, site: Site, candidates: Candidates) -> Predicted | None:
        """What the policy makes of candidates, the same as last time for the same ones; None without traffic."""
        if self._last is None or self._last[0] is not site or self._last[1] is not candidates:
            traffic = len(ground_plan(site).used) > 0
            self._last = site, candidates, policy.predicted(outlook(site, candidates)) if traffic else None
        return self._last[2]
