"""One instant of a recording: the measurements and the objects.

A `Frame` may come from anywhere. A measurement is an image of ranges or a cloud; both give points.
The world frame is right-handed, x and y level, z up, in metres. If the sensors stand still it is
the site's; on a vehicle it is the vehicle's, and `map_SE3_world` places it in the map. Each reader
in `toolkit.datasets.layouts` states its own."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, cast, runtime_checkable

import numpy as np

from toolkit.arrays import (
    Bool,
    BoxRows,
    Float,
    Float32,
    Float64,
    ImageVectors,
    Int64,
    Mask,
    Pose,
    Shaped,
)
from toolkit.boxes import corners
from toolkit.display import Card, Displayed, Table, describe_count
from toolkit.frozen import set_fields
from toolkit.geometry import check_pose, invert, transform
from toolkit.objects import Objects
from toolkit.sensors.models import SpinningLidar
from toolkit.sensors.sensor import Sensor, is_return, tabulate_sensors
from toolkit.sites.site import Site

# share of a box's rectangle in the image beyond which an ignored region voids it, as in KITTI
IGNORED_SHARE = 0.5
# m from every sensor and point; an object farther away has coordinates of another unit or frame
FARTHEST_BOX = 1000.0
AWAY = "boxes a kilometre from every sensor"
MAX_APART_S = 0.02  # a car at 50 km/h moves .28 m
APART = f"frames whose clouds were measured more than {MAX_APART_S * 1000:.0f} ms apart"
# stands for the model of a sensor that is known by its clouds alone
_UNKNOWN_MODEL = SpinningLidar()


@dataclass(frozen=True, eq=False)
class SensorCloud:
    """Points that one sensor measured.

    Attributes:
        points: (n, 3) m, in the sensor's frame or in the world frame, as `frame` says.
        world_SE3_sensor: pose of the sensor.
        time: of each point, seconds from the cloud's first; None if the set lacks it.
        intensity: of each point, as the set gives it; None if it lacks it.
        ring: number of each point's laser; None if the set lacks it.
        stamp_s: when the cloud was measured, seconds on the clock of `Frame.time`; None if
            unknown."""

    name: str
    points: Float32[np.ndarray, "n 3"]
    world_SE3_sensor: Pose
    frame: Literal["sensor", "world"] = "sensor"
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None
    ring: Int64[np.ndarray, " n"] | None = None
    stamp_s: float | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for columns of another length and a pose that is no rigid motion."""
        if self.points.ndim != 2 or self.points.shape[1] != 3:
            raise ValueError(
                f"points of {self.name!r} must have shape (n, 3), got {self.points.shape}"
            )
        for name, column in (
            ("time", self.time),
            ("intensity", self.intensity),
            ("ring", self.ring),
        ):
            if column is not None and column.shape != (len(self.points),):
                raise ValueError(
                    f"{name} of {self.name!r} must be of {len(self.points)} points, got "
                    f"{column.shape}"
                )
        if self.stamp_s is not None and not np.isfinite(self.stamp_s):
            raise ValueError(
                f"stamp_s of {self.name!r} must be seconds, got {self.stamp_s}: give None if "
                "unknown"
            )
        pose = check_pose(self.world_SE3_sensor, f"pose of {self.name!r}")
        set_fields(self, world_SE3_sensor=pose)  # as float64; the dataclass is frozen

    def in_sensor(self) -> Float64[np.ndarray, "n 3"]:
        """Points (m) in the sensor's frame, as float64."""
        points = self.points.astype(np.float64)
        return (
            points if self.frame == "sensor" else transform(invert(self.world_SE3_sensor), points)
        )

    def in_own_frame(self) -> "SensorCloud":
        """Return the cloud with its points in the sensor's frame; itself if they are already."""
        if self.frame == "sensor":
            return self
        return replace(self, points=self.in_sensor().astype(np.float32), frame="sensor")

    def in_world(self) -> Float64[np.ndarray, "n 3"]:
        """Points (m) in the world frame, as float64, since coordinates may be large."""
        points = self.points.astype(np.float64)
        return points if self.frame == "world" else transform(self.world_SE3_sensor, points)


