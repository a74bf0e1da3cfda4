import json
import struct
from itertools import product
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies import meshes
from toolkit.bodies.body import Body, include_mirrors
from toolkit.bodies.drawn_bodies import draw_body
from toolkit.bodies.fleet import catalogue, fleet_named
from toolkit.mesh import Mesh, box, ellipsoid, merge, tube
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

SEDAN = next(body for body in catalogue() if body.name == "family_sedan")


def write(
    path,
    body: Body = SEDAN,
    *,
    scale: float = 1.0,
    turn=((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    shift=(0, 0, 0),
):
    vertices = scale * (body.vertices @ np.array(turn, float).T) + shift
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices.astype(float)),
        o3d.utility.Vector3iVector(body.triangles),
    )
    mesh.compute_vertex_normals()
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".glb":  # Open3D cannot read the glTF it writes
        return write_glb(path, vertices, body.triangles)
    assert o3d.io.write_triangle_mesh(str(path), mesh)
    return path


def write_glb(path, vertices, triangles):
    data = vertices.astype("<f4").tobytes(), triangles.astype("<u4").tobytes()
    low, high = (
        vertices.astype("<f4").min(axis=0).tolist(),
        vertices.astype("<f4").max(axis=0).tolist(),
    )
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
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(vertices),
                "type": "VEC3",
                "min": low,
                "max": high,
            },
            {"bufferView": 1, "componentType": 5125, "count": triangles.size, "type": "SCALAR"},
        ],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(data)
    header = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    chunks = (
        struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(body), b"BIN\0")
        + body
    )
    path.write_bytes(header + chunks)
    return path


def load_mesh(path):
    return meshes.take_mesh(path, Path(path.name), meshes.MeshEntry()).body


def load_meshes(folder):
    return tuple(taken.body for taken in meshes.take_meshes(folder))


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb"])
def test_every_format_gives_the_same_box(tmp_path, suffix):
    body = load_mesh(write(tmp_path / f"sedan.{suffix}", shift=(3, -4, 0.7)))
    assert np.allclose(body.size, SEDAN.size, atol=1e-4)
    assert np.allclose(
        body.vertices.min(axis=0)[[0, 2]], -np.array(body.size)[[0, 2]] / 2, atol=1e-4
    )
    assert -body.vertices[:, 1].min() > body.size[1] / 2 + 0.05  # the mirrors
    assert body.label == VEHICLE
    assert body.name == "sedan"


def test_meshes_are_turned_upright_and_stray_vertices_left_out(tmp_path):
    y_up_z_forward = ((0, 1, 0), (0, 0, 1), (1, 0, 0))
    body = load_mesh(write(tmp_path / "sedan.glb", turn=y_up_z_forward))
    assert np.allclose(body.size, SEDAN.size, atol=1e-4)
    cabin = body.vertices[body.vertices[:, 2] > 0.3 * body.size[2]]
    assert cabin[:, 0].mean() < 0  # the bonnet is in front of it, so the cabin is behind the middle
    stray = Body(
        "s", 0, np.concatenate([SEDAN.vertices, [[9, 9, 9]]]).astype(np.float32), SEDAN.triangles
    )
    assert np.allclose(load_mesh(write(tmp_path / "sedan.ply", stray)).size, SEDAN.size, atol=1e-4)


