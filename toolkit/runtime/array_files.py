"""Tables and other results as files of named arrays: written whole or not at all, checked when they are read."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from toolkit.runtime.files import write_bytes

_CHECKSUM = 32  # bytes of SHA-256 over all that comes before, at the end of the file, where NumPy overlooks them


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a .npz file; one that was there is replaced. A process killed in mid-write leaves what was there before."""
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # its other keyword is not among them
    write_bytes(path, content.getvalue() + sha256(content.getvalue()).digest())


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a file of `write_arrays`. Raises FileNotFoundError; ValueError where it is damaged or another."""
    content = Path(path).read_bytes()
    content, checksum = content[:-_CHECKSUM], content[-_CHECKSUM:]
    if sha256(content).digest() != checksum:
        raise ValueError(f"{path} does not fit its checksum, so it is damaged or no file of ours: make it again")
    try:
        with np.load(BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file}
    except (ValueError, OSError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path} holds no plain arrays ({error}): make it again") from None
