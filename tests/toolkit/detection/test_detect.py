"""A detector in frames: levelled, detected in, written."""

import json
from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration.level_frames import level_frames
from toolkit.calibration.place import Place, Stand
from toolkit.datasets.box_files import parse_objects, read_entries
from toolkit.detection.detect import (
    FrameDetections,
    describe_summary,
    detect_frames,
    file_name,
    summarise,
    write_detections,
)
from toolkit.frame import Frame, Rectangle, SensorCloud
from toolkit.geometry import pose, tilt_rows, transform
from toolkit.objects import Detections, Objects
from toolkit.sites.files import load_site
from toolkit.sites.site import Site


def street(rng, count=6000):
    """Ground, and a block of 4 × 2 × 1.5 m that stands on it at (10, 5)."""
    ground = np.column_stack([rng.uniform(-30, 30, (count, 2)), rng.normal(0, 0.01, count)])
    block = np.column_stack(
        [rng.uniform(8, 12, 400), rng.uniform(4, 6, 400), rng.uniform(0, 1.5, 400)]
    )
    return np.concatenate([ground, block])


class Blocks:
    """Detects the mean of what stands 0.3 to 2 m above z = 0, as a box."""

    def __init__(self):
        self.seen = []

    def __call__(self, points):
        self.seen.append(points)
        high = points[(points[:, 2] > 0.3) & (points[:, 2] < 2)]
        if not len(high):
            return Detections.empty()
        x, y, _ = high.mean(axis=0)
        return Detections(np.array([[x, y, 0.75, 4, 2, 1.5, 0.0]]), np.array([0.9]))


def samples(world, count=1):
    """Clouds of the street as a lidar 3 m above its middle measured it, in a world where the street
    lies at `world`."""
    made = []
    for k in range(count):
        place = world @ pose(0.0, 0.0, 3.0)
        points = transform(pose(0.0, 0.0, -3.0), street(np.random.default_rng(k)))
        made.append(
            Frame.of_clouds(
                str(k), (SensorCloud("s", points.astype(np.float32), place),), Objects.empty()
            )
        )
    return made


class Recorded(list):
    """Frames at a known site."""

    site: Site | None = None


def test_a_known_site_that_slopes_is_detected_in_on_level_ground():
    flat = load_site("tjunction")
    recorded = Recorded(samples(np.eye(4)))
    recorded.site = replace(flat, relief=replace(flat.relief, slope=(0.05, 0.0)))
    (cloud,) = recorded[0].clouds
    tilted = tilt_rows(cloud.in_world(), (0.05, 0.0)).astype(np.float32)
    recorded[0] = recorded[0].with_clouds([replace(cloud, points=tilted, frame="world")])
    (found,) = detect_frames(recorded, Blocks())
    np.testing.assert_allclose(found.detections.boxes[0, :3], [10.0, 5.0, 0.75 + 0.5], atol=0.15)


@pytest.mark.parametrize("levelling", ["map", "plane"])
def test_a_street_that_leans_far_from_the_origin_is_detected_in(levelling):
    """A kilometre away, 120 m up, and leaning by 3 degrees: boxes are where they stand in that
    world."""
    world = pose(1000.0, 2000.0, 120.0, yaw=0.5, pitch=np.deg2rad(3))
    (found,) = detect_frames(samples(world), Blocks(), Place(levelling))
    expected = transform(world, np.array([[10.0, 5.0, 0.75]]))[0]
    np.testing.assert_allclose(found.detections.boxes[0, :3], expected, atol=0.15)
    assert found.stand.warning is None
    assert found.stand.ground.tilt == pytest.approx(np.deg2rad(3), abs=0.003)
    assert (
        found.stand.middle.tolist()
        == np.round(transform(world, np.array([[0.0, 0, 3]]))[0, :2]).tolist()
    )
    assert found.stand.ms > 0
    assert found.detect_ms > 0


def test_raw_clouds_are_warned_of():
    (found,) = detect_frames(samples(pose(0.0, 0.0, -1.7)), Blocks(), Place("none"))
    assert "ground seems to lie at z = -1.70 m" in str(found.stand.warning)
    assert found.stand.ground is None


def test_points_are_counted_from_the_middle():
    detector = Blocks()
    (found,) = detect_frames(
        samples(pose(5000.0)), detector, Place("none", area=(4995.0, -8.0, 5015.0, 12.0))
    )
    assert detector.seen[0].dtype == np.float32
    assert detector.seen[0][:, 0].min() == pytest.approx(-35, abs=0.1)
    np.testing.assert_allclose(found.detections.boxes[0, :2], [5010, 5], atol=0.1)


def test_still_sensors_have_one_ground():
    still = list(detect_frames(samples(np.eye(4), 2), Blocks(), Place(still=True)))
    assert still[0].stand.ground is still[1].stand.ground
    other = list(detect_frames(samples(np.eye(4), 2), Blocks()))
    assert other[0].stand.ground is not other[1].stand.ground
    with pytest.raises((ValueError, TypeError), match=r"one of map, plane, none|Type-check"):
        Place("flat")


