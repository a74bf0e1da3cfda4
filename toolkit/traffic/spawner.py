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
