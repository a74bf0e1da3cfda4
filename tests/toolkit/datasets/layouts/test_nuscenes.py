import json

import numpy as np
import pytest

from toolkit.datasets.layouts.nuscenes import compute_quaternion, nuscenes, write_nuscenes
from toolkit.datasets.pose_files import quaternion_pose
from toolkit.datasets.problem_kinds import STRAY
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects

QUARTER = [0.70710678, 0.0, 0.0, 0.70710678]  # w first


def tables():
    return {
        "sample": [
            {"token": "late", "timestamp": 2_000_000},
            {"token": "s", "timestamp": 1_500_000},
        ],
        "sample_data": [
            {
                "token": "d",
                "sample_token": "s",
                "ego_pose_token": "e",
                "calibrated_sensor_token": "c",
                "timestamp": 1_500_000,
                "is_key_frame": True,
                "filename": "samples/LIDAR_TOP/a.pcd.bin",
            },
            {
                "token": "d2",
                "sample_token": "s",
                "ego_pose_token": "e",
                "calibrated_sensor_token": "c",
                "timestamp": 1_550_000,
                "is_key_frame": False,
                "filename": "sweeps/LIDAR_TOP/b.pcd.bin",
            },
        ],
        "ego_pose": [{"token": "e", "translation": [600.0, 1600.0, 0.0], "rotation": QUARTER}],
        "calibrated_sensor": [
            {
                "token": "c",
                "sensor_token": "l",
                "translation": [1.0, 0.0, 1.8],
                "rotation": [1, 0, 0, 0],
            }
        ],
        "sensor": [{"token": "l", "channel": "LIDAR_TOP", "modality": "lidar"}],
        "sample_annotation": [
            {
                "token": "a",
                "sample_token": "s",
                "instance_token": "i",
                "translation": [600.0, 1620.0, 1.0],
                "size": [1.9, 4.6, 1.7],
                "rotation": QUARTER,
                "num_lidar_pts": 5,
            },
            {
                "token": "b",
                "sample_token": "s",
                "instance_token": "j",
                "translation": [600.0, 1605.0, 1.0],
                "size": [0.5, 0.5, 1.0],
                "rotation": QUARTER,
                "num_lidar_pts": 2,
            },
        ],
        "instance": [{"token": "i", "category_token": "k"}, {"token": "j", "category_token": "n"}],
        "category": [
            {"token": "k", "name": "vehicle.car"},
            {"token": "n", "name": "movable_object.trafficcone"},
        ],
    }


def root(tmp_path, content):
    (tmp_path / "v1.0-mini").mkdir()
    for name, table in content.items():
        (tmp_path / "v1.0-mini" / f"{name}.json").write_text(json.dumps(table))
    (tmp_path / "samples/LIDAR_TOP").mkdir(parents=True)
    np.array([[2, 0, -1, 7, 31]], "<f4").tofile(tmp_path / "samples/LIDAR_TOP/a.pcd.bin")
    return tmp_path


def test_a_sample_by_hand(tmp_path):
    """The vehicle heads north (a quarter turn): 20 m north of it is 20 m ahead; size is width,
    length, height."""
    (sample,) = nuscenes(root(tmp_path, tables()))
    np.testing.assert_allclose(sample.objects.boxes, [[20, 0, 1, 4.6, 1.9, 1.7, 0]], atol=1e-6)
    assert sample.counts.tolist() == [5]
    assert sample.others.counts.tolist() == [2]
    assert sample.categories == ("vehicle.car",)
    assert sample.time == 1.5
    np.testing.assert_allclose(sample.points(), [[3, 0, 0.8]], atol=1e-6)
    assert sample.clouds[0].intensity.tolist() == [7]
    assert sample.clouds[0].name == "LIDAR_TOP"
    np.testing.assert_allclose(sample.map_SE3_world[:3, 3], [600, 1600, 0])