class Region:
    """Region in which a frame's labels are complete; objects outside it may have no label."""

    kind: ClassVar[str]  # name of the subclass in records

    def covers(self, boxes: BoxRows) -> Mask:
        """Mask of the boxes (world frame) inside the region."""
        raise NotImplementedError

    def move_origin(self, origin: Float64[np.ndarray, "3"]) -> "Region":
        """Return the region in a world frame that begins at `origin` (m) of this one."""
        raise NotImplementedError

    def record(self) -> dict[str, object]:
        """Return kind and fields as plain values, for JSON and `parse_region`."""
        return {
            "kind": self.kind,
            **{name: np.asarray(value).tolist() for name, value in vars(self).items()},
        }


@dataclass(frozen=True)
class Everywhere(Region):
    """Labels are complete wherever there are points."""

    kind = "everywhere"

    def covers(self, boxes: BoxRows) -> Mask:
        """Mask of all boxes."""
        return np.ones(len(boxes), bool)

    def move_origin(self, origin: Float64[np.ndarray, "3"]) -> "Everywhere":
        """Return the region itself."""
        return self


@dataclass(frozen=True)
class Rectangle(Region):
    """Detection area with complete labels.

    area: xmin, ymin, xmax, ymax (m, world frame)."""

    kind = "rectangle"
    area: tuple[float, float, float, float]

    def covers(self, boxes: BoxRows) -> Mask:
        """Mask of the boxes with their centre in the area."""
        return np.asarray(
            ((boxes[:, :2] >= self.area[:2]) & (boxes[:, :2] <= self.area[2:])).all(axis=1)
        )

    def move_origin(self, origin: Float64[np.ndarray, "3"]) -> "Rectangle":
        """Return the rectangle counted from another origin."""
        x, y, _ = origin.tolist()
        xmin, ymin, xmax, ymax = self.area
        return Rectangle((xmin - x, ymin - y, xmax - x, ymax - y))


