"""HDF5 files whose disk may fill up while they are written: one OSError, where the HDF5 library ends the process.

HDF5 cannot close a file that it could not write to the end, and dies over it. So it never learns of the failure: it
writes through a file object that keeps the first error for itself and lets all later writes pass.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py


@contextmanager
def hdf5_file(path: str | Path) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """A new HDF5 file to be written by the block, and a function that raises OSError once the disk has refused; it is
    called at the end, and may be called before to end long work early. Not atomic: see `toolkit.runtime.files.writing`.
    """
    with Path(path).open("w+b", buffering=0) as raw:
        disk = _Disk(raw)
        try:
            with h5py.File(disk, "w") as file:
                yield file, disk.check
        except Exception:
            disk.check()  # what HDF5 says of a file that is not as it wrote it matters less
            raise
        disk.check()


class _Disk(io.RawIOBase):
    """A file that keeps an error of writing until it is asked for it."""

    def __init__(self, raw: io.FileIO) -> None:
        self._raw = raw
        self._error: OSError | None = None

    def check(self) -> None:
        """Raise the error, if there was one."""
        if self._error is not None:
            raise self._error

    def readinto(self, buffer: Any) -> int:
        return self._raw.readinto(buffer)

    def write(self, content: Any) -> int:
        rest = memoryview(content).cast("B")
        size = len(rest)
        try:
            while len(rest) and self._error is None:
                rest = rest[self._raw.write(rest) :]
        except OSError as error:
            self._error = error
        self._raw.seek(len(rest), os.SEEK_CUR)
        return size

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._raw.seek(offset, whence)

    def tell(self) -> int:
        return self._raw.tell()

    def truncate(self, size: int | None = None) -> int:
        try:
            self._raw.truncate(size)
        except OSError as error:
            self._error = self._error or error
        return self._raw.tell() if size is None else size
