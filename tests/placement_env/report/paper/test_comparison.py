import csv
import json

import pytest

from placement_env.analysis.intervals import Interval
from placement_env.report.paper.comparison import Compared, Experiment

SAME = Compared(("early", "0,2,5"), "AP", 0.71, 0.70)
FAR = Compared(("late", "all"), "AP", 0.9, 0.8, Interval(0.85, 0.95), reason="few points, A")
NOT_COMPARED = Compared(("ours", "3"), "kbit", 516.25, None)


def experiment(rows):
    return Experiment("name", "Title", "table 1", ("scheme", "sensors"), rows, "2 frames", "So.", lambda out: None)


def test_difference_and_when_it_is_large():
    assert SAME.difference == pytest.approx(0.01)
    assert FAR.difference == pytest.approx(0.1)
    assert [each.large for each in (SAME, FAR, NOT_COMPARED)] == [False, True, False]
    assert NOT_COMPARED.difference is None
    assert Compared((), "AP", float("nan"), 0.5).difference is None
    assert not Compared((), "kbit", 500.0, 5.0).large
    assert Compared((), "AP", 0.6, 0.75).large
    assert Compared((), "AP", 0.75, 0.7).difference == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("relation", "ours", "difference"),
    [
        ("more than", 0.7, 0.0),
        ("more than", 0.5, -0.1),
        ("less than", 0.5, 0.0),
        ("less than", 0.7, 0.1),
        ("is", 0.7, 0.1),
    ],
)
def test_a_bound_that_is_kept_is_no_difference(relation, ours, difference):
    assert Compared((), "share", ours, 0.6, relation=relation).difference == pytest.approx(difference)


def test_cells():
    assert SAME.cells == ("early", "0,2,5", "AP", "0.7100", "–", "0.7000", "+0.0100", "")
    assert FAR.cells[3:] == ("0.9000", "0.8500–0.9500", "0.8000", "+0.1000", "few points, A")
    assert NOT_COMPARED.cells[2:] == ("kbit", "516.25", "–", "–", "–", "")
    assert Compared(("x",), "share", 0.7, 0.6, relation="more than").cells[4:6] == ("> 0.6000", "+0.0000")


def test_csv_has_all_figures_in_full():
    rows = list(csv.reader(experiment((SAME, FAR, NOT_COMPARED)).csv.splitlines()))
    assert rows[0] == ["scheme", "sensors", "unit", "ours", "low", "high", "paper", "difference", "reason"]
    assert rows[2][:7] == ["late", "all", "AP", "0.9", "0.85", "0.95", "0.8"]
    assert rows[2][8] == "few points, A"
    assert rows[3] == ["ours", "3", "kbit", "516.25", "", "", "", "", ""]


def test_as_dict_is_json():
    values = json.loads(json.dumps(experiment((SAME, FAR)).as_dict()))
    assert values["rows"][1]["interval"] == [0.85, 0.95]
    assert values["rows"][0] | {"difference": 0} == {
        "scheme": "early", "sensors": "0,2,5", "unit": "AP", "ours": 0.71, "interval": None, "paper": 0.7,
        "relation": "is", "difference": 0, "reason": "",
    }  # fmt: skip
