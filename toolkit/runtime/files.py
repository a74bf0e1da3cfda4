"""Files written whole and read with care: JSON, TOML, arrays.

A file is written in its folder under another name, synced to disk and renamed, so that no reader,
kill or full disk ever meets half a file. A symbolic link stays, its target is replaced. On failure
no file is left behind, and one OSError names file and reason. The file that a killed process leaves
is named `.NAME.0.unfinished`; the next process that writes NAME takes it over. A writer locks it,
so that no other process takes it over. Damage found in reading becomes one ValueError in one
line."""

import errno
import json
import math
import os
import re
import select
import shutil
import stat
import struct
import tokenize
import tomllib
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np

try:
    import fcntl
except ImportError:  # not a Unix
    fcntl = None  # type: ignore[assignment]

UNFINISHED = ".unfinished"  # in the names of files that are, or were, being written
WRITTEN = ".coview"  # file in folders that are ours to replace
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
_MAX_SILENCE_S = 10.0  # pause of a pipe between bytes
_MAX_PIPE_BYTES = 1 << 26
MAX_FILE_BYTES = 1 << 30
MAX_TEXT_BYTES = 1 << 29  # for a text, which becomes up to twice as many
MAX_YAML_VALUES = 1_000_000  # in a YAML text; a value that an alias repeats counts each time
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


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a whole file. Raises OSError on failure."""
    with writing(path) as unfinished:
        unfinished.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole file of UTF-8 text, as `write_bytes`."""
    write_bytes(path, text.encode("utf-8"))


@contextmanager
def writing(path: str | Path, unfinished: Path | None = None) -> Iterator[Path]:
    """Give the block a temporary path to write a file to, and rename the file at the end.

    The path has the same ending and folder. If the block raises, `path` stays as it was. Raises
    OSError, with file and reason in one line, if the disk is full or the folder cannot be written.
    unfinished: the temporary path, if it matters, on the file system of `path`; no file is made
    before the block."""
    target = Path(os.path.realpath(path))
    descriptor = None
    try:
        with _name_output(path):
            target.parent.mkdir(parents=True, exist_ok=True)
            if unfinished is None:
                unfinished, descriptor = _take_unfinished(
                    target.parent, f".{target.name[:100]}", target.suffix
                )
            yield unfinished
            with unfinished.open("rb") as file:
                os.fsync(file.fileno())
            unfinished.chmod(_mode(target))
            unfinished.replace(target)
    finally:
        if unfinished is not None:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
        if descriptor is not None:
            os.close(descriptor)


@contextmanager
def writing_together(folder: str | Path) -> Iterator[Path]:
    """Give the block a folder, and move its files into `folder` at the end.

    `folder` is made if missing. If the block raises, nothing moves. Raises OSError as `writing`."""
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
    """Give the block a folder that replaces `folder` at the end: see `check_new_folder`.

    If the block raises, `folder` stays as it was. Raises OSError as `writing`, and while another
    process writes it."""
    target = Path(os.path.realpath(folder))
    try:
        with _aside(target, inside=target.exists()) as (_, unfinished):
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
    """Move the content of a folder inside `target` in place of the rest."""
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
    missing = [path for path in (parent, *parent.parents) if not path.exists()]
    unfinished = descriptor = None
    try:
        parent.mkdir(parents=True, exist_ok=True)
        unfinished, descriptor = _take_unfinished(
            parent, "" if inside else f".{target.name[:100]}", None
        )
        yield target, unfinished
    finally:
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
        if descriptor is not None:
            os.close(descriptor)
        for path in missing:  # those that are empty are what nothing came of
            with suppress(OSError):
                path.rmdir()


def _take_unfinished(folder: Path, start: str, suffix: str | None) -> tuple[Path, int]:
    """Make and lock an empty file, or folder (suffix None), or take over one of a killed writer."""
    for number in range(1000):
        path = folder / f"{start}.{number}{UNFINISHED}{suffix or ''}"
        existed = path.exists()
        try:
            descriptor = take(path, folder=suffix is None, unlocked=not existed)
        except PermissionError:
            if not existed:
                raise
            continue  # another user's
        if descriptor is None:
            continue
        if suffix is not None:
            os.truncate(path, 0)
        elif left := list(path.iterdir()):
            warnings.warn(
                f"{path}, which a killed run left, is removed and begun anew", stacklevel=2
            )
            for entry in left:
                shutil.rmtree(
                    entry
                ) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        return path, descriptor
    raise FileExistsError(f"{folder} is full of files {start}.N{UNFINISHED}: remove them")


