"""Spawn traffic near the detection area, which SUMO moves, and remove it after four frames.

SUMO runs in this process: one simulation at a time, silent, its errors raised. It gives the middle
of a vehicle's front bumper, and as its angle the direction to it from the middle of the rear
bumper, both on the path, so headings turn continuously through bends. A body's box lies on that
line."""

import io
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

import numpy as np

from toolkit.arrays import Float, Float64, Int64, Rng
from toolkit.bodies.body import Body
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.sites.site import Site

STEP = 1.0  # s; SUMO's own default, for which its driver models are tuned
FINE_STEP = 0.1  # s, for frames closer together; drivers decide every `STEP` still
LATERAL_RESOLUTION = (
    0.8  # m; sublanes: cars leave the lane's middle, two-wheelers ride beside each other
)

_OPTIONS = {
    "lateral-resolution": LATERAL_RESOLUTION,
    "collision.action": "none",
    "time-to-teleport": -1,
    "max-depart-delay": 0,
    **dict.fromkeys(("xml-validation", "xml-validation.net"), "never"),
    **dict.fromkeys(("no-step-log", "no-warnings", "duration-log.disable"), "true"),
}


@contextmanager
def running(network: str, types: str, *, seed: int, step: float = STEP) -> Iterator[ModuleType]:
    """Run the libsumo module with a network (net.xml text) and vehicle types (additional-file
    text); step: s.

    Raises ImportError without SUMO, RuntimeError where a simulation is open in this process already
    (libsumo knows only one), ValueError with SUMO's own words where it refuses the network."""
    try:
        with redirect_stdout(
            io.StringIO()
        ):  # it greets with a warning about pyarrow, which is not used here
            sumo = import_module("libsumo")
    except ImportError as error:
        raise ImportError(f'traffic needs SUMO ({error}): pip install "coview[sim]"') from None
    if sumo.simulation.isLoaded():
        raise RuntimeError(
            "SUMO simulates one site at a time in a process, and one is open: "
            "use up or close() the earlier simulation first, or run this one in another process"
        )
    with TemporaryDirectory(prefix="coview-") as folder:
        files = {name: Path(folder) / name for name in ("net.xml", "types.xml", "said.txt")}
        files["net.xml"].write_text(network, encoding="utf-8")
        files["types.xml"].write_text(types, encoding="utf-8")
        options = {
            **_OPTIONS,
            "net-file": files["net.xml"],
            "additional-files": files["types.xml"],
            "seed": seed,
        }
        options |= {"step-length": step} | (
            {} if step == STEP else {"default.action-step-length": STEP}
        )
        try:
            with _stderr_into(files["said.txt"]):
                sumo.start(
                    [
                        "sumo",
                        *(
                            word
                            for name, value in options.items()
                            for word in (f"--{name}", str(value))
                        ),
                    ]
                )
        except Exception as error:  # SUMO says why only on stderr
            message = files["said.txt"].read_text(encoding="utf-8").strip() or str(error)
            reason = message.splitlines()[0].removeprefix("Error: ").rstrip(".")
            raise ValueError(
                f"SUMO refuses the site's network: {reason}: build it again with netconvert"
            ) from None
    try:
        yield sumo
    finally:
        sumo.close()


@contextmanager
def _stderr_into(file: Path) -> Iterator[None]:
    """Redirect stderr to a file."""
    sys.stderr.flush()
    stderr_copy = os.dup(2)
    try:
        with file.open("wb") as sink:
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        os.dup2(stderr_copy, 2)
        os.close(stderr_copy)


HEAVY_SHARE = 0.08  # of the vehicles
# paper, Dataset
SHARES = {VEHICLE: 0.6 * (1 - HEAVY_SHARE), HEAVY: 0.6 * HEAVY_SHARE, CYCLIST: 0.2, PEDESTRIAN: 0.2}
# degrees; deviation of yaw from the path's
SWAY = {VEHICLE: 0.5, HEAVY: 0.3, CYCLIST: 2.0, PEDESTRIAN: 8.0}
# m; deviation from the middle of the lane
ASIDE = {VEHICLE: 0.25, HEAVY: 0.0, CYCLIST: 0.8, PEDESTRIAN: 0.0}
BICYCLE_LENGTH = 1.75  # m; a longer two-wheeler has an engine
POSITIONS = 3  # lateral positions in the lane, drawn per body


