"""Traffic on a site: SUMO drives, rides and walks; a `Snapshot` every few seconds.

As in the paper's dataset, a spawned object is a car, a two-wheeler or a pedestrian with probability
0.6, 0.2 and 0.2 (8 % of the cars are heavy vehicles), at most 30 objects exist, and each is seen in
four frames, 5 s apart, before another takes its place. Classes without bodies, or without lanes
near the area (pedestrians, if there is no footway), are left out and the other probabilities grow
in proportion. Parked vehicles are drawn for the bays; they count among the 30, a fifth of them at
most by default, and stay longer. Boxes that overlap are moved aside or dropped. A share of all may
be `Strays`."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
import shapely

from toolkit.arrays import Int64, Rng
from toolkit.bodies.body import Body
from toolkit.boxes import footprints
from toolkit.objects import VEHICLE, Objects
from toolkit.sites.site import Site
from toolkit.traffic.continuous import ContinuousTraffic, simulate_continuously
from toolkit.traffic.flow import Flow
from toolkit.traffic.obstacles import Obstacles, place_boxes, separate
from toolkit.traffic.parked import Parked
from toolkit.traffic.road_lanes import outline_view
from toolkit.traffic.spawner import Spawner
from toolkit.traffic.strays import Strays
from toolkit.traffic.sumo import FINE_STEP_S, STEP_S, running
from toolkit.traffic.supply import Supply

INTERVAL = 5.0  # s between frames
MOST_OBJECTS = 30
WARM_UP = 15.0  # s before the first frame


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One instant of traffic, site frame.

    Attributes:
        objects: all that touch the area or `VIEW_MARGIN_M` around it, so some centres are outside
            the area.
        bodies: for each object, the row of its body among the bodies given to `simulate`.
        time: seconds since the first frame.
        repaired: number of objects moved aside or taken out because bodies overlapped."""

    objects: Objects
    bodies: Int64[np.ndarray, " n"]
    time: float = 0.0
    repaired: int = 0