def take(path: Path, *, folder: bool = False, unlocked: bool = True) -> int | None:
    """Open a file or folder, made if missing, and lock it until it is closed.

    Returns None if another process holds it. unlocked: also open it on systems without locks."""
    while True:
        if folder:
            path.mkdir(0o700, exist_ok=True)
        kind = os.O_RDONLY if folder else os.O_RDWR | os.O_CREAT
        descriptor = os.open(
            path if fcntl or not folder else os.devnull, kind | getattr(os, "O_NOFOLLOW", 0), 0o600
        )
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not path.exists() or not os.path.samestat(os.fstat(descriptor), path.stat()):
                    os.close(descriptor)
                    continue  # whoever held it removed it in between
        except OSError as error:
            if isinstance(error, BlockingIOError) or not unlocked:
                os.close(descriptor)
                return None
        return descriptor


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
    """Raise OSError if a file of `size` bytes has no room; `path` is left empty.

    It serves libraries that do not report a full disk."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate") and size:
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(0)


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

    Raises as `check_output`, and ValueError if files would be lost that `writing_folder` has not
    written, or that are inputs."""
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


def _mask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _mode(target: Path) -> int:
    """Permissions of a replaced file, else rw-rw-rw- less the mask."""
    return target.stat().st_mode & 0o7777 if target.exists() else 0o666 & ~_mask()


def plain_file(path: str | Path) -> Path:
    """Return the path of a file or folder that is about to be read.

    Raises OSError if it is missing, ValueError for a pipe or a device, whose content may never come
    or never end."""
    path = Path(path)
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise ValueError(f"{path} is a pipe or a device: save its content to a file, and give that")
    return path


def read_plain(path: str | Path) -> bytes:
    """Read a whole file.

    Raises OSError; ValueError for a pipe, a device and more than `MAX_FILE_BYTES`."""
    size = plain_file(path).stat().st_size
    if size > MAX_FILE_BYTES:
        allowed = f"more than the {MAX_FILE_BYTES / 2**30:g} GiB that are read at a time"
        raise ValueError(f"{path} has {size / 2**30:.1f} GiB, {allowed}: split it")
    return Path(path).read_bytes()


def read_bytes(path: str | Path) -> bytes:
    """Read a file or a pipe.

    Raises OSError; ValueError for a device, a file larger than `MAX_FILE_BYTES`, and a pipe that is
    silent or does not end."""
    if not Path(path).is_fifo():
        return read_plain(path)
    content = bytearray()
    with open(
        path, "rb", 0, opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)
    ) as pipe:
        while len(content) < _MAX_PIPE_BYTES and select.select([pipe], [], [], _MAX_SILENCE_S)[0]:
            chunk = pipe.read(1 << 20)
            if not chunk:
                return bytes(content)
            content += chunk
    raise ValueError(
        f"{path} is a pipe that is silent or does not end: save its content to a file, and give "
        "that"
    )


def read_text(path: str | Path, kind: str = "text") -> str:
    """Read UTF-8 as `read_bytes`. kind: word for the file in the ValueError if it is no text."""
    if (size := os.stat(path).st_size) > MAX_TEXT_BYTES:
        raise ValueError(f"{path} has {size / 2**30:.1f} GiB, too much for a {kind} file: split it")
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: not a text file (byte {error.start} is not UTF-8): give a {kind} file"
        ) from None


