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

import numpy as np
import shapely

from toolkit.arrays import Int64, Rng
from toolkit.bodies.body import Body
from toolkit.boxes import footprints
from toolkit.objects import VEHICLE, Objects
from toolkit.sites.site import Site
from toolkit.traffic.obstacles import Obstacles, separate
from toolkit.traffic.parked import Parked
from toolkit.traffic.spawner import Spawner
from toolkit.traffic.strays import Strays
from toolkit.traffic.sumo import FINE_STEP_S, STEP_S, running
from toolkit.traffic.supply import Supply

INTERVAL = 5.0  # s between frames
MOST_OBJECTS = 30
# m round the area within which objects belong to a snapshot: they occlude, and the edge cuts them
MARGIN = 10.0
WARM_UP = 15.0  # s before the first frame
# If frames are closer together than `STEP_S`, this many snapshots `INTERVAL` apart are taken first
# and not given out: at the start everything still waits in queues, until objects have come and
# gone.
COMING_AND_GOING = 8


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One instant of traffic, site frame.

    Attributes:
        objects: all that touch the area or the `MARGIN` around it, so some centres are outside the
            area.
        bodies: for each object, the row of its body among the bodies given to `simulate`.
        time: seconds since the first frame.
        repaired: number of objects moved aside or taken out because bodies overlapped."""

    objects: Objects
    bodies: Int64[np.ndarray, " n"]
    time: float = 0.0
    repaired: int = 0


@dataclass(frozen=True)
class Mix:
    """Numbers of moving and parked objects and strays. Raises ValueError for impossible ones.

    Attributes:
        most: largest number of objects at a time.
        parked: largest number of parked vehicles among them; None for a fifth.
        stay: periods of `INTERVAL`, or frames if these are farther apart, until all parked
            vehicles are replaced, for independent blocks; None if each leaves at random.
        strays: share of the objects that are anywhere, whatever their class, see
            `toolkit.traffic.strays`."""

    most: int = MOST_OBJECTS
    parked: int | None = None
    stay: int | None = None
    strays: float = 0.0

    def __post_init__(self) -> None:
        # raises ValueError for a field that is out of range
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
    seed: int | Rng,
    interval: float = INTERVAL,
    mix: Mix | None = None,
    once: bool = False,
) -> Generator[Snapshot, None, None]:
    """Simulate `frames` snapshots of traffic on a site, `interval` (s) apart.

    Below 1 s objects live as long as ever, in more frames. once: no body is used again before all
    of its class have been, as is right for a fleet drawn for one recording; some pedestrians walk
    in groups then. Same seed, same bytes. One simulation runs at a time in a process: use up or
    close() the iterator before the next.

    Raises ValueError if the site has no network, nothing can drive near its area, or an argument
    does not fit; ImportError without SUMO; RuntimeError if another simulation is open."""
    if not site.network:
        raise ValueError(
            f"site {site.name!r} has no network, so no traffic: import one from a map, or "
            "build_network"
        )
    if frames < 0:
        raise ValueError(f"frames must be at least 0, got {frames}")
    step = sumo_step(interval)
    if not any(body.label == VEHICLE for body in bodies):
        raise ValueError(
            f"bodies must hold at least one vehicle, got {len(bodies)} bodies: pass catalogue()"
        )
    obstacles = Obstacles(site)
    supply = Supply(bodies, np.random.default_rng(seed), once=once)
    return _run(site, supply, obstacles, mix or Mix(), frames, interval, step)


def sumo_step(interval: float) -> float:
    """Step of SUMO (s) for frames `interval` seconds apart: `STEP_S`, or `FINE_STEP_S` below it.

    Raises ValueError unless the interval is a whole number of steps."""
    step = STEP_S if interval >= STEP_S else FINE_STEP_S
    steps = interval / step
    if not (0.5 < steps < 1e6 and abs(steps - round(steps)) < 1e-6):
        raise ValueError(
            f"interval must be a whole number of SUMO's steps of {STEP_S} or {FINE_STEP_S} s, got "
            f"{interval}"
        )
    return step


def _run(
    site: Site,
    supply: Supply,
    obstacles: Obstacles,
    mix: Mix,
    frames: int,
    interval: float,
    step: float,
) -> Generator[Snapshot, None, None]:
    """Yield the snapshots of `simulate` while SUMO runs.

    interval: time between frames (s); step: time step of SUMO (s)."""
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
    with running(site.network, types, seed=sumo_seed, step=step) as sumo:
        spawner = Spawner(sumo, site, supply, max_objects=max_moving, step=step)
        take = partial(_take_snapshot, site, spawner, obstacles)
        spawner.advance(WARM_UP)
        for _ in range(COMING_AND_GOING if step < STEP_S else 0):
            take(parked, strays, time=0.0)
            spawner.advance(INTERVAL)
        periods = 0
        for index in range(frames):
            is_last = _ends_period(index, interval)
            yield take(parked, strays, time=index * interval, counts=is_last)
            if is_last:
                periods += 1
                if mix.stay is None:
                    parked = parked.later(supply)
                elif periods % mix.stay == 0:
                    parked = Parked.draw(site, obstacles, supply, max_parked=mix.most_parked)
                strays = strays.later(supply, (index + 1) * interval)
            spawner.advance(interval)


def _ends_period(index: int, interval: float) -> bool:
    """True if frame `index` is the last one of a period of `INTERVAL`.

    Parking and the life of objects are counted in such periods. interval: time between frames (s);
    with `STEP_S` or more, each frame ends a period."""
    # periods that have passed at the frame, and at the next one; 1e-6 for rounding
    passed = int(index * interval / INTERVAL + 1e-6)
    passed_next = int((index + 1) * interval / INTERVAL + 1e-6)
    return interval >= STEP_S or passed_next > passed


def _take_snapshot(
    site: Site,
    spawner: Spawner,
    obstacles: Obstacles,
    parked: Parked,
    strays: Strays,
    *,
    time: float,
    counts: bool = True,
) -> Snapshot:
    """Objects near the area now; those that cannot be kept apart are removed.

    time: seconds since the first frame; counts: True to count this frame for the life of the
    objects."""
    moving_ids, moving_bodies, moving_poses = spawner.state()
    ids = np.concatenate([parked.ids, moving_ids, strays.ids])
    bodies = np.concatenate([parked.bodies, moving_bodies, strays.bodies])
    poses = np.concatenate([parked.poses, moving_poses, strays.at(time)])
    sizes = spawner.supply.sizes[bodies]
    # wrapped to -pi..pi
    yaw = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    boxes = np.column_stack([poses[:, :2], sizes[:, 2] / 2, sizes, yaw])
    boxes, is_kept, repaired = separate(boxes, obstacles)
    spawner.remove(ids[~is_kept])
    # the area with its margin; kept objects that touch it are in the snapshot
    near = shapely.box(*(site.area + MARGIN * np.array([-1, -1, 1, 1])))
    kept_shapes = shapely.polygons(footprints(boxes[is_kept]))
    seen = np.flatnonzero(is_kept)[shapely.intersects(kept_shapes, near)]
    if counts:
        spawner.count_frame(ids[seen])
    boxes = boxes[seen]
    boxes[:, 2] += site.ground(footprints(boxes)).mean(axis=1)
    labels = spawner.supply.labels[bodies[seen]]
    return Snapshot(Objects(boxes, labels, ids[seen]), bodies[seen], time, repaired)
