import json

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, strategies as st

from toolkit.clouds import attributes, from_attributes, from_points, positions, save, sensor_numbers
from toolkit.datasets import cloud_files, feather_files, pose_files
from toolkit.geometry import invert, pose, transform
from toolkit.runtime import array_files

POINTS = np.random.default_rng(0).uniform(-50, 50, (40, 3)).astype(np.float32).astype(np.float64)
POSES = [pose(5e5, 5.4e6, 300.0, yaw=1.0), pose(5e5 + 30, 5.4e6, 305.0, yaw=-2.0, pitch=0.1)]


def write(path):
    extra = np.full((len(POINTS), 2), 0.5)
    name = path.name
    if name.endswith((".ply", ".pcd", ".npz")):
        save(from_points(POINTS), path)
    elif name.endswith(".npy"):
        np.save(path, np.hstack([POINTS, extra]))
    elif name.endswith(".bin"):
        columns = 2 if name.endswith(".pcd.bin") else 1
        np.hstack([POINTS, extra[:, :columns]]).astype("<f4").tofile(path)
    elif name.endswith(".feather"):
        pyarrow = pytest.importorskip("pyarrow")
        from pyarrow import feather

        feather.write_feather(pyarrow.table(dict(zip("xyz", POINTS.T, strict=True))), path)
    else:
        separator = ", " if name.endswith(".csv") else " "
        lines = [separator.join(map(repr, map(float, row))) for row in np.hstack([POINTS, extra])]
        path.write_text("\n".join(["# x y z and more", *lines, ""]))
    return path


ENDINGS = ["ply", "pcd", "npz", "xyz", "txt", "csv", "npy", "bin", "pcd.bin", "feather"]


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_format_gives_the_same_points(tmp_path, ending):
    points = cloud_files.read_points(write(tmp_path / f"a.{ending}"))
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, POINTS)


def test_points_of_no_number_or_none_at_all(tmp_path):
    np.save(tmp_path / "a.npy", [[1, 2, 3], [np.nan, 0, 0], [0, np.inf, 0]])
    assert cloud_files.read_points(tmp_path / "a.npy").tolist() == [[1, 2, 3]]
    world = POINTS + POSES[0][:3, 3]
    paths = []
    for k, world_SE3_sensor in enumerate(POSES):
        paths.append(tmp_path / f"station{k}.npy")
        np.save(paths[-1], transform(invert(world_SE3_sensor), world))
    fused = cloud_files.fuse_files(paths, POSES)
    np.testing.assert_allclose(positions(fused), np.tile(world, (2, 1)), atol=1e-6, rtol=0)
    assert sensor_numbers(fused).tolist() == [0] * 40 + [1] * 40
    header = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 0\nHEIGHT "
        "1\nPOINTS 0\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_text(header)
    (tmp_path / "a.bin").write_bytes(b"")
    for name in ("a.pcd", "a.bin"):
        assert cloud_files.read_points(tmp_path / name).shape == (0, 3)


def numbers(pose, form):
    return {"4x4": pose.tolist(), "16": pose.ravel().tolist(), "12": pose[:3].ravel().tolist()}[
        form
    ]


@pytest.mark.parametrize("form", ["4x4", "16", "12"])
def test_pose_files_in_json(tmp_path, form):
    one, other = (numbers(p, form) for p in POSES)
    for content, names in (
        ({"north": one, "south": other}, ["north", "south"]),
        ([one, other], ["0", "1"]),
        (one, ["0"]),
    ):
        (tmp_path / "poses.json").write_text(json.dumps(content))
        poses = pose_files.read_poses(tmp_path / "poses.json")
        assert list(poses) == names
        for found, expected in zip(poses.values(), POSES, strict=False):
            np.testing.assert_allclose(found, expected)


