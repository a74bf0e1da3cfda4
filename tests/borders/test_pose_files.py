"""Poses whose file states the order of their numbers are read by it; an order that is likelier
another is said.

scipy, ROS and TUM's trajectories have quaternions x y z w, Argoverse 2 and nuScenes w x y z."""

import json
import warnings

import numpy as np
import pytest

from toolkit.datasets.pose_files import read_poses
from toolkit.geometry import pose

YAW = np.deg2rad(30)
PLACED = pose(12.0, 3.0, 5.0, yaw=YAW)
W, Z = np.cos(YAW / 2), np.sin(YAW / 2)


@pytest.mark.parametrize(
    "text",
    [
        f"name,qw,qx,qy,qz,tx,ty,tz\nnorth,{W},0,0,{Z},12,3,5\n",
        f"sensor_name;tx_m;ty_m;tz_m;qx;qy;qz;qw\r\nnorth;12;3;5;0;0;{Z};{W}\r\n",
        f"\ufeffx y z qx qy qz qw name\n12 3 5 0 0 {Z} {W} north\n",
    ],
)
def test_named_columns(tmp_path, text):
    (tmp_path / "poses.csv").write_bytes(text.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_poses(tmp_path / "poses.csv")
    assert list(read) == ["north"]
    np.testing.assert_allclose(read["north"], PLACED, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "name,qw,qx,qy,qz,lat,lon,alt\nn,1,0,0,0,48,11,500\n",
            "its columns must be one each of qw, qx, qy, qz",
        ),
        ("name,qw,qx,qy,qz,tx,ty,tz\nn,1,0,0,0,1,2\n", "a cell under each of its names"),
        ("name,qw,qx,qy,qz,tx,ty,tz\n", "a cell under each of its names"),
        (
            "name,qw,qx,qy,qz,tx,ty,tz\nn,1,0,0,0,1,2,3\nn,1,0,0,0,1,2,4\n",
            "two poses have one name: n",
        ),
        ("name,qw,qx,qy,qz,tx,ty,tz\nn,2,0,0,0,1,2,3\n", "must have length 1"),
    ],
)
def test_named_columns_that_are_no_poses(tmp_path, text, message):
    (tmp_path / "poses.csv").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_poses(tmp_path / "poses.csv")


@pytest.mark.parametrize("quaternion", [[0, 0, Z, W], [0, 0, 0, 1], [0.1, 0.2, 0.9, np.sqrt(0.14)]])
def test_quaternions_that_are_likelier_w_last_are_said(tmp_path, quaternion):
    """A sensor that would hang upside down or face backwards exactly."""
    (tmp_path / "poses.json").write_text(json.dumps({"north": [*quaternion, 12, 3, 5]}))
    with pytest.warns(
        UserWarning, match="read as qw qx qy qz tx ty tz, but might be qx qy qz qw tx ty tz"
    ):
        read_poses(tmp_path / "poses.json")


@pytest.mark.parametrize(
    "quaternion", [[W, 0, 0, Z], [0, 1, 0, 0], [0.5, -0.5, 0.5, -0.5], [W, 0, Z, 0]]
)
def test_other_quaternions_are_read_without_a_word(tmp_path, quaternion):
    (tmp_path / "poses.json").write_text(json.dumps({"north": [*quaternion, 12, 3, 5]}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_poses(tmp_path / "poses.json")


def test_a_pose_in_parts_is_refused_with_the_forms(tmp_path):
    (tmp_path / "poses.json").write_text(
        json.dumps({"north": {"rotation": np.eye(3).tolist(), "translation": [1, 2, 3]}})
    )
    with pytest.raises(
        ValueError, match=r"pose 'north' .* must be 16, 12 or 7 numbers \(4×4, 3×4, or qw qx qy qz"
    ):
        read_poses(tmp_path / "poses.json")