@dataclass(frozen=True, eq=False)
class ImageWedge(Region):
    """Region that one camera sees, except for ignored rectangles of its image.

    Attributes:
        projection: matrix that takes x, y, z, 1 (m, world frame) to u · depth, v · depth, depth.
        width: width of the image (pixels).
        height: its height.
        ignored: left, top, right, bottom (pixels) of regions without complete labels, KITTI's
            DontCare."""

    kind = "image"
    projection: Float64[np.ndarray, "3 4"]
    width: int
    height: int
    ignored: tuple[tuple[float, float, float, float], ...] = ()

    def covers(self, boxes: BoxRows) -> Mask:
        """Mask of the boxes (world frame) with their centre in the camera's image.

        Boxes do not count if more than `IGNORED_SHARE` of their rectangle in the image is in an
        ignored region."""
        centres = boxes[:, :3]
        # pixels from the left and from the top, and metres from the camera
        u, v, depth = self._pixels(centres)
        is_inside = (depth > 0) & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
        if not self.ignored:
            return is_inside
        rectangles = self.rectangles(boxes)
        left_top, right_bottom = rectangles[:, :2], rectangles[:, 2:]
        area = (right_bottom - left_top).prod(axis=1)
        for region in self.ignored:  # left, top, right, bottom
            # width and height of the overlap, negative for none
            overlap = np.minimum(right_bottom, region[2:]) - np.maximum(left_top, region[:2])
            overlap_area = np.clip(overlap, 0, None).prod(axis=1)
            is_inside &= overlap_area / np.where(area > 0, area, 1.0) <= IGNORED_SHARE
        return is_inside

    def move_origin(self, origin: Float64[np.ndarray, "3"]) -> "ImageWedge":
        """Return the wedge whose projection begins at another origin."""
        moved = self.projection.copy()
        moved[:, 3] += self.projection[:, :3] @ origin
        return replace(self, projection=moved)

    def rectangles(self, boxes: BoxRows) -> Float64[np.ndarray, "n 4"]:
        """Left, top, right, bottom (pixels) of boxes in the image, cut to it.

        All four are 0 for a box with a corner behind the camera."""
        if not len(boxes):
            return np.zeros((0, 4))
        # each (box, corner): pixels from the left and from the top, and metres from the camera
        u, v, depth = (
            column.reshape(-1, 8) for column in self._pixels(corners(boxes).reshape(-1, 3))
        )
        limits = np.array([self.width - 1.0, self.height - 1.0])
        left_top = np.clip(np.stack([u.min(axis=1), v.min(axis=1)], axis=1), 0, limits)
        right_bottom = np.clip(np.stack([u.max(axis=1), v.max(axis=1)], axis=1), 0, limits)
        is_in_front = (depth > 0).all(axis=1, keepdims=True)
        return np.where(is_in_front, np.hstack([left_top, right_bottom]), 0.0)

    def _pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels u, v and depth (m) of points (n, 3); a depth of 0 becomes 1e-9 to divide by."""
        homogeneous = points @ self.projection[:, :3].T + self.projection[:, 3]
        depth = homogeneous[:, 2]
        divisor = np.where(np.abs(depth) > 1e-9, depth, 1e-9)
        return homogeneous[:, 0] / divisor, homogeneous[:, 1] / divisor, depth


def _four(values: Any) -> tuple[float, float, float, float]:
    """Four numbers as a tuple of floats; ValueError for another count."""
    a, b, c, d = (float(value) for value in values)
    return a, b, c, d


def parse_region(record: object) -> Region:
    """Return the region in which labels are complete from its record.

    record: "kind" (everywhere, rectangle or image) and the fields of such a region, as read from
    JSON. Raises ValueError for anything else."""
    fields: Mapping[str, Any] = record if isinstance(record, Mapping) else {}
    kind = str(fields.get("kind"))
    try:
        if kind == "everywhere":
            return Everywhere()
        if kind == "rectangle":
            return Rectangle(_four(fields["area"]))
        if kind == "image":
            projection = np.array(fields["projection"], np.float64)
            if projection.shape != (3, 4):
                raise ValueError(f"a projection must be 3 by 4, got {projection.shape}")
            ignored = tuple(_four(rectangle) for rectangle in fields["ignored"])
            return ImageWedge(
                projection,
                width=int(fields["width"]),
                height=int(fields["height"]),
                ignored=ignored,
            )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(
            f"the numbers of a region {kind} are damaged ({' '.join(str(error).split())[:80]})"
        ) from None
    raise ValueError(
        f"labels must be complete in one of everywhere, rectangle, image, got {str(record)[:60]}"
    )


@dataclass(frozen=True, eq=False)
class OtherObjects:
    """Labels of classes other than ours.

    Attributes:
        boxes: box of each label, world frame.
        categories: its class as the data set names it.
        counts: the data set's number of points on it, None if it gives none."""

    boxes: BoxRows = field(default_factory=lambda: np.zeros((0, 7)))
    categories: tuple[str, ...] = ()
    counts: Int64[np.ndarray, " n"] | None = None


Image = Float32[np.ndarray, "_ _"]


