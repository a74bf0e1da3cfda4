"""Files read with care: damage becomes one ValueError in one line."""

import os
import select
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MAX_SILENCE_S = 10.0  # pause of a pipe between bytes
MAX_PIPE_BYTES = 1 << 26
MAX_FILE_BYTES = 1 << 30
MAX_TEXT_BYTES = 1 << 29  # for a text, which becomes up to twice as many


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
    # without O_NONBLOCK, opening a pipe waits for its writer, maybe for ever
    with open(
        path, "rb", 0, opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)
    ) as pipe:
        while len(content) < MAX_PIPE_BYTES and select.select([pipe], [], [], MAX_SILENCE_S)[0]:
            chunk = pipe.read(1 << 20)
            if not chunk:
                return bytes(content)
            content += chunk
    raise ValueError(
        f"{path} is a pipe that is silent or does not end: save its content to a file, and give "
        "that"
    )


def read_text(path: str | Path, kind: str = "text") -> str:
    """Read UTF-8 text from a file or a pipe.

    kind: word for the file in the ValueError if it is no text. Raises the errors of `read_bytes`.
    """
    if (size := os.stat(path).st_size) > MAX_TEXT_BYTES:
        raise ValueError(f"{path} has {size / 2**30:.1f} GiB, too much for a {kind} file: split it")
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path}: not a text file (byte {error.start} is not UTF-8): give a {kind} file"
        ) from None


def resolve_below(root: str | Path, name: str) -> Path:
    """Return the file of a data set that one of its files names, as Linux or Windows writes paths.

    Raises ValueError for a name that leaves `root`."""
    relative_path = Path(name)
    if "\\" in name and "\0" not in name and not os.path.lexists(Path(root) / relative_path):
        relative_path = Path(name.replace("\\", "/"))
    if relative_path.is_absolute() or ".." in relative_path.parts or "\0" in name:
        raise ValueError(
            f"the file name {name[:100]!r} leads out of {root}: name files below that folder"
        )
    return Path(root) / relative_path


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

        mapped_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit_bytes = min(
            limit for limit in (mapped_bytes + size, soft, hard) if limit != resource.RLIM_INFINITY
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
