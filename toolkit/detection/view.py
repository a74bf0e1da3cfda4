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

from toolkit.arrays import Float32, ImageRanges, Int64, Mask, Pose
from toolkit.boxes import nms
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.place import CROP_HEIGHT_M, Stand, crop_points
from toolkit.calibration.recording_scenes import Scenes
from toolkit.detection.codec import PAPER, Codec, ImageCodec
from toolkit.detection.messages import Origin, RangeImage
from toolkit.frame import Frame, unproject
from toolkit.geometry import LEVEL
from toolkit.objects import Detections, Detector, Objects
from toolkit.points import Area, Crop, crop_image, crop_sensor, detect_on_ground
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

NMS_IOU = 0.1  # BEV IoU above which the less sure of two boxes of one label is dropped
LinkMemory = dict[tuple[int, str], Any]  # state of links between frames, by sensor (index) and name
_Value = TypeVar("_Value")
# Puts points (m) of a frame's world on level ground.
Lift = Callable[[Float32[np.ndarray, "n 3"]], Float32[np.ndarray, "n 3"]]
# Returns the mask of the points (world frame, m) of a sensor that are kept.
Keep = Callable[[Float32[np.ndarray, "n 3"], Sensor], Mask]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of one sensor of a view.

    Attributes:
        sensor: index of the sensor in the view.
        history: names of the steps that the sensor's cropped points went through, () for the
            cropped points as measured; clouds of one sensor and frame with equal histories hold the
            same points.
        points: x, y and z (m, world frame) of each point.
        ms: milliseconds after the measurement at which the points are ready.
        rows: row of each point among the sensor's cropped points, None if all are here in their
            order, or if the points arrived over a link.
    """

    sensor: int
    history: tuple[str, ...]
    points: Float32[np.ndarray, "n 3"]
    ms: float
    rows: Int64[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class Captured:
    """Range image in which a sensor's points were measured, with the crop that selects them.

    Attributes:
        frame: frame that holds the image.
        index: index of the sensor and its image in the frame.
        area: detection area, a site or xmin, ymin, xmax, ymax (m).
        height: height below which points are kept (m), None for the area's default.
        crop_pixels: flat index (row by row) of each cropped point's pixel, in the order of the
            points; None if `pixels` has to find them.
        lift: transform of points of the frame's world that was applied before the crop, such as
            putting them on level ground; None if there was none.
    """

    frame: Frame
    index: int
    area: Area
    height: float | None = None
    crop_pixels: Int64[np.ndarray, " n"] | None = None
    lift: Lift | None = None

    @property
    def sensor(self) -> Sensor:
        """Sensor of the image, at the pose that the centre assumes."""
        return self.frame.sensors[self.index]

    @property
    def measurement(self) -> ImageRanges:
        """Measurement of every pixel (m), inside the crop and outside."""
        return self.frame.images[self.index]

    @cached_property
    def pixels(self) -> Int64[np.ndarray, " n"]:
        """Flat index (row by row) of each cropped point's pixel, in the order of the points."""
        if self.crop_pixels is not None:
            return self.crop_pixels
        # distances (m) of the points from their pixels' rays, if the frame has any
        shift = self.frame.shifts[self.index] if self.frame.shifts else None
        crop = Crop.from_place(self.area, self.height)
        _, pixels = crop_image(self.sensor, self.measurement, crop, shift=shift)
        return pixels

    def sending(self, pixels: Int64[np.ndarray, " m"]) -> RangeImage:
        """Return a range image to send: the measurements of some pixels, 0 in all others.

        pixels: flat indices (row by row) of the pixels to keep."""
        sent_ranges = np.zeros(self.measurement.size, np.float32)
        sent_ranges[pixels] = self.measurement.ravel()[pixels]
        return RangeImage(
            self.sensor,
            measurement=sent_ranges.reshape(self.measurement.shape),
            time=self.frame.time,
            number=self.frame.index,
        )

    def points(self, image: ImageRanges) -> Float32[np.ndarray, "n 3"]:
        """Convert an image of this sensor to points, lifted like the measured points.

        image: measurements (m), such as restored by the centre; pixels without a return give no
        point. The points (m) are in row order of their pixels."""
        # distances (m) of the points from their pixels' rays, if the frame has any
        shift = self.frame.shifts[self.index] if self.frame.shifts else None
        # xyz: (3, rows, columns); is_valid: pixels (rows, columns) that have a point
        xyz, is_valid = unproject(self.sensor, image, shift)
        points = np.ascontiguousarray(xyz[:, is_valid].T)
        return points if self.lift is None else self.lift(points)


