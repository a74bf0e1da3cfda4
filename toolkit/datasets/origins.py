"""Origins of recordings whose coordinates are far from zero, such as UTM's.

float32 holds a tenth of a millimetre at a kilometre, but half a metre at a northing of 5336 km.
Clouds are float32, so an origin goes into their sensors' poses, which are float64. Layouts that
keep clouds in one world frame get frames that are counted from one origin for the whole recording
(`near_frames`); `map_SE3_world` holds it."""

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Pose
from toolkit.datasets.cloud_files import read_recorded
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import transform
from toolkit.point_writing import NEAR_ORIGIN_M

MAX_SAMPLE_POINTS = 1000  # points that a middle or an origin is found from


def translation(position: Float64[np.ndarray, "3"]) -> Pose:
    """Return the pose (4, 4) that moves by x, y, z (m) and does not turn."""
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


def find_far_middle(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "3"]:
    """Return the median of points, rounded to a metre; zeros unless most are far from the origin.

    Points that are not finite or all 0, which some drivers write for no return, do not count."""
    sample = points[:: len(points) // MAX_SAMPLE_POINTS + 1]  # evenly taken
    is_return = np.isfinite(sample).all(axis=1) & (sample != 0).any(axis=1)
    sample = sample[is_return]
    is_far = np.abs(sample).max(axis=1, initial=0) > NEAR_ORIGIN_M
    if 2 * np.count_nonzero(is_far) <= len(sample):
        return np.zeros(3)
    return np.asarray(np.round(np.median(sample, axis=0)))


@dataclass(frozen=True)
class Middles:
    """Middles of the sensors' first clouds, from which far away clouds are counted.

    files: each sensor's first cloud by its name; for a sensor without one it is the first cloud
    that is read."""

    files: Mapping[str, Path] = field(default_factory=dict)
    _by_sensor: dict[str, Float64[np.ndarray, "3"]] = field(
        default_factory=dict, repr=False, compare=False
    )

    def find(self, sensor: str, middle: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
        """Return the middle (x, y, z in m) from which a sensor's clouds are counted.

        It is the middle of the sensor's first cloud, in `self.files`. middle: middle of the cloud
        that is being read, used if there is no first cloud for the sensor. The result is kept for
        the sensor's next clouds."""
        if sensor not in self._by_sensor:
            file = self.files.get(sensor)
            if file is not None:
                middle = find_far_middle(read_recorded(file)["positions"])
            self._by_sensor[sensor] = middle
        return self._by_sensor[sensor]


def find_origin(frame: Frame) -> Float64[np.ndarray, "3"]:
    """Return an origin (m, world frame) near a frame's sensors, else its points or objects.

    It is zero if all are near."""
    sensor_positions = np.array([sensor.position for sensor in frame.sensors]).reshape(-1, 3)
    box_centres = frame.objects.boxes[:, :3]
    for positions in (sensor_positions, frame.points(), box_centres):
        middle = find_far_middle(positions)
        if middle.any():
            return middle
    return np.zeros(3)


def rebase(frame: Frame, origin: Float64[np.ndarray, "3"]) -> Frame:
    """Return a frame with its world frame moved to a new origin.

    origin: x, y, z of the new origin in the old world frame (m). Boxes, poses, points and the
    labelled region are counted from it, and `map_SE3_world` makes up for it."""
    if not origin.any():
        return frame
    old_SE3_new = translation(origin)
    new_SE3_old = translation(-origin)
    clouds = [_rebase_cloud(cloud, new_SE3_old) for cloud in frame.clouds]
    box_shift = np.array([*origin, 0, 0, 0, 0])  # sizes and yaw stay
    return replace(
        frame.with_clouds(clouds),
        objects=replace(frame.objects, boxes=frame.objects.boxes - box_shift),
        others=replace(frame.others, boxes=frame.others.boxes - box_shift),
        complete=frame.complete.move_origin(origin),
        map_SE3_world=frame.map_SE3_world @ old_SE3_new,
    )


def near_frames(frames: Iterable[Frame]) -> Iterator[Frame]:
    """Yield frames with their world frame moved to an origin near the first frame.

    So float32 holds their clouds in the world frame. Frames that are near already stay as they
    are."""
    remaining_frames = iter(frames)
    first_frame = next(remaining_frames, None)
    if first_frame is None:
        return
    origin = find_origin(first_frame)
    for frame in chain([first_frame], remaining_frames):
        yield rebase(frame, origin)


def warn_of_origin(frame: Frame, layout: str) -> None:
    """Warn if a frame has an origin far from the map's, which a layout cannot store.

    layout: its name, for the warning."""
    position = frame.map_SE3_world[:3, 3]
    if np.abs(position).max() > NEAR_ORIGIN_M:
        numbers = " ".join(f"{value:.3f}" for value in position)
        lost = f"{layout} has no place for an origin: points and boxes are counted from {numbers} m"
        warnings.warn(f"{lost}, add it to get back to the map", stacklevel=3)


def _rebase_cloud(cloud: SensorCloud, new_SE3_old: Pose) -> SensorCloud:
    """Return a cloud in a new world frame. new_SE3_old: pose of the old world frame in the new."""
    new_SE3_sensor = new_SE3_old @ cloud.world_SE3_sensor
    if cloud.frame == "sensor":
        return replace(cloud, world_SE3_sensor=new_SE3_sensor)
    points = transform(new_SE3_old, cloud.in_world()).astype(np.float32)
    return replace(cloud, world_SE3_sensor=new_SE3_sensor, points=points)
