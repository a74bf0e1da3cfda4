import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.reference import SURFACE_SPACING, cloud_surface, scene_points, scenes_surface, site_surface
from toolkit.geometry import look
from toolkit.sensors.models import DepthCamera
from toolkit.sites.site import Site, Solid

SQUARE = np.array([[0.0, 0], [6, 0], [6, 4], [0, 4]])
PLACE = Site(
    "place",
    np.array([-12.0, -12, 12, 12]),
    solids=(Solid(SQUARE, 0.0, 5.0, "container"), Solid(SQUARE - 9.0, 0.0, 6.0, "tree")),
)


def scene(depth, share=1.0, spread=0.02, frames=16):
    model = DepthCamera(width=40, height=30, stride=2)
    images = {name: np.full(model.shape, value, np.float32) for name, value in
              {"first": depth, "spread": spread, "share": share, "second": np.nan,
               "second_spread": 0.0, "second_share": 0.0}.items()}  # fmt: skip
    return EmptyScene("c", model, frames=frames, **images)


def test_a_site_is_sampled_evenly_with_its_normals_and_without_leaves():
    surface = site_surface(PLACE)
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    roof = np.isclose(surface.points[:, 2], 5.0)
    assert roof.sum() == pytest.approx(24 / SURFACE_SPACING**2, rel=0.1)
    assert np.allclose(np.abs(surface.normals[roof]), [0, 0, 1])
    wall = np.isclose(surface.points[:, 1], 4.0) & (surface.points[:, 2] > 0.01)
    assert wall.sum() == pytest.approx(30 / SURFACE_SPACING**2, rel=0.1)
    assert surface.points[:, 2].max() <= 5.0 + 1e-9
    assert np.abs(surface.points[:, :2]).max() < 60.0
    again = site_surface(PLACE)
    assert again.points.tobytes() == surface.points.tobytes()


def test_a_cloud_has_normals_where_it_is_flat():
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-5, 5, (20000, 2)), 0.005 * rng.standard_normal(20000)])
    bush = rng.uniform([6, 6, 0.5], [8, 8, 2.5], (3000, 3))
    surface = cloud_surface(np.concatenate([ground, bush, [[np.nan, 0, 0]]]))
    flat = surface.points[:, 2] < 0.1
    assert np.abs(surface.normals[flat, 2]).mean() > 0.99
    assert (~flat).sum() < 0.2 * flat.sum()
    with pytest.raises(ValueError, match="0 points on flat ground or walls, 50 are needed"):
        cloud_surface(rng.uniform(0, 100, (30, 3)))


def test_the_points_of_a_scene_lie_at_its_depth_and_know_how_sure_they_are():
    points, deviation = scene_points(scene(8.0))
    assert points.shape == (300, 3)
    assert np.allclose(points[:, 2], 8.0)
    slant = np.linalg.norm(points, axis=1) / 8.0
    np.testing.assert_allclose(deviation, 0.02 * slant / 4.0, rtol=1e-5)
    assert len(scene_points(scene(0.0))[0]) == 0
    assert len(scene_points(scene(8.0, share=0.4))[0]) == 0
    assert len(scene_points(scene(8.0, share=0.4), least_share=0.3)[0]) == 300


def test_scenes_of_several_sensors_make_one_surface():
    poses = [look((x, 0.0, 8.0), heading=0.0, tilt=np.pi / 2) for x in (0.0, 20.0)]
    wide = [scene(8.0), scene(8.0)]
    surface = scenes_surface(wide, poses)
    assert np.abs(surface.points[:, 2]).max() < 1e-4
    assert (surface.points[:, 0] < 10).any()
    assert (surface.points[:, 0] > 10).any()
    with pytest.raises(ValueError, match="50 are needed"):
        scenes_surface([], [])
