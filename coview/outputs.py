"""Output of commands: shared options, and checks of paths before long work."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from toolkit.runtime.files import check_output


@dataclass(frozen=True, kw_only=True)
class Writing:
    """Handling of results."""

    overwrite: bool = False
    """Replace existing files."""
    json: bool = False
    """Print the results as JSON."""


def check_file(out: Path | None, *, inputs: Iterable[Path] = (), overwrite: bool = False) -> None:
    """Check that a command may write a file, if any.

    Raises ValueError if `out` is an input, OSError if it cannot be written or exists without `overwrite`.
    """
    if out is not None:
        check_output(out, inputs=inputs, overwrite=overwrite)
        if out.is_dir():
            raise IsADirectoryError(f"{out} is a folder: give the name of a file in it")
        check_writable(out.resolve().parent, out)


def check_folder(out: Path, *, holds: str, inputs: Iterable[Path] = (), overwrite: bool = False) -> None:
    """Check that a command may write the file `holds` into a folder, new or old."""
    inputs = list(inputs)
    check_output(out, inputs=inputs, overwrite=True)
    check_file(out / holds, inputs=inputs, overwrite=overwrite)


def check_new_folder(out: Path, *, inputs: Iterable[Path] = (), overwrite: bool = False) -> None:
    """Check that a folder to fill is empty, new, or to be overwritten."""
    check_output(out, inputs=inputs, overwrite=overwrite)
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out} is a file: give the name of a folder")
    check_writable(out.resolve(), out)


def check_writable(folder: Path, out: Path) -> None:
    """Raise OSError if the folder of `out` cannot be made or written."""
    there = next(each for each in (folder, *folder.parents) if each.exists())
    if not there.is_dir():
        raise NotADirectoryError(f"cannot write {out}: {there} is no folder; give another path")
    if not os.access(there, os.W_OK | os.X_OK):
        raise PermissionError(f"cannot write {out}: {there} may not be written; give another path")
