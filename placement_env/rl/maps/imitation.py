"""A map network trained on lessons: to predict what sets are worth, and above all which candidate adds most.

Four losses are added up for each junction: how likely each candidate alone hits each vehicle (cross-entropy), where
vehicles are (negative log likelihood of their cells), what each candidate sends (that of a normal distribution of log
kbit), and of each set with one candidate more, the squared error of AP and the regret

    Σ_c softmax_c(AP_c / TEMPERATURE) · (max AP* - AP*_c)          AP predicted, AP* by the surrogate

which is what a policy loses that draws its next sensor so. Every pass goes through all lessons once, in an order drawn
from the run's seed and the number of the pass, so weights, optimiser and the count of passes are the whole state: a
training that was killed and called again ends with the weights of one that was not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from models.training.checkpoint import read_checkpoint, save_atomically
from placement_env.checks import check_whole
from placement_env.rl.maps.lessons import Lesson
from placement_env.rl.maps.map_network import LEAST_EVIDENCE, MapNetwork

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
    progress: Callable[[int, dict[str, float]], None] | None = None,
) -> MapNetwork:
    """A network taught by lessons; `out` keeps its checkpoint, with which it goes on where it was stopped.

    progress: called after each pass with how many are done and the mean of each loss. Raises ValueError without lessons
    and where `out` holds a training of other settings.
    """
    teaching = teaching or Teaching()
    check_whole("passes", teaching.passes, least=1)
    if not lessons:
        raise ValueError("a network is taught by lessons, got none: prepare some junctions")
    out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed)
    network = MapNetwork(teaching.width)
    optimiser = torch.optim.Adam(network.parameters(), lr=teaching.learning_rate)
    identity = {"teaching": str(teaching), "seed": seed, "lessons": len(lessons)}
    done = _restore(network, optimiser, out / IMITATION, identity)
    for number in range(done, teaching.passes):
        losses: dict[str, float] = {}
        order = np.random.default_rng([seed, number]).permutation(len(lessons))
        for step, k in enumerate(order.tolist()):
            share = (number + step / len(lessons)) / teaching.passes
            optimiser.param_groups[0]["lr"] = teaching.learning_rate * (
                0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2
            )
            each = losses_of(network, lessons[k])
            total = each["hit"] + each["crowd"] + each["kbit"]
            total = total + teaching.of_ap * each["ap"] + teaching.of_regret * each["regret"]
            optimiser.zero_grad()
            total.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            for name, loss in each.items():
                losses[name] = losses.get(name, 0.0) + loss.item() / len(lessons)
        state: dict[str, Any] = {"network": network.state_dict(), "optimiser": optimiser.state_dict()}
        save_atomically(out / IMITATION, {**identity, **state, "passes": number + 1})
        if progress:
            progress(number + 1, losses)
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


def _restore(network: MapNetwork, optimiser: torch.optim.Optimizer, path: Path, identity: dict[str, Any]) -> int:
    """Passes that are done, by a checkpoint where there is one."""
    if not path.exists():
        return 0
    state = read_checkpoint(path)
    different = [key for key, value in identity.items() if state.get(key) != value]
    if different:
        raise ValueError(f"{path} is of other {' and '.join(different)}: choose another folder or remove it")
    network.load_state_dict(state["network"])
    optimiser.load_state_dict(state["optimiser"])
    return int(state["passes"])
