import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies.ply_meshes import read_ply_mesh


@pytest.mark.parametrize("as_text", [False, True])
def test_what_open3d_writes_is_read_as_it_was(tmp_path, as_text):
    mesh = o3d.geometry.TriangleMesh.create_sphere(1.0, 6)
    mesh.compute_vertex_normals()
    mesh.paint_uniform_color([1, 0, 0])
    o3d.io.write_triangle_mesh(tmp_path / "a.ply", mesh, write_ascii=as_text)
    vertices, triangles = read_ply_mesh(tmp_path / "a.ply")
    np.testing.assert_allclose(vertices, np.asarray(mesh.vertices), atol=1e-5)
    np.testing.assert_array_equal(triangles, np.asarray(mesh.triangles))


TEXT = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property uchar flags
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
7 4 0 1 2 3
"""


def test_a_face_of_four_corners_is_two_triangles(tmp_path):
    (tmp_path / "a.ply").write_text(TEXT)
    assert read_ply_mesh(tmp_path / "a.ply")[1].tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("2 3\n", "2 4\n", "not there"),
        ("2 3\n", "2 -1\n", "not there"),
        ("2 3\n", "2", "cut off"),
        ("7 4", "7 200", "cut off"),
        ("7 4", "7 -1", "cut off"),
        ("vertex 4", "vertex 99999999999", "cut off"),
        ("float x", "floot x", "header has a line"),
        ("float x", "float w", "no x, y and z"),
        ("1 1 0", "1 one 0", "word"),
        ("1 1 0", "1 nan 0", "NaN"),
        ("end_header", "", "no header"),
    ],
)
def test_damage_is_refused(tmp_path, old, new, says):
    (tmp_path / "a.ply").write_text(TEXT.replace(old, new))
    with pytest.raises(ValueError, match=says):
        read_ply_mesh(tmp_path / "a.ply")
