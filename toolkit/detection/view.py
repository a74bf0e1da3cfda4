"""`View`: one frame as its sensors saw it.

A fusion scheme takes clouds and detections from it, each computed once. All schemes and sensor sets
that are scored on a frame share one view. Every value has the time at which it is ready, in
milliseconds after the measurement. Sensors work in parallel, so a step begins when the last of its
inputs is ready."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from time import perf_counter
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from toolkit.arrays import Float32, ImageRanges, Int64, Mask
from toolkit.boxes import nms
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.place import CROP_HEIGHT_M, Stand, crop_points
from toolkit.calibration.recording_scenes import Scenes
from toolkit.detection.codec import PAPER, Codec, ImageCodec, Origin, RangeImage
from toolkit.frame import Frame, unproject
from toolkit.geometry import LEVEL
from toolkit.objects import Detections, Detector, Objects
from toolkit.points import Area, Crop, crop_image, crop_sensor, detect_on_ground
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

NMS_IOU = 0.1
LinkMemory = dict[tuple[int, str], Any]  # state of links between frames, by sensor (index) and name
_Value = TypeVar("_Value")
Lift = Callable[[Float32[np.ndarray, "n 3"]], Float32[np.ndarray, "n 3"]]
Keep = Callable[[Float32[np.ndarray, "n 3"], Sensor], Mask]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of one sensor of a view.

    Attributes:
        sensor: index of the sensor.
        history: steps that its cropped points went through; clouds of one sensor and frame with
            equal histories are equal.
        points: the points, world frame (m).
        ms: time after the measurement at which they are ready.
        rows: rows of the points among the sensor's cropped points, None for all.
    """

    sensor: int
    history: tuple[str, ...]
    points: Float32[np.ndarray, "n 3"]
    ms: float
    rows: Int64[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class Captured:
    """Image in which a sensor's points were measured: number `index` of a frame.

    Attributes:
        frame: frame of the image.
        index: index of the sensor.
        area: area of the crop.
        height: height of the crop (m), None for the area's.
        crop_pixels: pixels of the points in the crop, in the points' order, None to find them.
        lift: what was done to points of the frame's world before they were cropped, such as putting
            them on level ground.
    """

    frame: Frame
    index: int
    area: Area
    height: float | None = None
    crop_pixels: Int64[np.ndarray, " n"] | None = None
    lift: Lift | None = None

    @property
    def sensor(self) -> Sensor:
        """Sensor of the image, at its assumed pose."""
        return self.frame.sensors[self.index]

    @property
    def measurement(self) -> ImageRanges:
        """Measurements of the whole image."""
        return self.frame.images[self.index]

    @cached_property
    def pixels(self) -> Int64[np.ndarray, " n"]:
        """Pixels of the points in the crop, in their order."""
        if self.crop_pixels is not None:
            return self.crop_pixels
        shift = self.frame.shifts[self.index] if self.frame.shifts else None
        return crop_image(
            self.sensor, self.measurement, Crop.of(self.area, self.height), shift=shift
        )[1]

    def sending(self, pixels: Int64[np.ndarray, " m"]) -> RangeImage:
        """Image with only some of the pixels."""
        sent = np.zeros(self.measurement.size, np.float32)
        sent[pixels] = self.measurement.ravel()[pixels]
        return RangeImage(
            self.sensor, sent.reshape(self.measurement.shape), self.frame.time, self.frame.index
        )

    def points(self, image: ImageRanges) -> Float32[np.ndarray, "n 3"]:
        """Points, world frame, that an image of this sensor measures."""
        xyz, valid = unproject(
            self.sensor, image, self.frame.shifts[self.index] if self.frame.shifts else None
        )
        points = np.ascontiguousarray(xyz[:, valid].T)
        return points if self.lift is None else self.lift(points)


@dataclass(frozen=True, eq=False)
class Boxes:
    """Detections, and when they are ready.

    sensor: index of the sensor whose points they were detected in, None for several."""

    detections: Detections
    ms: float
    sensor: int | None = None


_Arrived = TypeVar("_Arrived", Cloud, Boxes)


class Sent(NamedTuple, Generic[_Arrived]):
    """Points or detections that arrived at the centre, and their cost."""

    arrived: _Arrived
    bits: int


@dataclass(frozen=True)
class Fused:
    """Fused detections of a frame.

    bits: bits of each sensor, in the order named; ms: time from measurement to fused boxes."""

    detections: Detections
    bits: Int64[np.ndarray, " sensors"]
    ms: float = 0.0

    @property
    def kbit_per_sensor(self) -> float:
        """Mean kbit (1000 bit) over the sensors, 0 without any."""
        return float(self.bits.mean()) / 1000 if len(self.bits) else 0.0


@dataclass(frozen=True, eq=False)
class Images:
    """Images behind the points of sensors (index), and their empty scenes if known.

    time, number: time and number of the frame."""

    capture: Callable[[int], Captured] | None = None
    scene: Callable[[int], EmptyScene] | None = None
    time: float = 0.0
    number: int = 0


class View:
    """View of one frame.

    site: a site or an area; measure: returns the cropped points of a sensor (index); run: the
    detector, on the points of some clouds together; codec: codec of the messages; nms_iou: BEV IoU
    above which the less sure of two boxes of one label is dropped; images: images behind the
    points, None without; memory: passed from one frame's view to the next if frames are read in
    order."""

    def __init__(
        self,
        site: Area,
        sensors: tuple[Sensor, ...],
        *,
        measure: Callable[[int], Float32[np.ndarray, "n 3"]],
        run: Callable[[Sequence[Cloud]], Detections],
        codec: Codec = PAPER,
        nms_iou: float = NMS_IOU,
        images: Images | None = None,
        memory: LinkMemory | None = None,
    ) -> None:
        self._memory: LinkMemory = {} if memory is None else memory
        self.site = site
        self.sensors = sensors
        self.codec = codec
        self.nms_iou = nms_iou
        self._measure = measure
        self._run = run
        self._images = images or Images()
        self._captured: dict[int, Captured] = {}
        self._clouds: dict[tuple[int, tuple[str, ...]], Cloud] = {}
        self._detected: dict[tuple[int, tuple[str, ...]], Boxes] = {}
        self._sent_clouds: dict[Cloud | tuple[int, str], Sent[Cloud]] = {}
        self._sent_boxes: dict[Boxes, Sent[Boxes]] = {}

    def cloud(self, sensor: int) -> Cloud:
        """Points of a sensor in the site's area, world frame."""
        if (sensor, ()) not in self._clouds:
            start = perf_counter()
            self._clouds[sensor, ()] = Cloud(sensor, (), self._measure(sensor), _ms_since(start))
        return self._clouds[sensor, ()]

    def part(self, cloud: Cloud, name: str, keep: Keep) -> Cloud:
        """Keep the points of a cloud that `keep` selects."""
        key = cloud.sensor, (*cloud.history, name)
        if key not in self._clouds:
            start = perf_counter()
            selected = np.flatnonzero(keep(cloud.points, self.sensors[cloud.sensor]))
            rows = selected if cloud.rows is None else cloud.rows[selected]
            points = cloud.points[selected]
            self._clouds[key] = Cloud(*key, points, cloud.ms + _ms_since(start), rows)
        return self._clouds[key]

    def captured(self, sensor: int) -> Captured:
        """Image behind a sensor's points; ValueError without images."""
        if self._images.capture is None:
            raise ValueError(
                "this view has points alone, no images: choose a scheme and codec that work with "
                "points"
            )
        if sensor not in self._captured:
            self._captured[sensor] = self._images.capture(sensor)
        return self._captured[sensor]

    def scene(self, sensor: int) -> EmptyScene:
        """Empty scene of a sensor; ValueError if the view knows no scenes."""
        if self._images.scene is None:
            raise ValueError(
                "this view knows no empty scenes: pass some of toolkit.calibration.empty_scene"
            )
        return self._images.scene(sensor)

    def remember(self, sensor: int, name: str, begin: Callable[[], _Value]) -> _Value:
        """State of a sensor's link between frames, made by `begin` in the first frame.

        name: name of the link."""
        if (sensor, name) not in self._memory:
            self._memory[sensor, name] = begin()
        state: _Value = self._memory[sensor, name]
        return state

    def transmit(
        self, sensor: int, name: str, through: Callable[[], tuple[Float32[np.ndarray, "m 3"], int]]
    ) -> Sent[Cloud]:
        """Send an image of a sensor to the centre.

        through: returns the points that the centre gets and the bits that were sent; name: states
        everything that this depends on in addition to the measurement."""
        if (sensor, name) not in self._sent_clouds:
            measured = self.cloud(sensor)
            start = perf_counter()
            points, bits = through()
            self._sent_clouds[sensor, name] = Sent(
                Cloud(sensor, (name,), points, measured.ms + _ms_since(start)), bits
            )
        return self._sent_clouds[sensor, name]

    def detect(self, clouds: Sequence[Cloud]) -> Boxes:
        """Detect in the points of some clouds together."""
        key = (clouds[0].sensor, clouds[0].history) if len(clouds) == 1 else None
        if key in self._detected:
            return self._detected[key]
        start = perf_counter()
        sensor = clouds[0].sensor if len(clouds) == 1 else None
        boxes = Boxes(self._run(clouds), _last(clouds) + _ms_since(start), sensor)
        if key is not None:
            self._detected[key] = boxes
        return boxes

    def send_points(self, cloud: Cloud) -> Sent[Cloud]:
        """Send a cloud through the codec."""
        if cloud not in self._sent_clouds:
            start = perf_counter()
            if isinstance(self.codec, ImageCodec) and self._images.capture is not None:
                captured = self.captured(cloud.sensor)
                pixels = captured.pixels if cloud.rows is None else captured.pixels[cloud.rows]
                message = self.codec.encode_image(captured.sending(pixels))
                points = captured.points(self.codec.decode_image(message, captured.sensor))
            else:
                message = self.codec.encode_points(cloud.points)
                points = self.codec.decode_points(message)
            coded = () if points is cloud.points else (self.codec.digest,)
            arrived = Cloud(
                cloud.sensor, cloud.history + coded, points, cloud.ms + _ms_since(start)
            )
            self._sent_clouds[cloud] = Sent(arrived, message.bits)
        return self._sent_clouds[cloud]

    def send_boxes(self, boxes: Boxes) -> Sent[Boxes]:
        """Send a sensor's detections through the codec; ValueError for detections of several
        sensors."""
        if boxes.sensor is None:
            raise ValueError(
                "boxes are sent by the sensor that detected them, got those of several: send "
                "each alone"
            )
        if boxes not in self._sent_boxes:
            start = perf_counter()
            sensor = self.sensors[boxes.sensor]
            origin = Origin(sensor, self._images.time, self._images.number)
            message = self.codec.encode_boxes(boxes.detections, origin)
            arrived = Boxes(
                self.codec.decode_boxes(message, sensor), boxes.ms + _ms_since(start), boxes.sensor
            )
            self._sent_boxes[boxes] = Sent(arrived, message.bits)
        return self._sent_boxes[boxes]

    def share_points(
        self, sensors: Sequence[int], part: str = "", keep: Keep | None = None
    ) -> list[Sent[Cloud]]:
        """Send the cloud of each sensor, or only the points that `keep` selects."""
        clouds = [self.cloud(sensor) for sensor in sensors]
        return [
            self.send_points(cloud if keep is None else self.part(cloud, part, keep))
            for cloud in clouds
        ]

    def fuse_points(self, sent: Sequence[Sent[Cloud]]) -> Fused:
        """Detect in all points that arrive."""
        boxes = self.suppress([self.detect([message.arrived for message in sent])])
        return Fused(
            boxes.detections, np.array([message.bits for message in sent], np.int64), boxes.ms
        )

    def share_boxes(self, sensors: Sequence[int]) -> list[Sent[Boxes]]:
        """Send what is detected in the cloud of each sensor."""
        return [self.send_boxes(self.detect([self.cloud(sensor)])) for sensor in sensors]

    def suppress(self, inputs: Sequence[Boxes]) -> Boxes:
        """Pool all boxes, best first, without duplicates."""
        start = perf_counter()
        merged = suppress(Detections.merge([boxes.detections for boxes in inputs]), self.nms_iou)
        return Boxes(
            merged, _last(inputs) + _ms_since(start), inputs[0].sensor if len(inputs) == 1 else None
        )


def frame_view(
    frame: Frame,
    detector: Detector,
    site: Area,
    *,
    height: float | None = None,
    codec: Codec = PAPER,
    nms_iou: float = NMS_IOU,
    scene: Callable[[int], EmptyScene] | None = None,
    memory: LinkMemory | None = None,
) -> View:
    """Return the view of a frame, cropped to a site or area below a height (m).

    scene, memory: see `View`."""
    crop = Crop.of(site, height)
    detect = detector if crop.slope == LEVEL else partial(detect_on_ground, detector, place=site)
    images = Images(
        lambda sensor: Captured(frame, sensor, site, height), scene, _sent_time(frame), frame.index
    )
    view = partial(
        View, site, frame.sensors, codec=codec, nms_iou=nms_iou, images=images, memory=memory
    )
    return view(
        measure=lambda sensor: crop_sensor(frame, sensor, crop),
        run=lambda clouds: detect(together(clouds)),
    )


def together(clouds: Sequence[Cloud]) -> Float32[np.ndarray, "n 3"]:
    """Join the points of several clouds."""
    return np.concatenate([np.zeros((0, 3), np.float32), *(cloud.points for cloud in clouds)])


def suppress(detections: Detections, iou_threshold: float = NMS_IOU) -> Detections:
    """Drop detections that overlap a surer one of their label by more than a BEV IoU.

    They come back best first. Equal scores are settled by the boxes' numbers, so the order of the
    input makes no difference."""
    boxes = detections.boxes
    scores = detections.scores
    labels = detections.labels
    order = np.lexsort((labels, *boxes.T))
    return detections[order[nms(boxes[order], scores[order], iou_threshold, labels=labels[order])]]


def _last(sources: Sequence[Cloud] | Sequence[Boxes]) -> float:
    return max((source.ms for source in sources), default=0.0)


def _sent_time(frame: Frame) -> float:
    """Time of a frame in messages, 0 if unknown."""
    return frame.time if np.isfinite(frame.time) and frame.time >= 0 else 0.0


def _ms_since(start: float) -> float:
    return (perf_counter() - start) * 1e3


def stand_view(
    frame: Frame,
    detector: Detector,
    stand: Stand,
    *,
    codec: Codec = PAPER,
    nms_iou: float = NMS_IOU,
    scenes: Scenes | None = None,
    memory: LinkMemory | None = None,
) -> View:
    """Return the view of a frame on level ground, at its site or counted from the middle.

    With scenes, clouds are images too, so schemes that send pixels work as on simulated frames: a
    sensor has the points that its image shows, and the points that the centre restores are on the
    rays of its cells. memory: state of the links, from frame to frame."""
    if isinstance(stand.area, Site):
        return frame_view(
            frame, detector, stand.area, codec=codec, nms_iou=nms_iou, scene=scenes, memory=memory
        )
    lift = None if stand.ground is None else stand.ground.points
    middle_SE3_world = np.eye(4)
    middle_SE3_world[:2, 3] = -stand.middle

    @cache
    def show(k: int, scenes: Scenes) -> tuple[Float32[np.ndarray, "n 3"], Captured]:
        """Points in the crop that a cloud's image shows, with it."""
        cloud = frame.clouds[k]
        image = scenes.image(cloud)
        sensor = Sensor(cloud.name, image.grid.model, middle_SE3_world @ cloud.world_SE3_sensor)
        sensor_frame = Frame(
            (sensor,), (image.measurement,), Objects.empty(), _sent_time(frame), frame.index
        )
        level_points = stand.lift(cloud.in_world()[image.shown])
        is_kept = Crop.of(stand.area, CROP_HEIGHT_M).holds(level_points)
        return level_points[is_kept], Captured(
            sensor_frame, 0, stand.area, CROP_HEIGHT_M, image.cells[image.shown][is_kept], lift
        )

    def run(clouds: Sequence[Cloud]) -> Detections:
        points = together(clouds)
        return detector(points) if len(points) else Detections.empty()

    level_SE3_world = (
        middle_SE3_world
        if stand.ground is None
        else stand.ground.level_SE3_frame @ middle_SE3_world
    )
    models = [
        sensor.model if scenes is None else scenes.grid(sensor.name).model
        for sensor in frame.sensors
    ]
    placed = zip(frame.clouds, models, strict=True)
    sensors = tuple(
        Sensor(lidar.name, model, level_SE3_world @ lidar.world_SE3_sensor)
        for lidar, model in placed
    )
    view = partial(View, stand.area, sensors, run=run, codec=codec, nms_iou=nms_iou, memory=memory)
    images = Images(time=_sent_time(frame), number=frame.index)
    if scenes is None:
        return view(
            measure=lambda k: crop_points(stand.lift(frame.clouds[k].in_world()), stand.area),
            images=images,
        )
    images = replace(
        images,
        capture=lambda k: show(k, scenes)[1],
        scene=lambda k: scenes[frame.sensors[k].name].scene,
    )
    return view(measure=lambda k: show(k, scenes)[0], images=images)
