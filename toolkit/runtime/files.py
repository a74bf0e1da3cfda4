"""Files written whole and read with care: JSON, TOML, arrays. A file is written beside its place
under another name, synced to disk and renamed, so that no reader, kill or full disk ever meets half
of one. A symbolic link stays, its target is replaced. On failure nothing is left behind, and one
OSError names file and reason. What a killed process leaves is named `.NAME.0.unfinished`; the next
one that writes NAME takes it over. A writer locks it, so that nobody takes over what is being
written. Damage met in reading becomes one ValueError in one line."""

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

UNFINISHED = (
    ".unfinished"  # in the names of what is being written, or was when its process was killed
)
WRITTEN = ".coview"  # file in folders that are ours to replace
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
    """Give the block a name, with the same ending and folder, to write a file under; rename it at
    the end. If the block raises, `path` stays as it was. Raises OSError, with file and reason in
    one line, where the disk is full or the folder cannot be written. unfinished: that name, if it
    matters, on the file system of `path`; none is made before the block."""
    target = Path(os.path.realpath(path))
    held = None
    try:
        with _name_output(path):
            target.parent.mkdir(parents=True, exist_ok=True)
            if unfinished is None:
                unfinished, held = _take_unfinished(
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
        if held is not None:
            os.close(held)


@contextmanager
def writing_together(folder: str | Path) -> Iterator[Path]:
    """Give the block a folder; move its files into `folder`, made if missing, at the end. If the
    block raises, nothing moves. Raises OSError as `writing`."""
    with (
        _name_output(folder),
        _aside(Path(os.path.realpath(folder)), inside=True) as (target, unfinished),
    ):
        yield unfinished
        for each in sorted(unfinished.iterdir()):
            place = Path(os.path.realpath(target / each.name))
            each.chmod(_mode(place))
            each.replace(place)


@contextmanager
def writing_folder(folder: str | Path) -> Iterator[Path]:
    """Give the block a folder that becomes `folder` at the end, in place of all that is there: see
    `check_new_folder`. If the block raises, `folder` stays as it was. Raises OSError as `writing`,
    and while another process writes it."""
    target = Path(os.path.realpath(folder))
    try:
        with _aside(target, inside=target.exists()) as (_, unfinished):
            if not unfinished.name.endswith(f".0{UNFINISHED}"):
                raise FileExistsError(
                    f"another run is writing to {folder}: wait for it, or stop it"
                )
            yield unfinished
            (unfinished / WRITTEN).touch()
            if (
                unfinished.parent == target
            ):  # it stays, as it may be mounted, or be where somebody works
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
        for each in target.iterdir():
            if each not in (old, unfinished, target / WRITTEN):
                each.rename(old / each.name)
        for each in sorted(unfinished.iterdir(), key=lambda each: each.name == WRITTEN):
            each.replace(target / each.name)


@contextmanager
def _aside(target: Path, *, inside: bool) -> Iterator[tuple[Path, Path]]:
    """Give the block `target` and an empty folder, inside or beside it, that is removed at the
    end."""
    parent = target if inside else target.parent
    missing = [each for each in (parent, *parent.parents) if not each.exists()]
    unfinished = held = None
    try:
        parent.mkdir(parents=True, exist_ok=True)
        unfinished, held = _take_unfinished(parent, "" if inside else f".{target.name[:100]}", None)
        yield target, unfinished
    finally:
        if unfinished is not None:
            shutil.rmtree(unfinished, ignore_errors=True)
        if held is not None:
            os.close(held)
        for each in missing:  # those that are empty are what nothing came of
            with suppress(OSError):
                each.rmdir()


def _take_unfinished(folder: Path, start: str, suffix: str | None) -> tuple[Path, int]:
    """Make and lock an empty file, or folder (suffix None), or take over one whose writer was
    killed."""
    for number in range(1000):
        path = folder / f"{start}.{number}{UNFINISHED}{suffix or ''}"
        there = path.exists()
        try:
            held = take(path, folder=suffix is None, unlocked=not there)
        except PermissionError:
            if not there:
                raise
            continue  # another user's
        if held is None:
            continue
        if suffix is not None:
            os.truncate(path, 0)
        elif left := list(path.iterdir()):
            warnings.warn(
                f"{path}, which a killed run left, is removed and begun anew", stacklevel=2
            )
            for each in left:
                shutil.rmtree(each) if each.is_dir() and not each.is_symlink() else each.unlink()
        return path, held
    raise FileExistsError(f"{folder} is full of files {start}.N{UNFINISHED}: remove them")


def take(path: Path, *, folder: bool = False, unlocked: bool = True) -> int | None:
    """Open a file or folder, made if missing, and lock it until it is closed. None where another
    process holds it. unlocked: open it where there are no locks, too."""
    while True:
        if folder:
            path.mkdir(0o700, exist_ok=True)
        kind = os.O_RDONLY if folder else os.O_RDWR | os.O_CREAT
        held = os.open(
            path if fcntl or not folder else os.devnull, kind | getattr(os, "O_NOFOLLOW", 0), 0o600
        )
        try:
            if fcntl is not None:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not path.exists() or not os.path.samestat(os.fstat(held), path.stat()):
                    os.close(held)
                    continue  # whoever held it removed it in between
        except OSError as error:
            if isinstance(error, BlockingIOError) or not unlocked:
                os.close(held)
                return None
        return held


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
    """Raise OSError if a file of `size` bytes has no room. For libraries that do not tell; `path`
    is left empty."""
    with path.open("wb") as file:
        if hasattr(os, "posix_fallocate") and size:
            os.posix_fallocate(file.fileno(), 0, size)
        file.truncate(0)


def check_output(
    out: str | Path, *, inputs: Iterable[str | Path] = (), overwrite: bool = False
) -> None:
    """Check that a command may write to `out`. Raises ValueError where `out` is one of the inputs,
    or below one, under whatever name or link; FileExistsError where it exists (a folder: is not
    empty) without `overwrite`."""
    out, place = Path(out), Path(os.path.realpath(out))
    for each in inputs:
        read = Path(os.path.realpath(each))
        if any(above == read or _same(above, read) for above in (place, *place.parents)):
            same = place == read or _same(place, read)
            where = "is what is read" if same else f"is inside {each}, which is read"
            raise ValueError(f"{out} {where}: write to another place, so that nothing is lost")
    there = (
        any(UNFINISHED not in each.name for each in out.iterdir()) if out.is_dir() else out.exists()
    )
    if there and not overwrite:
        raise FileExistsError(
            f"{out} exists: write to another file, or replace it with --overwrite"
        )


def _same(one: Path, other: Path) -> bool:
    return one.exists() and other.exists() and one.samefile(other)


def check_new_folder(
    out: str | Path, *, inputs: Iterable[str | Path] = (), overwrite: bool = False
) -> None:
    """Check that `out` may become what `writing_folder` writes. Raises as `check_output`;
    ValueError where files would be lost that `writing_folder` has not written, or that are
    inputs."""
    out = Path(out)
    inputs = list(inputs)
    note = out / WRITTEN
    check_output(
        out,
        inputs=inputs,
        overwrite=overwrite or (note.is_file() and note.read_text() == UNFINISHED),
    )
    if out.is_dir() and any(UNFINISHED not in each.name for each in out.iterdir()):
        place = Path(os.path.realpath(out))
        for each in inputs:
            if place in Path(os.path.realpath(each)).parents:
                raise ValueError(
                    f"{out} holds {each}, which is read: write to another folder, it would be lost"
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
    """Return the path of a file or folder that is about to be read. Raises OSError for a missing
    one, ValueError for a pipe or a device, whose content may never come or never end."""
    path = Path(path)
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise ValueError(f"{path} is a pipe or a device: save its content to a file, and give that")
    return path


# s without a byte, bytes
_PATIENCE = 10.0
_LONGEST_PIPE = 1 << 26
MAX_FILE_BYTES = 1 << 30
MAX_TEXT_BYTES = 1 << 29  # for a text, which becomes up to twice as many


def read_plain(path: str | Path) -> bytes:
    """Read a file whole. Raises OSError; ValueError for a pipe, a device and more than
    `MAX_FILE_BYTES`."""
    size = plain_file(path).stat().st_size
    if size > MAX_FILE_BYTES:
        allowed = f"more than the {MAX_FILE_BYTES / 2**30:g} GiB that are read at a time"
        raise ValueError(f"{path} has {size / 2**30:.1f} GiB, {allowed}: split it")
    return Path(path).read_bytes()


def read_bytes(path: str | Path) -> bytes:
    """Read a file or a pipe. Raises OSError; ValueError for a device, a file larger than
    `MAX_FILE_BYTES`, and a pipe that is silent or does not end."""
    if not Path(path).is_fifo():
        return read_plain(path)
    content = bytearray()
    with open(
        path, "rb", 0, opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)
    ) as pipe:
        while len(content) < _LONGEST_PIPE and select.select([pipe], [], [], _PATIENCE)[0]:
            part = pipe.read(1 << 20)
            if not part:
                return bytes(content)
            content += part
    raise ValueError(
        f"{path} is a pipe that is silent or does not end: save its content to a file, and give "
        "that"
    )


def read_text(path: str | Path, kind: str = "text") -> str:
    """Read UTF-8 as `read_bytes`. kind: of the file, for the message of the ValueError if it is no
    text."""
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
    if (
        len(digits) > 300
    ):  # no float is as large, and Python turns no text of thousands into a number
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
    """Read a TOML file of ours that lies beside a module, given by its `__file__`."""
    return tomllib.loads(Path(module).with_name(name).read_text(encoding="utf-8"))


def parse_toml(content: bytes) -> dict[str, object]:
    """Parse a TOML file's content. Raises ValueError, in one line, for damaged, too large or too
    deeply nested text."""
    try:
        if len(content) > 1_000_000:
            raise ValueError("it is larger than 1 MB")
        if any(
            line.count(b".") > 300 for line in content.splitlines()
        ):  # the parser takes their square in memory
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


MOST_VALUES = 1_000_000  # of a YAML text, where a value that an alias repeats counts each time


def parse_yaml(text: str) -> Any:
    """Parse a YAML text. Raises ValueError, in one line, for damage, a key that is there twice, and
    aliases that make more than `MOST_VALUES` of a few lines."""
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None
        if _count_values(node, {}) > MOST_VALUES:
            raise ValueError(
                f"it holds more than {MOST_VALUES} values, aliases included: restore the file"
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
        counted[id(node)] = MOST_VALUES + 1  # met again below itself
        below = node.value if node.id != "scalar" else ()
        if node.id == "mapping":
            _refuse_doubled(
                [key.value for key, _ in below if key.id == "scalar" and key.value != "<<"]
            )
            below = [each for pair in below for each in pair]
        counted[id(node)] = min(
            MOST_VALUES + 1, 1 + sum(_count_values(each, counted) for each in below)
        )
    return counted[id(node)]


def resolve_below(root: str | Path, name: str) -> Path:
    """Return the file of a data set that one of its files names, as Linux or Windows writes paths.

    Raises ValueError for a name that leaves `root`."""
    given = Path(name)
    if "\\" in name and "\0" not in name and not os.path.lexists(Path(root) / given):
        given = Path(name.replace("\\", "/"))
    if given.is_absolute() or ".." in given.parts or "\0" in name:
        raise ValueError(
            f"the file name {name[:100]!r} leads out of {root}: name files below that folder"
        )
    return Path(root) / given


def check_links(root: str | Path) -> None:
    """Raise ValueError if a symbolic link in a folder leads out of it, so that only the folder's
    own is copied."""
    place = os.path.realpath(root)
    for folder, folders, files in os.walk(root):
        for link in (
            each
            for name in (*folders, *files)
            if os.path.islink(each := os.path.join(folder, name))
        ):
            if os.path.commonpath([place, target := os.path.realpath(link)]) != place:
                raise ValueError(
                    f"{link} leads out of {root}, to {target}: put a copy in its place"
                )


@contextmanager
def limit_memory(size: int) -> Iterator[None]:
    """Let this process map at most `size` more bytes, where the system can limit that; more raises
    MemoryError."""
    try:
        import resource

        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        most = min(
            limit for limit in (mapped + size, soft, hard) if limit != resource.RLIM_INFINITY
        )
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
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
    """Replace numbers that JSON lacks by null, such as an infinite bound or the AP without
    objects."""
    if isinstance(value, dict):
        return {key: replace_infinite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [replace_infinite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# bytes of SHA-256 over all that comes before, at the end of the file, where NumPy overlooks them
_CHECKSUM = 32


def write_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write a .npz file with a checksum, replacing an old one. A process killed while writing
    leaves the old one. Raises ValueError for arrays that `read_arrays` would refuse."""
    with name_errors(path):
        check_unpacked(sum(array.nbytes for array in arrays.values()))
    content = BytesIO()
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]  # its other keyword is not among them
    write_bytes(path, content.getvalue() + sha256(content.getvalue()).digest())


def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read the arrays of a file of `write_arrays`. Raises FileNotFoundError; ValueError for a
    damaged or other file."""
    content = read_plain(path)
    content, checksum = content[:-_CHECKSUM], content[-_CHECKSUM:]
    if sha256(content).digest() != checksum:
        raise ValueError(
            f"{path} does not fit its checksum: it is damaged or not a coview file, make it again"
        )
    return load_arrays(path, BytesIO(content))


# what np.load was seen to raise on damaged files: from the zip archive, the header's text, its
# shape
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


MOST_UNPACKED = 1 << 30  # bytes of memory that one file may ask for
# bytes of a cloud that is packed: float64 copies of it take several times as much
MOST_CLOUD = 1 << 28


def check_unpacked(size: int, most: int | None = None) -> None:
    """Raise ValueError where a file asks for more memory than `most`, by default
    `MOST_UNPACKED`."""
    most = most or MOST_UNPACKED
    if size > most:
        raise ValueError(
            f"it unpacks to {size / 2**30:.1f} GiB, more than the {most / 2**30:g} GiB allowed: "
            "split it"
        )


def load_arrays(
    path: str | Path, content: BytesIO | None = None, *, most: int | None = None
) -> dict[str, np.ndarray]:
    """Load the arrays of a .npz file by name, that of a .npy file as "". Raises ValueError, in one
    line, also where those of a .npz would take more memory than `check_unpacked` allows. content:
    of the file, if it was read before."""
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
                check_unpacked(sum(entry.file_size for entry in archive.infolist()), most)
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
    """Check that the array of a stream of `size` bytes is as large as its header says."""
    form = np.lib.format
    version = form.read_magic(stream)
    read_header = form.read_array_header_1_0 if version == (1, 0) else form.read_array_header_2_0
    shape, _, kind = read_header(stream)
    check_unpacked(declared := math.prod(shape) * kind.itemsize)
    if kind.itemsize and declared != size - stream.tell() and not kind.hasobject:
        raise ValueError(f"its header says {declared} bytes, but {size - stream.tell()} are there")
