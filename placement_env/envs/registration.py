"""The environments' names in Gymnasium; importing `placement_env` gives them where Gymnasium is installed."""

from __future__ import annotations

ENVIRONMENTS = {
    "coview/SensorSelect-v0": ("select:SensorSelectEnv", "vector:SensorSelectVectorEnv"),
    "coview/SensorSubset-v0": ("subset:SensorSubsetEnv", "vector:SensorSubsetVectorEnv"),
    "coview/SensorPose-v0": ("pose:SensorPoseEnv", "vector:SensorPoseVectorEnv"),
}


def register() -> None:
    """Make the environments known to Gymnasium. Raises ImportError, with the remedy, where Gymnasium is missing."""
    try:
        from gymnasium.envs.registration import register as register_one
        from gymnasium.envs.registration import registry
    except ImportError:
        raise ImportError("the environments need Gymnasium: pip install coview[rl]") from None
    for name, (scalar, vector) in ENVIRONMENTS.items():
        if name not in registry:
            register_one(name, f"placement_env.envs.{scalar}", vector_entry_point=f"placement_env.envs.{vector}")
