"""What coview writes, read by each format's rules and nothing of coview's readers: corners of
boxes, points, times.

Each reader here follows the format's development kit: KITTI's `computeBox3D.m`, the nuScenes
devkit's `Box.corners`, Argoverse 2's `Cuboid.vertices_m`, OpenCOOD's `x_to_world` and `create_bbx`,
DAIR-V2X's label description, the SUSTechPOINTS README, ASAM OpenLABEL 1.0.0 clause 7.10.1. Corners
are compared as sets, in the map's frame."""

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from toolkit.boxes import corners, count_points
from toolkit.datasets.recordings import write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import Objects

START_S = 1_700_000_000.25
WORLD = pose(500.0, -200.0, 3.0, yaw=1.2)  # in the map
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64) / 2
Found = tuple[np.ndarray, np.ndarray]  # corners (m, 8, 3) and points (n, 3), in the same frame


def frame() -> Frame:
    rng = np.random.default_rng(7)
    boxes = np.column_stack(
        [rng.uniform(8, 40, 5), rng.uniform(-9, 9, 5), rng.uniform(0.4, 1.2, 5)]
    )
    sizes = np.array(
        [[4.5, 1.8, 1.5], [1.9, 0.6, 1.7], [0.8, 0.7, 1.8], [12.0, 2.6, 3.4], [4.2, 1.9, 1.6]]
    )
    yaws = np.array([0.3, -1.2, 2.9, -2.4, 1.6])
    objects = Objects(
        np.column_stack([boxes, sizes, yaws]), np.array([0, 1, 2, 3, 0]), np.arange(11, 16)
    )
    points = rng.uniform(-30, 30, (40, 3)).astype(np.float32)
    lidar = SensorCloud(
        "lidar",
        points,
        pose(3.0, -2.0, 6.0, yaw=0.4),
        intensity=np.linspace(0, 1, 40, dtype=np.float32),
    )
    return Frame.of_clouds("0", (lidar,), objects, time=START_S, map_SE3_world=WORLD)


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    rows = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]]}
    return np.array(rows.get(axis, [[c, -s, 0], [s, c, 0], [0, 0, 1]]))


