"""Traffic on a site: SUMO drives, rides and walks; every few seconds a `Snapshot` says what is
where.

As in the paper's dataset, a spawned object is a car, a two-wheeler or a pedestrian with probability
0.6, 0.2 and 0.2 (8 % of the cars are heavy vehicles), at most 30 objects exist, and each is seen in
four frames, 5 s apart, before another takes its place. Classes without bodies, or without lanes of
their own near the area (pedestrians, where there is no footway), are left out and the other
probabilities grow in proportion. Parked vehicles are drawn for the bays; they count among the 30, a
fifth of them at most by default, and stay longer. Boxes that overlap are moved aside or dropped.

A share of all may be `Strays`, road users where their class seldom is: on any lane or footway,
beside walls and vehicles, shoulder to shoulder. Where everybody keeps to lanes of their own, a
detector learns the place in place of the shape: a pedestrian on a lane becomes a cyclist. Strays
stand or go straight on, at any heading, for as many frames as other road users live."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import shapely

from toolkit.arrays import Bool, Float64, Int64, Mask, Rng
from toolkit.bodies.body import Body
from toolkit.boxes import footprints
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Objects
from toolkit.sites.network import unite
from toolkit.sites.site import Site
from toolkit.traffic.spawner import FINE_STEP, LIFE, STEP, Spawner, Supply, running

_Boxes = Float64[np.ndarray, "n 7"]
GAP = 0.1  # m left between bodies
STEPS_ASIDE = (0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75, 1.0, -1.0)  # m, tried in this order
_WALKABLE = 0.3  # m above the ground; lower solids can be stepped on


class Obstacles:
    """Static solids high enough to be in the way, indexed by place. Heights count from the plane of
    the ground, as those of boxes do until a snapshot puts them on the ground."""

    def __init__(self, site: Site) -> None:
        middles = np.array([solid.footprint.mean(axis=0) for solid in site.solids]).reshape(-1, 2)
        above = np.array([solid.top for solid in site.solids]) - site.ground(middles)
        blocking = [
            solid for solid, height in zip(site.solids, above, strict=True) if height > _WALKABLE
        ]
        places = np.array([solid.footprint.mean(axis=0) for solid in blocking]).reshape(-1, 2)
        self.bases = np.array([solid.base for solid in blocking]) - site.plane(places)
        self.tree = shapely.STRtree([shapely.Polygon(solid.footprint) for solid in blocking])

    def hit(self, boxes: _Boxes) -> Mask:
        """Mask of boxes that touch an obstacle; they pass under one that begins above them, such as
        a tree's crown."""
        rows, obstacles = self.tree.query(_shapes(boxes), predicate="intersects")
        hit = np.zeros(len(boxes), bool)
        hit[rows[self.bases[obstacles] < boxes[rows, 2] + boxes[rows, 5] / 2]] = True
        return hit


def separate(boxes: _Boxes, obstacles: Obstacles) -> tuple[_Boxes, Mask, int]:
    """Separate boxes; return them, a mask of kept rows and the number of changes. Earlier rows have
    precedence. A row in the way steps aside by up to 1 m across its heading, or is dropped."""
    is_kept = np.ones(len(boxes), bool)
    in_the_way = np.flatnonzero(overlaps(boxes).any(axis=0) | obstacles.hit(boxes))
    if not len(in_the_way):
        return boxes, is_kept, 0
    settled = boxes.copy()
    shapes = _shapes(boxes)
    for row in in_the_way:
        is_kept[row] = False  # so that `kept` are the others
        places = np.tile(boxes[row], (len(STEPS_ASIDE), 1))
        places[:, :2] += np.outer(STEPS_ASIDE, [-np.sin(boxes[row, 6]), np.cos(boxes[row, 6])])
        place_shapes = _shapes(places)
        free = ~obstacles.hit(places) & ~shapely.intersects(
            place_shapes[:, None], shapes[is_kept][None]
        ).any(axis=1)
        first = np.argmax(free)
        is_kept[row] = free[first]
        settled[row] = places[first]
        shapes[row] = place_shapes[first]
    return settled, is_kept, int((~is_kept | (settled != boxes).any(axis=1)).sum())


