"""Output of commands: exit codes, results and errors, and checks of paths before long work."""

import json
import os
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from toolkit.runtime import output_checks
from toolkit.runtime.output_checks import check_output
from toolkit.runtime.parallel import WorkLost
from toolkit.runtime.resumable import ShardFolder
from toolkit.runtime.text_tables import escape
from toolkit.runtime.text_values import read_json, replace_infinite
from toolkit.runtime.writing import UNFINISHED

# exit codes
OK = 0
SUSPECTED = 1
BAD_INPUT = 2
MISSING = 3
PIPE_LOST = 4
INTERNAL = 70
INTERRUPTED = 130
PIPE_CLOSED = 141
NOT_MET = SUSPECTED  # a plan's requirement cannot be met; "no", like the doctor's suspicion
SITE_KIND = "a site's file"
PLAN_KIND = "a plan"
CARD_KIND = "the card of a network"
FILE_KINDS = {  # files that take long to make again, by a key that no other has
    "map_SE3_site": SITE_KIND,
    "coview_plan": PLAN_KIND,
    "coview_live": "a project of coview live",
    "decoded": CARD_KIND,
}
MAX_JSON_BYTES = 100_000_000  # larger files are of no kind
OURS = ("coview", "examples", "placement_env", "models", "toolkit")
REPORT = "this is a fault of coview, not of what you gave it: please report it with the lines above"


@dataclass(frozen=True, kw_only=True)
class Writing:
    """Handling of results."""

    overwrite: bool = False
    """Replace existing files."""
    json: bool = False
    """Print the results as JSON."""


def say(text: object, *, error: bool = False) -> None:
    """Print text, on stderr for an error.

    All that commands print goes through this function or through `escape`."""
    print(escape(text), file=sys.stderr if error else sys.stdout, flush=error)


def print_result(result: object, text: str, *, as_json: bool) -> None:
    """Print the text, or the result as one line of JSON with null for infinite numbers and NaN."""
    say(json.dumps(replace_infinite(result), allow_nan=False) if as_json else text)


def check_file(
    out: Path | None, *, inputs: Iterable[Path] = (), overwrite: bool = False, kind: str = ""
) -> None:
    """Check that a command may write a file.

    out: the file, None for no check; inputs: files that the command reads; overwrite: True to
    replace the file; kind: kind of the file among `FILE_KINDS`, "" for other files. Raises
    ValueError if `out` is an input or of a kind that the command does not write, even with
    `overwrite`. Raises OSError if it cannot be written, or exists without `overwrite`."""
    if out is not None:
        # only whether it is an input; whether it exists is checked after its kind, since nobody
        # should be told to --overwrite a file of another kind
        check_output(out, inputs=inputs, overwrite=True)
        found_kind = find_kind(out)
        if found_kind not in ("", kind):
            raise ValueError(
                f"{out} is {found_kind}, which this command does not write: give another name"
            )
        check_output(out, overwrite=overwrite)
        if out.is_dir():
            raise IsADirectoryError(f"{out} is a folder: give the name of a file in it")
        check_writable(out.resolve().parent, out)


def find_kind(path: Path) -> str:
    """Return the kind of a file among `FILE_KINDS`, "" for other and missing files."""
    if path.suffix.lower() not in (".json", ".geojson") or not path.is_file():
        return ""
    if path.stat().st_size > MAX_JSON_BYTES:
        return ""
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return ""
    keys = content.keys() if isinstance(content, dict) else ()
    return next((kind for key, kind in FILE_KINDS.items() if key in keys), "")


def check_folder(
    out: Path,
    *,
    holds: str,
    inputs: Iterable[Path] = (),
    overwrite: bool = False,
    writes: Collection[str] = (),
    kind: str = "",
) -> None:
    """Check that a command may write the file `holds` into a new or existing folder.

    Args:
        out: The folder.
        holds: Name of the command's main file.
        inputs: Files that the command reads.
        overwrite: True to replace the main file.
        writes: Names of the command's other files.
        kind: Kind of the main file among `FILE_KINDS`, "" for other files.

    Raises:
        ValueError: For a file that is an input, and for a file of `writes` without the main file
            next to it, which another command wrote.
        OSError: If the main file exists without `overwrite`, or cannot be written.
    """
    inputs = list(inputs)
    check_output(out, inputs=inputs, overwrite=True)
    for name in writes:
        check_output(out / name, inputs=inputs, overwrite=True)
    foreign = [name for name in sorted(writes) if name != holds and (out / name).exists()]
    if foreign and not (out / holds).exists():
        raise ValueError(
            f"{out} holds {foreign[0]}, which this command did not write, as there is no {holds}: "
            "give another folder, or it would be lost"
        )
    check_file(out / holds, inputs=inputs, overwrite=overwrite, kind=kind)


