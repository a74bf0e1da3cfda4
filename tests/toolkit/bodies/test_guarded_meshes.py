"""Meshes read in a process of their own: what hangs or dies over a file is one error."""

import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies import guarded_meshes
from toolkit.bodies.guarded_meshes import read_guarded_mesh
from toolkit.mesh import box


@pytest.fixture
def path(tmp_path):
    """Any kind that Open3D reads will do: which are guarded is the caller's choice."""
    made = box((4.0, 2.0, 1.5))
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(made.vertices), o3d.utility.Vector3iVector(made.triangles)
    )
    o3d.io.write_triangle_mesh(str(tmp_path / "box.ply"), mesh)
    return tmp_path / "box.ply"


def test_it_gives_what_is_in_the_file(path):
    vertices, triangles = read_guarded_mesh(path)
    made = box((4.0, 2.0, 1.5))
    np.testing.assert_allclose(vertices, made.vertices)
    np.testing.assert_array_equal(triangles, made.triangles)


def test_what_is_no_mesh_has_no_triangles(tmp_path):
    (tmp_path / "broken.glb").write_bytes(b"glTF" + bytes(99))
    vertices, triangles = read_guarded_mesh(tmp_path / "broken.glb")
    assert vertices.shape == triangles.shape == (0, 3)


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("while True: pass", "has not read it after 1 s"),
        ("import os; os.abort()", "fails over it with exit status -6"),
        ("raise RuntimeError", "fails over it with exit status 1"),
    ],
)
def test_what_hangs_or_dies_over_a_file_is_one_line(path, monkeypatch, program, says):
    monkeypatch.setattr(guarded_meshes, "_READ", program)
    with pytest.raises(ValueError, match=says) as error:
        read_guarded_mesh(path, limit_s=1.0)
    assert "\n" not in str(error.value)
