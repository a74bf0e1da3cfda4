import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies.off_meshes import read_off_mesh

TEXT = "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0 # a comment\n0 1 0\n4 0 1 2 3 255 0 0\n"


def test_what_open3d_writes_is_read_as_it_was(tmp_path):
    mesh = o3d.geometry.TriangleMesh.create_sphere(1.0, 6)
    o3d.io.write_triangle_mesh(tmp_path / "a.off", mesh)
    vertices, triangles = read_off_mesh(tmp_path / "a.off")
    np.testing.assert_allclose(vertices, np.asarray(mesh.vertices), atol=1e-5)
    np.testing.assert_array_equal(triangles, np.asarray(mesh.triangles))


def test_a_face_of_four_corners_is_two_triangles(tmp_path):
    for text in (TEXT, TEXT.replace("OFF\n", "OFF ")):
        (tmp_path / "a.off").write_text(text)
        assert read_off_mesh(tmp_path / "a.off")[1].tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("1 2 3 255", "1 2 9 255", "not there"),
        ("1 2 3 255", "1 2 -1 255", "not there"),
        ("4 1 0", "40 1 0", "cut off"),
        ("1 1 0", "1 one 0", "damaged"),
        ("1 1 0", "1 inf 0", "finite"),
        ("1 1 0", "1 1", "damaged"),
        ("OFF", "FFO", "begin with"),
    ],
)
def test_damage_is_refused(tmp_path, old, new, says):
    (tmp_path / "a.off").write_text(TEXT.replace(old, new))
    with pytest.raises(ValueError, match=says):
        read_off_mesh(tmp_path / "a.off")
