"""What moves on a site: spawned near the detection area, driven by SUMO, gone after four frames.

SUMO gives the middle of a vehicle's front bumper, and as its angle the direction to it from the middle of the rear
bumper, both on the path, so headings turn continuously through bends. A body's box hangs on that line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.roads import Roads, distance_to_area
from toolkit.site import Site
from toolkit.sumo import STEP

if TYPE_CHECKING:
    from toolkit.bodies import Body

HEAVY_SHARE = 0.08  # of the vehicles
SHARES = {VEHICLE: 0.6 * (1 - HEAVY_SHARE), HEAVY: 0.6 * HEAVY_SHARE, CYCLIST: 0.2, PEDESTRIAN: 0.2}  # paper, Dataset
LIFE = 4  # frames an object is seen in
REACH = 25.0  # m round the area in which things are spawned; they are given up `_LEEWAY` farther out
BICYCLE_LENGTH = 1.75  # m; a longer two-wheeler has an engine

_LEEWAY = 10.0
_ROUTE_LENGTH = 300.0  # m; farther than anything drives in its life
_TRIES = 8  # places looked at before a spawn is put off to the next step
_POSITIONS = 3  # lateral positions in the lane, drawn per body
_ASIDE = 0.3  # m a pedestrian walks beside the middle of its stripe
_SWAY = {VEHICLE: 0.5, HEAVY: 0.3, CYCLIST: 2.0, PEDESTRIAN: 8.0}  # degrees; deviation of an object's yaw


@dataclass
class Mover:
    """One spawned object: row of its body, frames it has been seen in, and how it deviates from SUMO's pose."""

    body: int
    walks: bool
    aside: float
    turn: float
    frames: int = 0


