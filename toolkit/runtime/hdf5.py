"""HDF5 files read and written with care.

A damaged file makes h5py raise OSError, RuntimeError, KeyError, TypeError, ... from any access, even from `in`. Every
access here stands in `reading`, which turns these into one OSError that names the place, and what comes out is plain:
lists of names, texts, numbers in NumPy arrays.

HDF5 cannot close a file that it could not write to the end, and ends the process instead. `hdf5_file` therefore writes
through a file object that keeps the first error to itself and lets all later writes pass.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

# Deflate makes nothing smaller than this; a dataset that claims more than that, and this many bytes, is damaged, and
# reading it would stop the machine.
_SMALLEST, _PLENTY = 1 / 1100, 1 << 28

# What h5py was seen to raise on damaged files.
_H5PY_RAISES = (
    OSError, RuntimeError, KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, MemoryError,
    NotImplementedError, SystemError,
)  # fmt: skip


@contextmanager
def reading(where: str) -> Iterator[None]:
    """Turn errors of the block's HDF5 accesses into one OSError. Only such accesses belong in the block."""
    try:
        yield
    except _H5PY_RAISES as error:
        reason = " ".join(str(error).strip("'\"").split())[:200] or type(error).__name__
        raise OSError(f"{where} cannot be read ({reason}): the file is damaged, restore it") from None


def open_hdf5(path: str | Path) -> h5py.File:
    """Open a file for reading. Raises OSError, in one line, where it is no HDF5 file, empty or cut off."""
    path = Path(path)
    try:
        return h5py.File(path, "r")
    except _H5PY_RAISES as error:
        size, claimed = path.stat().st_size, _read_end_address(path)
        if size == 0:
            raise OSError(f"{path} is empty: copy or make it again") from None
        if claimed is None:
            raise OSError(f"{path} is not an HDF5 file: check that it is the right one") from None
        if size < claimed:
            raise OSError(f"{path} is cut off: {size} of {claimed} bytes are there; copy or make it again") from None
        raise OSError(f"{path} cannot be read as HDF5 ({_line(error)}): copy or make it again") from None


def _read_end_address(path: Path) -> int | None:
    """End-of-file address in the superblock; None without one."""
    with path.open("rb") as file:
        head = file.read(48)
    if head[:8] != b"\x89HDF\r\n\x1a\n":
        return None
    start = 28 if head[8:9] >= b"\2" else 40  # by the version of the superblock
    return int.from_bytes(head[start : start + 8], "little")


def contains(group: h5py.Group, name: str) -> bool:
    """True if a group has a member of that name."""
    with reading(name):
        return name in group


def child_names(group: h5py.Group, name: str) -> list[str]:
    """Names in a group, in order; empty if it is missing."""
    with reading(name):
        return list(group[name]) if name in group and isinstance(group[name], h5py.Group) else []


def find_kind(group: h5py.Group, name: str) -> type:
    """Kind of a member: h5py.Dataset, h5py.Group or h5py.Datatype."""
    with reading(name):
        return type(group[name])


def dataset(group: h5py.Group, name: str, *, axes: int | None = None, kinds: str = "fiu") -> h5py.Dataset:
    """Dataset of that name, not yet read. axes: their number; kinds: of NumPy's types that it may have."""
    with reading(name):
        node: Any = group.get(name)
        numeric = isinstance(node, h5py.Dataset) and node.shape is not None
        shape, dtype, size = (node.shape, node.dtype, node.nbytes) if numeric else ((), np.dtype(float), 0)
        stored = node.id.get_storage_size() if numeric else 0
    if node is None:
        raise ValueError(f"dataset {name!r} is missing: restore the file, or make it again")
    if not numeric:
        raise ValueError(f"{name} must be a dataset of numbers, got {type(node).__name__.lower()} without any")
    if dtype.kind not in kinds or (dtype.kind in "fc" and dtype.itemsize > 8):
        raise ValueError(f"{name} must hold {_KINDS.get(kinds, 'numbers')}, got {dtype} of shape {shape}")
    if axes is not None and len(shape) != axes:
        raise ValueError(f"{name} must have {axes} axes, got {dtype} of shape {shape}")
    if size > _PLENTY and size * _SMALLEST > stored:
        raise ValueError(f"{name} claims {size} bytes, but only {stored} are stored: the file is damaged, restore it")
    return node


def array(group: h5py.Group, name: str, *, axes: int | None = None, kinds: str = "fiu") -> np.ndarray:
    """All numbers of a dataset, which must pass `dataset`."""
    return rows(dataset(group, name, axes=axes, kinds=kinds), name, ...)


def rows(node: h5py.Dataset, name: str, where: Any) -> np.ndarray:
    """Part of a dataset, `node[where]`."""
    with reading(name):
        return np.asarray(node[where])


def text(group: h5py.Group, name: str) -> str:
    """Text of a dataset."""
    with reading(name):
        content = group[name][()]
        if isinstance(content, bytes):
            return content.decode("utf-8")
    if not isinstance(content, str):
        raise ValueError(f"{name} must hold a text, got {type(content).__name__}: the file is damaged, restore it")
    return content


def read_node_attributes(node: h5py.Group | h5py.Dataset, where: str) -> dict[str, Any]:
    """Attributes of a group or dataset: texts, numbers and arrays."""
    with reading(f"attributes of {where}"):
        return {name: value for name, value in node.attrs.items() if not isinstance(value, h5py.Empty)}


_KINDS = {"iu": "whole numbers", "f": "floating-point numbers", "fiu": "numbers"}


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]


@contextmanager
def hdf5_file(path: str | Path) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """Give the block a new HDF5 file, and a function that checks the disk.

    The function raises OSError once the disk has refused; it is called at the end, and may be called before to end long
    work early. Not atomic: see `toolkit.runtime.files.writing`.
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
    """File that keeps an error of writing until it is checked."""

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
