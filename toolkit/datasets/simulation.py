"""Simulated datasets: traffic, rendered frame by frame, in a run that may be killed at any moment.

Frames are made in blocks of `FRAMES_PER_BLOCK` with different seeds, so neither the number of
workers nor an interruption changes a byte. A finished block is one shard, a complete small dataset,
in `FILE.parts/`; the last step joins them.

Recordings of random junctions, a few frames each, train a detector for any junction. The junction,
sensors and bodies of every recording follow from a seed and its number."""

import json
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import h5py
import numpy as np

from toolkit.arrays import Float32, Int64, Rng
from toolkit.bodies.body import Body, stretch_randomly
from toolkit.bodies.fleet import Fleet, fleet_named
from toolkit.datasets.recording_file import RECORDING_SCHEMA, Header, Scene, encode, join
from toolkit.frame import Frame
from toolkit.objects import LABELS
from toolkit.runtime.cache import code_digest
from toolkit.runtime.resumable import Plan, ShardFolder, describe_differences, make_shards
from toolkit.runtime.run import Simulation
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site, load_site
from toolkit.sites.random import random_sensors, random_site
from toolkit.sites.site import Site
from toolkit.traffic.continuous import ContinuousTraffic, simulate_continuously
from toolkit.traffic.snapshots import (
    INTERVAL,
    MOST_OBJECTS,
    Mix,
    check_interval,
    simulate,
    take_continuous,
)
from toolkit.traffic.supply import Supply

if TYPE_CHECKING:
    from toolkit.rendering.renderer import Renderer

DEFAULT_FRAMES = 1000
FRAMES_PER_BLOCK = 50  # frames drawn with one seed
_SITE_FRAMES = 20  # for each site, by default
MIN_RANDOM_SENSORS = 3
MAX_RANDOM_SENSORS = 10
MIN_PARKED = 4  # lower bound of the maximum number of parked vehicles
MAX_PARKED = 20  # upper bound of the maximum number of parked vehicles
MAX_STRAY_SHARE = 0.7  # share of road users that are anywhere
_NOTE = b"left out "  # start of the file of a recording that failed
_MAX_NOTE_BYTES = 4096
_Made = TypeVar("_Made")


def simulate_dataset(
    site: Site | str | Path,
    out: str | Path,
    *,
    run: Simulation = Simulation(workers=None),
    sensors: Sequence[Sensor] | None = None,
    fleet: Fleet | None = None,
    interval: float = INTERVAL,
    mix: Mix = Mix(),
    overwrite: bool = False,
) -> int:
    """Simulate frames at a site and write them to HDF5.

    `toolkit.datasets.dataset.CoopDataset` reads the file. A run that was killed continues with its
    block when called again, and ends with the same bytes.

    site: a site, the name of a built-in one, or the path of a saved one; run: number of frames
    (`DEFAULT_FRAMES` by default), seed and processes, which change no byte; with several, a script
    must call it under `if __name__ == "__main__":`; sensors: None for the site's; fleet: all bodies
    drawn by default, again for every block of frames; interval: seconds between frames, 5 or e.g.
    0.1; traffic is continuous below 1 s, else it restarts every `FRAMES_PER_BLOCK` frames; mix:
    who is on the roads; overwrite: replace a file, or drop an unfinished run, of another plan.

    Returns the number of frames simulated now: 0 if `out` was complete already. Raises ValueError
    for arguments that do not fit; FileExistsError if `out`, or an unfinished run, has another plan;
    OSError, with the number of frames that are safe, if the disk is full."""
    site = site if isinstance(site, Site) else load_site(site)
    placed_sensors = tuple(site.sensors if sensors is None else sensors)
    frames = int(run.frames_or(DEFAULT_FRAMES))
    job = Job(
        site=site,
        sensors=placed_sensors,
        fleet=fleet_named() if fleet is None else fleet,
        frames=frames,
        seed=int(run.seed),
        interval=float(interval),
        mix=mix,
    )
    out = Path(os.path.realpath(out))  # the target of a link is written
    shards = ShardFolder(out.with_name(out.name + ".parts"), job.plan)
    if out.exists() and not overwrite:
        _check_same(out, job.plan)
        if shards.path.is_dir():  # killed during clean-up
            with shards.lock():
                shards.remove()
        return 0
    out.parent.mkdir(parents=True, exist_ok=True)
    with shards.lock(), shards.explain_disk_errors(out, job.count):
        shards.open(overwrite)
        made_before = job.count(shards.check_shards())
        if job.is_continuous:
            job = job.with_traffic(run.stage("seconds of traffic", job.seconds))
        report = run.stage("frames simulated", frames, before=made_before)
        make_shards(job, shards, range(job.blocks), workers=run.count, ray=run.ray, progress=report)
        shards.publish(out, lambda paths, target: join(job.header, paths, target))
    return frames - made_before


