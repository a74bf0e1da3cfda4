import json
import struct

import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies.body import Body
from toolkit.bodies.fleet import catalogue
from toolkit.bodies.meshes import load_mesh, load_meshes
from toolkit.mesh import box
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

SEDAN = next(body for body in catalogue() if body.name == "family_sedan")


def write(path, body: Body = SEDAN, *, scale: float = 1.0, turn=((1, 0, 0), (0, 1, 0), (0, 0, 1)), shift=(0, 0, 0)):
    vertices = scale * (body.vertices @ np.array(turn, float).T) + shift
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices.astype(float)), o3d.utility.Vector3iVector(body.triangles)
    )
    mesh.compute_vertex_normals()
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".glb":  # Open3D cannot read the glTF it writes
        return write_glb(path, vertices, body.triangles)
    assert o3d.io.write_triangle_mesh(str(path), mesh)
    return path


def write_glb(path, vertices, triangles):
    data = vertices.astype("<f4").tobytes(), triangles.astype("<u4").tobytes()
    low, high = vertices.astype("<f4").min(axis=0).tolist(), vertices.astype("<f4").max(axis=0).tolist()
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": sum(map(len, data))}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(data[0]), "target": 34962},
            {"buffer": 0, "byteOffset": len(data[0]), "byteLength": len(data[1]), "target": 34963},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": 5125, "count": triangles.size, "type": "SCALAR"},
        ],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(data)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
    path.write_bytes(header + chunks)
    return path


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb"])
def test_every_format_gives_the_same_box(tmp_path, suffix):
    body = load_mesh(write(tmp_path / f"sedan.{suffix}", shift=(3, -4, 0.7)))
    assert np.allclose(body.size, SEDAN.size, atol=1e-4)
    assert np.allclose(body.vertices.min(axis=0), -np.array(body.size) / 2, atol=1e-4)
    assert body.label == VEHICLE
    assert body.name == "sedan"


def test_gltf_as_its_standard_says_is_turned_upright(tmp_path):
    y_up_z_forward = ((0, 1, 0), (0, 0, 1), (1, 0, 0))
    body = load_mesh(write(tmp_path / "sedan.glb", turn=y_up_z_forward))
    assert np.allclose(body.size, SEDAN.size, atol=1e-4)
    cabin = body.vertices[body.vertices[:, 2] > 0.3 * body.size[2]]
    assert cabin[:, 0].mean() < 0  # the bonnet is in front of it, so the cabin is behind the middle


def test_folders_and_names_give_the_class_and_the_rest_follows_from_the_size(tmp_path):
    bodies = {body.name: body for body in catalogue()}
    write(tmp_path / "vehicle" / "a.ply")
    write(tmp_path / "b" / "heavy_van.ply", bodies["high_roof_van"])
    write(tmp_path / "c.ply", bodies["man_standing"])
    write(tmp_path / "d.ply", bodies["city_bicycle"])
    write(tmp_path / "e.ply", bodies["city_bus"])
    (tmp_path / "README.txt").write_text("not a mesh")
    loaded = {body.name: body.label for body in load_meshes(tmp_path)}
    assert loaded == {"vehicle/a": VEHICLE, "b/heavy_van": HEAVY, "c": PEDESTRIAN, "d": CYCLIST, "e": HEAVY}
    assert [body.name for body in catalogue(tmp_path)][-5:] == sorted(loaded)


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        ({"scale": 1000.0}, "millimetres, scale it by 0.001"),
        ({"scale": 100.0}, "centimetres, scale it by 0.01"),
        ({"turn": ((0, -1, 0), (1, 0, 0), (0, 0, 1))}, "z up and y forward, turn it"),
        ({"turn": ((0, 1, 0), (0, 0, 1), (1, 0, 0))}, "y up and z forward, turn it"),
        ({"scale": 17.0}, "check its units"),
    ],
)
def test_a_size_no_road_user_has_is_refused_with_what_to_do(tmp_path, change, hint):
    path = write(tmp_path / "vehicle_sedan.ply", **change)
    with pytest.raises(ValueError, match=hint) as error:
        load_meshes(tmp_path)
    assert str(path) in str(error.value)


def test_a_mesh_in_the_wrong_folder_is_refused(tmp_path):
    write(tmp_path / "pedestrian" / "sedan.ply")
    with pytest.raises(ValueError, match="no size of a pedestrian"):
        load_meshes(tmp_path)


def test_unread_vertices_do_not_widen_the_box(tmp_path):
    stray = Body("s", 0, np.concatenate([SEDAN.vertices, [[9, 9, 9]]]).astype(np.float32), SEDAN.triangles)
    assert np.allclose(load_mesh(write(tmp_path / "sedan.ply", stray)).size, SEDAN.size, atol=1e-4)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb", "gltf", "fbx"])
@pytest.mark.parametrize("content", [b"", b"\x00\x01garbage" * 50, b"ply\nformat ascii 1.0\nelement vertex 5\n"])
def test_damaged_files_are_named(tmp_path, suffix, content):
    (tmp_path / f"broken.{suffix}").write_bytes(content)
    with pytest.raises(ValueError, match=f"broken.{suffix}.*export it again"):
        load_meshes(tmp_path)


def test_points_without_triangles_and_nan_are_refused(tmp_path):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(SEDAN.vertices.astype(float)))
    o3d.io.write_point_cloud(str(tmp_path / "points.ply"), cloud)
    with pytest.raises(ValueError, match="points but no triangles"):
        load_mesh(tmp_path / "points.ply")
    broken = Body("b", 0, box((4, 2, 1.5)).vertices.astype(np.float32), box((4, 2, 1.5)).triangles.astype(np.int32))
    broken.vertices[0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        load_mesh(write(tmp_path / "nan.ply", broken))


def test_missing_and_empty_folders(tmp_path):
    with pytest.raises(FileNotFoundError, match="no folder"):
        load_meshes(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="holds no mesh"):
        load_meshes(tmp_path)
