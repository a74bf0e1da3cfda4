"""Two samples of two lidars near a car, a pedestrian and a trailer that is none of our classes."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.frame import Frame, OtherObjects, SensorCloud
from toolkit.objects import Detections, Objects

CAR = [12.0, 3.0, 0.75, 4.2, 1.8, 1.5, 0.3]


@pytest.fixture(scope="session")
def samples():
    """The first lidar has times and intensities; the second is in the second sample alone."""
    rng = np.random.default_rng(0)
    poses = [np.eye(4), np.eye(4)]
    poses[0][:3, 3], poses[1][:3, 3] = (0, 0, 5), (20, 10, 5)
    ground = np.column_stack([rng.uniform(-30, 30, (400, 2)), rng.normal(-5, 0.01, 400)]).astype(
        np.float32
    )
    north = SensorCloud(
        "north",
        ground,
        poses[0],
        time=np.linspace(0, 0.1, 400),
        intensity=np.arange(400, dtype=np.float32),
    )
    south = SensorCloud("south", ground[:100] + np.float32(0), poses[1])
    objects = Objects(
        np.array([CAR, [5.0, -4.0, 0.9, 0.6, 0.6, 1.8, 0.0]]), np.array(["vehicle", "pedestrian"])
    )
    others = OtherObjects(np.array([[-8.0, 2, 1.5, 9, 2.5, 3, 0]]), ("TRAILER",))
    first = Frame.of_clouds("first", (north,), objects, others=others, time=0.0)
    return [
        first,
        replace(first.with_clouds((north, south)), name="second", objects=objects[:1], time=0.1),
    ]


@pytest.fixture(scope="session")
def finds_the_car():
    return lambda points: Detections(np.array([CAR]) - [0, 0, 0, 0, 0, 0, 0.1], np.array([0.9]))


@pytest.fixture(scope="session")
def touched(samples):
    """The first sample with points on the car and on the pedestrian, of a third lidar."""
    first = samples[0]
    on_boxes = np.concatenate([first.objects.boxes[:, :3]] * 4).astype(np.float32)
    return first.with_clouds((*first.clouds, SensorCloud("near", on_boxes, np.eye(4))))
