"""Traffic on a site: SUMO drives, rides and walks; every few seconds a `Snapshot` says what is where.

As in the paper's dataset, a spawned object is a car, a two-wheeler or a pedestrian with probability 0.6, 0.2 and 0.2
(8 % of the cars are heavy vehicles), at most 30 objects exist, and each is seen in four frames, 5 s apart, before
another takes its place. Classes without bodies, or without lanes of their own near the area (pedestrians, where there
is no footway), are left out and the other probabilities grow in proportion. Parked vehicles are drawn for the bays;
they count among the 30, a fifth of them at most by default, and stay longer. A share of all may be `Strays`. Boxes that
overlap are moved aside or dropped.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import shapely

from toolkit.arrays import Float64, Int64
from toolkit.boxes import footprints
from toolkit.objects import VEHICLE, Objects
from toolkit.sites.site import Site
from toolkit.traffic.obstacles import Obstacles, separate
from toolkit.traffic.spawner import Spawner, Supply
from toolkit.traffic.strays import Strays
from toolkit.traffic.sumo import FINE_STEP, STEP, running

if TYPE_CHECKING:
    from toolkit.bodies.body import Body

_Boxes = Float64[np.ndarray, "n 7"]
STAY = 20.0  # frames, mean
ROOM = (5.8, 2.4, 2.0)  # m, length, width and height a bay must offer
OCCUPIED = (0.3, 0.9)  # share of the bays, from .. to
JITTER = (0.1, 0.1, np.radians(1.0))  # m, m, rad; how far off the middle of the bay


@dataclass(frozen=True, eq=False)
class Parked:
    """Parked vehicles, and the bays (x, y, yaw) of the site: bay, body, id and pose (x, y, yaw) of each."""

    bays: Float64[np.ndarray, "m 3"]
    places: Int64[np.ndarray, " n"]
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: Float64[np.ndarray, "n 3"]

    @staticmethod
    def draw(site: Site, obstacles: Obstacles, supply: Supply, *, most: int) -> Parked:
        """Park vehicles in a random share of the free bays, `most` at most."""
        x, y, yaw = site.parking.T
        room = np.column_stack([x, y, np.full((len(x), 4), (ROOM[2] / 2, *ROOM)), yaw])
        bays = site.parking[~obstacles.hit(room)]
        number = min(round(len(bays) * supply.rng.uniform(*OCCUPIED)), most)
        places, nobody = supply.rng.permutation(len(bays))[:number], np.zeros(number, np.int64)
        return Parked(bays, places, nobody, nobody, np.zeros((number, 3)))._refill(np.ones(number, bool), supply)

    def later(self, supply: Supply) -> Parked:
        """Parked vehicles a frame later: each has left with probability 1 / `STAY`, another stands in a free bay."""
        return self._refill(supply.rng.random(len(self.ids)) < 1 / STAY, supply)

    def boxes(self, supply: Supply) -> _Boxes:
        """Boxes on level ground, (n, 7)."""
        sizes = supply.sizes[self.bodies]
        return np.column_stack([self.poses[:, :2], sizes[:, 2] / 2, sizes, self.poses[:, 2]])

    def _refill(self, left: np.ndarray, supply: Supply) -> Parked:
        if not left.any():
            return self
        rng, number = supply.rng, int(left.sum())
        parked = replace(self, **{k: getattr(self, k).copy() for k in ("places", "bodies", "ids", "poses")})
        free = np.setdiff1d(np.arange(len(self.bays)), self.places[~left])
        parked.places[left] = rng.permutation(free)[:number]
        parked.bodies[left] = supply.several(np.flatnonzero(supply.labels == VEHICLE), number)
        parked.ids[left] = [next(supply.ids) for _ in range(number)]
        off_centre = JITTER * np.clip(rng.standard_normal((number, 3)), -1.5, 1.5)
        parked.poses[left] = self.bays[parked.places[left]] + off_centre
        parked.poses[left, 2] += np.pi * rng.integers(2, size=number)  # nose or tail first
        return parked


INTERVAL = 5.0  # s between frames
MOST_OBJECTS = 30
MARGIN = 10.0  # m round the area within which objects belong to a snapshot: they occlude, and the edge cuts them
WARM_UP = 15.0  # s before the first frame
COMING_AND_GOING = 8  # times `INTERVAL` more before frames closer together: at first all stand in the queues they fill


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One instant of traffic, site frame."""

    objects: Objects  # all that touch the area or the `MARGIN` around it, so some centres lie outside the area
    bodies: Int64[np.ndarray, " n"]  # row of each object in the bodies given to `simulate`
    time: float = 0.0  # s since the first frame
    repaired: int = 0  # objects moved aside or taken out because bodies overlapped


@dataclass(frozen=True)
class Mix:
    """Shares of moving and parked objects. Raises ValueError for impossible numbers."""

    most: int = MOST_OBJECTS  # at a time
    parked: int | None = None  # vehicles among them that park, a fifth at most by default
    stay: int | None = None  # frames until all stand in other bays, for independent blocks; None: each on its own
    strays: float = 0.0  # share of all that is anywhere, whatever its class, see `toolkit.traffic.strays`

    def __post_init__(self) -> None:
        if self.most < 1:
            raise ValueError(f"most must be at least 1, got {self.most}")
        if self.parked is not None and not 0 <= self.parked <= self.most:
            raise ValueError(f"parked must lie in 0..most {self.most}, got {self.parked}")
        if self.stay is not None and self.stay < 1:
            raise ValueError(f"stay must be one frame or more, got {self.stay}")
        if not 0 <= self.strays <= 1:
            raise ValueError(f"strays must be a share from 0 to 1, got {self.strays}")

    @property
    def most_parked(self) -> int:
        """Largest number of parked vehicles."""
        return self.most // 5 if self.parked is None else self.parked


