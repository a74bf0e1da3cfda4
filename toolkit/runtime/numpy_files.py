"""NumPy's own files, .npy and .npz, read with care: without pickles, and every damage one ValueError."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np

# What np.load was seen to raise on damaged files: from the zip archive, from the header's text, from its shape.
_NUMPY_RAISES = (
    OSError, ValueError, EOFError, KeyError, TypeError, IndexError, OverflowError, MemoryError, NotImplementedError,
    RuntimeError, SyntaxError, AttributeError, zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError,
)  # fmt: skip


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of a .npz file by name; the one of a .npy file under the name "". Raises ValueError, in one line."""
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"": loaded}
        with loaded as file:
            return {name: file[name] for name in file.files}
    except _NUMPY_RAISES as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise ValueError(f"{path} is no .npy array or .npz archive that can be read: {reason}") from None
