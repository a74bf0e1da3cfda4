"""`Practice`: a junction at which a policy draws sets of sensors and learns what each would have been worth.

A set is drawn as the policy answers, one sensor after another, but by chance: with g_c what candidate c is predicted to
add to the reward, as far as its link is likely to carry it,

    π(c | set) = exp(g_c / T) / (1 + Σ_k exp(g_k / T))          1 stands for building no more, which adds nothing

over the candidates that the terms allow. A sensor whose link does not carry what it sends is refused when it is built:
the policy does not know, and the set is worth what is left of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from placement_env.candidates.places import ROUNDED, added_prices
from placement_env.envs.maps.junctions import Junction
from placement_env.envs.maps.terms import Terms, drawn_terms
from placement_env.fidelity.surrogate import Surrogate
from placement_env.objective import Objective
from placement_env.rl.maps.lessons import LARGEST_SET, Lesson
from placement_env.rl.maps.map_network import MapNetwork, Prospects
from placement_env.rl.maps.map_policy import NO_ROOM
from toolkit.arrays import Float32, Float64, Int64

MOST_FAILED = 8  # candidates


class Draws(NamedTuple):
    """Sets that were drawn. logits (s, C + 1): of the candidates and of stopping, one row for each of s choices; taken
    (s): which was chosen; before (s, C): the set that it joins; episode (s): number of the set; rewards (n): of each of
    n sets, of what is built of it."""

    logits: Tensor
    taken: Tensor
    before: Tensor
    episode: Tensor
    rewards: Float64[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Practice:
    """What the map of a junction says, as tensors, and what its candidates see. sent: kbit of a frame by each."""

    channels: Tensor
    view: Tensor
    features: Tensor
    sent: Float64[np.ndarray, " C"]
    junction: Junction
    scored_by: Surrogate

    @staticmethod
    def of(junction: Junction, lesson: Lesson) -> Practice:
        """That of a junction and the lesson which was made of it. Raises ValueError where they do not belong
        together."""
        if len(junction.candidates) != len(lesson.kbit):
            raise ValueError(
                f"a lesson of {len(lesson.kbit)} candidates is none of a junction with {len(junction.candidates)}"
            )
        view = torch.from_numpy(lesson.view.astype(np.float32))
        tensors = torch.from_numpy(lesson.channels), view, torch.from_numpy(lesson.features)
        scored_by = Surrogate(junction.visibility, "early", radius=junction.site.hybrid_radius)
        return Practice(*tensors, lesson.kbit, junction, scored_by)

    def task(self, rng: np.random.Generator) -> PracticeTask:
        """What is asked for: in half of the tasks AP alone on the candidates' own terms, in the others drawn ones; and
        in half of them it is known what every sensor sends."""
        if rng.random() < 0.5:
            terms = Terms.plain(self.junction.candidates, int(rng.integers(1, LARGEST_SET + 1)))
        else:
            budget, failures = (1, LARGEST_SET), (0, min(MOST_FAILED, len(self.sent) - 1))
            terms = drawn_terms(self.junction.candidates, rng, budget=budget, failures=failures)
        return PracticeTask(self, terms, known=bool(rng.random() < 0.5))

    def prospects(self, network: MapNetwork) -> Prospects:
        """What a network makes of the map."""
        return network.prospects(self.channels, self.view, self.features)


class PracticeTask:
    """A practice on terms. known: whether it is known what every candidate sends, as to a search that has looked."""

    def __init__(self, practice: Practice, terms: Terms, *, known: bool) -> None:
        self.practice, self.terms, self.known = practice, terms, known
        self.objective = Objective.of(
            terms.candidates, practice.scored_by, "early", terms.weights, site=practice.junction.site,
            visibility=practice.junction.visibility, most_price=terms.most_price,
        )  # fmt: skip

    def logits(self, network: MapNetwork, seen: Prospects, chosen: Tensor, temperature: float) -> Tensor:
        """Of every candidate beside sets (n, C) of 0 and 1, and of stopping (n, C + 1); -inf where it may not join."""
        rows = chosen.numpy() > 0
        allowed = torch.from_numpy(np.stack([self.terms.allowed(np.flatnonzero(row).tolist()) for row in rows]))
        gains, carried = self.gains(network, seen, chosen)
        logits = torch.where(allowed & (carried > 0), gains / temperature, -torch.inf)
        return torch.cat([logits, torch.zeros(len(rows), 1)], 1)

    def gains(self, network: MapNetwork, seen: Prospects, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """What each candidate is predicted to add to the reward of sets (n, C), as far as its link is likely to carry
        it, and how likely that is: `placement_env.rl.maps.map_policy.Predicted.gains`, to be differentiated."""
        candidates, weights = self.terms.candidates, self.terms.weights
        count = chosen.sum(1)
        kbit = torch.from_numpy(self.practice.sent).float()
        if not self.known:
            kbit = torch.exp(seen.log_kbit + torch.exp(2 * seen.log_spread) / 2)
        before = torch.where(count > 0, network.ap(chosen @ seen.evidence, seen.weight), 0)
        load = chosen @ kbit
        more = (load[:, None] + kbit) / (count[:, None] + 1) - (load / count.clamp(min=1))[:, None]
        prices = np.stack([added_prices(candidates, row) for row in chosen.numpy() > 0])
        costs = weights.comm * more + weights.price * torch.from_numpy(prices).float()
        carried = self._carried(seen, chosen, kbit)
        return carried * (network.next_ap(seen, chosen) - before[:, None] - costs), carried

    def _carried(self, seen: Prospects, chosen: Tensor, kbit: Tensor) -> Tensor:
        """How likely the link of each candidate carries what it sends beside what a set sends over it."""
        candidates = self.terms.candidates
        mount, capacity = torch.from_numpy(candidates.mount), torch.from_numpy(candidates.capacity)
        sent = torch.from_numpy(self.practice.sent) if self.known else kbit.double()
        on_mount = torch.zeros(len(chosen), len(candidates.mounts), dtype=torch.float64)
        load = on_mount.index_add(1, mount, chosen * sent)[:, mount]
        if self.known:
            return (load + sent <= capacity * (1 + torch.where(load > 0, ROUNDED, 0.0))).float()
        room = (capacity - load).clamp(min=NO_ROOM).float()
        return torch.special.ndtr((torch.log(room) - seen.log_kbit) / torch.exp(seen.log_spread))

    def draw(self, network: MapNetwork, count: int, rng: np.random.Generator, *, temperature: float) -> Draws:
        """`count` sets, each drawn until the budget is used up, nothing may join, or it was chosen to stop."""
        seen, candidates = self.practice.prospects(network), len(self.practice.sent)
        chosen, built = torch.zeros(count, candidates), np.zeros((count, candidates), np.bool_)
        going, steps = np.arange(count), []
        for _ in range(self.terms.budget):
            before = chosen[going]
            logits = self.logits(network, seen, before, temperature)
            picked = _drawn(torch.softmax(logits.detach(), 1).numpy(), rng)
            steps.append((logits, torch.from_numpy(picked), before, torch.from_numpy(going)))
            on = picked < candidates
            going, joined = going[on], picked[on]
            if not len(going):
                break
            chosen = chosen.clone()
            chosen[going, joined] = 1
            for row, candidate in zip(going.tolist(), joined.tolist(), strict=True):
                built[row, candidate] = self.objective.allowed(built[row])[candidate]
        logits, taken, before, episode = (torch.cat(part) for part in zip(*steps, strict=True))
        return Draws(logits, taken, before, episode, self.objective.scores(built).reward)


def _drawn(chances: Float32[np.ndarray, "n k"], rng: np.random.Generator) -> Int64[np.ndarray, " n"]:
    """A column of each row, as likely as it says."""
    reached = chances.cumsum(axis=1, dtype=np.float64)
    return (reached > rng.random((len(chances), 1)) * reached[:, -1:]).argmax(axis=1)
