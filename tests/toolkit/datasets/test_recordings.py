"""Every layout that is written gives back what was written, and none shows a traceback for
damage."""

import os
import random
import signal
from dataclasses import replace

import numpy as np
import pytest

import toolkit.datasets
from toolkit.datasets import recordings
from toolkit.datasets.layout import Layout
from toolkit.datasets.problem_kinds import add_problem
from toolkit.datasets.recording_views import Part, read
from toolkit.datasets.recordings import (
    LAYOUTS,
    find_layout,
    load_plugins,
    open_recording,
    write_recording,
)
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose, transform
from toolkit.objects import Objects

WRITTEN = sorted(name for name, layout in LAYOUTS.items() if layout.writer)
LABELLED = [name for name in WRITTEN if name != "rosbag"]
ONE_CLOUD = {"kitti", "dair", "sustech"}  # where the clouds of a sample become one


def scene(count=2, sensors=2):
    rng = np.random.default_rng(3)
    samples = []
    for k in range(count):
        boxes = np.column_stack(
            [
                rng.uniform(4, 40, 5),
                rng.uniform(-15, 15, 5),
                rng.uniform(0.5, 1.5, 5),
                rng.uniform(0.5, 9, (5, 3)),
                rng.uniform(-3.1, 3.1, 5),
            ]
        )
        clouds = tuple(
            SensorCloud(
                f"S{s}",
                rng.uniform(-30, 30, (40 + s, 3)).astype(np.float32),
                pose(3.0 * s, -2.0, 6.0, yaw=0.4 + s, pitch=0.05),
                intensity=rng.uniform(0, 1, 40 + s).astype(np.float32),
            )
            for s in range(sensors)
        )
        objects = Objects(boxes, np.array([0, 1, 2, 3, 0]), np.array([11, 12, 13, 14, 15]))
        place = pose(500.0, -200.0, 3.0, yaw=1.2)
        samples.append(
            Frame.of_clouds(f"{k}", clouds, objects, time=1e9 + 0.1 * k, map_SE3_world=place)
        )
    return samples


def place_of(folder, layout):
    """Where a layout is written below a folder, and where it is opened."""
    written = folder / "recording.hdf5" if LAYOUTS[layout].file else folder
    return written, folder / "bag" if layout == "rosbag" else written


def in_map(sample, boxes):
    turn = np.arctan2(sample.map_SE3_world[1, 0], sample.map_SE3_world[0, 0])
    return np.column_stack(
        [transform(sample.map_SE3_world, boxes[:, :3]), boxes[:, 3:6], boxes[:, 6] + turn]
    )


def where(sample, layout):
    """The map where the layout keeps one, else the world frame."""
    return (
        sample.map_SE3_world if layout in ("nuscenes", "opv2v", "v2xset", "v2xreal") else np.eye(4)
    )


@pytest.mark.parametrize("layout", LABELLED)
def test_boxes_come_back_within_a_millimetre_and_a_hundredth_of_a_degree(tmp_path, layout):
    written = scene()
    place, opened = place_of(tmp_path, layout)
    assert write_recording(written, place, layout) == 2
    back = list(find_layout(layout).open(opened))
    assert len(back) == len(find_layout(layout).open(opened)) == 2
    for before, after in zip(written, back, strict=True):
        a, b = before.objects.boxes, after.objects.boxes
        if layout in ("nuscenes", "opv2v", "v2xset", "v2xreal"):
            a, b = in_map(before, a), in_map(after, b)
        if layout in ("opv2v", "v2xset", "v2xreal"):  # ids sort as numbers do
            assert after.objects.ids.tolist() == [11, 12, 13, 14, 15]
        np.testing.assert_allclose(a[:, :6], b[:, :6], atol=1e-3)
        assert np.rad2deg(np.abs(np.angle(np.exp(1j * (a[:, 6] - b[:, 6]))))).max() < 0.01
        assert after.objects.labels.tolist() == [0, 1, 2, 3, 0]
        assert after.problems == {}


@pytest.mark.filterwarnings("ignore:.*no place for labels")
@pytest.mark.parametrize("layout", WRITTEN)
def test_points_come_back_where_they_were(tmp_path, layout):
    written = scene()
    place, opened = place_of(tmp_path, layout)
    write_recording(written, place, layout)
    for before, after in zip(written, find_layout(layout).open(opened), strict=True):
        assert len(after.clouds) == (1 if layout in ONE_CLOUD else 2)
        a, b = (transform(where(s, layout), s.points()) for s in (before, after))
        np.testing.assert_allclose(
            a, b, atol=2e-4 if layout in ("opv2v", "v2xset", "v2xreal") else 2e-5
        )
        intensity = np.concatenate([cloud.intensity for cloud in after.clouds])
        np.testing.assert_array_equal(
            intensity, np.concatenate([cloud.intensity for cloud in before.clouds])
        )


