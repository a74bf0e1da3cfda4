"""Files and folders written whole.

A file is written in its folder under another name, synced to disk and renamed, so that no reader,
kill or full disk ever meets half a file. A symbolic link stays, its target is replaced. On failure
no file is left behind, and one OSError names file and reason. The file that a killed process leaves
is named `.NAME.0.unfinished`; the next process that writes NAME takes it over. A writer locks it,
so that no other process takes it over."""

import errno
import os
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a Unix
    fcntl = None  # type: ignore[assignment]

UNFINISHED = ".unfinished"  # in the names of files that are, or were, being written
WRITTEN = ".coview"  # file in folders that are ours to replace
MAX_ATTEMPTS = 100  # at a file that other processes remove again and again
_held_paths: set[Path] = set()  # unfinished files that blocks of this process write
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file. Raises OSError on failure."""
    with writing(path) as unfinished:
        unfinished.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole file of UTF-8 text. Raises OSError on failure."""
    write_bytes(path, text.encode("utf-8"))


@contextmanager
def writing(path: str | Path, unfinished: Path | None = None) -> Iterator[Path]:
    """Give the block a temporary path to write a file to, and rename the file at the end.

    The path has the same ending and folder. If the block raises, `path` stays as it was. Raises
    OSError, with file and reason in one line, if the disk is full or the folder cannot be written.
    unfinished: the temporary path, if it matters, on the file system of `path`; no file is made
    before the block. A temporary path of another block is given back as it is: to rename another
    file to it would take its lock away."""
    target = Path(os.path.realpath(path))
    if target in _held_paths:
        with _name_output(path):
            yield target
        return
    descriptor = None
    held_path = None
    try:
        with _name_output(path):
            target.parent.mkdir(parents=True, exist_ok=True)
            if unfinished is None:
                unfinished, descriptor = _take_unfinished(
                    target.parent, f".{target.name[:100]}", target.suffix
                )
            held_path = unfinished
            _held_paths.add(held_path)
            yield unfinished
            with unfinished.open("rb") as file:
                os.fsync(file.fileno())
            unfinished.chmod(_mode(target))
            unfinished.replace(target)
            unfinished = None  # another writer may take the name from now on
    finally:
        if held_path is not None:
            _held_paths.discard(held_path)
        if unfinished is not None:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
        if descriptor is not None:
            os.close(descriptor)


@contextmanager
def writing_together(folder: str | Path) -> Iterator[Path]:
    """Give the block a folder, and move its files into `folder` at the end.

    `folder` is made if missing. If the block raises, nothing moves. Raises OSError, with file and
    reason in one line, if the disk is full or the folder cannot be written."""
    with (
        _name_output(folder),
        _aside(Path(os.path.realpath(folder)), inside=True) as (target, unfinished),
    ):
        yield unfinished
        for file in sorted(unfinished.iterdir()):
            destination = Path(os.path.realpath(target / file.name))
            file.chmod(_mode(destination))
            file.replace(destination)


@contextmanager
def writing_folder(folder: str | Path) -> Iterator[Path]:
    """Give the block a folder that replaces `folder` at the end.

    Call `check_new_folder` first, which refuses a folder that may not be replaced. If the block
    raises, `folder` stays as it was. Raises OSError, with file and reason in one line, if the disk
    is full or the folder cannot be written, and while another process writes it."""
    target = Path(os.path.realpath(folder))
    try:
        with _aside(target, inside=target.exists()) as (_, unfinished):
            # names are numbered from 0; a living process holds the one with 0
            if not unfinished.name.endswith(f".0{UNFINISHED}"):
                raise FileExistsError(
                    f"another run is writing to {folder}: wait for it, or stop it"
                )
            yield unfinished
            (unfinished / WRITTEN).touch()
            # the folder stays, as it may be mounted, or somebody may work in it
            if unfinished.parent == target:
                _replace_content(target, unfinished)
            else:
                unfinished.chmod(0o777 & ~_mask())
                unfinished.rename(target)
    except OSError as error:
        if error.errno not in DISK_ERRORS:  # such as of the recording that the block reads
            raise
        with _name_output(folder):
            raise


def _replace_content(target: Path, unfinished: Path) -> None:
    """Move the content of `unfinished`, a folder inside `target`, in place of the rest of `target`.

    The mark `WRITTEN` is moved last, so that a killed run leaves no folder that looks whole."""
    write_text(target / WRITTEN, UNFINISHED)  # until the end, so that a killed run is known
    with _aside(target, inside=True) as (_, old):
        for entry in target.iterdir():
            if entry not in (old, unfinished, target / WRITTEN):
                entry.rename(old / entry.name)
        for entry in sorted(unfinished.iterdir(), key=lambda entry: entry.name == WRITTEN):
            entry.replace(target / entry.name)