def check_empty_folder(out: Path, *, inputs: Iterable[Path] = (), overwrite: bool = False) -> None:
    """Check that a folder is empty or new, or that coview wrote it and may overwrite it.

    inputs: files that the command reads, which must not be in it; overwrite: True to replace a
    folder that coview wrote. Raises OSError or ValueError otherwise."""
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out} is a file: give the name of a folder")
    output_checks.check_new_folder(out, inputs=inputs, overwrite=overwrite)
    check_writable(out.resolve(), out)


@contextmanager
def claim(
    out: Path, settings: object, check: Callable[..., None], *, overwrite: bool = False
) -> Iterator[bool]:
    """Check `out` by `check(overwrite=...)`, and lock it until the block ends.

    A killed run leaves a note of its settings. A run with the same settings may replace what that
    run wrote without `overwrite`. Yields True if the block may overwrite.

    settings: all that the output depends on, compared by its repr; check: raises OSError or
    ValueError if `out` may not be written."""
    check(overwrite=True)
    target = out.resolve()
    # the note is next to `out`, or in it if the folder around it cannot be written
    is_sibling = not target.is_dir() or os.access(target.parent, os.W_OK)
    path = target.with_name(f"{target.name}{UNFINISHED}") if is_sibling else target / UNFINISHED
    note = ShardFolder(path, {"asked": repr(settings)})
    may_overwrite = overwrite or note.found == note.plan
    check(overwrite=may_overwrite)
    with note.lock():
        check(overwrite=may_overwrite)  # another run may have ended in between
        note.open(overwrite=True)
        try:
            yield may_overwrite
        except BaseException:
            with suppress(FileExistsError):  # after files were written, the note stays to resume
                check(overwrite=False)
                note.remove()
            raise
        note.remove()


def check_writable(folder: Path, out: Path) -> None:
    """Raise OSError if a folder, which may not exist yet, cannot be written.

    out: file or folder to write, for the error."""
    existing = next(parent for parent in (folder, *folder.parents) if parent.exists())
    if not existing.is_dir():
        raise NotADirectoryError(f"cannot write {out}: {existing} is no folder; give another path")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise PermissionError(
            f"cannot write {out}: {existing} may not be written; give another path"
        )


def report(error: BaseException, *, debug: bool = False) -> int:
    """Print an error on stderr and return its exit code.

    debug: print the traceback of any error."""
    if isinstance(error, BrokenPipeError):
        _silence(sys.stdout)
        return PIPE_CLOSED
    code, message = _classify(error)
    try:
        if debug or code == INTERNAL:
            say("".join(traceback.format_exception(error)).rstrip(), error=True)
        say(f"coview: {' '.join(message.split())}", error=True)
    except OSError:  # nobody reads it, or the disk is full
        _silence(sys.stderr)
    return code


def _silence(stream: TextIO) -> None:
    """Discard further output of a stream."""
    with suppress(OSError, ValueError):  # it may be no real file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _classify(error: BaseException) -> tuple[int, str]:
    """Exit code of an error, and the text that the user reads."""
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, "stopped, nothing is left half written; start the same command again"
    if isinstance(error, WorkLost):
        return PIPE_LOST, str(error)
    # a package of others is missing; a missing module of ours is a fault of the program
    if isinstance(error, ImportError) and (error.name or "").partition(".")[0] not in OURS:
        return MISSING, str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        # the text leaves out the error's number
        return (
            BAD_INPUT,
            f"cannot use {error.filename}: {error.strerror}; give another path, or make this one "
            "readable and writable",
        )
    if isinstance(error, OSError | ValueError):
        return BAD_INPUT, str(error)
    return INTERNAL, REPORT
