"""Files of weights and checkpoints: written whole, read without executing anything.

Weights are safetensors files: tensors, and a header that says what they are and where they come from. Checkpoints are
`torch.save` files of plain tensors and numbers.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet
from toolkit.runtime.files import parse_json, write_bytes

FORMAT = "coview VoxelNet 1"


@dataclass(frozen=True)
class Header:
    """Origin of weights. site: the site they were trained for, "general" for any. ap: measured AP by name."""

    site: str = ""
    seed: int = 0
    commit: str = ""
    ap: dict[str, float] = field(default_factory=dict)


def save_weights(path: str | Path, network: VoxelNet, header: Header) -> None:
    """Write a network's weights, complete or not at all.

    Raises ValueError for a weight that is not finite: such a network is of no use.
    """
    from safetensors.torch import save

    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise ValueError(
                f"weights must be finite, but {name} is not: the training diverged, save an earlier network"
            )
    metadata = {
        "format": FORMAT,
        "config": json.dumps(network.config.to_dict()),
        "digest": digest_tensors(tensors),
        "site": header.site,
        "seed": str(header.seed),
        "commit": header.commit,
        "ap": json.dumps(header.ap),
    }
    write_bytes(path, header_in_order(save(tensors, metadata)))


def header_in_order(content: bytes) -> bytes:
    """Sort the header of a safetensors file by name. The library orders it anew in every process."""
    size = int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8 : 8 + size]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)  # so that the tensors are aligned
    return len(header).to_bytes(8, "little") + header + content[8 + size :]


def load_weights(path: str | Path) -> tuple[VoxelNet, Header]:
    """Load the network of a weights file, ready for inference, and its header.

    Raises FileNotFoundError; ValueError, in one line, if the file is damaged, of another kind, or of another size than
    its configuration says.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no weights file at {path}")
    metadata, tensors = read_tensors(path, FORMAT)
    return _network(path, metadata, tensors), _header(path, metadata)


def read_tensors(path: Path, expected_format: str) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Read header and tensors of a safetensors file.

    Raises ValueError, in one line, if the file is damaged or its header names another format or digest.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # no dict
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RuntimeError, MemoryError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path} is damaged or not a safetensors file ({reason}): fetch it again") from None
    if metadata.get("format") != expected_format:
        raise ValueError(f"{path} is not in the format {expected_format!r}, its header says {metadata.get('format')!r}")
    if metadata.get("digest") != digest_tensors(tensors):
        raise ValueError(f"{path} is damaged: its tensors are not those it was saved with; fetch it again")
    return metadata, tensors


def check_tensors(expected: dict[str, Tensor], tensors: dict[str, Tensor], origin: str | Path) -> None:
    """Raise ValueError, naming the first difference, unless names and shapes agree."""
    missing, unknown = expected.keys() - tensors.keys(), tensors.keys() - expected.keys()
    if missing or unknown:
        what = f"lacks {min(missing)}" if missing else f"has {min(unknown)} besides"
        raise ValueError(f"{origin} {what}: it holds {len(tensors)} tensors where the network has {len(expected)}")
    for name, tensor in expected.items():
        if tensors[name].shape != tensor.shape:
            raise ValueError(f"{origin}: {name} must have shape {(*tensor.shape,)}, got {(*tensors[name].shape,)}")
        if tensor.is_floating_point() and not torch.isfinite(tensors[name]).all():
            raise ValueError(f"{origin}: {name} holds values that are not finite")


def _network(path: Path, metadata: dict[str, str], tensors: dict[str, Tensor]) -> VoxelNet:
    try:
        config = VoxelNetConfig.from_dict(parse_json(metadata["config"]))
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} has no usable configuration in its header: {error}") from None
    try:
        with torch.device("meta"):  # what it would be, without the memory that a damaged configuration may ask for
            expected = VoxelNet(config).state_dict()
    except (ValueError, RuntimeError, TypeError, IndexError, OverflowError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path} has a configuration that makes no network: {reason}") from None
    check_tensors(expected, tensors, path)
    network = VoxelNet(config)
    network.load_state_dict(tensors)
    return network.eval()


def _header(path: Path, metadata: dict[str, str]) -> Header:
    try:
        ap, seed = parse_json(metadata.get("ap", "{}")), int(metadata.get("seed", 0))
    except ValueError as error:
        raise ValueError(f"{path} has no usable seed and AP in its header: {error}") from None
    if not isinstance(ap, dict) or not all(isinstance(value, int | float) for value in ap.values()):
        raise ValueError(f"{path}: ap of its header must be numbers by name, got {str(ap)[:60]}")
    return Header(metadata.get("site", ""), seed, metadata.get("commit", ""), ap)


def digest_tensors(tensors: dict[str, Tensor]) -> str:
    """SHA-256 of tensors with their names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tuple(tensors[name].shape)}".encode())
        flat = tensors[name].detach().cpu().contiguous().view(-1)
        digest.update(flat.view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def digest_detector(weights: str, *settings: object) -> str:
    """SHA-256 of a weights digest and a detector's settings, as JSON."""
    return hashlib.sha256(json.dumps([weights, *settings], sort_keys=True).encode()).hexdigest()


# What torch.load was seen to raise on damaged files, besides the OSError of a file that cannot be opened.
_TORCH_RAISES = (
    pickle.UnpicklingError,
    RuntimeError,
    EOFError,
    KeyError,
    ValueError,
    AttributeError,
    TypeError,
    IndexError,
    OverflowError,
    MemoryError,
    AssertionError,
    OSError,
    zipfile.BadZipFile,
    NotImplementedError,
)


def load_tensors(path: str | Path, device: str = "cpu") -> Any:
    """Read tensors, numbers, texts, lists and dictionaries that `torch.save` wrote.

    Raises FileNotFoundError; ValueError, in one line, if the file is damaged or holds anything else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {path}")
    try:
        return torch.load(path, map_location=device, weights_only=True)
    except _TORCH_RAISES as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise ValueError(f"{path} is damaged or not a checkpoint of tensors: {reason}") from None


def save_atomically(path: Path, state: dict[str, object]) -> None:
    """Write a checkpoint, complete or not at all."""
    content = BytesIO()
    torch.save(state, content)
    write_bytes(path, content.getvalue())


def read_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Read a checkpoint without executing anything in it. Raises ValueError if it is damaged."""
    try:
        state = load_tensors(path, device)
    except ValueError as error:
        raise ValueError(f"{error}: remove it to start again") from None
    if not isinstance(state, dict):
        raise ValueError(f"{path} is not a checkpoint: remove it to start again, or choose another folder")
    return state


def check_identity(path: Path, state: dict[str, object], identity: dict[str, object]) -> None:
    """Raise ValueError unless a checkpoint belongs to the run of `identity`. identity: settings by name."""
    different = [key for key in identity if _plain(state.get(key, "")) != _plain(identity[key])]
    if different:
        raise ValueError(
            f"{path} belongs to a run with another {' and '.join(different)}: choose another folder or --overwrite it"
        )


@contextmanager
def checkpoint_errors(path: Path) -> Iterator[None]:
    """Turn errors of a checkpoint that does not fit into one line."""
    try:
        yield
    except (KeyError, TypeError, AttributeError, RuntimeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:160]
        raise ValueError(f"{path} is not a checkpoint of this training ({reason}): remove it to start again") from None


def _plain(value: object) -> object:
    """Return tuples as lists, so that settings compare equal after a round trip."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