@dataclass(frozen=True, eq=False)
class Boxes:
    """Detections, with the time at which they are ready.

    ms: milliseconds after the measurement; sensor: index of the sensor in whose points the boxes
    were detected, None if they come from the points of several sensors."""

    detections: Detections
    ms: float
    sensor: int | None = None


_Arrived = TypeVar("_Arrived", Cloud, Boxes)


class Sent(NamedTuple, Generic[_Arrived]):
    """Cloud or boxes as decoded at the centre, and the bits of their message."""

    arrived: _Arrived
    bits: int


@dataclass(frozen=True)
class Fused:
    """Fused detections of a frame, with what they cost.

    bits: bits that each sensor sent, in the order in which the caller named the sensors; ms:
    milliseconds from the measurement to the fused boxes."""

    detections: Detections
    bits: Int64[np.ndarray, " sensors"]
    ms: float = 0.0

    @property
    def kbit_per_sensor(self) -> float:
        """Mean kbit (1000 bits) that a sensor sent, 0 without sensors."""
        return float(self.bits.mean()) / 1000 if len(self.bits) else 0.0


@dataclass(frozen=True, eq=False)
class Images:
    """Access to the images behind a view's points, and to the sensors' empty scenes.

    capture: returns a sensor's image by the sensor's index, None if the points have no image;
    scene: returns a sensor's empty scene by index, None if scenes are unknown; time, number: time
    (s) and number of the frame, written into messages."""

    capture: Callable[[int], Captured] | None = None
    scene: Callable[[int], EmptyScene] | None = None
    time: float = 0.0
    number: int = 0


