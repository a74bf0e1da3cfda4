"""Work in blocks that survives being killed: every finished block is one file, complete or not there at all.

A part is called `{block}.{crc32}.hdf5`. It is written under another name, brought to the disk, then renamed; what has
its name but not its checksum is damaged and made again. What the parts are made from stands beside them in `plan.json`.
"""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import re
import shutil
import signal
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

try:
    import fcntl
except ImportError:  # not a Unix
    fcntl = None  # type: ignore[assignment]

_PART = re.compile(r"(\d{5,})\.([0-9a-f]{8})\.hdf5")
_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


@runtime_checkable
class Work(Protocol):
    """What is made in blocks; it is pickled to every worker."""

    def start(self, threads: int) -> Callable[[int], Iterator[Any]]:
        """Get ready, once a process, which may use so many threads; returns what makes the items of a block."""
        ...

    def encode(self, items: Sequence[Any]) -> bytes:
        """The content of the part file of a block's items."""
        ...


@dataclass(frozen=True)
class PartFolder:
    """The finished parts of a file that is being made, and the plan (JSON) that they are made from."""

    path: Path
    plan: dict[str, Any]

    def open(self, overwrite: bool) -> None:
        """Make the folder, or go on in it. Raises FileExistsError where its parts were made from another plan."""
        note = self.path / "plan.json"
        found = _read_json(note)
        differences = "" if found is None else describe_differences(found, self.plan)
        if differences and not overwrite:
            raise FileExistsError(
                f"{self.path} holds an unfinished run made from {differences}:"
                " finish that one first, write to another file, or overwrite it"
            )
        if found is None or differences:
            self._clear()
            write_whole(note, json.dumps(self.plan, indent=1).encode())

    def verified(self) -> dict[int, Path]:
        """The undamaged parts by block; all else is removed."""
        parts = {}
        for path in sorted(self.path.iterdir()):
            name = _PART.fullmatch(path.name)
            if name and zlib.crc32(path.read_bytes()) == int(name[2], 16):
                parts[int(name[1])] = path
            elif name or path.suffix == ".unfinished":
                path.unlink()
        return parts

    def add(self, block: int, content: bytes) -> None:
        """Store the part of a block, all of it or nothing."""
        write_whole(self.path / f"{block:05d}.{zlib.crc32(content):08x}.hdf5", content)

    def publish(self, out: Path, join: Callable[[list[Path], Path], None]) -> None:
        """Join all parts into `out`, which appears whole, and remove them."""
        joined = self.path / "joined.unfinished"
        size = sum(path.stat().st_size for path in self.parts().values())
        if size > shutil.disk_usage(self.path).free:
            raise OSError(errno.ENOSPC, f"{size / 1e6:.0f} MB are needed to join the parts")
        join([self.parts()[block] for block in sorted(self.parts())], joined)
        with joined.open("rb") as file:
            os.fsync(file.fileno())
        joined.replace(out)
        self.remove()

    def parts(self) -> dict[int, Path]:
        """The parts by block, undamaged as far as their names tell."""
        return {int(name[1]): path for path in self.path.iterdir() if (name := _PART.fullmatch(path.name))}

    def remove(self) -> None:
        """Remove the folder, if it is there and holds nothing but ours."""
        if self.path.is_dir():
            self._clear()
            for name in ("plan.json", "lock"):
                (self.path / name).unlink(missing_ok=True)
            with suppress(OSError):  # somebody put a file of their own there
                self.path.rmdir()

    def _clear(self) -> None:
        for path in self.path.iterdir():
            if _PART.fullmatch(path.name) or path.name.endswith(".unfinished"):
                path.unlink()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep a second run out; the lock goes with the process, however it ends."""
        self.path.mkdir(parents=True, exist_ok=True)
        with (self.path / "lock").open("w") as lock:
            if fcntl is not None:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except OSError:
                    raise FileExistsError(f"another run is writing to {self.path}: wait for it, or stop it") from None
            yield

    @contextmanager
    def disk_errors_explained(self, out: Path, frames: Callable[[Iterable[int]], int]) -> Iterator[None]:
        """Turn a full or failing disk into one line that says what is safe; frames: how many some blocks hold."""
        try:
            yield
        except (OSError, RuntimeError) as error:  # h5py raises both
            number = getattr(error, "errno", None) or _errno_in(str(error))
            if number not in _DISK_ERRORS:
                raise
            safe = frames(self.parts())
            for unfinished in self.path.glob("*.unfinished"):
                unfinished.unlink(missing_ok=True)
            free = shutil.disk_usage(self.path).free
            explained = OSError(
                f"cannot write {out}: {os.strerror(number)} ({free / 1e6:.0f} MB free); {safe} frames are safe in"
                f" {self.path}, make room and start again to go on"
            )
            explained.errno = number
            raise explained from error


def make_parts(
    work: Work, folder: PartFolder, blocks: Sequence[int], *, workers: int, progress: Callable[[int], None]
) -> None:
    """Make the parts of `blocks` in `workers` processes, in this one if it is one; progress: told the items done."""
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    done = 0
    if blocks and min(workers, len(blocks)) == 1:
        make = work.start(os.cpu_count() or 1)

        def count() -> None:
            nonlocal done
            done += 1
            progress(done)

        for block in blocks:
            _make_part(work, folder, make, block, count)
    elif blocks:
        _make_parts_in_processes(work, folder, blocks, min(workers, len(blocks)), progress)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is there under its name only when all of it is on the disk."""
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.unfinished")
    with unfinished.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    unfinished.replace(path)


