"""Readings: measurements of sensors as they report them, with the poses they are believed to have.

An error term makes one `Reading` of another. The true measurement (`TrueImage`), as rendered, never
changes. A random number depends on the seed, the error term and what it is drawn for, never on how
many were drawn before, so that a sensor measures the same in any order of sensors, frames and
processes."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Float64, ImageMask, ImageRanges, ImageVectors, Int64, Pose, Rng
from toolkit.boxes import points_in_boxes
from toolkit.objects import Objects
from toolkit.sensors.sensor import Sensor, is_return

# what a stream of random numbers is drawn for: part of its seed
_SENSOR, _FRAME, _OBJECT, _POLE = range(1, 5)
SKIN_M = 0.05  # boxes are enlarged by it on each side, so that they hold their object's surface
FOOT_MARGIN_M = 0.05  # points lower than this above the foot of a box are of the ground


@dataclass(frozen=True)
class Draws:
    """Random numbers of one error term of one sensor in one frame, identified by four numbers.

    Attributes:
        seed: seed of the recording's errors.
        sensor: number of the sensor.
        frame: number of the frame.
        term: number of the term's stream."""

    seed: int
    sensor: int
    frame: int
    term: int

    def own_noise(self) -> Rng:
        """Generator of the noise of the sensor's model in this frame, the same for all terms."""
        return np.random.default_rng([self.seed, self.frame, self.sensor])

    def of_frame(self) -> Rng:
        """Generator for this term, sensor and frame."""
        return np.random.default_rng([self.seed, _FRAME, self.frame, self.sensor, self.term])

    def of_sensor(self) -> Rng:
        """Generator for this term and sensor, the same in every frame."""
        return np.random.default_rng([self.seed, _SENSOR, self.sensor, self.term])

    def of_pole(self, position: Float64[np.ndarray, "3"]) -> Rng:
        """Generator for the pole at a sensor's position, the same in every frame.

        position: x, y, z (m, world frame). All sensors over the same centimetre of ground share
        it."""
        # whole centimetres as 32 bits without sign: seeds must not be negative
        x, y = (int(np.rint(metres * 100)) & 0xFFFFFFFF for metres in position[:2].tolist())
        return np.random.default_rng([self.seed, _POLE, x, y, self.term])

    def of_objects(self, ids: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Number in [0, 1) for each track id, the same for all sensors and frames."""
        seed_words = [self.seed, _OBJECT, self.term]
        numbers = []
        for track in ids.tolist():
            track_word = int(track) & 0xFFFFFFFFFFFFFFFF  # seeds must not be negative
            numbers.append(np.random.default_rng([*seed_words, track_word]).random())
        return np.array(numbers, np.float64)


@dataclass(frozen=True, eq=False)
class TrueImage:
    """Measurement without error at the true pose.

    Attributes:
        sensor: the sensor, at its true pose.
        measurement: its image (rows, columns; m), no return as in `sensor.is_return`.
        objects: objects of the frame.
        time: time of the frame (s).
        velocities: velocities of the objects (m/s, world frame), None if unknown.
    """

    sensor: Sensor
    measurement: ImageRanges
    objects: Objects
    time: float = 0.0
    velocities: Float64[np.ndarray, "n 3"] | None = None

    @cached_property
    def valid(self) -> ImageMask:
        """Mask of pixels that have a return."""
        return is_return(self.measurement, self.sensor.model.max_range)

    @cached_property
    def ray_lengths(self) -> ImageRanges:
        """Range per measured metre of each pixel: 1 for models that measure ranges.

        A camera measures depth, which is shorter than the range off the middle of the image."""
        return np.linalg.norm(self.sensor.model.rays(), axis=2).astype(np.float32)

    @cached_property
    def ranges(self) -> ImageRanges:
        """Distance from the sensor to the surface of each pixel (m), 0 for none."""
        return np.where(self.valid, self.measurement * self.ray_lengths, np.float32(0))

    @cached_property
    def points(self) -> Float64[np.ndarray, "pixels 3"]:
        """Point of each pixel, world frame, row after row; the sensor itself for no return."""
        flat = np.where(self.valid, self.measurement, np.float32(0)).ravel().astype(np.float64)
        return (self.sensor.world_rays * flat).T.astype(np.float64) + self.sensor.position

    @cached_property
    def owners(self) -> Int64[np.ndarray, "rows columns"]:
        """Row in `objects` of the object whose box holds each pixel's point, -1 for no object.

        A point close to the foot of a box is of the ground. If boxes overlap, the first one
        counts."""
        owners = np.full(self.measurement.size, -1, np.int64)
        if len(self.objects):
            boxes = self.objects.boxes.copy()
            # views: writing to them changes `boxes`
            middle_z, height = boxes[:, 2], boxes[:, 5]
            length_and_width = boxes[:, 3:5]
            # raise the bottom of each box by the margin, and its other sides outwards by the skin
            middle_z += (FOOT_MARGIN_M + SKIN_M) / 2
            length_and_width += 2 * SKIN_M
            height[:] = np.maximum(height + SKIN_M - FOOT_MARGIN_M, 1e-3)
            pixels = np.flatnonzero(self.valid)
            is_in_box = points_in_boxes(self.points[pixels], boxes)  # (pixel, box)
            owners[pixels] = np.where(is_in_box.any(axis=1), is_in_box.argmax(axis=1), -1)
        return owners.reshape(self.measurement.shape)

    @cached_property
    def cosines(self) -> ImageRanges:
        """Cosine of the angle between each ray and the surface's normal, 1 if that is unknown.

        Steps to the nearer neighbour in the column and in the row span the surface."""
        rays = self.sensor.model.rays().astype(np.float64)
        points = rays * np.where(self.valid, self.measurement, np.float32(0))[..., None]
        column_step = _step_to_neighbour(points, self.valid, axis=0)
        row_step = _step_to_neighbour(points, self.valid, axis=1)
        normal = np.cross(column_step, row_step)
        area = np.linalg.norm(normal, axis=2)
        is_known = self.valid & (area > 0)
        dot_product = np.abs(np.einsum("ijk,ijk->ij", normal, rays))
        cosine = dot_product / np.where(is_known, area * self.ray_lengths, 1)
        return np.where(is_known, np.clip(cosine, 0, 1), 1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Reading:
    """Measurement of a sensor as it reports it.

    Attributes:
        truth: measurement without error.
        measurement: image, 0 for no return.
        pose: believed world_SE3_sensor.
        shift: displacement of each pixel's point off its ray (m, world frame), None for zero.
    """

    truth: TrueImage
    measurement: ImageRanges
    pose: Pose
    shift: ImageVectors | None = None

    @staticmethod
    def from_truth(truth: TrueImage) -> "Reading":
        """Reading without error: the true image at the true pose, with NaN and infinity as 0.

        0 means no return."""
        image = np.asarray(truth.measurement, np.float32)
        is_finite = np.isfinite(image)
        if not is_finite.all():
            image = np.where(is_finite, image, np.float32(0))
        return Reading(truth, image, truth.sensor.pose)

    @property
    def valid(self) -> ImageMask:
        """Mask of pixels that have a return in this reading."""
        return is_return(self.measurement, self.truth.sensor.model.max_range)

    def without(self, lost: ImageMask) -> "Reading":
        """Return the reading with 0, no return, at the pixels of a mask."""
        if not lost.any():
            return self
        return self.measuring(np.where(lost, np.float32(0), self.measurement))

    def measuring(self, measurement: ImageRanges) -> "Reading":
        """Return the reading with another image."""
        return replace(self, measurement=measurement)


def _step_to_neighbour(points: np.ndarray, valid: np.ndarray, *, axis: int) -> np.ndarray:
    """Step (rows, columns, 3) from each point towards its nearer neighbour along one axis.

    points: (rows, columns, 3) m; valid: (rows, columns) mask of the points that count. axis: 0 for
    neighbours in the column, 1 in the row. A step backwards is reversed, so that all have the same
    sense; it is 0 without a valid neighbour."""
    step = np.diff(points, axis=axis)
    both_valid = valid[:-1] & valid[1:] if axis == 0 else valid[:, :-1] & valid[:, 1:]
    length = np.where(both_valid, np.linalg.norm(step, axis=2), np.inf)
    step = np.where(both_valid[..., None], step, 0)
    # there is one step less than points: padded at the end, step i leads on from point i, padded at
    # the start, it leads to point i
    if axis == 0:
        pad_end, pad_start = [(0, 1), (0, 0)], [(1, 0), (0, 0)]
    else:
        pad_end, pad_start = [(0, 0), (0, 1)], [(0, 0), (1, 0)]
    length_after = np.pad(length, pad_end, constant_values=np.inf)
    length_before = np.pad(length, pad_start, constant_values=np.inf)
    step_after = np.pad(step, [*pad_end, (0, 0)])
    step_before = np.pad(step, [*pad_start, (0, 0)])
    return np.where((length_after <= length_before)[..., None], step_after, step_before)


@runtime_checkable
class ErrorTerm(Protocol):
    """One kind of error: a frozen dataclass of numbers."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def needs_velocities(self) -> bool:
        """True if it depends on the velocities of objects."""

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """Return the reading with this error.

        draws: random numbers of this term, sensor and frame."""
