"""A sample as a fusion scheme sees it: a view of its clouds on level ground, sensor by sensor.

With empty scenes of its sensors the view has images too, so that schemes which send pixels work as on simulated frames.
A sensor then has the points that its image shows, where they were measured; what the centre makes of a message lies
along the rays of its cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.calibration.ground import Ground
from toolkit.calibration.samples.sample_scenes import SampleScenes
from toolkit.datasets.sample import Sample
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.samples.imaged import ImagedClouds
from toolkit.detection.view import NMS_IOU, Cloud, LinkMemory, View, together
from toolkit.objects import Detections, Detector
from toolkit.points import inside
from toolkit.sensors.model import SensorModel
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
    scenes: SampleScenes | None = None,
    number: int = 0,
    memory: LinkMemory | None = None,
) -> View:
    """The view of a sample's clouds, counted from the middle, on level ground, cropped to the area and below 4 m.

    Sensor k is that of cloud k, where it stands on that ground; what kind of sensor it is does not matter here unless
    there are scenes. number: of the sample, for messages to say; memory: of links, from sample to sample of the same
    sensors.
    """
    lifted = np.eye(4) if ground is None else ground.level_SE3_frame
    shift = np.eye(4)
    shift[:2, 3] = -middle

    def points(k: int) -> Float32[np.ndarray, "n 3"]:
        points = sample.clouds[k].in_world() - [*middle, 0.0]
        upright = (points if ground is None or not len(points) else ground.points(points)).astype(np.float32)
        return upright[inside(upright, area, CROP_HEIGHT)]

    def run(clouds: Sequence[Cloud]) -> Detections:
        points = together(clouds)
        return detector(points) if len(points) else Detections.empty()

    given: dict[str, Any] = {"measure": points}
    models: list[SensorModel] = [SpinningLidar() for _ in sample.clouds]
    if scenes is not None:
        imaged = ImagedClouds(sample, scenes, ground, middle, area, height=CROP_HEIGHT, number=number)
        given = {"measure": imaged.measure, "capture": imaged.capture, "scene": imaged.scene}
        models = [imaged.model(k) for k in range(len(sample.clouds))]
    sensors = tuple(
        Sensor(cloud.name, model, lifted @ shift @ cloud.world_SE3_sensor)
        for cloud, model in zip(sample.clouds, models, strict=True)
    )
    return View(area, sensors, run=run, codec=codec, nms_iou=nms_iou, memory=memory, **given)
