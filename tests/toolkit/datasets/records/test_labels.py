import numpy as np
import pytest

from toolkit.datasets.records.labels import CATEGORIES, labelled, no_labels, track_number

BOX = [1.0, 2, 3, 4, 2, 1.5, 0.5]


def made(*rows, names=None, **more):
    problems = {}
    found = labelled(np.array(rows, np.float64), names or ["car"] * len(rows), None, problems, **more)
    return found, problems


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        (0, np.nan, "labels with NaN or infinite numbers"),
        (6, np.inf, "labels with NaN or infinite numbers"),
        (4, 0.0, "boxes of no size"),
        (5, -1.0, "boxes of no size"),
        (3, 1001.0, "boxes too large or too far away to be"),
        (1, 1.1e6, "boxes too large or too far away to be"),
    ],
)
def test_what_cannot_be_is_counted(column, value, problem):
    wrong = list(BOX)
    wrong[column] = value
    found, problems = made(BOX, wrong)
    assert len(found.objects) == 1
    assert problems == {problem: 1}


def test_doubled_labels():
    twin = [BOX[0] + 0.0009, *BOX[1:]]
    apart = [BOX[0] + 0.0011, *BOX[1:]]
    found, problems = made(BOX, twin, apart, BOX, names=["car", "car", "car", "bus"])
    assert found.objects.labels.tolist() == [0, 0, 3]
    assert problems == {"doubled labels": 1}


def test_other_kinds_stay_with_their_counts():
    found, problems = made(BOX, BOX, names=["Traffic Cone", "PEDESTRIAN"], counts=[3, 8])
    assert found.objects.labels.tolist() == [2]
    assert found.counts.tolist() == [8]
    assert found.others.categories == ("Traffic Cone",)
    assert found.others.counts.tolist() == [3]
    assert problems == {"labels of other kinds than ours": 1}


def test_a_count_that_is_missing_leaves_none():
    assert made(BOX, [0, *BOX[1:]], counts=[3, -1])[0].counts is None
    assert no_labels().counts is None


def test_yaw_is_brought_to_half_a_turn():
    found, _ = made([*BOX[:6], 7.0])
    assert found.objects.boxes[0, 6] == pytest.approx(7 - 2 * np.pi)


def test_track_ids_are_numbers_the_same_everywhere():
    assert track_number(" 17 ") == 17
    assert track_number("-3") == -3
    assert track_number("b1d0-44") == track_number("b1d0-44") != track_number("b1d0-45")
    assert track_number("9" * 30) >= 0
    assert track_number("²") > 3


@pytest.mark.parametrize(("name", "label"), [("car", 0), ("van", 0), ("bus", 3), ("cyclist", 1), ("person_sitting", 2)])
def test_kinds(name, label):
    assert CATEGORIES[name] == label
