"""A site in 3D: ground and streets that follow the relief."""

import numpy as np
import pytest
import shapely

from toolkit.sites.site import Relief, Site, Solid
from toolkit.viewing.site_scene import GROUND_MARGIN_M, drape, ground_mesh

FIELD = Site("field", np.array([0.0, 0.0, 12.0, 8.0]), relief=Relief(0.3, 5))


def area(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    return float(np.abs(np.cross(b - a, c - a)).sum() / 2)


def test_ground_and_draped_shapes_follow_ponds_and_relief():
    pond = Solid(np.array([[2.0, 2], [6, 2], [6, 6], [2, 6]]), -1.0, -0.5, "pond")
    wet = Site("wet", FIELD.area, solids=(pond,))
    whole = (12 + 2 * GROUND_MARGIN_M) * (8 + 2 * GROUND_MARGIN_M)
    assert area(ground_mesh(FIELD)) == pytest.approx(whole)
    assert area(ground_mesh(wet)) == pytest.approx(whole - 16)
    mesh = drape(FIELD, [shapely.box(0, 0, 10, 5), shapely.box(5, 0, 10, 8)], lift=0.1)
    assert area(mesh) == pytest.approx(65)
    np.testing.assert_allclose(mesh.vertices[:, 2], FIELD.ground(mesh.vertices[:, :2]) + 0.1)
