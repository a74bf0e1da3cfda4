import re

import pytest

from placement_env.report.paper.reasons import CAUSES, RowEvidence, reason_of


@pytest.mark.parametrize("ours", [0.25, 0.3, 0.3499, float("nan")])
def test_a_small_difference_needs_no_reason(ours):
    assert reason_of(ours, 0.30, RowEvidence(0.5, 0.5)) == ""


def test_what_has_no_point_cannot_be_found():
    assert reason_of(0.2, 0.3, RowEvidence(0.21, 0.2)) == (
        "only 21.0 % of the vehicles have a point here: no detector reaches the paper's figure (C)"
    )


def test_above_the_paper_it_is_the_detector():
    assert reason_of(0.99, 0.71, RowEvidence(1.0, 0.985)) == (
        "100.0 % of the vehicles have a point here and 98.5 % of these are found; the paper's AP is 71.0 % (A)"
    )


def test_below_the_paper_with_points_enough_it_may_be_either():
    assert reason_of(0.5, 0.7, RowEvidence(0.8, 0.6)) == (
        "80.0 % of the vehicles have a point here and 75.0 % of these are found; the paper's AP is 70.0 % (A, C)"
    )


def test_at_greater_iou_it_is_the_fit_of_the_boxes():
    assert reason_of(0.8, 0.6, RowEvidence(1.0, 0.9, 0.93), iou=0.8) == (
        "90.0 % of the vehicles are found at this IoU, mean IoU of the hits 0.930 (B)"
    )
    assert reason_of(0.8, 0.6, RowEvidence(1.0, 0.9), iou=0.9) == "90.0 % of the vehicles are found at this IoU (B)"


def test_the_published_counting_comes_first_where_it_explains_most():
    mostly = reason_of(0.51, 0.07, RowEvidence(1.0, 0.64, 0.93, published=0.04), iou=0.9)
    assert mostly.startswith("by the published code's counting ours is 0.0400 (D); 64.0 %")
    little = reason_of(0.98, 0.81, RowEvidence(1.0, 0.99, 0.93, published=0.96))
    assert little.endswith("(A); by the published code's counting ours is 0.9600 (D)")


def test_nothing_is_divided_by_nothing_and_shares_end_at_one():
    assert "0.0 % of the vehicles have a point here" in reason_of(0.0, 0.3, RowEvidence(0.0, 0.0))
    assert "and 100.0 % of these are found" in reason_of(0.4, 0.3, RowEvidence(0.33, 0.34))


def test_every_letter_is_explained():
    reasons = [
        reason_of(ours, paper, RowEvidence(0.9, 0.8, 0.9, 0.5), iou=iou)
        for ours in (0.1, 0.9) for paper in (0.3, 0.6, 0.95) for iou in (0.7, 0.9)
    ]  # fmt: skip
    assert set(re.findall(r"[(, ]([A-Z])(?=[,)])", " ".join(reasons))) == set(CAUSES)
