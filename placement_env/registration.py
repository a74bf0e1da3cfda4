"""The environments' names in Gymnasium, given when both packages are imported, in either order."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType
from typing import Any

ENVIRONMENTS = {
    "coview/SensorSelect-v0": ("select_env:SensorSelectEnv", "vector_env:SensorSelectVectorEnv"),
    "coview/SensorSubset-v0": ("subset_env:SensorSubsetEnv", "vector_env:SensorSubsetVectorEnv"),
    "coview/SensorPose-v0": ("pose_env:SensorPoseEnv", "vector_env:SensorPoseVectorEnv"),
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
            register_one(name, f"placement_env.{scalar}", vector_entry_point=f"placement_env.{vector}")


def register_with_gymnasium() -> None:
    """`register`, now if Gymnasium is imported already, else as soon as it is; so this costs nothing without it."""
    if "gymnasium.envs.registration" in sys.modules:
        register()
    elif not any(isinstance(finder, _AfterGymnasium) for finder in sys.meta_path):
        sys.meta_path.insert(0, _AfterGymnasium())


class _AfterGymnasium(MetaPathFinder):
    """Runs `register` once Gymnasium has been imported, then goes."""

    def find_spec(self, name: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                register()

            spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
