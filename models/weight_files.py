"""Files of weights and checkpoints: written whole, read without executing anything.

Weights are safetensors files: tensors, and a header that states their kind and origin. Checkpoints
are `torch.save` files of plain tensors and numbers.
"""

import hashlib
import json
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.voxelnet import VoxelNet
from toolkit.runtime.reading import MAX_FILE_BYTES
from toolkit.runtime.text_values import parse_json
from toolkit.runtime.writing import write_bytes

FORMAT = "coview VoxelNet 1"
# Errors that torch.load raised on damaged files, in addition to OSError for a file that cannot be
# opened.
_TORCH_RAISES = (
    pickle.UnpicklingError,
    zipfile.BadZipFile,
    RuntimeError,
    NotImplementedError,
    EOFError,
    OSError,
    MemoryError,
    KeyError,
    IndexError,
    ValueError,
    TypeError,
    AttributeError,
    OverflowError,
    AssertionError,
)


@dataclass(frozen=True)
class WeightsHeader:
    """Origin of weights.

    Attributes:
        site: Site they were trained for, "general" for any.
        seed: Seed of the training.
        commit: Commit of the code.
        ap: Measured AP by name.
    """

    site: str = ""
    seed: int = 0
    commit: str = ""
    ap: dict[str, float] = field(default_factory=dict)


def save_weights(path: str | Path, network: VoxelNet, header: WeightsHeader) -> None:
    """Write a network's weights, complete or not at all. Raises ValueError for weights that are not
    finite.
    """
    from safetensors.torch import save

    tensors = {
        name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()
    }
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise ValueError(
                f"weights must be finite, but {name} is not: the training diverged, save an "
                "earlier one"
            )
    metadata = {
        "format": FORMAT,
        "config": json.dumps(network.config.to_dict()),
        "digest": digest_tensors(tensors),
    }
    metadata |= {
        "site": header.site,
        "seed": str(header.seed),
        "commit": header.commit,
        "ap": json.dumps(header.ap),
    }
    content = save(tensors, metadata)
    # a safetensors file: 8 bytes with the size of a JSON header, the header, the tensors; the
    # library orders the header differently in every process, so it is sorted here
    header_end = 8 + int.from_bytes(content[:8], "little")
    entries = json.loads(content[8:header_end])
    sorted_header = json.dumps(entries, sort_keys=True, separators=(",", ":")).encode()
    sorted_header += b" " * (-len(sorted_header) % 8)  # so that the tensors are aligned
    size = len(sorted_header).to_bytes(8, "little")
    write_bytes(path, size + sorted_header + content[header_end:])


def load_weights(path: str | Path) -> tuple[VoxelNet, WeightsHeader]:
    """Load the network of a weights file, ready for inference, and its header.

    Raises FileNotFoundError; ValueError, in one line, if the file is damaged, of another kind, or
    of another size than in its configuration.
    """
    path = Path(path)
    metadata, tensors = _read_tensors(path)
    if metadata.get("format") != FORMAT:
        raise ValueError(
            f"{path} is not in the format {FORMAT!r}, its header has {metadata.get('format')!r}"
        )
    if metadata.get("digest") != digest_tensors(tensors):
        raise ValueError(
            f"{path} is damaged: its tensors are not those it was saved with; fetch it again"
        )
    network = _build_network(path, metadata, tensors)
    try:
        ap = parse_json(metadata.get("ap", "{}"))
        seed = int(metadata.get("seed", 0))
    except ValueError as error:
        raise ValueError(f"{path} has no usable seed and AP in its header: {error}") from None
    if not isinstance(ap, dict) or not all(isinstance(value, int | float) for value in ap.values()):
        raise ValueError(f"{path}: ap of its header must be numbers by name, got {str(ap)[:60]}")
    header = WeightsHeader(
        site=metadata.get("site", ""), seed=seed, commit=metadata.get("commit", ""), ap=ap
    )
    return network.eval(), header


