"""The page on your own roadside recording, command by command, on one that is made and on a real
one."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from models.training.packed import PackedFrames
from toolkit.boxes import footprints
from toolkit.datasets.pose_files import read_poses
from toolkit.datasets.recording_views import read
from toolkit.datasets.recordings import write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.models import RowLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid

ROOT = Path(__file__).parents[2]
LOG = Path(os.environ.get("COVIEW_SHARED", ROOT.parent / "shared")) / "real" / "av2_two_lidars"
REACH = ("--area", -30, -30, 30, 30)


def rows(path, measure):
    content = json.loads(path.read_text())
    wanted = ("vehicle", "ours", measure, "all")
    return [
        r
        for r in content["breakdown"]
        if (r["label"], r["protocol"], r["measure"], r["among"]) == wanted
    ]


@pytest.fixture(scope="session")
def own(recording, tmp_path_factory):
    """One frame of a simulated recording as a folder of clouds."""
    folder = tmp_path_factory.mktemp("own") / "mine"
    samples = [sample for sample, _ in zip(read(recording, "hdf5"), range(1), strict=False)]
    write_recording(samples, folder, "folder")
    return folder


def test_from_a_folder_to_ap(own, tmp_path, run):
    mine = (own, "--layout", "folder")
    assert "objects per frame" in run("survey", *mine)[1]
    assert run("doctor", *mine)[:2] == (0, "nothing suspected\n")
    assert (
        run(
            "detect", *mine, *REACH, "--level", "plane", "--still", "--out", tmp_path / "boxes.json"
        )[0]
        == 0
    )
    assert len(json.loads((tmp_path / "boxes.json").read_text())["samples"]) == 1
    assert (
        run("evaluate", *mine, *REACH, "--level", "plane", "--still", "--out", tmp_path / "e")[0]
        == 0
    )
    (row,) = rows(tmp_path / "e" / "table.json", "BEV 0.5")
    assert row["ap"] > 0.5
    assert run("convert", *mine, "--to", "kitti", "--out", tmp_path / "kitti")[0] == 0


@pytest.mark.slow
def test_from_a_folder_to_a_trained_detector(own, tmp_path, run):
    packed = tmp_path / "mine.packed"
    assert (
        run("pack", own, "--layout", "folder", *REACH, "--level", "plane", "--out", packed)[0] == 0
    )
    assert len(PackedFrames(packed)) == 1
    trained = (
        "train",
        "--data",
        packed,
        "--start",
        "general",
        "--preset",
        "general",
        "--epochs",
        1,
        "--batch",
        1,
    )
    code, _, err = run(*trained, "--workers", 0, "--out", tmp_path / "runs")
    assert code == 0, err
    assert (tmp_path / "runs" / "weights.safetensors").is_file()


@pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")
def test_the_real_log_is_surveyed_and_levelled(tmp_path, run):
    pytest.importorskip("pyarrow")
    log = (LOG, "--layout", "argoverse")
    assert (
        "162 of 162 labelled cuboids hold as many points as the set says" in run("survey", *log)[1]
    )
    assert run("doctor", *log)[:2] == (0, "nothing suspected\n")
    found = {}
    for level in ("none", "plane"):
        arguments = (
            "--frames",
            1,
            "--classes",
            "vehicle",
            "--level",
            level,
            "--out",
            tmp_path / level,
        )
        assert run("evaluate", *log, *arguments)[0] == 0
        (row,) = rows(tmp_path / level / "table.json", "BEV 0.5")
        found[level] = row["ap"]
    assert found["plane"] > 0.5
    assert found["plane"] > found["none"]


@pytest.mark.skipif(not LOG.is_dir(), reason="the recording is not here")
def test_the_foreground_of_the_real_log_is_detected(tmp_path, run):
    given = ("--area", -25, -25, 25, 25, "--classes", "vehicle", "--level", "plane")
    chosen = ("--layout", "argoverse", *given, "--schemes", "foreground")
    code, said, err = run("evaluate", LOG, *chosen, "--out", tmp_path)
    assert code == 0, err
    assert "empty scenes are learnt from 2 samples" in err
    assert "up_lidar: of 103592 points its images leave out" in said
    (row,) = rows(tmp_path / "table.json", "BEV 0.5")
    assert row["ap"] > 0.5
    content = json.loads((tmp_path / "table.json").read_text())
    assert 10 < content["schemes"]["foreground"]["kbit_per_sensor"] < 100


@pytest.fixture(scope="session")
def lidars(tmp_path_factory):
    """Six samples of two 32-row lidars beside a street, one of them crooked; two cars stand
    elsewhere in each."""
    model = RowLidar(tuple(np.deg2rad(np.linspace(0, -40, 32))), columns=720)
    hut = Solid(np.array([[-14.0, 10], [-8, 10], [-8, 16], [-14, 16]]), 0.0, 4.0, "building")
    true = [
        Sensor("east", model, pose(-6.0, -9.0, 4.5, yaw=1.0)),
        Sensor("west", model, pose(6.0, -9.0, 4.5, yaw=2.0)),
    ]
    crooked = pose(roll=np.deg2rad(0.4), pitch=np.deg2rad(0.6)) @ true[1].pose
    rng, samples = np.random.default_rng(0), []
    for k in range(6):
        boxes = np.array(
            [
                [-12.0 + 4 * k, 0.0, 0.75, 4.4, 1.9, 1.5, 0.0],
                [9.0 - 3 * k, 4.0, 0.75, 4.2, 1.8, 1.5, 0.0],
            ]
        )
        cars = tuple(Solid(footprint, 0.0, 1.5, "container") for footprint in footprints(boxes))
        site = Site("street", np.array([-25.0, -25, 25, 25]), solids=(hut, *cars))
        clouds = []
        for sensor, image in zip(
            true, Renderer(site, [], tuple(true), threads=1).background, strict=True
        ):
            noisy = model.noisy(image, rng)
            points = (model.rays() * noisy[..., None])[noisy > 0]
            believed = sensor.pose if sensor.name == "east" else crooked
            clouds.append(SensorCloud(sensor.name, points, believed))
        samples.append(Frame.of_clouds(str(k), tuple(clouds), Objects(boxes)))
    folder = tmp_path_factory.mktemp("lidars") / "street"
    write_recording(samples, folder, "folder")
    return folder


LIDAR_AREA = (
    "--layout",
    "folder",
    "--area",
    -20,
    -20,
    20,
    20,
    "--level",
    "plane",
    "--still",
    "--classes",
    "vehicle",
)


@pytest.mark.slow
def test_schemes_on_lidars_that_are_put_right(lidars, tmp_path, run):
    arguments = ("evaluate", lidars, *LIDAR_AREA, "--schemes", "early", "foreground", "--rate", 10)
    code, said, err = run(
        *arguments, "--detector", "cluster", "--calibrate", "together", "--out", tmp_path
    )
    assert code == 0, err
    assert "west: turned by 0." in said
    assert "at 10 Hz" in said
    assert "east: of 1" in said
    content = json.loads((tmp_path / "table.json").read_text())
    assert 0.2 < content["poses"]["west"]["turned_deg"] < 0.8
    early, foreground = (
        content["schemes"][name]["kbit_per_sensor"] for name in ("early", "foreground")
    )
    assert foreground < early / 15
    assert min([row["ap"] for row in rows(tmp_path / "table.json", "BEV 0.5")]) > 0.5


def test_lidars_are_calibrated_by_each_other(lidars, tmp_path, run, refused):
    arguments = ("calibrate", lidars, "--layout", "folder", "--held", "east", "--frames", 5)
    code, said, err = run(
        *arguments, "--poses", tmp_path / "poses.json", "--out", tmp_path / "right"
    )
    assert code == 0, err
    assert "west: turned by 0." in said
    found = read_poses(tmp_path / "poses.json")
    true = pose(6.0, -9.0, 4.5, yaw=2.0)
    assert np.abs(next(read(lidars, "folder")).clouds[1].world_SE3_sensor - true).max() > 0.05
    assert np.abs(found["west"][:3, :3] - true[:3, :3]).max() < 0.003
    right = list(read(tmp_path / "right", "folder"))
    assert len(right) == 5
    np.testing.assert_allclose(right[4].clouds[1].world_SE3_sensor, found["west"], atol=1e-9)
    assert "recorded clouds have errors of their own" in refused(*arguments, "--errors", "poor")
    assert "no sensor 'south'" in refused(
        "calibrate", lidars, "--layout", "folder", "--held", "south"
    )


@pytest.mark.slow
def test_lidars_are_scored_alone_and_by_clusters(lidars, tmp_path, run):
    alone = tmp_path / "alone"
    samples = []
    for sample in read(lidars, "folder"):
        east, west = sample.clouds
        blinded = SensorCloud("west", west.points[:9], west.world_SE3_sensor)
        samples.append(sample.with_clouds((east, blinded)))
    write_recording(samples, alone, "folder")
    arguments = (
        "evaluate",
        alone,
        "--layout",
        "folder",
        "--level",
        "plane",
        "--still",
        "--classes",
        "vehicle",
    )
    chosen = (*arguments, "--detector", "cluster", "--sensors", "east", "--schemes", "foreground")
    code, said, err = run(*chosen, "--out", tmp_path / "e")
    assert code == 0, err
    assert "west" not in said
    (row,) = rows(tmp_path / "e" / "table.json", "BEV 0.5")
    assert row["ap"] > 0.3
    code, _, err = run(
        *arguments, "--detector", "cluster", "--schemes", "foreground", "--out", tmp_path / "x"
    )
    assert code == 2
    assert "54 points of west say nothing of its rows" in err
    code, said, err = run(
        "evaluate", lidars, *LIDAR_AREA, "--detector", "cluster", "--out", tmp_path
    )
    assert code == 0, err
    assert "all clouds" in said
    (row,) = rows(tmp_path / "table.json", "BEV 0.5")
    assert row["ap"] > 0.5


def test_calibration_is_by_what_there_is(lidars, tmp_path, refused):
    arguments = ("evaluate", lidars, *LIDAR_AREA, "--out", tmp_path)
    assert "nowhere.ply" in refused(*arguments, "--calibrate", "nowhere.ply")
