"""Road works stay within their strip and off the lanes that are driven."""

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.street.works import barrier, beacon, concrete, cone, fence, lane_works, verge_works
from toolkit.sites.surroundings import LANE_CLEARANCE, Plot, Road

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

WINDOW = shapely.box(*AREA).buffer(25.0, join_style="mitre")


def works(seed, line=LINE, edge="in0"):
    plot = Plot(ROAD, WINDOW, [])
    lane_works(plot, {edge: (line, 3.4)}, np.random.default_rng(seed))
    return plot.solids


@pytest.mark.parametrize("edge", ["in0", "out0"])
def test_a_closed_lane_is_fenced_off_and_nothing_of_it_is_in_the_way(edge):
    found = set()
    for seed in range(15):
        solids = works(seed, edge=edge)
        shapes = [shapely.Polygon(s.footprint) for s in solids]
        assert min(shape.distance(DRIVEN) for shape in shapes) >= LANE_CLEARANCE
        x = np.concatenate([s.footprint[:, 0] for s in solids])
        assert (x.min() > 80 - 56) if edge == "in0" else (x.max() < -80 + 56), "near the junction"
        assert sum(s.kind in ("cone", "barrier", "fence") for s in solids) > 5
        found |= {s.kind for s in solids}
        assert [s.top for s in solids] == [s.top for s in works(seed, edge=edge)]
    assert {"cone", "barrier", "fence", "container", "machine", "heap"} <= found


def test_a_strip_too_short_for_works_has_none():
    assert works(0, line=np.array([[0.0, -6.1], [12.0, -6.1]])) == []


def test_works_beside_the_street_keep_off_it():
    number = 0
    for seed in range(8):
        plot = Plot(ROAD, WINDOW, [])
        verge_works(plot, np.random.default_rng(seed))
        assert not any(shapely.Polygon(s.footprint).intersects(ROAD.surface) for s in plot.solids)
        number += len(plot.solids) > 0
    assert number >= 4


@pytest.mark.parametrize(
    ("make", "kind", "top"),
    [
        (cone, "cone", (0.5, 1.0)),
        (beacon, "cone", (1.0, 1.3)),
        (concrete, "barrier", (0.75, 0.95)),
        (fence, "fence", (1.2, 2.0)),
    ],
)
def test_what_closes_a_lane_has_its_usual_size(make, kind, top):
    for seed in range(5):
        solids = make(np.random.default_rng(seed))
        assert {s.kind for s in solids} == {kind}
        assert min(s.base for s in solids) == 0
        assert top[0] - 0.01 <= max(s.top for s in solids) <= top[1] + 0.01


def test_a_barrier_is_as_long_as_asked_and_stands():
    solids = barrier(2.5, np.random.default_rng(0))
    assert np.ptp(np.concatenate([s.footprint for s in solids])[:, 0]) == pytest.approx(2.5)
    assert min(s.base for s in solids) == 0
    assert 0.9 <= max(s.top for s in solids) <= 1.2
