"""Frames come in the order of the numbers in their names: 2 before 10, whether or not a tool pads
them with zeros.

open-mmlab, SUSTechPOINTS and many export scripts write 1.pcd, 2.pcd ... 10.pcd; a plain sort gives
1, 10, 2."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from toolkit.datasets.layouts.kitti import kitti
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.point_files.pcd import pcd_bytes

NUMBERS = range(1, 13)


def put_cloud(path: Path, number: float) -> None:
    """A cloud of one point whose x is a number."""
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = {"x": [number], "y": [1.0], "z": [0.0]}
    path.write_bytes(
        pcd_bytes({name: np.array(column, np.float32) for name, column in columns.items()})
    )


def put_folder(root: Path) -> None:
    for k in NUMBERS:
        put_cloud(root / "north" / f"frame_{k}.pcd", k)


def put_sustech(root: Path) -> None:
    for k in NUMBERS:
        put_cloud(root / "lidar" / f"{k}.pcd", k)


def put_dair(root: Path) -> None:
    for k in NUMBERS:
        put_cloud(root / "velodyne" / f"{k}.pcd", k)


def put_kitti(root: Path) -> None:
    (root / "velodyne").mkdir(parents=True)
    for k in NUMBERS:
        np.array([[k, 1, 0, 0]], "<f4").tofile(root / "velodyne" / f"{k}.bin")


def put_opv2v(root: Path) -> None:
    for k in NUMBERS:
        put_cloud(root / "scene" / "7" / f"{k}.pcd", k)
        described = {"lidar_pose": [0, 0, 0, 0, 0, 0], "vehicles": {}}
        (root / "scene" / "7" / f"{k}.yaml").write_text(yaml.safe_dump(described))


def put_openlabel(root: Path) -> None:
    """Frames in one file, in the order of a JSON writer that sorts keys as text."""
    frames = {}
    for k in sorted(map(str, NUMBERS)):
        put_cloud(root / f"{k}.pcd", int(k))
        frames[k] = {"frame_properties": {"point_cloud_file_names": [f"{k}.pcd"]}, "objects": {}}
    (root / "labels.json").write_text(json.dumps({"openlabel": {"metadata": {}, "frames": frames}}))


WRITERS = {
    "folder": put_folder,
    "sustech": put_sustech,
    "dair": put_dair,
    "kitti": put_kitti,
    "opv2v": put_opv2v,
    "openlabel": put_openlabel,
}


@pytest.mark.parametrize("layout", WRITERS)
def test_frames_of_names_without_zeros(tmp_path, layout):
    WRITERS[layout](tmp_path)
    frames = list(open_recording(tmp_path, layout))
    assert [float(frame.clouds[0].points[0, 0]) for frame in frames] == list(NUMBERS)


def test_clouds_put_together_by_order_with_other_zeros(tmp_path):
    """north_1 ... north_12 and south_01 ... south_12."""
    for k in NUMBERS:
        put_cloud(tmp_path / "north" / f"north_{k}.pcd", k)
        put_cloud(tmp_path / "south" / f"south_{k:02d}.pcd", k)
    for frame in open_recording(tmp_path):
        north, south = frame.clouds
        assert north.points[0, 0] == south.points[0, 0]


def test_written_again_in_order(tmp_path):
    put_folder(tmp_path / "made")
    write_recording(open_recording(tmp_path / "made"), tmp_path / "written", "kitti")
    frames = list(kitti(tmp_path / "written"))
    assert [float(frame.clouds[0].points[0, 0]) for frame in frames] == list(NUMBERS)


def test_decimal_times_stay_in_order(tmp_path):
    """1700000000.5 is later than 1700000000.25, though 5 is less than 25."""
    for name, number in (("1700000000.25", 1), ("1700000000.5", 2), ("1700000001.0", 3)):
        put_cloud(tmp_path / f"{name}.pcd", number)
    frames = list(open_recording(tmp_path))
    assert [float(frame.clouds[0].points[0, 0]) for frame in frames] == [1, 2, 3]