@pytest.mark.parametrize("layout", sorted({*WRITTEN} - {"rosbag"}))
def test_clouds_without_points_and_frames_without_objects_are_read(tmp_path, layout):
    nothing = SensorCloud("S0", np.zeros((0, 3), np.float32), np.eye(4))
    place, opened = place_of(tmp_path, layout)
    write_recording([Frame.of_clouds("0", (nothing,), Objects.empty())], place, layout)
    (back,) = find_layout(layout).open(opened)
    assert len(back.points()) == len(back.objects) == 0
    assert layout == "hdf5" or back.problems["clouds without points"] >= 1


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_empty_folder_is_refused_in_one_line(tmp_path, layout):
    with pytest.raises((FileNotFoundError, ValueError, OSError)) as refused:
        find_layout(layout).open(tmp_path)
    assert "\n" not in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def damaged(content, rng):
    """One change of a file: cut, zeroed, flipped, an exchanged character or a number that none
    should be."""
    kind = rng.randrange(5)
    at = rng.randrange(max(1, len(content)))
    if kind == 0:
        return content[:at]
    if kind == 1:
        return content[:at] + bytes(min(16, len(content) - at)) + content[at + 16 :]
    if kind == 2:
        return (
            content[:at]
            + bytes([content[at] ^ (1 << rng.randrange(8))] if content else b"")
            + content[at + 1 :]
        )
    if kind == 3:
        return (
            content[:at]
            + rng.choice([b"NaN", b"1e308", b"-1", b"{}", b"null", b'"', b"\xff", b"[[", b":"])
            + content[at:]
        )
    end = min(len(content), at + rng.randrange(1, 60))
    return content[:at] + content[end:]


@pytest.mark.filterwarnings("ignore:.*no place for labels")
@pytest.mark.parametrize("layout", WRITTEN)
def test_damaged_files_are_one_line_or_read(tmp_path, layout):
    """A slice of the 600 mutants; COVIEW_MUTANTS says how many of each layout."""
    pytest.importorskip("rosbags" if layout == "rosbag" else "numpy")
    place, opened = place_of(tmp_path, layout)
    write_recording(scene(1, 1), place, layout)
    files = sorted(file for file in tmp_path.rglob("*") if file.is_file())
    rng = random.Random(layout)
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("a mutant takes more than 20 s"))
    for _ in range(int(os.environ.get("COVIEW_MUTANTS", "6"))):
        file = rng.choice(files)
        sound = file.read_bytes()
        file.write_bytes(damaged(sound, rng))
        signal.alarm(20)
        try:
            said = read_all(layout, opened)
        finally:
            signal.alarm(0)
        assert said is None or ("\n" not in said and str(tmp_path) in said), said
        file.write_bytes(sound)


def read_all(layout, path):
    """What reading says where it refuses, None where it does not."""
    try:
        for sample in find_layout(layout).open(path):
            assert np.isfinite(sample.objects.boxes).all()
            assert np.isfinite(sample.points()).all()
    except (ValueError, OSError) as error:
        return str(error)
    return None


def test_parts_and_options_are_those_of_the_reader(tmp_path):
    with pytest.raises(ValueError, match="no layout 'kiti': choose among folder, kitti"):
        find_layout("kiti")
    part = Part(Read(range(7)), frames=2, every=3)
    assert [*map(str, part), len(part)] == ["0", "3", 2]
    assert [*map(str, Part(Read(range(7)), every=3))] == ["0", "3", "6"]
    assert len(Part(Read(range(3)), frames=9)) == 3
    for number in (-1, 2):
        with pytest.raises(IndexError, match="2 are chosen"):
            part[number]
    with pytest.raises(ValueError, match="--drop-invalid does not go with layout folder"):
        open_recording(tmp_path, drop_invalid=True)
    with pytest.raises(ValueError, match="--poses does not go with layout kitti"):
        open_recording(tmp_path, "kitti", poses=tmp_path / "poses.txt")


@pytest.fixture
def folder(tmp_path):
    boxes = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5], [9.0, 2, 3, 2, 1, 1.5, 0.5]])
    cloud = SensorCloud("s", np.array([[1, 1, 1], [0, 0, 0]], np.float32), np.eye(4))
    samples = [
        Frame.of_clouds(str(k), (cloud,), Objects(boxes, np.array([0, 1]))) for k in range(3)
    ]
    assert write_recording(samples, tmp_path, "folder") == 3
    return tmp_path


def test_a_recording_is_read_one_by_one_with_its_problems_or_missed(folder):
    samples = read(folder, "folder")
    assert iter(samples) is samples
    assert [sample.name for sample in samples] == ["000000", "000001", "000002"]
    assert len(open_recording(str(folder), "folder")) == 3
    assert toolkit.datasets.read is read
    assert [
        sample.objects.labels.tolist() for sample in read(folder, "folder", classes=["cyclist"])
    ] == [[1]] * 3
    assert [
        sample.objects.labels.tolist() for sample in read(folder, "folder", classes=[0, 1])
    ] == [[0, 1]] * 3
    with pytest.raises(ValueError, match="label must be one of"):
        read(folder, "folder", classes=["dog"])
    total: dict[str, int] = {}
    for sample in read(folder, "folder"):
        for kind, number in sample.problems.items():
            add_problem(total, kind, number)
    assert total == {"points of no return": 3}
    with pytest.raises(FileNotFoundError, match="no such recording"):
        read(folder / "other", "folder")
    with pytest.raises(ValueError, match="no layout 'x'"):
        read(folder, "x")
    with pytest.raises(ValueError, match="layout rcooper is only read"):
        write_recording([], folder, "rcooper")


