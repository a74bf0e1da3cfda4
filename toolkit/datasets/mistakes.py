"""Suspected mistakes in a recording's conventions: each classic mistake is undone and the fits are compared. The
evidence is motion. Sensors stand still, so a pixel that is nearer than in other frames shows an object. Points of such
pixels must lie on the objects' boxes: inside them, and near their surface rather than in their core. `fit` is the share
of moving points that do. A mistake is suspected if undoing it raises the fit clearly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Pose
from toolkit.datasets import published_layout as published
from toolkit.geometry import invert, transform
from toolkit.objects import HEAVY, VEHICLE
from toolkit.sensors.sensor import Sensor

CLEAR = 0.05  # least gain in fit that raises suspicion of a mistake
FITS = 0.6  # least fit without the mistake
ENOUGH = 200  # moving points: with fewer nothing is suspected
_MOVED = 0.3  # m nearer than the empty scene
_SLACK = 0.1  # m a point may lie outside its box
_CORE = 0.6  # fraction of a vehicle's box where a sensor sees nothing
_POINTS_PER_FRAME = 100  # of each sensor

_FORWARD_FIRST = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # of x right, y down, z forward

Rows = Float64[np.ndarray, "_ 10"]


@dataclass(frozen=True, eq=False)
class SensorImages:
    """Images of one sensor. rays: (pixels, 3), in its frame; depth: (frames, pixels), 0 for no return."""

    sensor: Sensor
    rays: Float32[np.ndarray, "pixels 3"]
    depth: Float32[np.ndarray, "frames pixels"]

    def moving(self) -> Bool[np.ndarray, "frames pixels"]:
        """Mask of the pixels that show a moving object, one that is missing in another frame."""
        seen = self.depth[(self.depth > 0).any(axis=1)]  # a frame without any return tells nothing about the scene
        if len(seen) < 3:
            return np.zeros(self.depth.shape, bool)
        background = np.where(seen > 0, seen, np.inf).max(axis=0)
        return (self.depth > 0) & (self.depth < 100) & (self.depth < background * 0.99 - _MOVED)

    def points(self, frame: int) -> Float32[np.ndarray, "_ 3"]:
        """Points of one frame, site frame."""
        seen = self.depth[frame] > 0
        return transform(self.sensor.pose, self.rays[seen] * self.depth[frame, seen, None])


class Witness(NamedTuple):
    """Moving pixels of one sensor in one frame."""

    frame: int
    sensor: int
    rays: Float64[np.ndarray, "p 3"]
    depth: Float64[np.ndarray, " p"]


class Suspicion(NamedTuple):
    """A mistake whose undoing raises the fit."""

    mistake: str
    remedy: str
    before: float
    after: float

    @property
    def evidence(self) -> str:
        """Both fits in words."""
        return f"{self.before:.0%} of the moving points lie on boxes as it is, {self.after:.0%} with that undone"


class Mistake(NamedTuple):
    """A mistake in the objects. undo: from columns, by short names, to those that change."""

    mistake: str
    remedy: str
    undo: Callable[..., dict[str, np.ndarray]]


_COLUMNS = ("x", "y", "z", "pitch", "roll", "yaw", "l", "w", "h", "label")
_FULL = "full extents stored where half extents belong: the boxes are twice too large"
_HALVED = "half of the half extents stored: the boxes are half as large as their objects"
_RADIANS, _TWICE = "yaw in radians where degrees belong", "yaw turned from radians to degrees twice"
_NEGATE_YAW = "negate column 5 of objects: CARLA's y points the other way, so does its yaw"
MIRROR_Y = "negate columns 1 (y) and 5 (yaw) of objects"
_MIRRORED = "mirrored y axis: a right-handed world where CARLA's left-handed one belongs"
_MIRROR_X = "negate column 0 (x) of objects and take 180 degrees minus column 5 (yaw)"
_SWAP = "swap columns 0 and 1 of objects and take 90 degrees minus column 5 (yaw)"
_END = "the centre of the {} stored where the centre of the box belongs: the boxes {} by half their height"
_ADD = "add column 8 (half height) to column 2 (z) of objects"
_SUBTRACT = "subtract column 8 (half height) from column 2 (z) of objects"
OBJECT_MISTAKES = (
    Mistake(_FULL, "halve columns 6 to 8 of objects", lambda o: {key: o[key] / 2 for key in "lwh"}),
    Mistake(_HALVED, "double columns 6 to 8 of objects", lambda o: {key: o[key] * 2 for key in "lwh"}),
    Mistake("length and width swapped", "swap columns 6 and 7 of objects", lambda o: {"l": o["w"], "w": o["l"]}),
    Mistake(_RADIANS, "multiply column 5 of objects by 180 / pi", lambda o: {"yaw": np.rad2deg(o["yaw"])}),
    Mistake(_TWICE, "multiply column 5 of objects by pi / 180", lambda o: {"yaw": np.deg2rad(o["yaw"])}),
    Mistake("yaw counted the other way round", _NEGATE_YAW, lambda o: {"yaw": -o["yaw"]}),
    Mistake("yaw a quarter turn off", "add 90 degrees to column 5 of objects", lambda o: {"yaw": o["yaw"] + 90}),
    Mistake(_MIRRORED, MIRROR_Y, lambda o: {"y": -o["y"], "yaw": -o["yaw"]}),
    Mistake("mirrored y axis, of the positions alone", "negate column 1 (y) of objects", lambda o: {"y": -o["y"]}),
    Mistake("mirrored x axis", _MIRROR_X, lambda o: {"x": -o["x"], "yaw": 180 - o["yaw"]}),
    Mistake("x and y swapped", _SWAP, lambda o: {"x": o["y"], "y": o["x"], "yaw": 90 - o["yaw"]}),
    Mistake(_END.format("floor", "are sunk"), _ADD, lambda o: {"z": o["z"] + o["h"]}),
    Mistake(_END.format("roof", "float"), _SUBTRACT, lambda o: {"z": o["z"] - o["h"]}),
)


LIFTED = tuple(
    Mistake(
        f"the boxes {'float above' if lift > 0 else 'are sunk into'} the ground, by about {abs(lift):.1f} m",
        f"{'subtract' if lift > 0 else 'add'} {abs(lift):.1f} m {'from' if lift > 0 else 'to'} column 2 (z) of objects",
        lambda o, lift=lift: {"z": o["z"] - lift},
    )
    for lift in (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, -0.3, -0.4, -0.5, -0.6, -0.8, -1.0)
)


def witnesses(views: Sequence[SensorImages]) -> list[Witness]:
    """Choose moving pixels of each sensor and frame, the same every time."""
    rng = np.random.default_rng(0)
    chosen = []
    for i, view in enumerate(views):
        for frame, moving in enumerate(view.moving()):
            pixels = np.flatnonzero(moving)
            if len(pixels) > _POINTS_PER_FRAME:
                pixels = rng.choice(pixels, _POINTS_PER_FRAME, replace=False)
            rays, depth = view.rays[pixels].astype(np.float64), view.depth[frame, pixels].astype(np.float64)
            chosen.append(Witness(frame, i, rays, depth))
    return chosen


def fit(clouds: Sequence[np.ndarray], rows: Sequence[Rows], map_SE3_site: Pose) -> float:
    """Share of points on the boxes of their frame. clouds: (n, 3) in the site's frame, one for each frame."""
    on_boxes = 0
    for points, table in zip(clouds, rows, strict=True):
        if not len(points) or not len(table):
            continue
        objects = published.parse_rows(table, map_SE3_site)
        x, y, z = (points.T[:, :, None] - objects.boxes.T[:3, None, :]).astype(np.float32)
        cos, sin = np.cos(objects.boxes[:, 6]), np.sin(objects.boxes[:, 6])
        offsets = np.abs([x * cos + y * sin, y * cos - x * sin, z])
        half = objects.boxes.T[3:6, None, :] / 2
        inside = np.all(offsets <= half + _SLACK, axis=0)
        core = np.all(offsets <= half * _CORE, axis=0) & np.isin(objects.labels, (VEHICLE, HEAVY))
        on_boxes += int((np.any(inside, axis=1) & ~np.any(core, axis=1)).sum())
    return on_boxes / max(1, sum(map(len, clouds)))


