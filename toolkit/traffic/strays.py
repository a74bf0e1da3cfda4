"""Strays: road users at places that are unusual for their class.

They are on any lane or footway, next to walls and vehicles, shoulder to shoulder. If all road users
kept to the lanes of their class, a detector would learn the place instead of the shape: a
pedestrian on a lane would become a cyclist. Strays have a speed of 0 or go straight on, at any
heading, for as many frames as other road users live."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE
from toolkit.sites.site import Site
from toolkit.traffic.obstacles import Obstacles
from toolkit.traffic.spawner import LIFE
from toolkit.traffic.stray_ground import MAX_STRAY_GAP_M, StrayGround
from toolkit.traffic.supply import Supply

# share of each class among the strays
STRAY_SHARES = {PEDESTRIAN: 0.54, CYCLIST: 0.26, VEHICLE: 0.12, HEAVY: 0.08}
# shares of strays next to a solid or a vehicle, and next to the stray drawn before
NEXT_TO_SHARE = 0.35
COMPANION_SHARE = 0.3
STANDING_SHARES = {
    PEDESTRIAN: 0.5,
    CYCLIST: 0.3,
    VEHICLE: 1.0,
    HEAVY: 1.0,
}  # share that does not move, of the others
SPEEDS_M_S = {PEDESTRIAN: (0.4, 1.8), CYCLIST: (1.0, 6.0)}  # lowest and highest
MIN_STRAY_GAP_M = 0.12  # smallest distance between a stray and the thing next to it
MAX_COMPANION_GAP_M = 0.4  # largest distance between the sides of two companions
MAX_TRIES = 6  # places looked at before one among solids is taken
# x, y (m) and yaw (rad), site frame
_Poses = Float64[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class Strays:
    """n strays at one moment: row k of `bodies`, `ids` and the arrays after them is stray k.

    Attributes:
        ground: places for them.
        obstacles: solids that they keep clear of.
        bodies: row of its body in the supply.
        ids: its id.
        poses: its x, y (m), yaw (rad) when drawn.
        speeds: its speed (m/s).
        drawn_s: time when it was drawn (s).
        frames_left: number of frames that it still lives."""

    ground: StrayGround
    obstacles: Obstacles
    bodies: Int64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    poses: _Poses
    speeds: Float64[np.ndarray, " n"]
    drawn_s: Float64[np.ndarray, " n"]
    frames_left: Int64[np.ndarray, " n"]

    @staticmethod
    def draw(
        site: Site, obstacles: Obstacles, supply: Supply, number: int, vehicles: np.ndarray
    ) -> "Strays":
        """Draw strays for the first frame.

        Args:
            site: Site with lanes and footways.
            obstacles: Solids that strays keep clear of.
            supply: Gives bodies, ids and random numbers.
            number: Number of strays; without free ground there is no stray.
            vehicles: Boxes (n, 7) of parked vehicles, next to which strays may be too."""
        rng = supply.rng
        ground = StrayGround.draw(site, obstacles, rng) if number else StrayGround.empty()
        if number and len(vehicles):
            ground = ground.add_vehicles(vehicles)
        no_numbers = np.zeros(0)
        no_integers = np.zeros(0, np.int64)
        nobody = Strays(
            ground=ground,
            obstacles=obstacles,
            bodies=no_integers,
            ids=no_integers,
            poses=np.zeros((0, 3)),
            speeds=no_numbers,
            drawn_s=no_numbers,
            frames_left=no_integers,
        )
        number = number if len(ground.points) else 0
        # lives of different length, so that not all end in the same frame
        lives = rng.integers(1, LIFE + 1, number)
        return nobody._add(number, supply, time=0.0, lives=lives)

    def at(self, time: float) -> _Poses:
        """Poses at a time (s since the first frame), straight on from the drawn pose."""
        distances = self.speeds * (time - self.drawn_s)
        x, y, yaw = self.poses.T
        return np.column_stack([x + distances * np.cos(yaw), y + distances * np.sin(yaw), yaw])

    def later(self, supply: Supply, time: float) -> "Strays":
        """Strays a frame later, with new ones instead of those whose life is over.

        time: time of that frame (s since the first one)."""
        frames_left = self.frames_left - 1
        is_alive = frames_left > 0
        alive = replace(
            self,
            bodies=self.bodies[is_alive],
            ids=self.ids[is_alive],
            poses=self.poses[is_alive],
            speeds=self.speeds[is_alive],
            drawn_s=self.drawn_s[is_alive],
            frames_left=frames_left[is_alive],
        )
        missing = int((~is_alive).sum())
        return alive._add(missing, supply, time=time, lives=np.full(missing, LIFE))

    def _add(self, number: int, supply: Supply, time: float, lives: np.ndarray) -> "Strays":
        """Return the strays with `number` new ones after them.

        time: time from which they move (s); lives: number of frames that each new one lives."""
        rng = supply.rng
        labels = [label for label in STRAY_SHARES if (supply.labels == label).any()]
        shares = np.array([STRAY_SHARES[label] for label in labels])
        strays: list[_Stray] = []
        for label in rng.choice(labels, number, p=shares / shares.sum()).tolist():
            has_company = bool(strays) and rng.random() < COMPANION_SHARE
            previous = strays[-1] if has_company else None
            strays.append(self._draw_stray(label, previous, supply))
        ids = [next(supply.ids) for _ in range(number)]
        new_bodies = np.array([stray.body for stray in strays], np.int64)
        new_poses = np.array([stray.pose for stray in strays]).reshape(-1, 3)
        return replace(
            self,
            bodies=np.append(self.bodies, new_bodies),
            ids=np.append(self.ids, np.array(ids, np.int64)),
            poses=np.concatenate([self.poses, new_poses]),
            speeds=np.append(self.speeds, [stray.speed for stray in strays]),
            drawn_s=np.append(self.drawn_s, np.full(number, time)),
            frames_left=np.append(self.frames_left, lives),
        )

    def _draw_stray(self, label: int, previous: "_Stray | None", supply: Supply) -> "_Stray":
        """Draw a stray of a class, or a companion of another stray.

        previous: that other stray, which fixes place and speed and mostly the class; None for a
        stray without company."""
        rng = supply.rng
        if previous is not None and rng.random() < 0.8:
            label = int(supply.labels[previous.body])
        body = int(supply.several(np.flatnonzero(supply.labels == label), 1)[0])
        is_standing = rng.random() < STANDING_SHARES[label]
        speed = 0.0 if is_standing else float(rng.uniform(*SPEEDS_M_S[label]))
        if previous is not None:
            widths = supply.sizes[[previous.body, body], 1]  # column 1 of length, width, height (m)
            pose = _place_companion(previous.pose, widths, rng)
            speed = previous.speed
        else:
            pose, is_next_to = self._draw_place(supply.sizes[body], rng)
            if is_next_to:
                speed = 0.0
        return _Stray(body, pose, speed if label in SPEEDS_M_S else 0.0)

    def _draw_place(
        self, size: np.ndarray, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "3"], bool]:
        """Draw a pose (x, y, yaw), and True if it is next to a solid or a vehicle.

        size: length, width, height (m) of the body. The pose is clear of solids if one of
        `MAX_TRIES` draws is."""
        pose = np.zeros(3)
        is_next_to = False
        for _ in range(MAX_TRIES):
            yaw = rng.uniform(-np.pi, np.pi)
            is_next_to = len(self.ground.edges) > 0 and rng.random() < NEXT_TO_SHARE
            if is_next_to:
                edge = self.ground.edges[rng.integers(len(self.ground.edges))]
                pose = _place_next_to(edge, yaw, size, rng)
            else:
                x, y = self.ground.points[rng.integers(len(self.ground.points))]
                pose = np.array([x, y, yaw])
            x, y = pose[:2]
            height = size[2]
            box = np.array([[x, y, height / 2, *size, pose[2]]])  # pose[2] is its yaw
            (is_hit,) = self.obstacles.hit(box)
            if not is_hit:
                break
        return pose, is_next_to


class _Stray(NamedTuple):
    """Stray that was drawn: row of its body, pose (x, y in m, yaw in rad) and speed (m/s)."""

    body: int
    pose: Float64[np.ndarray, "3"]
    speed: float


def _place_next_to(
    edge: np.ndarray, yaw: float, size: np.ndarray, rng: np.random.Generator
) -> Float64[np.ndarray, "3"]:
    """Pose (x, y, yaw) next to an edge, mostly along or across it.

    edge: x, y and its outward unit normal nx, ny; yaw: heading (rad) for strays that are neither
    along nor across it; size: length, width, height (m) of the body."""
    x, y, nx, ny = edge
    length, width = size[:2]
    along_edge = np.arctan2(nx, -ny)  # heading (rad)
    if rng.random() < 0.6:
        yaw = along_edge + np.pi / 2 * rng.integers(4) + rng.normal(0, 0.1)
    turn = yaw - along_edge
    # half of the body's extent at right angles to the edge
    half_depth = abs(np.cos(turn)) * width / 2 + abs(np.sin(turn)) * length / 2
    distance = half_depth + rng.uniform(MIN_STRAY_GAP_M, MAX_STRAY_GAP_M)
    return np.array([x + distance * nx, y + distance * ny, yaw])


def _place_companion(
    first: np.ndarray, widths: np.ndarray, rng: np.random.Generator
) -> Float64[np.ndarray, "3"]:
    """Pose (x, y, yaw) to the left of a person drawn before, so that a group is in a row.

    first: pose of that person; widths: widths of that body and the companion's (m)."""
    x, y, yaw = first
    to_left = widths.sum() / 2 + rng.uniform(MIN_STRAY_GAP_M, MAX_COMPANION_GAP_M)
    behind = rng.normal(0, 0.15)  # m, as to_left
    companion_x = x - to_left * np.sin(yaw) - behind * np.cos(yaw)
    companion_y = y + to_left * np.cos(yaw) - behind * np.sin(yaw)
    return np.array([companion_x, companion_y, yaw + rng.normal(0, 0.1)])
