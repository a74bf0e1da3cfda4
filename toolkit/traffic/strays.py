"""Road users where their class seldom is: on any lane or footway, beside walls and vehicles, shoulder to shoulder.

Where everybody keeps to lanes of their own, a detector learns the place in place of the shape: a pedestrian on a lane
becomes a cyclist. Strays stand or go straight on, at any heading, for as many frames as other road users live.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely

from toolkit.arrays import Float64, Int64
from toolkit.boxes import footprints
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.sites.network import unite
from toolkit.sites.site import Site
from toolkit.traffic.obstacles import Obstacles
from toolkit.traffic.spawner import LIFE, Supply

STRAY_SHARES = {PEDESTRIAN: 0.54, CYCLIST: 0.26, VEHICLE: 0.12, HEAVY: 0.08}  # of the strays
BESIDE, COMPANIONS = 0.35, 0.3  # share that stands beside a solid or a vehicle, and beside the stray drawn before
STANDING_SHARES = {PEDESTRIAN: 0.5, CYCLIST: 0.3, VEHICLE: 1.0, HEAVY: 1.0}  # share of the others
SPEED = {PEDESTRIAN: (0.4, 1.8), CYCLIST: (1.0, 6.0)}  # m/s, from .. to
_NEAREST, _FARTHEST = 0.12, 1.5  # m of air between a stray and what it stands beside
_SHOULDER = 0.4  # m of air at most between two companions
_TRIES = 6
_EVERY = 0.5  # m between the places along an edge
_Poses = Float64[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class StrayGround:
    """Places of strays: points of lanes and footways in the area, and edges of solids there with outward normals."""

    points: Float64[np.ndarray, "n 2"]
    edges: Float64[np.ndarray, "m 4"]

    @staticmethod
    def of(site: Site, obstacles: Obstacles, rng: np.random.Generator) -> StrayGround:
        """Draw places all over a site's road."""
        surface = shapely.intersection(unite([*site.lanes, *site.footways]), shapely.box(*site.area))
        drawn = rng.uniform(site.area[:2], site.area[2:], (8000, 2))
        shapely.prepare(surface)
        points = drawn[shapely.contains_xy(surface, *drawn.T)]
        solids = obstacles.tree.geometries
        return StrayGround(points, outward_edges(solids[shapely.dwithin(solids, surface, _FARTHEST)]))


def outward_edges(polygons: np.ndarray) -> Float64[np.ndarray, "n 4"]:
    """Points every half metre along the outlines of polygons, and the outward normal at each: x y nx ny.

    >>> edges = outward_edges(shapely.polygons([[[0, 0], [0.5, 0], [0.5, 0.5], [0, 0.5]]]))
    >>> sorted((edges[:, 2:].round() + 0.0).tolist())
    [[-1.0, 0.0], [0.0, -1.0], [0.0, 1.0], [1.0, 0.0]]
    """
    rings = shapely.segmentize(shapely.get_exterior_ring(shapely.normalize(polygons)), _EVERY)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    ahead = np.diff(xy, axis=0)[ring[1:] == ring[:-1]]
    middles = ((xy[1:] + xy[:-1]) / 2)[ring[1:] == ring[:-1]]
    length = np.hypot(*ahead.T)
    kept = length > 1e-6
    normals = np.column_stack([-ahead[:, 1], ahead[:, 0]])[kept] / length[kept, None]
    return np.column_stack([middles[kept], normals])  # normalised rings run clockwise: left is outside