def test_folders_and_names_give_the_class_and_how_it_was_taken(tmp_path):
    bodies = {body.name: body for body in catalogue()}
    write(tmp_path / "vehicle" / "a.ply")
    write(tmp_path / "b" / "heavy_van.ply", bodies["high_roof_van"])
    for letter, name in zip("cde", ("man_standing", "city_bicycle", "city_bus"), strict=True):
        write(tmp_path / f"{letter}.ply", bodies[name])
    (tmp_path / "README.txt").write_text("not a mesh")
    loaded = {body.name: body.label for body in load_meshes(tmp_path)}
    assert loaded == {
        "vehicle/a": VEHICLE,
        "b/heavy_van": HEAVY,
        "c": PEDESTRIAN,
        "d": CYCLIST,
        "e": HEAVY,
    }
    assert [body.name for body in catalogue(tmp_path)][-5:] == sorted(loaded)
    how = tmp_path / "how"
    write(how / "vehicle" / "a.ply", OURS["compact_suv"])
    write(how / "b.ply", OURS["classic_sedan"])
    write(how / "c.glb", OURS["city_bicycle"], turn=Y_UP_Z_FORWARD)
    assert [f"{taken.file}: {taken.how}" for taken in meshes.take_meshes(how)] == [
        "b.ply: vehicle (by its shape), 4.55 x 1.69 x 1.41 m, z up, x forward (its profile "
        "agrees), mirrors left out of its box",
        "c.glb: cyclist (by its shape), 1.72 x 0.62 x 1.83 m, y up, z forward (front assumed)",
        "vehicle/a.ply: vehicle (by its folder or name), 4.18 x 1.79 x 1.59 m, z up, x forward "
        "(its profile agrees), mirrors left out of its box",
    ]


