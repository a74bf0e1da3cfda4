"""Recordings of random junctions, to train a detector for any.

Each recording has a few frames. Every recording has its own junction, sensors and bodies, determined by a seed and its
number.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from toolkit.arrays import Float32
from toolkit.frame import Frame
from toolkit.runtime.code_digest import code_digest
from toolkit.runtime.parallel import spread
from toolkit.runtime.resumable import ShardFolder, make_shards

if TYPE_CHECKING:
    from toolkit.bodies.fleet import Fleet
    from toolkit.sites.site import Site

FEWEST_SENSORS, MOST_SENSORS = 3, 10
FEWEST_PARKED, MOST_PARKED = 4, 20  # range of the greatest number of parked vehicles
_NOTE = b"left out "  # start of the file of a recording that failed
_LONGEST_NOTE = 4096
_Made = TypeVar("_Made")


class RandomRecording(NamedTuple):
    """Frames of a random site. empty: each sensor's measurement without traffic, (rows, columns) m."""

    site: Site
    frames: tuple[Frame, ...]
    empty: tuple[Float32[np.ndarray, "_ _"], ...]


@dataclass(frozen=True)
class Failed:
    """A recording that could not be made, and the reason."""

    number: int
    reason: str


def random_recording(
    seed: int, number: int, frames: int, threads: int = 1, *, fleet: Fleet | None = None
) -> RandomRecording:
    """Simulate a random junction with random sensors and traffic.

    It has three to ten sensors; measurements are noise-free.

    number: of the recording under this seed; threads: of the ray casting; fleet: by default all bodies are drawn; a
    fleet that draws none has each body stretched a little. Raises the errors of drawing the site and of SUMO.
    """
    from toolkit.bodies.body import stretch_randomly
    from toolkit.bodies.fleet import fleet_named
    from toolkit.rendering.renderer import Renderer
    from toolkit.sites.random import random_sensors, random_site
    from toolkit.traffic.snapshots import MOST_OBJECTS, Mix, simulate

    rng = np.random.default_rng([seed, number])
    site = random_site(rng)
    sensors = random_sensors(site, rng, int(rng.integers(FEWEST_SENSORS, MOST_SENSORS + 1)))
    fleet = fleet_named() if fleet is None else fleet
    bodies = fleet.bodies(frames, rng)
    if not fleet.drawn:
        bodies = tuple(stretch_randomly(body, rng) for body in bodies)
    parked = int(rng.integers(FEWEST_PARKED, MOST_PARKED + 1))
    most = MOST_OBJECTS * 4 // 5 + parked
    snapshots = simulate(site, bodies, frames=frames, seed=rng, mix=Mix(most, parked), once=bool(fleet.drawn))
    renderer = Renderer(site, bodies, sensors, threads=threads)
    recorded = tuple(
        Frame(sensors, renderer.render(snapshot).measurements, snapshot.objects, snapshot.time, index)
        for index, snapshot in enumerate(snapshots)
    )
    return RandomRecording(site, recorded, renderer.background)


def random_recordings(
    count: int,
    frames: int,
    seed: int,
    encode: Callable[[RandomRecording], Any],
    *,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
    fleet: Fleet | None = None,
) -> Iterator[Any]:
    """Yield encoded random recordings in order.

    encode: called in the process that made the recording; workers: processes, one per core if None, without effect on
    the results; fleet: see `random_recording`; progress: called with the number of recordings done. A recording that
    fails is left out with a warning that says why. Few results wait in memory.
    """
    _check(count, frames, seed)
    workers = min(count, os.cpu_count() or 1 if workers is None else workers)
    for result in spread(_Job(seed, frames, encode, fleet), range(count), workers=workers, progress=progress):
        if isinstance(result, Failed):
            warnings.warn(f"random site {result.number} of seed {seed} left out: {result.reason}", stacklevel=2)
        else:
            yield result


