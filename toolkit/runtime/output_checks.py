"""Checks of a command's output paths, before its work begins."""

import os
from collections.abc import Iterable
from pathlib import Path

from toolkit.runtime.writing import UNFINISHED, WRITTEN


def check_output(
    out: str | Path, *, inputs: Iterable[str | Path] = (), overwrite: bool = False
) -> None:
    """Check that a command may write to `out`.

    Raises ValueError if `out` is one of the inputs, or inside one, under any name or link;
    FileExistsError if it exists (a folder: is not empty) without `overwrite`."""
    out = Path(out)
    target = Path(os.path.realpath(out))
    for source in inputs:
        read_path = Path(os.path.realpath(source))
        above = (target, *target.parents)
        if any(parent == read_path or _same(parent, read_path) for parent in above):
            is_same = target == read_path or _same(target, read_path)
            relation = "is what is read" if is_same else f"is inside {source}, which is read"
            raise ValueError(f"{out} {relation}: write to another place, so that nothing is lost")
    is_occupied = out.exists()
    if out.is_dir():
        is_occupied = any(UNFINISHED not in entry.name for entry in out.iterdir())
    if is_occupied and not overwrite:
        raise FileExistsError(
            f"{out} exists: write to another file, or replace it with --overwrite"
        )


def _same(first: Path, second: Path) -> bool:
    return first.exists() and second.exists() and first.samefile(second)


def check_new_folder(
    out: str | Path, *, inputs: Iterable[str | Path] = (), overwrite: bool = False
) -> None:
    """Check that `writing_folder` may write `out`.

    Raises ValueError if `out` is one of the inputs, or inside one, or if files would be lost that
    `writing_folder` has not written, or that are inputs; FileExistsError if it is a folder that is
    not empty, without `overwrite`."""
    out = Path(out)
    inputs = list(inputs)
    note = out / WRITTEN
    is_unfinished = note.is_file() and note.read_text() == UNFINISHED
    check_output(out, inputs=inputs, overwrite=overwrite or is_unfinished)
    if out.is_dir() and any(UNFINISHED not in entry.name for entry in out.iterdir()):
        target = Path(os.path.realpath(out))
        for source in inputs:
            if target in Path(os.path.realpath(source)).parents:
                raise ValueError(
                    f"{out} holds {source}, which is read: write to another folder, it would be "
                    "lost"
                )
        if not note.is_file():
            remedy = "write to another folder, or empty it if an earlier coview wrote them"
            raise ValueError(f"{out} holds files that coview did not write there: {remedy}")