def by_quaternion(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def place(rotation: np.ndarray, translation: Any) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, np.ravel(translation)
    return matrix


def box_corners(centre: Any, size: Any, rotation: np.ndarray) -> np.ndarray:
    """Corners of a box of length, width and height."""
    return (SIGNS * np.asarray(size, np.float64)) @ rotation.T + np.asarray(centre, np.float64)


def read_pcd(path: Path) -> np.ndarray:
    """x, y and z of a binary PCD file of 4-byte fields."""
    head, body = path.read_bytes().split(b"DATA binary\n", 1)
    entries = {line.split()[0]: line.split()[1:] for line in head.decode().splitlines() if line}
    assert set(entries["SIZE"]) == {"4"}
    assert entries["FIELDS"][:3] == ["x", "y", "z"]
    table = np.frombuffer(body, "<f4").reshape(int(entries["POINTS"][0]), -1)
    return table[:, :3].astype(np.float64)


def kitti(folder: Path) -> Found:
    lines = (folder / "training/calib/000000.txt").read_text().splitlines()
    calib = {
        name: np.array(numbers.split(), float)
        for name, numbers in (line.split(":") for line in lines)
    }
    velo_to_cam = place(*np.hsplit(calib["Tr_velo_to_cam"].reshape(3, 4), [3]))
    rectified = place(calib["R0_rect"].reshape(3, 3), np.zeros(3)) @ velo_to_cam
    found = []
    for line in (folder / "training/label_2/000000.txt").read_text().splitlines():
        h, w, length, x, y, z, ry = map(float, line.split()[8:15])
        in_camera = [[length * sx, -h * (sz + 0.5), w * sy] for sx, sy, sz in SIGNS]
        turned = np.array(in_camera) @ turn("y", ry).T + [x, y, z]
        found.append(transform(np.linalg.inv(rectified), turned))
    points = np.fromfile(folder / "training/velodyne/000000.bin", "<f4").reshape(-1, 4)[:, :3]
    return np.array(found), points.astype(np.float64)


def dair(folder: Path) -> Found:
    rows = json.loads((folder / "label/virtuallidar/000000.json").read_text())
    found = []
    for row in rows:
        centre = [float(row["3d_location"][axis]) for axis in "xyz"]
        size = [float(row["3d_dimensions"][axis]) for axis in "lwh"]
        found.append(box_corners(centre, size, turn("z", float(row["rotation"]))))
    calib = json.loads((folder / "calib/virtuallidar_to_world/000000.json").read_text())
    in_map = place(np.array(calib["rotation"]), calib["translation"])
    (entry,) = json.loads((folder / "data_info.json").read_text())
    assert int(entry["pointcloud_timestamp"]) == round(START_S * 1e6)
    cloud = read_pcd(folder / entry["pointcloud_path"])
    return transform(in_map, np.array(found)), transform(in_map, cloud)


def sustech(folder: Path) -> Found:
    found = []
    for row in json.loads((folder / "label/000000.json").read_text()):
        centre, turned, size = (
            np.array([row["psr"][name][axis] for axis in "xyz"])
            for name in ("position", "rotation", "scale")
        )
        rotation = turn("x", turned[0]) @ turn("y", turned[1]) @ turn("z", turned[2])
        found.append(box_corners(centre, size, rotation))
    return np.array(found), read_pcd(folder / "lidar/000000.pcd")


def openlabel(folder: Path) -> Found:
    content = json.loads((folder / "labels_point_clouds/000000.json").read_text())["openlabel"]
    found = []
    for shown in content["frames"]["0"]["objects"].values():
        (cuboid,) = shown["object_data"]["cuboid"]
        assert cuboid["coordinate_system"] == "world"
        x, y, z, qx, qy, qz, qw, *size = cuboid["val"]
        found.append(box_corners([x, y, z], size, by_quaternion(qw, qx, qy, qz)))
    matrix = np.reshape(
        content["coordinate_systems"]["lidar"]["pose_wrt_parent"]["matrix4x4"], (4, 4)
    )
    stream = content["frames"]["0"]["frame_properties"]["streams"]["lidar"]
    return np.array(found), transform(
        matrix, read_pcd(folder / "labels_point_clouds" / stream["uri"])
    )


def x_to_world(value: Any) -> np.ndarray:
    """CARLA's transform of x, y, z, roll, yaw, pitch in degrees, left-handed."""
    x, y, z, roll, yaw, pitch = (float(number) for number in value)
    (cr, cy, cp), (sr, sy, sp) = (
        np.cos(np.deg2rad([roll, yaw, pitch])),
        np.sin(np.deg2rad([roll, yaw, pitch])),
    )
    rows = [
        [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
        [sp, -cp * sr, cp * cr],
    ]
    return place(np.array(rows), [x, y, z])


def opv2v(folder: Path, mirror: float = -1.0) -> Found:
    content = yaml.safe_load((folder / "scenario/0/00000.yaml").read_text())
    found = []
    for vehicle in content["vehicles"].values():
        at = np.array(vehicle["location"]) + np.array(vehicle["center"])
        turned = x_to_world([*at, *vehicle["angle"]])
        found.append(transform(turned, 2 * SIGNS * np.array(vehicle["extent"])))
    points = transform(x_to_world(content["lidar_pose"]), read_pcd(folder / "scenario/0/00000.pcd"))
    return np.array(found) * [1, mirror, 1], points * [1, mirror, 1]


def v2xreal(folder: Path) -> Found:
    return opv2v(folder, 1.0)


def nuscenes(folder: Path) -> Found:
    def table(name: str) -> list[Any]:
        return json.loads((folder / "v1.0-coview" / f"{name}.json").read_text())

    def in_parent(row: Any) -> np.ndarray:
        return place(by_quaternion(*row["rotation"]), row["translation"])

    found = []
    for row in table("sample_annotation"):
        width, length, height = row["size"]
        found.append(
            box_corners(
                row["translation"], [length, width, height], by_quaternion(*row["rotation"])
            )
        )
    (data,) = table("sample_data")
    assert data["timestamp"] == round(START_S * 1e6)
    (mounted,) = (
        row for row in table("calibrated_sensor") if row["token"] == data["calibrated_sensor_token"]
    )
    (ego,) = (row for row in table("ego_pose") if row["token"] == data["ego_pose_token"])
    points = np.fromfile(folder / data["filename"], "<f4").reshape(-1, 5)[:, :3].astype(np.float64)
    return np.array(found), transform(in_parent(ego) @ in_parent(mounted), points)


@pytest.mark.parametrize("counted", [True, False])
def test_nuscenes_holds_all_that_its_devkit_follows(tmp_path, counted):
    """nuscenes-devkit 1.2.0: `NuScenes.__init__` reads map[0] and its file, scenes' and instances'
    ends and lists of samples; evaluation adds num_lidar_pts and num_radar_pts."""
    shown = [
        replace(frame(), time=START_S + k, counts=np.arange(5) if counted else None)
        for k in range(3)
    ]
    write_recording(shown, tmp_path, "nuscenes")
    tables = {
        path.stem: json.loads(path.read_text())
        for path in (tmp_path / "v1.0-coview").glob("*.json")
    }
    tokens = {name: {row["token"]: row for row in rows} for name, rows in tables.items()}
    assert all(len(tokens[name]) == len(rows) for name, rows in tables.items())
    (kept,) = tables["map"]
    assert (tmp_path / kept["filename"]).read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert [log["token"] for log in tables["log"]] == kept["log_tokens"]
    (scene,) = tables["scene"]
    assert scene["log_token"] in tokens["log"]
    for table, first, last, count in (
        ("sample", scene["first_sample_token"], scene["last_sample_token"], scene["nbr_samples"]),
        *(
            (
                "sample_annotation",
                row["first_annotation_token"],
                row["last_annotation_token"],
                row["nbr_annotations"],
            )
            for row in tables["instance"]
        ),
    ):
        followed = [first]
        while following := tokens[table][followed[-1]]["next"]:
            assert tokens[table][following]["prev"] == followed[-1]
            followed.append(following)
        assert followed[-1] == last
        assert len(followed) == count == 3
    for row in tables["sample_data"]:
        mounted = tokens["calibrated_sensor"][row["calibrated_sensor_token"]]
        assert tokens["sensor"][mounted["sensor_token"]]["modality"] == "lidar"
    assert all(row["scene_token"] in tokens["scene"] for row in tables["sample"])
    counts = [
        row["num_lidar_pts"] + row["num_radar_pts"] for row in tables["sample_annotation"][:5]
    ]
    assert counts == (
        list(range(5))
        if counted
        else count_points(shown[0].points(), shown[0].objects.boxes).tolist()
    )


def argoverse(folder: Path) -> Found:
    feather = pytest.importorskip("pyarrow.feather")
    rows = feather.read_table(folder / "annotations.feather").to_pylist()
    stamp = round(START_S * 1e9)
    found = []
    for row in rows:
        assert row["timestamp_ns"] == stamp
        size = [row[name] for name in ("length_m", "width_m", "height_m")]
        rotation = by_quaternion(*(row[name] for name in ("qw", "qx", "qy", "qz")))
        found.append(box_corners([row[name] for name in ("tx_m", "ty_m", "tz_m")], size, rotation))
    table = feather.read_table(folder / f"sensors/lidar/{stamp}.feather").to_pydict()
    points = np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)
    (city,) = feather.read_table(folder / "city_SE3_egovehicle.feather").to_pylist()
    rotation = by_quaternion(*(city[name] for name in ("qw", "qx", "qy", "qz")))
    in_map = place(rotation, [city[name] for name in ("tx_m", "ty_m", "tz_m")])
    return transform(in_map, np.array(found)), transform(in_map, points)


def folder(path: Path) -> Found:
    (sample,) = json.loads((path / "labels.json").read_text())["samples"]
    assert sample["time"] == START_S
    found = []
    for row in sample["objects"]:
        centre, size = (
            [row[axis] for axis in "xyz"],
            [row[name] for name in ("length", "width", "height")],
        )
        found.append(box_corners(centre, size, turn("z", np.deg2rad(row["yaw_deg"]))))
    name, *numbers = (path / "poses.txt").read_text().split()
    matrix = np.vstack([np.reshape(np.array(numbers, float), (3, 4)), [0, 0, 0, 1]])
    return np.array(found), transform(matrix, read_pcd(path / f"{name}.pcd"))


def rosbag(path: Path) -> Found:
    """MCAP's messages by rosbags' own reader, CDR decoded by hand."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    (file,) = (path / "bag").glob("*.mcap")
    found: dict[str, bytes] = {}
    with highlevel.AnyReader([file]) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic] = data
            if connection.topic == "/tf":
                (link,) = reader.deserialize(data, connection.msgtype).transforms
    seconds, nanoseconds, length = struct.unpack_from("<iII", found["/lidar"], 4)
    assert seconds + nanoseconds * 1e-9 == pytest.approx(START_S, abs=1e-6)
    assert found["/lidar"][16 : 16 + length] == b"lidar\0"
    assert link.child_frame_id == "lidar"
    q, t = link.transform.rotation, link.transform.translation
    body = found["/lidar"][-1 - 16 * 40 : -1]  # the last byte is is_dense
    points = np.frombuffer(body, "<f4").reshape(40, 4)[:, :3].astype(np.float64)
    return np.zeros((0, 8, 3)), transform(
        place(by_quaternion(q.w, q.x, q.y, q.z), [t.x, t.y, t.z]), points
    )


IN_MAP = (dair, opv2v, v2xreal, nuscenes, argoverse)
READERS: dict[str, Callable[[Path], Found]] = {
    "argoverse": argoverse,
    "dair": dair,
    "folder": folder,
    "kitti": kitti,
    "nuscenes": nuscenes,
    "openlabel": openlabel,
    "opv2v": opv2v,
    "rosbag": rosbag,
    "sustech": sustech,
    "v2xreal": v2xreal,
    "v2xset": opv2v,
}


@pytest.mark.filterwarnings("ignore:.*no place for labels")
@pytest.mark.parametrize("layout", sorted(READERS))
def test_corners_and_points_by_the_formats_rules(tmp_path, layout):
    shown = frame()
    write_recording([shown], tmp_path, layout)
    found, points = READERS[layout](tmp_path)
    in_frame = WORLD if READERS[layout] in IN_MAP else np.eye(4)
    np.testing.assert_allclose(points, transform(in_frame, shown.points()), atol=1e-3)
    if layout == "rosbag":
        return
    expected = transform(in_frame, corners(shown.objects.boxes))
    assert len(found) == len(expected)
    x, y, z, length, *_, yaw = shown.objects.boxes.T
    ahead = np.column_stack([x + length / 2 * np.cos(yaw), y + length / 2 * np.sin(yaw), z])
    fronts = found[:, SIGNS[:, 0] > 0].mean(axis=1)
    np.testing.assert_allclose(fronts, transform(in_frame, ahead), atol=2e-3)
    for ours, theirs in zip(expected, found, strict=True):
        away = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
        assert away.min(axis=1).max() < 2e-3
        assert away.min(axis=0).max() < 2e-3
