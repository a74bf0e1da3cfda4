"""`Spawner`: spawns traffic near the detection area, which SUMO moves, and removes it after four frames.

SUMO gives the middle of a vehicle's front bumper, and as its angle the direction to it from the middle of the rear
bumper, both on the path, so headings turn continuously through bends. A body's box lies on that line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import PEDESTRIAN
from toolkit.sites.site import Site
from toolkit.traffic.routes import Roads, distance_to_area
from toolkit.traffic.sumo import STEP
from toolkit.traffic.supply import Supply
from toolkit.traffic.vehicle_types import POSITIONS, SHARES, SWAY, VehicleTypes

LIFE = 4  # frames an object is seen in
SPAWN_REACH = 25.0  # m round the area in which things are spawned; they are removed `_LEEWAY` farther out

_LEEWAY = 10.0
_ROUTE_LENGTH = 300.0  # m; farther than anything drives in its life
_TRIES = 8  # places looked at before a spawn is put off to the next step
_ASIDE = 0.3  # m a pedestrian walks beside the middle of its stripe
_COMPANIONS = (0.7, 0.19, 0.08, 0.03)  # shares of pedestrians of a drawn fleet who walk with 0, 1, 2, 3 others
_RESERVED = 2  # of the places are left to companions where there may be some
_SHOULDER = (0.55, 0.8)  # m between two who walk side by side, from .. to


@dataclass
class Spawned:
    """One spawned object: row of its body, frames it has been seen in, and how it deviates from SUMO's pose: by `turn`
    (rad), `aside` and `behind` (m). leader: whose pose that is where SUMO does not know it, for companions on foot."""

    body: int
    walks: bool
    aside: float
    turn: float
    inserted: bool = False
    frames: int = 0
    behind: float = 0.0
    leader: int | None = None


class Spawner:
    """Spawns and removes everything SUMO moves, at most `most` at a time; object n is vehicle or person "n" in SUMO.

    Raises ValueError where no lane of the network near the area is open to cars.
    """

    def __init__(
        self,
        sumo: Any,
        site: Site,
        types: VehicleTypes,
        rng: np.random.Generator,
        ids: Iterator[int],
        *,
        most: int,
        supply: Supply | None = None,
        step: float = STEP,
    ) -> None:
        self.step = step
        self.sumo, self.area, self.rng, self.ids, self.most = sumo, site.area, rng, ids, most
        self.types, self.supply = types, supply or Supply(len(types.labels))
        self.roads = Roads.read(sumo)
        self.places = {kind: self.roads.places(site.area, SPAWN_REACH, kind) for kind in sorted(set(types.classes))}
        if not len(self.places["passenger"]):
            raise ValueError(
                f"site {site.name!r}: no lane open to cars within {SPAWN_REACH:.0f} m of the area "
                f"{site.area.tolist()}: give the network in site coordinates, or move the area onto the road"
            )
        possible = np.array([len(self.places[kind]) > 0 for kind in types.classes])
        rows = {label: np.flatnonzero(possible & (types.labels == label)) for label in SHARES}
        self.choices = {label: rows_of_label for label, rows_of_label in rows.items() if len(rows_of_label)}
        shares = np.array([SHARES[label] for label in self.choices])
        self.shares = shares / shares.sum()
        self.due: list[int] = []  # labels drawn, waiting for a place
        self.spawned: dict[int, Spawned] = {}
        self.walks: dict[tuple[str, str], list[str]] = {}
        self.routes: set[str] = set()

    def advance(self, seconds: float) -> None:
        """Simulate on, spawning what is missing before every step; what found no place by the end is given up."""
        for _ in range(round(seconds / self.step)):
            self._spawn()
            self.sumo.simulationStep()
            self._remove_arrived()
        self.due = []

    def state(self) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Ids, bodies and poses (x, y, yaw of the middle of the body) of all that move, the oldest first."""
        poses = {name: self._pose(name, spawned) for name, spawned in self.spawned.items()}
        points = np.array([pose[:2] for pose in poses.values()]).reshape(-1, 2)
        distant = distance_to_area(points, self.area) > SPAWN_REACH + _LEEWAY
        self.remove(np.array(list(poses), np.int64)[distant])
        ids = np.array(list(self.spawned), np.int64)
        bodies = np.array([spawned.body for spawned in self.spawned.values()], np.int64)
        return ids, bodies, np.array([poses[name] for name in self.spawned]).reshape(-1, 3)

    def remove(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Take objects out of the simulation; ids that do not move are left alone."""
        for name in ids.tolist():
            spawned = self.spawned.pop(name, None)
            self.spawned = {other: each for other, each in self.spawned.items() if each.leader != name}
            if spawned and spawned.leader is None:
                (self.sumo.person if spawned.walks else self.sumo.vehicle).remove(str(name))

    def count_frame(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Note that these objects were seen in a frame; for some it was the last."""
        seen = [name for name in ids.tolist() if name in self.spawned]
        for name in seen:
            self.spawned[name].frames += 1
        self.remove(np.array([name for name in seen if self.spawned[name].frames >= LIFE], np.int64))

    def _spawn(self) -> None:
        """Fill up to `most`. What finds no place keeps its turn, so that the shares hold where the road is full."""
        reserved = _RESERVED if self.supply.once else 0
        missing = self.most - reserved - len(self.spawned) - len(self.due)
        if missing > 0:
            self.due += self.rng.choice(list(self.choices), missing, p=self.shares).tolist()
        if not self.due:
            return
        positions = {walks: self._positions(walks) for walks in (False, True)}
        waiting, self.due = self.due, []
        for label in waiting:
            walks = label == PEDESTRIAN
            body = self.supply.offer(self.choices[label], self.rng)
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
            positions[walks] = np.vstack([positions[walks], self.places[self.types.classes[body]].points[place]])

    def _free_place(self, body: int, taken: Float64[np.ndarray, "m 2"]) -> int | None:
        """A random place away from the taken ones with room for the body behind it, if one is found quickly."""
        places, length = self.places[self.types.classes[body]], self.types.sizes[body, 0]
        candidates = self.rng.integers(len(places), size=_TRIES)
        gaps = np.square(places.points[candidates][:, None] - taken[None]).sum(-1)
        drives = self.types.labels[body] != PEDESTRIAN
        free = (gaps > (length + (2.0 if drives else 0.5)) ** 2).all(axis=1)
        if drives:
            free &= places.offsets[candidates] >= np.minimum(length, places.lengths[candidates] - 1)
        return int(candidates[np.argmax(free)]) if free.any() else None

    def _add_driver(self, name: str, body: int, place: int) -> None:
        places = self.places[self.types.classes[body]]
        lane = places.lanes[place]
        edges = self.roads.route(lane, self.types.classes[body], _ROUTE_LENGTH, self.rng)
        route = " ".join(edges)
        if route not in self.routes:
            self.sumo.route.add(route, edges)
            self.routes.add(route)
        self.sumo.vehicle.add(
            name,
            route,
            f"{body}-{self.rng.integers(POSITIONS)}",
            departLane=lane.rpartition("_")[2],
            departPos=f"{places.offsets[place]:.2f}",
            departSpeed="max",
        )

    def _add_walker(self, name: str, body: int, place: int) -> None:
        places = self.places["pedestrian"]
        there = int(self.rng.integers(len(places)))
        start, end = (self.roads.lanes[places.lanes[at]].edge for at in (place, there))
        if (start, end) not in self.walks:
            stages = self.sumo.simulation.findIntermodalRoute(start, end, pType=f"{body}-0")
            self.walks[start, end] = [edge for stage in stages for edge in stage.edges] or [start]
        self.sumo.person.add(name, start, float(places.offsets[place]), typeID=f"{body}-0")
        walk = self.walks[start, end]
        arrival = places.offsets[there] if walk[-1] == end else places.lengths[place] / 2  # no way there: stay here
        self.sumo.person.appendWalkingStage(name, walk, float(arrival))

    def _add_companions(self, leader: int, room: int) -> None:
        """Some who walk beside a pedestrian, not more than there is room for."""
        first, beside = self.spawned[leader], 0.0
        for _ in range(min(int(self.rng.choice(len(_COMPANIONS), p=_COMPANIONS)), room)):
            body = self.supply.offer(self.choices[PEDESTRIAN], self.rng)
            self.supply.take(body)
            beside = beside + self.rng.uniform(*_SHOULDER) if beside >= 0 else -beside
            turn = first.turn + float(np.radians(self.rng.normal(0, SWAY[PEDESTRIAN])))
            behind = self.rng.uniform(-0.4, 0.4)
            self.spawned[next(self.ids)] = Spawned(body, True, first.aside + beside, turn, behind=behind, leader=leader)

    def _positions(self, walks: bool) -> Float64[np.ndarray, "n 2"]:
        domain = self.sumo.person if walks else self.sumo.vehicle
        names = [
            str(name) for name, spawned in self.spawned.items() if spawned.walks == walks and spawned.leader is None
        ]
        return np.array([domain.getPosition(name) for name in names]).reshape(-1, 2)

    def _pose(self, name: int, spawned: Spawned) -> Float64[np.ndarray, "3"]:
        domain = self.sumo.person if spawned.walks else self.sumo.vehicle
        known = str(name if spawned.leader is None else spawned.leader)
        x, y = domain.getPosition(known)
        yaw = np.pi / 2 - np.radians(domain.getAngle(known))  # SUMO: clockwise from north
        back = spawned.behind if spawned.walks else self.types.sizes[spawned.body, 0] / 2
        x -= back * np.cos(yaw) + spawned.aside * np.sin(yaw)
        y -= back * np.sin(yaw) - spawned.aside * np.cos(yaw)
        return np.array([x, y, yaw + spawned.turn])

    def _remove_arrived(self) -> None:
        """Drop what has arrived. What SUMO could not insert is due again, and must not come later on its own."""
        there = {*self.sumo.vehicle.getIDList(), *self.sumo.person.getIDList()}
        for name, spawned in list(self.spawned.items()):
            if str(name if spawned.leader is None else spawned.leader) in there:
                spawned.inserted = True
                continue
            del self.spawned[name]
            if not spawned.inserted:
                self.supply.give_back(spawned.body)
            if not spawned.inserted and spawned.leader is None:
                self.due.append(int(self.types.labels[spawned.body]))
        for name in self.sumo.vehicle.getIDList():
            if int(name) not in self.spawned:
                self.sumo.vehicle.remove(name)
