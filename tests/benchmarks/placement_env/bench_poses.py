"""CMA-ES from greedy's set, or a policy that learns, in equal time, beside searches of the pool.

python tests/benchmarks/placement_env/bench_poses.py tjunction --frames 12 --seconds 25 --budget 3 --iou 0.9
python tests/benchmarks/placement_env/bench_poses.py tjunction --learner ppo --frames 25 --seconds 1800
python tests/benchmarks/placement_env/bench_poses.py tjunction --learner none --frames 25 --seconds 1800  # beside it

Without `--learner` CMA-ES scores in panoramas and by rays. PPO and SAC learn on
`coview/SensorPose-v0`, and `--learner none` is the searches that they are set beside: each episode starts from
sensors drawn at random, and they see rewards alone, while the others may score whatever they like; all score in
panoramas of the same traffic, and every answer is scored again by rays, there and on traffic that nobody saw. "seen"
is the best set that came by while the policy learnt, "moved" the best of EPISODES episodes of the policy afterwards,
in its likeliest actions.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from placement_env.cases import Cases
from placement_env.setting import Setting
from toolkit.runtime.run import Run

sys.path.insert(0, str(Path(__file__).parents[3]))

from placement_env.envs.registration import register
from placement_env.objective import Objective
from placement_env.search import cmaes, greedy
from placement_env.search.exact import cpsat
from placement_env.search.result import Result
from toolkit.sensors.sensor import Sensor

EPISODES = 32
FRESH = 1  # added to the seed of the traffic

Answer = tuple[Sensor, ...]


class Best(gym.Wrapper):
    """Keeps the best set that came by, and how many came."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.reward, self.sensors, self.steps = -np.inf, (), 0

    def _look(self) -> None:
        objective, members = self.env.unwrapped.placement()  # type: ignore[attr-defined]
        reward = objective.score(members).reward
        if reward > self.reward:
            self.reward, self.sensors = reward, objective.candidates.sensors

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        found = self.env.reset(**settings)
        self._look()
        return found

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        found = self.env.step(action)
        self.steps += 1
        self._look()
        return found


def learnt(kind: str, env: Best, seconds: float, seed: int) -> Any:
    """A policy that learnt for so long."""
    import torch
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback

    class Until(BaseCallback):
        def __init__(self, end: float) -> None:
            super().__init__()
            self.end = end

        def _on_step(self) -> bool:
            return time.monotonic() < self.end

    torch.set_num_threads(1)
    common: dict[str, Any] = {"gamma": 0.9, "seed": seed, "device": "cpu"}  # a move pays at once, or hardly ever
    made = SAC("MlpPolicy", env, learning_starts=500, **common) if kind == "sac" else PPO(
        "MlpPolicy", env, n_steps=1024, batch_size=256, gae_lambda=0.9, learning_rate=5e-4,
        policy_kwargs={"log_std_init": -0.7}, **common,
    )  # fmt: skip
    return made.learn(10**9, callback=Until(time.monotonic() + seconds))


def played(policy: Any, env: Best) -> np.ndarray:
    """The reward at the end of each of `EPISODES` episodes."""
    ends = []
    for episode in range(EPISODES):
        observation, over = env.reset(seed=10_000 + episode)[0], False
        while not over:
            observation, _, terminated, truncated, _ = env.step(policy.predict(observation, deterministic=True)[0])
            over = terminated or truncated
        objective, members = env.unwrapped.placement()  # type: ignore[attr-defined]
        ends.append(objective.score(members).reward)
    return np.array(ends)


def answered(name: str, objective: Objective, sensors: Sequence[Sensor], said: str) -> None:
    """A line: the answer by rays in the traffic that was searched and in traffic that nobody saw."""
    made = objective.preparation
    assert made is not None
    scores = []
    for part in (made, replace(made, run=replace(made.run, seed=made.run.seed + FRESH))):
        (score,) = cmaes.build_pose_scorer(part, objective.weights)([tuple(sensors)])
        scores.append("may not be built" if score is None else f"{score.reward:.4f}")
    print(f"{name:<22} searched {scores[0]}, fresh {scores[1]}; {said}", flush=True)


def show(name: str, result: Result) -> None:
    """One line of figures."""
    print(
        f"{name:<24} reward {result.best.reward:.4f}, start {result.history.reward[0]:.4f}, "
        f"{result.evaluations} evaluations, {result.seconds:.1f} s",
        flush=True,
    )


def beside_learning(asked: argparse.Namespace, objective: Objective) -> None:
    """The searches that a policy which learns is set beside."""
    first = greedy.search(objective, asked.budget)
    answered("greedy", objective, objective.candidates.select(first.best.subset).sensors, "of the pool")
    found = cmaes.search(objective, asked.budget, seed=asked.seed, seconds=asked.seconds)
    answered("CMA-ES", objective, found.sensors or (), f"{found.evaluations} evaluations in {found.seconds:.0f} s")


def by_learning(asked: argparse.Namespace, objective: Objective) -> None:
    """A policy that learns."""
    register()
    settings: dict[str, Any] = {"frames": asked.frames, "candidates": "pool", "iou": asked.iou}
    env = Best(
        gym.make(
            "coview/SensorPose-v0", site=asked.site, budget=asked.budget, rendering="panorama",
            disable_env_checker=True, **settings,
        )
    )  # fmt: skip
    policy = learnt(asked.learner, env, asked.seconds, asked.seed)
    steps = env.steps
    answered(f"{asked.learner}, seen", objective, env.sensors, f"{steps} steps in {asked.seconds:.0f} s")
    env.reward, env.sensors = -np.inf, ()
    ends = played(policy, env)
    said = f"{EPISODES} episodes end at {ends.mean():.4f} ± {ends.std():.4f}, best {ends.max():.4f}"
    answered(f"{asked.learner}, moved", objective, env.sensors, said)


def by_search(asked: argparse.Namespace, objective: Objective) -> None:
    """Searches that move sensors, in panoramas and by rays."""
    made = objective.preparation
    assert made is not None
    show("greedy", greedy.search(objective, asked.budget))
    show("CP-SAT", cpsat.search(objective, asked.budget, seconds=asked.seconds))
    for way in ("panoramas", "rays"):
        if way == "rays":
            vars(made)["live"] = None
        for seed in (0, 1):
            show(f"CMA-ES, {way}", cmaes.search(objective, asked.budget, seed=seed, seconds=asked.seconds))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site")
    parser.add_argument("--learner", choices=("ppo", "sac", "none"))
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--budget", type=int, default=3)
    parser.add_argument("--iou", type=float, default=0.9)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    objective = Objective(Setting(asked.site, candidates="pool", cases=Cases(iou=asked.iou)), Run(frames=asked.frames))
    {None: by_search, "none": beside_learning}.get(asked.learner, by_learning)(asked, objective)


if __name__ == "__main__":
    main()