@dataclass(frozen=True, eq=False)
class Strays:
    """Strays of a moment: body, id, pose when drawn (x, y, yaw), speed (m/s), time then (s) and frames to live."""

    ground: StrayGround
    obstacles: Obstacles
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: _Poses
    speeds: Float64[np.ndarray, " n"]
    drawn: Float64[np.ndarray, " n"]
    left: Int64[np.ndarray, " n"]

    @staticmethod
    def draw(site: Site, obstacles: Obstacles, supply: Supply, number: int, vehicles: np.ndarray) -> Strays:
        """Draw so many strays. vehicles: boxes (n, 7) of those that park, which strays stand beside too."""
        rng, none = supply.rng, np.zeros(0)
        ground = StrayGround.of(site, obstacles, rng) if number else StrayGround(np.zeros((0, 2)), np.zeros((0, 4)))
        if number and len(vehicles):
            beside = outward_edges(shapely.polygons(footprints(vehicles)))
            again = max(1, len(ground.edges) // max(1, 2 * len(beside)))  # a third of the edges are those of vehicles
            ground = replace(ground, edges=np.concatenate([ground.edges, np.tile(beside, (again, 1))]))
        whole = none.astype(np.int64)
        strays = Strays(ground, obstacles, whole, whole, np.zeros((0, 3)), none, none, whole)
        number = number if len(ground.points) else 0
        return strays._add(number, supply, 0.0, rng.integers(1, LIFE + 1, number))

    def at(self, time: float) -> _Poses:
        """Poses at a time (s)."""
        gone = self.speeds * (time - self.drawn)
        x, y, yaw = self.poses.T
        return np.column_stack([x + gone * np.cos(yaw), y + gone * np.sin(yaw), yaw])

    def later(self, supply: Supply, time: float) -> Strays:
        """Strays a frame later, others in place of those whose life is over. time: of that frame (s)."""
        number, left = len(self.ids), self.left - 1
        kept = left > 0
        columns = {name: getattr(self, name)[kept] for name in ("bodies", "ids", "poses", "speeds", "drawn")}
        missing = number - int(kept.sum())
        return replace(self, **columns, left=left[kept])._add(missing, supply, time, np.full(missing, LIFE))

    def _add(self, number: int, supply: Supply, time: float, left: np.ndarray) -> Strays:
        rng, chosen = supply.rng, [label for label in STRAY_SHARES if (supply.labels == label).any()]
        shares = np.array([STRAY_SHARES[label] for label in chosen])
        bodies, poses, speeds = list[int](), list[np.ndarray](), list[float]()
        for label in rng.choice(chosen, number, p=shares / shares.sum()).tolist():
            has_company = bool(poses) and rng.random() < COMPANIONS
            if has_company:
                label = int(supply.labels[bodies[-1]]) if rng.random() < 0.8 else label
            body = int(supply.several(np.flatnonzero(supply.labels == label), 1)[0])
            stands = rng.random() < STANDING_SHARES[label]
            speed = 0.0 if stands else float(rng.uniform(*SPEED[label]))
            if has_company:
                pose, speed = self._place_companion(poses[-1], supply.sizes[[bodies[-1], body], 1], rng), speeds[-1]
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

    def _place(self, size: np.ndarray, rng: np.random.Generator) -> tuple[Float64[np.ndarray, "3"], bool]:
        """Pose on open ground or beside something, and whether it is the second; clear of solids where that is easy."""
        pose, beside = np.zeros(3), False
        for _ in range(_TRIES):
            yaw, beside = rng.uniform(-np.pi, np.pi), len(self.ground.edges) > 0 and rng.random() < BESIDE
            if beside:
                x, y, nx, ny = self.ground.edges[rng.integers(len(self.ground.edges))]
                edge = np.arctan2(nx, -ny)
                yaw = edge + np.pi / 2 * rng.integers(4) + rng.normal(0, 0.1) if rng.random() < 0.6 else yaw
                across = abs(np.cos(yaw - edge)) * size[1] / 2 + abs(np.sin(yaw - edge)) * size[0] / 2
                away = across + rng.uniform(_NEAREST, _FARTHEST)
                pose = np.array([x + away * nx, y + away * ny, yaw])
            else:
                pose = np.array([*self.ground.points[rng.integers(len(self.ground.points))], yaw])
            box = np.array([[pose[0], pose[1], size[2] / 2, *size, pose[2]]])
            if not self.obstacles.hit(box)[0]:
                break
        return pose, beside

    @staticmethod
    def _place_companion(first: np.ndarray, widths: np.ndarray, rng: np.random.Generator) -> Float64[np.ndarray, "3"]:
        """Pose to the left of the one drawn before, so that a group stands in a row."""
        x, y, yaw = first
        across, behind = widths.sum() / 2 + rng.uniform(_NEAREST, _SHOULDER), rng.normal(0, 0.15)
        x, y = x - across * np.sin(yaw) - behind * np.cos(yaw), y + across * np.cos(yaw) - behind * np.sin(yaw)
        return np.array([x, y, yaw + rng.normal(0, 0.1)])
