"""Weights as safetensors files: a network's tensors, and a header that says what they are and where they come from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
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
    """Where weights come from. site: what they were trained for, "general" for any. ap: as measured, by name."""

    site: str = ""
    seed: int = 0
    commit: str = ""
    ap: dict[str, float] = field(default_factory=dict)


def save_weights(path: str | Path, network: VoxelNet, header: Header) -> None:
    """Write a network's weights; the file is there complete or not at all.

    Raises ValueError where a weight is not finite: such a network is of no use.
    """
    from safetensors.torch import save

    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise ValueError(
                f"weights must be finite, but {name} is not: the training diverged, save an earlier network"
            )
    metadata = {
        "format": FORMAT, "config": json.dumps(network.config.to_dict()), "digest": digest_of(tensors),
        "site": header.site, "seed": str(header.seed), "commit": header.commit, "ap": json.dumps(header.ap),
    }  # fmt: skip
    write_bytes(path, header_in_order(save(tensors, metadata)))


def header_in_order(content: bytes) -> bytes:
    """A safetensors file with its header sorted by name; the library orders it anew in every process."""
    size = int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8 : 8 + size]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)  # so that the tensors are aligned
    return len(header).to_bytes(8, "little") + header + content[8 + size :]


def load_weights(path: str | Path) -> tuple[VoxelNet, Header]:
    """The network of a weights file, ready for inference, and its header.

    Raises FileNotFoundError; ValueError, in one line, where the file is damaged, of another kind, or not of the size
    that its configuration says.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no weights file at {path}")
    metadata, tensors = read_tensors(path, FORMAT)
    return _network(path, metadata, tensors), _header(path, metadata)


def read_tensors(path: Path, expected_format: str) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Header and tensors of a safetensors file that says which format it is in, and the digest of its tensors.

    Raises ValueError, in one line, where the file is damaged or of another format.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # no dict
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RuntimeError, MemoryError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path} is damaged or no safetensors file ({reason}): fetch it again") from None
    if metadata.get("format") != expected_format:
        raise ValueError(f"{path} is not in the format {expected_format!r}, its header says {metadata.get('format')!r}")
    if metadata.get("digest") != digest_of(tensors):
        raise ValueError(f"{path} is damaged: its tensors are not those it was saved with; fetch it again")
    return metadata, tensors


def check_tensors(expected: dict[str, Tensor], tensors: dict[str, Tensor], origin: str | Path) -> None:
    """Raise ValueError, naming the first difference, unless the tensors are the expected ones by name and shape."""
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
        raise ValueError(f"{path} has a configuration of which no network can be made: {reason}") from None
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


def digest_of(tensors: dict[str, Tensor]) -> str:
    """SHA-256 of tensors, their names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tuple(tensors[name].shape)}".encode())
        flat = tensors[name].detach().cpu().contiguous().view(-1)
        digest.update(flat.view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def digest_with(weights: str, *settings: Any) -> str:
    """SHA-256 of a digest of weights and what else a detector's answers depend on, as JSON writes it."""
    return hashlib.sha256(json.dumps([weights, *settings], sort_keys=True).encode()).hexdigest()