@pytest.mark.parametrize(
    ("change", "hint"),
    [
        *(
            ({"scale": 1000.0}, "millimetres, scale it by 0.001"),
            ({"scale": 100.0}, "centimetres, scale it by 0.01"),
        ),
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


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb", "gltf"])
@pytest.mark.parametrize(
    "content", [b"", b"\x00\x01garbage" * 50, b"ply\nformat ascii 1.0\nelement vertex 5\n"]
)
def test_damaged_files_are_named(tmp_path, suffix, content):
    (tmp_path / f"broken.{suffix}").write_bytes(content)
    with pytest.raises(ValueError, match=f"broken.{suffix}.*export it again"):
        load_meshes(tmp_path)


@pytest.mark.parametrize("suffix", ["obj", "ply", "off"])
@pytest.mark.parametrize("corner", ["9", "-9"])
def test_a_corner_that_is_not_there_is_refused(tmp_path, suffix, corner):
    path = tmp_path / f"square.{suffix}"
    texts = {
        "obj": f"v 0 0 0\nv 4 0 0\nv 4 2 0\nv 0 2 1.5\nf 1 2 3\nf 1 3 {corner}\n",
        "ply": (
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float "
            "y\nproperty float z\nelement face 1\nproperty list uchar int "
            f"vertex_indices\nend_header\n0 0 0\n4 0 0\n4 2 0\n0 2 1\n3 0 1 {corner}\n"
        ),
        "off": f"OFF\n4 1 0\n0 0 0\n4 0 0\n4 2 0\n0 2 1\n3 0 1 {corner}\n",
    }
    path.write_text(texts[suffix])
    with pytest.raises(ValueError, match=r"export it again"):
        load_mesh(path)


def test_empty_folders_and_flat_small_or_broken_meshes_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="is not a folder"):
        load_meshes(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="holds no mesh"):
        load_meshes(tmp_path)
    with pytest.raises(ValueError, match="has no volume"):
        meshes.measure_shape(
            Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
        )
    with pytest.raises(ValueError, match="has no surface"):
        meshes.surface_points(
            Mesh(np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]), np.array([[0, 1, 2]]))
        )
    write(tmp_path / "pedestrian" / "sedan.ply")
    with pytest.raises(ValueError, match="does not fit a pedestrian"):
        load_meshes(tmp_path)
    flat = Body(
        "t",
        0,
        np.array([[0, 0, 0], [4, 0, 0], [4, 2, 1.5]], np.float32),
        np.array([[0, 1, 2]], np.int32),
    )
    with pytest.raises(ValueError, match="not clearly that of one"):
        load_mesh(write(tmp_path / "one.ply", flat))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(SEDAN.vertices.astype(float)))
    o3d.io.write_point_cloud(str(tmp_path / "points.ply"), cloud)
    with pytest.raises(ValueError, match="points but no triangles"):
        load_mesh(tmp_path / "points.ply")
    broken = Body(
        "b",
        0,
        box((4, 2, 1.5)).vertices.astype(np.float32),
        box((4, 2, 1.5)).triangles.astype(np.int32),
    )
    broken.vertices[0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        load_mesh(write(tmp_path / "nan.ply", broken))


Y_UP_X_FORWARD = ((1, 0, 0), (0, 0, 1), (0, -1, 0))
Y_UP_Z_FORWARD = ((0, 1, 0), (0, 0, 1), (1, 0, 0))
OURS = {body.name: body for body in catalogue()}
INCHES, FEET = 1 / 0.0254, 1 / 0.3048


def elephant() -> Body:
    legs = [tube([(x, y, 0), (x, y, 0.9)], 0.2, 8) for x in (-0.9, 0.9) for y in (-0.45, 0.45)]
    parts = [
        ellipsoid((0, 0, 1.3), (1.5, 0.8, 0.7)),
        ellipsoid((1.7, 0, 1.6), (0.7, 0.5, 0.5)),
        *legs,
    ]
    mesh: Mesh = merge([*parts, tube([(2.2, 0, 1.6), (2.6, 0, 0.8), (2.6, 0, 0.2)], 0.15)])
    return Body("e", 0, mesh.vertices.astype(np.float32), mesh.triangles.astype(np.int32))


@pytest.mark.parametrize(
    ("name", "body", "change", "says"),
    [
        ("car.ply", "family_sedan", {"turn": Y_UP_X_FORWARD}, "y up and x forward, turn it"),
        (
            "vehicle_car.ply",
            "family_sedan",
            {"turn": Y_UP_X_FORWARD},
            "lies on its side.*y up and x forward, turn it",
        ),
        ("car.ply", "family_sedan", {"turn": Y_UP_Z_FORWARD}, "y up and z forward, turn it"),
        (
            "car.ply",
            "compact_suv",
            {"turn": Y_UP_Z_FORWARD, "scale": 0.46},
            "not clearly|does not fit any road user",
        ),
        (
            "car.ply",
            "family_sedan",
            {"scale": INCHES},
            "it seems to be in inches, scale it by 0.0254",
        ),
        ("car.ply", "compact_suv", {"scale": FEET}, "it seems to be in feet, scale it by 0.3048"),
        (
            "car.ply",
            "compact_suv",
            {"scale": 100.0},
            "it seems to be in centimetres, scale it by 0.01",
        ),
        ("bus.ply", "city_bus", {"scale": FEET}, "it seems to be in feet, scale it by 0.3048"),
        ("bus.ply", "city_bus", {"scale": INCHES}, "it seems to be in inches, scale it by 0.0254"),
        ("bus.ply", "city_bus", {"turn": Y_UP_X_FORWARD}, "y up and x forward, turn it"),
        (
            "bus.ply",
            "city_bus",
            {"scale": 0.5},
            "by its size it may be a vehicle, but its shape is not",
        ),
        (
            "car.ply",
            "compact_suv",
            {"turn": ((-1, 0, 0), (0, -1, 0), (0, 0, 1))},
            "face backwards: -x forward",
        ),
        ("man.ply", "man_standing", {"scale": FEET}, "in feet, scale it by 0.3048"),
        ("pedestrian_man.ply", "man_standing", {"scale": INCHES}, "in inches, scale it by 0.0254"),
    ],
)
def test_what_cannot_be_told_is_refused_with_the_remedy(tmp_path, name, body, change, says):
    write(tmp_path / name, OURS[body], **change)
    with pytest.raises(ValueError, match=says) as error:
        load_meshes(tmp_path)
    assert "\n" not in str(error.value)
    assert name in str(error.value)


def test_a_table_names_and_labels_a_mesh(tmp_path):
    write(tmp_path / "dumbo.ply", elephant())
    with pytest.raises(
        ValueError,
        match=r"may be .* vehicle.* not clearly that of one: put it into a folder vehicle/",
    ):
        load_meshes(tmp_path)
    (tmp_path / "meshes.toml").write_text('[[mesh]]\nfile = "dumbo.ply"\nlabel = "vehicle"\n')
    assert [(body.name, body.label) for body in load_meshes(tmp_path)] == [("dumbo", VEHICLE)]


def test_a_table_turns_and_scales_a_mesh(tmp_path):
    write(tmp_path / "sub" / "x1.ply", OURS["city_bus"], turn=Y_UP_Z_FORWARD, scale=INCHES)
    entry = 'file = "sub/x1.ply"\nlabel = "heavy"\nup = "y"\nforward = "z"\nscale = 0.0254\n'
    (tmp_path / "meshes.toml").write_text(f"[[mesh]]\n{entry}")
    (taken,) = meshes.take_meshes(tmp_path)
    assert taken.body.label == HEAVY
    aside = taken.body.vertices - OURS["city_bus"].vertices
    assert np.allclose(
        aside, [-0.105, 0, 0], atol=2e-3
    )  # its mirrors stick out to the front as well, and stay in
    assert taken.file == "sub/x1.ply"
    said = "heavy (as meshes.toml says), 12.21 x 2.59 x 3.19 m, y up, z forward, scaled by 0.0254"
    assert taken.how == f"{said}, mirrors left out of its box"


def test_entries_of_a_table_are_read(tmp_path):
    assert meshes.read_mesh_table(tmp_path) == {}
    assert not meshes.MeshEntry().has_frame
    assert np.array_equal(meshes.MeshEntry().turn, np.eye(3))
    text = '[[mesh]]\nfile = "a.obj"\nlabel = "heavy"\nup = "y"\nforward = "-z"\nscale = 0.0254\n'
    (read,) = table_mesh_table(tmp_path, text).values()
    assert read == meshes.MeshEntry(HEAVY, "y", "-z", 0.0254)
    assert read.has_frame
    assert np.allclose(read.turn @ [1, 2, 3], [-3, -1, 2])  # forward, left, up


def test_every_pair_of_axes_is_a_rotation():
    for up, forward in product(("x", "y", "z", "-x", "-y", "-z"), repeat=2):
        if up[-1] != forward[-1]:
            turn = meshes.MeshEntry(up=up, forward=forward).turn
            assert np.linalg.det(turn) == pytest.approx(1)
            assert np.array_equal(turn @ turn.T, np.eye(3))


def test_fleets_of_meshes_leave_mirrors_out_of_their_boxes_and_draw_what_the_folder_has_none_of(
    tmp_path,
):
    write(tmp_path / "a.ply", OURS["compact_suv"])
    fleet = fleet_named("meshes", tmp_path)
    (suv,) = fleet.fixed
    assert suv.size[1] == pytest.approx(1.79, abs=0.01)
    assert np.ptp(suv.vertices, axis=0)[1] == pytest.approx(1.97, abs=0.01)
    assert fleet.drawn == (CYCLIST, PEDESTRIAN, HEAVY)
    assert "mirrors left out of its box" in fleet.notes[0]


def test_fleets_with_mirrors_have_them_in_their_boxes(tmp_path):
    write(tmp_path / "a.ply", OURS["compact_suv"])
    assert fleet_named("meshes", tmp_path, mirrors=True).fixed[0].size[1] == pytest.approx(
        1.97, abs=0.01
    )
    assert fleet_named("both", tmp_path).drawn == (VEHICLE, CYCLIST, PEDESTRIAN, HEAVY)
    assert fleet_named("catalogue", tmp_path).fixed[-1].size[1] == pytest.approx(1.79, abs=0.01)
    assert fleet_named("catalogue", tmp_path, mirrors=True).fixed[-1].truth is None
    assert fleet_named("catalogue", mirrors=True).fixed[0].truth is None


def test_bodies_of_a_class_are_those_of_the_folder(tmp_path):
    write(tmp_path / "a.ply", OURS["compact_suv"])
    fleet = fleet_named("meshes", tmp_path)
    bodies = fleet.bodies(1, np.random.default_rng(0))
    assert {body.name for body in bodies if body.label == VEHICLE} == {"a"}


ON_ITS_SIDE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def shape_of(mesh, turn=None):
    vertices = np.asarray(mesh.vertices, np.float64) @ (np.eye(3) if turn is None else turn).T
    return meshes.measure_shape(Mesh(vertices, np.asarray(mesh.triangles, np.int64)))


def elephant_mesh(length=4.4, width=1.8, height=1.7):
    """A trunk, head, ears, and four legs under a belly."""
    legs = [tube([(x, y, 0), (x, y, 0.9)], 0.2, 8) for x in (-0.9, 0.9) for y in (-0.45, 0.45)]
    ears = [ellipsoid((1.5, y, 1.8), (0.1, 0.4, 0.5)) for y in (0.7, -0.7)]
    body, head = ellipsoid((0, 0, 1.3), (1.5, 0.8, 0.7)), ellipsoid((1.7, 0, 1.7), (0.6, 0.5, 0.5))
    mesh = merge(
        [body, head, *legs, tube([(2.2, 0, 1.6), (2.7, 0, 0.8), (2.8, 0, 0.2)], 0.15), *ears]
    )
    return Mesh(
        mesh.vertices * (np.array([length, width, height]) / np.ptp(mesh.vertices, axis=0)),
        mesh.triangles,
    )


def table():
    legs = [box((0.06, 0.06, 0.75), (x, y, 0.375)) for x in (-0.8, 0.8) for y in (-0.4, 0.4)]
    return merge([box((1.8, 0.9, 0.05), (0, 0, 0.75)), *legs])


def horse():
    legs = [tube([(x, y, 0), (x, y, 1.0)], 0.07, 6) for x in (-0.6, 0.6) for y in (-0.2, 0.2)]
    return merge(
        [
            ellipsoid((0, 0, 1.2), (0.9, 0.3, 0.35)),
            ellipsoid((1.1, 0, 1.7), (0.3, 0.12, 0.2)),
            *legs,
        ]
    )


@pytest.mark.parametrize(
    ("names", "label"),
    [
        (["family_sedan", "large_suv", "double_cab_pickup", "coupe", "delivery_van"], VEHICLE),
        *((["city_bus", "box_truck"], HEAVY), (["city_bicycle", "motorcycle"], CYCLIST)),
        (["man_standing", "man_striding"], PEDESTRIAN),
    ],
)
def test_each_is_clearly_what_it_is(names, label):
    for shape in (shape_of(OURS[name]) for name in names):
        assert [each for each in range(4) if meshes.is_clearly(shape, each)] == [label]
        assert meshes.find_wrong_stand(shape, label) is None


@pytest.mark.parametrize(
    "mesh",
    [
        *(
            elephant_mesh(),
            elephant_mesh(6.0, 2.4, 3.2),
            elephant_mesh(3.2, 1.5, 1.45),
            table(),
            horse(),
        ),
        *(
            box((0.6, 0.6, 1.8)),
            box((0.5, 0.5, 0.9)),
            ellipsoid((0, 0, 1), (2.2, 0.9, 0.75), 12, 16),
        ),
    ],
    ids=["calf", "elephant", "small_elephant", "table", "horse", "wardrobe", "stool", "egg"],
)
def test_animals_and_furniture_are_clearly_nothing(mesh):
    assert not [LABELS[label] for label in range(4) if meshes.is_clearly(shape_of(mesh), label)]


def test_wrong_stands_are_found():
    for turn, says in (
        *(
            (ON_ITS_SIDE, "lies on its side"),
            (np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), "stands across"),
        ),
        (np.diag([-1.0, -1, 1]), "face backwards"),
    ):
        shape = shape_of(OURS["compact_hatchback"], turn)
        assert says in str(meshes.find_wrong_stand(shape, VEHICLE))
        assert says == "face backwards" or not meshes.is_clearly(shape, VEHICLE)
    lying = shape_of(OURS["man_standing"], np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]))
    assert "lies" in str(meshes.find_wrong_stand(lying, PEDESTRIAN))