class View:
    """View of one frame: clouds, messages and detections, each computed once and kept.

    site: a site or an area (xmin, ymin, xmax, ymax, m); sensors: sensors of the frame, which all
    methods name by their index here; measure: returns the cropped points of a sensor, given its
    index; run: detects in the points of the given clouds, joined; codec: codec of the messages;
    nms_iou: BEV IoU above which the less sure of two boxes of one label is dropped; images: images
    behind the points, None without; memory: state of the links, passed from one frame's view to the
    next if frames are read in order and changed in place, None for a fresh one."""

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
        """View a frame in which nothing is computed yet, see the class for the fields.

        measure: returns the cloud of a sensor by its index; run: detects in clouds; images: images
        behind the points, None without; memory: state of the links, None for a fresh one."""
        self._memory: LinkMemory = {} if memory is None else memory
        self.site = site
        self.sensors = sensors
        self.codec = codec
        self.nms_iou = nms_iou
        self._measure = measure
        self._run = run
        self._images = images or Images()
        # Results by (sensor, history), except messages: by the cloud or boxes sent, or by (sensor,
        # name) in `transmit`. Clouds and boxes are compared by identity.
        self._captured: dict[int, Captured] = {}
        self._clouds: dict[tuple[int, tuple[str, ...]], Cloud] = {}
        self._detected: dict[tuple[int, tuple[str, ...]], Boxes] = {}
        self._sent_clouds: dict[Cloud | tuple[int, str], Sent[Cloud]] = {}
        self._sent_boxes: dict[Boxes, Sent[Boxes]] = {}

    def cloud(self, sensor: int) -> Cloud:
        """Cropped points of a sensor (index), measured at the first call."""
        key = sensor, ()  # no step was applied to the points yet
        if key not in self._clouds:
            start = perf_counter()
            points = self._measure(sensor)
            self._clouds[key] = Cloud(sensor, history=(), points=points, ms=_ms_since(start))
        return self._clouds[key]

    def part(self, cloud: Cloud, name: str, keep: Keep) -> Cloud:
        """Return the points of a cloud that `keep` selects.

        name: name of the selection. The result is cached by it, so one name must always mean one
        selection; keep: returns the mask of the points to keep, given points and sensor. The time
        `ms` at which the points are ready is the cloud's plus the time that the selection takes."""
        sensor = cloud.sensor  # an index
        history = (*cloud.history, name)
        if (sensor, history) not in self._clouds:
            start = perf_counter()
            kept_rows = np.flatnonzero(keep(cloud.points, self.sensors[sensor]))
            # rows among all cropped points of the sensor
            rows = kept_rows if cloud.rows is None else cloud.rows[kept_rows]
            points = cloud.points[kept_rows]
            ms = cloud.ms + _ms_since(start)
            self._clouds[sensor, history] = Cloud(sensor, history, points, ms=ms, rows=rows)
        return self._clouds[sensor, history]

    def captured(self, sensor: int) -> Captured:
        """Image behind a sensor's points, by the sensor's index.

        Raises ValueError if the view has no images."""
        if self._images.capture is None:
            raise ValueError(
                "this view has points alone, no images: choose a scheme and codec that work with "
                "points"
            )
        if sensor not in self._captured:
            self._captured[sensor] = self._images.capture(sensor)
        return self._captured[sensor]

    def scene(self, sensor: int) -> EmptyScene:
        """Empty scene of a sensor (its image without objects), by the sensor's index.

        Raises ValueError if the view knows no scenes."""
        if self._images.scene is None:
            raise ValueError(
                "this view knows no empty scenes: pass some of toolkit.calibration.empty_scene"
            )
        return self._images.scene(sensor)

    def remember(self, sensor: int, name: str, begin: Callable[[], _Value]) -> _Value:
        """Return the state of a sensor's link, kept from frame to frame in the view's memory.

        sensor: index of the sensor; name: name of the link, such as a scheme's digest; begin: makes
        the state if the memory has none yet. The caller changes the state in place."""
        if (sensor, name) not in self._memory:
            self._memory[sensor, name] = begin()
        state: _Value = self._memory[sensor, name]
        return state

    def transmit(
        self, sensor: int, name: str, through: Callable[[], tuple[Float32[np.ndarray, "m 3"], int]]
    ) -> Sent[Cloud]:
        """Return a sensor's points as they arrive over a link that the caller provides.

        sensor: index of the sensor; name: states everything except the measurement that the message
        depends on, as the result is cached by it; through: encodes, decodes and returns the points
        (world frame, m) that the centre gets and the bits that were sent."""
        if (sensor, name) not in self._sent_clouds:
            measured_cloud = self.cloud(sensor)
            start = perf_counter()
            points, bits = through()
            ms = measured_cloud.ms + _ms_since(start)
            arrived_cloud = Cloud(sensor, history=(name,), points=points, ms=ms)
            self._sent_clouds[sensor, name] = Sent(arrived_cloud, bits)
        return self._sent_clouds[sensor, name]

    def detect(self, clouds: Sequence[Cloud]) -> Boxes:
        """Detect in the joined points of one or more clouds.

        Boxes are ready (`ms`) after the last of the clouds plus the time that detection takes.
        Boxes of a single cloud are cached; boxes of several are not, and have no sensor."""
        start = perf_counter()
        if len(clouds) != 1:
            return Boxes(self._run(clouds), ms=_last_ms(clouds) + _ms_since(start))
        (cloud,) = clouds
        key = cloud.sensor, cloud.history
        if key not in self._detected:
            detections = self._run(clouds)
            ms = cloud.ms + _ms_since(start)
            self._detected[key] = Boxes(detections, ms=ms, sensor=cloud.sensor)
        return self._detected[key]

    def send_points(self, cloud: Cloud) -> Sent[Cloud]:
        """Send a cloud through the codec: as pixels of its image if possible, else as points.

        Returns the points that the centre decodes, and the bits of the message. They are ready
        (`ms`) after the cloud plus the time that coding takes. The result is cached."""
        if cloud not in self._sent_clouds:
            start = perf_counter()
            if isinstance(self.codec, ImageCodec) and self._images.capture is not None:
                captured = self.captured(cloud.sensor)
                pixels = captured.pixels if cloud.rows is None else captured.pixels[cloud.rows]
                message = self.codec.encode_image(captured.sending(pixels))
                decoded_image = self.codec.decode_image(message, captured.sensor)
                points = captured.points(decoded_image)
            else:
                message = self.codec.encode_points(cloud.points)
                points = self.codec.decode_points(message)
            # A lossless codec returns the very array: the history stays, so detections are shared.
            is_lossless = points is cloud.points
            history = cloud.history if is_lossless else (*cloud.history, self.codec.digest)
            ms = cloud.ms + _ms_since(start)
            arrived_cloud = Cloud(cloud.sensor, history=history, points=points, ms=ms)
            self._sent_clouds[cloud] = Sent(arrived_cloud, message.bits)
        return self._sent_clouds[cloud]

    def send_boxes(self, boxes: Boxes) -> Sent[Boxes]:
        """Send a sensor's detections through the codec.

        Returns the boxes that the centre decodes, and the bits of the message. They are ready
        (`ms`) after the detections plus the time that coding takes. The result is cached. Raises
        ValueError for boxes detected in the points of several sensors."""
        if boxes.sensor is None:
            raise ValueError(
                "boxes are sent by the sensor that detected them, got those of several: send "
                "each alone"
            )
        if boxes not in self._sent_boxes:
            start = perf_counter()
            sensor = self.sensors[boxes.sensor]
            origin = Origin(sensor, time=self._images.time, number=self._images.number)
            message = self.codec.encode_boxes(boxes.detections, origin)
            detections = self.codec.decode_boxes(message, sensor)
            ms = boxes.ms + _ms_since(start)
            arrived_boxes = Boxes(detections, ms=ms, sensor=boxes.sensor)
            self._sent_boxes[boxes] = Sent(arrived_boxes, message.bits)
        return self._sent_boxes[boxes]

    def share_points(
        self, sensors: Sequence[int], part: str = "", keep: Keep | None = None
    ) -> list[Sent[Cloud]]:
        """Send the cloud of each sensor (index), or only the points that `keep` selects.

        part: name of the selection, by which its points are cached; keep: returns the mask of the
        points to send, given a cloud's points and its sensor, None to send all points. Messages
        come back in the order of the sensors."""
        clouds = [self.cloud(sensor) for sensor in sensors]
        return [
            self.send_points(cloud if keep is None else self.part(cloud, part, keep))
            for cloud in clouds
        ]

    def fuse_points(self, sent: Sequence[Sent[Cloud]]) -> Fused:
        """Detect in all points that arrived, joined, and drop duplicate boxes.

        sent: message of each sensor, in the order of the bits in the result."""
        boxes = self.suppress([self.detect([message.arrived for message in sent])])
        bits = np.array([message.bits for message in sent], np.int64)
        return Fused(boxes.detections, bits=bits, ms=boxes.ms)

    def share_boxes(self, sensors: Sequence[int]) -> list[Sent[Boxes]]:
        """Send the boxes detected in the cloud of each sensor (index), in that order."""
        return [self.send_boxes(self.detect([self.cloud(sensor)])) for sensor in sensors]

    def suppress(self, inputs: Sequence[Boxes]) -> Boxes:
        """Pool boxes, drop duplicates and sort the rest, best score first.

        They are ready after the last of the inputs plus the time that pooling takes."""
        start = perf_counter()
        merged_detections = Detections.merge([boxes.detections for boxes in inputs])
        detections = suppress(merged_detections, self.nms_iou)
        sensor = inputs[0].sensor if len(inputs) == 1 else None  # None for several sensors
        return Boxes(detections, ms=_last_ms(inputs) + _ms_since(start), sensor=sensor)


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
    """Return the view of a frame that has images, cropped to a site or area.

    height: height below which points are kept (m), None for the site's or area's default; scene:
    returns a sensor's empty scene by index, None if unknown; memory: state of the links, see
    `View`. On sloping ground, the detector works on levelled points and its boxes are tilted
    back."""
    crop = Crop.from_place(site, height)
    detect = detector if crop.slope == LEVEL else partial(detect_on_ground, detector, place=site)
    images = Images(
        capture=lambda sensor: Captured(frame, index=sensor, area=site, height=height),
        scene=scene,
        time=_sent_time(frame),
        number=frame.index,
    )
    return View(
        site,
        frame.sensors,
        measure=lambda sensor: crop_sensor(frame, sensor, crop),
        run=lambda clouds: detect(together(clouds)),
        codec=codec,
        nms_iou=nms_iou,
        images=images,
        memory=memory,
    )


