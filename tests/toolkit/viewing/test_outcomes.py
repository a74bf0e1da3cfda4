import numpy as np

from toolkit.datasets.sample import Rectangle, Sample, SensorCloud
from toolkit.detection.samples.detected import detect_samples
from toolkit.objects import Detections, Objects
from toolkit.viewing.outcomes import MARKED, outcomes_of

BOXES = np.array([[x, 0.0, 1.0, 4.0, 2.0, 2.0, 0.0] for x in (0.0, 10.0, 20.0, 30.0, 80.0)])
LABELS = np.array([0, 0, 0, 2, 0])


def detected(boxes, labels=None, complete=None, objects=None):
    """A sample of five objects, the third of them without points, in which these boxes are found."""
    points = np.array([[box[0], 0, 1] for k, box in enumerate(BOXES) if k != 2] * 3, np.float32)
    objects = Objects(BOXES, LABELS) if objects is None else objects
    area = {} if complete is None else {"complete": complete}
    sample = Sample("0", (SensorCloud("s", points, np.eye(4)),), objects, **area)
    labels = np.zeros(len(boxes), np.int64) if labels is None else labels
    found = Detections(boxes, np.linspace(0.9, 0.5, len(boxes)), labels)
    (each,) = detect_samples([sample], lambda points: found, levelling="none", middle=(0.0, 0.0))
    return each


def by_x(outcomes):
    return {name: {kind: boxes[:, 0].tolist() for kind, boxes in by.items()} for name, by in outcomes.items()}


def test_hits_misses_and_false_alarms_of_each_class():
    found = BOXES[[0, 0, 3, 1]] + np.array([[0.2, 0, 0, 0, 0, 0, 0], [0.9, 0, 0, 0, 0, 0, 0]] + [[0.0] * 7] * 2)
    outcomes = outcomes_of(detected(found, np.array([0, 0, 2, 2])), (50.0, 50.0))
    assert by_x(outcomes) == {
        "hits": {"vehicle": [0.2], "pedestrian": [30.0]},
        "missed": {"vehicle": [10.0]},
        "false alarms": {"vehicle": [0.9], "pedestrian": [10.0]},
    }


def test_the_iou_is_that_of_volumes_and_depends_on_the_class():
    lifted = BOXES[[0, 3]] + np.array([0, 0, 0.9, 0, 0, 0, 0])  # IoU 1.1 / 2.9 = 0.38
    outcomes = outcomes_of(detected(lifted, np.array([0, 2])), (50.0, 50.0))
    assert by_x(outcomes)["hits"] == {"pedestrian": [30.0]}
    assert by_x(outcomes)["false alarms"] == {"vehicle": [0.0]}


def test_what_cannot_be_judged_is_neither():
    """A label without points, one beyond the area, and what lies where labels are not complete."""
    outcomes = outcomes_of(detected(BOXES[[2, 4]]), (50.0, 50.0))
    assert by_x(outcomes) == {
        "hits": {}, "missed": {"vehicle": [0.0, 10.0], "pedestrian": [30.0]}, "false alarms": {},
    }  # fmt: skip
    near = outcomes_of(detected(BOXES[[1]] + 5.0, complete=Rectangle((-5.0, -5.0, 5.0, 5.0))), (50.0, 50.0))
    assert by_x(near) == {"hits": {}, "missed": {"vehicle": [0.0]}, "false alarms": {}}


def test_without_labels_nobody_knows():
    assert outcomes_of(detected(BOXES, objects=Objects.empty()), (50.0, 50.0)) == {}
    assert list(MARKED) == ["hits", "missed", "false alarms"]