def overlaps(boxes: _Boxes) -> Bool[np.ndarray, "n n"]:
    """Mask of pairs of boxes closer than `GAP`, above the diagonal."""
    radius = np.hypot(boxes[:, 3] + GAP, boxes[:, 4] + GAP) / 2
    gaps = boxes[:, None, :2] - boxes[None, :, :2]
    i, j = np.nonzero(
        np.triu(np.square(gaps).sum(-1) < np.square(radius[:, None] + radius[None]), 1)
    )
    shapes = _shapes(boxes)
    close = np.zeros((len(boxes), len(boxes)), bool)
    close[i, j] = shapely.intersects(shapes[i], shapes[j])
    return close


def _shapes(boxes: _Boxes) -> np.ndarray:
    widened = boxes.copy()
    widened[:, 3:5] += GAP  # half of it on each side: two neighbours keep one gap
    return shapely.polygons(footprints(widened))


STRAY_SHARES = {PEDESTRIAN: 0.54, CYCLIST: 0.26, VEHICLE: 0.12, HEAVY: 0.08}  # of the strays
# share that stands beside a solid or a vehicle, and beside the stray drawn before
BESIDE = 0.35
COMPANIONS = 0.3
STANDING_SHARES = {PEDESTRIAN: 0.5, CYCLIST: 0.3, VEHICLE: 1.0, HEAVY: 1.0}  # share of the others
SPEED = {PEDESTRIAN: (0.4, 1.8), CYCLIST: (1.0, 6.0)}  # m/s, from .. to
# m of air between a stray and what it stands beside
_NEAREST = 0.12
_FARTHEST = 1.5
_SHOULDER = 0.4  # m of air at most between two companions
_TRIES = 6
_EVERY = 0.5  # m between the places along an edge
_Poses = Float64[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class StrayGround:
    """Places of strays: points of lanes and footways in the area, and edges of solids there with
    outward normals."""

    points: Float64[np.ndarray, "n 2"]
    edges: Float64[np.ndarray, "m 4"]

    @staticmethod
    def of(site: Site, obstacles: Obstacles, rng: np.random.Generator) -> "StrayGround":
        """Draw places all over a site's road."""
        surface = shapely.intersection(
            unite([*site.lanes, *site.footways]), shapely.box(*site.area)
        )
        drawn = rng.uniform(site.area[:2], site.area[2:], (8000, 2))
        shapely.prepare(surface)
        points = drawn[shapely.contains_xy(surface, *drawn.T)]
        solids = obstacles.tree.geometries
        return StrayGround(
            points, outward_edges(solids[shapely.dwithin(solids, surface, _FARTHEST)])
        )


def outward_edges(polygons: np.ndarray) -> Float64[np.ndarray, "n 4"]:
    """Points every half metre along the outlines of polygons, and the outward normal at each: x y
    nx ny."""
    rings = shapely.segmentize(shapely.get_exterior_ring(shapely.normalize(polygons)), _EVERY)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    ahead = np.diff(xy, axis=0)[ring[1:] == ring[:-1]]
    middles = ((xy[1:] + xy[:-1]) / 2)[ring[1:] == ring[:-1]]
    length = np.hypot(*ahead.T)
    is_long = length > 1e-6
    normals = np.column_stack([-ahead[:, 1], ahead[:, 0]])[is_long] / length[is_long, None]
    # normalised rings run clockwise: left is outside
    return np.column_stack([middles[is_long], normals])


@dataclass(frozen=True, eq=False)
class Strays:
    """Strays of a moment: body, id, pose when drawn (x, y, yaw), speed (m/s), time then (s) and
    frames to live."""

    ground: StrayGround
    obstacles: Obstacles
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: _Poses
    speeds: Float64[np.ndarray, " n"]
    drawn: Float64[np.ndarray, " n"]
    left: Int64[np.ndarray, " n"]

    @staticmethod
    def draw(
        site: Site, obstacles: Obstacles, supply: Supply, number: int, vehicles: np.ndarray
    ) -> "Strays":
        """Draw so many strays. vehicles: boxes (n, 7) of those that park, which strays stand beside
        too."""
        rng = supply.rng
        no_numbers = np.zeros(0)
        ground = (
            StrayGround.of(site, obstacles, rng)
            if number
            else StrayGround(np.zeros((0, 2)), np.zeros((0, 4)))
        )
        if number and len(vehicles):
            beside = outward_edges(shapely.polygons(footprints(vehicles)))
            # a third of the edges are those of vehicles
            repeats = max(1, len(ground.edges) // max(1, 2 * len(beside)))
            ground = replace(
                ground, edges=np.concatenate([ground.edges, np.tile(beside, (repeats, 1))])
            )
        no_integers = no_numbers.astype(np.int64)
        strays = Strays(
            ground,
            obstacles,
            no_integers,
            no_integers,
            np.zeros((0, 3)),
            no_numbers,
            no_numbers,
            no_integers,
        )
        number = number if len(ground.points) else 0
        return strays._add(number, supply, 0.0, rng.integers(1, LIFE + 1, number))

    def at(self, time: float) -> _Poses:
        """Poses at a time (s)."""
        gone = self.speeds * (time - self.drawn)
        x, y, yaw = self.poses.T
        return np.column_stack([x + gone * np.cos(yaw), y + gone * np.sin(yaw), yaw])

    def later(self, supply: Supply, time: float) -> "Strays":
        """Strays a frame later, others in place of those whose life is over. time: of that frame
        (s)."""
        number = len(self.ids)
        left = self.left - 1
        is_alive = left > 0
        columns = {
            name: getattr(self, name)[is_alive]
            for name in ("bodies", "ids", "poses", "speeds", "drawn")
        }
        missing = number - int(is_alive.sum())
        return replace(self, **columns, left=left[is_alive])._add(
            missing, supply, time, np.full(missing, LIFE)
        )

    def _add(self, number: int, supply: Supply, time: float, left: np.ndarray) -> "Strays":
        rng = supply.rng
        stray_labels = [label for label in STRAY_SHARES if (supply.labels == label).any()]
        shares = np.array([STRAY_SHARES[label] for label in stray_labels])
        bodies = list[int]()
        poses = list[np.ndarray]()
        speeds = list[float]()
        for label in rng.choice(stray_labels, number, p=shares / shares.sum()).tolist():
            has_company = bool(poses) and rng.random() < COMPANIONS
            if has_company:
                label = int(supply.labels[bodies[-1]]) if rng.random() < 0.8 else label
            body = int(supply.several(np.flatnonzero(supply.labels == label), 1)[0])
            stands = rng.random() < STANDING_SHARES[label]
            speed = 0.0 if stands else float(rng.uniform(*SPEED[label]))
            if has_company:
                pose = self._place_companion(poses[-1], supply.sizes[[bodies[-1], body], 1], rng)
                speed = speeds[-1]
            else:
                pose, beside = self._place(supply.sizes[body], rng)
                speed = 0.0 if beside else speed
            bodies.append(body)
            poses.append(pose)
            speeds.append(speed if label in SPEED else 0.0)
        ids = [next(supply.ids) for _ in range(number)]
        return replace(
            self,
            bodies=np.append(self.bodies, np.array(bodies, np.int64)),
            ids=np.append(self.ids, np.array(ids, np.int64)),
            poses=np.concatenate([self.poses, np.array(poses).reshape(-1, 3)]),
            speeds=np.append(self.speeds, speeds),
            drawn=np.append(self.drawn, np.full(number, time)),
            left=np.append(self.left, left),
        )

    def _place(
        self, size: np.ndarray, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "3"], bool]:
        """Pose on open ground or beside something, and whether it is the second; clear of solids
        where that is easy."""
        pose = np.zeros(3)
        beside = False
        for _ in range(_TRIES):
            yaw = rng.uniform(-np.pi, np.pi)
            beside = len(self.ground.edges) > 0 and rng.random() < BESIDE
            if beside:
                x, y, nx, ny = self.ground.edges[rng.integers(len(self.ground.edges))]
                edge = np.arctan2(nx, -ny)
                yaw = (
                    edge + np.pi / 2 * rng.integers(4) + rng.normal(0, 0.1)
                    if rng.random() < 0.6
                    else yaw
                )
                across = (
                    abs(np.cos(yaw - edge)) * size[1] / 2 + abs(np.sin(yaw - edge)) * size[0] / 2
                )
                away = across + rng.uniform(_NEAREST, _FARTHEST)
                pose = np.array([x + away * nx, y + away * ny, yaw])
            else:
                pose = np.array([*self.ground.points[rng.integers(len(self.ground.points))], yaw])
            box = np.array([[pose[0], pose[1], size[2] / 2, *size, pose[2]]])
            if not self.obstacles.hit(box)[0]:
                break
        return pose, beside

    @staticmethod
    def _place_companion(
        first: np.ndarray, widths: np.ndarray, rng: np.random.Generator
    ) -> Float64[np.ndarray, "3"]:
        """Pose to the left of the one drawn before, so that a group stands in a row."""
        x, y, yaw = first
        across = widths.sum() / 2 + rng.uniform(_NEAREST, _SHOULDER)
        behind = rng.normal(0, 0.15)
        x, y = (
            x - across * np.sin(yaw) - behind * np.cos(yaw),
            y + across * np.cos(yaw) - behind * np.sin(yaw),
        )
        return np.array([x, y, yaw + rng.normal(0, 0.1)])


STAY = 20.0  # frames, mean
ROOM = (5.8, 2.4, 2.0)  # m, length, width and height a bay must offer
OCCUPIED = (0.3, 0.9)  # share of the bays, from .. to
JITTER = (0.1, 0.1, np.radians(1.0))  # m, m, rad; how far off the middle of the bay


@dataclass(frozen=True, eq=False)
class Parked:
    """Parked vehicles, and the bays (x, y, yaw) of the site: bay, body, id and pose (x, y, yaw) of
    each."""

    bays: Float64[np.ndarray, "m 3"]
    places: Int64[np.ndarray, " n"]
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: Float64[np.ndarray, "n 3"]

    @staticmethod
    def draw(site: Site, obstacles: Obstacles, supply: Supply, *, max_parked: int) -> "Parked":
        """Park vehicles in a random share of the free bays, `max_parked` at most."""
        x, y, yaw = site.parking.T
        room = np.column_stack([x, y, np.full((len(x), 4), (ROOM[2] / 2, *ROOM)), yaw])
        bays = site.parking[~obstacles.hit(room)]
        number = min(round(len(bays) * supply.rng.uniform(*OCCUPIED)), max_parked)
        places = supply.rng.permutation(len(bays))[:number]
        nobody = np.zeros(number, np.int64)
        return Parked(bays, places, nobody, nobody, np.zeros((number, 3)))._refill(
            np.ones(number, bool), supply
        )

    def later(self, supply: Supply) -> "Parked":
        """Parked vehicles a frame later: each has left with probability 1 / `STAY`, another stands
        in a free bay."""
        return self._refill(supply.rng.random(len(self.ids)) < 1 / STAY, supply)

    def boxes(self, supply: Supply) -> _Boxes:
        """Boxes on level ground, (n, 7)."""
        sizes = supply.sizes[self.bodies]
        return np.column_stack([self.poses[:, :2], sizes[:, 2] / 2, sizes, self.poses[:, 2]])

    def _refill(self, left: np.ndarray, supply: Supply) -> "Parked":
        if not left.any():
            return self
        rng = supply.rng
        number = int(left.sum())
        parked = replace(
            self, **{k: getattr(self, k).copy() for k in ("places", "bodies", "ids", "poses")}
        )
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
# m round the area within which objects belong to a snapshot: they occlude, and the edge cuts them
MARGIN = 10.0
WARM_UP = 15.0  # s before the first frame
# times `INTERVAL` more before frames closer together: at first all stand in the queues they fill
COMING_AND_GOING = 8


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One instant of traffic, site frame."""

    # all that touch the area or the `MARGIN` around it, so some centres lie outside the area
    objects: Objects
    bodies: Int64[np.ndarray, " n"]  # row of each object in the bodies given to `simulate`
    time: float = 0.0  # s since the first frame
    repaired: int = 0  # objects moved aside or taken out because bodies overlapped


@dataclass(frozen=True)
class Mix:
    """Shares of moving and parked objects. Raises ValueError for impossible numbers."""

    most: int = MOST_OBJECTS  # at a time
    parked: int | None = None  # vehicles among them that park, a fifth at most by default
    stay: int | None = (
        None  # frames until all stand in other bays, for independent blocks; None: each on its own
    )
    strays: float = (
        0.0  # share of all that is anywhere, whatever its class, see `toolkit.traffic.snapshots`
    )

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
    seed: int | Rng,
    interval: float = INTERVAL,
    mix: Mix | None = None,
    once: bool = False,
) -> Generator[Snapshot, None, None]:
    """Simulate `frames` snapshots of traffic on a site, `interval` (s) apart.

    Below 1 s objects live as long as ever, in more frames. once: no body is used again before all
    of its class have been, as is right for a fleet drawn afresh; some pedestrians walk in groups
    then. Same seed, same bytes. One simulation runs at a time in a process: use up or close() the
    iterator before the next.

    Raises ValueError where the site has no network, nothing can drive near its area, or an argument
    does not fit; ImportError without SUMO; RuntimeError where another simulation is open."""
    if not site.network:
        raise ValueError(
            f"site {site.name!r} has no network, so no traffic: import one from a map, or "
            "build_network"
        )
    if frames < 0:
        raise ValueError(f"frames must be at least 0, got {frames}")
    step = sumo_step(interval)
    mix = mix or Mix()
    if not any(body.label == VEHICLE for body in bodies):
        raise ValueError(
            f"bodies must hold at least one vehicle, got {len(bodies)} bodies: pass catalogue()"
        )
    obstacles = Obstacles(site)
    supply = Supply(bodies, np.random.default_rng(seed), once=once)
    draw = partial(Parked.draw, site, obstacles, supply, max_parked=mix.most_parked)

    def run() -> Generator[Snapshot, None, None]:
        parked = draw()
        periods = 0
        parked_count = (
            len(parked.ids) if mix.stay is None else min(len(parked.bays), mix.most_parked)
        )
        wander = partial(
            Strays.draw, site, obstacles, supply, round(mix.strays * (mix.most - parked_count))
        )
        strays = wander(parked.boxes(supply))
        types = supply.sumo_types()
        sumo_seed = int(supply.rng.integers(2**31 - 1))
        with running(site.network, types, seed=sumo_seed, step=step) as sumo:
            spawner = Spawner(
                sumo, site, supply, max_objects=mix.most - parked_count - len(strays.ids), step=step
            )
            look = partial(_snapshot, site, spawner, obstacles)
            spawner.advance(WARM_UP)
            for _ in range(COMING_AND_GOING if step < STEP else 0):
                look(parked, strays, time=0.0)
                spawner.advance(INTERVAL)
            for index in range(frames):
                passed, at = (int((index + k) * interval / INTERVAL + 1e-6) for k in (0, 1))
                # of an `INTERVAL`, by which parking and life are counted
                last = interval >= STEP or at > passed
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
    """Step of SUMO (s) for an interval of frames. Raises ValueError unless the interval is a whole
    number of steps."""
    step = STEP if interval >= STEP else FINE_STEP
    steps = interval / step
    if not (0.5 < steps < 1e6 and abs(steps - round(steps)) < 1e-6):
        raise ValueError(
            f"interval must be a whole number of SUMO's steps of {STEP} or {FINE_STEP} s, got "
            f"{interval}"
        )
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
    """Objects near the area now; those that cannot be kept apart are removed. counts: note that
    they were seen."""
    parked_state = (parked.ids, parked.bodies, parked.poses)
    stray_state = (strays.ids, strays.bodies, strays.at(time))
    ids, bodies, poses = (
        np.concatenate(parts)
        for parts in zip(parked_state, spawner.state(), stray_state, strict=True)
    )
    sizes = spawner.supply.sizes[bodies]
    yaw = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    boxes = np.column_stack([poses[:, :2], sizes[:, 2] / 2, sizes, yaw])
    boxes, is_kept, repaired = separate(boxes, obstacles)
    spawner.remove(ids[~is_kept])
    near = shapely.box(*(site.area + MARGIN * np.array([-1, -1, 1, 1])))
    seen = np.flatnonzero(is_kept)[
        shapely.intersects(shapely.polygons(footprints(boxes[is_kept])), near)
    ]
    if counts:
        spawner.count_frame(ids[seen])
    boxes = boxes[seen]
    bodies = bodies[seen]
    ids = ids[seen]
    boxes[:, 2] += site.ground(footprints(boxes)).mean(axis=1)
    return Snapshot(Objects(boxes, spawner.supply.labels[bodies], ids), bodies, time, repaired)
