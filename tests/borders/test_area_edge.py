"""Objects at the edge of the detection area: found on whichever side of it the detection's centre
is."""

from pathlib import Path

import numpy as np
import pytest

from toolkit.calibration.place import Place
from toolkit.datasets.layouts.folder import write_folder
from toolkit.datasets.recordings import open_recording
from toolkit.detection.comparison import Comparison
from toolkit.detection.detect import FrameDetections
from toolkit.detection.evaluation import evaluate_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import VEHICLE, Detections, Objects
from toolkit.viewing.outcomes import sort_outcomes

CAR_M = (4.2, 1.8, 1.5)
EDGE_M = 40.0


def car_boxes(places):
    return np.array([[x, 0.0, 0.75, *CAR_M, 0.0] for x in places]).reshape(-1, 7)


class FixedDetector:
    """Detector that reports the same cars in every cloud, in the frame of the area's middle."""

    labels = ("vehicle",)
    digest = "fixed"

    def __init__(self, places, scores):
        self.detections = Detections(
            car_boxes(places), np.array(scores), np.full(len(places), VEHICLE)
        )

    def __call__(self, points):
        return self.detections


@pytest.fixture
def record(tmp_path: Path):
    def write(places):
        points = np.concatenate([np.tile([x, 0.0, 0.5], (50, 1)) for x in (*places, -10.0)])
        cloud = SensorCloud("lidar1", points.astype(np.float32), np.eye(4))
        write_folder([Frame.of_clouds("0", (cloud,), Objects(car_boxes(places)))], tmp_path / "own")
        return open_recording(tmp_path / "own")

    return write


AREA = Place(level="none", area=(-EDGE_M, -EDGE_M, EDGE_M, EDGE_M))
THREE_IOUS = (0.7, 0.8, 0.9)


def score(recording, places, scores):
    asked = Comparison(schemes=(None,), classes=("vehicle",), iou_thresholds=THREE_IOUS)
    return evaluate_recording(recording, FixedDetector(places, scores), asked, place=AREA)


@pytest.mark.parametrize(("labelled", "detected"), [(39.98, 40.02), (40.02, 39.98), (39.98, 39.98)])
def test_border_object_is_no_miss_and_no_false_alarm(record, labelled, detected):
    """IoU is (4.2 - .04) / (4.2 + .04) = .98. A second car keeps AP defined where the first is not
    to be found."""
    found = score(record([labelled, 0.0]), [detected, 0.0], [0.9, 0.8])
    assert [row.ap for row in found] == [1.0, 1.0, 1.0]
    assert [row.false_alarms_per_frame for row in found] == [0.0, 0.0, 0.0]
    assert found[0].truths == (2 if labelled < EDGE_M else 1)
    aps = [row.ap for row in found.breakdown if row.among == "all" and row.truths]
    assert aps == pytest.approx(np.ones(len(aps)))


def test_detection_outside_is_no_false_alarm_whatever_it_overlaps(record):
    """One hits nothing, one overlaps the car at the edge by too little (IoU (4.2 - 1.5) / (4.2 +
    1.5) = .47)."""
    found = score(record([39.5, 0.0]), [45.0, 41.0, 39.5, 0.0], [0.95, 0.93, 0.9, 0.8])
    assert [row.ap for row in found] == [1.0, 1.0, 1.0]
    assert {figures.precision for figures in found.classes} == {1.0}


def test_viewer_marks_a_car_at_the_edge_as_hit(record):
    recording = record([39.98, 0.0])
    frame = recording[0]
    ((_, stand),) = AREA.stands([frame])
    detections = Detections(car_boxes([40.02, 45.0]), np.array([0.9, 0.8]), np.full(2, VEHICLE))
    outcomes = sort_outcomes(FrameDetections(frame, detections, stand, 0.0))
    assert outcomes["hits"]["vehicle"].boxes[:, 0].tolist() == [40.02]
    assert outcomes["ignored"]["vehicle"].boxes[:, 0].tolist() == [45.0]
    assert outcomes["missed"]["vehicle"].boxes[:, 0].tolist() == [0.0]