def random_recordings_file(
    count: int,
    frames: int,
    seed: int,
    out: Path,
    *,
    encode: Callable[[RandomRecording], bytes],
    join: Callable[[Iterator[Path], Path], _Made],
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
    fleet: Fleet | None = None,
    overwrite: bool = False,
) -> _Made:
    """Write `random_recordings` to one file.

    The file is joined from one file per recording. A run that was killed continues when called again, and ends with the
    same bytes; every finished recording lies in `FILE.parts/`.

    encode: content of the file of a recording, called in the process that made it; join: called with the files in
    order and the target, its result is returned; overwrite: drop an unfinished run of another count, seed, fleet or
    code; other arguments as in `random_recordings`.

    Raises FileExistsError for such a run, and OSError, with the number of safe recordings, if the disk is full.
    """
    _check(count, frames, seed)
    workers = min(count, os.cpu_count() or 1 if workers is None else workers)
    code = code_digest(__name__, encode.__module__)[:12]
    plan = {"random sites": count, "frames": frames, "seed": seed, "fleet": _describe_fleet(fleet), "code": code}
    shards = ShardFolder(out.with_name(out.name + ".parts"), plan)
    made: list[_Made] = []
    with shards.lock(), shards.explain_disk_errors(out, lambda blocks: len(list(blocks))):
        shards.open(overwrite)
        safe = shards.check_shards()
        todo = [number for number in range(count) if number not in safe]
        tell = (lambda done: None) if progress is None else (lambda done: progress(min(count, len(safe) + done)))
        make_shards(_FileJob(seed, frames, encode, fleet), shards, todo, workers=workers, progress=tell)
        shards.publish(out, lambda paths, target: made.append(join(_without_failed(paths, seed), target)))
    return made[0]


def _without_failed(paths: list[Path], seed: int) -> Iterator[Path]:
    """Yield the files of recordings. The note of a failed recording becomes a warning."""
    for path in paths:
        content = path.read_bytes() if path.stat().st_size < _LONGEST_NOTE else b""
        if not content.startswith(_NOTE):
            yield path
            continue
        number, reason = content[len(_NOTE) :].decode().split(" ", 1)
        warnings.warn(f"random site {number} of seed {seed} left out: {reason}", stacklevel=2)


@dataclass(frozen=True)
class _FileJob:
    """One recording, or its reason for failure, as a file."""

    seed: int
    frames: int
    encode_one: Callable[[RandomRecording], bytes]
    fleet: Fleet | None

    def start(self, threads: int) -> Callable[[int], Iterator[bytes]]:
        """Return the function that makes a recording. There is nothing to prepare."""
        return lambda number: iter([self._content(number)])

    def encode(self, items: Sequence[bytes]) -> bytes:
        """Return the file as it is."""
        return items[0]

    def _content(self, number: int) -> bytes:
        made = _Job(self.seed, self.frames, self.encode_one, self.fleet)(number)
        if isinstance(made, Failed):
            return _NOTE + f"{made.number} {made.reason}".encode()[: _LONGEST_NOTE // 2]
        return made


def _describe_fleet(fleet: Fleet | None) -> str:
    """Describe a fleet. Two fleets are the same if their descriptions are equal."""
    from toolkit.bodies.fleet import fleet_named

    fleet = fleet_named() if fleet is None else fleet
    bodies = sha256()
    for body in fleet.fixed:
        bodies.update(f"{body.name} {body.label} {body.size}".encode() + body.vertices.tobytes())
    return f"{len(fleet.fixed)} {bodies.hexdigest()[:12]} drawn {list(fleet.drawn)} mirrors {fleet.mirrors}"


def _check(count: int, frames: int, seed: int) -> None:
    whole = all(isinstance(number, Integral) for number in (count, frames, seed))
    if not whole or min(count, frames) < 1 or seed < 0:
        raise ValueError(
            f"need at least one site and one frame, and seed >= 0, whole numbers, got {count}, {frames} and {seed}"
        )


@dataclass(frozen=True)
class _Job:
    seed: int
    frames: int
    encode: Callable[[RandomRecording], Any]
    fleet: Fleet | None

    def __call__(self, number: int) -> Any:
        try:
            return self.encode(random_recording(self.seed, number, self.frames, fleet=self.fleet))
        except (ValueError, RuntimeError, ArithmeticError, LookupError) as error:
            return Failed(number, f"{type(error).__name__}: {error}")