@dataclass(frozen=True, eq=False)
class Frame(Displayed):
    """One instant.

    measurements: one per sensor, in the order of `sensors`. An image is (rows, columns) float32 of
    depth (camera) or range (lidar) in metres, 0 where nothing returned; of a sensor known by its
    clouds alone it is the cloud. objects: ground truth or labels, world frame. time: seconds, NaN
    where unknown. index: its number in its recording. shifts: for each sensor the distance (m,
    world frame) of each pixel's point from its ray, None for none; empty where no sensor has any
    (see `toolkit.sensors.error_terms`).

    Labels of a recorded frame say more: name, unique in its recording; categories, counts: the
    set's names of the objects' classes, and its number of points on each; others: labels of other
    classes; complete: where labels are; map_SE3_world: pose of the world frame in the set's map;
    problems: labels and points left out in reading, by kind.
    """

    sensors: tuple[Sensor, ...]
    measurements: tuple[Image | SensorCloud, ...]
    objects: Objects
    time: float = 0.0
    index: int = 0
    shifts: tuple[Float32[np.ndarray, "_ _ 3"] | None, ...] = ()
    name: str = ""
    categories: tuple[str, ...] = ()
    counts: Int64[np.ndarray, " m"] | None = None
    others: OtherObjects = field(default_factory=OtherObjects)
    complete: Region = field(default_factory=Everywhere)
    map_SE3_world: Pose = field(default_factory=lambda: np.eye(4))
    problems: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError for fields that do not fit each other, and for equal sensor names."""
        if len(self.sensors) != len(self.measurements):
            raise ValueError(
                f"{len(self.sensors)} sensors but {len(self.measurements)} measurements"
            )
        if self.shifts and len(self.shifts) != len(self.sensors):
            raise ValueError(
                f"{len(self.sensors)} sensors but {len(self.shifts)} shifts: give one each, or none"
            )
        names = [sensor.name for sensor in self.sensors]
        if len(set(names)) < len(names):
            raise ValueError(
                f"the sensors of a frame must have different names, got {names}: rename one"
            )
        for sensor, measurement in zip(self.sensors, self.measurements, strict=True):
            if isinstance(measurement, np.ndarray):
                _check_image(sensor, measurement)
        count = len(self.objects.boxes)
        # categories may be empty, and counts None, with any number of objects
        for column, values in (("categories", self.categories or None), ("counts", self.counts)):
            if values is not None and len(values) != count:
                raise ValueError(f"{count} objects but {len(values)} {column} in {self.name!r}")

    @staticmethod
    def of_clouds(
        name: str,
        clouds: Sequence[SensorCloud],
        objects: Objects,
        categories: tuple[str, ...] = (),
        counts: Int64[np.ndarray, " m"] | None = None,
        others: OtherObjects | None = None,
        *,
        time: float = np.nan,
        **more: Any,
    ) -> "Frame":
        """Return a labelled frame of clouds, with a sensor of unknown model for each cloud.

        Its `problems` also count objects a kilometre away from all clouds, and clouds measured at
        different times.

        Args:
            name: Name of the frame, unique in its recording.
            clouds: A cloud of each sensor.
            objects: Labels of our classes, world frame.
            categories: Class of each object as the data set names it.
            counts: The data set's number of points on each object, None if it gives none.
            others: Labels of other classes, None if there are none.
            time: Seconds, NaN if unknown.
            more: Further fields of `Frame`."""
        more |= {
            "categories": categories,
            "counts": counts,
            "others": OtherObjects() if others is None else others,
        }
        if away := _count_away(clouds, objects):
            more["problems"] = {**more.get("problems", {}), AWAY: away}
        if measure_spread(clouds) > MAX_APART_S:
            more["problems"] = {**more.get("problems", {}), APART: 1}
        return Frame(
            sensors=_cloud_sensors(clouds),
            measurements=tuple(clouds),
            objects=objects,
            time=time,
            name=name,
            **more,
        )

    def _card(self) -> Card:
        """Return title, facts, table and picture of the frame, for `repr` and notebooks."""
        time_facts = () if np.isnan(self.time) else (f"time {self.time:g} s",)
        counts = (
            describe_count(len(self.sensors), "sensor"),
            describe_count(len(self.objects), "object"),
        )
        return Card(
            title=f"Frame({self.name!r})" if self.name else f"Frame {self.index}",
            facts=(*time_facts, *counts),
            tables={"sensors": lambda: tabulate_measured(self)},
            drawing="toolkit.viewing.still:draw_frame_alone",
        )

    @property
    def has_images(self) -> bool:
        """True if the frame has sensors and each of them measured an image."""
        return bool(self.sensors) and not any(
            isinstance(measurement, SensorCloud) for measurement in self.measurements
        )

    @property
    def images(self) -> tuple[Image, ...]:
        """Image of every sensor (rows, columns; m); ValueError if one measured a cloud."""
        for sensor, measurement in zip(self.sensors, self.measurements, strict=True):
            if isinstance(measurement, SensorCloud):
                raise ValueError(
                    f"sensor {sensor.name!r} measured a cloud, no image: choose what works with "
                    "points"
                )
        return self.measurements  # type: ignore[return-value]

    @cached_property
    def clouds(self) -> tuple[SensorCloud, ...]:
        """Points of every sensor as a cloud, in the order of `sensors`.

        Images become clouds in the frame of the sensor's body (x forward, y left, z up)."""
        clouds = []
        for k, (sensor, measurement) in enumerate(
            zip(self.sensors, self.measurements, strict=True)
        ):
            if isinstance(measurement, SensorCloud):
                clouds.append(measurement)
                continue
            shift = self.shifts[k] if self.shifts else None
            world_points, has_return = unproject(sensor, measurement, shift)
            body = sensor.world_SE3_body
            body_points = transform(invert(body), world_points.T[has_return].astype(np.float64))
            cloud = SensorCloud(
                sensor.name, points=body_points.astype(np.float32), world_SE3_sensor=body
            )
            clouds.append(cloud)
        return tuple(clouds)

    def points(self) -> Float64[np.ndarray, "n 3"]:
        """Points (m, world frame) of all sensors, one sensor after the other."""
        return np.concatenate([np.zeros((0, 3)), *(cloud.in_world() for cloud in self.clouds)])

    def with_clouds(self, clouds: Sequence[SensorCloud]) -> "Frame":
        """Return the frame with other clouds instead of its sensors and measurements."""
        return replace(self, sensors=_cloud_sensors(clouds), measurements=tuple(clouds), shifts=())

    def seen_by(self, sensors: Sequence[int | str]) -> "Frame":
        """Return the frame with only some sensors, in the frame's order.

        sensors: names or positions in `Frame.sensors`. Raises ValueError for unknown ones."""
        positions = sorted(select_sensors(self.sensors, sensors))
        if len(positions) == len(self.sensors):
            return self
        kept_sensors = tuple(self.sensors[k] for k in positions)
        measurements = tuple(self.measurements[k] for k in positions)
        shifts = tuple(self.shifts[k] for k in positions) if self.shifts else ()
        return replace(self, sensors=kept_sensors, measurements=measurements, shifts=shifts)

    def select_objects(self, rows: Shaped[np.ndarray, " k"]) -> "Frame":
        """Return the frame with only some objects, their categories and counts.

        rows: mask of the objects or their row numbers."""
        row_numbers = np.arange(len(self.objects))[rows]
        categories = tuple(self.categories[k] for k in row_numbers) if self.categories else ()
        counts = None if self.counts is None else self.counts[row_numbers]
        objects = self.objects[row_numbers]
        return replace(self, objects=objects, categories=categories, counts=counts)


