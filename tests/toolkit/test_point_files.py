import warnings

import numpy as np
import open3d as o3d
import pytest

from toolkit.clouds import attributes, from_attributes
from toolkit.point_columns import name_attributes
from toolkit.point_files.lzf import decompress_lzf
from toolkit.point_files.pcd import read_pcd
from toolkit.point_files.ply import read_ply

RNG = np.random.default_rng(0)
MADE: dict[str, np.ndarray] = {
    "positions": RNG.normal(0, 9, (500, 3)).astype(np.float32),
    "normals": RNG.normal(size=(500, 3)).astype(np.float32),
    "colors": RNG.integers(0, 256, (500, 3)).astype(np.uint8),
    "intensity": RNG.random((500, 1)).astype(np.float32),
    "ring": (np.arange(500)[:, None] // 8).astype(np.uint16),
    "sensor": np.zeros((500, 1), np.int32),
}


def header(fields, points, data):
    names, kinds, sizes, counts = zip(*fields, strict=True)
    rows = [("FIELDS", names), ("SIZE", sizes), ("TYPE", kinds), ("COUNT", counts)]
    text = "\n".join(f"{key} {' '.join(map(str, values))}" for key, values in rows)
    return f"# .PCD\nVERSION 0.7\n{text}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {data}\n".encode()


@pytest.mark.parametrize("way", [{"write_ascii": True}, {"compressed": True}, {}])
def test_what_open3d_writes_is_read_as_it_was(tmp_path, way):
    o3d.t.io.write_point_cloud(tmp_path / "a.pcd", from_attributes(MADE), **way)
    read = read_pcd(tmp_path / "a.pcd")
    assert read.keys() == MADE.keys()
    for name, column in MADE.items():
        np.testing.assert_allclose(read[name], column, rtol=1e-6)
        assert read[name].dtype == column.dtype


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
def test_two_paddings_of_one_name(tmp_path, kind):
    """As PCL and ROS write them; Open3D's reader writes past the end of its memory here."""
    fields = [
        *(("x", "F", 4, 1), ("y", "F", 4, 1), ("z", "F", 4, 1), ("_", "U", 1, 4)),
        *(("intensity", "F", 4, 1), ("t", "U", 4, 1), ("_", "U", 1, 24)),
    ]
    rows = np.zeros(
        90, [(f"{k}", f"<{c.lower()}{size}", count) for k, (_, c, size, count) in enumerate(fields)]
    )
    for k in (0, 1, 2, 4, 5):
        rows[f"{k}"] = np.arange(90)[:, None] * (k + 1)
    if kind == "ascii":
        body = "\n".join(
            " ".join(str(value) for value in np.hstack([*row])) for row in rows.tolist()
        ).encode()
    else:
        body = rows.tobytes()
    if kind == "binary_compressed":
        plain = b"".join(rows[name].tobytes() for name in rows.dtype.names)
        packed = b"".join(
            bytes([len(plain[i : i + 32]) - 1]) + plain[i : i + 32]
            for i in range(0, len(plain), 32)
        )
        body = np.array([len(packed), len(plain)], "<u4").tobytes() + packed
    (tmp_path / "a.pcd").write_bytes(header(fields, 90, kind) + body)
    read = read_pcd(tmp_path / "a.pcd")
    np.testing.assert_array_equal(read["positions"], np.arange(90)[:, None] * [1.0, 2, 3])
    np.testing.assert_array_equal(read["intensity"][:, 0], np.arange(90) * 5.0)
    assert read["t"].dtype == np.uint32
    assert read.keys() == {"positions", "intensity", "t"}


@pytest.mark.parametrize("kind", ["ascii", "binary"])
def test_a_field_of_no_numbers_is_none(tmp_path, kind):
    fields = [
        ("x", "F", 4, 1),
        ("y", "F", 4, 1),
        ("z", "F", 4, 1),
        ("rgb", "F", 4, 0),
        ("i", "U", 1, 1),
    ]
    body = b"1 2 3 7\n4 5 6 8\n"
    if kind == "binary":
        rows = np.array([(1, 2, 3, 7), (4, 5, 6, 8)], "<f4,<f4,<f4,u1")
        body = rows.tobytes()
    (tmp_path / "a.pcd").write_bytes(header(fields, 2, kind) + body)
    read = read_pcd(tmp_path / "a.pcd")
    assert read["positions"].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert [
        sorted(each.ravel().tolist()) for name, each in read.items() if name != "positions"
    ] == [[7, 8]]


def test_columns_are_taken_apart_or_empty(tmp_path):
    assert decompress_lzf(bytes([2, 1, 2, 3, 0x20 | 0, 2]), 6) == bytes([1, 2, 3, 1, 2, 3])
    assert decompress_lzf(bytes([0, 7, 0xE0, 255, 0]), 265) == bytes([7] * 265)
    for packed, size in (([5, 1], 6), ([0x20, 9], 3), ([0, 1], 2), ([0, 7, 0xE0, 255, 0], 9)):
        with pytest.raises(ValueError, match="damaged"):
            decompress_lzf(bytes(packed), size)
    word = np.array([0xFF8001, 0, 0x0000FF, 0x010203], np.uint32)
    for column in (word, word.view(np.float32), word[:, None]):
        colours = name_attributes({**AXES, "rgb": column})["colors"]
        assert colours.tolist() == [[255, 128, 1], [0, 0, 0], [0, 0, 255], [1, 2, 3]]
    made = name_attributes(
        {**{axis: np.arange(4) for axis in "xyz"}, "word": np.array(["a"] * 4), "t": np.arange(4)}
    )
    assert made.keys() == {"positions", "t"}
    assert made["positions"].dtype == np.float64
    for kind in ("ascii", "binary", "binary_compressed"):
        (tmp_path / "a.pcd").write_bytes(header(XYZ, 0, kind))
        assert read_pcd(tmp_path / "a.pcd")["positions"].shape == (0, 3)
    assert "positions" in attributes(from_attributes(read_pcd(tmp_path / "a.pcd")))


XYZ = [("x", "F", 4, 1), ("y", "F", 4, 1), ("z", "F", 4, 1)]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *((b"junk", "no line DATA"), (header(XYZ[:2], 1, "binary") + bytes(8), "no column z")),
        (header([*XYZ, ("x", "F", 4, 1)], 1, "binary") + bytes(16), "one name"),
        (header([*XYZ, ("f", "F", 2, 1)], 1, "binary") + bytes(14), "TYPE and SIZE"),
        (header(XYZ, 10**12, "binary") + bytes(12), "cut off, 12 of"),
        (header(XYZ, 2, "ascii") + b"1 2 3", "cut off, 1 of 2"),
        (header(XYZ, 1, "ascii") + b"1 2 north", "not a number"),
        (
            header(XYZ, 9000, "ascii") + b"1 2 3\n" * 8999 + b"1 2 x" + b"y" * 3_000_000,
            "not a number",
        ),
        (header(XYZ, 1, "ascii") + b"1 2 3\n4 5 6", "2 of 1 rows"),
        (header(XYZ, 1, "binary") + bytes(24), "says 1 points, 12 bytes, but 24"),
        (
            header(XYZ, 1, "ascii").replace(b"POINTS 1", b"POINTS 9") + b"1 2 3",
            "one number of points",
        ),
        (header(XYZ, 1, "zip") + bytes(12), "DATA must be"),
        (
            header(XYZ, 1, "binary_compressed") + np.array([4, 99], "<u4").tobytes() + bytes(4),
            "take 12 bytes, but 99",
        ),
        (
            header(XYZ, 1, "binary_compressed") + np.array([4, 12], "<u4").tobytes() + bytes(4),
            "are damaged",
        ),
    ],
)
def test_damage_is_one_line(tmp_path, content, says):
    (tmp_path / "a.pcd").write_bytes(content)
    with pytest.raises(ValueError, match=says) as error:
        read_pcd(tmp_path / "a.pcd")
    assert "\n" not in str(error.value)


