import numpy as np
import pytest
import shapely
import trimesh

from toolkit.mesh import box, ellipsoid, extrude, flip_sides, merge, place, triangulate, tube

L_SHAPE = np.array([[0.0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        *((box((1, 2, 3), (5, 5, 5)), 6.0), (extrude(L_SHAPE, 1.0, 3.0), 6.0)),
        (extrude(L_SHAPE[::-1], 1.0, 3.0), 6.0),  # clockwise outlines too
        *(
            (tube([(0, 0, 0), (0, 0, 2)], 0.5, 64), np.pi / 2),
            (tube([(0, 0, 0), (0, 2, 0)], 0.5, 64), np.pi / 2),
        ),
        *(
            (tube([(0, 0, 0), (2, 0, 0)], 0.5, 64), np.pi / 2),
            (ellipsoid((1, 1, 1), (1, 2, 3), 40, 40), 8 * np.pi),
        ),
        *((flip_sides(box((1, 2, 3), (5, 5, 5))), 6.0), (place(box((1, 2, 3)), 4.0, yaw=0.7), 6.0)),
    ],
)
def test_solids_are_closed_and_wound_outwards(mesh, expected):
    assert trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False).volume == pytest.approx(
        expected, rel=0.02
    )


@pytest.mark.parametrize(
    ("end", "extent"), [((1, 0, 0), (1, 2, 1)), ((0, 0, 1), (1, 2, 1)), ((0, 1, 0), (1, 1, 2))]
)
def test_a_flat_bar_is_broad_along_y_or_else_along_z(end, extent):
    bar = tube([(0, 0, 0), end], 0.5, flat=2.0)
    np.testing.assert_allclose(np.ptp(bar.vertices, axis=0), extent)


def test_triangles_face_up_turn_and_shift():
    ring = shapely.Point(0, 0).buffer(2.0).difference(shapely.Point(0, 0).buffer(1.0))
    a, b, c = np.moveaxis(triangulate(ring).vertices[triangulate(ring).triangles], 1, 0)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(ring.area)
    assert np.allclose(place(box((2, 0.1, 1), (1, 0, 0)), yaw=np.pi / 2).vertices[:, 1].max(), 2.0)
    assert merge([]).triangles.shape == (0, 3)
    cube = box((1, 1, 1))
    assert np.allclose(place(cube, 1.0, 2.0, 3.0).vertices, cube.vertices + np.array([1, 2, 3]))
    assert np.array_equal(place(cube, z=2.0).triangles, cube.triangles)
    assert np.allclose(cube.vertices.mean(axis=0), 0)
    first, second = box((1, 1, 1)), box((1, 1, 1))
    first.triangles[:] = 0
    assert trimesh.Trimesh(
        second.vertices, second.triangles, process=False
    ).volume == pytest.approx(1)
    assert np.array_equal(second.triangles, box((1, 1, 1)).triangles)
