"""Sites as values: checked when they are made, compared field by field, and the ground they stand
on."""

from dataclasses import replace

import numpy as np
import pytest

from toolkit.geometry import look
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site, Solid

SQUARE = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])


def test_sites_that_differ_are_not_equal(small_site):
    site = small_site()
    assert site != replace(site, hybrid_radius=15.0)
    assert site != Site("small", site.area)
    assert site != "small"


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        *(
            ("area", [0.0, 0, 5000, 5000], "at most 10 km long and 4 km² large"),
            ("area", [0, 0, 1e300, 1e-300], "at most"),
        ),
        *(
            ("area", [0.0, 0, 0, 4], "area is empty"),
            ("area", [0.0, 0, np.nan, 4], "area must be four finite numbers"),
        ),
        ("height", 0.0, "height must be positive"),
        ("hybrid_radius", -1.0, "hybrid_radius must be finite and at least 0 m, got -1"),
        ("hybrid_radius", np.inf, "hybrid_radius must be finite and at least 0 m, got inf"),
        (
            "lanes",
            (SQUARE, SQUARE[[0, 2, 1, 3]]),
            r"lanes\[1\]: polygon crosses itself near \(2, 2\)",
        ),
        ("parking", np.array([[1.0, 2, np.nan]]), "parking must be finite rows"),
    ],
)
def test_a_site_made_in_python_is_checked_too(field, value, message):
    arguments = {"name": "s", "area": np.array([0.0, 0, 1, 1])} | {
        field: np.array(value) if field == "area" else value
    }
    with pytest.raises(ValueError, match=message):
        Site(**arguments)


def test_ground_is_smooth_and_seeded():
    site, other = (
        Site("s", np.array([0.0, 0, 1, 1]), relief=Relief(0.08, seed)) for seed in (1, 2)
    )
    xy = np.random.default_rng(0).uniform(-500, 500, (20_000, 2))
    z = site.ground(xy)
    assert np.abs(z).max() <= 0.08
    assert 0.01 < z.std() < 0.06
    assert abs(z.mean()) < 0.002
    assert np.array_equal(z, site.ground(xy))
    assert not np.allclose(z, other.ground(xy))
    assert np.abs(site.ground(xy + np.array([0.1, 0])) - z).max() < 0.003
    assert site.ground(xy.reshape(100, 200, 2)).shape == (100, 200)
    assert not Site("flat", site.area).ground(xy).any()


def test_ground_slopes_about_the_origin():
    level, steep = (
        Site("s", np.array([0.0, 0, 1, 1]), relief=Relief(0.08, 3, slope))
        for slope in ((0.0, 0.0), (0.06, -0.02))
    )
    xy = np.random.default_rng(0).uniform(-50, 50, (40, 2))
    np.testing.assert_allclose(steep.plane(xy), xy @ [0.06, -0.02])
    np.testing.assert_allclose(steep.ground(xy) - level.ground(xy), xy @ [0.06, -0.02], atol=1e-12)
    assert not level.plane(xy).any()
    assert steep != level
    with pytest.raises(ValueError, match=r"relief\.slope must be a rise along x and along y"):
        Relief(slope=(0.5, 0.0))


@pytest.mark.parametrize(
    "change",
    [
        *(
            {"name": "other"},
            {"area": np.array([-10.0, -5, 10, 6])},
            {"height": 3.6},
            {"lanes": (SQUARE,)},
        ),
        {"footways": (SQUARE + 6,)},
        *(
            {
                "solids": (
                    Solid(SQUARE - 9, -0.3, 6.25, "wall"),
                    Solid(SQUARE + 1, -1.0, -0.5, "pond"),
                )
            },
            {"mounts": ()},
        ),
        {"sensors": (Sensor("d0", DepthCamera(sigma=0.5), look((1.0, 2.0, 5.2), 0.3, 0.1)),)},
        *({"parking": np.array([[1.0, 2, 0.6]])}, {"network": ""}, {"map_SE3_site": np.eye(4)}),
        *({"geo_reference": None}, {"relief": Relief(0.06, 8)}),
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_site_that_differs_in_one_field_is_another(change, small_site):
    assert small_site() == small_site()
    assert replace(small_site(), **change) != small_site()
    assert replace(small_site(), height=3.5 + 1e-12) == small_site()
