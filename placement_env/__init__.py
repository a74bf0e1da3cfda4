"""What to build: candidates, objective, environments and searches. Nothing heavy loads until it is used."""

from placement_env.envs.registration import register_with_gymnasium
from toolkit.runtime.lazy import lazily

__getattr__, __dir__ = lazily(
    __name__,
    {
        "Candidates": "candidates.candidates", "pool": "candidates.pool", "paper_candidates": "candidates.pool",
        "load_poles": "candidates.poles",
        "Objective": "objective", "Weights": "objective", "Score": "objective", "Scores": "objective",
        "Visibility": "fidelity.visibility",
        "see": "fidelity.visibility", "traffic": "fidelity.traffic", "Renders": "fidelity.renders",
        "Coverage": "fidelity.coverage", "Surrogate": "fidelity.surrogate", "Detected": "fidelity.detector",
        "TableFidelity": "fidelity.table", "load_table": "fidelity.table",
        "SensorSelectEnv": "envs.select", "SensorSubsetEnv": "envs.subset", "SensorPoseEnv": "envs.pose",
    },
)  # fmt: skip

register_with_gymnasium()