def simulate(
    site: Site,
    bodies: Sequence[Body],
    *,
    frames: int,
    seed: int | np.random.Generator,
    interval: float = INTERVAL,
    mix: Mix | None = None,
    once: bool = False,
) -> Generator[Snapshot, None, None]:
    """Simulate `frames` snapshots of traffic on a site, `interval` (s) apart.

    Below 1 s objects live as long as ever, in more frames. once: no body is used again before all of its class have
    been, as is right for a fleet drawn afresh; some pedestrians walk in groups then. Same seed, same bytes. One
    simulation runs at a time in a process: use up or close() the iterator before the next.

    Raises ValueError where the site has no network, nothing can drive near its area, or an argument does not fit;
    ImportError without SUMO; RuntimeError where another simulation is open.
    """
    if not site.network:
        raise ValueError(f"site {site.name!r} has no network, so no traffic: import one from a map, or build_network")
    if frames < 0:
        raise ValueError(f"frames must be at least 0, got {frames}")
    step, mix = sumo_step(interval), mix or Mix()
    if not any(body.label == VEHICLE for body in bodies):
        raise ValueError(f"bodies must hold at least one vehicle, got {len(bodies)} bodies: pass catalogue()")
    obstacles, supply = Obstacles(site), Supply(bodies, np.random.default_rng(seed), once=once)
    draw = partial(Parked.draw, site, obstacles, supply, most=mix.most_parked)

    def run() -> Generator[Snapshot, None, None]:
        parked, periods = draw(), 0
        standing = len(parked.ids) if mix.stay is None else min(len(parked.bays), mix.most_parked)
        wander = partial(Strays.draw, site, obstacles, supply, round(mix.strays * (mix.most - standing)))
        strays = wander(parked.boxes(supply))
        types, sumo_seed = supply.sumo_types(), int(supply.rng.integers(2**31 - 1))
        with running(site.network, types, seed=sumo_seed, step=step) as sumo:
            spawner = Spawner(sumo, site, supply, most=mix.most - standing - len(strays.ids), step=step)
            look = partial(_snapshot, site, spawner, obstacles)
            spawner.advance(WARM_UP)
            for _ in range(COMING_AND_GOING if step < STEP else 0):
                look(parked, strays, time=0.0)
                spawner.advance(INTERVAL)
            for index in range(frames):
                passed, at = (int((index + k) * interval / INTERVAL + 1e-6) for k in (0, 1))
                last = interval >= STEP or at > passed  # of an `INTERVAL`, by which parking and life are counted
                yield look(parked, strays, time=index * interval, counts=last)
                if last:
                    periods += 1
                    if mix.stay is None:
                        parked = parked.later(supply)
                    elif periods % mix.stay == 0:
                        parked = draw()
                    strays = strays.later(supply, (index + 1) * interval)
                spawner.advance(interval)

    return run()


def sumo_step(interval: float) -> float:
    """Step of SUMO (s) for an interval of frames. Raises ValueError unless the interval is a whole number of steps."""
    step = STEP if interval >= STEP else FINE_STEP
    steps = interval / step
    if not (0.5 < steps < 1e6 and abs(steps - round(steps)) < 1e-6):
        raise ValueError(f"interval must be a whole number of SUMO's steps of {STEP} or {FINE_STEP} s, got {interval}")
    return step


def _snapshot(
    site: Site,
    spawner: Spawner,
    obstacles: Obstacles,
    parked: Parked,
    strays: Strays,
    *,
    time: float,
    counts: bool = True,
) -> Snapshot:
    """Objects near the area now; those that cannot be kept apart are removed. counts: note that they were seen."""
    standing, last = (parked.ids, parked.bodies, parked.poses), (strays.ids, strays.bodies, strays.at(time))
    ids, bodies, poses = (
        np.concatenate(all_of_them) for all_of_them in zip(standing, spawner.state(), last, strict=True)
    )
    sizes = spawner.supply.sizes[bodies]
    yaw = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    boxes = np.column_stack([poses[:, :2], sizes[:, 2] / 2, sizes, yaw])
    boxes, kept, repaired = separate(boxes, obstacles)
    spawner.remove(ids[~kept])
    near = shapely.box(*(site.area + MARGIN * np.array([-1, -1, 1, 1])))
    seen = np.flatnonzero(kept)[shapely.intersects(shapely.polygons(footprints(boxes[kept])), near)]
    if counts:
        spawner.count_frame(ids[seen])
    boxes, bodies, ids = boxes[seen], bodies[seen], ids[seen]
    boxes[:, 2] += site.ground(footprints(boxes)).mean(axis=1)
    return Snapshot(Objects(boxes, spawner.supply.labels[bodies], ids), bodies, time, repaired)
