"""Steps per second of the environments, by the processor's time of one process: the best and the median of 20 rounds.

python tests/benchmarks/bench_env.py [FRAMES]
"""

from __future__ import annotations

import sys
import time

import gymnasium as gym
import numpy as np

from placement_env.envs.registration import register
from placement_env.objective import FidelityName, Objective

register()
ROUNDS = 20


def pace(env: gym.vector.VectorEnv, steps: int) -> np.ndarray:
    """Environment steps per second of each of `ROUNDS` rounds, playing legal actions at random."""
    rng, paces = np.random.default_rng(0), []
    for _ in range(ROUNDS):
        _, info = env.reset(seed=0)
        start = time.process_time()
        for _ in range(steps):
            mask = info["action_mask"]
            actions = (rng.random(mask.shape) * mask).argmax(axis=1)
            _, _, _, _, info = env.step(actions)
        paces.append(steps * env.num_envs / (time.process_time() - start))
    return np.array(paces)


def main(frames: int) -> None:
    """Print a line for each fidelity and number of episodes side by side."""
    fidelities: list[FidelityName] = ["surrogate", "coverage"]
    for name in fidelities:
        objective = Objective("tjunction", frames, fidelity=name)
        for count in (1, 16, 64):
            objective.forget()
            env = gym.make_vec("coview/SensorSelect-v0", num_envs=count, objective=objective)
            paces = pace(env, 800 // count + 20)
            print(
                f"{name:10} {frames} frames, {count:3} at once: "
                f"{paces.max():8.0f} steps/s at best, median {np.median(paces):8.0f}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