@dataclass(frozen=True)
class Job:
    """Plan of a dataset; sent to every worker.

    Attributes:
        site: the site.
        sensors: its sensors.
        fleet: bodies of the road users.
        frames: number of frames.
        seed: seed of all random numbers.
        interval: time between frames (s).
        mix: who is on the roads.
        bodies: bodies of continuous traffic, once it is simulated.
        traffic: all its frames, once it is simulated.
    """

    site: Site
    sensors: tuple[Sensor, ...]
    fleet: Fleet
    frames: int
    seed: int
    interval: float = INTERVAL
    mix: Mix = Mix()
    bodies: tuple[Body, ...] = ()
    traffic: ContinuousTraffic | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for an impossible interval or share, and for no or misnamed sensors."""
        check_interval(self.interval)
        if self.is_continuous:
            self.mix.check_continuous()
        if not self.sensors:
            remedy = "coview plan or coview search --out says which to build, coview site import"
            raise ValueError(
                f"site {self.site.name!r} has no sensors: {remedy} --sensors N places some"
            )
        names = [sensor.name for sensor in self.sensors]
        for name in names:
            # names become names of datasets in the file
            if names.count(name) > 1 or "/" in name or name in ("", "."):
                raise ValueError(f"sensors must have different names without '/', got {names}")

    @property
    def is_continuous(self) -> bool:
        """True if road users come in at the border and leave there."""
        return self.mix.is_continuous(self.interval)

    @property
    def seconds(self) -> int:
        """Whole seconds from the first to the last frame, 1 or more."""
        return max(1, int((self.frames - 1) * self.interval))

    def with_traffic(self, progress: Callable[[int], None] | None = None) -> "Job":
        """Return the job with its bodies, and all frames of its continuous traffic simulated.

        progress: called with the number of simulated seconds."""
        rng = np.random.default_rng([self.seed, 2])
        bodies = self.fleet.bodies(self.frames, rng)
        supply = Supply(bodies, rng, once=bool(self.fleet.drawn))
        traffic = simulate_continuously(
            self.site,
            supply,
            frames=self.frames,
            interval=self.interval,
            max_parked=self.mix.most_parked,
            flow=self.mix.demand,
            progress=progress,
        )
        return replace(self, bodies=bodies, traffic=traffic)

    @property
    def blocks(self) -> int:
        """Number of blocks; the last may be shorter."""
        return -(-self.frames // FRAMES_PER_BLOCK)  # rounded up

    def block_frames(self, block: int) -> range:
        """Return the indices of a block's frames in the recording."""
        return range(block * FRAMES_PER_BLOCK, min((block + 1) * FRAMES_PER_BLOCK, self.frames))

    def count(self, blocks: Iterable[int]) -> int:
        """Return the number of frames in blocks with these numbers."""
        return sum(len(self.block_frames(block)) for block in blocks)

    @cached_property
    def plan(self) -> dict[str, object]:
        """Values that decide the bytes of the file, by the names that errors show.

        Two runs with equal plans make equal files."""
        sensor_digests = [[sensor.name, sensor.digest] for sensor in self.sensors]
        plan: dict[str, object] = {
            "site": f"{self.site.name} {_digest(format_site(self.site))}",
            "frames": int(self.frames),
            "seed": int(self.seed),
            "sensors": f"{len(self.sensors)} {_digest(json.dumps(sensor_digests))}",
            "bodies": describe_fleet(self.fleet),
            "schema": RECORDING_SCHEMA,
        }
        # only if they differ from their defaults, so that plans of older files stay equal
        if self.interval != INTERVAL:
            plan["interval"] = self.interval
        if self.is_continuous:
            demand = self.mix.demand
            plan["flow"] = "drawn" if demand is None else _digest(demand.text())
        if self.mix.strays:
            plan["strays"] = self.mix.strays
        usual_mix = Mix()
        # largest numbers of objects, and of parked ones among them
        if (self.mix.most, self.mix.most_parked) != (usual_mix.most, usual_mix.most_parked):
            plan["objects"] = f"{self.mix.most}, {self.mix.most_parked} of them parked"
        if self.mix.stay is not None:
            plan["parked for"] = self.mix.stay
        return plan

    @property
    def header(self) -> Header:
        """Header of the file, shared by all frames."""
        return Header(
            site=self.site,
            sensors=self.sensors,
            bodies=self.fleet.names,
            plan=json.dumps(self.plan),
        )

    def start(self, threads: int) -> Callable[[int], Iterator[Scene]]:
        """Build the static parts, once per process; return a function that makes a block's scenes.

        threads: threads of ray casting; the returned function takes the number of a block."""
        from toolkit.rendering.renderer import Renderer

        # all blocks share the site and the fixed bodies
        fixed_renderer = Renderer(self.site, self.fleet.fixed, self.sensors, threads=threads)
        if self.traffic is None:
            return partial(self._make_scenes, fixed_renderer)
        renderer = fixed_renderer.with_bodies(self.bodies) if self.fleet.drawn else fixed_renderer
        return partial(self._make_continuous_scenes, renderer, self._index_bodies(self.bodies))

    def _index_bodies(self, bodies: Sequence[Body]) -> Int64[np.ndarray, " n"]:
        """Index of each body in `self.fleet.names`, the file's list of bodies."""
        index_of_name = {name: index for index, name in enumerate(self.fleet.names)}
        return np.array([index_of_name[body.name] for body in bodies])

    def _make_scenes(self, fixed_renderer: "Renderer", block: int) -> Iterator[Scene]:
        """Simulate and render the scenes of a block of frames, one after the other.

        A block depends only on its number, so that blocks can be made in any order. fixed_renderer:
        renderer of the fleet's fixed bodies; block: number of the block."""
        seed = int(np.random.default_rng([self.seed, block]).integers(2**31))
        frames = self.block_frames(block)
        renderer = fixed_renderer
        # index in `self.fleet.names`, the file's list of bodies, of each of the renderer's bodies
        body_indices = np.arange(len(self.fleet.fixed))
        if self.fleet.drawn:
            rng = np.random.default_rng([self.seed, block, 1])
            bodies = self.fleet.bodies(len(frames), rng)
            renderer = fixed_renderer.with_bodies(bodies)
            body_indices = self._index_bodies(bodies)
        traffic = partial(simulate, self.site, interval=self.interval, mix=self.mix)
        once = bool(self.fleet.drawn)  # no body twice before all of its class
        snapshots = traffic(renderer.bodies, frames=len(frames), seed=seed, once=once)
        for index, snapshot in zip(frames, snapshots, strict=True):
            # a block has fewer than a million tracks, so that ids differ from block to block
            objects = replace(snapshot.objects, ids=snapshot.objects.ids + block * 1_000_000)
            frame = Frame(
                sensors=self.sensors,
                measurements=renderer.render(snapshot).measurements,
                objects=objects,
                time=block * FRAMES_PER_BLOCK * self.interval + snapshot.time,
                index=index,
            )
            yield Scene(frame, bodies=body_indices[snapshot.bodies])

    def _make_continuous_scenes(
        self, renderer: "Renderer", body_indices: Int64[np.ndarray, " n"], block: int
    ) -> Iterator[Scene]:
        """Render the scenes of a block of continuous traffic.

        renderer: renderer of all bodies; body_indices: index of each in the file's list; block:
        number of the block."""
        assert self.traffic is not None
        for index in self.block_frames(block):
            snapshot = take_continuous(self.traffic, index)
            frame = Frame(
                sensors=self.sensors,
                measurements=renderer.render(snapshot).measurements,
                objects=snapshot.objects,
                time=snapshot.time,
                index=index,
            )
            yield Scene(frame, bodies=body_indices[snapshot.bodies])

    def encode(self, scenes: Sequence[Scene]) -> bytes:
        """Return the bytes of a shard, a complete file of some scenes."""
        return encode(self.header, scenes)


