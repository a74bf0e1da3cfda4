"""Files of named arrays that are whole or not there: written under another name first, checked when they are read."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from toolkit.parts import write_whole

_DAMAGE = (ValueError, KeyError, EOFError, NotImplementedError, BadZipFile, zlib.error)


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a .npz file; one that was there is replaced. A process killed in mid-write leaves what was there before."""
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # its other keyword is not among them
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_whole(Path(path), content.getvalue())


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a file, each held against its checksum.

    Raises FileNotFoundError; ValueError where the file is damaged or holds anything but arrays.
    """
    content = Path(path).read_bytes()
    try:
        with np.load(BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file}
    except _DAMAGE as error:
        raise ValueError(f"{path} is damaged ({error}): delete it, and it is made again") from None