class Population:
    """Everything SUMO moves, at most `most` at a time; object n is vehicle or person "n" in SUMO.

    Raises ValueError where no lane of the network near the area is open to cars.
    """

    def __init__(
        self,
        sumo: Any,
        site: Site,
        bodies: Sequence[Body],
        rng: np.random.Generator,
        ids: Iterator[int],
        most: int,
    ) -> None:
        self.sumo, self.area, self.rng, self.ids, self.most = sumo, site.area, rng, ids, most
        self.labels = [body.label for body in bodies]
        self.lengths = [body.size[0] for body in bodies]
        self.classes = [sumo_class(body) for body in bodies]
        self.roads = Roads.read(sumo)
        self.places = {kind: self.roads.places(site.area, REACH, kind) for kind in sorted(set(self.classes))}
        if not len(self.places["passenger"]):
            raise ValueError(
                f"site {site.name!r}: no lane open to cars within {REACH:.0f} m of the area {site.area.tolist()}: "
                "give the network in site coordinates, or move the area onto the road"
            )
        self.choices = {
            label: [
                row for row, kind in enumerate(self.classes) if self.labels[row] == label and len(self.places[kind])
            ]
            for label in SHARES
        }
        self.movers: dict[int, Mover] = {}
        self.walks: dict[tuple[str, str], list[str]] = {}
        self.routes: dict[tuple[str, ...], str] = {}

    def advance(self, seconds: float) -> None:
        """Simulate on, filling up the population before every step."""
        for _ in range(round(seconds / STEP)):
            self._spawn()
            self.sumo.simulationStep()
            self._forget_the_gone()

    def state(self) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Ids, bodies and poses (x, y, yaw of the middle of the body) of all that move, the oldest first."""
        poses = {name: self._pose(name, mover) for name, mover in self.movers.items()}
        points = np.array([pose[:2] for pose in poses.values()]).reshape(-1, 2)
        distant = distance_to_area(points, self.area) > REACH + _LEEWAY
        self.remove(np.array(list(poses), np.int64)[distant])
        ids = np.array(list(self.movers), np.int64)
        bodies = np.array([mover.body for mover in self.movers.values()], np.int64)
        return ids, bodies, np.array([poses[name] for name in self.movers]).reshape(-1, 3)

    def remove(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Take objects out of the simulation; ids that do not move are left alone."""
        for name in ids.tolist():
            mover = self.movers.pop(name, None)
            if mover:
                (self.sumo.person if mover.walks else self.sumo.vehicle).remove(str(name))

    def count_frame(self, ids: Int64[np.ndarray, " n"]) -> None:
        """Note that these objects were seen in a frame; for some it was the last."""
        seen = [name for name in ids.tolist() if name in self.movers]
        for name in seen:
            self.movers[name].frames += 1
        self.remove(np.array([name for name in seen if self.movers[name].frames >= LIFE], np.int64))

    def _spawn(self) -> None:
        positions = {walks: self._positions(walks) for walks in (False, True)}
        labels = [label for label, rows in self.choices.items() if rows]
        shares = np.array([SHARES[label] for label in labels])
        for label in self.rng.choice(labels, self.most - len(self.movers), p=shares / shares.sum()):
            body = int(self.rng.choice(self.choices[label]))
            walks = label == PEDESTRIAN
            place = self._free_place(body, positions[walks])
            if place is None:
                continue
            name = next(self.ids)
            (self._add_walker if walks else self._add_driver)(str(name), body, place)
            self.movers[name] = Mover(
                body,
                walks,
                aside=self.rng.uniform(-_ASIDE, _ASIDE) if walks else 0.0,
                turn=np.deg2rad(self.rng.normal(0, _SWAY[label])),
            )
            positions[walks] = np.vstack([positions[walks], self.places[self.classes[body]].points[place]])

    def _free_place(self, body: int, taken: Float64[np.ndarray, "m 2"]) -> int | None:
        """A random place away from the taken ones with room for the body behind it, if one is found quickly."""
        places, length = self.places[self.classes[body]], self.lengths[body]
        candidates = self.rng.integers(len(places), size=_TRIES)
        gaps = np.square(places.points[candidates][:, None] - taken[None]).sum(-1)
        free = (gaps > (length + 2) ** 2).all(axis=1)
        if self.labels[body] != PEDESTRIAN:
            free &= places.offsets[candidates] >= np.minimum(length, places.lengths[candidates] - 1)
        return int(candidates[np.argmax(free)]) if free.any() else None

    def _add_driver(self, name: str, body: int, place: int) -> None:
        places = self.places[self.classes[body]]
        lane = places.lanes[place]
        edges = self.roads.route(lane, self.classes[body], _ROUTE_LENGTH, self.rng)
        route = self.routes.setdefault(tuple(edges), f"route{len(self.routes)}")
        if route not in self.sumo.route.getIDList():
            self.sumo.route.add(route, edges)
        self.sumo.vehicle.add(
            name,
            route,
            f"{body}-{self.rng.integers(_POSITIONS)}",
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
        self.sumo.person.appendWalkingStage(name, self.walks[start, end], float(places.offsets[there]))

    def _positions(self, walks: bool) -> Float64[np.ndarray, "n 2"]:
        domain = self.sumo.person if walks else self.sumo.vehicle
        names = [str(name) for name, mover in self.movers.items() if mover.walks == walks]
        return np.array([domain.getPosition(name) for name in names]).reshape(-1, 2)

    def _pose(self, name: int, mover: Mover) -> Float64[np.ndarray, "3"]:
        domain = self.sumo.person if mover.walks else self.sumo.vehicle
        x, y = domain.getPosition(str(name))
        yaw = np.pi / 2 - np.deg2rad(domain.getAngle(str(name)))  # SUMO: clockwise from north
        back = 0.0 if mover.walks else self.lengths[mover.body] / 2
        x -= back * np.cos(yaw) + mover.aside * np.sin(yaw)
        y -= back * np.sin(yaw) - mover.aside * np.cos(yaw)
        yaw += mover.turn
        return np.array([x, y, np.arctan2(np.sin(yaw), np.cos(yaw))])

    def _forget_the_gone(self) -> None:
        """Drop what has arrived or could not be inserted; and what SUMO inserts later after all leaves again."""
        there = {*self.sumo.vehicle.getIDList(), *self.sumo.person.getIDList()}
        for name in [name for name in self.movers if str(name) not in there]:
            del self.movers[name]
        for name in self.sumo.vehicle.getIDList():
            if int(name) not in self.movers:
                self.sumo.vehicle.remove(name)


def sumo_class(body: Body) -> str:
    """SUMO's vehicle class of a body, which says which lanes it may use."""
    two_wheeler = "bicycle" if body.size[0] <= BICYCLE_LENGTH else "motorcycle"
    return {VEHICLE: "passenger", HEAVY: "truck", CYCLIST: two_wheeler, PEDESTRIAN: "pedestrian"}[body.label]


def vehicle_types(bodies: Sequence[Body], rng: np.random.Generator) -> str:
    """SUMO's additional file that declares type "body-position" for every body and lateral position in the lane."""
    rows = []
    for number, body in enumerate(bodies):
        length, width, height = body.size
        spread = {VEHICLE: 0.25, CYCLIST: 0.8}.get(body.label, 0.0)
        for position in range(_POSITIONS):
            offset = np.clip(rng.normal(0, spread), -1.2, 1.2)
            gap = 0.5 if body.label == PEDESTRIAN else rng.uniform(1.0, 2.5)
            rows.append(
                f'<vType id="{number}-{position}" vClass="{sumo_class(body)}" length="{length:.2f}" width="{width:.2f}" '
                f'height="{height:.2f}" minGap="{gap:.2f}" latAlignment="{offset:.2f}"/>'
            )
    return f"<additional>\n{chr(10).join(rows)}\n</additional>\n"