def tabulate_measured(frame: Frame) -> Table:
    """Columns of a table of a frame's sensors, with the number of points of each."""
    return {
        **tabulate_sensors(frame.sensors),
        "points": [len(cloud.points) for cloud in frame.clouds],
    }


def measure_spread(clouds: Sequence[SensorCloud]) -> float:
    """Time (s) between the first and the last of some clouds, 0 if fewer than two have a stamp."""
    stamps = [cloud.stamp_s for cloud in clouds if cloud.stamp_s is not None]
    return max(stamps) - min(stamps) if len(stamps) > 1 else 0.0


def _count_away(clouds: Sequence[SensorCloud], objects: Objects) -> int:
    """Count the objects farther than `FARTHEST_BOX` (m) from every sensor and its points.

    The distance to points is the distance along an axis to the cuboid around them. 0 without
    clouds."""
    centres = objects.boxes[:, :3]
    is_away_of_all = np.full(len(objects), len(clouds) > 0)
    for cloud in clouds:
        if not is_away_of_all.any():
            break
        sensor_position = cloud.world_SE3_sensor[:3, 3]
        is_away = np.linalg.norm(centres - sensor_position, axis=1) > FARTHEST_BOX
        # clouds in a map may come without their sensor's position, so their points count too
        if (is_away_of_all & is_away).any() and len(cloud.points):
            points = cloud.in_world()
            low = points.min(axis=0) - FARTHEST_BOX
            high = points.max(axis=0) + FARTHEST_BOX
            is_away &= ((centres < low) | (centres > high)).any(axis=1)
        is_away_of_all &= is_away
    return int(is_away_of_all.sum())


