"""Readings: what a sensor says it measured and where it is believed to be, and how errors change that.

An error term makes one `Reading` of another. The truth beside it (`TrueImage`) never changes: which object each pixel
shows, how far off, and how obliquely, as rendered without any error.

A random number depends on the seed, the error term and what it is drawn for, never on how many were drawn before, so
that a sensor measures the same in any order of sensors, frames and processes, whichever others are used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.boxes import points_in_boxes
from toolkit.objects import Objects
from toolkit.sensors.sensor import Sensor, returned

_SENSOR, _FRAME, _OBJECT, _POLE = range(1, 5)  # what a stream of numbers is drawn for


@dataclass(frozen=True)
class Draws:
    """seed: of the recording's errors; sensor: a number that stands for the sensor; frame: its number; term: a number
    that stands for the error term."""

    seed: int
    sensor: int
    frame: int
    term: int

    def own_noise(self) -> np.random.Generator:
        """The generator of the sensor's own noise: that of `toolkit.datasets.dataset.noisy`, to the bit."""
        return np.random.default_rng([self.seed, self.frame, self.sensor])

    def of_frame(self) -> np.random.Generator:
        """A generator for this sensor in this frame."""
        return np.random.default_rng([self.seed, _FRAME, self.frame, self.sensor, self.term])

    def of_sensor(self) -> np.random.Generator:
        """A generator for this sensor, the same in every frame of a recording."""
        return np.random.default_rng([self.seed, _SENSOR, self.sensor, self.term])

    def of_pole(self, position: Float64[np.ndarray, "3"]) -> np.random.Generator:
        """A generator for all sensors over one point of the ground (to the centimetre), the same in every frame."""
        x, y = (int(np.rint(each * 100)) & 0xFFFFFFFF for each in position[:2].tolist())
        return np.random.default_rng([self.seed, _POLE, x, y, self.term])

    def of_objects(self, ids: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """A number of [0, 1) for each track id, the same for all sensors in every frame."""
        words = [self.seed, _OBJECT, self.term]
        drawn = [np.random.default_rng([*words, int(each) & 0xFFFFFFFFFFFFFFFF]).random() for each in ids.tolist()]
        return np.array(drawn, np.float64)


SKIN = 0.05  # m by which a box is larger than its object, so that points on its surface belong to it
FOOT_MARGIN = 0.05  # m above the foot of a box where the ground ends


@dataclass(frozen=True, eq=False)
class TrueImage:
    """What a sensor measures without error where it really is. velocities: of the objects, m/s, None if not known;
    time: of the frame (s)."""

    sensor: Sensor
    measurement: Float32[np.ndarray, "rows columns"]
    objects: Objects
    time: float = 0.0
    velocities: Float64[np.ndarray, "n 3"] | None = None

    @cached_property
    def valid(self) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels return anything."""
        return returned(self.measurement, self.sensor.model.max_range)

    @cached_property
    def ray_lengths(self) -> Float32[np.ndarray, "rows columns"]:
        """Range (m) per metre that is measured: 1 where the model measures ranges."""
        return np.linalg.norm(self.sensor.model.rays(), axis=2).astype(np.float32)

    @cached_property
    def ranges(self) -> Float32[np.ndarray, "rows columns"]:
        """Distance from the sensor to what each pixel shows (m), 0 for nothing."""
        return np.where(self.valid, self.measurement * self.ray_lengths, np.float32(0))

    @cached_property
    def points(self) -> Float64[np.ndarray, "pixels 3"]:
        """Where each pixel measures, world frame, row after row of the image; the sensor itself for nothing."""
        flat = np.where(self.valid, self.measurement, np.float32(0)).ravel().astype(np.float64)
        return (self.sensor.world_rays * flat).T.astype(np.float64) + self.sensor.position

    @cached_property
    def owners(self) -> Int64[np.ndarray, "rows columns"]:
        """Row of the object that each pixel shows, -1 for none: the one in whose box its point lies, above the foot."""
        owners = np.full(self.measurement.size, -1, np.int64)
        if len(self.objects):
            boxes = self.objects.boxes.copy()
            boxes[:, 2] += (FOOT_MARGIN + SKIN) / 2
            boxes[:, 3:5] += 2 * SKIN
            boxes[:, 5] = np.maximum(boxes[:, 5] + SKIN - FOOT_MARGIN, 1e-3)
            pixels = np.flatnonzero(self.valid)
            within = points_in_boxes(self.points[pixels], boxes)
            owners[pixels] = np.where(within.any(axis=1), within.argmax(axis=1), -1)
        return owners.reshape(self.measurement.shape)

    @cached_property
    def cosines(self) -> Float32[np.ndarray, "rows columns"]:
        """Cosine of the angle between each ray and the surface's normal, from the differences to the nearer of the
        neighbours across and along; 1 where these are not known."""
        rays = self.sensor.model.rays().astype(np.float64)
        points = rays * np.where(self.valid, self.measurement, np.float32(0))[..., None]
        normal = np.cross(_tangent(points, self.valid, 0), _tangent(points, self.valid, 1))
        area = np.linalg.norm(normal, axis=2)
        known = self.valid & (area > 0)
        along = np.abs(np.einsum("ijk,ijk->ij", normal, rays)) / np.where(known, area * self.ray_lengths, 1)
        return np.where(known, np.clip(along, 0, 1), 1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Reading:
    """What a sensor says. measurement: as of its model, 0 for nothing; pose: where it is believed to be,
    world_SE3_sensor; shift: metres, world frame, by which the point of each pixel lies off its ray, None for none."""

    truth: TrueImage
    measurement: Float32[np.ndarray, "rows columns"]
    pose: Float64[np.ndarray, "4 4"]
    shift: Float32[np.ndarray, "rows columns 3"] | None = None

    @staticmethod
    def of(truth: TrueImage) -> Reading:
        """Without error; NaN and infinity, which return nothing, are 0."""
        image = np.asarray(truth.measurement, np.float32)
        finite = np.isfinite(image)
        return Reading(truth, image if finite.all() else np.where(finite, image, np.float32(0)), truth.sensor.pose)

    @property
    def valid(self) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels return anything now."""
        return returned(self.measurement, self.truth.sensor.model.max_range)

    def without(self, lost: Bool[np.ndarray, "rows columns"]) -> Reading:
        """The reading where some pixels return nothing."""
        return self.measuring(np.where(lost, np.float32(0), self.measurement)) if lost.any() else self

    def measuring(self, measurement: Float32[np.ndarray, "rows columns"]) -> Reading:
        """The reading with another image."""
        return replace(self, measurement=measurement)


def _tangent(points: np.ndarray, valid: np.ndarray, axis: int) -> np.ndarray:
    """From each point to its nearer neighbour along an axis of the image, nothing where neither returns."""
    step = np.diff(points, axis=axis)
    both = np.logical_and(*_pairs(valid, axis))
    length = np.where(both, np.linalg.norm(step, axis=2), np.inf)
    edge = [(0, 0), (0, 0)]
    widths = {side: [*edge[:axis], side, *edge[axis + 1 :]] for side in ((0, 1), (1, 0))}
    after, before = (np.pad(length, width, constant_values=np.inf) for width in widths.values())
    step = np.where(both[..., None], step, 0)
    ahead, behind = (np.pad(step, [*width, (0, 0)]) for width in widths.values())
    return np.where((after <= before)[..., None], ahead, behind)


def _pairs(image: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """An image without its last, and without its first, row (axis 0) or column (axis 1)."""
    return (image[:-1], image[1:]) if axis == 0 else (image[:, :-1], image[:, 1:])


@runtime_checkable
class ErrorTerm(Protocol):
    """One kind of error."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def needs_velocities(self) -> bool:
        """Whether it has to be known how fast the objects are."""

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading with this error; the same reading where the term has no strength."""


def check_least(term: Any, **least: int | float) -> None:
    """ValueError where a number of a term is none, not finite or below the least it may be."""
    for name, lowest in least.items():
        value = getattr(term, name)
        if not isinstance(value, int | float | np.number) or not lowest <= value < np.inf:
            raise ValueError(f"{name} of {type(term).__name__} must be a number from {lowest:g} on, got {value!r}")


def check_share(term: Any, *names: str) -> None:
    """ValueError where a number of a term is no share."""
    for name in names:
        value = getattr(term, name)
        if not isinstance(value, int | float | np.number) or not 0 <= value <= 1:
            raise ValueError(f"{name} of {type(term).__name__} must be a share from 0 to 1, got {value!r}")
