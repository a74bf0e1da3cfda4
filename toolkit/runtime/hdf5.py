"""HDF5 files read and written with care.

Damage makes h5py raise errors of many kinds from any access, even from `in`. Every access here is
in a block of `reading`, which turns them into one OSError that names the member. HDF5 ends the
process when it cannot write a file to its end: `hdf5_file` therefore writes through a file object
that keeps the first error and ignores all later writes."""

import io
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import EllipsisType
from typing import Any, Literal

import h5py
import numpy as np

from toolkit.runtime.reading import plain_file

_MIN_DEFLATED_SHARE = 1 / 1100  # share of its size to which Deflate can reduce a dataset
_MANY_BYTES = 1 << 28  # a larger dataset that seems deflated further is damaged: do not read it
_KINDS = {"iu": "whole numbers", "f": "floating-point numbers", "fiu": "numbers"}
_DAMAGE = (  # errors that h5py was seen to raise on damaged files
    *(OSError, RuntimeError, LookupError, TypeError, ValueError),
    *(AttributeError, OverflowError, MemoryError, SystemError),
)
_Place = int | slice | EllipsisType | tuple[int, ...]


@contextmanager
def reading(where: str) -> Iterator[None]:
    """Turn errors of the block's HDF5 accesses into one OSError.

    Only such accesses belong in the block. where: what is read, the beginning of the message."""
    try:
        yield
    except _DAMAGE as error:
        reason = " ".join(str(error).strip("'\"").split())[:200] or type(error).__name__
        raise OSError(
            f"{where} cannot be read ({reason}): the file is damaged, restore it"
        ) from None


def open_hdf5(path: str | Path) -> h5py.File:
    """Open a file for reading.

    Raises OSError, in one line, if it is no HDF5 file, empty or cut off."""
    path = plain_file(path)
    try:
        return h5py.File(path, "r")
    except _DAMAGE as error:
        size = path.stat().st_size
        with path.open("rb") as file:
            # the signature, then the superblock with its version
            head = file.read(52)
        # byte of the end-of-file address
        start = {b"\0": 40, b"\1": 44}.get(head[8:9], 28)
        claimed_bytes = int.from_bytes(head[start : start + 8], "little")
        if size == 0:
            reason = "is empty: copy or make it again"
        elif head[:8] != b"\x89HDF\r\n\x1a\n":
            reason = "is not an HDF5 file: check that it is the right one"
        elif size < claimed_bytes:
            reason = f"is cut off: {size} of {claimed_bytes} bytes are there; copy or make it again"
        else:
            reason = (
                f"cannot be read as HDF5 ({' '.join(str(error).split())[:200]}): copy or make it "
                "again"
            )
        raise OSError(f"{path} {reason}") from None


def find_kinds(group: h5py.Group, names: Iterable[str]) -> dict[str, type]:
    """Kinds (h5py.Dataset, h5py.Group or h5py.Datatype) of the members that exist."""
    kinds: dict[str, type] = {}
    for name in names:
        node = _own(group, name)
        kinds |= {} if node is None else {name: type(node)}
    return kinds


def _own(group: h5py.Group, name: str) -> Any:
    """Member of a group, None if missing; a name that begins with / counts from the file's root.

    Raises ValueError for a link, and for a member that is stored in another file, which is not even
    opened."""
    node = group.file["/"] if name.startswith("/") else group
    path = ""
    fault = ""  # raised below, since `reading` turns errors in its block into others
    for step in filter(None, name.split("/")):
        path = f"{path}/{step}".lstrip("/")
        with reading(path):
            if not isinstance(node, h5py.Group) or not node.id.links.exists(step.encode()):
                return None
            if node.id.links.get_info(step.encode()).type != h5py.h5l.TYPE_HARD:
                fault = "is a link"
                break
            node = node[step]
            if isinstance(node, h5py.Dataset) and (node.is_virtual or node.external):
                fault = "has its numbers in another file"
                break
    if fault:
        raise ValueError(
            f"{path} {fault}, which is not followed: store what belongs there in this file"
        )
    return node


def contains(group: h5py.Group, name: str) -> bool:
    """Return True if a group has a member with this name."""
    return bool(find_kinds(group, [name]))


def child_names(group: h5py.Group, name: str) -> list[str]:
    """Names in a group, in order; empty if it is missing."""
    node = _own(group, name)
    with reading(name):
        return list(node) if isinstance(node, h5py.Group) else []


