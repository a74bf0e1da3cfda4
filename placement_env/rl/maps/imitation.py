"""A map network trained on lessons: to predict what sets are worth, and above all which candidate adds most.

Four losses are added up for each junction: how likely each candidate alone hits each vehicle (cross-entropy), where
vehicles are (negative log likelihood of their cells), what each candidate sends (that of a normal distribution of log
kbit), and of each set with one candidate more, the squared error of AP and the regret

    Σ_c softmax_c(AP_c / TEMPERATURE) · (max AP* - AP*_c)          AP predicted, AP* by the surrogate

which is what a policy loses that draws its next sensor so. Every pass goes through all lessons once, in an order drawn
from the run's seed and the number of the pass, so weights, optimiser and the count of steps are the whole state: a
training that was killed and called again ends with the weights of one that was not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from placement_env.checks import check_whole
from placement_env.rl.maps.lessons import Lesson
from placement_env.rl.maps.map_network import LEAST_EVIDENCE, MapNetwork
from placement_env.rl.maps.training_state import CHECKPOINT_S, TrainingState, cosine

IMITATION = "imitation.pt"
TEMPERATURE = 0.02  # of AP


@dataclass(frozen=True)
class Teaching:
    """How a network is taught. passes: over all lessons; learning_rate: at first, falling to nothing as a cosine does;
    of_ap, of_regret: what these losses count, beside 1 of each other; width: of the network's layers."""

    passes: int = 30
    learning_rate: float = 4e-3
    of_ap: float = 20.0
    of_regret: float = 20.0
    width: int = 24


@dataclass(frozen=True, eq=False)
class _Tensors:
    """A lesson as tensors."""

    channels: Tensor
    view: Tensor
    features: Tensor
    log_kbit: Tensor
    cell: Tensor
    alone: Tensor
    sets: Tensor
    ap: Tensor

    @staticmethod
    def of(lesson: Lesson) -> _Tensors:
        return _Tensors(
            torch.from_numpy(lesson.channels), torch.from_numpy(lesson.view.astype(np.float32)),
            torch.from_numpy(lesson.features), torch.from_numpy(np.log(lesson.kbit + 1).astype(np.float32)),
            torch.from_numpy(lesson.cell), torch.from_numpy(lesson.alone.astype(np.float32)),
            torch.from_numpy(lesson.sets.astype(np.float32)), torch.from_numpy(lesson.ap),
        )  # fmt: skip


def imitate(
    lessons: Sequence[Lesson],
    out: Path,
    *,
    teaching: Teaching | None = None,
    seed: int = 0,
    every_s: float = CHECKPOINT_S,
    progress: Callable[[int, dict[str, float]], None] | None = None,
) -> MapNetwork:
    """A network taught by lessons; `out` keeps its checkpoint, with which it goes on where it was stopped.

    every_s: between two checkpoints within a pass; there is one after each. progress: called after each pass with how
    many are done and the mean of each loss. Raises ValueError without lessons and where `out` holds a training of other
    settings.
    """
    teaching = teaching or Teaching()
    check_whole("passes", teaching.passes, least=1)
    if not lessons:
        raise ValueError("a network is taught by lessons, got none: prepare some junctions")
    torch.manual_seed(seed)
    network = MapNetwork(teaching.width)
    optimiser = torch.optim.Adam(network.parameters(), lr=teaching.learning_rate)
    identity = {"teaching": str(teaching), "seed": seed, "lessons": digest_of_lessons(lessons)}
    state = TrainingState(out / IMITATION, identity, {"network": network, "optimiser": optimiser}, every_s=every_s)
    losses: dict[str, float] = state.counts.get("losses", {})
    for step in range(state.counts.get("steps", 0), teaching.passes * len(lessons)):
        done, place = divmod(step, len(lessons))
        k = int(np.random.default_rng([seed, done]).permutation(len(lessons))[place])
        optimiser.param_groups[0]["lr"] = teaching.learning_rate * cosine(step / (teaching.passes * len(lessons)))
        each = losses_of(network, lessons[k])
        optimiser.zero_grad()
        total_loss(each, teaching).backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        losses = {name: losses.get(name, 0.0) + loss.item() / len(lessons) for name, loss in each.items()}
        last = place + 1 == len(lessons)
        if last or state.due:
            state.save(steps=step + 1, losses={} if last else losses)
        if last:
            if progress:
                progress(done + 1, losses)
            losses = {}
    return network


def losses_of(network: MapNetwork, lesson: Lesson) -> dict[str, Tensor]:
    """The losses of one lesson by name."""
    known = _Tensors.of(lesson)
    seen = network.prospects(known.channels, known.view, known.features)
    hit = network.hit(seen.evidence[:, known.cell]).clamp(LEAST_EVIDENCE, 1 - LEAST_EVIDENCE)
    surprise = (known.log_kbit - seen.log_kbit) / torch.exp(seen.log_spread)
    predicted = network.next_ap(seen, known.sets)
    free = torch.isfinite(known.ap)
    if not free.any(dim=1).all():
        raise ValueError("every set of a lesson needs a candidate that may join it: leave out those that have none")
    ap = torch.where(free, known.ap, 0)
    chance = torch.softmax(torch.where(free, predicted / TEMPERATURE, -torch.inf), 1)
    best = torch.where(free, known.ap, -1).max(1, keepdim=True).values
    return {
        "hit": functional.binary_cross_entropy(hit, known.alone),
        "crowd": -0.1 * torch.log(seen.weight[known.cell] + LEAST_EVIDENCE).mean(),
        "kbit": 0.1 * (surprise.square() / 2 + seen.log_spread).mean(),
        "ap": (predicted - ap).square()[free].mean(),
        "regret": (chance * torch.where(free, best - ap, 0)).sum(1).mean(),
    }


def total_loss(losses: dict[str, Tensor], teaching: Teaching) -> Tensor:
    """The losses of a lesson added up, as far as each counts."""
    alone = losses["hit"] + losses["crowd"] + losses["kbit"]
    return alone + teaching.of_ap * losses["ap"] + teaching.of_regret * losses["regret"]


def digest_of_lessons(lessons: Sequence[Lesson]) -> str:
    """Of what they say, and of their order."""
    digest = hashlib.sha256()
    for lesson in lessons:
        for field in fields(Lesson):
            digest.update(np.ascontiguousarray(getattr(lesson, field.name)).tobytes())
    return digest.hexdigest()
