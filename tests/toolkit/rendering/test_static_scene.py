import numpy as np
import open3d as o3d
import pytest

from toolkit.rendering.static_scene import FAR, RECESS, ROUGHNESS, build_scenery
from toolkit.sites.files import load_site
from toolkit.sites.random import random_site
from toolkit.sites.site import Relief, Site, Solid

AREA = np.array([-20.0, -10, 20, 10])
SQUARE = np.array([[0.0, 0], [8, 0], [8, 6], [0, 6]])


def site(*solids: Solid, relief: Relief = Relief()) -> Site:  # noqa: B008
    return Site("test", AREA, solids=solids, relief=relief)


def drop(mesh, xy):
    """Height of what a vertical ray from 50 m up meets, infinite depth for nothing."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    down = np.column_stack([xy, np.full(len(xy), 50.0), np.tile([0.0, 0, -1], (len(xy), 1))])
    return 50.0 - scene.cast_rays(down.astype(np.float32))["t_hit"].numpy()


def places(rng, n=3000, margin=30.0):
    return rng.uniform(AREA[:2] - margin, AREA[2:] + margin, (n, 2))


def test_ground_is_as_high_as_the_site_says():
    assert np.abs(drop(build_scenery(site()), places(np.random.default_rng(0)))).max() < 1e-4
    uneven = site(relief=Relief(0.1, 3))
    xy = places(np.random.default_rng(0), margin=12.0)
    assert np.abs(drop(build_scenery(uneven), xy) - uneven.ground(xy)).max() < 0.003
    far = np.random.default_rng(1).uniform(-FAR * 0.8, FAR * 0.8, (500, 2))
    assert np.isfinite(drop(build_scenery(uneven), far)).all()


def test_ponds_lie_below_the_ground_up_to_their_banks():
    pond = Solid(SQUARE, -1.5, -0.5, "pond")
    xy = places(np.random.default_rng(0))
    inside = (xy > [0, 0]).all(axis=1) & (xy < [8, 6]).all(axis=1)
    heights = drop(build_scenery(site(pond)), xy)
    assert np.allclose(heights[inside], -0.5, atol=1e-4)
    assert np.allclose(heights[~inside], 0.0, atol=1e-4)
    # meet the banks, not below
    slanted = np.array([[-1.0, 3, 0.4, 1, 0, -0.5], [4, 7, 0.4, 0, -1, -0.5]], np.float32)
    scene = o3d.t.geometry.RaycastingScene()
    mesh = build_scenery(site(pond))
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    assert (scene.cast_rays(slanted)["t_hit"].numpy() < 1.9).all()
    assert np.allclose(
        drop(
            build_scenery(site(Solid(SQUARE / 20, -0.3, 0.8, "building"))), np.array([[0.2, 0.15]])
        ),
        0.8,
    )


@pytest.mark.slow
def test_meshes_of_sites_repeat_and_are_of_moderate_size():
    for name in ("tjunction", "roundabout"):
        first, second = build_scenery(load_site(name)), build_scenery(load_site(name))
        assert np.array_equal(first.vertices, second.vertices)
        assert np.array_equal(first.triangles, second.triangles)
        assert 10_000 < len(first.triangles) < 300_000
        assert np.isfinite(first.vertices).all()
    mesh = build_scenery(random_site(np.random.default_rng(3)))
    assert np.isfinite(mesh.vertices).all()
    assert len(mesh.triangles) < 300_000


@pytest.mark.parametrize(
    "kind", ["wall", "fence", "post", "sign", "bin", "bench", "shelter", "kerb", "island", "trunk"]
)
def test_plain_solids_fill_their_prism(kind):
    mesh = build_scenery(site(Solid(SQUARE, -0.3, 2.0, kind)))
    assert np.allclose(drop(mesh, np.array([[0.1, 0.1], [7.9, 5.9], [4, 3]])), 2.0)
    assert np.allclose(drop(mesh, np.array([[-0.1, 0.1], [8.1, 5.9]])), 0.0, atol=1e-4)


@pytest.mark.parametrize("outline", [SQUARE, SQUARE[::-1]])
def test_houses_have_windows_set_into_closed_walls(outline):
    mesh = build_scenery(site(Solid(outline, -0.3, 7.0, "building")))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    y, z = np.meshgrid(np.linspace(0.05, 5.95, 119), np.linspace(0.05, 6.9, 137))
    rays = np.column_stack(
        [np.full(y.size, -5.0), y.ravel(), z.ravel(), np.tile([1.0, 0, 0], (y.size, 1))]
    )
    hit = scene.cast_rays(rays.astype(np.float32))
    depth = hit["t_hit"].numpy()
    walls, panes = np.abs(depth - 5) < 1e-4, np.abs(depth - 5 - RECESS) < 1e-4
    assert (walls | panes).all()
    assert 0.1 < panes.mean() < 0.5
    assert (hit["primitive_normals"].numpy()[:, 0] < -0.99).all()  # outwards
    assert np.allclose(drop(mesh, np.array([[4.0, 3.0]])), 7.0)


def test_hedges_leaves_and_slopes_are_followed_by_rays():
    mesh = build_scenery(
        site(Solid(np.array([[0.0, 0], [6, 0], [6, 0.8], [0, 0.8]]), -0.3, 1.4, "hedge"))
    )
    hedge = mesh.vertices[mesh.vertices[:, 2] > 0.05]
    assert hedge[:, :2].min() > -ROUGHNESS - 1e-9
    assert (hedge[:, :2].max(axis=0) < np.array([6, 0.8]) + ROUGHNESS).all()
    heights = drop(mesh, np.column_stack([np.linspace(0.3, 5.7, 200), np.full(200, 0.4)]))
    assert (heights > 1.2).all()
    assert heights.max() <= 1.4 + 1e-4
    assert heights.std() > 0.005
    ring = 1.5 * np.column_stack(
        [np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)]
    )
    mesh = build_scenery(site(Solid(ring, 2.0, 5.0, "tree")))
    heights = drop(mesh, np.random.default_rng(0).uniform(-0.9, 0.9, (2000, 2)))
    passed = heights < 0.1
    assert 0.02 < passed.mean() < 0.6
    assert heights[~passed].min() > 1.4
    kerb, house = (
        Solid(SQUARE, 0.0, 0.48, "kerb"),
        Solid(np.add(SQUARE, [0, 20]), -0.3, 6.0, "building"),
    )
    steep = site(kerb, house, relief=Relief(0.0, 0, (0.06, 0.03)))
    ground, solid = (
        drop(build_scenery(steep), places(np.random.default_rng(0))),
        drop(build_scenery(steep), SQUARE * 0.9 + 0.3),
    )
    bare = places(np.random.default_rng(0))
    away = ~((bare > [-1, -1]) & (bare < [9, 27])).all(axis=1)
    np.testing.assert_allclose(ground[away], bare[away] @ [0.06, 0.03], atol=1e-4)
    middle = SQUARE.mean(axis=0)
    np.testing.assert_allclose(
        solid, 0.48 + (SQUARE * 0.9 + 0.3 - middle) @ [0.06, 0.03], atol=1e-4
    )
    flat = build_scenery(site(kerb, house))
    np.testing.assert_array_equal(build_scenery(steep).vertices[:, :2], flat.vertices[:, :2])
    pond = Solid(SQUARE, -1.5, -0.5, "pond")
    xy = SQUARE * 0.8 + 0.4
    heights = drop(build_scenery(site(pond, relief=Relief(0.0, 0, (0.05, 0.0)))), xy)
    assert np.isfinite(heights).all()


@pytest.mark.parametrize("kind", ["building", "hedge", "bush", "tree"])
def test_solids_of_endless_size_are_refused(kind):
    for footprint, top in ((SQUARE, 1e300), (SQUARE * 1e3, 1e3)):
        with pytest.raises(ValueError, match=r"m² of skin, where 2|1000 m high"):
            build_scenery(site(Solid(footprint, 0.0, top, kind)))
