"""A recording in UTM: float32 steps by half a metre at a northing of 5336 km, so an origin is taken
off first.

Every layout is written and read back with 300 different y, the car's box on its 300 points, and the
lidar where it was. ETRS89 / UTM zone 32N (EPSG:25832) at 11.58 E, 48.15 N is about (692000,
5336000)."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.datasets import cloud_records, frame_labels, problem_kinds
from toolkit.datasets.origins import find_origin, near_frames, rebase
from toolkit.datasets.recordings import LAYOUTS, find_layout, open_recording, write_recording
from toolkit.frame import Everywhere, Frame, ImageWedge, Rectangle, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import Objects

UTM = np.array([692000.0, 5336000.0, 520.0])
BOX = [692010.0, 5336000.0, 515.75, 4.2, 1.9, 1.6, 0.0]
WRITTEN = sorted(name for name, layout in LAYOUTS.items() if layout.writer)


def car() -> np.ndarray:
    """300 points on a car 10 m before the lidar, each at another y."""
    rng = np.random.default_rng(0)
    return np.column_stack(
        [rng.uniform(8, 12, 300), np.linspace(-0.9, 0.9, 300), rng.uniform(-5, -3.5, 300)]
    )


def write_folder(folder: Path, *, placed: bool) -> Path:
    """Two frames of one lidar, with a pose, or with points in UTM and none."""
    (folder / "lidar1").mkdir(parents=True)
    samples = []
    for name in ("000000", "000001"):
        np.save(folder / "lidar1" / f"{name}.npy", car() + (0 if placed else UTM))
        row = dict(zip(("x", "y", "z", "length", "width", "height", "yaw_deg"), BOX, strict=True))
        samples.append(
            {"name": name, "time": float(name), "objects": [row | {"label": "vehicle", "id": 1}]}
        )
    (folder / "labels.json").write_text(
        json.dumps({"coview": "boxes", "version": 1, "samples": samples})
    )
    if placed:
        (folder / "poses.json").write_text(json.dumps({"lidar1": pose(*UTM).ravel().tolist()}))
    return folder


@pytest.mark.filterwarnings("ignore:.*no place for")
@pytest.mark.parametrize("layout", WRITTEN)
@pytest.mark.parametrize("placed", [True, False])
def test_points_boxes_and_poses_come_back_to_the_millimetre(tmp_path, layout, placed):
    pytest.importorskip({"rosbag": "rosbags", "argoverse": "pyarrow"}.get(layout, "numpy"))
    recording = open_recording(write_folder(tmp_path / "in", placed=placed), "folder")
    place = tmp_path / ("out.hdf5" if layout == "hdf5" else "out")
    write_recording(recording, place, layout)
    back = find_layout(layout).open(place / "bag" if layout == "rosbag" else place)
    assert len(back) == 2
    for before, after in zip(recording, back, strict=True):
        points = after.points()
        assert len(np.unique(points[:, 1].round(4))) == 300
        lost = UTM + ([0, 0, 0] if placed else [10, 0, -4]) if layout == "sustech" else np.zeros(3)
        in_map = transform(after.map_SE3_world, points) + lost
        np.testing.assert_allclose(
            in_map, before.points(), atol=1e-3 if layout != "sustech" or placed else 1
        )
        if layout != "rosbag":
            assert count_points(points, after.objects.boxes).tolist() == [300]
            centre = transform(after.map_SE3_world, after.objects.boxes[:, :3]) + lost
            np.testing.assert_allclose(
                centre, [BOX[:3]], atol=1e-3 if layout != "sustech" or placed else 1
            )
        sensor = transform(after.map_SE3_world, after.sensors[0].position[None])[0] + lost
        np.testing.assert_allclose(
            sensor, before.sensors[0].position, atol=0.5 if layout == "sustech" else 1e-3
        )


def test_kitti_by_hand_holds_float32_and_the_place_in_the_last_line_of_its_calibration(tmp_path):
    write_recording(
        open_recording(write_folder(tmp_path / "in", placed=True), "folder"),
        tmp_path / "out",
        "kitti",
    )
    rows = np.fromfile(tmp_path / "out/training/velodyne/000001.bin", "<f4").reshape(-1, 4)
    np.testing.assert_allclose(rows[:, :3], car(), atol=1e-5)
    lines = (tmp_path / "out/training/calib/000001.txt").read_text().splitlines()
    assert [line.split(":")[0] for line in lines[:7]] == [
        *("P0", "P1", "P2", "P3", "R0_rect"),
        *("Tr_velo_to_cam", "Tr_imu_to_velo"),
    ]
    name, *numbers = lines[7].split()
    assert name == "Tr_velo_to_world:"
    np.testing.assert_allclose(np.array(numbers, float).reshape(3, 4)[:, 3], UTM, atol=1e-6)


def test_a_layout_without_a_place_for_the_origin_says_it(tmp_path):
    recording = open_recording(write_folder(tmp_path / "in", placed=True), "folder")
    with pytest.warns(
        UserWarning, match=r"no place for an origin: .* from 692000\.000 5336000\.000 520\.000 m"
    ):
        write_recording(recording, tmp_path / "out", "sustech")


def test_every_frame_is_counted_from_the_first_ones_origin(tmp_path):
    """A lidar whose points wander by 50 m keeps its place, whichever frame is read first."""
    folder = write_folder(tmp_path / "in", placed=False)
    np.save(folder / "lidar1/000001.npy", car() + UTM + [50, 0, 0])
    first, second = open_recording(folder, "folder")
    alone = open_recording(folder, "folder")[1]
    for frame in (second, alone):
        assert frame.sensors[0].position.tolist() == first.sensors[0].position.tolist()
        np.testing.assert_allclose(frame.points(), car() + UTM + [50, 0, 0], atol=1e-4)
    assert first.problems == {problem_kinds.UNPLACED: 1}


def test_points_that_float32_spoilt_before_are_counted(tmp_path):
    np.save(tmp_path / "a.npy", (car() + UTM).astype(np.float32))
    (frame,) = open_recording(tmp_path / "a.npy")
    assert len(np.unique(frame.points()[:, 1])) < 10
    assert frame.problems == {problem_kinds.UNPLACED: 1, problem_kinds.COARSE_POINTS: 1}


def test_clouds_in_a_far_world_go_into_their_sensors_frame():
    """Argoverse's points are in the world frame, also if that is a map's."""
    problems: problem_kinds.Problems = {}
    cloud = cloud_records.build_cloud(
        {"positions": car() + UTM}, "a", pose(*UTM, yaw=1.0), problems, frame="world"
    )
    assert cloud.frame == "sensor"
    assert problems == {}
    np.testing.assert_allclose(cloud.in_world(), car() + UTM, atol=1e-5)


def test_another_origin_moves_all_that_a_frame_holds():
    box = Objects(np.array([BOX]))
    far = SensorCloud("a", np.ones((1, 3), np.float32), pose(*UTM, yaw=0.3))
    frame = Frame.of_clouds("0", (far,), box, map_SE3_world=pose(5.0, yaw=0.2))
    assert find_origin(frame).tolist() == UTM.tolist()
    moved = rebase(frame, UTM)
    np.testing.assert_allclose(moved.objects.boxes[0, :3], [10, 0, -4.25], atol=1e-9)
    place = transform(frame.map_SE3_world, frame.points())
    np.testing.assert_allclose(transform(moved.map_SE3_world, moved.points()), place, atol=1e-6)
    in_world = SensorCloud("b", np.full((1, 3), 2.0, np.float32), pose(7.0, yaw=1.0), "world")
    frame = Frame.of_clouds("0", (in_world,), box, map_SE3_world=pose(5.0, yaw=0.2))
    moved = rebase(frame, np.array([100.0, -40.0, 5.0]))
    assert moved.points().tolist() == [[-98, 42, -3]]
    place = transform(frame.map_SE3_world, frame.points())
    np.testing.assert_allclose(transform(moved.map_SE3_world, moved.points()), place, atol=1e-6)
    near = Frame.of_clouds("0", (), Objects(np.array([[1.0, 2, 3, 4, 2, 1, 0]])))
    assert next(near_frames([near])) is near
    assert list(near_frames([])) == []


def test_regions_move_with_the_origin():
    """Boxes are in a region or not, whatever the origin."""
    rng = np.random.default_rng(2)
    origin = np.array([100.0, -40.0, 5.0])
    boxes = np.column_stack(
        [rng.uniform(-60, 60, (200, 3)), np.full((200, 3), 2.0), rng.uniform(-3, 3, 200)]
    )
    projection = np.array([[900.0, 3, 500, 7], [0, 900, 400, -2], [0, 0.01, 1, 0.5]])
    wedge = ImageWedge(projection, 1000, 800, ((100.0, 100.0, 300.0, 300.0),))
    moved = boxes - np.array([*origin, 0, 0, 0, 0])
    for region in (Everywhere(), Rectangle((-20.0, -30.0, 10.0, 40.0)), wedge):
        np.testing.assert_array_equal(
            region.covers(boxes), region.move_origin(origin).covers(moved)
        )
    assert 0 < wedge.covers(boxes).sum() < 200


def test_one_side_of_dair_is_placed_by_its_calibration(tmp_path):
    """virtuallidar_to_world of the infrastructure; novatel_to_world after lidar_to_novatel of the
    vehicle."""
    recording = open_recording(write_folder(tmp_path / "in", placed=True), "folder")
    write_recording(recording, tmp_path / "out", "dair")
    for name in ("novatel_to_world", "lidar_to_novatel"):
        (tmp_path / "out/calib" / name).mkdir()
    place = {"rotation": np.eye(3).tolist(), "translation": [[692000.0], [5336000.0], [520.0]]}
    mount = {"transform": {"rotation": np.eye(3).tolist(), "translation": [[1.0], [0.0], [2.0]]}}
    (tmp_path / "out/calib/virtuallidar_to_world/000000.json").unlink()
    (tmp_path / "out/calib/novatel_to_world/000000.json").write_text(json.dumps(place))
    (tmp_path / "out/calib/lidar_to_novatel/000000.json").write_text(json.dumps(mount))
    (tmp_path / "out/calib/virtuallidar_to_world/000001.json").write_text("{}")
    vehicle, damaged = open_recording(tmp_path / "out", "dair")
    assert vehicle.map_SE3_world[:3, 3].tolist() == [692001.0, 5336000.0, 522.0]
    assert damaged.map_SE3_world.tolist() == np.eye(4).tolist()
    assert damaged.problems == {
        "calibrations that say where the lidar is in the map and cannot be read": 1
    }


def test_coordinates_of_all_that_is_read_are_told_apart_from_no_place(tmp_path):
    """Labels beyond 1e8 m (`MAX_COORDINATE_M`) are none; those of UTM in feet are."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problems: problem_kinds.Problems = {}
        rows = np.array([[2.27e6, 1.75e7, 1700.0, 14, 6, 5, 0.0], [1.1e8, 0, 0, 4, 2, 1.5, 0]])
        found = frame_labels.make_labels(rows, ["car", "car"], None, problems)
    assert len(found.objects) == 1
    assert problems == {problem_kinds.TOO_LARGE: 1}
