"""Recordings of junctions drawn at random, a few frames of each: what a detector for any junction is trained on.

Every recording has a junction, sensors, and bodies of its own; a seed and its number say which.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

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
FEWEST_PARKED, MOST_PARKED = 4, 20  # vehicles a recording has at most, drawn
_NOTE = b"left out "  # begins the file of a recording that failed
_LONGEST_NOTE = 4096
_Made = TypeVar("_Made")


@dataclass(frozen=True)
class RandomRecording:
    """frames of a site, and what each of their sensors measures when nothing moves there, (rows, columns) m."""

    site: Site
    frames: tuple[Frame, ...]
    empty: tuple[Float32[np.ndarray, "_ _"], ...]


@dataclass(frozen=True)
class Failed:
    """A recording that could not be made, and why."""

    number: int
    reason: str


def random_recording(
    seed: int, number: int, frames: int, threads: int = 1, *, fleet: Fleet | None = None
) -> RandomRecording:
    """Recording `number` of a seed: a random junction, three to ten random sensors, traffic, noise-free measurements.

    threads: of the ray casting; fleet: None for everyone drawn afresh; of one that draws nobody each body is stretched
    a little.
    Raises what drawing the site and SUMO raise.
    """
    from toolkit.bodies.body import stretch_randomly
    from toolkit.bodies.fleet import fleet_named
    from toolkit.rendering.renderer import Renderer
    from toolkit.sites.random import random_sensors, random_site
    from toolkit.traffic.snapshots import MOST_OBJECTS, simulate

    rng = np.random.default_rng([seed, number])
    site = random_site(rng)
    sensors = random_sensors(site, rng, int(rng.integers(FEWEST_SENSORS, MOST_SENSORS + 1)))
    fleet = fleet_named() if fleet is None else fleet
    bodies = fleet.bodies(frames, rng)
    if not fleet.drawn:
        bodies = tuple(stretch_randomly(body, rng) for body in bodies)
    parked = int(rng.integers(FEWEST_PARKED, MOST_PARKED + 1))
    most = MOST_OBJECTS * 4 // 5 + parked
    snapshots = simulate(site, bodies, frames=frames, seed=rng, most=most, parked=parked, once=bool(fleet.drawn))
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
    """`count` random recordings of `frames` frames, in order, each as `encode` makes it in the process it was made in.

    A recording that fails is left out with a warning that says why. workers: processes, one per core when None; their
    number changes nothing but the time. fleet: see `random_recording`. progress: told how many recordings are done.
    Few results wait in memory.
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
    """`random_recordings` as one file that `join` makes of a file of each. Killed at any moment and called again it
    goes on, to the same bytes; every recording that is done lies in `FILE.parts/`.

    encode: the content of the file of a recording, made in the process that made it; join: told their files in order
    and what to write, its result is returned. overwrite: drop what is left of a run of another count, seed, fleet or
    code; other arguments as in `random_recordings`.
    Raises FileExistsError where there is such a run, OSError where the disk is full, and says how many are safe.
    """
    _check(count, frames, seed)
    workers = min(count, os.cpu_count() or 1 if workers is None else workers)
    code = code_digest(__name__, encode.__module__)[:12]
    plan = {"random sites": count, "frames": frames, "seed": seed, "fleet": _described(fleet), "code": code}
    shards = ShardFolder(out.with_name(out.name + ".parts"), plan)
    made: list[_Made] = []
    with shards.locked(), shards.disk_errors_explained(out, lambda blocks: len(list(blocks))):
        shards.open(overwrite)
        safe = shards.verified()
        todo = [number for number in range(count) if number not in safe]
        tell = (lambda done: None) if progress is None else (lambda done: progress(min(count, len(safe) + done)))
        make_shards(_FileJob(seed, frames, encode, fleet), shards, todo, workers=workers, progress=tell)
        shards.publish(out, lambda paths, target: made.append(join(_without_failed(paths, seed), target)))
    return made[0]


def _without_failed(paths: list[Path], seed: int) -> Iterator[Path]:
    """The files of recordings; of one that failed there is a note, which becomes a warning."""
    for path in paths:
        content = path.read_bytes() if path.stat().st_size < _LONGEST_NOTE else b""
        if not content.startswith(_NOTE):
            yield path
            continue
        number, reason = content[len(_NOTE) :].decode().split(" ", 1)
        warnings.warn(f"random site {number} of seed {seed} left out: {reason}", stacklevel=2)


@dataclass(frozen=True)
class _FileJob:
    """One recording, or why there is none, as one file."""

    seed: int
    frames: int
    encode_one: Callable[[RandomRecording], bytes]
    fleet: Fleet | None

    def start(self, threads: int) -> Callable[[int], Iterator[bytes]]:
        """Nothing is got ready."""
        return lambda number: iter([self._content(number)])

    def encode(self, items: Sequence[bytes]) -> bytes:
        """As it is."""
        return items[0]

    def _content(self, number: int) -> bytes:
        made = _Job(self.seed, self.frames, self.encode_one, self.fleet)(number)
        if isinstance(made, Failed):
            return _NOTE + f"{made.number} {made.reason}".encode()[: _LONGEST_NOTE // 2]
        return made


def _described(fleet: Fleet | None) -> str:
    """What must be equal for two fleets to be the same."""
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