class Supply:
    """Bodies of traffic in random order of use, with SUMO's types for them and the next numbers of
    objects.

    labels: class numbers; sizes: length, width, height (m); classes: SUMO's, which say what lanes
    are open to it; once: a body that was taken does not come again before all others offered with
    it have been taken too, so that in a large fleet every object has a body of its own."""

    def __init__(self, bodies: Sequence[Body], rng: Rng, *, once: bool = False) -> None:
        self.rng = rng
        self.once = once
        self.ids = count()
        self._taken = np.zeros(len(bodies), bool)
        self.labels = np.array([body.label for body in bodies], np.int64)
        self.sizes = np.array([body.size for body in bodies], np.float64).reshape(-1, 3)
        names = {VEHICLE: "passenger", HEAVY: "truck", PEDESTRIAN: "pedestrian"}
        two_wheelers = (
            "bicycle" if body.size[0] <= BICYCLE_LENGTH else "motorcycle" for body in bodies
        )
        self.classes = tuple(
            names.get(body.label, two_wheeler)
            for body, two_wheeler in zip(bodies, two_wheelers, strict=True)
        )

    def sumo_types(self) -> str:
        """SUMO's additional file with a type "row-position" for each body and lateral position in
        the lane."""
        rows = []
        for row, (label, (length, width, height)) in enumerate(
            zip(self.labels.tolist(), self.sizes, strict=True)
        ):
            for position in range(POSITIONS):
                aside = np.clip(self.rng.normal(0, ASIDE[label]), -1.2, 1.2)
                gap = self.rng.uniform(1.0, 2.5) if label != PEDESTRIAN else 0.5
                rows.append(
                    f'<vType id="{row}-{position}" vClass="{self.classes[row]}" '
                    f'length="{length:.3f}" width="{width:.3f}" height="{height:.3f}" '
                    f'minGap="{gap:.2f}" latAlignment="{aside:.2f}"/>'
                )
        return "<additional>\n" + "\n".join(rows) + "\n</additional>\n"

    def offer(self, rows: Int64[np.ndarray, " n"]) -> int:
        """Draw one of these rows; call `take` when it is used."""
        if not self.once:
            return int(self.rng.choice(rows))
        free = rows[~self._taken[rows]]
        if not len(free):
            self._taken[rows] = False
            free = rows
        return int(self.rng.choice(free))

    def take(self, row: int, *, is_used: bool = True) -> None:
        """Note that a row is used. is_used: False if it was not used after all."""
        self._taken[row] = is_used

    def several(self, rows: Int64[np.ndarray, " n"], number: int) -> Int64[np.ndarray, " m"]:
        """Draw and take `number` of these rows."""
        drawn = [] if self.once else self.rng.choice(rows, number).tolist()
        while len(drawn) < number:
            drawn.append(self.offer(rows))
            self.take(drawn[-1])
        return np.array(drawn, np.int64)


SPACING = 2.0  # m between the places of a lane


@dataclass(frozen=True, eq=False)
class Lane:
    """Lane of the network. shape: (k, 2) middle line (m); following: lanes its links lead to,
    U-turns last."""

    name: str
    edge: str
    length: float
    shape: Float64[np.ndarray, "k 2"]
    forbidden: frozenset[str]
    following: tuple[str, ...]

    def at(self, offset: Float[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
        """Points of the middle line, `offset` (m) from its start."""
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.shape, axis=0).T))])
        stretched = offset * along[-1] / self.length
        return np.stack(
            [np.interp(stretched, along, self.shape[:, axis]) for axis in (0, 1)], axis=-1
        )


@dataclass(frozen=True, eq=False)
class Places:
    """Places on lanes: names and lengths (m) of their lanes, offsets from the lane's start (m), and
    points."""

    lanes: tuple[str, ...]
    lengths: Float64[np.ndarray, " n"]
    offsets: Float64[np.ndarray, " n"]
    points: Float64[np.ndarray, "n 2"]