def test_clouds_without_ground_are_not_levelled():
    nothing = Frame.of_clouds(
        "0", (SensorCloud("s", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty()
    )
    few = Frame.of_clouds(
        "1", (SensorCloud("s", np.array([[1, 1, 1.0]], np.float32), np.eye(4)),), Objects.empty()
    )
    first, second = detect_frames([nothing, few], Blocks())
    assert len(first.detections) == 0
    assert first.stand.warning is None
    assert str(second.stand.warning).startswith("not levelled: no ground found in 1 points")
    assert len(second.detections) == 1
    clouds = tuple(
        SensorCloud(name, np.ones((2, 3), np.float32), pose(k))
        for k, name in ((0.0, "a"), (9.0, "b"))
    )
    detector = Blocks()
    sample = Frame.of_clouds("0", clouds, Objects.empty())
    list(
        detect_frames([sample.seen_by(["b"])], detector, Place("none", area=(-1.0, -1.0, 1.0, 1.0)))
    )
    assert detector.seen[0].tolist() == [[10, 1, 1]] * 2
    assert Place().find_middle(sample).tolist() == [4, 0]


def sample(complete=None, lift=20.0):
    """Ground `lift` m up, sensors at (100, 0), a car 10 m ahead, one 53 m away and one 80 m
    away."""
    rng = np.random.default_rng(0)
    street = np.column_stack(
        [rng.uniform(60, 140, 6000), rng.uniform(-40, 40, 6000), rng.normal(lift, 0.005, 6000)]
    )
    post = np.tile([110.0, 0.0, lift + 1.0], (30, 1))
    cloud = SensorCloud(
        "s", np.concatenate([street, post]).astype(np.float32), pose(100.0, 0.0, lift + 5), "world"
    )
    boxes = np.array([[x, 0, lift + 0.75, 4, 2, 1.5, 0.3] for x in (110.0, 153.0, 180.0)])
    return Frame.of_clouds(
        "0", (cloud,), Objects(boxes), **({} if complete is None else {"complete": complete})
    )


@pytest.mark.parametrize("levelling", ["map", "plane"])
def test_points_and_boxes_stand_on_the_ground(levelling):
    (made,) = level_frames([sample()], Place(levelling))
    assert made.area == (-50, -50, 50, 50)
    assert made.sensors == ("s",)
    np.testing.assert_allclose(made.objects.boxes[0], [10, 0, 0.75, 4, 2, 1.5, 0.3], atol=0.03)
    assert len(made.objects) == 2  # the one on the edge is kept, the far one is not
    np.testing.assert_allclose(
        made.clouds[0][made.clouds[0][:, 2] > 0.5].mean(axis=0), [10, 0, 1], atol=0.03
    )
    assert made.clouds[0].dtype == np.float32
    assert made.clouds[0][:, 2].min() > 0


def test_samples_for_training_have_area_and_ground():
    (made,) = level_frames([sample(Rectangle((100.0, -5.0, 120.0, 5.0)))], Place("plane"))
    assert (made.clouds[0][:, 0] >= 0).all()
    assert (np.abs(made.clouds[0][:, 1]) <= 5).all()
    first, second = level_frames(
        [sample(), sample(lift=20.4)], Place(still=True, area=(102.0, -6.0, 118.0, 6.0))
    )
    assert first.area == (-8, -6, 8, 6)
    assert first.objects.boxes[0, 0] == pytest.approx(0, abs=0.01)
    assert second.objects.boxes[0, 2] == pytest.approx(1.15, abs=0.03)
    nothing = Frame.of_clouds(
        "0", (SensorCloud("s", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty()
    )
    one = Frame.of_clouds(
        "0", (SensorCloud("s", np.ones((1, 3), np.float32), np.eye(4)),), Objects.empty()
    )
    assert list(level_frames([nothing, one], Place())) == []
    assert len(list(level_frames([one], Place("none")))) == 1


BOX = np.array([[10.0, 2, 1, 4, 2, 1.5, 0.5]])


@pytest.fixture
def found():
    detections = Detections(BOX, np.array([0.75]))
    problems = ({"doubled labels": 2}, {"doubled labels": 1})
    return [
        FrameDetections(
            Frame.of_clouds(f"a/{k}", (), Objects.empty(), problems=each),
            detections,
            Stand(np.zeros(4), np.zeros(2), ms=10.0 + k),
            20.0 + k,
        )
        for k, each in enumerate(problems)
    ]


def test_boxes_in_a_file_come_back(found, tmp_path):
    assert list(write_detections(iter(found), tmp_path / "b.json", weights="general")) == found
    entries = read_entries(tmp_path / "b.json")
    assert list(entries) == ["a/0", "a/1"]
    np.testing.assert_allclose(
        parse_objects("b.json", entries["a/0"], {}).objects.boxes, BOX, atol=1e-12
    )
    assert json.loads((tmp_path / "b.json").read_text())["weights"] == "general"


def test_boxes_are_written_as_openlabel_and_kitti(found, tmp_path):
    list(write_detections(iter(found), tmp_path / "o", "openlabel"))
    list(write_detections(iter(found), tmp_path / "k", "kitti"))
    assert sorted(file.name for file in (tmp_path / "o").glob("*.json")) == ["a_0.json", "a_1.json"]
    words = (tmp_path / "k/a_0.txt").read_text().split()
    assert words[0] == "Car"
    assert len(words) == 16
    assert float(words[-1]) == 0.75
    assert file_name("106-105/seq-1/00000 b") == "106-105_seq-1_00000_b"


def test_frames_with_one_file_name_are_refused(found, tmp_path):
    twin = replace(found[0], frame=replace(found[0].frame, name="a_0"))
    with pytest.raises(ValueError, match="frames 'a/0' and 'a_0' would both be written to 'a_0'"):
        list(write_detections([found[0], twin], tmp_path / "k", "kitti"))
    assert not (tmp_path / "k").exists()


def test_a_summary_counts_boxes_problems_and_time(found):
    figures = summarise(found)
    assert figures == {
        "samples": 2,
        "detections": 2,
        "problems": {"doubled labels": 3},
        "level_ms": 10.5,
        "detect_ms": 20.5,
    }
    assert (
        describe_summary(figures)
        == "2 detections in 2 clouds; 10 ms to level, 20 ms to detect; 3 doubled labels"
    )
    assert describe_summary(summarise([])) == "0 detections in 0 clouds"
