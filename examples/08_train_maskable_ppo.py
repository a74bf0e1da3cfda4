"""Train a policy to place sensors, and hold it against the optimum and against greedy.

python examples/08_train_maskable_ppo.py
"""

import tempfile
from pathlib import Path

from placement_env import (
    Objective,
    SensorSelectEnv,
    Setting,
    exhaustive,
    greedy,
    rollout,
    train_policy,
)
from toolkit import Run


def main(frames: int = 6, steps: int = 2048, budget: int = 3) -> None:
    """All environments share one objective and its memory. Called again with the same folder,
    training goes on."""
    objective = Objective(Setting("tjunction", fidelity="surrogate"), Run(frames=frames))

    def make_env() -> SensorSelectEnv:
        return SensorSelectEnv(objective=objective, budget=budget)

    def report(done: int, mean_return: float) -> None:
        print(f"{done:6d} steps, mean return {mean_return:.3f}")

    with tempfile.TemporaryDirectory() as folder:
        policy = train_policy(make_env, Path(folder), steps=steps, seed=0, progress=report)
    print(rollout(policy, make_env(), episodes=10))
    print(greedy.search(objective, budget))
    print(exhaustive.search(objective, budget))


if __name__ == "__main__":
    main()