@dataclass(frozen=True, eq=False)
class Roads:
    """Lanes of a network by name, without junctions' inner lanes."""

    lanes: Mapping[str, Lane]

    @staticmethod
    def read(sumo: ModuleType) -> "Roads":
        """Read the roads of the network that SUMO runs."""
        lanes = {}
        for name in sumo.lane.getIDList():
            if not name.startswith(":"):
                links = sumo.lane.getLinks(name)
                onward = [link[0] for link in links if link[6] != "t"] or [
                    link[0] for link in links
                ]
                following = tuple(
                    dict.fromkeys(lane for lane in onward if not lane.startswith(":"))
                )
                shape = np.array(sumo.lane.getShape(name), np.float64)
                edge = sumo.lane.getEdgeID(name)
                length = sumo.lane.getLength(name)
                lanes[name] = Lane(
                    name, edge, length, shape, frozenset(sumo.lane.getDisallowed(name)), following
                )
        return Roads(lanes)

    def places(self, area: Float64[np.ndarray, "4"], reach: float, vehicle_class: str) -> Places:
        """Places within `reach` (m) of the area to start a vehicle or pedestrian of a SUMO class.
        Outside the area they are headed for it. Pedestrians start on lanes of their own and walk
        either way."""
        walks = vehicle_class == "pedestrian"
        names = []
        offsets = [np.zeros(0)]
        points = [np.zeros((0, 2))]
        for lane in self.lanes.values():
            if vehicle_class in lane.forbidden or (walks and "passenger" not in lane.forbidden):
                continue
            along = np.arange(SPACING / 2, lane.length, SPACING)
            xy = lane.at(along)
            ahead = lane.at(along + SPACING) - lane.at(along - SPACING)
            towards = np.clip(xy, area[:2], area[2:]) - xy
            is_headed = (towards == 0).all(axis=1) | ((towards * ahead).sum(axis=1) > 0)
            useful = (distance_to_area(xy, area) <= reach) & (walks | is_headed)
            names += [lane.name] * int(useful.sum())
            offsets.append(along[useful])
            points.append(xy[useful])
        lengths = np.array([self.lanes[name].length for name in names])
        return Places(tuple(names), lengths, np.concatenate(offsets), np.concatenate(points))

    def route(
        self, start: str, vehicle_class: str, distance: float, rng: np.random.Generator
    ) -> list[str]:
        """Draw the edges of a drive of at least `distance` (m) from lane `start` on, or to where
        the road ends."""
        lane = self.lanes[start]
        edges = [self.lanes[start].edge]
        driven = 0.0
        while driven < distance:
            choices: list[str] = []
            for candidate in (
                lane,
                *self._neighbours[lane.edge],
            ):  # at a lane's end its neighbours may go on
                choices = choices or [
                    n for n in candidate.following if vehicle_class not in self.lanes[n].forbidden
                ]
            if not choices:
                break
            lane = self.lanes[choices[rng.integers(len(choices))]]
            edges.append(lane.edge)
            driven += lane.length
        return edges

    @cached_property
    def _neighbours(self) -> Mapping[str, Sequence[Lane]]:
        edges: dict[str, list[Lane]] = {}
        for lane in self.lanes.values():
            edges.setdefault(lane.edge, []).append(lane)
        return edges


def distance_to_area(
    points: Float[np.ndarray, "*n 2"], area: Float64[np.ndarray, "4"]
) -> Float64[np.ndarray, "*n"]:
    """Distance (m) from points to a rectangle, 0 inside."""
    beyond = points - np.clip(points, area[:2], area[2:])
    return np.hypot(beyond[..., 0], beyond[..., 1])


LIFE = 4  # frames an object is seen in
SPAWN_REACH = (
    25.0  # m round the area in which things are spawned; they are removed `_LEEWAY` farther out
)

_LEEWAY = 10.0
_ROUTE_LENGTH = 300.0  # m; farther than anything drives in its life
_TRIES = 8  # places looked at before a spawn is put off to the next step
_ASIDE = 0.3  # m a pedestrian walks beside the middle of its stripe
# shares of pedestrians of a drawn fleet with 0, 1, 2, 3 companions
_COMPANIONS = (0.7, 0.19, 0.08, 0.03)
_RESERVED = 2  # of the places are left to companions where there may be some
_SHOULDER = (0.55, 0.8)  # m between two pedestrians side by side, from .. to


@dataclass
class Spawned:
    """State of one spawned object."""

    body: int  # its row
    walks: bool
    aside: float  # m, rad, and behind: deviation from SUMO's pose
    turn: float
    inserted: bool = False
    frames: int = 0  # it has been seen in
    behind: float = 0.0
    leader: int | None = (
        None  # object whose pose that is, for companions on foot, which SUMO does not know
    )


