"""Steps per second of the environments, by the processor's time of one process (wall time too).

python tests/benchmarks/bench_env.py [FRAMES]
"""

from __future__ import annotations

import sys
import time

import gymnasium as gym
import numpy as np

from placement_env.objective import FidelityName, Objective
from placement_env.registration import register

register()


def pace(env: gym.vector.VectorEnv, steps: int) -> tuple[float, float]:
    """Environment steps per second of processor and of wall time, playing legal actions at random."""
    rng = np.random.default_rng(0)
    _, info = env.reset(seed=0)
    start, wall = time.process_time(), time.perf_counter()
    for _ in range(steps):
        mask = info["action_mask"]
        actions = (rng.random(mask.shape) * mask).argmax(axis=1)
        _, _, _, _, info = env.step(actions)
    done = steps * env.num_envs
    return done / (time.process_time() - start), done / (time.perf_counter() - wall)


def main(frames: int) -> None:
    """Print a line for each fidelity and number of episodes side by side."""
    fidelities: list[FidelityName] = ["surrogate", "coverage"]
    for name in fidelities:
        objective = Objective("tjunction", frames, fidelity=name)
        for count in (1, 16, 64):
            objective.forget()
            env = gym.make_vec("coview/SensorSelect-v0", num_envs=count, objective=objective)
            by_processor, by_wall = pace(env, 4000 // count)
            print(f"{name:10} {frames} frames, {count:3} at once: {by_processor:8.0f} steps/s, {by_wall:8.0f} by wall")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