def describe_fleet(fleet: Fleet) -> str:
    """Describe a fleet in words for plans; the words are equal for fleets of the same bodies."""
    fixed_bodies = sha256()
    for body in fleet.fixed:
        truth = "" if body.truth is None else f" {body.truth}"  # its size if the mesh differs
        fixed_bodies.update(f"{body.name} {body.label}{truth}".encode())
        fixed_bodies.update(body.vertices.tobytes() + body.triangles.tobytes())
    words = f"{len(fleet.fixed)} {fixed_bodies.hexdigest()[:12]}"
    if not fleet.drawn:
        return words
    # drawn bodies follow from the code that draws them
    code = code_digest("toolkit.bodies.drawn_bodies")[:12]
    mirrors = "with" if fleet.mirrors else "without"
    how = "drawn evenly" if fleet.evenly else "drawn"
    classes = " ".join(LABELS[label] for label in fleet.drawn)
    return f"{words} and {how} {classes} {mirrors} mirrors {code}"


def _check_same(out: Path, plan: Plan) -> None:
    """Raise FileExistsError unless the finished file `out` was made from `plan`."""
    try:
        with h5py.File(out) as file:
            made_from = json.loads(file["coview"].attrs["plan"])
            differences = describe_differences(made_from, plan)
    except (OSError, KeyError, ValueError):
        obstacle = "but is no complete file of coview simulate"
    else:
        obstacle = f"made from {differences}" if differences else ""
    if obstacle:
        raise FileExistsError(f"{out} exists, {obstacle}: write to another file, or --overwrite it")