class Read(list):
    site = None


@pytest.mark.parametrize(
    ("options", "message"), [({"every": 0}, "every must"), ({"frames": 0}, "frames must")]
)
def test_no_part_is_empty(options, message):
    with pytest.raises(ValueError, match=message):
        Part(Read(range(3)), **options)
    with pytest.raises(ValueError, match="there is no frame"):
        Part(Read())


def test_layouts_plug_in(monkeypatch):
    class Point:
        name = "mine"

        def load(self):
            return Layout("mine", "tests_own_layout", "mine")

    monkeypatch.setattr(
        recordings, "entry_points", lambda group: [Point()] if group == "coview.layouts" else []
    )
    load_plugins.cache_clear()
    assert find_layout("mine").reader == "mine"
    monkeypatch.undo()
    load_plugins.cache_clear()
    with pytest.raises(ValueError, match="there is no layout 'mine'"):
        find_layout("mine")


OWN_FILES = {
    "folder": ("labels.json", "poses.txt", "S0/000000.pcd"),
    "kitti": tuple(
        f"training/{name}"
        for name in ("label_2/000000.txt", "calib/000000.txt", "velodyne/000000.bin")
    ),
    "dair": ("label/virtuallidar/000000.json", "velodyne/000000.pcd"),
    "openlabel": ("labels_point_clouds/000000.json", "point_clouds/S0/000000_S0.pcd"),
    "sustech": ("label/000000.json", "lidar/000000.pcd"),
    "argoverse": (
        "annotations.feather",
        "city_SE3_egovehicle.feather",
        "calibration/egovehicle_SE3_sensor.feather",
    ),
    "nuscenes": ("v1.0-coview/sample_annotation.json", "samples/LIDAR_S0/000000.pcd.bin"),
}


@pytest.mark.parametrize("layout", OWN_FILES)
def test_pipes_devices_folders_and_lost_links_in_place_of_files_are_told(tmp_path, layout, limits):
    limits("toolkit.runtime.reading", MAX_SILENCE_S=0.01)
    write_recording(scene(), tmp_path, layout)
    for name in OWN_FILES[layout]:
        file = tmp_path / name
        sound = file.read_bytes()
        for make in (
            *(os.mkfifo, os.mkdir, lambda file: file.symlink_to("/dev/zero")),
            *(lambda file: file.symlink_to("/no/where"), lambda file: file.symlink_to(file)),
        ):
            file.unlink()
            make(file)
            with pytest.raises((ValueError, OSError), match=file.name):
                list(open_recording(tmp_path, layout))
            file.rmdir() if file.is_dir() else file.unlink()
            file.write_bytes(sound)


@pytest.mark.filterwarnings("ignore:.*no place for labels")
@pytest.mark.parametrize("layout", ["nuscenes", "argoverse", "rosbag"])
def test_times_that_no_clock_shows_or_that_two_sweeps_share_are_refused(tmp_path, layout):
    if layout == "rosbag":
        pytest.importorskip("rosbags")
    for k, time in enumerate((-1.0, 2.0**31, 1e300)):
        with pytest.raises(
            ValueError, match=r"frame '0' must have seconds since 1970, below 2\^31, got"
        ):
            write_recording([replace(scene()[0], time=time)], tmp_path / str(k), layout)
    twice = [replace(frame, time=1e9) for frame in scene()]
    if layout == "argoverse":
        with pytest.raises(ValueError, match="named by their times, but two are of 1e\\+09 s"):
            write_recording(twice, tmp_path / "log", layout)
    else:
        assert write_recording(twice, tmp_path / "log", layout) == 2


@pytest.mark.parametrize("name", ["pole 1", "Süd; links", "a,b", "#3", "left:", "plain-1.b"])
def test_poses_of_sensors_come_back_whatever_their_names(tmp_path, name):
    (frame,) = scene(1, 1)
    (cloud,) = frame.clouds
    placed = pose(1.5, -2.0, 6.25, yaw=0.3, pitch=0.2)
    write_recording(
        [frame.with_clouds((replace(cloud, name=name, world_SE3_sensor=placed),))],
        tmp_path,
        "folder",
    )
    (read,) = open_recording(tmp_path, "folder")
    assert [each.name for each in read.clouds] == [name]
    np.testing.assert_array_equal(read.clouds[0].world_SE3_sensor, placed)
    assert (tmp_path / "poses.txt").exists() == (name == "plain-1.b")
