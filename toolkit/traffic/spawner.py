"""Spawn traffic near the detection area, which SUMO moves, and remove it after four frames.

SUMO gives the middle of a vehicle's front bumper, and as its angle the direction to it from the
middle of the rear bumper, both on the path, so headings turn continuously through bends. The middle
of a body's box is on that line."""

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import PEDESTRIAN
from toolkit.sites.site import Site
from toolkit.traffic.road_lanes import Roads, distance_to_area
from toolkit.traffic.sumo import STEP
from toolkit.traffic.supply import POSITIONS, SHARES, SWAY, Supply

LIFE = 4  # frames an object is seen in
SPAWN_REACH = (
    25.0  # m round the area in which things are spawned; they are removed `_LEEWAY` farther out
)
_LEEWAY = 10.0  # m
_ROUTE_LENGTH = 300.0  # m; farther than anything drives in its life
_TRIES = 8  # places looked at before a spawn is put off to the next step
_ASIDE = 0.3  # m, at most, that a pedestrian walks left or right of the middle of its stripe
# shares of pedestrians of a drawn fleet with 0, 1, 2, 3 companions
_COMPANIONS = (0.7, 0.19, 0.08, 0.03)
_RESERVED = 2  # objects that are not spawned if there may be companions, to leave room for these
_SHOULDER = (0.55, 0.8)  # lowest and highest distance (m) between two pedestrians side by side


@dataclass
class Spawned:
    """State of one spawned object.

    Its pose is SUMO's, moved `aside` (m to the left) and `behind` (m back, pedestrians only) and
    turned by `turn` (rad)."""

    body: int  # row of its body in the supply
    walks: bool  # True for pedestrians
    aside: float
    turn: float
    inserted: bool = False  # True after SUMO has put it on the road
    frames: int = 0  # number of frames in which it has been seen
    behind: float = 0.0
    leader: int | None = (
        None  # object whose pose that is, for companions on foot, which SUMO does not know
    )