def _digest(text: str) -> str:
    # First 12 hexadecimal digits of a text's SHA-256, enough to tell plans apart.
    return sha256(text.encode()).hexdigest()[:12]


class RandomRecording(NamedTuple):
    """Frames of a random site.

    empty: each sensor's image (rows, columns; m, 0 for no return) of the site without traffic."""

    site: Site
    frames: tuple[Frame, ...]
    empty: tuple[Float32[np.ndarray, "_ _"], ...]


def random_recording(
    seed: int,
    number: int,
    frames: int,
    *,
    fleet: Fleet | None = None,
    sites: Sequence[str | Path] = (),
) -> RandomRecording:
    """Simulate a random junction with random sensors, noise-free, and random traffic.

    number: number of the recording under this seed; frames: number of frames; fleet: by default
    all bodies are drawn; if a fleet draws no bodies, each body is stretched a little; sites: files
    to take in turn instead of drawing junctions. Raises the errors of the sites and of SUMO."""
    rng = np.random.default_rng([seed, number])
    site = load_site(sites[number % len(sites)]) if sites else random_site(rng)
    return record_randomly(site, rng, frames, fleet=fleet)


def record_randomly(
    site: Site, rng: Rng, frames: int, *, fleet: Fleet | None = None
) -> RandomRecording:
    """Simulate a site with random sensors on its mounts and random traffic, noise-free.

    rng: all random numbers come from it; frames: number of frames; fleet: by default all bodies are
    drawn; if a fleet draws no bodies, each body is stretched a little."""
    from toolkit.rendering.renderer import Renderer

    # the order of the draws from `rng` decides the recording
    sensor_count = int(rng.integers(MIN_RANDOM_SENSORS, MAX_RANDOM_SENSORS + 1))
    sensors = random_sensors(site, rng, sensor_count)
    fleet = fleet_named() if fleet is None else fleet
    bodies = fleet.bodies(frames, rng)
    if not fleet.drawn:
        bodies = tuple(stretch_randomly(body, rng) for body in bodies)
    max_parked = int(rng.integers(MIN_PARKED, MAX_PARKED + 1))
    max_objects = MOST_OBJECTS * 4 // 5 + max_parked
    strays = float(rng.uniform(0, MAX_STRAY_SHARE))
    mix = Mix(max_objects, parked=max_parked, strays=strays)
    snapshots = simulate(site, bodies, frames=frames, seed=rng, mix=mix, once=bool(fleet.drawn))
    renderer = Renderer(site, bodies, sensors, threads=1)
    recorded_frames = []
    for index, snapshot in enumerate(snapshots):
        frame = Frame(
            sensors=sensors,
            measurements=renderer.render(snapshot).measurements,
            objects=snapshot.objects,
            time=snapshot.time,
            index=index,
        )
        recorded_frames.append(frame)
    return RandomRecording(site, frames=tuple(recorded_frames), empty=renderer.background)


