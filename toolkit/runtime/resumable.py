"""Work in blocks that survives being killed: every finished block is one whole file.

A shard is called `{block}.{crc32}.hdf5`. It is written under another name, synced to disk, then
renamed; a shard that does not fit its checksum is damaged and made again. The plan of the shards is
in their folder, in `plan.json`."""

import errno
import json
import os
import re
import shutil
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar, runtime_checkable

from toolkit.runtime.parallel import spread
from toolkit.runtime.process_pool import tick
from toolkit.runtime.writing import DISK_ERRORS, UNFINISHED, take, write_bytes, write_text, writing

_SHARD = re.compile(r"(\d{5,})\.([0-9a-f]{8})\.hdf5")

Plan = Mapping[str, object]  # of JSON values
_Item = TypeVar("_Item")
_Made = TypeVar("_Made")


@runtime_checkable
class Work(Protocol[_Item]):
    """Work in blocks, pickled to every worker."""

    def start(self, threads: int) -> Callable[[int], Iterator[_Item]]:
        """Prepare once per process; return a maker of a block's items.

        threads: number of threads that the process may use."""

    def encode(self, items: Sequence[_Item]) -> bytes:
        """Content of the shard of a block's items."""


@dataclass(frozen=True)
class ShardFolder:
    """Finished shards of an unfinished file, and their plan (JSON)."""

    path: Path
    plan: Plan

    @property
    def found(self) -> Plan | None:
        """Plan of the run that was killed here; None without one, or if it cannot be read."""
        with suppress(FileNotFoundError, NotADirectoryError, ValueError):
            return dict(json.loads((self.path / "plan.json").read_text()))
        return None

    def open(self, overwrite: bool) -> None:
        """Begin a run in the folder, or continue the one that was killed there with the same plan.

        The folder must exist, as it does within `lock`. overwrite: True to begin again, without the
        shards made so far, in a folder of another plan, which otherwise raises FileExistsError
        unless nothing was finished there."""
        stored_plan = self.found
        differences = "" if stored_plan is None else describe_differences(stored_plan, self.plan)
        if differences and not overwrite and self._has_finished_parts():
            remedy = "finish that one first, write to another file, or --overwrite it"
            raise FileExistsError(
                f"{self.path} holds an unfinished run made from {differences}: {remedy}"
            )
        if stored_plan is None or differences:
            self._clear()
            write_text(self.path / "plan.json", json.dumps(self.plan, indent=1))

    def _has_finished_parts(self) -> bool:
        """Return True if the folder holds more than a plan, a lock and unfinished files."""
        return any(
            path.name not in ("plan.json", "lock") and UNFINISHED not in path.name
            for path in self.path.iterdir()
        )

    def check_shards(self) -> dict[int, Path]:
        """Undamaged shards by block; damaged and unfinished ones are removed."""
        shards = {}
        for path in sorted(self.path.iterdir()):
            name = _SHARD.fullmatch(path.name)  # its groups: block and checksum
            if name and zlib.crc32(path.read_bytes()) == int(name[2], 16):
                shards[int(name[1])] = path
            elif name or UNFINISHED in path.name:
                path.unlink()
        return shards

    def add(self, block: int, content: bytes) -> None:
        """Store the shard of a block whole or not at all."""
        write_bytes(self.path / f"{block:05d}.{zlib.crc32(content):08x}.hdf5", content)

    def publish(self, out: Path, join: Callable[[list[Path], Path], _Made]) -> _Made:
        """Join all shards into `out`, which appears whole, and remove them. Returns the result of
        `join`."""
        shards = [path for _, path in sorted(self.shards().items())]
        size = sum(path.stat().st_size for path in shards)
        if size > shutil.disk_usage(self.path).free:
            raise OSError(errno.ENOSPC, f"{size / 1e6:.0f} MB are needed to join the shards")
        with writing(out, self.path / f"joined{UNFINISHED}") as joined_file:
            result = join(shards, joined_file)
        self.remove()
        return result

    def shards(self) -> dict[int, Path]:
        """Shards by block, judging by their names."""
        return {
            int(name[1]): path
            for path in self.path.iterdir()
            if (name := _SHARD.fullmatch(path.name))
        }

    def remove(self) -> None:
        """Remove the folder if it holds nothing else."""
        if self.path.is_dir():
            self._clear()
            for name in ("plan.json", "lock"):
                (self.path / name).unlink(missing_ok=True)
            with suppress(OSError):  # it holds a file of the user's
                self.path.rmdir()

    def _clear(self) -> None:
        """Remove all shards, finished or not."""
        for path in self.path.iterdir():
            if _SHARD.fullmatch(path.name) or UNFINISHED in path.name:
                path.unlink()

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep a second run out until the block ends."""
        lock = self.path / "lock"
        descriptor = take(lock)
        if descriptor is None:
            raise FileExistsError(f"another run is writing to {self.path}: wait for it, or stop it")
        try:
            yield
        finally:
            # it may be gone already, with the folder, or belong to the next run
            with suppress(OSError):
                if os.path.samestat(os.fstat(descriptor), lock.stat()):
                    lock.unlink()
                    self.path.rmdir()  # if empty
            os.close(descriptor)

    @contextmanager
    def explain_disk_errors(
        self, out: Path, frames: Callable[[Collection[int]], int]
    ) -> Iterator[None]:
        """Turn a full or failing disk into one line that states what is safe.

        out: the file that the shards are for. frames: from blocks to their number of frames."""
        try:
            yield
        except OSError as error:
            if error.errno not in DISK_ERRORS:
                raise
            reason = (
                f"{os.strerror(error.errno)} ({shutil.disk_usage(self.path).free / 1e6:.0f} MB "
                "free)"
            )
            remedy = (
                f"{frames(self.shards())} frames are safe in {self.path}, make room and start "
                "again to go on"
            )
            line = OSError(f"cannot write {out}: {reason}; {remedy}")
            line.errno = error.errno  # set afterwards: str() of the error is only the line
            raise line from error


def make_shards(
    work: Work[_Item],
    folder: ShardFolder,
    blocks: Sequence[int],
    *,
    workers: int,
    ray: str | None = None,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Make the shards of `blocks` that are missing, in `workers` processes or on a Ray cluster.

    ray: address of the cluster, which sends their content back. progress: called with the number of
    finished items."""
    missing_blocks = sorted(set(blocks) - folder.shards().keys())
    workers = min(workers, max(1, len(missing_blocks)))
    finished_items = 0

    def count(items: int = 1) -> None:
        """Count finished items, and report their number."""
        nonlocal finished_items
        finished_items += items
        if progress is not None:
            progress(finished_items)

    job = _ShardJob(
        work=work,
        folder=None if ray else folder,
        threads=1 if ray else (os.cpu_count() or 1) // max(1, workers) or 1,
        count=count if workers == 1 and not ray else tick,
    )
    results = spread(job, missing_blocks, workers=workers, ray=ray, ticks=progress)
    for block, (items, content) in zip(missing_blocks, results, strict=True):
        if content is not None:
            folder.add(block, content)
            count(items)