def test_a_box_has_its_measures():
    shape = shape_of(box((4.0, 2.0, 1.0), (7, 8, 9)))
    assert np.allclose(shape.size, [4, 2, 1])
    assert (shape.fills == 1).all()
    assert (shape.asymmetry < 1e-6).all()
    assert shape.stance == pytest.approx((4, 2), abs=0.05)
    assert shape.clearance == pytest.approx(0)
    assert shape.ahead == pytest.approx(0, abs=1e-6)


def test_points_are_spread_by_area():
    two = merge([box((1.0, 1.0, 1.0)), box((2.0, 2.0, 2.0), (5, 0, 0))])
    points = meshes.surface_points(two)
    assert (points[:, 0] > 3).mean() == pytest.approx(0.8, abs=0.01)


def test_widths_without_mirrors_are_those_of_drawn_bodies():
    # Drawn bodies know how wide they are without them: an oracle.
    for number in range(40):
        body = draw_body(VEHICLE, np.random.default_rng([11, number]))
        whole = include_mirrors(body)
        span = meshes.mirror_span(
            Mesh(whole.vertices.astype(np.float64), whole.triangles.astype(np.int64))
        )
        width = whole.size[1] if span is None else span[1] - span[0]
        assert width == pytest.approx(body.size[1], abs=0.03), body.name