class Spawner:
    """Spawn and remove everything that SUMO moves, at most `most` objects at a time. Object n is
    vehicle or person "n" in SUMO. Raises ValueError where no lane near the area is open to cars."""

    def __init__(
        self, sumo: ModuleType, site: Site, supply: Supply, *, max_objects: int, step: float = STEP
    ) -> None:
        self.sumo = sumo
        self.area = site.area
        self.most = max_objects
        self.step = step
        self.supply = supply
        self.rng = supply.rng
        self.ids = supply.ids
        self.domains = {False: sumo.vehicle, True: sumo.person}  # True: on foot
        self.roads = Roads.read(sumo)
        self.places = {
            kind: self.roads.places(site.area, SPAWN_REACH, kind)
            for kind in sorted(set(supply.classes))
        }
        if not self.places["passenger"].lanes:
            where = f"within {SPAWN_REACH:.0f} m of the area {site.area.tolist()}"
            remedy = "give the network in site coordinates, or move the area onto the road"
            raise ValueError(f"site {site.name!r}: no lane open to cars {where}: {remedy}")
        possible = np.array([bool(self.places[kind].lanes) for kind in supply.classes])
        rows = {label: np.flatnonzero(possible & (supply.labels == label)) for label in SHARES}
        self.choices = {
            label: bodies_of_label
            for label, bodies_of_label in rows.items()
            if len(bodies_of_label)
        }
        shares = np.array([SHARES[label] for label in self.choices])
        self.shares = shares / shares.sum()
        self.due: list[int] = []  # labels drawn, waiting for a place
        self.spawned: dict[int, Spawned] = {}
        self.walks: dict[tuple[str, str], list[str]] = {}
        self.routes: set[str] = set()

    def advance(self, seconds: float) -> None:
        """Simulate on, spawning missing objects before every step. Objects without a place by the
        end are given up."""
        for _ in range(round(seconds / self.step)):
            self._spawn()
            self.sumo.simulationStep()
            present = {*self.sumo.vehicle.getIDList(), *self.sumo.person.getIDList()}
            for name, spawned in list(self.spawned.items()):
                if str(name if spawned.leader is None else spawned.leader) in present:
                    spawned.inserted = True
                    continue
                del self.spawned[
                    name
                ]  # it arrived, or SUMO could not insert it: then it is due again
                if not spawned.inserted:
                    self.supply.take(spawned.body, is_used=False)
                    self.due += (
                        [int(self.supply.labels[spawned.body])] if spawned.leader is None else []
                    )
            for vehicle in self.sumo.vehicle.getIDList():  # none may come later
                if int(vehicle) not in self.spawned:
                    self.sumo.vehicle.remove(vehicle)
        self.due = []

    def state(
        self,
    ) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Ids, bodies and poses (x, y, yaw of the middle), the oldest first."""
        poses = {}
        for name, spawned in self.spawned.items():
            domain = self.domains[spawned.walks]
            sumo_id = str(name if spawned.leader is None else spawned.leader)
            x, y = domain.getPosition(sumo_id)
            # degrees clockwise from north; NaN for some that change lanes
            angle = domain.getAngle(sumo_id)
            if not np.isfinite(angle):
                angle = self.sumo.lane.getAngle(
                    domain.getLaneID(sumo_id), domain.getLanePosition(sumo_id)
                )
            yaw = np.pi / 2 - np.radians(angle)
            back = spawned.behind if spawned.walks else self.supply.sizes[spawned.body, 0] / 2
            x -= back * np.cos(yaw) + spawned.aside * np.sin(yaw)
            y -= back * np.sin(yaw) - spawned.aside * np.cos(yaw)
            poses[name] = np.array([x, y, yaw + spawned.turn])
        points = np.array([pose[:2] for pose in poses.values()]).reshape(-1, 2)
        distant = distance_to_area(points, self.area) > SPAWN_REACH + _LEEWAY
        self.remove(np.array(list(poses), np.int64)[distant])
        ids = np.array(list(self.spawned), np.int64)
        bodies = np.array([spawned.body for spawned in self.spawned.values()], np.int64)
        return ids, bodies, np.array([poses[name] for name in self.spawned]).reshape(-1, 3)

    def remove(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Remove objects from the simulation; other ids are ignored."""
        for name in ids.tolist():
            spawned = self.spawned.pop(name, None)
            self.spawned = {
                spawned_name: record
                for spawned_name, record in self.spawned.items()
                if record.leader != name
            }
            if spawned and spawned.leader is None:
                self.domains[spawned.walks].remove(str(name))

    def count_frame(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Count a frame; remove objects at their last."""
        seen = [name for name in ids.tolist() if name in self.spawned]
        for name in seen:
            self.spawned[name].frames += 1
        self.remove(
            np.array([name for name in seen if self.spawned[name].frames >= LIFE], np.int64)
        )

    def _spawn(self) -> None:
        """Fill up to `most`."""
        reserved = _RESERVED if self.supply.once else 0
        missing = self.most - reserved - len(self.spawned) - len(self.due)
        if missing > 0:
            self.due += self.rng.choice(list(self.choices), missing, p=self.shares).tolist()
        if not self.due:
            return
        positions = {}
        for walks, domain in self.domains.items():
            names = [
                name
                for name, record in self.spawned.items()
                if record.walks == walks and record.leader is None
            ]
            positions[walks] = np.array([domain.getPosition(str(name)) for name in names]).reshape(
                -1, 2
            )
        waiting = self.due
        self.due = []
        for label in waiting:
            walks = label == PEDESTRIAN
            body = self.supply.offer(self.choices[label])
            place = self._free_place(body, positions[walks])
            if place is None:
                self.due.append(label)
                continue
            self.supply.take(body)
            name = next(self.ids)
            (self._add_walker if walks else self._add_driver)(str(name), body, place)
            aside = self.rng.uniform(-_ASIDE, _ASIDE) if walks else 0.0
            turn = float(np.radians(self.rng.normal(0, SWAY[label])))
            self.spawned[name] = Spawned(body, walks, aside, turn)
            if walks and self.supply.once:
                self._add_companions(name, self.most - len(self.spawned) - len(waiting))
            positions[walks] = np.vstack(
                [positions[walks], self.places[self.supply.classes[body]].points[place]]
            )

    def _free_place(self, body: int, occupied: Float64[np.ndarray, "m 2"]) -> int | None:
        """Draw a free place with room for the body behind it, if found quickly."""
        places = self.places[self.supply.classes[body]]
        length = self.supply.sizes[body, 0]
        candidates = self.rng.integers(len(places.lanes), size=_TRIES)
        gaps = np.square(places.points[candidates][:, None] - occupied[None]).sum(-1)
        drives = self.supply.labels[body] != PEDESTRIAN
        free = (gaps > (length + (2.0 if drives else 0.5)) ** 2).all(axis=1)
        if drives:
            free &= places.offsets[candidates] >= np.minimum(length, places.lengths[candidates] - 1)
        return int(candidates[np.argmax(free)]) if free.any() else None

    def _add_driver(self, name: str, body: int, place: int) -> None:
        places = self.places[self.supply.classes[body]]
        lane = places.lanes[place]
        edges = self.roads.route(lane, self.supply.classes[body], _ROUTE_LENGTH, self.rng)
        if (route := " ".join(edges)) not in self.routes:
            self.sumo.route.add(route, edges)
            self.routes.add(route)
        start = {"departLane": lane.rpartition("_")[2], "departPos": f"{places.offsets[place]:.2f}"}
        self.sumo.vehicle.add(
            name, route, f"{body}-{self.rng.integers(POSITIONS)}", **start, departSpeed="max"
        )

    def _add_walker(self, name: str, body: int, place: int) -> None:
        places = self.places["pedestrian"]
        destination = int(self.rng.integers(len(places.lanes)))
        start, end = (self.roads.lanes[places.lanes[index]].edge for index in (place, destination))
        if (start, end) not in self.walks:
            stages = self.sumo.simulation.findIntermodalRoute(start, end, pType=f"{body}-0")
            self.walks[start, end] = [edge for stage in stages for edge in stage.edges] or [start]
        self.sumo.person.add(name, start, float(places.offsets[place]), typeID=f"{body}-0")
        walk = self.walks[start, end]
        # no way there: stay here
        arrival = places.offsets[destination] if walk[-1] == end else places.lengths[place] / 2
        self.sumo.person.appendWalkingStage(name, walk, float(arrival))

    def _add_companions(self, leader: int, room: int) -> None:
        """Add companions beside a pedestrian, room permitting."""
        first = self.spawned[leader]
        beside = 0.0
        for _ in range(min(int(self.rng.choice(len(_COMPANIONS), p=_COMPANIONS)), room)):
            body = self.supply.offer(self.choices[PEDESTRIAN])
            self.supply.take(body)
            beside = beside + self.rng.uniform(*_SHOULDER) if beside >= 0 else -beside
            turn = first.turn + float(np.radians(self.rng.normal(0, SWAY[PEDESTRIAN])))
            behind = self.rng.uniform(-0.4, 0.4)
            self.spawned[next(self.ids)] = Spawned(
                body, True, first.aside + beside, turn, behind=behind, leader=leader
            )