def test_pose_files_in_text(tmp_path):
    file = tmp_path / "poses.txt"

    def text(row):
        return " ".join(map(repr, map(float, row)))

    for content, names in (
        *(
            ("\n".join(text(row) for row in POSES[0]), ["0"]),
            ("\n".join(text(row) for row in POSES[0][:3]), ["0"]),
        ),
        ("# KITTI\n" + "\n\n".join(text(p[:3].ravel()) for p in POSES), ["0", "1"]),
        (
            "\n".join(f"{name} {text(p.ravel())}" for name, p in zip("ab", POSES, strict=True)),
            ["a", "b"],
        ),
    ):
        file.write_text(content)
        poses = pose_files.read_poses(file)
        assert list(poses) == names
        np.testing.assert_allclose(poses[names[0]], POSES[0])
    file.write_text("up 1 0 0 0 7 8 9")
    np.testing.assert_allclose(pose_files.read_poses(file)["up"], pose(7.0, 8.0, 9.0))
    np.testing.assert_allclose(
        pose_files.read_poses(file, inverted=True)["up"], pose(-7.0, -8.0, -9.0)
    )


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternions_turn_as_the_quaternion_product_does(quaternion):
    w, *vector = np.array(quaternion) / np.linalg.norm(quaternion)
    matrix = pose_files.quaternion_pose(np.array([w, *vector]), np.zeros(3))[:3, :3]
    for axis in np.eye(3):
        turned = axis + 2 * np.cross(vector, np.cross(vector, axis) + w * axis)
        np.testing.assert_allclose(matrix @ axis, turned, atol=1e-12)


