"""Figures beside the paper's, and reasons for differences."""

import csv
import itertools
import json
import re

import pytest

from examples.studies.paper.comparison import Compared, Experiment, RowEvidence, explain_difference
from examples.studies.paper.paper_tables import CAUSES
from placement_env.analysis.intervals import Interval

SAME = Compared(("early", "0,2,5"), "AP", 0.71, 0.70)
FAR = Compared(("late", "all"), "AP", 0.9, 0.8, Interval(0.85, 0.95), reason="few points, A")
NOT_COMPARED = Compared(("ours", "3"), "kbit", 516.25, None)


def experiment(rows):
    return Experiment(
        "name", "Title", "table 1", ("scheme", "sensors"), rows, "2 frames", "So.", lambda out: None
    )


def test_differences_are_large_beyond_a_bound():
    assert SAME.difference == pytest.approx(0.01)
    assert FAR.difference == pytest.approx(0.1)
    assert [each.large for each in (SAME, FAR, NOT_COMPARED)] == [False, True, False]
    assert NOT_COMPARED.difference is None
    assert Compared((), "AP", float("nan"), 0.5).difference is None
    assert not Compared((), "kbit", 500.0, 5.0).large
    assert Compared((), "AP", 0.6, 0.75).large
    assert Compared((), "AP", 0.75, 0.7).difference == pytest.approx(0.05)


def test_reasons_name_every_cause():
    cases = itertools.product((0.1, 0.9), (0.3, 0.6, 0.95), (0.7, 0.9))
    evidence = RowEvidence(0.9, 0.8, 0.9, 0.5)
    reasons = [explain_difference(ours, paper, evidence, iou=iou) for ours, paper, iou in cases]
    assert set(re.findall(r"[(, ]([A-Z])(?=[,)])", " ".join(reasons))) == set(CAUSES)


def test_rows_have_their_cells():
    assert SAME.cells == ("early", "0,2,5", "AP", "0.7100", "–", "0.7000", "+0.0100", "")
    assert FAR.cells[3:] == ("0.9000", "0.8500–0.9500", "0.8000", "+0.1000", "few points, A")
    assert NOT_COMPARED.cells[2:] == ("kbit", "516.25", "–", "–", "–", "")
    assert Compared(("x",), "share", 0.7, 0.6, relation="more than").cells[4:6] == (
        "> 0.6000",
        "+0.0000",
    )


def test_csv_has_unrounded_figures():
    rows = list(csv.reader(experiment((SAME, FAR, NOT_COMPARED)).csv.splitlines()))
    assert rows[0] == [
        "scheme",
        "sensors",
        "unit",
        "ours",
        "low",
        "high",
        "paper",
        "difference",
        "reason",
    ]
    assert rows[2][:7] == ["late", "all", "AP", "0.9", "0.85", "0.95", "0.8"]
    assert rows[2][8] == "few points, A"
    assert rows[3] == ["ours", "3", "kbit", "516.25", "", "", "", "", ""]


def test_json_has_the_rows():
    values = json.loads(json.dumps(experiment((SAME, FAR)).as_dict()))
    assert values["rows"][1]["interval"] == [0.85, 0.95]
    assert values["rows"][0] | {"difference": 0} == {
        "scheme": "early",
        "sensors": "0,2,5",
        "unit": "AP",
        "ours": 0.71,
        "interval": None,
        "paper": 0.7,
        "relation": "is",
        "difference": 0,
        "reason": "",
    }


@pytest.mark.parametrize(
    ("relation", "ours", "difference"),
    [
        *(
            ("more than", 0.7, 0.0),
            ("more than", 0.5, -0.1),
            ("less than", 0.5, 0.0),
            ("less than", 0.7, 0.1),
        ),
        ("is", 0.7, 0.1),
    ],
)
def test_a_bound_that_is_kept_is_no_difference(relation, ours, difference):
    assert Compared((), "share", ours, 0.6, relation=relation).difference == pytest.approx(
        difference
    )


@pytest.mark.parametrize("ours", [0.25, 0.3, 0.3499, float("nan")])
def test_a_small_difference_needs_no_reason(ours):
    assert explain_difference(ours, 0.30, RowEvidence(0.5, 0.5)) == ""


def test_causes_of_differences_are_named():
    assert explain_difference(0.2, 0.3, RowEvidence(0.21, 0.2)) == (
        "only 21.0 % of the vehicles have a point here: no detector can reach the paper's figure "
        "(C)"
    )
    assert explain_difference(0.99, 0.71, RowEvidence(1.0, 0.985)) == (
        "100.0 % of the vehicles have a point here and 98.5 % of these are found; the paper's AP "
        "is 71.0 % (A)"
    )
    assert explain_difference(0.5, 0.7, RowEvidence(0.8, 0.6)) == (
        "80.0 % of the vehicles have a point here and 75.0 % of these are found; the paper's AP "
        "is 70.0 % (A, C)"
    )
    assert explain_difference(0.8, 0.6, RowEvidence(1.0, 0.9, 0.93), iou=0.8) == (
        "90.0 % of the vehicles are found at this IoU, mean IoU of the hits 0.930 (B)"
    )
    assert (
        explain_difference(0.8, 0.6, RowEvidence(1.0, 0.9), iou=0.9)
        == "90.0 % of the vehicles are found at this IoU (B)"
    )
    mostly = explain_difference(0.51, 0.07, RowEvidence(1.0, 0.64, 0.93, published=0.04), iou=0.9)
    assert mostly.startswith("by the published code's counting ours is 0.0400 (D); 64.0 %")
    little = explain_difference(0.98, 0.81, RowEvidence(1.0, 0.99, 0.93, published=0.96))
    assert little.endswith("(A); by the published code's counting ours is 0.9600 (D)")
    assert "0.0 % of the vehicles have a point here" in explain_difference(
        0.0, 0.3, RowEvidence(0.0, 0.0)
    )
    assert "and 100.0 % of these are found" in explain_difference(0.4, 0.3, RowEvidence(0.33, 0.34))