def describe_differences(found: dict[str, Any], asked: dict[str, Any]) -> str:
    """What is in `found` that is not in `asked`, in words; empty where they are equal.

    >>> describe_differences({"seed": 1, "frames": 9}, {"seed": 2, "frames": 9})
    'seed 1 instead of 2'
    """
    keys = [key for key in {**found, **asked} if found.get(key) != asked.get(key)]
    return ", ".join(f"{key} {found.get(key)} instead of {asked.get(key)}" for key in keys)


def _make_part(
    work: Work, folder: PartFolder, make: Callable[[int], Iterator[Any]], block: int, count: Callable[[], None]
) -> None:
    items = []
    for item in make(block):
        items.append(item)
        count()
    folder.add(block, work.encode(items))


def _make_parts_in_processes(
    work: Work, folder: PartFolder, blocks: Sequence[int], workers: int, progress: Callable[[int], None]
) -> None:
    context = multiprocessing.get_context("spawn")  # forking would copy the locks of Open3D's and torch's threads
    done = context.Value("q")
    threads = max(1, (os.cpu_count() or 1) // workers)
    others = set(multiprocessing.active_children())
    with ProcessPoolExecutor(workers, context, _start_worker, (work, folder, done, threads)) as pool:
        pending = {pool.submit(_work, block) for block in blocks}
        try:
            while pending:
                finished, pending = wait(pending, timeout=0.2, return_when=FIRST_EXCEPTION)
                for future in finished:
                    future.result()
                progress(done.value)
        except BrokenProcessPool:
            raise RuntimeError(
                "a worker process ended unexpectedly: out of memory, or called from a script without"
                ' `if __name__ == "__main__":`; start again to go on, with fewer workers'
            ) from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise


_worker: tuple[Work, PartFolder, Callable[[int], Iterator[Any]], Callable[[], None]]


def _start_worker(work: Work, folder: PartFolder, done: Any, threads: int) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    threading.Thread(target=_end_with_parent, daemon=True).start()

    def count() -> None:
        with done.get_lock():
            done.value += 1

    _worker = work, folder, work.start(threads), count


def _work(block: int) -> None:
    work, folder, make, count = _worker
    _make_part(work, folder, make, block, count)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()  # returns when the parent is gone, killed or not
        os._exit(1)


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        return json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return None


def _errno_in(message: str) -> int | None:
    """The error number HDF5 writes into its messages."""
    number = re.search(r"errno = (\d+)", message)
    return int(number[1]) if number else None