def collect_clouds(
    chosen: Sequence[Witness], sensors: Sequence[Sensor], frames: int
) -> list[Float64[np.ndarray, "_ 3"]]:
    """Points of the witnesses in each frame, site frame."""
    parts: list[list[np.ndarray]] = [[np.zeros((0, 3))] for _ in range(frames)]
    for w in chosen:
        parts[w.frame].append(transform(sensors[w.sensor].pose, w.rays * w.depth[:, None]))
    return [np.concatenate(part) for part in parts]


def suspect_objects(
    chosen: Sequence[Witness], sensors: Sequence[Sensor], rows: Sequence[Rows], map_SE3_site: Pose
) -> tuple[list[Suspicion], list[Rows], float]:
    """Find the mistake, or pair of mistakes, in the objects. Returns it, the rows without it, and the fit of these."""
    clouds = collect_clouds(chosen, sensors, len(rows))
    if sum(map(len, clouds)) < ENOUGH:
        return [], list(rows), 1.0
    current = fit(clouds, rows, map_SE3_site)
    for attempts in (list(combinations(OBJECT_MISTAKES + LIFTED, 1)), list(combinations(OBJECT_MISTAKES, 2))):
        undone = [[_without(mistakes, table) for table in rows] for mistakes in attempts]
        fits = [fit(clouds, tables, map_SE3_site) for tables in undone]
        best = int(np.argmax(fits))
        if fits[best] >= current + CLEAR and fits[best] >= FITS:
            found = [Suspicion(mistake, remedy, current, fits[best]) for mistake, remedy, _ in attempts[best]]
            return found, undone[best], fits[best]
        if current >= FITS:
            break
    return [], list(rows), current


