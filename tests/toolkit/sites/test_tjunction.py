"""The T-junction as the paper and CARLA have it."""

import numpy as np
import pytest
import shapely

from toolkit.geometry import transform
from toolkit.sites.files import load_site


def test_areas_in_carla_coordinates():
    site = load_site("tjunction")
    xmin, ymin, xmax, ymax = site.area
    corners = transform(site.map_SE3_site, np.array([[xmin, ymin, 0], [xmax, ymax, 0]]))
    x, y_carla = corners[:, 0], -corners[:, 1]
    assert sorted(x) == [84, 124]
    assert sorted(y_carla) == [156, 236]
    a, b = 12.5, 13.6
    x, y, _ = transform(site.map_SE3_site, np.array([a, b, 0.0]))
    assert (a, b) == pytest.approx((196 + y, 104 - x))  # a = 196 - y_carla, b = 104 - x_carla
    assert np.array_equal(load_site("roundabout").map_SE3_site, np.eye(4))


def headings(site):
    return np.rad2deg([np.arctan2(s.pose[1, 2], s.pose[0, 2]) for s in site.sensors])


def test_sensor_poses_of_the_tjunction():
    site = load_site("tjunction")
    published = [
        (40.9, 8.1, 155),
        (-7.7, 21.9, 295),
        (-45.6, 10.1, 15),
        (8, 5.6, 52),
        (-8.3, 18.5, 208),
        (-5.5, -27.5, 64),
    ]
    places = np.array([s.position[:2] for s in site.sensors])
    assert np.allclose(places, [p[:2] for p in published])
    assert np.allclose((headings(site) - [p[2] for p in published] + 180) % 360, 180)


def test_streets_lie_where_the_paper_has_them(union):
    tjunction = load_site("tjunction")
    road, walk = union(tjunction.lanes), union(tjunction.footways)
    assert all(road.contains(shapely.Point(p)) for p in [(-30, 9.7), (30, 17.5), (-0.8, 13.6), (-4.7, -15), (3.1, -15)])
    assert all(walk.contains(shapely.Point(p)) for p in [(-30, 5.4), (30, 21.8), (-9.0, -15), (7.4, -15)])
    across = shapely.LineString([(-30, 0), (-30, 30)])
    assert across.intersection(road).length == pytest.approx(8.6, abs=0.01)
    assert across.intersection(walk).length == pytest.approx(8.0, abs=0.01)