@dataclass(frozen=True)
class Mix:
    """Numbers of objects on the roads, or the demand of continuous traffic.

    Raises ValueError for impossible numbers, and for strays in continuous traffic.

    Attributes:
        most: largest number of objects at a time.
        parked: largest number of parked vehicles among them; None for a fifth.
        stay: frames until all parked vehicles are replaced, for independent blocks; None if each
            leaves at random.
        strays: share of the objects that are anywhere, whatever their class, see
            `toolkit.traffic.strays`.
        flow: demand of continuous traffic (`toolkit.traffic.continuous`), "drawn" to draw it; None
            for continuous traffic, with a drawn demand, only below 1 s between frames. Of the
            numbers only that of parked vehicles counts then."""

    most: int = MOST_OBJECTS
    parked: int | None = None
    stay: int | None = None
    strays: float = 0.0
    flow: Flow | Literal["drawn"] | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is out of range."""
        if self.most < 1:
            raise ValueError(f"most must be at least 1, got {self.most}")
        if self.parked is not None and not 0 <= self.parked <= self.most:
            raise ValueError(f"parked must lie in 0..most {self.most}, got {self.parked}")
        if self.stay is not None and self.stay < 1:
            raise ValueError(f"stay must be one frame or more, got {self.stay}")
        if not 0 <= self.strays <= 1:
            raise ValueError(f"strays must be a share from 0 to 1, got {self.strays}")
        if self.flow is not None:
            self.check_continuous()

    def is_continuous(self, interval: float) -> bool:
        """True if road users come in at the border and leave there.

        interval: time between frames (s)."""
        return self.flow is not None or interval < STEP_S

    def check_continuous(self) -> None:
        """Raise ValueError for strays, which are no part of continuous traffic."""
        if self.strays:
            raise ValueError(
                f"strays are no part of continuous traffic, got a share of {self.strays:g}: leave "
                "them out, or take frames 5 s apart without a flow"
            )

    @property
    def demand(self) -> Flow | None:
        """Demand of continuous traffic, None to draw it."""
        return self.flow if isinstance(self.flow, Flow) else None

    @property
    def most_parked(self) -> int:
        """Largest number of parked vehicles."""
        return self.most // 5 if self.parked is None else self.parked


def simulate(
    site: Site,
    bodies: Sequence[Body],
    *,
    frames: int,
    seed: int | Rng,
    interval: float = INTERVAL,
    mix: Mix | None = None,
    once: bool = False,
) -> Generator[Snapshot, None, None]:
    """Simulate `frames` snapshots of traffic on a site, `interval` (s) apart.

    Below 1 s, and with a flow in `mix`, traffic is continuous (`toolkit.traffic.continuous`): road
    users come in at the border of the network and leave there. once: no body is used again before
    all of its class have been, as is right for a fleet drawn for one recording; some pedestrians
    walk in groups then. Same seed, same bytes. One simulation runs at a time in a process: use up
    or close() the iterator before the next.

    Raises ValueError if the site has no network, nothing can drive near its area, or an argument
    does not fit; ImportError without SUMO; RuntimeError if another simulation is open."""
    if not site.network:
        raise ValueError(
            f"site {site.name!r} has no network, so no traffic: import one from a map, or "
            "build_network"
        )
    if frames < 0:
        raise ValueError(f"frames must be at least 0, got {frames}")
    check_interval(interval)
    if not any(body.label == VEHICLE for body in bodies):
        raise ValueError(
            f"bodies must hold at least one vehicle, got {len(bodies)} bodies: pass catalogue()"
        )
    mix = mix or Mix()
    supply = Supply(bodies, np.random.default_rng(seed), once=once)
    if not mix.is_continuous(interval):
        return _run(
            site, supply, obstacles=Obstacles(site), mix=mix, frames=frames, interval=interval
        )
    mix.check_continuous()
    return _run_continuously(site, supply, mix, frames, interval)


def check_interval(interval: float) -> None:
    """Raise ValueError unless an interval (s) is a whole number of steps.

    A step has `STEP_S`, or `FINE_STEP_S` below that."""
    step = STEP_S if interval >= STEP_S else FINE_STEP_S
    steps = interval / step
    if not (0.5 < steps < 1e6 and abs(steps - round(steps)) < 1e-6):
        raise ValueError(
            f"interval must be a whole number of SUMO's steps of {STEP_S} or {FINE_STEP_S} s, got "
            f"{interval}"
        )


def _run_continuously(
    site: Site, supply: Supply, mix: Mix, frames: int, interval: float
) -> Generator[Snapshot, None, None]:
    """Yield the snapshots of continuous traffic, simulated in full before the first one.

    Args:
        site: Site with a network.
        supply: Gives bodies, ids and random numbers.
        mix: Demand, and the largest number of parked vehicles.
        frames: Number of frames.
        interval: Time between frames (s)."""
    traffic = simulate_continuously(
        site, supply, frames=frames, interval=interval, max_parked=mix.most_parked, flow=mix.demand
    )
    for k in range(frames):
        yield take_continuous(traffic, k)


def take_continuous(traffic: ContinuousTraffic, k: int) -> Snapshot:
    """Snapshot of frame k of continuous traffic."""
    objects, bodies = traffic.objects(k)
    return Snapshot(objects, bodies, k * traffic.interval)


def _run(
    site: Site, supply: Supply, obstacles: Obstacles, mix: Mix, frames: int, interval: float
) -> Generator[Snapshot, None, None]:
    """Yield a snapshot of each frame while SUMO runs; road users are spawned near the area.

    Args:
        site: Site with a network.
        supply: Gives bodies, ids and random numbers.
        obstacles: Solids of the site.
        mix: Numbers of objects.
        frames: Number of frames.
        interval: Time between frames (s)."""
    # all draw from the supply's one generator: the order of draws decides the results
    parked = Parked.draw(site, obstacles, supply, max_parked=mix.most_parked)
    parked_count = len(parked.ids)
    if mix.stay is not None:
        parked_count = min(len(parked.bays), mix.most_parked)
    stray_count = round(mix.strays * (mix.most - parked_count))
    strays = Strays.draw(site, obstacles, supply, stray_count, parked.boxes(supply))
    max_moving = mix.most - parked_count - len(strays.ids)
    types = supply.sumo_types()
    sumo_seed = int(supply.rng.integers(2**31 - 1))
    with running(site.network, types, seed=sumo_seed) as sumo:
        spawner = Spawner(sumo, site, supply, max_objects=max_moving)
        take = partial(_take_snapshot, site, spawner, obstacles)
        spawner.advance(WARM_UP)
        for index in range(frames):
            yield take(parked, strays, time=index * interval)
            if mix.stay is None:
                parked = parked.later(supply)
            elif (index + 1) % mix.stay == 0:
                parked = Parked.draw(site, obstacles, supply, max_parked=mix.most_parked)
            strays = strays.later(supply, (index + 1) * interval)
            spawner.advance(interval)


def _take_snapshot(
    site: Site,
    spawner: Spawner,
    obstacles: Obstacles,
    parked: Parked,
    strays: Strays,
    *,
    time: float,
) -> Snapshot:
    """Objects that touch the view of the area now; those that cannot be kept apart are removed.

    Args:
        site: Site.
        spawner: Moving road users, which are told which ones were seen.
        obstacles: Solids of the site.
        parked: Parked vehicles.
        strays: Road users at unusual places.
        time: Seconds since the first frame."""
    moving_ids, moving_bodies, moving_poses = spawner.state()
    ids = np.concatenate([parked.ids, moving_ids, strays.ids])
    bodies = np.concatenate([parked.bodies, moving_bodies, strays.bodies])
    poses = np.concatenate([parked.poses, moving_poses, strays.at(time)])
    sizes = spawner.supply.sizes[bodies]
    boxes, is_kept, repaired = separate(place_boxes(poses, sizes), obstacles)
    spawner.remove(ids[~is_kept])
    # kept objects that touch the view are in the snapshot
    kept_shapes = shapely.polygons(footprints(boxes[is_kept]))
    seen = np.flatnonzero(is_kept)[shapely.intersects(kept_shapes, outline_view(site.area))]
    spawner.count_frame(ids[seen])
    boxes = boxes[seen]
    boxes[:, 2] += site.ground(footprints(boxes)).mean(axis=1)
    labels = spawner.supply.labels[bodies[seen]]
    return Snapshot(
        objects=Objects(boxes, labels, ids[seen]), bodies=bodies[seen], time=time, repaired=repaired
    )
