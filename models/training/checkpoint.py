"""Checkpoints of a training: written whole or not at all, read without executing anything, damage named in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import torch

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet
from models.tensor_files import load_tensors
from models.weight_files import check_tensors
from toolkit.runtime.files import write_bytes

CHECKPOINT = "checkpoint.pt"


def save_atomically(path: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint that is whole under its name, or not there."""
    content = BytesIO()
    torch.save(state, content)
    write_bytes(path, content.getvalue())


def read_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """What `save_atomically` wrote. Nothing in the file is executed. Raises ValueError where it is damaged."""
    try:
        state = load_tensors(path, device)
    except ValueError as error:
        raise ValueError(f"{error}: remove it to begin anew") from None
    if not isinstance(state, dict):
        raise ValueError(f"{path} is no checkpoint: remove it to begin anew, or choose another folder")
    return state


def load_checkpoint(path: Path) -> tuple[VoxelNet, dict[str, Any]]:
    """The network of a checkpoint and the settings it was trained with. Raises ValueError where it is damaged."""
    state = read_checkpoint(path)
    with checkpoint_errors(path):
        network = VoxelNet(VoxelNetConfig.from_dict(state["config"]))
        check_tensors(network.state_dict(), state["network"], "its network")
        network.load_state_dict(state["network"])
        return network.eval(), {"preset": state["preset"], "step": state["step"], "frames": state["frames"]}


def check_identity(path: Path, state: dict[str, Any], identity: dict[str, Any]) -> None:
    """Raise ValueError unless a checkpoint's state is of the run that `identity` says: its settings, by name."""
    different = [key for key in identity if _plain(state.get(key, "")) != _plain(identity[key])]
    if different:
        raise ValueError(
            f"{path} belongs to a run with another {' and '.join(different)}: choose another folder or --overwrite it"
        )


@contextmanager
def checkpoint_errors(path: Path) -> Iterator[None]:
    """One line for a checkpoint that can be read and does not fit."""
    try:
        yield
    except (KeyError, TypeError, AttributeError, RuntimeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:160]
        raise ValueError(f"{path} is no checkpoint of this training ({reason}): remove it to begin anew") from None


def _plain(value: Any) -> Any:
    """Tuples as lists, so that settings compare equal after a round trip."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
