"""A cluster detector is learnt from empty scenes."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.place import Place
from toolkit.calibration.recording_scenes import Scenes
from toolkit.detection import cluster as clusters
from toolkit.detection.cluster import learn_cluster_detector
from toolkit.detection.detect import detect_frames
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import LABELS, Objects
from toolkit.sensors.models import RowLidar

MODEL = RowLidar(tuple(np.deg2rad(np.linspace(-4, -45, 40))), columns=720)
PLACES = {"a": pose(400.0, -9.0, 5.0, yaw=0.4), "b": pose(402.0, 10.0, 5.0, yaw=-2.0)}
CARS = np.array([[407.0, 1.0, 0.8, 4.2, 1.8, 1.5, 0.0], [395.0, 2.0, 0.8, 4.2, 1.8, 1.5, 1.57]])


def measured(place, boxes):
    """Range of each pixel to flat ground or the nearest box."""
    origin, rays = place[:3, 3], MODEL.rays().reshape(-1, 3).astype(np.float64) @ place[:3, :3].T
    best = -origin[2] / rays[:, 2]
    for box in boxes:
        box_SE3_world = np.linalg.inv(pose(*box[:3], yaw=box[6]))
        start, along = transform(box_SE3_world, origin[None])[0], rays @ box_SE3_world[:3, :3].T
        with np.errstate(divide="ignore"):
            ends = np.stack([(sign * box[3:6] / 2 - start) / along for sign in (-1, 1)])
        near, far = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        best = np.where((near < far) & (near > 0), np.minimum(best, near), best)
    return best.reshape(MODEL.shape).astype(np.float32)


def samples(count=6):
    """Two lidars; cars in the last sample only."""
    rng = np.random.default_rng(0)
    for k in range(count):
        boxes = CARS if k == count - 1 else CARS[:0]
        clouds = []
        for name, place in PLACES.items():
            image = measured(place, boxes)
            image += rng.normal(0, 0.01, image.shape).astype(np.float32)
            clouds.append(
                SensorCloud(name, (MODEL.rays() * image[..., None]).reshape(-1, 3), place)
            )
        yield Frame.of_clouds(str(k), tuple(clouds), Objects(boxes))


@pytest.fixture(scope="module")
def every():
    return list(samples())


def test_sweeps_of_an_empty_scene_by_hand():
    shape, model = (2, 500), RowLidar((0.0, -0.1), columns=500)

    def full(value):
        return np.full(shape, value, np.float32)

    scene = EmptyScene(
        "a", model, full(20.0), full(0.1), full(0.75), full(10.0), full(0.01), full(0.25), 8
    )
    points = clusters.draw_sweep(Scenes([], [scene]), "a", np.random.default_rng(0))
    ranges = np.linalg.norm(points, axis=1)
    near = ranges < 15
    assert len(points) == 1000
    assert 0.2 < near.mean() < 0.3
    assert ranges[near].std() == pytest.approx(0.01, rel=0.2)
    assert ranges[~near].std() == pytest.approx(0.1, rel=0.2)


def test_detectors_that_learnt_no_label_have_boxes_or_refuse(every):
    scenes = Scenes(every)
    x, y = Place().find_middle(every[0])
    place = Place("plane", True, (x - 20, y - 20, x + 20, y + 20))
    detector = learn_cluster_detector(scenes, every[0], place)
    found = list(detect_frames(every, detector, place))
    assert [len(each.detections) for each in found] == [0] * 5 + [2]
    assert detector.area == (-20, -20, 20, 20)
    assert detector.labels == LABELS
    assert replace(detector, area=None).digest in detector.digest
    boxes = found[-1].detections.boxes
    boxes = boxes[np.argsort(-boxes[:, 0])]
    np.testing.assert_allclose(boxes[:, :2], CARS[:, :2], atol=0.4)
    np.testing.assert_allclose(boxes[:, 3:6], CARS[:, 3:6], atol=0.5)
