"""Files written whole and read with care: JSON, NumPy's and our own of named arrays. A file is written beside its place
under another name, synced to disk and renamed, so that no reader, kill or full disk ever meets half of one. A symbolic
link stays, its target is replaced. On failure nothing is left behind, and one OSError names file and reason. Damage met
in reading becomes one ValueError in one line."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import struct
import tempfile
import tokenize
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file. Raises OSError on failure."""
    with writing(path) as unfinished:
        unfinished.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole file of UTF-8 text, as `write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


@contextmanager
def writing(path: str | Path, unfinished: Path | None = None) -> Iterator[Path]:
    """Give the block a name, with the same ending and folder, to write a file under; rename it at the end. If the block
    raises, `path` stays as it was. Raises OSError, with file and reason in one line, where the disk is full or the
    folder cannot be written. unfinished: that name, if it matters, on the file system of `path`; none is made before
    the block."""
    target = Path(os.path.realpath(path))
    try:
        with _name_output(path):
            target.parent.mkdir(parents=True, exist_ok=True)
            if unfinished is None:
                ending = f".unfinished{target.suffix}"
                number, name = tempfile.mkstemp(ending, f".{target.name[:100]}.", target.parent)
                os.close(number)
                unfinished = Path(name)
            yield unfinished
            with unfinished.open("rb") as file:
                os.fsync(file.fileno())
            unfinished.chmod(_mode(target))
            unfinished.replace(target)
    finally:
        if unfinished is not None:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)


@contextmanager
def writing_together(folder: str | Path) -> Iterator[Path]:
    """Give the block a folder; move its files into `folder`, made if missing, at the end. If the block raises, nothing
    moves. Raises OSError as `writing`."""
    target = Path(os.path.realpath(folder))
    missing = [each for each in (target, *target.parents) if not each.exists()]
    unfinished = None
    try:
        with _name_output(folder):
            target.mkdir(parents=True, exist_ok=True)
            unfinished = Path(tempfile.mkdtemp(".unfinished", ".", target))
            yield unfinished
            for each in unfinished.iterdir():
                place = Path(os.path.realpath(target / each.name))
                each.chmod(_mode(place))
                each.replace(place)
    finally:
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
        for each in missing:  # those that are empty are what nothing came of
            with suppress(OSError):
                each.rmdir()


@contextmanager
def _name_output(path: str | Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        reason = f"cannot write {path}: {os.strerror(error.errno)}; make room, or give another path"
        explained = type(OSError(error.errno, ""))(reason)
        explained.errno = error.errno
        raise explained from error


def reserve(path: Path, size: int) -> None:
    """Raise OSError if a file of `size` bytes has no room. For libraries that do not tell; `path` is left empty."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate") and size:
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(0)


def check_output(out: str | Path, *, inputs: Iterable[str | Path] = (), overwrite: bool = False) -> None:
    """Check that a command may write to `out`. Raises ValueError where `out` is one of the inputs, under whatever name
    or link; FileExistsError where it exists (a folder: is not empty) without `overwrite`."""
    out = Path(out)
    for each in map(Path, inputs):
        same = out.samefile(each) if out.exists() and each.exists() else False
        if same or os.path.realpath(out) == os.path.realpath(each):
            raise ValueError(f"{out} is what is read: write to another file, it would be lost")
    there = any(out.iterdir()) if out.is_dir() else out.exists()
    if there and not overwrite:
        raise FileExistsError(f"{out} exists: write to another file, or replace it with --overwrite")


def _mode(target: Path) -> int:
    """Permissions of a replaced file, else rw-rw-rw- less the mask."""
    if target.exists():
        return target.stat().st_mode & 0o7777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


def parse_json(text: str) -> Any:
    """Parse a JSON text. Raises ValueError, in one line, for damaged or too deeply nested text.

    >>> parse_json("[" * 100000)
    Traceback (most recent call last):
    ValueError: its lists or objects are nested too deep to be read: restore the file
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        reason = f"not JSON from line {error.lineno} on ({error.msg})"
    except RecursionError:
        reason = "its lists or objects are nested too deep to be read"
    except ValueError:  # Python refuses to turn very long texts into numbers
        reason = "it has a number of thousands of digits"
    raise ValueError(f"{reason}: restore the file")


@contextmanager
def name_errors(where: str | Path) -> Iterator[None]:
    """Put a file or field before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def read_json(path: str | Path) -> Any:
    """Read a JSON file in UTF-8. Raises OSError; ValueError, in one line, for a damaged file."""
    with name_errors(path):
        try:
            return parse_json(Path(path).read_text(encoding="utf-8-sig"))
        except UnicodeDecodeError as error:
            raise ValueError(f"not a text file (byte {error.start} is not UTF-8): give a JSON file") from None


def replace_infinite(value: Any) -> Any:
    """Replace numbers that JSON lacks by null, such as an infinite bound or the AP without objects.

    >>> replace_infinite({"bound": float("inf"), "ap": (0.5, float("nan"))})
    {'bound': None, 'ap': [0.5, None]}
    """
    if isinstance(value, dict):
        return {key: replace_infinite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [replace_infinite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


_CHECKSUM = 32  # bytes of SHA-256 over all that comes before, at the end of the file, where NumPy overlooks them


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a .npz file with a checksum, replacing an old one. A process killed while writing leaves the old one."""
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # its other keyword is not among them
    write_bytes(path, content.getvalue() + sha256(content.getvalue()).digest())


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read the arrays of a file of `write_arrays`. Raises FileNotFoundError; ValueError for a damaged or other file."""
    content = Path(path).read_bytes()
    content, checksum = content[:-_CHECKSUM], content[-_CHECKSUM:]
    if sha256(content).digest() != checksum:
        raise ValueError(f"{path} does not fit its checksum: it is damaged or not a coview file, make it again")
    try:
        with np.load(BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file}
    except (ValueError, OSError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path} holds no plain arrays ({error}): make it again") from None


_DAMAGE = (  # what np.load was seen to raise on damaged files: from the zip archive, the header's text, its shape
    *(OSError, ValueError, EOFError, LookupError, TypeError, OverflowError, MemoryError, RuntimeError, SyntaxError),
    *(AttributeError, BadZipFile, zlib.error, struct.error, tokenize.TokenError),
)


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Load the arrays of a .npz file by name, that of a .npy file as "". Raises ValueError, in one line."""
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"": loaded}
        with loaded as file:
            return {name: file[name] for name in file.files}
    except _DAMAGE as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise ValueError(f"{path} cannot be read as .npy array or .npz archive: {reason}") from None
