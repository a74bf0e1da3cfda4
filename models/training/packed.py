"""Packed recordings in memory: the empty site once, and the differences of each frame.

Depth stays noise-free; every reading draws fresh noise. `models.training.packing` writes the file;
its layout, flat arrays that need only numpy and h5py:

    rigs/{r}                    attributes: area, height, sensors (JSON: name, type, model), slope
                                of the ground if it is not level; poses (s, 4, 4)
    rigs/{r}/pixels, depth      what the sensors see of the empty site within the crop, one sensor
                                after the other: uint32 pixel number (row · columns + column),
                                float32 measurement (m)
    rigs/{r}/ends               (s,) ends of the pixels of each sensor
    frames/rig, frames/ends     (t,) rig of each frame, and (t, s + 1) begin of the changed
                                pixels of each sensor, and end of the last ones
    pixels, steps               (p,) changed pixels, and their measurement in 1/512 m, 0 for none
    boxes, labels, box_ends     objects of all frames, and (t + 1,) begin of each frame's
    clouds/frames, ends, points for frames of recorded clouds: (f,) their numbers, (f, s + 1) begin
                                of the points of each sensor and end of the last ones, (p, 3) the
                                points in 1/512 m, on level ground
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, SupportsFloat

import h5py
import numpy as np

from toolkit.arrays import Float, Float32, Mask, Rng, Shaped
from toolkit.boxes import check_boxes
from toolkit.geometry import LEVEL, Slope, check_slope, level_rows
from toolkit.objects import Objects
from toolkit.runtime import hdf5
from toolkit.runtime.text_values import parse_json
from toolkit.sensors.models import make_model
from toolkit.sensors.sensor import Sensor

STEPS_PER_METRE = 512  # quantisation of changes: 2 mm steps are far below the sensors' noise
MAX_SENSOR_PIXELS = 10**8  # a file with more is damaged
CROP_MARGIN_M = 0.2  # kept around the crop, so that noise can carry a point across its edge

_Points = Float32[np.ndarray, "n 3"]
_Pixels = Shaped[np.ndarray, " n"]  # numbers of pixels: row · columns + column
Area = tuple[float, float, float, float]  # xmin ymin xmax ymax, m


class PackedFrames:
    """Packed file in memory. Points and objects of frame k are in its site's frame.

    Raises FileNotFoundError; ValueError if the file is damaged or not a packed file.
    """

    def __init__(self, path: Path | str) -> None:
        """Read a packed file into memory.

        Raises FileNotFoundError, and ValueError for a file that is damaged or not packed."""
        if not Path(path).is_file():
            raise FileNotFoundError(f"no packed file {path}: make it with coview pack")
        try:
            with hdf5.open_hdf5(path) as file:
                if hdf5.contains(file, "coview") or hdf5.contains(file, "dslices"):
                    raise ValueError("it is a recording")
                read_integers = partial(hdf5.array, file, kinds="iu")
                self._rig_of_frame = read_integers("frames/rig", axes=1)
                self._ends = read_integers("frames/ends", axes=2)
                self._pixels = read_integers("pixels", axes=1)
                self._steps = read_integers("steps", axes=1)
                self._boxes = hdf5.array(file, "boxes", axes=2)
                self._labels = read_integers("labels", axes=1)
                self._box_ends = read_integers("box_ends", axes=1)
                # row in `_cloud_ends` of each frame that has recorded clouds
                self._places: dict[int, int] = {}
                self._cloud_ends = np.zeros((0, 1), np.int64)
                self._points = np.zeros((0, 3), np.int32)
                if hdf5.contains(file, "clouds"):
                    cloud_frames = read_integers("clouds/frames", axes=1).tolist()
                    self._places = {k: index for index, k in enumerate(cloud_frames)}
                    self._cloud_ends = read_integers("clouds/ends", axes=2)
                    self._points = read_integers("clouds/points", axes=2)
                self.rigs = tuple(
                    _read_rig(file, f"rigs/{r}") for r in range(len(hdf5.child_names(file, "rigs")))
                )
            self._check()
        except (OSError, ValueError) as error:
            reason = f"{path} is damaged or not a packed file ({error})"
            raise ValueError(f"{reason}: make it again with coview pack") from error

    def _check(self) -> None:
        """Raise ValueError unless all arrays fit each other."""
        frames = len(self)
        if frames and not ((self._rig_of_frame >= 0) & (self._rig_of_frame < len(self.rigs))).all():
            raise ValueError(f"frames/rig must be numbers of its {len(self.rigs)} rigs")
        max_sensors = max((len(rig.sensors) for rig in self.rigs), default=0)
        if (
            len(self._ends) != frames
            or self._ends.shape[1] <= max_sensors
            or not _ascends(self._ends, len(self._pixels))
        ):
            raise ValueError("frames/ends does not cut its pixels into frames and sensors")
        if len(self._steps) != len(self._pixels):
            raise ValueError(f"it has {len(self._pixels)} pixels but {len(self._steps)} steps")
        if len(self._box_ends) != frames + 1 or not _ascends(self._box_ends, len(self._boxes)):
            raise ValueError("box_ends does not cut its boxes into frames")
        check_boxes(self._boxes)
        for k in range(frames):
            for s, sensor in enumerate(self.rig(k).sensors):
                _check_pixels(self._pixels[slice(*self._ends[k, s : s + 2])], sensor, "pixels")
        Objects(self._boxes, self._labels)
        if self._points.shape[1] != 3:
            raise ValueError(f"clouds/points must be x y z in each row, got {self._points.shape}")
        if len(self._places) != len(self._cloud_ends) or any(
            not 0 <= k < frames for k in self._places
        ):
            raise ValueError(
                f"clouds/frames must be different numbers of its {frames} frames, as many as "
                "clouds/ends"
            )
        max_sensors = max((len(self.rig(k).sensors) for k in self._places), default=0)
        if self._cloud_ends.shape[1] <= max_sensors or not _ascends(
            self._cloud_ends, len(self._points)
        ):
            raise ValueError("clouds/ends does not cut clouds/points into frames and sensors")

    def __len__(self) -> int:
        return len(self._rig_of_frame)

    def rig(self, k: int) -> "Rig":
        """Sensors of frame k and their crop."""
        return self.rigs[self._rig_of_frame[k]]

    def objects(self, k: int) -> Objects:
        """Ground truth of frame k, on the site's slope."""
        rows = slice(*self._box_ends[k : k + 2])
        return Objects(self._boxes[rows], self._labels[rows])

    def level_objects(self, k: int) -> Objects:
        """Ground truth of frame k, turned to level ground as its `points` are."""
        objects = self.objects(k)
        slope = self.rig(k).slope
        if slope == LEVEL:
            return objects
        return replace(objects, boxes=level_rows(objects.boxes, slope))

    def is_recorded(self, k: int) -> bool:
        """True if a frame has recorded clouds, without an empty site."""
        return k in self._places

    def changes(self, k: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Changed pixels of frame k, and their measurements in 1/512 m (0: none), per sensor."""
        slices = [slice(*self._ends[k, s : s + 2]) for s in range(len(self.rig(k).sensors))]
        return [self._pixels[rows] for rows in slices], [self._steps[rows] for rows in slices]

    def points(
        self, k: int, rng: Rng | None, sensors: Iterable[int] | None = None
    ) -> list[Float32[np.ndarray, "_ 3"]]:
        """Points of frame k inside the crop, of each chosen sensor (None: all), on level ground.

        Recorded clouds come back as they are; other frames are the empty site's image with the
        pixels that changed. rng: for fresh noise, None for no noise.
        """
        rig = self.rig(k)
        clouds = []
        for s in range(len(rig.sensors)) if sensors is None else sensors:
            if self.is_recorded(k):
                # a row of ends has where the first sensor's points begin, then where each ends
                rows = slice(*self._cloud_ends[self._places[k], s : s + 2])
                clouds.append(self._points[rows].astype(np.float32) / np.float32(STEPS_PER_METRE))
            else:
                rows = slice(*self._ends[k, s : s + 2])
                metres = self._steps[rows].astype(np.float32) / STEPS_PER_METRE
                sweep = rig.measure(s, changed=self._pixels[rows], measured=metres, rng=rng)
                clouds.append(level_rows(sweep.points, rig.slope))
        return clouds


class _Sweep(NamedTuple):
    """Measurement of one sensor inside the crop.

    Attributes:
        points: x y z in the site's frame, m.
        pixels: Number of each point's pixel.
        depth: Measurement of each pixel (m).
    """

    points: _Points
    pixels: _Pixels
    depth: Float32[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Rig:
    """Fixed sensors, and their view of the empty site in the crop.

    The crop is the area up to the height above sloping ground.

    Attributes:
        sensors: Sensors.
        area: xmin ymin xmax ymax (m).
        height: Height of the crop (m).
        pixels: Pixels of each sensor that see the empty site in the crop.
        depth: Measurement of each pixel (m).
        slope: Slope of the ground.
    """

    sensors: tuple[Sensor, ...]
    area: Area
    height: float
    pixels: tuple[Shaped[np.ndarray, " _"], ...]
    depth: tuple[Float32[np.ndarray, " _"], ...]
    slope: Slope = LEVEL

    @staticmethod
    def seeing(
        sensors: Iterable[Sensor],
        area: Iterable[SupportsFloat],
        height: float,
        empty: Iterable[np.ndarray],
        slope: Slope = LEVEL,
    ) -> "Rig":
        """Rig from images of the empty site (m, 0 without a measurement), one for each sensor.

        area: xmin ymin xmax ymax (m). height: top of the crop above the ground (m).
        """
        xmin, ymin, xmax, ymax = map(float, area)
        rig = Rig(
            sensors=tuple(sensors),
            area=(xmin, ymin, xmax, ymax),
            height=float(height),
            pixels=(),
            depth=(),
            slope=slope,
        )
        pixels = []
        depth = []
        for s, image in enumerate(empty):
            measured_pixels = np.flatnonzero(image > 0).astype(np.uint32)
            points = rig.world(s, measured_pixels, image.ravel()[measured_pixels])
            crop_pixels = measured_pixels[rig.in_crop(points, CROP_MARGIN_M)]
            pixels.append(crop_pixels)
            depth.append(image.ravel()[crop_pixels])
        return replace(rig, pixels=tuple(pixels), depth=tuple(depth))

    def measure(self, s: int, changed: np.ndarray, measured: np.ndarray, rng: Rng | None) -> _Sweep:
        """Noisy measurement of sensor s in the crop.

        changed: numbers of pixels that differ from the empty site; measured: their measurements (m,
        0: nothing). rng: for noise, None for no noise.
        """
        rows, columns = self.sensors[s].model.shape
        is_unchanged_pixel = np.ones(rows * columns, bool)
        is_unchanged_pixel[changed] = False
        is_unchanged = is_unchanged_pixel[self.pixels[s]]
        is_measured = measured > 0
        pixels = np.concatenate([self.pixels[s][is_unchanged], changed[is_measured]])
        depth = np.concatenate([self.depth[s][is_unchanged], measured[is_measured]])
        if rng is not None:
            noise = rng.standard_normal(len(depth), dtype=np.float32)
            depth += noise * self.sensors[s].model.deviation(depth)
        points = self.world(s, pixels, depth)
        is_in_crop = self.in_crop(points)
        return _Sweep(points=points[is_in_crop], pixels=pixels[is_in_crop], depth=depth[is_in_crop])

    def world(self, s: int, pixels: _Pixels, depth: Float[np.ndarray, " n"]) -> _Points:
        """Points (x y z in the site's frame, m) that pixels of sensor s measure.

        depth: measurement of each pixel (m).
        """
        sensor = self.sensors[s]
        rotation = sensor.pose[:3, :3].T.astype(np.float32)
        points = sensor.model.rays().reshape(-1, 3).take(pixels, axis=0) @ rotation
        points *= depth[:, None]
        points += sensor.position.astype(np.float32)
        return points

    def in_crop(self, points: _Points, margin: float = 0.0) -> Mask:
        """Mask of points (x y z, m) in the crop, widened by a margin (m).

        Heights count from the ground, which may slope: from 0 to the crop's height."""
        x, y, z = level_rows(points, self.slope).T
        xmin, ymin, xmax, ymax = self.area
        is_inside_x = (x >= xmin - margin) & (x <= xmax + margin)
        is_inside_y = (y >= ymin - margin) & (y <= ymax + margin)
        is_inside_z = (z > -margin) & (z < self.height + margin)
        return is_inside_x & is_inside_y & is_inside_z


def _read_rig(file: h5py.File, name: str) -> Rig:
    """Rig of the group `name`. Raises ValueError, which names the entry, for a damaged one."""
    with hdf5.reading(name):
        attributes = hdf5.read_node_attributes(file[name], name)
    poses = hdf5.array(file, f"{name}/poses", axes=3)
    depth = hdf5.array(file, f"{name}/depth", axes=1, kinds="f")
    pixels = hdf5.array(file, f"{name}/pixels", axes=1, kinds="iu")
    ends = hdf5.array(file, f"{name}/ends", axes=1, kinds="iu")
    try:
        named_models = [
            (str(entry["name"]), make_model(entry["type"], entry["model"]))
            for entry in parse_json(attributes["sensors"])
        ]
        sensors = tuple(
            Sensor(name=sensor_name, model=model, pose=pose)
            for (sensor_name, model), pose in zip(named_models, poses, strict=True)
        )
        xmin, ymin, xmax, ymax = map(float, attributes["area"])
        height = float(attributes["height"])
        slope = check_slope(attributes.get("slope", LEVEL), "slope")
    except (KeyError, TypeError, AttributeError, OverflowError, ValueError) as error:
        raise ValueError(
            f"{name}: its attributes do not describe sensors, area and height ({error})"
        ) from None
    if not (
        np.isfinite([xmin, ymin, xmax, ymax, height]).all()
        and xmin < xmax
        and ymin < ymax
        and height > 0
    ):
        raise ValueError(
            f"{name}: needs an area xmin ymin xmax ymax and a height, got {attributes['area']}, "
            f"{height}"
        )
    sizes = [math.prod(sensor.model.shape) for sensor in sensors]
    if not sizes or max(sizes) > MAX_SENSOR_PIXELS:
        raise ValueError(f"{name}: needs sensors of at most {MAX_SENSOR_PIXELS} pixels each")
    if len(ends) != len(sensors) or len(pixels) != len(depth) or not _ascends(ends, len(pixels)):
        raise ValueError(
            f"{name}/ends does not cut its {len(pixels)} pixels and {len(depth)} depths into "
            "sensors"
        )
    if not np.isfinite(depth).all():
        raise ValueError(f"{name}/depth holds NaN or infinity")
    pixels_by_sensor = tuple(np.split(pixels, ends[:-1]))
    for sensor, sensor_pixels in zip(sensors, pixels_by_sensor, strict=True):
        _check_pixels(sensor_pixels, sensor, f"{name}/pixels")
    return Rig(
        sensors=sensors,
        area=(xmin, ymin, xmax, ymax),
        height=height,
        pixels=pixels_by_sensor,
        depth=tuple(np.split(depth.astype(np.float32), ends[:-1])),
        slope=slope,
    )


def _ascends(ends: np.ndarray, total: int) -> bool:
    """True if the numbers ascend, row after row, from 0 or more to at most the total."""
    flat = ends.ravel().astype(np.int64)
    if not len(flat):
        return True
    is_within = flat[0] >= 0 and flat[-1] <= total
    return bool((np.diff(flat) >= 0).all() and is_within)


def _check_pixels(pixels: np.ndarray, sensor: Sensor, name: str) -> None:
    """Raise ValueError for pixels that the sensor does not have.

    pixels: numbers of pixels, row · columns + column; name: their entry in the file."""
    rows, columns = sensor.model.shape
    if not len(pixels):
        return
    lowest = pixels.min()
    highest = pixels.max()
    if lowest < 0 or highest >= rows * columns:
        raise ValueError(
            f"{name} must be of the {rows}×{columns} that sensor {sensor.name!r} has, got "
            f"{lowest if lowest < 0 else highest}"
        )
