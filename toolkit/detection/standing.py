"""Standing scene: voxels with points in most frames, if sensors do not move and the site is
unknown.

A post, a bush or a container looks like a road user in every frame. Points are gathered into voxels
of the world frame. A voxel that has points in most frames belongs to the scene, and a detection
with hardly a point outside such voxels is left out. A recording that moves has no such scene: its
sensors move, or everything they see moves."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Bool, Float, Float64, Int64, Mask, Points
from toolkit.boxes import count_points
from toolkit.calibration.recording_scenes import MAX_STILL_SENSOR_M
from toolkit.detection.background import MIN_NEW_SHARE
from toolkit.frame import Frame, Frames
from toolkit.objects import HEAVY, VEHICLE, Detections

MIN_STANDING_FRAMES = 10  # with fewer, whoever waits is in most frames
MAX_LEARNT_FRAMES = 20
MIN_STANDING_SHARE = 0.75  # share of the frames in which a voxel has points
STANDING_VOXEL_M = 0.25
MAX_STILL_TURN_RAD = float(np.deg2rad(0.5))
MIN_SCENE_SHARE = 0.5  # share of the points off the ground in such voxels, if sensors are still
MAX_WAITING_S = 60.0  # in shorter recordings, vehicles that do not move may wait
MIN_WAITING_SCORE = 0.5  # score from which vehicles are kept as waiting
_OFF_GROUND_M = 0.5  # above the lowest point of its square
_SQUARE_M = 2.0
_INDEX_BITS = 21  # for each index of a voxel
# steps from a voxel to itself and to the six voxels that share a face with it
_FACES = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


@dataclass(frozen=True, eq=False)
class StandingScene:
    """Voxels that have points in most frames.

    Attributes:
        origin: (3,) m, corner of the grid, world frame.
        keys: (n,) sorted keys of the voxels and their neighbours across a face.
        frames: number of frames of the recording.
        waiting: True if vehicles that do not move may only wait.
    """

    origin: Float64[np.ndarray, "3"]
    keys: Int64[np.ndarray, " n"]
    frames: int
    waiting: bool

    def holds(self, points: Points) -> Mask:
        """Mask of points (m, world) in voxels of the scene."""
        point_keys = _voxel_keys(points, self.origin)
        # row of the first sorted key that is not less: the point's key if the scene has it
        rows = np.minimum(np.searchsorted(self.keys, point_keys), len(self.keys) - 1)
        return self.keys[rows] == point_keys

    def leave_out(self, detections: Detections, points: Float[np.ndarray, "n 3"]) -> Detections:
        """Return the detections (world) with enough points outside the scene.

        points: all points of the frame (m, world). If the scene may hold vehicles that only waited
        while it was learnt (`waiting`), vehicles with a high score are kept in any case."""
        foreground_points = points[~self.holds(points)]
        point_count = count_points(points, detections.boxes)
        foreground_count = count_points(foreground_points, detections.boxes)
        is_kept = (foreground_count > 0) & (foreground_count >= MIN_NEW_SHARE * point_count)
        if self.waiting:
            is_vehicle = np.isin(detections.labels, [VEHICLE, HEAVY])
            is_kept |= is_vehicle & (detections.scores >= MIN_WAITING_SCORE)
        return detections[is_kept]

    def describe(self, left_out: int) -> str:
        """Line of text on the number of detections left out, and on how to keep them."""
        rule = f"what stands in most of the {self.frames} frames is background"
        return (
            f"{rule}: {left_out} detections are left out; --detector general-background keeps them"
        )


def learn_standing_scene(frames: Frames) -> StandingScene | None:
    """Learn the standing scene of a recording from at most 20 of its frames, evenly spread.

    Returns None with few frames, for a frame without points, and if sensors or everything they see
    moves."""
    if len(frames) < MIN_STANDING_FRAMES:
        return None
    indices = np.unique(np.linspace(0, len(frames) - 1, MAX_LEARNT_FRAMES).astype(int)).tolist()
    first_frame = frames[0]
    clouds = list[Points]()
    times = []
    for index in indices:
        frame = frames[index]
        if not _is_still(first_frame, frame):
            return None
        times.append(frame.time)
        clouds.append(frame.points().astype(np.float64))
    clouds = [cloud[np.isfinite(cloud).all(axis=1)] for cloud in clouds]
    if not all(map(len, clouds)):
        return None
    middle = np.median(clouds[0], axis=0)
    # half the grid below the middle, so that the indices of all points are positive
    origin = middle - STANDING_VOXEL_M * (1 << (_INDEX_BITS - 1))
    frame_keys = [
        np.unique(_voxel_keys(cloud, origin)) for cloud in clouds
    ]  # only voxels with points
    keys, frame_counts = np.unique(np.concatenate(frame_keys), return_counts=True)
    keys = keys[frame_counts >= MIN_STANDING_SHARE * len(indices)]
    high_points = clouds[0][_off_ground_mask(clouds[0])]
    if not len(keys) or not len(high_points):
        return None
    seconds = max(times) - min(times)
    scene = StandingScene(
        origin,
        keys=_add_face_neighbours(keys),
        frames=len(frames),
        # unknown times are NaN: `not >=` then counts the recording as short
        waiting=not seconds >= MAX_WAITING_S,
    )
    return scene if scene.holds(high_points).mean() >= MIN_SCENE_SHARE else None


def _is_still(first_frame: Frame, frame: Frame) -> bool:
    """Return True if sensors and world have hardly moved since the first frame.

    The sensors must be the same, and no pose may differ by more than `MAX_STILL_SENSOR_M` or
    `MAX_STILL_TURN_RAD`."""
    first_names = [sensor.name for sensor in first_frame.sensors]
    if first_names != [sensor.name for sensor in frame.sensors]:
        return False
    first_poses = [*(sensor.pose for sensor in first_frame.sensors), first_frame.map_SE3_world]
    poses = [*(sensor.pose for sensor in frame.sensors), frame.map_SE3_world]
    for first_pose, pose in zip(first_poses, poses, strict=True):
        rotation = first_pose[:3, :3].T @ pose[:3, :3]
        # the trace of a rotation is 1 + 2 cos(angle)
        angle = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
        distance = np.linalg.norm(first_pose[:3, 3] - pose[:3, 3])
        if distance > MAX_STILL_SENSOR_M or angle > MAX_STILL_TURN_RAD:
            return False
    return True


def _off_ground_mask(points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Mask of points well above the lowest point of their square (2 m) seen from above.

    Ground would look the same wherever a sensor moves."""
    xy = points[:, :2]
    height = points[:, 2]
    column, row = np.floor((xy - xy.min(axis=0)) / _SQUARE_M).astype(np.int64).T
    # both indices in one number, the first above bit 32; square: number of each point's square
    _, square = np.unique(column << 32 | row, return_inverse=True)
    lowest_height = np.full(square.max() + 1, np.inf)
    np.minimum.at(lowest_height, square, height)
    return height > lowest_height[square] + _OFF_GROUND_M


def _voxel_keys(points: Points, origin: Float64[np.ndarray, "3"]) -> Int64[np.ndarray, " n"]:
    """Return the key of each point's voxel: its three indices in one whole number.

    points: m, world; origin: corner of the grid (m, world). Points outside the grid count to its
    edge, a voxel inside so that neighbours have indices too."""
    max_index = (1 << _INDEX_BITS) - 2
    index = np.clip(np.floor((points - origin) / STANDING_VOXEL_M), 1, max_index).astype(np.int64)
    return _join_index(index)


def _join_index(index: Int64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " n"]:
    """Keys of voxels from their indices along x, y and z, `_INDEX_BITS` each."""
    return (index[:, 0] << 2 * _INDEX_BITS) | (index[:, 1] << _INDEX_BITS) | index[:, 2]


def _add_face_neighbours(keys: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    """Return keys of voxels and of all voxels that share a face with them, sorted."""
    low_bits = (1 << _INDEX_BITS) - 1
    x = keys >> 2 * _INDEX_BITS
    y = (keys >> _INDEX_BITS) & low_bits
    index = np.column_stack([x, y, keys & low_bits])
    return np.unique(np.concatenate([_join_index(index + face) for face in _FACES]))
