import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from placement_env.report.content import Ground
from placement_env.report.pages.scene_shapes import (
    GROUND_MARGIN,
    NO_RETURN,
    draped,
    ground_mesh,
    seen_cells,
    view_edges,
)
from toolkit.rendering.renderer import Renderer
from toolkit.sites.site import Relief, Site, Solid

FIELD = Site("field", np.array([0.0, 0.0, 12.0, 8.0]), relief=Relief(0.3, 5))


def area(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    return float(np.abs(np.cross(b - a, c - a)).sum() / 2)


def test_ground_reaches_around_the_area_and_leaves_ponds_open():
    pond = Solid(np.array([[2.0, 2], [6, 2], [6, 6], [2, 6]]), -1.0, -0.5, "pond")
    wet = Site("wet", FIELD.area, solids=(pond,))
    whole = (12 + 2 * GROUND_MARGIN) * (8 + 2 * GROUND_MARGIN)
    assert area(ground_mesh(FIELD)) == pytest.approx(whole)
    assert area(ground_mesh(wet)) == pytest.approx(whole - 16)


def test_draped_shapes_follow_the_relief():
    mesh = draped(FIELD, [shapely.box(0, 0, 10, 5), shapely.box(5, 0, 10, 8)], lift=0.1)
    assert area(mesh) == pytest.approx(65)
    np.testing.assert_allclose(mesh.vertices[:, 2], FIELD.ground(mesh.vertices[:, :2]) + 0.1)


@given(st.integers(0, 2**32 - 1))
def test_visible_ground_covers_the_seen_cells_and_no_other(seed):
    seen = np.random.default_rng(seed).random((8, 24)) < 0.6
    x, y, zeros = np.arange(0.25, 12, 0.5), np.arange(0.5, 8, 1.0)[:8], np.zeros((8, 24))
    ground = Ground(x, y * 0.5, seen[None], zeros[None].astype(np.float32), ~seen, seen, seen)
    mesh = seen_cells(FIELD, ground, seen, lift=0.2)
    assert area(mesh) == pytest.approx(0.25 * seen.sum())
    np.testing.assert_allclose(mesh.vertices[:, 2], FIELD.ground(mesh.vertices[:, :2]) + 0.2)
    corners = mesh.vertices[mesh.triangles].mean(1)
    columns, rows = np.floor(corners[:, 0] / 0.5).astype(int), np.round(corners[:, 1] / 0.5 - 0.5).astype(int)
    assert seen[rows.clip(0, 7), columns.clip(0, 23)].all()


def test_views_end_where_something_stands(example):
    sensor = example.site.sensors[0]
    (background,) = Renderer(example.site, (), [sensor]).background
    edges = view_edges(sensor, background)
    rays = edges[np.linalg.norm(edges[:, 0] - sensor.position, axis=1) < 1e-6]
    assert len(rays) == 4
    lengths = np.linalg.norm(rays[:, 1] - rays[:, 0], axis=1)
    corners = background[[0, 0, -1, -1], [0, -1, -1, 0]]
    directions = np.linalg.norm(sensor.model.rays()[[0, 0, -1, -1], [0, -1, -1, 0]], axis=1)
    expected = np.where(corners > 0, corners, NO_RETURN) * directions
    np.testing.assert_allclose(sorted(lengths), sorted(expected), rtol=0.2)
    assert edges[..., 2].min() > -1
