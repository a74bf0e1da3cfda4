"""Files that are whole or not there: the one writer of the house, and what a command may write where.

A file is written beside its place under another name, brought to the disk and renamed, so that a reader, a kill or a
full disk never meets half of one. Where the place is a symbolic link, what it points to is replaced. Folders that are
missing are made. Whatever goes wrong, nothing is left behind, and one OSError names the file and the reason.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file, in place of one that was there. Raises OSError where that is impossible."""
    with writing(path) as unfinished:
        unfinished.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole file of UTF-8 text, as `write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


@contextmanager
def writing(path: str | Path, unfinished: Path | None = None) -> Iterator[Path]:
    """The name under which the block shall write a file (same ending, same folder); at its end it gets its own name.

    For libraries that write files themselves. Where the block raises, `path` stays what it was. Raises OSError, with
    file and reason in one line, where the disk is full or the folder cannot be written.

    unfinished: that name, if it matters, on the same file system as `path`; none is made before the block.
    """
    target = Path(os.path.realpath(path))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        unfinished = unfinished or _beside(target)
        yield unfinished
        with unfinished.open("rb") as file:
            os.fsync(file.fileno())
        unfinished.chmod(_mode(target))
        unfinished.replace(target)
    except (OSError, RuntimeError) as error:  # h5py raises both
        reason = reason_of(error)
        if reason is None:
            raise
        raise _explained(path, reason) from error
    finally:
        if unfinished is not None:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)


@contextmanager
def writing_together(folder: str | Path) -> Iterator[Path]:
    """A folder to write files in, which at the end of the block all get into `folder`, made if missing.

    Where the block raises, none does, and `folder` stays what it was. Raises OSError as `writing`.
    """
    target = Path(os.path.realpath(folder))
    missing = [each for each in (target, *target.parents) if not each.exists()]
    unfinished = None
    try:
        target.mkdir(parents=True, exist_ok=True)
        unfinished = Path(tempfile.mkdtemp(".unfinished", ".", target))
        yield unfinished
        for each in unfinished.iterdir():
            place = Path(os.path.realpath(target / each.name))
            each.chmod(_mode(place))
            each.replace(place)
    except OSError as error:
        reason = reason_of(error)
        if reason is None:
            raise
        raise _explained(folder, reason) from error
    finally:
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
        for each in missing:  # those that are empty are what nothing came of
            with suppress(OSError):
                each.rmdir()


def reserve(path: Path, size: int) -> None:
    """Raise OSError where a file of so many bytes has no room, for libraries that do not tell; `path` is left empty."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate") and size:
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(0)


def check_output(out: str | Path, *, inputs: Iterable[str | Path] = (), overwrite: bool = False) -> None:
    """Whether a command may write to `out`: not where one of its inputs is, nor, unless told, where anything is.

    Raises ValueError where `out` is one of the inputs, under whatever name or link; FileExistsError where it is there
    (a folder: where it is not empty) and `overwrite` is not set.
    """
    out = Path(out)
    for each in inputs:
        if _same(out, Path(each)):
            raise ValueError(f"{out} is what is read: write to another file, it would be lost")
    there = any(out.iterdir()) if out.is_dir() else out.exists()
    if there and not overwrite:
        raise FileExistsError(f"{out} exists: write to another file, or replace it with --overwrite")


def _beside(target: Path) -> Path:
    """A new empty file in the folder of another, of its kind, hidden, and of a name of its own."""
    number, name = tempfile.mkstemp(f".unfinished{target.suffix}", f".{target.name[:100]}.", target.parent)
    os.close(number)
    return Path(name)


def _same(a: Path, b: Path) -> bool:
    with suppress(OSError):
        return a.samefile(b)
    return os.path.realpath(a) == os.path.realpath(b)


def _mode(target: Path) -> int:
    """Permissions of what is replaced, else what the process's mask leaves of rw-rw-rw-."""
    if target.exists():
        return target.stat().st_mode & 0o7777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def reason_of(error: BaseException) -> int | None:
    """The error number of a file system that refused, also where HDF5 hides it in a message; None for other errors."""
    number = getattr(error, "errno", None)
    if number is None and (found := re.search(r"errno = (\d+)", str(error))):
        number = int(found[1])
    return number


def _explained(path: str | Path, number: int) -> OSError:
    kind = type(OSError(number, ""))
    explained = kind(f"cannot write {path}: {os.strerror(number)}; make room, or give another path")
    explained.errno = number
    return explained
