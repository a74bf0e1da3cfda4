"""A map network that was taught by imitation, trained further by what its own answers are worth (REINFORCE).

In each step a policy π draws n sets at one junction on terms of its own (`Practice`). With r_i the reward of set i, AP
by the surrogate less what communication and building cost, the step descends

    - 1/n Σ_i (r_i - b_i) Σ_t log π(c_it)  +  β · KL(π_0 | π)  -  ε · H(π)  +  λ · losses of the lesson

(Williams 1992) where b_i is the mean reward of the other sets, so that a set counts as far as it is better than what
the policy would have drawn instead; π_0 is the imitated policy, KL and entropy H are means over the choices that were
met, and the losses are those of `placement_env.rl.maps.imitation`, so that the network goes on predicting AP, which its
swaps rest on. The weights that are given back are a running mean of those of the steps.

Junction, terms and sets of a step are drawn from the run's seed and the number of the step, so weights, optimiser and
the count of steps are the whole state: a training that was killed and called again ends with the weights of one that
was not.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from models.weight_files import digest_of
from placement_env.checks import check_whole
from placement_env.rl.maps.imitation import TEMPERATURE, Teaching, losses_of, total_loss
from placement_env.rl.maps.lessons import Lesson
from placement_env.rl.maps.map_network import MapNetwork
from placement_env.rl.maps.practice import Practice
from placement_env.rl.maps.training_state import CHECKPOINT_S, Stateful, TrainingState, cosine
from toolkit.arrays import Float64

REINFORCEMENT = "reinforcement.pt"
NO_CHANCE = -100.0  # logarithm of what may not be chosen


@dataclass(frozen=True)
class Reinforcement:
    """How a network is trained by rewards. steps: of gradient, one junction each; sets: drawn in a step; learning_rate:
    at first, falling to a hundredth as a cosine does; divergence, entropy: AP that a nat of KL(π_0 | π), and of
    entropy, count; of_lesson: what the losses of imitation count; averaged: share that the running mean of the weights
    keeps in a step; temperature: T, of AP."""

    steps: int = 2000
    sets: int = 16
    learning_rate: float = 5e-4
    divergence: float = 1e-3
    entropy: float = 1e-4
    of_lesson: float = 0.1
    averaged: float = 0.99
    temperature: float = TEMPERATURE

    def __post_init__(self) -> None:
        check_whole("steps", self.steps, least=1)
        check_whole("sets", self.sets, least=2)


Course = Callable[[], tuple[Practice, Lesson]]  # a junction, read when it is its turn


def reinforce(
    imitated: MapNetwork,
    courses: Sequence[Course],
    out: Path,
    *,
    settings: Reinforcement | None = None,
    teaching: Teaching | None = None,
    seed: int = 0,
    every_s: float = CHECKPOINT_S,
    progress: Callable[[int, dict[str, float]], None] | None = None,
) -> MapNetwork:
    """An imitated network, which stays as it is, trained further; `out` keeps the checkpoint, with which it goes on
    where it was stopped.

    courses: the junctions; teaching: how the losses of imitation count; every_s: between two checkpoints; progress:
    called after each step with how many are done and its mean reward, entropy and divergence. Raises ValueError without
    courses, for settings that do not fit, and where `out` holds a training of other settings.
    """
    settings, teaching = settings or Reinforcement(), teaching or Teaching()
    if not courses:
        raise ValueError("a policy learns by rewards at junctions, got none: prepare some")
    network, mean = copy.deepcopy(imitated), copy.deepcopy(imitated)
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    started = digest_of(dict(imitated.state_dict()))
    identity = {"settings": str(settings), "seed": seed, "junctions": len(courses), "imitated policy": started}
    parts: dict[str, Stateful] = {"network": network, "mean": mean, "optimiser": optimiser}
    state = TrainingState(out / REINFORCEMENT, identity, parts, every_s=every_s)
    for step in range(state.counts.get("steps", 0), settings.steps):
        epoch, place = divmod(step, len(courses))
        practice, lesson = courses[int(np.random.default_rng([seed, 1, epoch]).permutation(len(courses))[place])]()
        optimiser.param_groups[0]["lr"] = settings.learning_rate * cosine(step / settings.steps)
        losses, figures = reward_losses(network, imitated, practice, settings, np.random.default_rng([seed, 2, step]))
        taught = TEMPERATURE * total_loss(losses_of(network, lesson), teaching) if settings.of_lesson else 0.0
        optimiser.zero_grad()
        (losses + settings.of_lesson * taught).backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        with torch.no_grad():
            for kept, now in zip(mean.parameters(), network.parameters(), strict=True):
                kept.lerp_(now, 1 - settings.averaged)
        if state.due or step + 1 == settings.steps:
            state.save(steps=step + 1)
        if progress:
            progress(step + 1, figures)
    return mean


def reward_losses(
    network: MapNetwork, imitated: MapNetwork, practice: Practice, settings: Reinforcement, rng: np.random.Generator
) -> tuple[Tensor, dict[str, float]]:
    """The loss of one step without that of the lesson, and figures of it."""
    task = practice.task(rng)
    draws = task.draw(network, settings.sets, rng, temperature=settings.temperature)
    with torch.no_grad():
        before = task.logits(imitated, practice.prospects(imitated), draws.before, settings.temperature)
    now, then = (_log_chances(logits) for logits in (draws.logits, before))
    entropy = -(now.exp() * now).sum(1).mean()
    divergence = (then.exp() * (then - now)).sum(1).mean()
    taken = now.gather(1, draws.taken[:, None])[:, 0]
    reinforced = -(advantages(draws.rewards)[draws.episode] * taken).sum() / settings.sets
    loss = reinforced + settings.divergence * divergence - settings.entropy * entropy
    figures = {"reward": float(draws.rewards.mean()), "entropy": entropy.item(), "divergence": divergence.item()}
    return loss, figures


def advantages(rewards: Float64[np.ndarray, " n"]) -> Tensor:
    """By how much the reward of each set is above the mean of the others.

    >>> advantages(np.array([0.5, 0.8, 0.8])).tolist()
    [-0.30000001192092896, 0.15000000596046448, 0.15000000596046448]
    """
    n = len(rewards)
    return torch.from_numpy((rewards - rewards.mean()) * n / (n - 1)).float()


def _log_chances(logits: Tensor) -> Tensor:
    """Logarithms of the chances of choices, `NO_CHANCE` of one that there is not."""
    return torch.where(torch.isfinite(logits), torch.log_softmax(logits, 1), NO_CHANCE)
