"""Bays stand on shoulders, at their angle, apart from each other and from what stands there already."""

from itertools import pairwise

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.street.bays import ANGLES, BAY, bays_between, forecourts, kerb_bays, outline, stations
from toolkit.sites.surroundings import Plot, Road

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
SHOULDER = rectangle(-80.0, -8.7, 80.0, -3.5)
LINE = np.array([[-80.0, -6.1], [80.0, -6.1]])  # middle of the shoulder, as its traffic goes
ROAD = Road(
    paths=[np.array([[-80.0, 0.0], [80.0, 0.0]])],
    half_widths=[(5.5, 10.7)],
    lanes=[rectangle(-80.0, -3.5, 80.0, 0.0), rectangle(-80.0, 0.0, 80.0, 3.5), SHOULDER],
    footways=[rectangle(-80.0, 3.5, 80.0, 5.5), rectangle(-80.0, -10.7, 80.0, -8.7)],
    shoulders=[SHOULDER],
)
DRIVEN = shapely.box(-80.0, -3.5, 80.0, 3.5)


def plot():
    return Plot(ROAD, shapely.box(*AREA).buffer(25.0, join_style="mitre"), [])


@pytest.mark.parametrize("angle", ANGLES)
def test_bays_are_headed_for_the_kerb_on_the_right_and_do_not_overlap(angle):
    rows = stations((LINE, ANGLES[angle]), angle, at_end=True)
    assert len(rows) > (10 if angle == 0 else 15)
    assert np.rad2deg(rows[:, 2]) == pytest.approx(-angle, abs=0.01)
    assert rows[:, 1] == pytest.approx(-6.1)
    assert rows[:, 0].max() < 80 - 6 - BAY[0] / 2 + 0.01, "clear of the junction at the end"
    assert rows[:, 0].min() > 80 - 76
    shapes = [outline(row[0], row[1], row[2], (BAY[0] - 0.2, BAY[1] - 0.2)) for row in rows]
    assert max(a.intersection(b).area for a, b in pairwise(shapes)) < 1e-6


@pytest.mark.parametrize("angle", ANGLES)
def test_bays_between_two_junctions_keep_clear_of_both(angle):
    line = shapely.LineString(LINE)
    right, left = bays_between(line, angle), bays_between(line, angle, kerb_left=True)
    assert np.abs(right[:, 0]).max() < 80 - 6 - BAY[0] / 2 + 0.01
    assert np.abs(right[:, 0]).max() > 60
    assert np.rad2deg(right[:, 2]) == pytest.approx(-angle, abs=0.01)
    assert np.rad2deg(left[:, 2]) == pytest.approx(angle, abs=0.01)
    assert len(bays_between(shapely.LineString([(0, 0), (15, 0)]), angle)) == 0


def test_the_junction_is_where_the_way_begins_for_edges_that_leave_it():
    rows = stations((LINE, 2.3), 0, at_end=False)
    assert -80 + 6 + BAY[0] / 2 - 0.01 < rows[:, 0].min() < rows[:, 0].max() < -80 + 76


def test_a_drawn_share_of_the_bays_is_claimed_and_repeats():
    counts = []
    for seed in range(12):
        ground = plot()
        bays = kerb_bays(ground, {"in0": (LINE, 5.2)}, {"in0": 90, "out7": 0}, np.random.default_rng(seed))
        again = kerb_bays(plot(), {"in0": (LINE, 5.2)}, {"in0": 90}, np.random.default_rng(seed))
        assert np.array_equal(bays, again)
        assert not ground.claim(outline(*bays[0]).buffer(-0.5), shoulder=True), "taken"
        counts.append(len(bays))
    assert 5 < min(counts) < 15
    assert 15 < max(counts) < 25


def test_forecourts_keep_off_the_street():
    for seed in range(6):
        bays = forecourts(plot(), np.random.default_rng(seed))
        assert all(outline(*bay).intersection(ROAD.surface).is_empty for bay in bays)
