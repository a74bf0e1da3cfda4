"""Files of `torch.save` read with care: nothing in them is executed, and every damage is one ValueError."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path
from typing import Any

import torch

# What torch.load was seen to raise on damaged files, besides the OSError of a file that cannot be opened.
_TORCH_RAISES = (
    pickle.UnpicklingError, RuntimeError, EOFError, KeyError, ValueError, AttributeError, TypeError, IndexError,
    OverflowError, MemoryError, AssertionError, OSError, zipfile.BadZipFile, NotImplementedError,
)  # fmt: skip


def load_tensors(path: str | Path, device: str = "cpu") -> Any:
    """What `torch.save` wrote: tensors, numbers, texts, lists and dictionaries of these.

    Raises FileNotFoundError; ValueError, in one line, where the file is damaged or holds anything else.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {path}")
    try:
        return torch.load(path, map_location=device, weights_only=True)
    except _TORCH_RAISES as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise ValueError(f"{path} is damaged or no checkpoint of tensors alone: {reason}") from None