def _cloud_sensors(clouds: Sequence[SensorCloud]) -> tuple[Sensor, ...]:
    # Sensor at the pose of each cloud, with a model that stands for an unknown one.
    return tuple(Sensor(cloud.name, _UNKNOWN_MODEL, cloud.world_SE3_sensor) for cloud in clouds)


def _check_image(sensor: Sensor, measurement: np.ndarray) -> None:
    """Raise ValueError unless an image has the rows and columns of its sensor."""
    if measurement.shape != (shape := sensor.model.shape):
        raise ValueError(
            f"sensor {sensor.name!r} measures {shape} pixels, got an image of {measurement.shape}"
        )


@runtime_checkable
class Frames(Protocol):
    """Frames in order, such as a `Recording`."""

    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Frame: ...


@runtime_checkable
class Recording(Frames, Protocol):
    """Frames of one place; its site may be unknown (None)."""

    @property
    def site(self) -> Site | None:
        """The place, with its detection area."""

    def __iter__(self) -> Iterator[Frame]: ...


@runtime_checkable
class SiteRecording(Frames, Protocol):
    """Frames at a known site, such as a `toolkit.datasets.dataset.CoopDataset`."""

    site: Site
    sensors: tuple[Sensor, ...]


def unproject(
    sensor: Sensor,
    measurement: Float[np.ndarray, "rows columns"],
    shift: ImageVectors | None = None,
) -> tuple[Float32[np.ndarray, "3 pixels"], Bool[np.ndarray, " pixels"]]:
    """Return the world point of every pixel, and a mask of the pixels that have a return.

    Pixels are in one line, row after row of the image. A pixel without return has the sensor's
    position, moved by its shift. measurement: depth or range (m) of each pixel; shift: displacement
    of each pixel's point (m, world frame), None for none. Raises ValueError for a sensor more than
    100 km from the origin."""
    _check_image(sensor, measurement)
    position = sensor.pose[:3, 3]
    if np.abs(position).max() > 1e5:
        far = (
            f"sensor {sensor.name!r} stands at {position.tolist()}, too far from the origin for "
            "float32 points"
        )
        raise ValueError(f"{far}: take coordinates from an origin near the site")
    flat_measurement = np.asarray(measurement, np.float32).ravel()
    has_return = is_return(flat_measurement, sensor.model.max_range)
    # rays (3, pixels) are scaled so that measurement times ray leads from the sensor to the point
    xyz = sensor.world_rays * np.where(has_return, flat_measurement, np.float32(0))
    xyz += position.astype(np.float32)[:, None]
    if shift is not None:
        xyz += shift.reshape(-1, 3).T
    return xyz, has_return