def test_poses_are_matched_by_name_or_place_one_for_each_file(tmp_path):
    poses = {"b": POSES[1], "a": POSES[0]}
    assert [
        p is q
        for p, q in zip(pose_files.match_poses(["x/a.ply", "b.pcd.bin"], poses), POSES, strict=True)
    ] == [True, True]
    assert pose_files.match_poses(["a.ply"], {"0": POSES[1]})[0] is POSES[1]
    with pytest.raises(ValueError, match="files a, c, poses b, a"):
        pose_files.match_poses(["a.ply", "c.ply"], poses)
    with pytest.raises(ValueError, match="cannot tell which pose"):
        pose_files.match_poses(["north/7.ply", "south/7.ply"], {"7": POSES[0], "b": POSES[1]})
    assert (
        pose_files.match_poses(["2024.01.05.pcd"], {"2024.01.05": POSES[0], "b": POSES[1]})[0]
        is POSES[0]
    )
    clouds = [tmp_path / "a.ply", tmp_path / "b.ply"]
    for name, content in (("a", [POSES[0]]), ("b", [POSES[1]]), ("all", POSES)):
        (tmp_path / f"{name}.json").write_text(json.dumps([p.tolist() for p in content]))
    for files in (["a.json", "b.json"], ["all.json"]):
        np.testing.assert_allclose(
            pose_files.load_poses(clouds, [tmp_path / file for file in files]), POSES
        )
    with pytest.raises(ValueError, match="2 files of one pose each"):
        pose_files.load_poses(clouds, [tmp_path / "a.json", tmp_path / "all.json"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *(("", "empty"), ("1 2 3", "16, 12 or 7 numbers"), ("a b c d e f g", "must be numbers")),
        *(
            ("2 0 0 0 0 0 0", "length 1"),
            ("1 0 0 0  0 2 0 0  0 0 1 0", "rotation"),
            ("1 0 0 0 nan 0 0", "NaN"),
        ),
        *(
            ("nan 0 0 0 0 0 0", r"pose '0' of .*poses\.txt"),
            ("a 1 0 0 0 0 0 0\na 1 0 0 0 5 0 0", "one name"),
        ),
    ],
)
def test_bad_pose_files_say_what_is_wrong(tmp_path, content, message):
    (tmp_path / "poses.txt").write_text(content)
    with pytest.raises(ValueError, match=message):
        pose_files.read_poses(tmp_path / "poses.txt")
    with pytest.raises(ValueError, match=r"must be numbers, got .10{57}"):
        pose_files.parse_pose([10**400, 0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("content", ["{", "3", "[]", '{"a": "b"}', '[{"x": 1}]', "[[1, 2], [3]]"])
def test_bad_json_says_what_is_wrong(tmp_path, content):
    (tmp_path / "poses.json").write_text(content)
    with pytest.raises(ValueError, match=r"poses\.json"):
        pose_files.read_poses(tmp_path / "poses.json")


def test_bad_cloud_files_say_what_is_wrong_and_need_a_pose_each(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such cloud file"):
        cloud_files.read_points(tmp_path / "a.ply")
    for name, content, message in (
        *(("a.e57", b"x", r"ends in \.ply"), ("a.bin", b"12345", "5 bytes")),
        *(
            ("a.npy", b"12345", r"cannot be read as \.npy array"),
            ("a.feather", b"12345", "no feather file"),
        ),
        *(("a.xyz", b"1 2\n", "x y z in every row"), ("b.xyz", b"1 2 x\n", "x y z in every row")),
        *(("a.ply", b"ply", "no points"), ("a.npz", b"junk", r"cannot be read as \.npy array")),
        ("two-columns.csv", b"1,2\n3,4\n5,6\n", "x y z in every row"),
        *(
            ("b.csv", b"1,5 2,5 3,5\n", "decimal commas"),
            ("c.csv", b"10 2,5\t3,5\n", "decimal commas"),
        ),
        *(
            ("d.csv", b"x,y,z\n1,5,2,5,3,5\n", "as many cells"),
            ("e.csv", b"1 2 3\n1 2 3 4\n", "as many cells"),
        ),
        ("f.xyz", b"nan nan nan\n1 2 inf\n", "none of its 2 points"),
        (
            "millimetres.xyz",
            b"\n".join(b"%d %d 0" % (k * 1000, k * 900) for k in range(-50, 50)),
            "give metres",
        ),
        ("empty-cell.csv", b"1,,3,4\n", "x y z in every row"),
        ("binary.csv", b"\xff\xfe\x00", r"binary\.csv: not a text file"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=message):
            cloud_files.read_points(tmp_path / name)
    rows = np.random.default_rng(0).normal(0, 20, (400, 4)).astype("<f4")
    rows[:, 3] = 0.5
    for name, array, message in (
        *(("doubles.bin", rows.astype("<f8"), "below 0"), ("three.bin", rows[:, :3], "below 0")),
        *(
            ("five.bin", np.column_stack([rows, rows[:, 0]]), "below 0"),
            ("whole.bin", rows.astype("<i4"), "no places"),
        ),
        ("swapped.bin", np.abs(rows).astype(">f4"), "no places|half of its points|below 0"),
    ):
        (tmp_path / name).write_bytes(np.ascontiguousarray(array).tobytes())
        with pytest.raises(ValueError, match=message):
            cloud_files.read_points(tmp_path / name)
    np.save(tmp_path / "b.npy", rows[:, :3].T)
    with pytest.raises(ValueError, match="transpose"):
        cloud_files.read_points(tmp_path / "b.npy")
    np.save(tmp_path / "b.npy", np.zeros(7))
    with pytest.raises(ValueError, match="rows of x y z"):
        cloud_files.read_points(tmp_path / "b.npy")
    with pytest.raises(ValueError, match="2 poses"):
        cloud_files.fuse_files([tmp_path / "a.ply"], POSES)
    assert pose_files.parse_pose(np.eye(4)).shape == (4, 4)


@pytest.mark.parametrize(
    "content",
    [
        *(
            "x,y,z,intensity\n1,2,3,9\n",
            "\ufefft;X;Y;Z\n0;1;2;3\n",
            "//X Y Z\n1 2 3\n",
            '"t","z","y","x"\n0,3,2,1\n',
        ),
        "1 , 2,3,\n",
    ],
)
def test_text_with_a_header_is_read_by_its_columns(tmp_path, content):
    (tmp_path / "a.csv").write_text(content, encoding="utf-8")
    assert cloud_files.read_points(tmp_path / "a.csv").tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("ascii", [False, True])
def test_a_ply_that_is_cut_off_is_refused(tmp_path, ascii):
    o3d.t.io.write_point_cloud(tmp_path / "a.ply", from_points(POINTS), write_ascii=ascii)
    assert len(cloud_files.read_points(tmp_path / "a.ply")) == len(POINTS)
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(ValueError, match="cut off"):
        cloud_files.read_points(tmp_path / "a.ply")


def test_fused_files_keep_what_all_have_in_named_columns(tmp_path):
    normals = np.tile(np.float32([1, 0, 0]), (40, 1))
    whole: dict[str, np.ndarray] = {
        "positions": POINTS,
        "normals": normals,
        "intensity": np.arange(40.0)[:, None],
    }
    save(from_attributes({**whole, "ring": np.ones((40, 1), np.uint16)}), tmp_path / "a.pcd")
    save(from_attributes(whole), tmp_path / "b.ply")
    with pytest.warns(UserWarning, match="drops ring"):
        fused = attributes(cloud_files.fuse_files([tmp_path / "a.pcd", tmp_path / "b.ply"], POSES))
    np.testing.assert_array_equal(fused["intensity"][:, 0], np.tile(np.arange(40.0), 2))
    np.testing.assert_allclose(fused["normals"][:40], np.tile(POSES[0][:3, 0], (40, 1)), atol=1e-6)
    np.testing.assert_allclose(fused["normals"][40:], np.tile(POSES[1][:3, 0], (40, 1)), atol=1e-6)
    (tmp_path / "a.csv").write_text("t,x,y,z,r,g,b,word\n7,1,2,3,255,0,9,car\n8,4,5,6,1,2,3,bus\n")
    np.hstack([POINTS, np.arange(40)[:, None], np.ones((40, 1))]).astype("<f4").tofile(
        tmp_path / "a.pcd.bin"
    )
    text, scan = (
        attributes(cloud_files.fuse_files([tmp_path / name], [np.eye(4)]))
        for name in ("a.csv", "a.pcd.bin")
    )
    assert text["t"][:, 0].tolist() == [7, 8]
    assert text["colors"].tolist() == [[255, 0, 9], [1, 2, 3]]
    assert text["colors"].dtype == np.uint8
    assert "word" not in text
    assert scan["intensity"][:, 0].tolist() == list(range(40))
    assert set(scan) == {"positions", "sensor", "intensity", "ring"}


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a": ' * 100_000, "[" + "1" * 9000 + "]"])
def test_deep_and_endless_json_is_refused_in_one_line(tmp_path, content):
    (tmp_path / "poses.json").write_text(content)
    with pytest.raises(
        ValueError, match=r"poses\.json holds no poses: (its lists|it has a number)"
    ) as error:
        pose_files.read_poses(tmp_path / "poses.json")
    assert "\n" not in str(error.value)


def test_a_table_that_unpacks_to_gigabytes_is_refused(tmp_path, limits):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import feather

    columns = [("x", np.zeros(1 << 20)), ("y", np.zeros(1 << 20)), ("z", np.zeros(1 << 20))]
    compressions = ("zstd", "lz4", "uncompressed")
    for compression in compressions:
        path = tmp_path / f"{compression}.feather"
        feather.write_feather(pyarrow.table(dict(columns)), path, compression=compression)
        assert len(feather_files.read_table(path)["x"]) == 1 << 20
    usual = array_files.MAX_CLOUD_BYTES
    limits(array_files, MAX_CLOUD_BYTES=20 << 20)
    for compression in compressions:
        with pytest.raises(ValueError, match=rf"{compression}\.feather .* unpacks to"):
            feather_files.read_table(tmp_path / f"{compression}.feather")
    limits(array_files, MAX_CLOUD_BYTES=usual)
    nothing = pyarrow.nulls(1 << 30)
    feather.write_feather(
        pyarrow.table({"x": nothing}),
        tmp_path / "a.feather",
        compression="uncompressed",
        chunksize=1 << 30,
    )
    for content in (
        (tmp_path / "a.feather").read_bytes(),
        (tmp_path / "a.feather").read_bytes()[:-9],
    ):
        (tmp_path / "a.feather").write_bytes(content)
        with pytest.raises(ValueError, match=r"unpacks to 8\.0 GiB|cut off"):
            feather_files.read_table(tmp_path / "a.feather")


def test_points_of_no_return_are_not_fused(tmp_path):
    np.savetxt(tmp_path / "a.xyz", np.concatenate([POINTS, np.zeros((5, 3))]))
    with pytest.warns(UserWarning, match="a.xyz: 5 points at 0 0 0, of no return, are left out"):
        fused = cloud_files.fuse_files([tmp_path / "a.xyz"], [POSES[0]])
    assert len(positions(fused)) == len(POINTS)


def test_commas_that_may_be_decimal_are_told(tmp_path):
    (tmp_path / "a.csv").write_text("1,5,2,5,3,5\n" * 3)
    with pytest.warns(
        UserWarning, match=r"a.csv: all numbers are whole: if its commas are decimal"
    ):
        cloud_files.read_points(tmp_path / "a.csv")
    for sound in ("x,y,z,r,g,b\n1,5,2,5,3,5\n", "1,5,2,5,3,5.0\n", "1,5,2,5\n", "1 5 2 5 3 5\n"):
        (tmp_path / "a.csv").write_text(sound)
        assert cloud_files.read_points(tmp_path / "a.csv").tolist() == [[1, 5, 2]]
