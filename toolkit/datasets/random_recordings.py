"""Recordings of junctions drawn at random, a few frames of each: what a detector for any junction is trained on.

Every recording has a junction, sensors, and bodies of its own; a seed and its number say which.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np

from toolkit.arrays import Float32
from toolkit.frame import Frame
from toolkit.runtime.parallel import spread

if TYPE_CHECKING:
    from toolkit.bodies.fleet import Fleet
    from toolkit.sites.site import Site

FEWEST_SENSORS, MOST_SENSORS = 3, 10


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
    """Recording `number` of a seed: a random junction, three to ten random sensors, the bodies of training each a
    little stretched, traffic, noise-free measurements.

    threads: of the ray casting; fleet: bodies in place of those of training.
    Raises what drawing the site and SUMO raise.
    """
    from toolkit.bodies.body import vary
    from toolkit.bodies.fleet import catalogue
    from toolkit.rendering.renderer import Renderer
    from toolkit.sites.random import random_sensors, random_site
    from toolkit.traffic.snapshots import simulate

    rng = np.random.default_rng([seed, number])
    site = random_site(rng)
    sensors = random_sensors(site, rng, int(rng.integers(FEWEST_SENSORS, MOST_SENSORS + 1)))
    bodies = tuple(vary(body, rng) for body in catalogue()) if fleet is None else fleet.bodies(frames, rng)
    snapshots = simulate(site, bodies, frames=frames, seed=rng, once=fleet is not None)
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
    whole = all(isinstance(number, Integral) for number in (count, frames, seed))
    if not whole or min(count, frames) < 1 or seed < 0:
        raise ValueError(
            f"need at least one site and one frame, and seed >= 0, whole numbers, got {count}, {frames} and {seed}"
        )
    workers = min(count, os.cpu_count() or 1 if workers is None else workers)
    for result in spread(_Job(seed, frames, encode, fleet), range(count), workers=workers, progress=progress):
        if isinstance(result, Failed):
            warnings.warn(f"random site {result.number} of seed {seed} left out: {result.reason}", stacklevel=2)
        else:
            yield result


@dataclass(frozen=True)
class _Job:
    seed: int
    frames: int
    encode: Callable[[RandomRecording], Any]
    fleet: Fleet | None

    def __call__(self, number: int) -> Any:
        try:
            if self.fleet is None:
                return self.encode(random_recording(self.seed, number, self.frames))
            return self.encode(random_recording(self.seed, number, self.frames, fleet=self.fleet))
        except (ValueError, RuntimeError, ArithmeticError, LookupError) as error:
            return Failed(number, f"{type(error).__name__}: {error}")
