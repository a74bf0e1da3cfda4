"""Recordings of random junctions, a few frames each, to train a detector for any.

Every recording has its own junction, sensors and bodies, determined by a seed and its number.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from toolkit.arrays import Float32, Rng
from toolkit.frame import Frame
from toolkit.runtime.code_digest import code_digest
from toolkit.runtime.resumable import ShardFolder, make_shards
from toolkit.runtime.run import Simulation

if TYPE_CHECKING:
    from toolkit.bodies.fleet import Fleet
    from toolkit.sites.site import Site

_FRAMES = 20  # usual number, of each site
FEWEST_SENSORS, MOST_SENSORS = 3, 10
FEWEST_PARKED, MOST_PARKED = 4, 20  # range of the greatest number of parked vehicles
MOST_STRAYS = 0.7  # share of road users that are anywhere, at most
_NOTE = b"left out "  # start of the file of a recording that failed
_LONGEST_NOTE = 4096
_Made = TypeVar("_Made")


class RandomRecording(NamedTuple):
    """Frames of a random site. empty: each sensor's measurement without traffic, (rows, columns) m."""

    site: Site
    frames: tuple[Frame, ...]
    empty: tuple[Float32[np.ndarray, "_ _"], ...]


def random_recording(seed: int, number: int, frames: int, *, fleet: Fleet | None = None) -> RandomRecording:
    """Simulate a random junction with three to ten random sensors, noise-free, and random traffic. number: of the
    recording under this seed; fleet: by default all bodies are drawn; a fleet that draws none has each body stretched a
    little. Raises the errors of drawing the site and of SUMO."""
    from toolkit.sites.random import random_site

    rng = np.random.default_rng([seed, number])
    return record_randomly(random_site(rng), rng, frames, fleet=fleet)


def record_randomly(site: Site, rng: Rng, frames: int, *, fleet: Fleet | None = None) -> RandomRecording:
    """Simulate a site as `random_recording` does, with random sensors on its mounts and random traffic."""
    from toolkit.bodies.body import stretch_randomly
    from toolkit.bodies.fleet import fleet_named
    from toolkit.rendering.renderer import Renderer
    from toolkit.sites.random import random_sensors
    from toolkit.traffic.snapshots import MOST_OBJECTS, Mix, simulate

    sensors = random_sensors(site, rng, int(rng.integers(FEWEST_SENSORS, MOST_SENSORS + 1)))
    fleet = fleet_named() if fleet is None else fleet
    bodies = fleet.bodies(frames, rng)
    if not fleet.drawn:
        bodies = tuple(stretch_randomly(body, rng) for body in bodies)
    parked = int(rng.integers(FEWEST_PARKED, MOST_PARKED + 1))
    most = MOST_OBJECTS * 4 // 5 + parked
    mix = Mix(most, parked, strays=float(rng.uniform(0, MOST_STRAYS)))
    snapshots = simulate(site, bodies, frames=frames, seed=rng, mix=mix, once=bool(fleet.drawn))
    renderer = Renderer(site, bodies, sensors, threads=1)
    recorded = []
    for index, snapshot in enumerate(snapshots):
        measurements = renderer.render(snapshot).measurements
        recorded.append(Frame(sensors, measurements, snapshot.objects, snapshot.time, index))
    return RandomRecording(site, tuple(recorded), renderer.background)


def random_recordings_file(
    count: int,
    out: Path,
    *,
    run: Simulation = Simulation(workers=None),
    encode: Callable[[RandomRecording], bytes],
    join: Callable[[Iterator[Path], Path], _Made],
    fleet: Fleet | None = None,
    overwrite: bool = False,
) -> _Made:
    """Write random recordings to one file, joined from one file per recording. A run that was killed continues when
    called again, and ends with the same bytes; every finished recording lies in `FILE.parts/`. A recording that fails
    is left out with a warning that says why. run: number of frames (20 by default), seed and processes, which change no
    byte; encode: content of the file of a recording, called in the process that made it; join: called with the files in
    order and the target, its result is returned; fleet: see `random_recording`; overwrite: drop an unfinished run of
    another count, seed, fleet or code. Raises FileExistsError for such a run, and OSError, with the number of safe
    recordings, if the disk is full."""
    from toolkit.bodies.fleet import fleet_named

    if count < 1:
        raise ValueError(f"need at least one site, got {count}")
    own, bodies = fleet_named() if fleet is None else fleet, sha256()
    for body in own.fixed:
        bodies.update(f"{body.name} {body.label} {body.size}".encode() + body.vertices.tobytes())
    described = f"{len(own.fixed)} {bodies.hexdigest()[:12]} drawn {list(own.drawn)} mirrors {own.mirrors}"
    frames, code = run.frames_or(_FRAMES), code_digest(__name__, encode.__module__)[:12]
    plan = {"random sites": count, "frames": frames, "seed": run.seed, "fleet": described, "code": code}
    shards = ShardFolder(out.with_name(out.name + ".parts"), plan)
    with shards.lock(), shards.explain_disk_errors(out, len):
        shards.open(overwrite)
        report = run.stage("sites drawn", count, before=len(shards.check_shards()))
        job = _Job(run.seed, frames, encode, fleet)
        make_shards(job, shards, range(count), workers=run.count, ray=run.ray, progress=report)
        return shards.publish(out, lambda paths, target: join(_without_failed(paths, run.seed), target))


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
class _Job:
    """One recording, or its reason for failure, as a file."""

    seed: int
    frames: int
    encode_one: Callable[[RandomRecording], bytes]
    fleet: Fleet | None

    def start(self, threads: int) -> Callable[[int], Iterator[bytes]]:
        def make(number: int) -> Iterator[bytes]:
            try:
                yield self.encode_one(random_recording(self.seed, number, self.frames, fleet=self.fleet))
            except (ValueError, RuntimeError, ArithmeticError, LookupError) as error:
                yield _NOTE + f"{number} {type(error).__name__}: {error}".encode()[: _LONGEST_NOTE // 2]

        return make

    def encode(self, items: Sequence[bytes]) -> bytes:
        return items[0]