@pytest.mark.parametrize(
    ("table", "change", "names"),
    [
        ("ego_pose", {"token": "other"}, r"ego_pose.json .*no entry e"),
        ("ego_pose", {"rotation": [1, 1, 1, 1]}, r"ego_pose.json .*length 1"),
        ("calibrated_sensor", {"sensor_token": "x"}, "no entry x"),
        ("sample_annotation", {"size": [1, 2]}, r"sample_annotation.json .*size must be 3 numbers"),
        ("instance", {"category_token": "x"}, r"instance.json .*no entry x"),
        ("sample", {"token": None}, r"sample.json"),
        ("sample_data", {"filename": "../secret.pcd.bin"}, "sample_data.json .*leads out of"),
        ("sample_data", {"filename": "/etc/hostname"}, "sample_data.json .*leads out of"),
    ],
)
def test_damage_names_the_table(tmp_path, table, change, names):
    content = tables()
    content[table] = [row | change for row in content[table]]
    with pytest.raises(ValueError, match=names):
        list(nuscenes(root(tmp_path, content)))


@pytest.mark.parametrize(
    "angles",
    [
        (0.0, 0.0, 0.0),
        (3.1, 0.0, 0.0),
        (0.0, 1.5, 0.0),
        (0.0, 0.0, 3.1),
        (1.0, 2.0, 3.0),
        (-2.0, 0.5, -1.0),
    ],
)
def test_quaternions_of_poses(angles):
    yaw, pitch, roll = angles
    placed = pose(yaw=yaw, pitch=pitch, roll=roll)
    unit = compute_quaternion(placed)
    assert unit[0] >= 0
    np.testing.assert_allclose(quaternion_pose(unit, np.zeros(3)), placed, atol=1e-12)


def test_numbers_that_stand_for_other_classes_in_other_samples_keep_their_classes(tmp_path):
    """Recordings without tracks count their objects anew in each sample."""
    boxes = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5], [9.0, 2, 3, 2, 1, 1.5, 0.5]])
    cloud = SensorCloud("s", np.ones((1, 3), np.float32), np.eye(4))
    labels = [[0, 2], [2, 0], [3, 2], [0, 2]]
    samples = [
        Frame.of_clouds(str(k), (cloud,), Objects(boxes, np.array(row), np.arange(2)))
        for k, row in enumerate(labels)
    ]
    write_nuscenes(samples, tmp_path)
    back = list(nuscenes(tmp_path))
    assert [sample.objects.labels.tolist() for sample in back] == labels
    assert [sample.objects.ids.tolist() for sample in (back[0], back[3])] == [[0, 1], [0, 1]]
    instances = json.loads((tmp_path / "v1.0-coview" / "instance.json").read_text())
    assert sorted(each["token"] for each in instances) == [
        "0",
        "0_heavy",
        "0_pedestrian",
        "1",
        "1_vehicle",
    ]


def test_each_lidar_stands_where_the_vehicle_was_at_its_own_time(tmp_path):
    """The vehicle drives north; the second lidar measures 3 m later and is 3 m ahead of the world,
    the first's."""
    content = tables()
    later = {"token": "d3", "ego_pose_token": "f", "filename": "samples/LIDAR_TOP/a.pcd.bin"}
    content["sample_data"].append(
        content["sample_data"][0] | later | {"calibrated_sensor_token": "c2"}
    )
    content["ego_pose"].append(
        {"token": "f", "translation": [600.0, 1603.0, 0.0], "rotation": QUARTER}
    )
    content["calibrated_sensor"].append(
        content["calibrated_sensor"][0] | {"token": "c2", "sensor_token": "m"}
    )
    content["sensor"].append({"token": "m", "channel": "LIDAR_BACK", "modality": "lidar"})
    (sample,) = nuscenes(root(tmp_path, content))
    np.testing.assert_allclose(sample.points(), [[3, 0, 0.8], [6, 0, 0.8]], atol=1e-5)


def test_labels_of_samples_without_a_cloud_are_counted(tmp_path):
    content = tables()
    content["sample_annotation"][1] |= {"sample_token": "dangling"}
    (sample,) = nuscenes(root(tmp_path, content))
    assert sample.problems == {STRAY: 1}
