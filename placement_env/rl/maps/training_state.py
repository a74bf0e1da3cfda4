"""`TrainingState`: where a training is, in one file, so that it goes on where it was killed."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from models.training.checkpoint import checkpoint_errors, read_checkpoint, save_atomically

CHECKPOINT_S = 60.0  # seconds between two checkpoints, at least


@runtime_checkable
class Stateful(Protocol):
    """A network or an optimiser."""

    def state_dict(self) -> dict[str, Any]:
        """Its state."""
        ...

    def load_state_dict(self, state_dict: dict[str, Any]) -> Any:
        """Take a state of `state_dict`."""
        ...


class TrainingState:
    """The file of a training. identity: what its weights depend on, by name; parts: networks and optimisers by name,
    which are brought to the state that the file holds, where there is one. Raises ValueError where it is damaged or of
    another training."""

    def __init__(
        self, path: Path, identity: Mapping[str, Any], parts: Mapping[str, Stateful], *, every_s: float = CHECKPOINT_S
    ) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._identity, self._parts, self._every = path, dict(identity), dict(parts), every_s
        self._saved = time.monotonic()
        self.counts: dict[str, Any] = {}
        if not path.exists():
            return
        state = read_checkpoint(path)
        different = [key for key, value in self._identity.items() if state.get(key) != value]
        if different:
            raise ValueError(f"{path} is of other {' and '.join(different)}: choose another folder or remove it")
        with checkpoint_errors(path):
            for name, part in self._parts.items():
                part.load_state_dict(state[name])
            self.counts = dict(state["counts"])

    @property
    def due(self) -> bool:
        """Whether the time for a checkpoint has come."""
        return time.monotonic() - self._saved >= self._every

    def save(self, **counts: Any) -> None:
        """Write the state, all of it or nothing; counts: how far the training is, numbers by name."""
        parts = {name: part.state_dict() for name, part in self._parts.items()}
        save_atomically(self._path, {**self._identity, **parts, "counts": counts})
        self._saved = time.monotonic()


def cosine(share: float) -> float:
    """What is left of a learning rate when a share of the steps is done: 1 at first, a hundredth at the end."""
    return 0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2
