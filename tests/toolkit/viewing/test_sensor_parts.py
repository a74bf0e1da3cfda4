"""Sensors in a scene: what they look at, and where their view ends."""

import numpy as np
import pytest

from toolkit.geometry import look
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.site import Site
from toolkit.viewing.sensor_parts import RAY_WITHOUT_RETURN_M, draw_view, find_target, view_edges


@pytest.mark.parametrize(
    ("heading", "tilt", "target"),
    [
        (0.0, np.arctan2(4.7, 8.0), (11.0, 4.0, 0.3)),  # where it looks at the ground
        (np.pi / 2, np.arctan2(4.7, 8.0), (3.0, 12.0, 0.3)),
        (0.0, 0.1, (23.0, 4.0, 5.0 - 20.0 * np.tan(0.1))),  # no farther than 20 m
        (0.0, 0.0, (23.0, 4.0, 5.0)),
        (0.0, -0.3, (23.0, 4.0, 5.0 + 20.0 * np.tan(0.3))),
        (0.0, np.pi / 2, (3.0, 4.0, 0.3)),
    ],
)
def test_a_handle_is_where_a_sensor_looks(heading, tilt, target):
    site = Site("s", np.array([-20.0, -20.0, 20.0, 20.0]))
    sensor = Sensor("a", DepthCamera(), look((3.0, 4.0, 5.0), heading, tilt))
    np.testing.assert_allclose(find_target(site, sensor), target, atol=1e-6)


def test_a_view_has_the_sides_of_the_field_of_view_and_the_foot_of_the_pole():
    site = Site("s", np.array([-20.0, -20.0, 20.0, 20.0]))
    sensor = Sensor("a", DepthCamera(), look((3.0, 4.0, 5.0), 0.0, np.arctan2(4.7, 8.0)))
    lines = draw_view(site, sensor, find_target(site, sensor))
    np.testing.assert_allclose(lines[:4, 0], [sensor.position] * 4)
    side = 8.0 * np.sqrt(0.5)  # of 90 degrees
    ends = [
        [11.0, 4.0, 0.3],
        [3.0 + side, 4.0 - side, 0.3],
        [3.0 + side, 4.0 + side, 0.3],
        [3.0, 4.0, 0.0],
    ]
    np.testing.assert_allclose(lines[:4, 1], ends, atol=1e-5)
    np.testing.assert_allclose(lines[4:, 1], lines[1:3, 1])
    np.testing.assert_allclose(lines[4:, 0], [lines[0, 1]] * 2)
    turned = Sensor("c", DepthCamera(), look((3.0, 4.0, 5.0), np.pi / 4, np.arctan2(4.7, 8.0)))
    lines = draw_view(site, turned, find_target(site, turned))
    np.testing.assert_allclose(lines[1:3, 1], [[11.0, 4.0, 0.3], [3.0, 12.0, 0.3]], atol=1e-5)
    lidar = Sensor("b", SpinningLidar(), look((3.0, 4.0, 5.0), 0.0, 0.5))
    assert len(draw_view(site, lidar, find_target(site, lidar))) == 2


def test_views_end_where_something_stands():
    site = load_site("tjunction")
    sensor = site.sensors[0]
    (background,) = Renderer(site, (), [sensor]).background
    edges = view_edges(sensor, background)
    rays = edges[np.linalg.norm(edges[:, 0] - sensor.position, axis=1) < 1e-6]
    assert len(rays) == 4
    lengths = np.linalg.norm(rays[:, 1] - rays[:, 0], axis=1)
    corners = background[[0, 0, -1, -1], [0, -1, -1, 0]]
    directions = np.linalg.norm(sensor.model.rays()[[0, 0, -1, -1], [0, -1, -1, 0]], axis=1)
    expected = np.where(corners > 0, corners, RAY_WITHOUT_RETURN_M) * directions
    np.testing.assert_allclose(sorted(lengths), sorted(expected), rtol=0.2)
    assert edges[..., 2].min() > -1
