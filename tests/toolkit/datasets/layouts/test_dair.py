import json

import numpy as np
import pytest

from toolkit.datasets.layouts.dair import NO_CAMERA, dair, read_transform
from toolkit.geometry import transform
from toolkit.point_files.pcd import pcd_bytes

CAR = {
    "type": "Car",
    "occluded_state": "0",
    "truncated_state": "0",
    "alpha": "1.5",
    "2d_box": {"xmin": "1", "ymin": "2", "xmax": "3", "ymax": "4"},
    "3d_dimensions": {"h": "1.5", "w": "1.8", "l": "4.5"},
    "3d_location": {"x": "12.5", "y": "-3.0", "z": "-1.2"},
    "rotation": "0.5",
}
LEVEL = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def put(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def cloud(path, point=(1.0, 2.0, 3.0)):
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {
        axis: np.array([value], np.float32) for axis, value in zip("xyz", point, strict=True)
    }
    path.write_bytes(pcd_bytes(columns | {"intensity": np.array([9.0], np.float32)}))


def test_one_side_has_numbers_as_strings(tmp_path):
    cloud(tmp_path / "velodyne/000123.pcd")
    put(
        tmp_path / "label/virtuallidar/000123.json",
        [CAR, CAR | {"type": "Trafficcone"}, CAR | {"type": "CarIgnore"}],
    )
    (sample,) = dair(tmp_path)
    np.testing.assert_allclose(sample.objects.boxes, [[12.5, -3, -1.2, 4.5, 1.8, 1.5, 0.5]])
    assert sample.others.categories == ("Trafficcone", "CarIgnore")
    assert sample.problems == {"labels of other kinds than ours": 2}


def test_labels_of_the_camera_are_complete_in_its_image_alone(tmp_path):
    cloud(tmp_path / "velodyne/000123.pcd")
    behind = CAR | {"3d_location": {"x": "-12.5", "y": "0", "z": "-1.2"}}
    put(tmp_path / "label/camera/000123.json", [CAR, behind])
    (sample,) = dair(tmp_path)
    assert sample.complete.covers(sample.objects.boxes).tolist() == [True, True]
    assert sample.problems == {NO_CAMERA: 1}
    put(
        tmp_path / "calib/camera_intrinsic/000123.json",
        {"cam_K": [1000, 0, 960, 0, 1000, 540, 0, 0, 1]},
    )
    ahead = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # the camera looks along the lidar's x
    put(
        tmp_path / "calib/virtuallidar_to_camera/000123.json",
        {"rotation": ahead, "translation": [[0], [0], [0]]},
    )
    (sample,) = dair(tmp_path)
    assert sample.complete.covers(sample.objects.boxes).tolist() == [True, False]
    assert sample.problems == {}


def test_rotations_are_named_made_one_or_refused(tmp_path):
    cloud(tmp_path / "velodyne/000123.pcd")
    put(
        tmp_path / "label/virtuallidar/000123.json",
        [{k: v for k, v in CAR.items() if k != "rotation"}],
    )
    with pytest.raises(ValueError, match=r"000123.json .*no entry rotation"):
        list(dair(tmp_path))
    put(
        tmp_path / "a.json",
        {"rotation": [[1, 0, 0.002], [0, 1, 0], [0, 0, 1]], "translation": [1, 2, 3]},
    )
    matrix = read_transform(tmp_path / "a.json")
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    put(
        tmp_path / "b.json",
        {"rotation": [[1.5, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [1, 2, 3]},
    )
    with pytest.raises(ValueError, match=r"b.json .*stretches"):
        read_transform(tmp_path / "b.json")
    put(
        tmp_path / "a.json",
        {
            "rotation": LEVEL,
            "translation": [1, 2, 3],
            "relative_error": {"delta_x": "1", "delta_y": 2},
        },
    )
    assert read_transform(tmp_path / "a.json")[:3, 3].tolist() == [2, 4, 3]
    assert read_transform(tmp_path / "a.json", (10.0, 0.0))[:3, 3].tolist() == [11, 2, 3]


@pytest.fixture
def pair(tmp_path):
    """Infrastructure at (1000, 2000) turned by a quarter, the vehicle 30 m ahead, its lidar 1 m
    above its frame."""
    root = tmp_path / "cooperative-vehicle-infrastructure"
    road, car = root / "infrastructure-side", root / "vehicle-side"
    cloud(road / "velodyne/000010.pcd", (1.0, 0.0, 0.0))
    cloud(car / "velodyne/000020.pcd", (0.0, 0.0, 0.0001))
    off = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.001], [0.0, 0.0, 1.0]]  # a rotation that is not quite one
    put(
        road / "calib/virtuallidar_to_world/000010.json",
        {
            "rotation": off,
            "translation": [[1000.0], [2000.0], [20.0]],
            "relative_error": {"delta_x": "", "delta_y": ""},
        },
    )
    put(
        car / "calib/lidar_to_novatel/000020.json",
        {"transform": {"rotation": LEVEL, "translation": [[0], [0], ["1"]]}},
    )
    put(
        car / "calib/novatel_to_world/000020.json",
        {"rotation": LEVEL, "translation": [[1000.0], [2030.0], [18.0]]},
    )
    put(
        root / "cooperative/label_world/000020.json",
        [CAR | {"3d_location": {"x": 1000.0, "y": 2010.0, "z": 21.0}}],
    )
    info = {
        "infrastructure_pointcloud_path": "infrastructure-side/velodyne/000010.pcd",
        "vehicle_pointcloud_path": "vehicle-side/velodyne/000020.pcd",
        "system_error_offset": {"delta_x": 0.5, "delta_y": "-0.25"},
    }
    put(root / "cooperative/data_info.json", [info])
    return tmp_path


def test_pairs_by_hand_with_or_without_an_offset(pair):
    """World 10 m north of the pole is 10 m ahead in a lidar that was turned by a quarter; the
    offset moves the pole."""
    (sample,) = dair(pair)
    assert [each.name for each in sample.clouds] == ["infrastructure", "vehicle"]
    np.testing.assert_allclose(sample.map_SE3_world[:3, 3], [1000.5, 1999.75, 20.0])
    np.testing.assert_allclose(sample.objects.boxes[0, :3], [10.25, 0.5, 1.0], atol=0.02)
    assert sample.objects.boxes[0, 6] == pytest.approx(0.5 - np.pi / 2, abs=1e-3)
    np.testing.assert_allclose(sample.points()[1], [30.25, 0.5, -1.0], atol=0.04)
    vehicle = transform(sample.map_SE3_world, sample.points()[1:])
    np.testing.assert_allclose(vehicle, [[1000.0, 2030.0, 19.0]], atol=1e-3)
    info = pair / "cooperative-vehicle-infrastructure/cooperative/data_info.json"
    put(info, [json.loads(info.read_text())[0] | {"system_error_offset": ""}])
    (sample,) = dair(pair)
    np.testing.assert_allclose(sample.map_SE3_world[:3, 3], [1000.0, 2000.0, 20.0])