def together(clouds: Sequence[Cloud]) -> Float32[np.ndarray, "n 3"]:
    """Join the points of several clouds into one (n, 3) array, empty without clouds."""
    # the empty array, because no clouds cannot be concatenated
    return np.concatenate([np.zeros((0, 3), np.float32), *(cloud.points for cloud in clouds)])


def suppress(detections: Detections, iou_threshold: float = NMS_IOU) -> Detections:
    """Drop detections that overlap a surer detection of the same label.

    iou_threshold: BEV IoU above which the less sure is dropped. The rest come back best first.
    Equal scores are ordered by the values of box and label, so that the order of the input makes no
    difference."""
    # sorted by values first: nms keeps this order among equal scores
    ordered_detections = detections[np.lexsort((detections.labels, *detections.boxes.T))]
    kept_rows = nms(
        ordered_detections.boxes,
        ordered_detections.scores,
        iou_threshold,
        labels=ordered_detections.labels,
    )
    return ordered_detections[kept_rows]


def _last_ms(sources: Sequence[Cloud] | Sequence[Boxes]) -> float:
    """Time (ms) at which the last source is ready, 0 without sources."""
    return max((source.ms for source in sources), default=0.0)


def _sent_time(frame: Frame) -> float:
    """Time of a frame (s) as written into messages, 0 if it is unknown or negative."""
    return frame.time if np.isfinite(frame.time) and frame.time >= 0 else 0.0