def random_recordings_file(
    count: int,
    out: Path,
    *,
    run: Simulation = Simulation(workers=None),
    encode: Callable[[RandomRecording], bytes],
    join: Callable[[Iterator[Path], Path], _Made],
    fleet: Fleet | None = None,
    sites: Sequence[str | Path] = (),
    overwrite: bool = False,
) -> _Made:
    """Write random recordings to one file, joined from one file per recording.

    A run that was killed continues when called again, and ends with the same bytes; every finished
    recording is in `FILE.parts/`. A recording that fails is left out with a warning that gives the
    reason. run: number of frames (20 by default), seed and processes, which change no byte; encode:
    content of a recording's file, called in the process that made it; join: called with the files
    in order and the target, its result is returned; fleet, sites: see `random_recording`;
    overwrite: drop an unfinished run of another count, seed, fleet, site or code. Raises
    FileExistsError for such a run, and OSError, with the number of safe recordings, if the disk is
    full."""
    if count < 1:
        raise ValueError(f"need at least one site, got {count}")
    frames = run.frames_or(_SITE_FRAMES)
    plan = {
        "random sites": count,
        "frames": frames,
        "seed": run.seed,
        "fleet": describe_fleet(fleet_named() if fleet is None else fleet),
        "code": code_digest(__name__, encode.__module__)[:12],
    }
    if sites:
        plan["sites"] = _digest(" ".join(format_site(load_site(site)) for site in sites))
    shards = ShardFolder(out.with_name(out.name + ".parts"), plan)
    with shards.lock(), shards.explain_disk_errors(out, len):
        shards.open(overwrite)
        report = run.stage("sites drawn", count, before=len(shards.check_shards()))
        job = _Job(seed=run.seed, frames=frames, encode_one=encode, fleet=fleet, sites=tuple(sites))
        make_shards(job, shards, range(count), workers=run.count, ray=run.ray, progress=report)
        return shards.publish(
            out, lambda paths, target: join(_without_failed(paths, run.seed), target)
        )


def _without_failed(paths: list[Path], seed: int) -> Iterator[Path]:
    """Yield the files of recordings; warn of each recording that failed.

    paths: files, a note with the reason in place of a failed recording; seed: seed of all
    recordings, for the warning."""
    for path in paths:
        content = path.read_bytes() if path.stat().st_size < _MAX_NOTE_BYTES else b""
        if not content.startswith(_NOTE):
            yield path
            continue
        # a long reason is cut, perhaps within a letter
        number, reason = content[len(_NOTE) :].decode(errors="ignore").split(" ", 1)
        warnings.warn(f"random site {number} of seed {seed} left out: {reason}", stacklevel=2)


@dataclass(frozen=True)
class _Job:
    """One recording, or its reason for failure, as a file."""

    seed: int
    frames: int
    encode_one: Callable[[RandomRecording], bytes]
    fleet: Fleet | None
    sites: tuple[str | Path, ...] = ()

    def start(self, threads: int) -> Callable[[int], Iterator[bytes]]:
        return self._make

    def _make(self, number: int) -> Iterator[bytes]:
        """Yield the content of one file: the recording of a number, or a note why it failed."""
        try:
            recording = random_recording(
                self.seed, number, self.frames, fleet=self.fleet, sites=self.sites
            )
            yield self.encode_one(recording)
        except (ValueError, RuntimeError, ArithmeticError, LookupError) as error:
            reason = f"{number} {type(error).__name__}: {error}"
            yield _NOTE + reason.encode()[: _MAX_NOTE_BYTES // 2]

    def encode(self, items: Sequence[bytes]) -> bytes:
        return items[0]
