"""coview fuse: clouds in their places, poses from anywhere, nothing lost and nothing empty."""

import json
import os
import threading

import numpy as np
import pytest

from toolkit.clouds import from_points, load, save, sensor_numbers


@pytest.fixture
def clouds(tmp_path):
    for name in ("a", "b"):
        save(from_points(np.float32([[1.0, 0.0, 1.0], [50.0, 0.0, 1.0]])), tmp_path / f"{name}.ply")
    shifted = np.eye(4)
    shifted[1, 3] = 5.0
    (tmp_path / "poses.json").write_text(
        json.dumps({"a": np.eye(4).tolist(), "b": shifted.tolist()})
    )
    return tmp_path / "a.ply", tmp_path / "b.ply"


def test_it_places_and_crops_clouds(clouds, tmp_path, run):
    arguments = (
        "--poses",
        tmp_path / "poses.json",
        "--area",
        -10,
        -10,
        10,
        10,
        "--out",
        tmp_path / "new" / "ab.ply",
    )
    code, out, _ = run("fuse", *clouds, *arguments, "--json")
    assert (code, json.loads(out)["points"]) == (0, 2)
    assert (tmp_path / "new" / "ab.ply").exists()


def test_it_thins_each_sensor_apart_and_keeps_its_number(clouds, tmp_path, run, refused):
    out = tmp_path / "thin.ply"
    same = tmp_path / "same.json"
    same.write_text(json.dumps({"a": np.eye(4).tolist(), "b": np.eye(4).tolist()}))
    assert run("fuse", *clouds, "--poses", same, "--voxel", 100, "--out", out)[0] == 0
    assert sensor_numbers(load(out)).tolist() == [0, 1]
    assert "--voxel must be above 0" in refused("fuse", *clouds, "--poses", same, "--voxel", 0)


def test_poses_may_come_from_a_pipe(clouds, tmp_path, run):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=((tmp_path / "poses.json").read_text(),))
    writer.start()
    code, out, err = run("fuse", *clouds, "--poses", pipe, "--json")
    writer.join()
    assert (code, json.loads(out)["points"]) == (0, 4), err


@pytest.mark.parametrize("inverted", [False, True])
def test_an_area_without_a_point_is_refused_and_says_where_they_lie(
    inverted, clouds, tmp_path, refused
):
    flags = ("--inverted",) if inverted else ()
    arguments = ("--poses", tmp_path / "poses.json", *flags, "--out", tmp_path / "new" / "ab.ply")
    line = refused("fuse", *clouds, *arguments, "--area", 100, 100, 200, 200)
    assert "none of the 4 points lies in the area: they lie at x 1.0 to 50.0" in line
    assert ("leave out --inverted" if inverted else "pass --inverted") in line
    assert not (tmp_path / "ab.ply").exists()


def test_no_input_and_no_other_file_is_replaced(clouds, tmp_path, run, refused):
    before = [cloud.read_bytes() for cloud in clouds]
    start = ("fuse", *clouds, "--poses", tmp_path / "poses.json", "--out")
    (tmp_path / "link.ply").symlink_to(clouds[0])
    for out in (clouds[1], tmp_path / "poses.json", tmp_path / "link.ply"):
        assert "is what is read" in refused(*start, out, "--overwrite")
    (tmp_path / "other.ply").write_text("precious")
    assert "--overwrite" in refused(*start, tmp_path / "other.ply")
    assert (tmp_path / "other.ply").read_text() == "precious"
    assert [cloud.read_bytes() for cloud in clouds] == before
    assert run(*start, tmp_path / "other.ply", "--overwrite")[0] == 0


def test_nothing_to_fuse(refused):
    assert "--poses" in refused("fuse")