def test_a_viewpoint_is_not_applied_and_that_is_said(tmp_path):
    content = header(XYZ, 1, "binary") + bytes(12)
    for said, warned in (
        ("0 0 0 1 0 0 0", 0),
        ("0.0 -0 0 1.00 0 0 0", 0),
        ("1 2 3 1 0 0 0", 1),
        ("0 0 0 0 1 0 0", 1),
    ):
        (tmp_path / "a.pcd").write_bytes(
            content.replace(b"DATA", f"VIEWPOINT {said}\nDATA".encode())
        )
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            read_pcd(tmp_path / "a.pcd")
        assert len(caught) == warned, said


AXES = {axis: np.arange(4.0) for axis in "xyz"}


@pytest.mark.parametrize("names", [("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz")])
def test_normals_have_the_type_of_positions(names):
    made = name_attributes(
        {axis: column.astype(np.float32) for axis, column in AXES.items()}
        | dict.fromkeys(names, AXES["x"])
    )
    assert made["normals"].shape == (4, 3)
    assert made["normals"].dtype == made["positions"].dtype == np.float32


LISTS = "element face 2\nproperty list uchar int corners\nelement camera 1\nproperty double f\n"
LISTED = {
    ">": b"\1" + bytes(4) + b"\2" + bytes(16),
    "<": b"\1" + bytes(4) + b"\2" + bytes(16),
    "": b"1 7\n2 7 7\n0.5\n",
}
PLY_NAMES = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}


