"""Files of named arrays that are whole or not there: written under another name first, checked when they are read."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np

from toolkit.runtime.resumable import write_whole

_CHECKSUM = 32  # bytes of SHA-256 over all that comes before, at the end of the file, where NumPy overlooks them


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a .npz file; one that was there is replaced. A process killed in mid-write leaves what was there before."""
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # its other keyword is not among them
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_whole(Path(path), content.getvalue() + sha256(content.getvalue()).digest())


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a file of `write_arrays`. Raises FileNotFoundError; ValueError where it is damaged or another."""
    content = Path(path).read_bytes()
    content, checksum = content[:-_CHECKSUM], content[-_CHECKSUM:]
    if sha256(content).digest() != checksum:
        raise ValueError(f"{path} does not fit its checksum, so it is damaged or no file of ours: make it again")
    with np.load(BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file}
