"""Steps per second of the environments, by the processor's time of one process: the best and the
median of 20 rounds; and how many files one step crosses, with how many calls between them.

python tests/benchmarks/placement_env/bench_env.py [FRAMES]
    --table     on the shipped table alone
    --pose      of moving four sensors alone: on mounts of the site's own sensors in panoramas, and rendered in full
"""

import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

import gymnasium as gym
import numpy as np

from placement_env.envs.registration import register_environments
from placement_env.objective import Objective
from placement_env.protocol import FidelityName
from placement_env.setting import Rendering, Setting
from toolkit.runtime.run import Run

register_environments()
ROUNDS = 20
ROOT = Path(__file__).parents[3]
OURS = tuple(f"{ROOT / package}/" for package in ("toolkit", "models", "placement_env"))


def pace(env: gym.vector.VectorEnv, steps: int) -> np.ndarray:
    """Environment steps per second of each of `ROUNDS` rounds, playing legal actions at random."""
    rng, paces = np.random.default_rng(0), []
    for _ in range(ROUNDS):
        _, info = env.reset(seed=0)
        start = time.process_time()
        for _ in range(steps):
            mask = info["action_mask"]
            _, _, _, _, info = env.step((rng.random(mask.shape) * mask).argmax(axis=1))
        paces.append(steps * env.num_envs / (time.process_time() - start))
    return np.array(paces)


def crossings(objective: Objective, action: int = 1) -> list[tuple[str, str]]:
    """Calls from one file of ours to another in a step of SensorSelect whose set was not scored
    before: caller's file, and file and name of what it calls. The first is `step` itself."""
    env = gym.make(
        "coview/SensorSelect-v0", objective=objective, disable_env_checker=True
    ).unwrapped
    env.reset(seed=0)
    env.step(action)  # what is made once is made
    env.reset()
    objective.forget()
    calls: list[tuple[str, str]] = []

    def watch(frame: FrameType, event: str, _: Any) -> None:
        file = frame.f_code.co_filename
        if event != "call" or not file.startswith(OURS):
            return
        caller = frame.f_back
        while caller is not None and not caller.f_code.co_filename.startswith(OURS):
            caller = caller.f_back
        source = "" if caller is None else caller.f_code.co_filename
        if source != file:
            calls.append((source, f"{file}:{frame.f_code.co_name}"))

    sys.setprofile(watch)
    try:
        env.step(action)
    finally:
        sys.setprofile(None)
    return calls


def files_of(calls: list[tuple[str, str]]) -> list[str]:
    return list(dict.fromkeys(called.rpartition(":")[0] for _, called in calls))


def pose_pace(
    frames: int, rendering: Rendering, steps: int, rounds: int
) -> tuple[float, np.ndarray]:
    """CPU seconds until the first episode has begun, and steps per second of rounds of moving all
    four sensors."""
    env = gym.make(
        "coview/SensorPose-v0",
        frames=frames,
        moves=steps * rounds + 1,
        rendering=rendering,
        disable_env_checker=True,
    ).unwrapped
    start, paces = time.process_time(), []
    env.reset(seed=0)
    begun = time.process_time() - start
    env.action_space.seed(0)
    for _ in range(rounds):
        start = time.process_time()
        for _ in range(steps):
            env.step(env.action_space.sample())
        paces.append(steps / (time.process_time() - start))
    return begun, np.array(paces)


def main_pose(frames: int) -> None:
    ways: list[tuple[Rendering, int, int]] = [("panorama", 50, ROUNDS), ("full", 1, 3)]
    for rendering, steps, rounds in ways:
        begun, paces = pose_pace(frames, rendering, steps, rounds)
        print(
            f"SensorPose, {rendering}, {frames} frames, four sensors moved at once: "
            f"{paces.max():.1f} steps/s at best, median {np.median(paces):.1f}; begun after "
            f"{begun:.1f} CPU s"
        )


def main_table() -> None:
    for count in (1, 16, 64):
        env = gym.make_vec("coview/SensorSelect-v0", num_envs=count, fidelity="table")
        paces = pace(env, 3200 // count + 20)
        print(
            f"table, {count:3} at once: {paces.max():8.0f} steps/s at best, median "
            f"{np.median(paces):8.0f}"
        )


def main(frames: int) -> None:
    calls = crossings(Objective(Setting("tjunction", fidelity="table")))
    names = [str(Path(file).relative_to(ROOT)) for file in files_of(calls)]
    print(
        f"table: a step crosses {len(names)} files with {len(calls)} calls between them: "
        f"{', '.join(names)}"
    )
    fidelities: list[FidelityName] = ["surrogate", "coverage"]
    for name in fidelities:
        objective = Objective(Setting("tjunction", fidelity=name), Run(frames=frames))
        for count in (1, 16, 64):
            objective.forget()
            env = gym.make_vec("coview/SensorSelect-v0", num_envs=count, objective=objective)
            paces = pace(env, 800 // count + 20)
            print(
                f"{name:10} {frames} frames, {count:3} at once: "
                f"{paces.max():8.0f} steps/s at best, median {np.median(paces):8.0f}"
            )


if __name__ == "__main__":
    numbers = [int(each) for each in sys.argv[1:] if each.isdigit()]
    if "--table" in sys.argv:
        main_table()
    else:
        (main_pose if "--pose" in sys.argv else main)(*(numbers or [200]))
