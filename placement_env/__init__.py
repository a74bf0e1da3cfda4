"""What to build: candidates, objective, environments and searches. Nothing heavy loads until it is used."""

from importlib.util import find_spec
from pathlib import Path

from placement_env.registration import register
from toolkit.lazy import lazily

__getattr__, __dir__ = lazily(
    __name__,
    Path(__file__).parent,
    {
        "Candidates": "candidates", "pool": "candidates", "paper_candidates": "candidates", "load_poles": "poles",
        "Objective": "objective", "Weights": "objective", "Score": "objective", "Scores": "objective",
        "Visibility": "visibility", "see": "visibility", "traffic": "traffic_frames", "Renders": "renders",
        "Coverage": "coverage", "Surrogate": "surrogate", "Detected": "detection",
        "TableFidelity": "tables", "load_table": "tables",
        "SensorSelectEnv": "select_env", "SensorSubsetEnv": "subset_env", "SensorPoseEnv": "pose_env",
    },
)  # fmt: skip

if find_spec("gymnasium"):
    register()
