"""One instant of a recording of clouds: what each sensor measured, what is there, and where the labels are complete.

The world frame of a sample is its layout's reference frame: x, y, z up, right-handed, metres. Where nothing moves it is
the site's; on a vehicle it is the vehicle's, and `map_SE3_world` says where in the set's map that is. Each layout in
`toolkit.datasets.layouts` states its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.boxes import corners
from toolkit.geometry import check_pose, invert, transform
from toolkit.objects import Objects

IGNORED_SHARE = 0.5  # of a box's rectangle in the image, from which on an ignored region voids it, as KITTI has it


@dataclass(frozen=True, eq=False)
class SensorCloud:
    """What one sensor measured.

    points: (n, 3) m, in the sensor's own frame or, where the set gives them so, in the sample's world frame; `frame`
    says which. world_SE3_sensor: where the sensor was. time: of each point, seconds from the sample's time; intensity:
    as the set gives it; ring: number of the laser that measured it. None where the set has none.
    """

    name: str
    points: Float32[np.ndarray, "n 3"]
    world_SE3_sensor: Float64[np.ndarray, "4 4"]
    frame: Literal["sensor", "world"] = "sensor"
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None
    ring: Int64[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ValueError(f"points of {self.name!r} must have shape (n, 3), got {self.points.shape}")
        for name, column in (("time", self.time), ("intensity", self.intensity), ("ring", self.ring)):
            if column is not None and column.shape != (len(self.points),):
                raise ValueError(f"{name} of {self.name!r} must be of {len(self.points)} points, got {column.shape}")
        object.__setattr__(self, "world_SE3_sensor", check_pose(self.world_SE3_sensor, f"pose of {self.name!r}"))

    def in_sensor(self) -> Float64[np.ndarray, "n 3"]:
        """The points in the sensor's own frame, float64."""
        points = self.points.astype(np.float64)
        return points if self.frame == "sensor" else transform(invert(self.world_SE3_sensor), points)

    def in_own_frame(self) -> SensorCloud:
        """The cloud with its points in the sensor's own frame."""
        return (
            self
            if self.frame == "sensor"
            else replace(self, points=self.in_sensor().astype(np.float32), frame="sensor")
        )

    def in_world(self) -> Float64[np.ndarray, "n 3"]:
        """The points in the world frame, float64, so that map coordinates keep their millimetres."""
        points = self.points.astype(np.float64)
        return points if self.frame == "world" else transform(self.world_SE3_sensor, points)


@runtime_checkable
class Region(Protocol):
    """Where the labels of a sample are complete."""

    def covers(self, boxes: Float64[np.ndarray, "n 7"]) -> Bool[np.ndarray, " n"]:
        """Which boxes, world frame, stand where an unlabelled object would be a miss of the labels."""
        ...

    def record(self) -> dict[str, Any]:
        """What files say of it, in JSON: its kind, and its numbers; `region_of` makes a region of that."""
        ...


@dataclass(frozen=True)
class Everywhere:
    """Labels that are complete wherever there are points."""

    def covers(self, boxes: Float64[np.ndarray, "n 7"]) -> Bool[np.ndarray, " n"]:
        """All."""
        return np.ones(len(boxes), bool)

    def record(self) -> dict[str, Any]:
        """Its kind."""
        return {"kind": "everywhere"}


@dataclass(frozen=True)
class Rectangle:
    """Labels of a detection area: xmin, ymin, xmax, ymax (m)."""

    area: tuple[float, float, float, float]

    def covers(self, boxes: Float64[np.ndarray, "n 7"]) -> Bool[np.ndarray, " n"]:
        """Those with their centre in it."""
        xmin, ymin, xmax, ymax = self.area
        x, y = boxes[:, 0], boxes[:, 1]
        return (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax)

    def record(self) -> dict[str, Any]:
        """Its kind and area."""
        return {"kind": "rectangle", "area": list(self.area)}


@dataclass(frozen=True, eq=False)
class ImageWedge:
    """Labels of what one camera sees. projection: world → pixels, homogeneous; width, height: of the image; ignored:
    left, top, right, bottom of regions where nobody labelled (DontCare)."""

    projection: Float64[np.ndarray, "3 4"]
    width: int
    height: int
    ignored: tuple[tuple[float, float, float, float], ...] = ()

    def covers(self, boxes: Float64[np.ndarray, "n 7"]) -> Bool[np.ndarray, " n"]:
        """Those whose centre the image shows, less those that mostly lie in an ignored region."""
        u, v, depth = self._pixels(boxes[:, :3])
        shown = (depth > 0) & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
        for region in self.ignored:
            shown &= self._share(boxes, region) <= IGNORED_SHARE
        return shown

    def rectangles(self, boxes: Float64[np.ndarray, "n 7"]) -> Float64[np.ndarray, "n 4"]:
        """Left, top, right, bottom of each box in the image, cut to it; all 0 for a box behind the camera."""
        if not len(boxes):
            return np.zeros((0, 4))
        u, v, depth = self._pixels(corners(boxes).reshape(-1, 3))
        u, v, ahead = u.reshape(-1, 8), v.reshape(-1, 8), (depth > 0).reshape(-1, 8)
        limits = np.array([self.width - 1.0, self.height - 1.0])
        low = np.clip(np.stack([u.min(axis=1), v.min(axis=1)], axis=1), 0, limits)
        high = np.clip(np.stack([u.max(axis=1), v.max(axis=1)], axis=1), 0, limits)
        return np.where(np.asarray(ahead.all(axis=1))[:, None], np.hstack([low, high]), 0.0)

    def record(self) -> dict[str, Any]:
        """Its kind, its projection, its image and what is ignored in it."""
        ignored = [list(region) for region in self.ignored]
        return {"kind": "image", "projection": self.projection.tolist(), "width": self.width, "height": self.height,
                "ignored": ignored}  # fmt: skip

    def _share(self, boxes: np.ndarray, region: tuple[float, float, float, float]) -> np.ndarray:
        rectangles = self.rectangles(boxes)
        overlap = np.minimum(rectangles[:, 2:], region[2:]) - np.maximum(rectangles[:, :2], region[:2])
        size = rectangles[:, 2:] - rectangles[:, :2]
        area = size.prod(axis=1)
        return np.clip(overlap, 0, None).prod(axis=1) / np.where(area > 0, area, 1.0)

    def _pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        homogeneous = points @ self.projection[:, :3].T + self.projection[:, 3]
        depth = homogeneous[:, 2]
        divisor = np.where(np.abs(depth) > 1e-9, depth, 1e-9)
        return homogeneous[:, 0] / divisor, homogeneous[:, 1] / divisor, depth