class Spawner:
    """Spawn and remove everything that SUMO moves. Object n is vehicle or person "n" in SUMO.

    Raises ValueError if no lane near the area is open to cars.

    Args:
        sumo: the libsumo module with a running simulation.
        supply: gives bodies, ids and random numbers.
        max_objects: largest number of objects at a time.
        step: time step of the simulation (s)."""

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
        # by SUMO class: places at which something of it can start
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
        # by class label: rows of the bodies that can start somewhere; `shares` has the same order
        self.choices = {
            label: bodies_of_label
            for label, bodies_of_label in rows.items()
            if len(bodies_of_label)
        }
        shares = np.array([SHARES[label] for label in self.choices])
        self.shares = shares / shares.sum()
        self.due: list[int] = []  # class labels of objects that wait for a place
        self.spawned: dict[int, Spawned] = {}  # by id, the oldest first
        # edges of walks already found, by first and last edge
        self.walks: dict[tuple[str, str], list[str]] = {}
        self.routes: set[str] = set()  # names of the routes that SUMO knows

    def advance(self, seconds: float) -> None:
        """Simulate on for some seconds, spawning missing objects before every step.

        Objects without a place by the end are given up."""
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
            # vehicles that SUMO inserted late, after they were given up
            for vehicle in self.sumo.vehicle.getIDList():
                if int(vehicle) not in self.spawned:
                    self.sumo.vehicle.remove(vehicle)
        self.due = []

    def state(
        self,
    ) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Ids, rows of bodies, and poses of all objects, the oldest first.

        A pose is x, y (m) and yaw (rad) of the middle of the body. Objects too far from the area
        are removed."""
        poses = {}
        for name, spawned in self.spawned.items():
            domain = self.domains[spawned.walks]
            sumo_id = str(name if spawned.leader is None else spawned.leader)
            x, y = domain.getPosition(sumo_id)
            # degrees clockwise from north; NaN for some vehicles that change lanes
            angle = domain.getAngle(sumo_id)
            if not np.isfinite(angle):
                angle = self.sumo.lane.getAngle(
                    domain.getLaneID(sumo_id), domain.getLanePosition(sumo_id)
                )
            yaw = np.pi / 2 - np.radians(angle)
            back = spawned.behind if spawned.walks else self.supply.sizes[spawned.body, 0] / 2
            # back along the heading, and `aside` to its left
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
        """Remove objects, and companions of removed leaders; unknown ids are ignored."""
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
        """Count a frame in which these objects were seen; remove those seen in `LIFE` frames."""
        seen = [name for name in ids.tolist() if name in self.spawned]
        for name in seen:
            self.spawned[name].frames += 1
        self.remove(
            np.array([name for name in seen if self.spawned[name].frames >= LIFE], np.int64)
        )

    def _spawn(self) -> None:
        """Spawn what is missing up to `most` objects; what finds no place stays in `due`."""
        # the random numbers are drawn in this order: classes, then per object body, place, rest
        reserved = _RESERVED if self.supply.once else 0
        missing = self.most - reserved - len(self.spawned) - len(self.due)
        if missing > 0:
            self.due += self.rng.choice(list(self.choices), missing, p=self.shares).tolist()
        if not self.due:
            return
        # places already taken, apart for drivers (False) and pedestrians (True)
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
        """Draw a place for a body, or return None if the first `_TRIES` are not free.

        A place is a row of `places` for the SUMO class of the body. occupied: x, y (m) of objects
        to keep away from. A vehicle also needs its length of lane behind the place."""
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
        # Add vehicle `name` to SUMO at a place (a row of `places`), on a random drive.
        places = self.places[self.supply.classes[body]]
        lane = places.lanes[place]
        edges = self.roads.route(lane, self.supply.classes[body], _ROUTE_LENGTH, self.rng)
        if (route := " ".join(edges)) not in self.routes:
            self.sumo.route.add(route, edges)
            self.routes.add(route)
        # the number after the last "_" of a lane's name counts the lanes of its edge
        start = {"departLane": lane.rpartition("_")[2], "departPos": f"{places.offsets[place]:.2f}"}
        self.sumo.vehicle.add(
            name, route, f"{body}-{self.rng.integers(POSITIONS)}", **start, departSpeed="max"
        )

    def _add_walker(self, name: str, body: int, place: int) -> None:
        # Add person `name` to SUMO at a place, on a walk to another, random one.
        places = self.places["pedestrian"]
        destination = int(self.rng.integers(len(places.lanes)))
        start, end = (self.roads.lanes[places.lanes[index]].edge for index in (place, destination))
        if (start, end) not in self.walks:
            stages = self.sumo.simulation.findIntermodalRoute(start, end, pType=f"{body}-0")
            self.walks[start, end] = [edge for stage in stages for edge in stage.edges] or [start]
        self.sumo.person.add(name, start, float(places.offsets[place]), typeID=f"{body}-0")
        walk = self.walks[start, end]
        # without a way there, walk to the middle of the lane on which it starts
        arrival = places.offsets[destination] if walk[-1] == end else places.lengths[place] / 2
        self.sumo.person.appendWalkingStage(name, walk, float(arrival))

    def _add_companions(self, leader: int, room: int) -> None:
        """Add up to three companions next to a pedestrian.

        leader: id of the pedestrian; room: largest number of companions."""
        first = self.spawned[leader]
        beside = 0.0
        for _ in range(min(int(self.rng.choice(len(_COMPANIONS), p=_COMPANIONS)), room)):
            body = self.supply.offer(self.choices[PEDESTRIAN])
            self.supply.take(body)
            # alternately farther to the left and mirrored to the right
            beside = beside + self.rng.uniform(*_SHOULDER) if beside >= 0 else -beside
            turn = first.turn + float(np.radians(self.rng.normal(0, SWAY[PEDESTRIAN])))
            behind = self.rng.uniform(-0.4, 0.4)
            self.spawned[next(self.ids)] = Spawned(
                body, True, first.aside + beside, turn, behind=behind, leader=leader
            )