def _without(mistakes: Sequence[Mistake], rows: Rows) -> Rows:
    for mistake in mistakes:
        table = dict(zip(_COLUMNS, rows.T, strict=True))
        table |= mistake.undo(table)
        rows = np.column_stack([table[name] for name in _COLUMNS])
    return rows


_FOR_ANOTHER = "its extrinsic is for a right-handed world and a camera with"
_SENSOR_MISTAKES = {  # with their remedies
    "its extrinsic is camera → world, the inverse of what belongs there": "store the inverse of extrinsic",
    f"{_FOR_ANOTHER} x right, y down, z forward": "turn extrinsic into CARLA's world (y negated) and a camera with X "
    "forward, Y right, Z up",
    f"{_FOR_ANOTHER} x forward, y left, z up": "negate y of the world and of the camera in extrinsic",
    "its depth is the distance along the ray, not along the optical axis": "divide each depth by the length of its ray "
    "whose X is 1",
    "it looks away: in the opposite direction": "turn extrinsic by 180 degrees about the camera's Z",
}


def suspect_sensor(
    chosen: Sequence[Witness], sensor: Sensor, rows: Sequence[Rows], map_SE3_site: Pose
) -> tuple[Suspicion | None, float]:
    """Find the pose or depth mistake of one sensor by its witnesses. Returns its fit too."""
    stored = published.extrinsic(sensor.pose, map_SE3_site)

    def measure_fit(matrix: np.ndarray, along_ray: bool = False) -> float:
        pose = published.parse_extrinsic(matrix, map_SE3_site)
        rays = [w.rays / np.linalg.norm(w.rays, axis=1, keepdims=True) if along_ray else w.rays for w in chosen]
        clouds = [transform(pose, ray * w.depth[:, None]) for ray, w in zip(rays, chosen, strict=True)]
        return fit(clouds, [rows[witness.frame] for witness in chosen], map_SE3_site)

    current = measure_fit(stored)
    if current > 1 - CLEAR:
        return None, current
    right_handed = published.MAP_FROM_CARLA
    undone = (
        measure_fit(invert(stored)),
        measure_fit(_FORWARD_FIRST @ stored @ right_handed),
        measure_fit(right_handed @ stored @ right_handed),
        measure_fit(stored, along_ray=True),
        measure_fit(np.diag([-1.0, -1, 1, 1]) @ stored),
    )
    named = zip(_SENSOR_MISTAKES.items(), undone, strict=True)
    attempts = [Suspicion(mistake, remedy, current, after) for (mistake, remedy), after in named]
    best = max(attempts, key=lambda suspicion: suspicion.after)
    return (best if best.after >= max(FITS, current + CLEAR) else None), current


MOST_FRAMES_OFF = 3
CLEARLY = 0.2  # least gain in fit that raises suspicion of shifted frames


def suspect_frames(
    clouds: Sequence[Float[np.ndarray, "_ 3"]], tables: Sequence[Rows], frames: Sequence[int], map_SE3_site: Pose
) -> tuple[Suspicion | None, list[Rows]]:
    """Find the number of frames by which objects are off. Returns it and the rows that belong to `frames`. clouds:
    moving points of `frames`, site frame; tables: rows of all frames of the file."""
    best: Suspicion | None = None
    rows = [tables[k] for k in frames]
    for off in [sign * n for n in range(1, MOST_FRAMES_OFF + 1) for sign in (1, -1)]:
        there = [0 <= k + off < len(tables) and len(tables[k]) and len(tables[k + off]) for k in frames]
        usable = np.flatnonzero(there).tolist()
        some = [clouds[i] for i in usable]
        if sum(map(len, some)) < ENOUGH:
            continue
        before = fit(some, [tables[frames[i]] for i in usable], map_SE3_site)
        after = fit(some, [tables[frames[i] + off] for i in usable], map_SE3_site)
        if after >= max(FITS, before + CLEARLY) and (best is None or after > best.after):
            count = f"{abs(off)} frame{'s' * (abs(off) > 1)}"
            mistake = f"labels lie about {count} {'behind' if off > 0 else 'ahead of'} the images"
            remedy = f"store objects/K as objects/{'K-' if off > 0 else 'K+'}{abs(off)}"
            best = Suspicion(mistake, remedy, before, after)
            rows = [tables[k + off] if 0 <= k + off < len(tables) else tables[k][:0] for k in frames]
    return best, rows