def _four(values: Any) -> tuple[float, float, float, float]:
    a, b, c, d = (float(value) for value in values)
    return a, b, c, d


def _projection(values: Any) -> Float64[np.ndarray, "3 4"]:
    matrix = np.array(values, np.float64)
    if matrix.shape != (3, 4):
        raise ValueError(f"a projection must be 3 by 4, got {matrix.shape}")
    return matrix


_REGIONS: dict[str, Callable[[Mapping[str, Any]], Region]] = {
    "everywhere": lambda record: Everywhere(),
    "rectangle": lambda record: Rectangle(_four(record["area"])),
    "image": lambda record: ImageWedge(
        _projection(record["projection"]), int(record["width"]), int(record["height"]),
        tuple(_four(each) for each in record["ignored"]),
    ),
}  # fmt: skip


def region_of(record: Any) -> Region:
    """The region that `Region.record` says. Raises ValueError for a kind that there is not, and for other numbers.

    >>> region_of(Rectangle((0.0, 0.0, 2.0, 1.0)).record())
    Rectangle(area=(0.0, 0.0, 2.0, 1.0))
    """
    kind = str(record.get("kind")) if isinstance(record, Mapping) else ""
    if kind not in _REGIONS:
        raise ValueError(f"labels must be complete in one of {', '.join(_REGIONS)}, got {str(record)[:60]}")
    try:
        return _REGIONS[kind](record)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"the numbers of a region {kind} are damaged ({' '.join(str(error).split())[:80]})") from None


@dataclass(frozen=True, eq=False)
class OtherObjects:
    """What a set labels that is none of our classes: boxes, its own names, and its own counts where it has some."""

    boxes: Float64[np.ndarray, "n 7"] = field(default_factory=lambda: np.zeros((0, 7)))
    categories: tuple[str, ...] = ()
    counts: Int64[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class Sample:
    """One instant.

    name: unique in its recording; clouds: one per sensor; objects: what is labelled, world frame; categories: the set's
    own names of the objects' classes; counts: the set's own number of points on each, None where it has none; others:
    what is labelled beside our classes; complete: where the labels are complete; time: seconds, NaN where the set has
    none; map_SE3_world: where the world frame is in the set's map; problems: what was met in reading and left out, or
    put among the others, by kind, and how many.
    """

    name: str
    clouds: tuple[SensorCloud, ...]
    objects: Objects
    categories: tuple[str, ...] = ()
    counts: Int64[np.ndarray, " m"] | None = None
    others: OtherObjects = field(default_factory=OtherObjects)
    complete: Region = field(default_factory=Everywhere)
    time: float = float("nan")
    map_SE3_world: Float64[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    problems: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [cloud.name for cloud in self.clouds]
        if len(set(names)) < len(names):
            raise ValueError(f"the sensors of sample {self.name!r} must have different names, got {names}")
        if self.categories and len(self.categories) != len(self.objects):
            raise ValueError(f"{len(self.objects)} objects but {len(self.categories)} categories in {self.name!r}")
        if self.counts is not None and len(self.counts) != len(self.objects):
            raise ValueError(f"{len(self.objects)} objects but {len(self.counts)} counts in {self.name!r}")

    def points(self) -> Float64[np.ndarray, "n 3"]:
        """The points of all sensors, one after the other, world frame."""
        return np.concatenate([np.zeros((0, 3)), *(cloud.in_world() for cloud in self.clouds)])

    def seen_by(self, sensors: Sequence[str]) -> Sample:
        """The sample with the clouds of some sensors (names). Raises ValueError for one that it has not."""
        names = [cloud.name for cloud in self.clouds]
        for name in sensors:
            if name not in names:
                raise ValueError(f"sample {self.name!r} has no sensor {name!r}: it has {', '.join(names) or 'none'}")
        return replace(self, clouds=tuple(cloud for cloud in self.clouds if cloud.name in sensors))

    def of(self, rows: Shaped[np.ndarray, " k"]) -> Sample:
        """The sample with some of its objects: a mask or indices."""
        rows = np.arange(len(self.objects))[rows]
        return replace(
            self,
            objects=self.objects[rows],
            categories=tuple(self.categories[k] for k in rows) if self.categories else (),
            counts=None if self.counts is None else self.counts[rows],
        )