def ply(order, before="", count=2, newline="\n"):
    """Header of points x, y, z, intensity."""
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    points = f"element vertex {count}\n{axes}property uchar intensity\nend_header\n"
    return f"ply\nformat {PLY_NAMES[order]} 1.0\n{before}{points}".replace("\n", newline).encode()


def ply_rows(order):
    if not order:
        return b"0 1 2 7\n4 5 6 8\n"
    rows = np.zeros(2, [("xyz", f"{order}f4", 3), ("intensity", "u1")])
    rows["xyz"], rows["intensity"] = [[0, 1, 2], [4, 5, 6]], [7, 8]
    return rows.tobytes()


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("before", ["", f"comment {'x' * 3000}\n", LISTS])
def test_ply_of_every_order_with_what_stands_before_its_points(tmp_path, order, newline, before):
    """A long comment ended the process in Open3D, an element before the points became points."""
    listed = LISTED[order] if before == LISTS else b""
    (tmp_path / "a.ply").write_bytes(ply(order, before, newline=newline) + listed + ply_rows(order))
    read = read_ply(tmp_path / "a.ply")
    assert read["positions"].tolist() == [[0, 1, 2], [4, 5, 6]]
    assert read["positions"].dtype == np.float32
    assert read["intensity"].tolist() == [[7], [8]]


@pytest.mark.parametrize("way", [{"write_ascii": True}, {}])
def test_ply_of_open3d_is_read_as_it_was(tmp_path, way):
    o3d.t.io.write_point_cloud(tmp_path / "a.ply", from_attributes(MADE), **way)
    read = read_ply(tmp_path / "a.ply")
    for name in ("positions", "normals", "colors", "intensity", "sensor"):
        np.testing.assert_allclose(read[name], MADE[name], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *((b"ply", "no header"), (ply("") + b"0 1 2 7\n4 north 6 8\n", "not a number")),
        *((ply("") + b"0 1 2 7\n", "cut off, 1 of 2"), (ply("") + b"0 1 2 7\n" * 3, "3 of 2 rows")),
        *(
            (ply("") + b"0 1 2 300\n" * 2, "does not fit"),
            (ply("<") + bytes(25), "cut off, 25 of 26"),
        ),
        *(
            (ply("<") + bytes(99), "2 points, 26 bytes, but 99"),
            (ply("", count="many"), "whole numbers"),
        ),
        *((ply("<", count=10**15), "cut off"), (ply("<", LISTS) + b"\xff" + bytes(9), "cut off")),
        *(
            (ply("<", LISTS.replace("face 2", "face 9999999")), "points first"),
            (ply("", count=-1), "no count below"),
        ),
        *(
            (ply("<").replace(b"float z", b"float w"), "x, y and z"),
            (ply("<").replace(b"uchar", b"half"), "unknown type"),
        ),
        (ply("<", "element camera 1\n" + "property char c\n" * 2000), "more than 1000 properties"),
    ],
)
def test_damaged_ply_is_one_line(tmp_path, content, says):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(ValueError, match=says) as error:
        read_ply(tmp_path / "a.ply")
    assert "\n" not in str(error.value)