def describe_differences(stored: Plan, requested: Plan) -> str:
    """Describe how `stored` differs from `requested`; empty if equal."""
    keys = [key for key in {**stored, **requested} if stored.get(key) != requested.get(key)]
    return ", ".join(f"{key} {stored.get(key)} instead of {requested.get(key)}" for key in keys)


@dataclass
class _ShardJob(Generic[_Item]):
    """Job of a worker: make one block, and store its shard.

    Attributes:
        work: Work.
        folder: Folder of the shards, None on a Ray cluster, whose machines need not see it.
        threads: Number of threads that the process may use.
        count: Called for every finished item.
        make: Maker of a block's items, prepared once per process.
    """

    work: Work[_Item]
    folder: ShardFolder | None
    threads: int
    count: Callable[[], None]
    make: Callable[[int], Iterator[_Item]] | None = field(default=None, init=False)

    def __call__(self, block: int) -> tuple[int, bytes | None]:
        """Number of items of a block, and the shard's content if it is not stored here."""
        self.make = self.make or self.work.start(self.threads)  # kept for the next block
        items = []
        for item in self.make(block):
            items.append(item)
            self.count()
        content = self.work.encode(items)
        if self.folder is None:
            return len(items), content
        try:
            self.folder.add(block, content)
        except OSError as error:
            # with the number in its arguments, so that it is not lost between processes
            raise OSError(error.errno, str(error)) from error
        return len(items), None
