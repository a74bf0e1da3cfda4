"""`Run`: settings for how a result is computed, whatever the result.

A command takes the smallest class that holds what it uses: `Processes` (workers, ray, progress) for
work on given files, `Simulation` (also seed and frames) if traffic is simulated, `Run` (also cache)
if results are kept. Other defaults are the parameter's default, `run: Run = Run(frames=1000)`. tyro
makes options and help of the fields. The same seed and frames give the same result on one machine;
cache and processes change only the time it takes. Values that do not fit raise ValueError, a
cluster without Ray ImportError."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Self, TypeVar

from toolkit.frozen import set_fields
from toolkit.runtime.parallel import spread
from toolkit.runtime.process_pool import is_waiting

if TYPE_CHECKING:
    from toolkit.runtime.cache import Cache

# processes of commands that compare many sets: each takes some 500 MB, so no more than two
USUAL_WORKERS = min(2, os.cpu_count() or 1)
PART_SEEDS = 1_000_003  # between the seeds of two parts of traffic
Stages = Callable[[str, int, "int | None"], None]  # name of a stage, done, to do (None if unknown)

_In = TypeVar("_In")
_Out = TypeVar("_Out")


@dataclass(frozen=True, kw_only=True)
class Processes:
    """Parallel work."""

    workers: int | None = 1
    """Number of processes on this machine; None for one per core."""
    ray: str | None = None
    """Ray cluster to use instead: its address, auto to join this machine's cluster, or local to
    start one."""
    progress: Stages | None = field(default=None, compare=False, repr=False)
    """Called with the name of a stage, what is done and what is to be done (None where unknown)."""

    def __post_init__(self) -> None:
        if self.workers is not None:
            check_whole("workers", self.workers, least=1, remedy="None takes one per core")
        if self.ray is not None and not find_spec("ray"):
            raise ImportError("work on a Ray cluster needs Ray: pip install coview[scale]")

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "progress": None}  # it speaks to the terminal of this process

    @property
    def count(self) -> int:
        """Number of processes on this machine."""
        return (os.cpu_count() or 1) if self.workers is None else self.workers

    @property
    def has_one_process(self) -> bool:
        """True if all work is done in this process."""
        return self.ray is None and self.count == 1

    def map(
        self,
        job: Callable[[_In], _Out],
        inputs: Iterable[_In],
        *,
        home: Callable[[_In], int] | None = None,
        is_quick: bool = False,
        progress: Callable[[int], None] | None = None,
    ) -> Iterator[_Out]:
        """Yield `job(x)` for each input, in order, computed by the processes of the run.

        job: a module's function or a callable object that can be pickled; home: from an input to a
        number; a process gets the inputs with the same number, None if it does not matter;
        is_quick: True if the job takes less time than to start processes, so that it is done here
        unless they wait for work; progress: called with the number of results. Raises the errors of
        `job`, WorkLost and ConnectionError."""
        if is_quick and not is_waiting(self.count):
            return spread(job, inputs, progress=progress)
        return spread(job, inputs, workers=self.count, ray=self.ray, home=home, progress=progress)

    def stage(
        self, name: str, total: int | None = None, *, before: int = 0
    ) -> Callable[[int], None] | None:
        """Callback that counts one stage, up to `total`; None if nobody listens.

        before: number done already."""
        report = self.progress
        if report is None:
            return None
        limit = float("inf") if total is None else total
        return lambda done: report(name, int(min(limit, before + done)), total)


@dataclass(frozen=True, kw_only=True)
class Simulation(Processes):
    """Random numbers, amount of traffic and processes."""

    seed: int = 0
    """Seed of all random numbers."""
    frames: int | None = None
    """Number of frames; None for the usual number, or for all frames of a recording."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_whole("seed", self.seed, least=0)
        if self.frames is not None:
            check_whole("frames", self.frames, least=1, remedy="leave it out for the usual number")

    def frames_or(self, usual: int) -> int:
        """Number of frames, the usual number if no number is given."""
        return usual if self.frames is None else self.frames

    def part(self, number: int, frames: int | None = None) -> Self:
        """Run on another part of the traffic.

        It shares no seed with the parts of any run with a seed below a million. number: 0 for the
        traffic of this run; frames: None for as many."""
        return replace(
            self,
            seed=self.seed + PART_SEEDS * number,
            frames=self.frames if frames is None else frames,
        )


@dataclass(frozen=True, kw_only=True)
class Run(Simulation):
    """Random numbers, amount of traffic, cache and processes."""

    cache: Path | None = None
    """Folder that keeps intermediate results, so that an interrupted run resumes; None for no
    folder."""

    def __post_init__(self) -> None:
        """Turn the cache into a path. Raises ValueError if it is a file."""
        super().__post_init__()
        set_fields(self, cache=None if self.cache is None else Path(self.cache))
        if self.cache is not None and self.cache.exists() and not self.cache.is_dir():
            raise ValueError(
                f"the cache is a folder, got the file {self.cache}: give another path, or leave "
                "it out"
            )

    @cached_property
    def memo(self) -> "Cache | None":
        """The cache's one file; None without a folder."""
        from toolkit.runtime.cache import Cache

        return None if self.cache is None else Cache(self.cache / "cache.sqlite")


def check_whole(name: str, value: object, *, least: int, remedy: str = "") -> None:
    """Raise ValueError unless a number is whole and at least `least`.

    name: what errors call it; remedy: end of the error, such as what to do."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise ValueError(
            f"{name} must be a whole number of at least {least}, got "
            f"{value!r}{remedy and ': '}{remedy}"
        )
