"""A sample as a fusion scheme sees it: a view of its clouds on level ground, sensor by sensor."""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.calibration.ground import Ground
from toolkit.datasets.sample import Sample
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.view import NMS_IOU, Cloud, View, together
from toolkit.objects import Detections, Detector
from toolkit.points import inside
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.spinning_lidar import SpinningLidar

CROP_HEIGHT = 4.0  # m, of the paper's crop


def sample_view(
    sample: Sample,
    detector: Detector,
    ground: Ground | None,
    middle: Float64[np.ndarray, "2"],
    area: Float64[np.ndarray, "4"],
    *,
    codec: Codec = PAPER,
    nms_iou: float = NMS_IOU,
) -> View:
    """The view of a sample's clouds, counted from the middle, on level ground, cropped to the area and below 4 m.

    Sensor k is that of cloud k, where it stands on that ground; what kind of sensor it is does not matter here.
    """
    lifted = np.eye(4) if ground is None else ground.level_SE3_frame
    shift = np.eye(4)
    shift[:2, 3] = -middle
    sensors = tuple(Sensor(c.name, SpinningLidar(), lifted @ shift @ c.world_SE3_sensor) for c in sample.clouds)

    def measure(k: int) -> Float32[np.ndarray, "n 3"]:
        points = sample.clouds[k].in_world() - [*middle, 0.0]
        upright = (points if ground is None or not len(points) else ground.points(points)).astype(np.float32)
        return upright[inside(upright, area, CROP_HEIGHT)]

    def run(clouds: list[Cloud]) -> Detections:
        points = together(clouds)
        return detector(points) if len(points) else Detections.empty()

    return View(area, sensors, measure=measure, run=run, codec=codec, nms_iou=nms_iou)  # type: ignore[arg-type]
