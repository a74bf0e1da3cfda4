"""Lanes of OpenDRIVE roads as outlines, the roads of one storey, slopes."""

import numpy as np
import pytest
import shapely

from toolkit.geometry import pose
from toolkit.sites.opendrive.extract import in_map, in_site, lanes, plane, roads_near, steepest, surfaces

WINDOW = shapely.box(-40, -40, 40, 40)


def test_lanes_lie_side_by_side(street, tmp_path):
    (road,) = roads_near(street(tmp_path), WINDOW, 0.0, 3.5)
    found = [(lane.kind, lane.outline.bounds, lane.width) for lane in lanes(road)]
    assert found == [
        ("driving", (-50, 0.5, 50, 4.0), 3.5),
        ("sidewalk", (-50, 4.0, 50, 6.0), 2.0),
        ("driving", (-50, -3.0, 50, 0.5), 3.5),
        ("parking", (-50, -5.5, 50, -3.0), 2.5),
        ("sidewalk", (-50, -7.5, 50, -5.5), 2.0),
    ]
    np.testing.assert_allclose(list(lanes(road))[3].middle[[0, -1]], [[-50, -4.25], [50, -4.25]])


def test_other_storeys_and_places_are_left_out(street, tmp_path):
    high = street(tmp_path, elevation='<elevation s="0" a="6"/>')
    assert roads_near(high, WINDOW, 0.0, 3.5) == []
    assert len(roads_near(high, WINDOW, 4.0, 3.5)) == 1
    assert roads_near(high, shapely.box(500, 500, 510, 510), 6.0, 3.5) == []


def test_steepest_slope_within_the_window(street, tmp_path):
    path = street(tmp_path, elevation='<elevation s="0" a="0" b="-0.04"/><elevation s="95" a="-3.8" b="0.3"/>')
    there = roads_near(path, WINDOW, 0.0, 5.0)
    assert steepest(there, WINDOW) == pytest.approx(0.04)
    assert steepest(there, WINDOW.buffer(20.0)) == pytest.approx(0.3)
    assert steepest([], WINDOW) == 0.0


def test_damaged_numbers_name_the_file(street, tmp_path):
    path = street(tmp_path, lanes='<lanes><laneSection s="zero"/></lanes>')
    with pytest.raises(ValueError, match=r"street\.xodr: <laneSection> needs a finite number as s, got 'zero'"):
        surfaces(path, roads_near(path, WINDOW, 0.0, 3.5))
    path = street(tmp_path, elevation='<elevation s="0" a="up"/>')
    with pytest.raises(ValueError, match=r"street\.xodr: <elevation> needs a finite number as a, got 'up'"):
        roads_near(path, WINDOW, 0.0, 3.5)


def test_frames_are_inverse():
    spot = shapely.Point(3.0, 4.0)
    there = pose(10.0, -20.0, 5.0, yaw=np.pi / 2)
    assert in_map(spot, there).equals_exact(shapely.Point(6.0, -17.0), 1e-9)
    assert in_site(in_map(spot, there), there).equals_exact(spot, 1e-9)


def test_the_plane_of_the_roads_in_the_frame_of_the_site(street, tmp_path):
    path = street(tmp_path, elevation='<elevation s="0" a="3" b="-0.04"/>')
    there = roads_near(path, WINDOW, 0.0, 5.0)
    along, off = plane(there, WINDOW, pose(5.0, 2.0, 1.0))
    assert along == pytest.approx((-0.04, 0.0))  # one road says nothing of the slope across it
    assert off == pytest.approx(0.0, abs=1e-9)
    turned, _ = plane(there, WINDOW, pose(yaw=np.pi / 2))
    assert turned == pytest.approx((0.0, 0.04))
    bent = street(tmp_path, elevation='<elevation s="0" a="3" b="-0.04"/><elevation s="50" a="1" b="0.0"/>')
    slope, off = plane(roads_near(bent, WINDOW, 0.0, 5.0), WINDOW, np.eye(4))
    assert -0.04 < slope[0] < 0.0
    assert 0.05 < off < 1.0
    assert plane([], WINDOW, np.eye(4)) == ((0.0, 0.0), 0.0)
