"""Registration of the environments once Gymnasium and `placement_env` are imported, in either
order.

Gymnasium itself imports a package named before the environment:
`gymnasium.make("placement_env:coview/...")`.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

ENVIRONMENTS: dict[str, tuple[str, str]] = {
    "coview/SensorSelect-v0": ("select:SensorSelectEnv", "select:SensorSelectVectorEnv"),
    "coview/SensorSubset-v0": ("select:SensorSubsetEnv", "select:SensorSubsetVectorEnv"),
    "coview/SensorPose-v0": ("pose:SensorPoseEnv", "pose:SensorPoseVectorEnv"),
}


def register_environments() -> None:
    """Register the environments with Gymnasium, unless they are registered already.

    Raises ImportError, with the remedy, if Gymnasium is missing."""
    try:
        from gymnasium.envs.registration import register as register_one, registry
    except ImportError:
        raise ImportError("the environments need Gymnasium: pip install coview[rl]") from None
    for name, (scalar, vector) in ENVIRONMENTS.items():
        if name not in registry:
            register_one(
                name,
                f"placement_env.envs.{scalar}",
                vector_entry_point=f"placement_env.envs.{vector}",
            )


def register_with_gymnasium() -> None:
    """Register once Gymnasium is imported, without importing it here."""
    if sys.modules.get("gymnasium"):
        register_environments()
    else:
        sys.meta_path.insert(0, _AfterImport())


class _AfterImport(MetaPathFinder):
    """Import hook (PEP 451) that registers after Gymnasium is imported, once."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Spec of Gymnasium that registers the environments when its module is executed.

        None for any other module, which leaves it to the usual finders."""
        if fullname != "gymnasium":
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            """Execute the imported module, then register the environments."""
            execute(module)
            if self in sys.meta_path:  # the hook is needed once only
                sys.meta_path.remove(self)
            register_environments()

        spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
