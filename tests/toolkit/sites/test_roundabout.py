"""The roundabout as the paper has it."""

import numpy as np
import shapely

from toolkit.sites.files import load_site


def test_odd_sensors_of_the_roundabout_face_the_centre_and_even_ones_outwards():
    site = load_site("roundabout")
    for i, sensor in enumerate(site.sensors):
        outwards = sensor.pose[:2, 2] @ (sensor.position[:2] / np.linalg.norm(sensor.position[:2]))
        assert outwards < -0.95 if i % 2 else outwards > 0.95
    assert np.allclose([s.position[:2] for s in site.sensors[::2]], [(29, -2), (-28, 1), (0, 30), (-1.5, -30)])


def test_streets_lie_where_the_paper_has_them(union):
    roundabout = load_site("roundabout")
    road = union(roundabout.lanes)
    ring = [(r * np.cos(t), r * np.sin(t)) for r in (17.6, 20.95, 24.3) for t in np.linspace(0, 2 * np.pi, 73)]
    assert all(road.distance(shapely.Point(p)) < 0.05 for p in ring)
    assert not road.intersects(shapely.Point(0, 0).buffer(17.2))
