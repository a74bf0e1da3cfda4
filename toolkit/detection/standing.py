"""Standing scene: the voxels with points in most frames of sensors that stand still, if the empty
site is unknown.

A post, a bush or a container looks like a road user in every frame. Points are gathered into voxels
of the world. A voxel that has points in most frames belongs to the scene, and a detection with
hardly a point outside such voxels is left out. A recording that moves has no such scene: its
sensors move, or what they see does."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Bool, Float, Float64, Int64, Mask, Points
from toolkit.boxes import count_points
from toolkit.calibration.empty_scene import STANDS_STILL
from toolkit.detection.background import LEAST_NEW
from toolkit.frame import Frame, Frames
from toolkit.objects import HEAVY, VEHICLE, Detections

MIN_STANDING_FRAMES = 10  # with fewer, whoever waits is in most frames
MAX_LEARNT_FRAMES = 20
STANDING_SHARE = 0.75  # part of the frames in which a voxel has points
STANDING_VOXEL_M = 0.25
MAX_STILL_TURN_RAD = float(np.deg2rad(0.5))
MIN_SCENE_SHARE = (
    0.5  # part of the points off the ground in such voxels, where the sensors stand still
)
MAX_WAITING_S = 60.0  # in shorter recordings, vehicles that stand may wait
MIN_WAITING_SCORE = 0.5  # from which vehicles are kept as waiting
_OFF_GROUND_M = 0.5  # above the lowest point of its square
_SQUARE_M = 2.0
_BITS = 21  # for each index of a voxel
_FACES = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


@dataclass(frozen=True, eq=False)
class StandingScene:
    """Voxels that have points in most frames.

    Attributes:
        origin: (3,) m, corner of the grid, world frame.
        keys: (n,) sorted keys of the voxels and their neighbours across a face.
        frames: number of frames of the recording.
        waiting: True where vehicles that stand may only wait."""

    origin: Float64[np.ndarray, "3"]
    keys: Int64[np.ndarray, " n"]
    frames: int
    waiting: bool

    def holds(self, points: Points) -> Mask:
        """Mark points (world) in the scene."""
        keys = _voxel_keys(points, self.origin)
        place = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return self.keys[place] == keys

    def leave_out(self, found: Detections, points: Float[np.ndarray, "n 3"]) -> Detections:
        """Return the detections (world) with enough points outside the scene."""
        new = points[~self.holds(points)]
        total = count_points(points, found.boxes)
        outside = count_points(new, found.boxes)
        kept = (outside > 0) & (outside >= LEAST_NEW * total)
        if self.waiting:
            kept |= np.isin(found.labels, [VEHICLE, HEAVY]) & (found.scores >= MIN_WAITING_SCORE)
        return found[kept]

    def describe(self, left_out: int) -> str:
        """Return in one line what is left out, and how it is kept."""
        standing = f"what stands in most of the {self.frames} frames is background"
        return (
            f"{standing}: {left_out} detections are left out; --detector general-background keeps "
            "them"
        )


def learn_standing_scene(frames: Frames) -> StandingScene | None:
    """Learn the standing scene of a recording; None with few frames, and where sensors or all they
    see moves."""
    if len(frames) < MIN_STANDING_FRAMES:
        return None
    rows = np.unique(np.linspace(0, len(frames) - 1, MAX_LEARNT_FRAMES).astype(int)).tolist()
    first = frames[0]
    clouds = list[Points]()
    times = []
    for row in rows:
        frame = frames[row]
        if not _is_still(first, frame):
            return None
        times.append(frame.time)
        clouds.append(frame.points().astype(np.float64))
    clouds = [cloud[np.isfinite(cloud).all(axis=1)] for cloud in clouds]
    if not all(map(len, clouds)):
        return None
    middle = np.median(clouds[0], axis=0)
    origin = middle - STANDING_VOXEL_M * (1 << (_BITS - 1))
    occupied = [np.unique(_voxel_keys(cloud, origin)) for cloud in clouds]
    keys, count = np.unique(np.concatenate(occupied), return_counts=True)
    keys = keys[count >= STANDING_SHARE * len(rows)]
    high = clouds[0][_off_ground_mask(clouds[0])]
    if not len(keys) or not len(high):
        return None
    seconds = max(times) - min(times)
    # unknown times are NaN
    scene = StandingScene(origin, _grow(keys), len(frames), not seconds >= MAX_WAITING_S)
    return scene if scene.holds(high).mean() >= MIN_SCENE_SHARE else None


def _is_still(first: Frame, frame: Frame) -> bool:
    """Return True if the sensors and the world are where they are in the first frame."""
    if [sensor.name for sensor in first.sensors] != [sensor.name for sensor in frame.sensors]:
        return False
    pairs = [
        (one.pose, other.pose) for one, other in zip(first.sensors, frame.sensors, strict=True)
    ]
    pairs.append((first.map_SE3_world, frame.map_SE3_world))
    for one, other in pairs:
        turn = one[:3, :3].T @ other[:3, :3]
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        if np.linalg.norm(one[:3, 3] - other[:3, 3]) > STANDS_STILL or angle > MAX_STILL_TURN_RAD:
            return False
    return True


def _off_ground_mask(points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Mark points well above the lowest one of their square: ground is the same wherever a sensor
    moves."""
    square = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / _SQUARE_M).astype(np.int64)
    _, number = np.unique(square[:, 0] << 32 | square[:, 1], return_inverse=True)
    lowest = np.full(number.max() + 1, np.inf)
    np.minimum.at(lowest, number, points[:, 2])
    return points[:, 2] > lowest[number] + _OFF_GROUND_M


def _voxel_keys(points: Points, origin: Float64[np.ndarray, "3"]) -> Int64[np.ndarray, " n"]:
    """Key of each point's voxel."""
    last = (1 << _BITS) - 2
    index = np.clip(np.floor((points - origin) / STANDING_VOXEL_M), 1, last).astype(np.int64)
    return _join_index(index)


def _join_index(index: Int64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    return (index[:, 0] << 2 * _BITS) | (index[:, 1] << _BITS) | index[:, 2]


def _grow(keys: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    """Return keys, also of the voxels that share a face."""
    mask = (1 << _BITS) - 1
    index = np.column_stack([keys >> 2 * _BITS, (keys >> _BITS) & mask, keys & mask])
    return np.unique(np.concatenate([_join_index(index + face) for face in _FACES]))