def parse_json(text: str) -> Any:
    """Parse a JSON text. Raises ValueError, in one line, for damaged or too deeply nested text."""
    try:
        return json.loads(text, parse_int=_whole_number, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        reason = f"not JSON from line {error.lineno} on ({error.msg})"
    except RecursionError:
        reason = "its lists or objects are nested too deep to be read"
    except ValueError as error:
        reason = str(error)
    raise ValueError(f"{reason}: restore the file")


def _whole_number(digits: str) -> int:
    # no float is as large, and Python turns no text of thousands into a number
    if len(digits) > 300:
        raise ValueError(f"it has a number of {len(digits)} digits")
    return int(digits)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _refuse_doubled([key for key, _ in pairs])
    return dict(pairs)


def _refuse_doubled(keys: list[Any]) -> None:
    if len(set(keys)) < len(keys):
        key = next(key for k, key in enumerate(keys) if key in keys[:k])
        raise ValueError(f"it has the key {str(key)[:60]!r} twice")


def read_own_table(module: str, name: str) -> dict[str, Any]:
    """Read a TOML file of this project in the folder of a module, given by its `__file__`."""
    return tomllib.loads(Path(module).with_name(name).read_text(encoding="utf-8"))


def parse_toml(content: bytes) -> dict[str, object]:
    """Parse a TOML file's content.

    Raises ValueError, in one line, for damaged, too large or too deeply nested text."""
    try:
        if len(content) > 1_000_000:
            raise ValueError("it is larger than 1 MB")
        # the parser takes the square of the dots in memory
        if any(line.count(b".") > 300 for line in content.splitlines()):
            raise ValueError("a line has more than 300 dots")
        if re.search(rb"\d{300}", content):
            raise ValueError("it has a number of hundreds of digits")
        return tomllib.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(
            f"not a text file (byte {error.start} is not UTF-8): give a TOML file"
        ) from None
    except RecursionError:
        raise ValueError(
            "its lists or tables are nested too deep to be read: repair the file"
        ) from None
    except ValueError as error:
        raise ValueError(f"not TOML ({str(error)[:120]}): repair the file") from None


def parse_yaml(text: str) -> Any:
    """Parse a YAML text.

    Raises ValueError, in one line, for damage, a repeated key, and aliases that make more than
    `MAX_YAML_VALUES` values of a few lines."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        if _count_values(node, {}) > MAX_YAML_VALUES:
            raise ValueError(
                f"it holds more than {MAX_YAML_VALUES} values, aliases included: restore the file"
            )
        return loader.construct_document(node)
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())[:160]) from None
    except RecursionError:
        raise ValueError(
            "its lists or names are nested too deep to be read: restore the file"
        ) from None
    finally:
        loader.dispose()


def _count_values(node: Any, counted: dict[int, int]) -> int:
    """Count a YAML node and all below it; aliases lead to one node many times."""
    if id(node) not in counted:
        counted[id(node)] = MAX_YAML_VALUES + 1  # met again below itself
        below = node.value if node.id != "scalar" else ()
        if node.id == "mapping":
            _refuse_doubled(
                [key.value for key, _ in below if key.id == "scalar" and key.value != "<<"]
            )
            below = [child for pair in below for child in pair]
        counted[id(node)] = min(
            MAX_YAML_VALUES + 1, 1 + sum(_count_values(child, counted) for child in below)
        )
    return counted[id(node)]


def resolve_below(root: str | Path, name: str) -> Path:
    """Return the file of a data set that one of its files names, as Linux or Windows writes paths.

    Raises ValueError for a name that leaves `root`."""
    relative = Path(name)
    if "\\" in name and "\0" not in name and not os.path.lexists(Path(root) / relative):
        relative = Path(name.replace("\\", "/"))
    if relative.is_absolute() or ".." in relative.parts or "\0" in name:
        raise ValueError(
            f"the file name {name[:100]!r} leads out of {root}: name files below that folder"
        )
    return Path(root) / relative


def check_links(root: str | Path) -> None:
    """Raise ValueError if a symbolic link in a folder points outside it.

    So only files of the folder are copied."""
    real_root = os.path.realpath(root)
    for folder, folders, files in os.walk(root):
        for name in (*folders, *files):
            entry = os.path.join(folder, name)
            if not os.path.islink(entry):
                continue
            target = os.path.realpath(entry)
            if os.path.commonpath([real_root, target]) != real_root:
                raise ValueError(
                    f"{entry} leads out of {root}, to {target}: put a copy in its place"
                )


@contextmanager
def limit_memory(size: int) -> Iterator[None]:
    """Let this process map at most `size` more bytes; beyond that it gets MemoryError.

    Does nothing if the system has no such limit."""
    try:
        import resource

        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit_bytes = min(
            limit for limit in (mapped + size, soft, hard) if limit != resource.RLIM_INFINITY
        )
        resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, hard))
    except (ImportError, OSError, ValueError):
        yield
        return
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def name_errors(where: str | Path) -> Iterator[None]:
    """Put a file or field before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def read_json(path: str | Path) -> Any:
    """Read a JSON file in UTF-8. Raises OSError; ValueError, in one line, for a damaged file."""
    text = read_text(path, "JSON")
    with name_errors(path):
        return parse_json(text)


def replace_infinite(value: Any) -> Any:
    """Replace numbers that JSON lacks by null, such as an infinite bound or an undefined AP."""
    if isinstance(value, dict):
        return {key: replace_infinite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [replace_infinite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
    stored = read_plain(path)
    content = stored[:-_CHECKSUM_BYTES]
    checksum = stored[-_CHECKSUM_BYTES:]
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
            if file.read(2) != b"PK":
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
    declared = math.prod(shape) * kind.itemsize
    check_unpacked(declared)
    if kind.itemsize and declared != size - stream.tell() and not kind.hasobject:
        raise ValueError(f"its header says {declared} bytes, but {size - stream.tell()} are there")
