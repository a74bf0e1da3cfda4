"""Levels at which one scheme overtakes another."""

import math

import numpy as np
import pytest

from examples.studies.stress.outputs import best_schemes, crossing_level, find_crossings
from examples.studies.stress.stressing import StressRow
from placement_env.analysis.intervals import Tally
from placement_env.report.content import Judgement

LEVELS = (0.0, 0.2, 0.4)


def row(scheme, amount, ap, *, kind="pose", iou=0.7, frames=8):
    """Of each frame of ten, so many tenths are found, in turn more and less of them."""
    found = [
        min(10, round(10 * ap) + (1 if k % 8 < 4 else -1) * (0 < ap < 1)) for k in range(frames)
    ]
    tally = Tally.of_frames(
        [np.full(n, 0.9) for n in found], [np.ones(n, bool) for n in found], [10] * frames
    )
    judged = Judgement(ap, ap, ap, ap, 1.0, 10 * frames, frames)
    return StressRow(
        kind, f"{amount}", scheme, "2 cm", judged, 1.0, 0.0, "vehicle", iou, amount, tally
    )


def rows(**schemes):
    return [
        row(name, x, ap)
        for name, each in schemes.items()
        for x, ap in zip(LEVELS, each, strict=True)
    ]


def test_a_lead_begins_where_it_last_comes_to_stay():
    levels = np.array([0.0, 0.2, 0.4])
    assert crossing_level(levels, np.array([-0.1, 0.1, 0.3])) == pytest.approx(0.1)
    assert crossing_level(levels, np.array([0.1, -0.1, 0.1])) == pytest.approx(
        0.3
    )  # the last time it comes to lead
    assert crossing_level(levels, np.array([0.1, 0.1, 0.1])) == 0
    assert crossing_level(levels, np.array([0.0, 0.1, 0.1])) == 0
    assert crossing_level(levels, np.array([-0.1, 0.2, 0.0])) == math.inf


def test_a_crossing_has_its_schemes_and_level():
    (found,) = find_crossings(rows(early=(0.9, 0.6, 0.2), late=(0.7, 0.6, 0.5)))
    assert (found.kind, found.iou, found.before, found.after) == ("pose", 0.7, "early", "late")
    assert found.level == pytest.approx(0.2)
    assert found.low == pytest.approx(0.2)  # both vary alike from draw to draw
    assert found.high == pytest.approx(0.2)
    assert found.share == 1


def test_no_scheme_overtakes_one_that_leads_throughout():
    assert find_crossings(rows(early=(0.9, 0.8, 0.7), late=(0.7, 0.7, 0.6))) == ()
    assert (
        find_crossings([each for each in rows(early=(0.9, 0.6, 0.2)) if each.amount is not None])
        == ()
    )


def test_draws_move_the_level_of_a_crossing():
    # 0.6 in every draw
    always = Tally.of_frames([np.full(6, 0.9)] * 8, [np.ones(6, bool)] * 8, [10] * 8)
    steady = [StressRow(**{**vars(row("late", x, 0.5)), "tally": always}) for x in LEVELS]
    varied = [row("early", x, ap) for x, ap in zip(LEVELS, (0.9, 0.7, 0.3), strict=True)]
    (found,) = find_crossings([*steady, *varied])
    assert found.low < 0.25 < found.high
    assert found.level == pytest.approx(0.3)
    assert found.low == pytest.approx(0.2)  # blocks of the lesser frames alone: 0.8, 0.6, 0.2
    assert found.high == pytest.approx(0.3)  # of the better ones: 1, 0.8, 0.4


def test_a_crossing_that_no_draw_has_is_kept():
    unsure = [row("late", x, ap) for x, ap in zip(LEVELS, (0.2, 0.2, 0.5), strict=True)]
    leading = [row("early", x, ap) for x, ap in zip(LEVELS, (1.0, 1.0, 0.0), strict=True)]
    # as good in every draw
    last = StressRow(**{**vars(leading[2]), "tally": row("early", 0.4, 0.5).tally})
    (found,) = find_crossings([*unsure, *leading[:2], last])  # the figure itself is never left out
    assert (found.low, found.high, found.share) == (found.level, math.inf, 0)


def test_the_best_scheme_has_its_range_of_levels():
    best = best_schemes(rows(early=(0.9, 0.6, 0.2), hybrid=(0.8, 0.7, 0.3), late=(0.6, 0.6, 0.5)))
    assert [(each.scheme, round(each.start, 3), round(each.end, 3)) for each in best] == [
        ("early", 0, 0.1),
        ("hybrid", 0.1, 0.267),
        ("late", 0.267, 0.4),
    ]
    assert best_schemes([row("early", None, 0.5), row("late", None, 0.5)]) == ()


def test_small_leads_do_not_count():
    assert find_crossings(rows(early=(1.0, 0.9, 0.5), late=(0.996, 0.9, 0.6))) == ()
    assert find_crossings(rows(early=(1.0, 0.9, 0.596), late=(0.9, 0.9, 0.6))) == ()
    assert len(find_crossings(rows(early=(1.0, 0.9, 0.594), late=(0.9, 0.9, 0.6)))) == 1
    best = best_schemes(rows(early=(0.9, 0.6, 0.2), foreground=(0.899, 0.604, 0.202)))
    assert [(each.scheme, each.start, each.end) for each in best] == [("early", 0, 0.4)]


def test_kinds_and_ious_are_apart():
    two = rows(early=(0.9, 0.6, 0.2), late=(0.7, 0.6, 0.5))
    strict = [StressRow(**{**vars(each), "iou": 0.9}) for each in two]
    other = [StressRow(**{**vars(each), "kind": "mounting"}) for each in two]
    assert [(each.kind, each.iou) for each in find_crossings([*two, *strict, *other])] == [
        ("mounting", 0.7),
        ("pose", 0.7),
        ("pose", 0.9),
    ]