def dataset(
    group: h5py.Group, name: str, *, axes: int | None = None, kinds: str = "fiu"
) -> h5py.Dataset:
    """Dataset of numbers with this name in a group, not yet read.

    axes: number of its axes, None for any; kinds: letters of the NumPy types it may have, such as
    "f" for floats. Raises ValueError for a missing or another dataset."""
    node = _own(group, name)
    with reading(name):
        is_numeric = isinstance(node, h5py.Dataset) and node.shape is not None
        shape = node.shape if is_numeric else ()
        dtype = node.dtype if is_numeric else np.dtype(float)
        size = node.nbytes if is_numeric else 0
        stored_bytes = node.id.get_storage_size() if is_numeric else 0
    if node is None:
        raise ValueError(f"dataset {name!r} is missing: restore the file, or make it again")
    if not is_numeric:
        raise ValueError(
            f"{name} must be a dataset of numbers, got {type(node).__name__.lower()} without any"
        )
    if dtype.kind not in kinds or (dtype.kind in "fc" and dtype.itemsize > 8):
        raise ValueError(
            f"{name} must hold {_KINDS.get(kinds, 'numbers')}, got {dtype} of shape {shape}"
        )
    if axes is not None and len(shape) != axes:
        raise ValueError(f"{name} must have {axes} axes, got {dtype} of shape {shape}")
    # compression cannot shrink data so far: the stored part is missing
    if size > _MANY_BYTES and size * _MIN_DEFLATED_SHARE > stored_bytes:
        raise ValueError(
            f"{name} claims {size} bytes, but only {stored_bytes} are stored: the file is damaged, "
            "restore it"
        )
    return node


def array(
    group: h5py.Group, name: str, *, axes: int | None = None, kinds: str = "fiu"
) -> np.ndarray:
    """All numbers of a dataset, which must pass `dataset` with this number of axes and kinds."""
    return rows(dataset(group, name, axes=axes, kinds=kinds), name, ...)


def find_array(
    group: h5py.Group, name: str, *, axes: int | None = None, kinds: str = "fiu"
) -> np.ndarray | None:
    """Return `array`, or None if there is no such member."""
    return array(group, name, axes=axes, kinds=kinds) if contains(group, name) else None


def rows(node: h5py.Dataset, name: str, where: _Place) -> np.ndarray:
    """Part of a dataset, `node[where]`. name: for the OSError if it cannot be read."""
    with reading(name):
        return np.asarray(node[where])


def text(group: h5py.Group, name: str) -> str:
    """Text of the dataset with this name in a group. Raises ValueError for another content."""
    node = _own(group, name)
    with reading(name):
        # without a node, group[name] raises the error of h5py for a missing name
        content = (group[name] if node is None else node)[()]
        if isinstance(content, bytes):
            return content.decode("utf-8")
    if not isinstance(content, str):
        raise ValueError(
            f"{name} must hold a text, got {type(content).__name__}: the file is damaged, restore "
            "it"
        )
    return content


def read_node_attributes(node: h5py.Group | h5py.Dataset, where: str) -> dict[str, Any]:
    """Attributes of a group or dataset: texts, numbers and arrays."""
    with reading(f"attributes of {where}"):
        return {
            name: value for name, value in node.attrs.items() if not isinstance(value, h5py.Empty)
        }


@contextmanager
def hdf5_file(
    path: str | Path, mode: Literal["w", "r+"] = "w"
) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """Give the block an HDF5 file to write, and a function that raises OSError once the disk
    failed.

    mode: "w" for a new file, "r+" to change one. The function is called at the end, and may be
    called before. Not atomic: see
    `toolkit.runtime.writing.writing`."""
    with _Disk(path, "w+" if mode == "w" else "r+") as disk:
        try:
            with h5py.File(disk, mode) as file:
                yield file, disk.check
        except Exception:
            disk.check()  # what HDF5 says of a file that is not as it wrote it matters less
            raise
        disk.check()


class _Disk(io.FileIO):
    """File that keeps the first error of writing until it is checked, and then writes no more."""

    error: OSError | None = None

    def check(self) -> None:
        """Raise the error that was kept."""
        if self.error is not None:
            raise self.error

    def write(self, content: Any) -> int:
        """Write the content, and return its size also if that failed."""
        remaining = memoryview(content).cast("B")
        size = len(remaining)
        try:
            while len(remaining) and self.error is None:
                remaining = remaining[super().write(remaining) :]
        except OSError as error:
            self.error = error
        self.seek(len(remaining), os.SEEK_CUR)  # where HDF5 expects the file to be
        return size

    def truncate(self, size: int | None = None) -> int:
        """Cut the file to a size, and remember the first error, as HDF5 does not report it."""
        try:
            super().truncate(size)
        except OSError as error:
            self.error = self.error or error
        return self.tell() if size is None else size
