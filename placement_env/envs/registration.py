"""Registration of the environments with Gymnasium.

It happens once Gymnasium and `placement_env` are imported, in either order.

Gymnasium itself imports a package named before the environment: `gymnasium.make("placement_env:coview/...")`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType

ENVIRONMENTS: dict[str, tuple[str, str]] = {
    "coview/SensorSelect-v0": ("select:SensorSelectEnv", "select:SensorSelectVectorEnv"),
    "coview/SensorSubset-v0": ("subset:SensorSubsetEnv", "subset:SensorSubsetVectorEnv"),
    "coview/SensorPose-v0": ("pose:SensorPoseEnv", "pose:SensorPoseVectorEnv"),
}


def register() -> None:
    """Register the environments. Raises ImportError, with the remedy, if Gymnasium is missing."""
    try:
        from gymnasium.envs.registration import register as register_one
        from gymnasium.envs.registration import registry
    except ImportError:
        raise ImportError("the environments need Gymnasium: pip install coview[rl]") from None
    for name, (scalar, vector) in ENVIRONMENTS.items():
        if name not in registry:
            register_one(name, f"placement_env.envs.{scalar}", vector_entry_point=f"placement_env.envs.{vector}")


def register_with_gymnasium() -> None:
    """Register once Gymnasium is imported, without importing it here."""
    if sys.modules.get("gymnasium"):
        register()
    else:
        sys.meta_path.insert(0, AfterImport("gymnasium", register))


class AfterImport(MetaPathFinder):
    """Import hook (PEP 451) that calls `then` after a module, once."""

    def __init__(self, name: str, then: Callable[[], None]) -> None:
        self.name, self.then = name, then

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module's spec, whose loader calls `then` when done. None for other modules."""
        if fullname != self.name:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _ThenLoader(spec.loader, self._finish)
        return spec

    def _finish(self) -> None:
        if self in sys.meta_path:
            sys.meta_path.remove(self)
        self.then()


class _ThenLoader(Loader):
    def __init__(self, loader: Loader, then: Callable[[], None]) -> None:
        self.loader, self.then = loader, then

    def __getattr__(self, name: str) -> object:
        return getattr(self.loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        if module.__spec__ is not None:
            module.__spec__.loader = module.__loader__ = self.loader
        self.loader.exec_module(module)
        self.then()