def table_mesh_table(folder: Path, text: str) -> dict[Path, meshes.MeshEntry]:
    (folder / "a.obj").touch()
    (folder / "meshes.toml").write_text(text, errors="surrogateescape")
    return meshes.read_mesh_table(folder)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        *((f"a = {'[' * 9999}", "nested too deep"), ("a" + 999 * ".a", "more than 300 dots")),
        *(("a = " + "9" * 400, "hundreds of digits"), ("\udcff", "not a text file")),
        *(("[[mesh", "not TOML"), ("mesh = 3", r"must hold \[\[mesh\]\] entries alone")),
        ('[other]\nx = 1\n[[mesh]]\nfile = "a.obj"', "entries alone"),
        ("mesh = [1]", "entry 1: file must name a mesh"),
        ('[[mesh]]\nfile = "b.obj"', "file must name a mesh below .*, got 'b.obj'"),
        ('[[mesh]]\nfile = "a.obj"\n[[mesh]]\nfile = "a.obj"', "entry 2: a.obj is there twice"),
        (
            '[[mesh]]\nfile = "a.obj"\ncolour = 1',
            "knows file, forward, label, scale, up, got colour",
        ),
        ('[[mesh]]\nfile = "a.obj"\nlabel = "tram"', "entry 1: label must be one of"),
        ('[[mesh]]\nfile = "a.obj"\nlabel = [1]', "entry 1: label must be one of"),
        (
            '[[mesh]]\nfile = "a.obj"\nup = "north"',
            "up must be one of x, -x, y, -y, z, -z, got 'north'",
        ),
        ('[[mesh]]\nfile = "a.obj"\nup = [1]', "up must be one of"),
        ('[[mesh]]\nfile = "a.obj"\nup = "x"', "up x and forward x lie on one axis"),
        ('[[mesh]]\nfile = "a.obj"\nscale = 0', "scale must be a number above 0"),
        ('[[mesh]]\nfile = "a.obj"\nscale = nan', "scale must be a number above 0"),
        ('[[mesh]]\nfile = "a.obj"\nscale = true', "scale must be a number above 0"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path, text, says):
    with pytest.raises(ValueError, match=says) as error:
        table_mesh_table(tmp_path, text)
    assert "meshes.toml" in str(error.value)
