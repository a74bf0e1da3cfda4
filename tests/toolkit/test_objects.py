from typing import Any

import numpy as np
import pytest

from toolkit.objects import (
    CYCLIST,
    HEAVY,
    LABELS,
    Detections,
    Objects,
    check_known,
    known_labels,
    label_index,
)

CAR = np.array([[0.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]])
THREE = np.repeat(CAR, 3, axis=0) + np.arange(3)[:, None]


def test_a_label_is_found_by_name_or_number():
    assert [label_index(name) for name in LABELS] == [0, 1, 2, 3]
    assert [label_index(number) for number in range(4)] == [0, 1, 2, 3]
    for wrong in ("tram", -1, 4):
        with pytest.raises(ValueError, match="label must be one of"):
            label_index(wrong)


def test_labels_are_numbers_of_names():
    objects = Objects(THREE)
    assert objects.labels.tolist() == [0, 0, 0]
    assert objects.ids.tolist() == [0, 1, 2]
    assert Detections(THREE, np.ones(3)).labels.tolist() == [0, 0, 0]
    boxes = np.ones((2, 7))
    assert Objects(boxes, np.array(["cyclist", "heavy"], object)).labels.tolist() == [
        CYCLIST,
        HEAVY,
    ]
    assert Objects(boxes, np.array([1.0, 3.0])).labels.tolist() == [CYCLIST, HEAVY]
    for share in (1.5, np.nan):
        with pytest.raises(ValueError, match="whole numbers"):
            Objects(boxes, np.array([0.0, share]))


def test_detectors_say_which_classes_they_know():
    assert known_labels(lambda points: Detections.empty()) is None
    assert known_labels(Knows(("heavy", "vehicle"))) == ("vehicle", "heavy")
    assert known_labels(Knows([1, 1])) == ("cyclist",)
    check_known(Knows(("heavy", "vehicle")), ["heavy"])
    check_known(lambda points: Detections.empty(), ["heavy"])
    with pytest.raises(
        ValueError, match="the detector knows vehicle only, not heavy, cyclist: take one"
    ):
        check_known(Knows(("vehicle",)), ["heavy", "vehicle", "cyclist"])
    for labels in ("vehicle", 3, ["tram"]):
        with pytest.raises(
            ValueError, match=r"labels of a detector must be a list|label must be one of"
        ):
            known_labels(Knows(labels))


def test_rows_stay_together_in_order_and_cannot_be_changed():
    objects = Objects(THREE, np.array([0, CYCLIST, HEAVY]), np.array([7, 8, 9]))
    for rows in (np.array([2, 0]), np.array([True, False, True]), slice(0, 2)):
        part = objects[rows]
        np.testing.assert_array_equal(part.boxes, THREE[rows])
        np.testing.assert_array_equal(part.labels, objects.labels[rows])
        np.testing.assert_array_equal(part.ids, objects.ids[rows])
    detections = Detections(THREE, np.array([0.1, 0.2, 0.3]), np.array([0, 1, 2]))
    assert detections[np.array([1])].scores.tolist() == [0.2]
    assert len(detections[np.zeros(3, bool)]) == 0
    for nothing in (Objects.empty(), Detections.empty()):
        assert len(nothing) == 0
        assert nothing.boxes.shape == (0, 7)
        assert nothing.labels.shape == (0,)
    one, two = (Detections(CAR + k, np.array([float(k)]), np.array([k])) for k in (1, 2))
    merged = Detections.merge([two, Detections.empty(), one])
    assert merged.scores.tolist() == [2, 1]
    assert merged.labels.tolist() == [2, 1]
    assert len(Detections.merge([])) == 0
    fixed: Any = Objects(CAR)
    with pytest.raises(AttributeError):
        fixed.boxes = THREE


@pytest.mark.parametrize(
    "make",
    [
        *(lambda: Objects(np.zeros((2, 8))), lambda: Objects(CAR, np.array([0, 1]))),
        *(lambda: Objects(CAR, np.array([4])), lambda: Objects(CAR, ids=np.array([1, 2]))),
        lambda: Detections(CAR, np.ones(2)),
    ],
)
def test_what_does_not_fit_is_refused(make):
    with pytest.raises((ValueError, TypeError)):
        make()


class Knows:
    def __init__(self, labels):
        self.labels = labels

    def __call__(self, points):
        return Detections.empty()
