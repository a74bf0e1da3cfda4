import numpy as np
import pytest

from placement_env.cases import Cases, iou_text
from placement_env.classes import Classes
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import POOR, TYPICAL


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"failing": 3}, "failing must be 0 to 2 sensors, got 3"),
        ({"failing": True}, "failing must be 0 to 2 sensors, got True"),
        ({"failures": "median"}, "failures must be one of mean, worst, got 'median'"),
        ({"levels": 5}, "traffic has 1 to 4 levels, got 5"),
        (
            {"errors": ("poor", "paper", "poor")},
            "different ones, got poor, paper, poor: name each once",
        ),
        (
            {"errors": ("typical", ErrorProfile("ours", TYPICAL.terms))},
            "different ones, got typical, ours",
        ),
        *(
            ({"errors": ()}, "different ones, got none"),
            ({"errors": "fog"}, "unknown error profile 'fog'"),
        ),
        *(
            ({"iou": 1.5}, "iou must lie in"),
            ({"iou": (0.5, 0.5)}, "one or several different ones"),
        ),
        *(({"iou": ()}, "one or several different ones"), ({"iou": "0.9:0.5"}, "iou must lie in")),
        ({"iou": "half"}, "as 0.7 or 0.5:0.95, got half"),
    ],
)
def test_fields_are_checked(fields, message):
    with pytest.raises(ValueError, match=message):
        Cases(**fields)


def test_equal_cases_are_equal_however_they_are_written():
    assert Cases(iou=(0.7,), errors=["poor"]) == Cases(iou="0.7", errors=POOR)
    assert Cases(errors=POOR).profiles == (POOR,)
    assert hash(Cases(iou=[0.9, 0.5])) == hash(Cases(iou=(0.5, 0.9)))
    assert len(Cases(iou="0.5:0.95").ious) == 10


def test_the_origin_states_what_is_not_usual():
    assert Cases().origin == {"iou": 0.7}
    assert Cases(iou=(0.5, 0.7), failing=1, levels=2, levels_by="mean").origin == {
        "iou": [0.5, 0.7],
        "failing": {"sensors": 1, "combine": "worst"},
        "levels": {"count": 2, "combine": "mean"},
    }
    assert Cases(errors="poor").errors_origin == POOR.origin
    assert Cases(errors=("poor", "typical")).errors_origin == {
        "profiles": [POOR.origin, TYPICAL.origin],
        "combine": "worst",
    }


def test_several_thresholds_are_named_and_classes_may_have_others():
    assert [iou_text(each) for each in (0.7, (0.5, 0.6))] == [
        "0.7",
        "0.5 to 0.6 (mean of 2 thresholds)",
    ]
    assert Cases(iou=(0.6, 0.7)).class_ious(Classes(("vehicle", "cyclist")), "cyclist") == 0.5


def test_failures_leave_each_set_without_each_sensor():
    rows, owners = Cases(failing=1).expand(np.array([[1, 1, 0], [0, 0, 1]], bool))
    assert rows.astype(int).tolist() == [[1, 1, 0], [0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0]]
    assert owners.tolist() == [0, 1, 0, 0, 1]
    sets = np.eye(3, dtype=bool)
    assert np.array_equal(Cases().expand(sets)[0], sets)
    assert len(Cases(failing=2).expand(np.ones((1, 4), bool))[0]) == 7


@pytest.mark.parametrize(("failures", "left"), [("worst", 0.2), ("mean", 0.3)])
def test_what_failures_leave(failures, left):
    cases = Cases(failing=1, failures=failures)
    figures, owners = np.array([0.9, 0.2, 0.4]), np.array([0, 0, 0])
    assert cases.over_failures(figures, owners, tie=0) == pytest.approx([left])
    assert cases.over_failures(figures, owners) == pytest.approx([left + 0.9e-6], abs=1e-12)
    assert cases.over_failures(np.zeros((0, 5)), np.zeros(0, int)).shape == (0, 5)


def test_levels_axes_and_shares_are_reduced():
    figures = np.array([[0.4, np.nan, np.nan], [0.6, 0.5, np.nan]])
    assert Cases(levels=2).over_levels(figures) == pytest.approx([0.4, 0.5, np.nan], nan_ok=True)
    assert Cases(levels=2, levels_by="mean").over_levels(figures) == pytest.approx(
        [0.5, 0.5, np.nan], nan_ok=True
    )
    assert [len(part) for part in Cases(levels=4).split(np.arange(9))] == [3, 2, 2, 2]
    assert len(Cases(levels=4).split(np.arange(2))) == 2
    # of 2 sets, of 1 and of 2 sensors, and 4 classes
    figures = np.random.default_rng(0).random((3, 2, 5, 4))
    owners = np.array([0, 1, 0, 1, 1])
    found = Cases(iou=(0.5, 0.7), failing=1, levels=3).at_profile(figures, owners)
    by_hand = figures.mean(axis=1).min(axis=0)
    by_hand = np.stack([by_hand[2], by_hand[3:].min(axis=0)]) + 1e-6 * by_hand[:2]
    assert found == pytest.approx(by_hand, abs=1e-12)
    ap = np.array([[0.3, 0.5], [0.4, 0.2]])
    assert Cases(errors=("paper", "poor")).shares(ap).tolist() == [[1, 0], [0, 1]]
    assert Cases(errors=("paper", "poor"), errors_by="mean").shares(ap).tolist() == [
        [0.5, 0.5],
        [0.5, 0.5],
    ]