def select_sensors(
    available: Sequence[Sensor], wanted: Sequence[int | str] | None = None
) -> list[int]:
    """Return the indices in `available` of some sensors, in the order of `wanted`.

    wanted: names or indices, None for all. Raises ValueError for an unknown sensor, one chosen
    twice, and names that two sensors share."""
    names = [sensor.name for sensor in available]
    if len(set(names)) < len(names):
        raise ValueError(
            f"every sensor needs a name of its own, got {', '.join(names)}: rename those that "
            "share one"
        )
    if wanted is None:
        return list(range(len(names)))
    if isinstance(wanted, str):
        raise ValueError(
            f"sensors must be a list of numbers or names, got the text {wanted!r}: pass "
            f"[{wanted!r}]"
        )
    positions = []
    for which in wanted:
        if isinstance(which, str) and which in names:
            positions.append(names.index(which))
        elif isinstance(which, int | np.integer) and 0 <= which < len(names):
            positions.append(int(which))
        else:
            raise ValueError(
                f"no sensor {which!r}: choose among 0..{len(names) - 1} or {', '.join(names)}"
            )
    if len(set(positions)) < len(positions):
        raise ValueError(
            f"a sensor can be chosen once only, got {list(wanted)}: leave out what is there twice"
        )
    return positions


class DisplayedRecording(Displayed):
    """Base of recordings that notebooks and terminals show as a card.

    The card has path and number of frames, and the sensors and the scene of the first frame."""

    def _card(self) -> Card:
        """Return title, facts, table and picture of the recording, for `repr` and notebooks."""
        recording = cast("Recording", self)
        # not all recordings have a path, or sensors that are the same in every frame
        path = getattr(self, "path", None)
        sensors = getattr(self, "sensors", None)
        class_name = type(self).__name__
        sensor_facts = () if sensors is None else (describe_count(len(sensors), "sensor"),)
        site_facts = () if recording.site is None else (f"site {recording.site.name!r}",)
        return Card(
            title=class_name if path is None else f"{class_name}({str(path)!r})",
            facts=(describe_count(len(recording), "frame"), *sensor_facts, *site_facts),
            tables={"sensors": lambda: tabulate_measured(recording[0]) if len(recording) else {}},
            drawing="toolkit.viewing.still:draw_recording",
        )


@dataclass(frozen=True, eq=False)
class RecordingView(DisplayedRecording):
    """Base of recordings whose frames are made from the frames of another one.

    recording: the other one; each frame is passed on unless a subclass changes it."""

    recording: Frames

    @property
    def site(self) -> Site | None:
        """The place, None if unknown."""
        return getattr(self.recording, "site", None)

    @property
    def path(self) -> Path | None:
        """The recording's file or folder."""
        return getattr(self.recording, "path", None)

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: int) -> Frame:
        return self.recording[index]

    def __iter__(self) -> Iterator[Frame]:
        return map(self.__getitem__, range(len(self)))


def empty_scene(frames: Sequence[Frame], sample: int = 100) -> Frame:
    """Return a frame without objects: each sensor's image behind all that moves.

    Each pixel has its farthest return. No return counts as farthest, so a pixel that sees the sky
    in any frame is 0. frames: frames of images from the same sensors; sample: largest number of
    frames to use, spread evenly over all. Raises ValueError without frames."""
    if not len(frames):
        raise ValueError("the empty scene needs a frame, got none")
    indices = np.linspace(0, len(frames) - 1, min(sample, len(frames))).astype(int)
    farthest: list[np.ndarray] = []  # an image of each sensor
    for index in np.unique(indices):
        # no return is infinite here and 0 again in `still_images`
        images = [np.where(image > 0, image, np.inf) for image in frames[int(index)].images]
        if farthest:
            images = [np.maximum(*pair) for pair in zip(farthest, images, strict=True)]
        farthest = images
    still_images = tuple(
        np.where(np.isfinite(image), image, 0).astype(np.float32) for image in farthest
    )
    return Frame(frames[0].sensors, measurements=still_images, objects=Objects.empty())