@contextmanager
def _aside(target: Path, *, inside: bool) -> Iterator[tuple[Path, Path]]:
    """Give the block `target` and an empty folder that is removed at the end.

    The empty folder is inside `target` or next to it."""
    parent = target if inside else target.parent
    missing_folders = [path for path in (parent, *parent.parents) if not path.exists()]
    unfinished = descriptor = None
    try:
        unfinished, descriptor = _take_unfinished(
            parent, "" if inside else f".{target.name[:100]}", suffix=None
        )
        yield target, unfinished
    finally:
        if unfinished is not None and descriptor is not None:
            # the block may have renamed it, and another writer may have taken the name
            if _is_at(descriptor, unfinished):
                shutil.rmtree(unfinished, ignore_errors=True)
            os.close(descriptor)
        for path in missing_folders:  # made above; they are removed if they stayed empty
            with suppress(OSError):
                path.rmdir()


def _take_unfinished(folder: Path, start: str, suffix: str | None) -> tuple[Path, int]:
    """Make and lock an empty file, or folder (suffix None), or take over one of a killed writer.

    folder: where it is made; start, suffix: beginning and ending of its name. Returns its path, and
    the file descriptor that holds the lock."""
    for number in range(1000):
        path = folder / f"{start}.{number}{UNFINISHED}{suffix or ''}"
        existed = path.exists()
        try:
            # on systems without locks, an entry that existed may be another writer's, so only one
            # that is new is opened
            descriptor = take(path, folder=suffix is None, unlocked=not existed)
        except PermissionError:
            if not existed:
                raise
            continue  # another user's
        if descriptor is None:  # another writer holds it
            continue
        if suffix is not None:
            os.truncate(path, 0)
        elif left_entries := list(path.iterdir()):
            warnings.warn(
                f"{path}, which a killed run left, is removed and begun anew", stacklevel=2
            )
            for entry in left_entries:
                if entry.is_dir() and not entry.is_symlink():
                    shutil.rmtree(entry)
                else:
                    entry.unlink()
        return path, descriptor
    raise FileExistsError(f"{folder} is full of files {start}.N{UNFINISHED}: remove them")


def take(path: Path, *, folder: bool = False, unlocked: bool = True) -> int | None:
    """Open a file or folder, made with its parents if missing, and lock it until it is closed.

    Returns the file descriptor that holds the lock, None if another process holds it. unlocked:
    also open it on systems without locks."""
    attempts = 0
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        attempts += 1
        try:
            descriptor = _open_folder(path) if folder else _open_file(path)
        except FileNotFoundError:
            if attempts == MAX_ATTEMPTS:
                raise  # no file can be made there, such as in /proc
            continue  # another process removed it, or its parent, in between
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if isinstance(error, BlockingIOError) or not unlocked:
                os.close(descriptor)
                return None
            return descriptor
        if _is_at(descriptor, path):
            return descriptor
        os.close(descriptor)  # another process removed this file in between


def _open_file(path: Path) -> int:
    """Open a file, made if missing, and return its descriptor."""
    return os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)


def _open_folder(path: Path) -> int:
    """Open a folder, made if missing, and return its descriptor.

    Systems without fcntl cannot open a folder: there the descriptor is of the null device."""
    with suppress(FileExistsError):
        path.mkdir(0o700)
    if fcntl is None:
        return os.open(os.devnull, os.O_RDONLY)
    return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)


def _is_at(descriptor: int, path: Path) -> bool:
    """Return True if a path leads to the very file or folder that a descriptor has open.

    It is always True on systems without fcntl."""
    if fcntl is None:
        return True
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


@contextmanager
def _name_output(path: str | Path) -> Iterator[None]:
    """Name the path in an OSError of the block, with a remedy and the same number of error."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        reason = f"cannot write {path}: {os.strerror(error.errno)}; make room, or give another path"
        explained_error = type(OSError(error.errno, ""))(reason)
        explained_error.errno = error.errno
        raise explained_error from error


def reserve(path: Path, size: int) -> None:
    """Raise OSError if a file of `size` bytes has no room; `path` is left empty.

    It serves libraries that do not report a full disk."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate") and size:
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(0)


def _mask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _mode(target: Path) -> int:
    """Permissions of a replaced file, else rw-rw-rw- less the mask."""
    return target.stat().st_mode & 0o7777 if target.exists() else 0o666 & ~_mask()
