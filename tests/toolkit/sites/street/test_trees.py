"""Crowns hang over the road, from 2.5 m up; trunks do not; neither is near a mount or in a house."""

import numpy as np
import pytest
import shapely

from toolkit.sites.furniture import rectangle
from toolkit.sites.site import Mount, Solid
from toolkit.sites.street.trees import OVER_ROAD, UNDERSIDE, avenues, clumps, plant
from toolkit.sites.surroundings import Plot, Road, along

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
MOUNT = Mount("pole", np.array([3.0, 4.3, 0.0]))
KERB = along(ROAD.carriageway.buffer(0.8).boundary.intersection(WINDOW), 0.5)


def avenue(seed):
    plot = Plot(ROAD, WINDOW, [MOUNT])
    avenues(plot, KERB, np.random.default_rng(seed))
    return plot.solids


def test_avenues_hang_over_the_road_and_what_drives_passes_below():
    seen = 0
    for seed in range(12):
        solids = avenue(seed)
        crowns = [s for s in solids if s.kind == "tree"]
        trunks = [shapely.Polygon(s.footprint) for s in solids if s.kind == "trunk"]
        assert not any(trunk.intersects(ROAD.carriageway) for trunk in trunks)
        assert all(UNDERSIDE[0] - 0.01 <= s.base < s.top <= UNDERSIDE[1] + 7.3 for s in crowns)
        hung = [s for s in crowns if shapely.Polygon(s.footprint).intersects(DRIVEN)]
        seen += len(hung) > 10
        near = [shapely.Polygon(s.footprint).distance(shapely.Point(3.0, 4.3)) for s in crowns]
        assert min(near, default=1.0) > 0.99
        assert [len(s.footprint) for s in solids] == [len(s.footprint) for s in avenue(seed)]
    assert 4 <= seen <= 11


def test_no_kerb_no_avenue():
    plot = Plot(ROAD, WINDOW, [])
    avenues(plot, np.zeros((0, 3)), np.random.default_rng(0))
    assert plot.solids == []


def test_a_crown_is_clumps_within_its_radius_and_levels_with_gaps():
    for seed in range(10):
        made = clumps(5.0, -2.0, OVER_ROAD[1] / 2, (3.0, 7.0), np.random.default_rng(seed))
        assert 3 <= len(made) <= 8
        reach = max(np.hypot(*(s.footprint - [5.0, -2.0]).T).max() for s in made)
        assert 3.0 < reach < 4.51
        assert min(s.base for s in made) == 3.0
        assert max(s.top for s in made) == 7.0


def test_crowns_are_narrower_beside_houses_and_not_planted_in_them():
    rng, plot = np.random.default_rng(0), Plot(ROAD, WINDOW, [])
    plot.solids.append(Solid(rectangle(0.0, 8.0, 10.0, 18.0), 0.0, 6.0, "building"))
    assert plant(plot, np.array([5.0, 6.2]), 4.0, (3.0, 6.0), rng)
    crowns = [shapely.Polygon(s.footprint) for s in plot.solids if s.kind == "tree"]
    assert max(crown.bounds[3] for crown in crowns) <= 8.01
    assert not plant(plot, np.array([5.0, 7.5]), 4.0, (3.0, 6.0), rng), "too close to the wall"
    assert not plant(plot, np.array([20.0, 0.0]), 4.0, (3.0, 6.0), rng), "on the lane"
    assert not plant(plot, np.array([5.0, 6.2]), 4.0, (3.0, 6.0), rng), "taken"


@pytest.mark.parametrize("footway", [True, False])
def test_a_footway_is_planted_only_where_it_may_be(footway):
    plot = Plot(ROAD, WINDOW, [])
    assert plant(plot, np.array([0.0, 4.5]), 2.0, (3.0, 6.0), np.random.default_rng(0), footway=footway) == footway


@pytest.mark.parametrize(("underside", "reaches"), [(2.4, False), (2.5, True)])
def test_crowns_too_low_to_drive_below_keep_off_the_road(underside, reaches):
    plot = Plot(ROAD, WINDOW, [])
    assert plant(plot, np.array([0.0, 5.2]), 4.0, (underside, 6.0), np.random.default_rng(0))
    crowns = [shapely.Polygon(s.footprint) for s in plot.solids if s.kind == "tree"]
    assert any(crown.intersects(ROAD.carriageway) for crown in crowns) == reaches
