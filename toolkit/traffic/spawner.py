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
from toolkit.traffic.sumo import STEP_S
from toolkit.traffic.supply import POSITIONS, SHARES, SWAY_DEG, Supply

LIFE = 4  # frames an object is seen in
SPAWN_REACH_M = (
    25.0  # m round the area in which things are spawned; they are removed `_LEEWAY_M` farther out
)
_LEEWAY_M = 10.0  # m
_ROUTE_LENGTH_M = 300.0  # m; farther than anything drives in its life
_MAX_PLACE_TRIES = 8  # places looked at before a spawn is put off to the next step
_MAX_PEDESTRIAN_OFFSET_M = (
    0.3  # m, at most, that a pedestrian walks left or right of the middle of its stripe
)
# shares of pedestrians of a drawn fleet with 0, 1, 2, 3 companions
_COMPANION_SHARES = (0.7, 0.19, 0.08, 0.03)
_RESERVED = 2  # objects that are not spawned if there may be companions, to leave room for these
_SHOULDER_GAPS_M = (
    0.55,
    0.8,
)  # lowest and highest distance (m) between two pedestrians side by side


@dataclass
class Spawned:
    """State of one spawned object.

    Its pose is SUMO's, moved `aside` (m to the left) and `behind` (m back, pedestrians only) and
    turned by `turn` (rad, counter-clockwise)."""

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
        self,
        sumo: ModuleType,
        site: Site,
        supply: Supply,
        *,
        max_objects: int,
        step: float = STEP_S,
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
            kind: self.roads.places(site.area, SPAWN_REACH_M, kind)
            for kind in sorted(set(supply.classes))
        }
        if not self.places["passenger"].lanes:
            where = f"within {SPAWN_REACH_M:.0f} m of the area {site.area.tolist()}"
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
        self.walk_edges: dict[tuple[str, str], list[str]] = {}
        self.routes: set[str] = set()  # names of the routes that SUMO knows

    def advance(self, seconds: float) -> None:
        """Simulate on for some seconds, spawning missing objects before every step.

        Objects without a place by the end are given up."""
        for _ in range(round(seconds / self.step)):
            self._spawn()
            self.sumo.simulationStep()
            present_ids = {*self.sumo.vehicle.getIDList(), *self.sumo.person.getIDList()}
            for name, spawned in list(self.spawned.items()):
                sumo_id = str(name if spawned.leader is None else spawned.leader)
                if sumo_id in present_ids:
                    spawned.inserted = True
                    continue
                # it arrived, or SUMO could not insert it: then it is due again
                del self.spawned[name]
                if not spawned.inserted:
                    self.supply.take(spawned.body, is_used=False)
                    if spawned.leader is None:
                        self.due.append(int(self.supply.labels[spawned.body]))
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
        poses = {}  # by id
        for name, spawned in self.spawned.items():
            domain = self.domains[spawned.walks]
            sumo_id = str(name if spawned.leader is None else spawned.leader)
            x, y = domain.getPosition(sumo_id)  # a vehicle's front, or a person's middle
            # degrees clockwise from north; NaN for some vehicles that change lanes
            bearing = domain.getAngle(sumo_id)
            if not np.isfinite(bearing):
                bearing = self.sumo.lane.getAngle(
                    domain.getLaneID(sumo_id), domain.getLanePosition(sumo_id)
                )
            yaw = np.pi / 2 - np.radians(bearing)
            half_length = self.supply.sizes[spawned.body, 0] / 2
            back = spawned.behind if spawned.walks else half_length
            # back along the heading, and `aside` to its left
            x -= back * np.cos(yaw) + spawned.aside * np.sin(yaw)
            y -= back * np.sin(yaw) - spawned.aside * np.cos(yaw)
            poses[name] = np.array([x, y, yaw + spawned.turn])
        points = np.array([pose[:2] for pose in poses.values()]).reshape(-1, 2)
        is_distant = distance_to_area(points, self.area) > SPAWN_REACH_M + _LEEWAY_M
        self.remove(np.array(list(poses), np.int64)[is_distant])
        ids = np.array(list(self.spawned), np.int64)
        bodies = np.array([spawned.body for spawned in self.spawned.values()], np.int64)
        return ids, bodies, np.array([poses[name] for name in self.spawned]).reshape(-1, 3)

    def remove(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Remove objects, and companions of removed leaders; unknown ids are ignored."""
        for name in ids.tolist():
            removed = self.spawned.pop(name, None)
            self.spawned = {
                other_name: spawned
                for other_name, spawned in self.spawned.items()
                if spawned.leader != name
            }
            if removed and removed.leader is None:  # SUMO does not know companions
                persons_or_vehicles = self.domains[removed.walks]
                persons_or_vehicles.remove(str(name))

    def count_frame(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Count a frame in which these objects were seen; remove those seen in `LIFE` frames."""
        known_ids = [name for name in ids.tolist() if name in self.spawned]
        for name in known_ids:
            self.spawned[name].frames += 1
        ended_ids = [name for name in known_ids if self.spawned[name].frames >= LIFE]
        self.remove(np.array(ended_ids, np.int64))

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
            (self._add_pedestrian if walks else self._add_driver)(str(name), body, place)
            aside = (
                self.rng.uniform(-_MAX_PEDESTRIAN_OFFSET_M, _MAX_PEDESTRIAN_OFFSET_M)
                if walks
                else 0.0
            )
            turn = float(np.radians(self.rng.normal(0, SWAY_DEG[label])))
            self.spawned[name] = Spawned(body, walks, aside, turn)
            if walks and self.supply.once:
                self._add_companions(name, self.most - len(self.spawned) - len(waiting))
            positions[walks] = np.vstack(
                [positions[walks], self.places[self.supply.classes[body]].points[place]]
            )

    def _free_place(self, body: int, occupied: Float64[np.ndarray, "m 2"]) -> int | None:
        """Draw a place for a body, or return None if the first `_MAX_PLACE_TRIES` are not free.

        A place is a row of `places` for the SUMO class of the body. occupied: x, y (m) of objects
        to keep away from. A vehicle also needs its length of lane behind the place."""
        places = self.places[self.supply.classes[body]]
        length = self.supply.sizes[body, 0]
        candidates = self.rng.integers(len(places.lanes), size=_MAX_PLACE_TRIES)
        square_distances = np.square(places.points[candidates][:, None] - occupied[None]).sum(-1)
        is_driver = self.supply.labels[body] != PEDESTRIAN
        least_distance = length + (2.0 if is_driver else 0.5)  # m
        is_free = (square_distances > least_distance**2).all(axis=1)
        if is_driver:
            # short lanes need their length less 1 m only
            needed_lane = np.minimum(length, places.lengths[candidates] - 1)
            is_free &= places.offsets[candidates] >= needed_lane
        return int(candidates[np.argmax(is_free)]) if is_free.any() else None

    def _add_driver(self, name: str, body: int, place: int) -> None:
        """Add a vehicle to SUMO, on a random drive.

        name: its id; body: row of its body; place: row in `places` of its class."""
        vehicle_class = self.supply.classes[body]
        places = self.places[vehicle_class]
        lane = places.lanes[place]
        edges = self.roads.route(lane, vehicle_class, _ROUTE_LENGTH_M, self.rng)
        route = " ".join(edges)  # its name
        if route not in self.routes:
            self.sumo.route.add(route, edges)
            self.routes.add(route)
        # the number after the last "_" of a lane's name counts the lanes of its edge
        lane_number = lane.rpartition("_")[2]
        self.sumo.vehicle.add(
            name,
            route,
            f"{body}-{self.rng.integers(POSITIONS)}",  # SUMO's type: body and lateral position
            departLane=lane_number,
            departPos=f"{places.offsets[place]:.2f}",
            departSpeed="max",
        )

    def _add_pedestrian(self, name: str, body: int, place: int) -> None:
        """Add a person to SUMO, on a walk to another, random place.

        name: its id; body: row of its body; place: row in `places` of pedestrians."""
        places = self.places["pedestrian"]
        destination = int(self.rng.integers(len(places.lanes)))
        start_edge = self.roads.lanes[places.lanes[place]].edge
        end_edge = self.roads.lanes[places.lanes[destination]].edge
        sumo_type = f"{body}-0"
        key = start_edge, end_edge
        if key not in self.walk_edges:
            stages = self.sumo.simulation.findIntermodalRoute(*key, pType=sumo_type)
            edges = [edge for stage in stages for edge in stage.edges]
            self.walk_edges[key] = edges or [start_edge]
        self.sumo.person.add(name, start_edge, float(places.offsets[place]), typeID=sumo_type)
        walk = self.walk_edges[key]
        # m along the last lane; without a way there, to the middle of the lane on which it starts
        arrival = places.offsets[destination] if walk[-1] == end_edge else places.lengths[place] / 2
        self.sumo.person.appendWalkingStage(name, walk, float(arrival))

    def _add_companions(self, leader: int, room: int) -> None:
        """Add up to three companions next to a pedestrian, who take its poses at a distance.

        leader: id of the pedestrian; room: largest number of companions."""
        first = self.spawned[leader]
        drawn_number = int(self.rng.choice(len(_COMPANION_SHARES), p=_COMPANION_SHARES))
        offset = 0.0  # m to the left of the leader
        for _ in range(min(drawn_number, room)):
            body = self.supply.offer(self.choices[PEDESTRIAN])
            self.supply.take(body)
            # alternately farther to the left and mirrored to the right
            offset = offset + self.rng.uniform(*_SHOULDER_GAPS_M) if offset >= 0 else -offset
            turn = first.turn + float(np.radians(self.rng.normal(0, SWAY_DEG[PEDESTRIAN])))
            behind = self.rng.uniform(-0.4, 0.4)  # m
            self.spawned[next(self.ids)] = Spawned(
                body,
                walks=True,
                aside=first.aside + offset,
                turn=turn,
                behind=behind,
                leader=leader,
            )
