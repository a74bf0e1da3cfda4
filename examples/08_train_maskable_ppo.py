"""Train a policy to place sensors, and hold it against the optimum and against greedy.

python examples/08_train_maskable_ppo.py
"""

import tempfile
from pathlib import Path

from placement_env.envs.select import SensorSelectEnv
from placement_env.objective import Objective
from placement_env.rl.training import rollout, train_policy
from placement_env.search import exhaustive, greedy


def main(frames: int = 6, steps: int = 2048, budget: int = 3) -> None:
    """All environments share one objective and its memory. Called again with the same folder, training goes on."""
    objective = Objective("tjunction", frames, fidelity="surrogate")

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
