"""`ImagedClouds`: the clouds of a sample as the images that they are in the grids of their sensors, on level ground."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.ground import Ground
from toolkit.calibration.samples.sample_scenes import SampleScenes
from toolkit.datasets.sample import Sample
from toolkit.detection.view import Captured
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.points import inside
from toolkit.sensors.model import SensorModel
from toolkit.sensors.sensor import Sensor


class ImagedClouds:
    """What a `toolkit.detection.view.View` asks of a sample with images, cloud by cloud (index), each made once.

    ground, middle, area, height: as of `toolkit.detection.samples.views.sample_view`; number: of the sample.
    """

    def __init__(
        self,
        sample: Sample,
        scenes: SampleScenes,
        ground: Ground | None,
        middle: Float64[np.ndarray, "2"],
        area: Float64[np.ndarray, "4"],
        *,
        height: float,
        number: int = 0,
    ) -> None:
        self.sample, self.scenes, self.middle, self.area = sample, scenes, middle, area
        self.height, self.number = height, number
        self._lift = None if ground is None else ground.points
        self._made = lru_cache(maxsize=None)(self._make)

    def model(self, k: int) -> SensorModel:
        """Of the sensor."""
        return self.scenes[self.sample.clouds[k].name].grid.model

    def measure(self, k: int) -> Float32[np.ndarray, "n 3"]:
        """The points in the crop that the image shows, where they were measured."""
        return self._made(k)[0]

    def capture(self, k: int) -> Captured:
        """The image."""
        return self._made(k)[1]

    def scene(self, k: int) -> EmptyScene:
        """Of the sensor."""
        return self.scenes[self.sample.clouds[k].name].scene

    def _make(self, k: int) -> tuple[Float32[np.ndarray, "n 3"], Captured]:
        cloud = self.sample.clouds[k]
        image = self.scenes.image(cloud)
        shift = np.eye(4)
        shift[:2, 3] = -self.middle
        sensor = Sensor(cloud.name, image.grid.model, shift @ cloud.world_SE3_sensor)
        known = np.isfinite(self.sample.time) and self.sample.time >= 0
        time = self.sample.time if known else 0.0
        frame = Frame((sensor,), (image.measurement,), Objects.empty(), time, self.number)
        points = (cloud.in_world() - [*self.middle, 0.0])[image.shown]
        lifted = points if self._lift is None or not len(points) else self._lift(points)
        upright = lifted.astype(np.float32)
        kept = inside(upright, self.area, self.height)
        cells = image.cells[image.shown][kept]
        return upright[kept], Captured(frame, 0, self.area, self.height, cells, self._lift)
