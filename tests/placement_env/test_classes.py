"""`Classes`: what is refused, and figures of several classes as one, against plain sums."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from placement_env.classes import SMALL_IOU, Classes, find_classes
from placement_env.defaults import VEHICLES
from toolkit.objects import LABELS

THREE = ("vehicle", "cyclist", "pedestrian")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"names": ()}, "classes must be one or several different ones"),
        ({"names": "vehicle"}, "classes must be one or several different ones"),
        ({"names": ("vehicle", "vehicle")}, "classes must be one or several different ones"),
        (
            {"names": ("tram",)},
            "there is no class 'tram', it counts as heavy: choose among vehicle, cyclist",
        ),
        (
            {"names": THREE, "weights": (1.0, 1.0)},
            "a weight above 0 for each of vehicle, cyclist, pedestrian",
        ),
        ({"names": THREE, "weights": (1.0, 1.0, 0.0)}, "leave out a class that does not count"),
        ({"names": THREE, "weights": (1.0, 1.0, -1.0)}, "a weight above 0"),
        ({"names": THREE, "weights": (1.0, 1.0, float("nan"))}, "a weight above 0"),
        ({"names": THREE, "weights": (1.0, 1.0, float("inf"))}, "a weight above 0"),
        ({"names": THREE, "combine": "best"}, "combine must be one of mean, worst, got 'best'"),
        (
            {"names": THREE, "weights": (1.0, 2.0, 1.0), "combine": "worst"},
            "the worst class takes no weights",
        ),
        ({"names": THREE, "ious": (0.5,)}, "an IoU for each of"),
        ({"names": THREE, "ious": (None, 0.5, 1.5)}, "iou must lie in"),
        (
            {"names": THREE, "ious": (0.7, None, None)},
            "the IoU of vehicles is that of the objective",
        ),
    ],
)
def test_what_is_refused(arguments, message):
    with pytest.raises((ValueError, TypeError), match=rf"{message}|Type-check"):
        Classes(**arguments)


def test_equal_classes_are_equal_in_any_order():
    one = Classes(("pedestrian", "vehicle"), (2.0, 6.0), ious=(0.25, None))
    other = Classes(("vehicle", "pedestrian"), (0.75, 0.25), ious=(None, 0.25))
    assert one == other
    assert one.digest == other.digest
    assert one.weights == (0.75, 0.25)
    assert one.labels == (0, 2)


def test_different_classes_have_different_digests():
    made = [
        VEHICLES,
        Classes(("heavy",)),
        Classes(THREE),
        Classes(THREE, combine="worst"),
        Classes(THREE, (1.0, 1.0, 2.0)),
        Classes(THREE, ious=(None, None, 0.25)),
    ]
    assert len({each.digest for each in made}) == len(made)


def test_a_class_has_the_iou_of_the_objective_its_usual_or_a_given_one():
    classes = Classes(LABELS, ious=(None, None, 0.25, None))
    assert [classes.get_iou(name, 0.8) for name in LABELS] == [0.8, SMALL_IOU, 0.25, 0.8]
    assert Classes(LABELS, ious=(None, None, None, 0.5)).get_iou("heavy", 0.8) == 0.5


def test_classes_are_found_by_their_names():
    assert find_classes("cyclist") == Classes(("cyclist",))
    assert find_classes(["vehicle", "heavy"]) == Classes(("vehicle", "heavy"))
    assert find_classes(VEHICLES) is VEHICLES
    with pytest.raises(
        (ValueError, TypeError), match=r"classes must be Classes or names|Type-check"
    ):
        find_classes(3)


def test_one_class_is_its_figure_and_weights_add_up_to_one():
    figures = np.random.default_rng(0).random((5, 1))
    np.testing.assert_array_equal(VEHICLES.combined(figures), figures[:, 0])
    assert np.isnan(VEHICLES.combined(np.array([[np.nan]])))[0]
    assert Classes(THREE, (1.0, 1.0, 7.0)).combined(np.ones((1, 3)))[0] == 1.0


def test_classes_are_described_with_weights_and_ious():
    assert VEHICLES.described(0.7) == VEHICLES.described() == "vehicle"
    assert Classes(THREE, combine="worst").described() == "worst of vehicle, cyclist and pedestrian"
    assert (
        Classes(THREE).described(0.7)
        == "mean of vehicle, cyclist (IoU 0.5) and pedestrian (IoU 0.5)"
    )
    assert (
        Classes(("vehicle", "heavy"), (1.0, 3.0)).described(0.7)
        == "mean of 0.25 vehicle and 0.75 heavy"
    )


@given(
    st.lists(
        st.lists(st.one_of(st.floats(0, 1), st.just(float("nan"))), min_size=3, max_size=3),
        min_size=1,
    ),
    st.tuples(*[st.floats(0.1, 5)] * 3),
)
def test_mean_and_worst_are_over_the_classes_that_are_there(rows, weights):
    figures = np.array(rows)
    mean, worst = (
        Classes(THREE, weights).combined(figures),
        Classes(THREE, combine="worst").combined(figures),
    )
    for row, of_mean, of_worst in zip(rows, mean, worst, strict=True):
        there = [
            (weight, value) for weight, value in zip(weights, row, strict=True) if value == value
        ]
        if not there:
            assert np.isnan(of_mean)
            assert np.isnan(of_worst)
            continue
        assert of_mean == pytest.approx(
            sum(w * v for w, v in there) / sum(w for w, _ in there), abs=1e-12
        )
        assert of_worst == min(value for _, value in there)
        assert of_worst <= of_mean + 1e-12