def _read_tensors(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Read the header and the tensors of a file.

    Raises FileNotFoundError; ValueError if the file is too large, damaged or of another kind."""
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise FileNotFoundError(f"no weights file at {path}")
    if (size := path.stat().st_size) > MAX_FILE_BYTES:
        raise ValueError(
            f"{path} has {size / 2**30:.1f} GiB, which no weights of coview have: fetch it again"
        )
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # no dict
    except (
        SafetensorError,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        RuntimeError,
        MemoryError,
    ) as error:
        raise ValueError(
            f"{path} is damaged or not a safetensors file ({_reason(error)}): fetch it again"
        ) from None
    return metadata, tensors


def _build_network(path: Path, metadata: dict[str, str], tensors: dict[str, Tensor]) -> VoxelNet:
    """Build the network that a header describes with these tensors.

    metadata: entries of the header, `config` among them. Raises ValueError unless they fit."""
    try:
        config = VoxelNetConfig.from_dict(parse_json(metadata["config"]))
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} has no usable configuration in its header: {error}") from None
    try:
        # expected tensors without the memory that a damaged configuration may request
        with torch.device("meta"):
            expected = VoxelNet(config).state_dict()
    except (ValueError, RuntimeError, TypeError, IndexError, OverflowError) as error:
        raise ValueError(
            f"{path} has a configuration that makes no network: {_reason(error)}"
        ) from None
    check_tensors(expected, tensors, path)
    network = VoxelNet(config)
    network.load_state_dict(tensors)
    return network


def _reason(error: Exception) -> str:
    """First line of an error's text, at most 160 characters, or its class without a text."""
    return (str(error).splitlines() or [type(error).__name__])[0][:160]


def check_tensors(
    expected: dict[str, Tensor], tensors: dict[str, Tensor], origin: str | Path
) -> None:
    """Raise ValueError unless the tensors are finite and have the expected names and shapes.

    expected: tensors of a network with these names and shapes; origin: the file, for the error."""
    missing = expected.keys() - tensors.keys()
    unknown = tensors.keys() - expected.keys()
    if missing or unknown:
        difference = f"lacks {min(missing)}" if missing else f"has {min(unknown)} besides"
        raise ValueError(
            f"{origin} {difference}: it holds {len(tensors)} tensors where the network has "
            f"{len(expected)}"
        )
    for name, tensor in expected.items():
        if tensors[name].shape != tensor.shape:
            raise ValueError(
                f"{origin}: {name} must have shape {(*tensor.shape,)}, got "
                f"{(*tensors[name].shape,)}"
            )
        if tensor.is_floating_point() and not torch.isfinite(tensors[name]).all():
            raise ValueError(f"{origin}: {name} holds values that are not finite")


def digest_tensors(tensors: dict[str, Tensor]) -> str:
    """SHA-256 of tensors with their names, types and shapes."""
    digest = hashlib.sha256()
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        flat = tensor.detach().cpu().contiguous().view(-1)
        # NumPy lacks some types of torch, such as bfloat16, so the values are read as bytes
        digest.update(flat.view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def digest_detector(weights: str, *settings: object) -> str:
    """SHA-256 of a detector's weights digest, and of settings that JSON can hold."""
    return hashlib.sha256(json.dumps([weights, *settings], sort_keys=True).encode()).hexdigest()


def load_tensors(path: str | Path, device: str = "cpu") -> object:
    """Read tensors and plain values that `torch.save` wrote.

    Raises FileNotFoundError; ValueError, in one line, if the file is damaged or holds anything
    else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {path}")
    try:
        return torch.load(path, map_location=device, weights_only=True)
    except _TORCH_RAISES as error:
        raise ValueError(
            f"{path} is damaged or not a checkpoint of tensors: {_reason(error)}"
        ) from None


def save_atomically(path: Path, state: dict[str, object]) -> None:
    """Write the state of a training as a checkpoint, complete or not at all."""
    content = BytesIO()
    torch.save(state, content)
    write_bytes(path, content.getvalue())


def read_checkpoint(
    path: Path, device: str = "cpu", *, identity: Mapping[str, object] | None = None
) -> dict[str, Any]:
    """Read the state in a checkpoint, by name, without executing anything in it.

    identity: values that the checkpoint must have, by name, None for any. Raises ValueError if it
    is damaged, or has others.
    """
    try:
        state = load_tensors(path, device)
    except ValueError as error:
        raise ValueError(f"{error}: remove it to start again") from None
    if not isinstance(state, dict):
        raise ValueError(
            f"{path} is not a checkpoint: remove it to start again, or choose another folder"
        )
    # a name that an older checkpoint lacks counts as ""
    differing = " and ".join(
        name for name, value in (identity or {}).items() if state.get(name, "") != value
    )
    if differing:
        remedy = "choose another folder or --overwrite it"
        raise ValueError(f"{path} belongs to a run with another {differing}: {remedy}")
    return state


@contextmanager
def checkpoint_errors(path: Path) -> Iterator[None]:
    """Turn errors of a checkpoint that does not fit into a ValueError in one line."""
    try:
        yield
    except (KeyError, TypeError, AttributeError, RuntimeError, ValueError) as error:
        reason = f"{path} is not a checkpoint of this training ({_reason(error)})"
        raise ValueError(f"{reason}: remove it to start again") from None