def _ms_since(start: float) -> float:
    """Milliseconds since `start`, a value of perf_counter (s)."""
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
    """Return the view of a frame on level ground, at its site or counted from the area's middle.

    stand: area and ground of the frame. At a site, this is `frame_view`; elsewhere, points and
    boxes are in m from the middle of the area, above level ground. scenes: empty scenes of the
    sensors, None to send clouds as points. With scenes, clouds are images too, so that schemes that
    send pixels work as on simulated frames: a sensor has the points that its image shows, and the
    points that the centre restores are on the rays of its cells. memory: state of the links,
    changed in place from frame to frame."""
    if isinstance(stand.area, Site):
        return frame_view(
            frame, detector, stand.area, codec=codec, nms_iou=nms_iou, scene=scenes, memory=memory
        )

    def run(clouds: Sequence[Cloud]) -> Detections:
        """Detect in the joined points of some clouds."""
        points = together(clouds)
        return detector(points) if len(points) else Detections.empty()

    sensors = _level_sensors(frame, stand, scenes)
    view = partial(View, stand.area, sensors, run=run, codec=codec, nms_iou=nms_iou, memory=memory)
    images = Images(time=_sent_time(frame), number=frame.index)
    if scenes is None:
        return view(
            measure=lambda k: crop_points(stand.lift(frame.clouds[k].in_world()), stand.area),
            images=images,
        )
    show = cache(partial(_show_cloud, frame, stand, scenes))
    images = replace(
        images,
        capture=lambda k: show(k).captured,
        scene=lambda k: scenes[frame.sensors[k].name].scene,
    )
    return view(measure=lambda k: show(k).points, images=images)


def _middle_SE3_world(stand: Stand) -> Pose:
    """Motion from the world frame to the frame that is counted from the middle of the area."""
    middle_SE3_world = np.eye(4)
    middle_SE3_world[:2, 3] = -stand.middle
    return middle_SE3_world


def _level_sensors(frame: Frame, stand: Stand, scenes: Scenes | None) -> tuple[Sensor, ...]:
    """Sensors of a frame of clouds, at their poses above level ground.

    stand: area and ground of the frame; positions are counted from the area's middle. scenes: give
    the sensors' rows and columns, None to keep the models of the frame."""
    level_SE3_world = _middle_SE3_world(stand)
    if stand.ground is not None:
        level_SE3_world = stand.ground.level_SE3_frame @ level_SE3_world
    sensors = []
    for cloud, sensor in zip(frame.clouds, frame.sensors, strict=True):
        model = sensor.model if scenes is None else scenes.grid(sensor.name).model
        sensors.append(Sensor(cloud.name, model, level_SE3_world @ cloud.world_SE3_sensor))
    return tuple(sensors)


class _ShownCloud(NamedTuple):
    """Cropped points of a cloud that its image shows, and the image.

    points: x, y and z (m) from the middle of the area, on level ground."""

    points: Float32[np.ndarray, "n 3"]
    captured: Captured


def _show_cloud(frame: Frame, stand: Stand, scenes: Scenes, cloud_index: int) -> _ShownCloud:
    """Return the cropped points of one cloud of a frame, and their image.

    stand: area and ground of the frame; scenes: give the sensors' rows and columns. Only points
    that the image of the cloud shows are kept."""
    cloud = frame.clouds[cloud_index]
    image = scenes.image(cloud)
    middle_SE3_sensor = _middle_SE3_world(stand) @ cloud.world_SE3_sensor
    sensor = Sensor(cloud.name, image.grid.model, middle_SE3_sensor)
    # a frame with this sensor and its image only, so the sensor has index 0
    sensor_frame = Frame(
        sensors=(sensor,),
        measurements=(image.measurement,),
        objects=Objects.empty(),
        time=_sent_time(frame),
        index=frame.index,
    )
    level_points = stand.lift(cloud.in_world()[image.shown])
    is_kept = Crop.from_place(stand.area, CROP_HEIGHT_M).holds(level_points)
    captured = Captured(
        sensor_frame,
        index=0,
        area=stand.area,
        height=CROP_HEIGHT_M,
        crop_pixels=image.cells[image.shown][is_kept],
        lift=None if stand.ground is None else stand.ground.points,
    )
    return _ShownCloud(level_points[is_kept], captured)
