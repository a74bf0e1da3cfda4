"""Files of NumPy's arrays, with limits on their size and a checksum."""

import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np

from toolkit.runtime.reading import name_errors, plain_file, read_plain
from toolkit.runtime.writing import write_bytes

# SHA-256 over the whole content, at the end of the file, which NumPy does not read
_CHECKSUM_BYTES = 32
# errors that np.load was seen to raise on damaged files: from the zip archive, the header's text
# or its shape
_DAMAGE = (
    *(
        OSError,
        ValueError,
        EOFError,
        LookupError,
        TypeError,
        OverflowError,
        MemoryError,
        RuntimeError,
        SyntaxError,
    ),
    *(AttributeError, zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError),
)
MAX_UNPACKED_BYTES = 1 << 30  # memory that one file may need
MAX_CLOUD_BYTES = 1 << 28  # packed cloud; float64 copies take several times as much


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a .npz file with a checksum, replacing an old one.

    A process killed while writing leaves the old one. Raises ValueError for arrays that
    `read_arrays` would refuse."""
    with name_errors(path):
        check_unpacked(sum(array.nbytes for array in arrays.values()))
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # its other keyword is not among them
    write_bytes(path, content.getvalue() + sha256(content.getvalue()).digest())


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read the arrays of a file of `write_arrays`.

    Raises FileNotFoundError; ValueError for a damaged or other file."""
    stored_bytes = read_plain(path)
    content = stored_bytes[:-_CHECKSUM_BYTES]
    checksum = stored_bytes[-_CHECKSUM_BYTES:]
    if sha256(content).digest() != checksum:
        raise ValueError(
            f"{path} does not fit its checksum: it is damaged or not a coview file, make it again"
        )
    return load_arrays(path, BytesIO(content))


def check_unpacked(size: int, max_bytes: int | None = None) -> None:
    """Raise ValueError if a file needs more memory than `max_bytes`, by default
    `MAX_UNPACKED_BYTES`."""
    max_bytes = max_bytes or MAX_UNPACKED_BYTES
    if size > max_bytes:
        raise ValueError(
            f"it unpacks to {size / 2**30:.1f} GiB, more than the {max_bytes / 2**30:g} GiB "
            "allowed: split it"
        )


def load_arrays(
    path: str | Path, content: BytesIO | None = None, *, max_bytes: int | None = None
) -> dict[str, np.ndarray]:
    """Load the arrays of a .npz file by name, or the array of a .npy file as "".

    Raises ValueError, in one line, also if the arrays of a .npz would take more memory than
    `check_unpacked` allows. content: content of the file, if it was read before."""
    try:
        with content or plain_file(path).open("rb") as file:
            if file.read(2) != b"PK":  # no zip archive, so a .npy file
                file.seek(0)
                _check_array(
                    file,
                    os.fstat(file.fileno()).st_size
                    if content is None
                    else len(content.getbuffer()),
                )
                file.seek(0)
                return {"": np.load(file, allow_pickle=False)}
            with zipfile.ZipFile(file) as archive:
                check_unpacked(sum(entry.file_size for entry in archive.infolist()), max_bytes)
                for entry in archive.infolist():
                    with archive.open(entry) as stream:
                        _check_array(stream, entry.file_size)
            file.seek(0)
            with np.load(file, allow_pickle=False) as arrays:
                return {name: arrays[name] for name in arrays.files}
    except _DAMAGE as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise ValueError(f"{path} cannot be read as .npy array or .npz archive: {reason}") from None


def _check_array(stream: IO[bytes], size: int) -> None:
    """Check that the array in a stream of `size` bytes is as large as its header states."""
    form = np.lib.format
    version = form.read_magic(stream)
    read_header = form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0
    shape, _, kind = read_header(stream)
    declared_bytes = math.prod(shape) * kind.itemsize
    check_unpacked(declared_bytes)
    if kind.itemsize and declared_bytes != size - stream.tell() and not kind.hasobject:
        raise ValueError(
            f"its header says {declared_bytes} bytes, but {size - stream.tell()} are there"
        )
