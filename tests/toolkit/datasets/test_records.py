import json

import numpy as np
import pytest

from toolkit.class_names import CATEGORIES
from toolkit.datasets import (
    box_files,
    box_frames,
    cloud_records,
    frame_labels,
    problem_kinds,
    record_values,
)
from toolkit.datasets.listing import Listing, check_labels
from toolkit.datasets.recording_views import Part
from toolkit.frame import AWAY, Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Detections, Objects


def test_listings_read_when_asked_with_rotations_and_poses():
    read = []

    def load(name):
        read.append(name)
        return Frame.of_clouds(name, (), Objects.empty())

    listing = Listing(("a", "b", "c"), load)
    assert len(listing) == 3
    assert listing[1].name == "b"
    assert read == ["b"]
    assert [sample.name for sample in listing] == ["a", "b", "c"]
    assert listing[-1].name == "c"
    off = pose(yaw=0.3)[:3, :3] + 0.004
    matrix = record_values.rigid(off, [1, 2, 3])
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.abs(matrix[:3, :3] - off).max() < 0.01
    for wrong in (
        np.diag([1.0, 1, -1]),
        1.2 * np.eye(3),
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
    ):
        with pytest.raises(ValueError, match="must turn by a rotation"):
            record_values.rigid(wrong, [0, 0, 0])
    with pytest.raises(ValueError, match="NaN"):
        record_values.rigid(np.eye(3), [np.nan, 0, 0])
    placed = pose(1.0, 2.0, 3.0, yaw=0.5)
    np.testing.assert_allclose(record_values.rigid_matrix(placed.tolist()), placed)
    np.testing.assert_allclose(record_values.rigid_matrix(placed[:3].ravel().astype(str)), placed)
    np.testing.assert_allclose(box_frames.heading(pose(9.0, yaw=0.25), [0.5, -3.0]), [0.75, -2.75])
    assert box_frames.heading(np.diag([1.0, -1, 1, 1]), 0.5) == pytest.approx(-0.5)


@pytest.mark.parametrize(
    ("damage", "names"),
    [
        (lambda: record_values.entry({"a": 1}, "a", "b"), "it has no entry a.b"),
        (lambda: record_values.as_number("x", "size"), "size must be a number, got 'x'"),
        (lambda: record_values.as_number(None, "size"), "size must be a number, got 'None'"),
        (lambda: record_values.numbers([1, [2]], 3, "size"), "size must be 3 numbers"),
        (lambda: record_values.numbers([1, "b", 2], 3, "size"), "size must be 3 numbers"),
        *(
            (lambda: json.loads("{}")["key"], "'key'"),
            (lambda: b"\xff".decode(), "byte 0 is not UTF-8"),
        ),
    ],
)
def test_damage_is_one_line_with_the_file(damage, names):
    with (
        pytest.raises(ValueError, match=f"f.json .*{names}"),
        record_values.name_damage("f.json", "list"),
    ):
        damage()


BOX = [1.0, 2, 3, 4, 2, 1.5, 0.5]


def made(*rows, names=None, **more):
    problems = {}
    found = frame_labels.make_labels(
        np.array(rows, np.float64), names or ["car"] * len(rows), None, problems, **more
    )
    return found, problems


def test_impossible_labels_are_left_out():
    for column, value, problem in (
        *(
            (0, np.nan, "labels with NaN or infinite numbers"),
            (6, np.inf, "labels with NaN or infinite numbers"),
        ),
        *((4, 0.0018, "boxes of no size"), (5, -1.0, "boxes of no size")),
        *(
            (3, 101.0, "boxes too large or too far away to be"),
            (1, 1.1e8, "boxes too large or too far away to be"),
        ),
    ):
        found, problems = made(BOX, [*BOX[:column], value, *BOX[column + 1 :]])
        assert len(found.objects) == 1
        assert problems == {problem: 1}


def test_doubled_labels_are_left_out_and_near_ones_stay():
    twin = [BOX[0] + 0.0009, *BOX[1:]]
    apart = [BOX[0] + 0.0011, *BOX[1:]]
    found, problems = made(BOX, twin, apart, BOX, names=["car", "car", "car", "bus"])
    assert found.objects.labels.tolist() == [0, 0, 3]
    assert problems == {"doubled labels": 1}


def test_labels_of_other_kinds_are_kept_apart_with_their_counts():
    found, problems = made(BOX, BOX, names=["Traffic Cone", "PEDESTRIAN"], counts=[3, 8])
    assert found.objects.labels.tolist() == [2]
    assert found.counts.tolist() == [8]
    assert found.others.categories == ("Traffic Cone",)
    assert found.others.counts.tolist() == [3]
    assert problems == {"labels of other kinds than ours": 1}
    assert made(BOX, [0, *BOX[1:]], counts=[3, -1])[0].counts is None
    assert frame_labels.no_labels().counts is None


def test_yaws_beyond_a_full_turn_are_wrapped():
    found, problems = made([*BOX[:6], 7.0], [0.0, *BOX[1:6], 6.28])
    assert found.objects.boxes[0, 6] == pytest.approx(7 - 2 * np.pi)
    assert problems == {"yaws beyond a full turn": 1}


def test_kinds_and_tracks_are_the_same_everywhere():
    assert [CATEGORIES[name] for name in ("car", "van", "bus", "cyclist", "person_sitting")] == [
        0,
        0,
        3,
        1,
        2,
    ]
    assert [frame_labels.track_number(" 17 "), frame_labels.track_number("-3")] == [17, -3]
    assert (
        frame_labels.track_number("b1d0-44")
        == frame_labels.track_number("b1d0-44")
        != frame_labels.track_number("b1d0-45")
    )
    assert frame_labels.track_number("9" * 30) >= 0
    assert frame_labels.track_number("²") > 3


def test_points_of_no_use_are_left_out():
    made, problems = cloud(
        [[1, 2, 3], [np.inf, 0, 0], [0, 0, 0], [2e5, 0, 0]], intensity=np.arange(4.0)[:, None]
    )
    assert (made.points.tolist(), made.intensity.tolist()) == ([[1, 2, 3]], [0])
    assert problems == {"points with NaN or infinite numbers": 2, "points of no return": 1}
    problems = {}
    made = cloud_records.build_cloud(
        {"positions": np.zeros((1, 3))}, "s", np.eye(4), problems, frame="world"
    )
    assert (len(made.points), problems) == (1, {})


def test_intensity_and_times_are_read_of_every_name():
    # colours hold intensity in the red
    made, _ = cloud([[1, 0, 0]], colors=np.array([[7, 0, 0]], np.uint8))
    assert made.intensity.tolist() == [7]
    times = cloud([[1, 0, 0], [2, 0, 0]], t=np.array([500, 300], np.uint32))[0].time
    np.testing.assert_allclose(times, [2e-7, 0], atol=1e-15)
    times = cloud([[1, 0, 0], [2, 0, 0]], timestamp=np.array([1.6e9, 1.6e9 + 0.5]))[0].time
    np.testing.assert_allclose(times, [0, 0.5])
    assert cloud([[1, 0, 0]])[0].time is None
    assert cloud([[1, 0, 0]])[0].intensity is None


def cloud(points, **columns):
    problems = {}
    return cloud_records.build_cloud(
        {"positions": np.array(points, np.float64), **columns}, "s", np.eye(4), problems
    ), problems


def test_clouds_come_back_with_intensity(tmp_path):
    placed = pose(1.0, 2.0, 3.0, yaw=1.0)
    sensor = SensorCloud(
        "s", np.array([[4.0, 5, 6]], np.float32), placed, intensity=np.array([0.5], np.float32)
    )
    cloud_records.write_cloud(tmp_path / "a.pcd", sensor)
    problems = {}
    back = cloud_records.read_cloud(tmp_path / "a.pcd", "s", placed, problems)
    assert back.points.tolist() == sensor.points.tolist()
    assert back.intensity.tolist() == [0.5]


def test_clouds_of_a_frame_become_one():
    placed = pose(10.0)
    some = SensorCloud("a", np.ones((1, 3), np.float32), placed, intensity=np.ones(1, np.float32))
    other = SensorCloud("b", np.ones((2, 3), np.float32), np.eye(4))
    together = cloud_records.one_cloud(Frame.of_clouds("0", (some, other), Objects.empty()))
    assert together.points[:, 0].tolist() == [11, 1, 1]
    assert together.intensity is None
    assert cloud_records.one_cloud(
        Frame.of_clouds("0", (some,), Objects.empty())
    ).intensity.tolist() == [1]


def test_rings_are_whole_numbers_or_none(tmp_path):
    assert cloud([[1, 0, 0]])[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([2.5]))[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([np.nan]))[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([1e6]))[0].ring is None
    assert cloud([[1, 0, 0]], ring=np.array([31.0], np.float32))[0].ring.tolist() == [31]
    made, _ = cloud(
        [[1, 0, 0], [0, 0, 0], [2, 0, 0]], laser_number=np.array([[31], [4], [7]], np.uint8)
    )
    assert made.ring.tolist() == [31, 7]
    cloud_records.write_cloud(tmp_path / "a.pcd", made)
    assert cloud_records.read_cloud(tmp_path / "a.pcd", "s", np.eye(4), {}).ring.tolist() == [31, 7]


BOX_BOXES_FILE = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5]])


def test_boxes_there_and_back(tmp_path):
    objects = Objects(BOX_BOXES_FILE, np.array([2]), np.array([7]))
    box_files.write_boxes(
        tmp_path / "a.json", [box_files.boxes_record("x", 0.5, objects, counts=[9])]
    )
    (each,) = box_files.read_entries(tmp_path / "a.json").values()
    assert each["time"] == 0.5
    assert each["objects"][0]["yaw_deg"] == pytest.approx(28.6478898)
    found = box_files.parse_objects(tmp_path / "a.json", each, {})
    np.testing.assert_allclose(found.objects.boxes, BOX_BOXES_FILE, atol=1e-12)
    assert found.objects.ids.tolist() == [7]
    assert found.counts.tolist() == [9]
    sure = Detections(BOX_BOXES_FILE, np.array([0.75]), np.array([3]))
    box_files.write_boxes(
        tmp_path / "a.json", [box_files.boxes_record("x", float("nan"), sure)], detector="general"
    )
    content = json.loads((tmp_path / "a.json").read_text())
    assert content["detector"] == "general"
    assert content["samples"][0]["time"] is None
    each = box_files.read_entries(tmp_path / "a.json")["x"]
    back = box_files.parse_objects(tmp_path / "a.json", each, {}).objects
    np.testing.assert_allclose(back.boxes, BOX_BOXES_FILE, atol=1e-12)
    assert (each["objects"][0]["score"], back.labels.tolist()) == (0.75, [3])


@pytest.mark.parametrize(
    ("content", "names"),
    [
        *(
            ("{}", "its form must be .*got an empty object"),
            ('{"coview": "boxes", "version": 2, "samples": []}', "got version 2"),
        ),
        ('{"coview": "boxes", "version": 1, "samples": {}}', "samples must be a list"),
        ('{"coview": "boxes", "version": 1, "samples": [{}]}', "no entry name"),
    ],
)
def test_damage_names_the_file(tmp_path, content, names):
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ValueError, match=f"a.json .*{names}"):
        box_files.read_entries(tmp_path / "a.json")


def test_labels_without_a_cloud_are_counted_once_and_none_with_one_is_refused():
    def load(name):
        return Frame.of_clouds(name, (), car, problems={"doubled labels": 2})

    car = Objects(np.array([[0.0, 0.0, 0.75, 4.2, 1.8, 1.5, 0.0]]))
    some = Listing(("a", "b"), load, labelled=("a", "c", "c", "d"))
    assert [frame.problems for frame in some] == [
        {"doubled labels": 2, problem_kinds.STRAY: 2},
        {"doubled labels": 2},
    ]
    assert some[-2].problems[problem_kinds.STRAY] == 2
    assert some.describe_strays().startswith("2 of the 3 names")
    assert "'c', where clouds have 'a'" in some.describe_strays()
    check_labels(some)
    for sound in (Listing(("a",), load), Listing(("a",), load, labelled=["7"], known=["7"])):
        assert not sound.describe_strays()
        check_labels(sound)
    with pytest.raises(
        ValueError, match=r"no label can be used: 1 of the 1 names.*'1646667310044', where .* 'a'"
    ):
        check_labels(Part(Listing(("a",), load, labelled=["1646667310044"])))
    car = Objects.empty()
    with pytest.raises(ValueError, match="no label, so nothing can be scored: take coview detect"):
        check_labels(Listing(("a",), load))


def test_labels_are_looked_for_in_the_frames_that_a_view_shows():
    """Every third frame is labelled: a view of these has labels from its first frame on, one of the
    others none."""
    car = Objects(np.array([BOX]), np.zeros(1, np.int64))

    def load(name):
        return Frame.of_clouds(name, (), car if int(name) % 3 == 0 else Objects.empty())

    listing = Listing(tuple(map(str, range(3, 9))), load)
    check_labels(Part(listing, every=3), 1)
    check_labels(Part(listing, frames=2, every=3))
    unlabelled = Listing(("1", "2", "3", "4", "5", "6"), load)
    check_labels(Part(unlabelled, every=2), 2)  # frames 1 and 3
    with pytest.raises(ValueError, match="no label, so nothing can be scored"):
        check_labels(Part(unlabelled, every=3), 2)  # frames 1 and 4


@pytest.mark.parametrize(
    ("place", "away"), [([900.0, 0.0, 0.0], 0), ([4500.0, 0.0, 0.0], 1), ([0.0, 0.0, 2000.0], 1)]
)
def test_boxes_far_from_every_sensor_and_point_are_counted(place, away):
    points, box = (
        np.zeros((2, 3), np.float32),
        Objects(np.array([[*place, *BOX[3:]]]), np.zeros(1, int), np.zeros(1, int)),
    )
    seen = SensorCloud("a", points, np.eye(4))
    expected = {AWAY: away} if away else {}
    assert Frame.of_clouds("f", (seen,), box).problems == expected
    # without its sensor's place
    in_map = SensorCloud("b", points + np.float32(max(place)), np.eye(4), "world")
    assert Frame.of_clouds("f", (seen, in_map), box[:0]).problems == {}
    around = SensorCloud("b", np.array([place], np.float32), np.eye(4), "world")
    assert Frame.of_clouds("f", (seen, around), box).problems == {}


def test_points_that_are_no_metres_none_or_at_the_sensor_are_counted_or_refused():
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (500, 3)) - np.array([0, 0, 5])

    def problems(points):
        met: dict[str, int] = {}
        cloud_records.build_cloud({"positions": points}, "a", np.eye(4), met)
        return met

    in_map = points + np.array([5e5, 5e6, 0])
    assert problems(points) == problems(np.concatenate([points, [[500, 0, 0]]])) == {}
    assert problems(in_map) == problems(in_map / 100) == {problem_kinds.UNPLACED: 1}
    deep = points * [1, 1, 200.0]
    away = np.linalg.norm(deep - np.median(deep, axis=0), axis=1)
    assert problems(deep) == {problem_kinds.FAR_POINTS: (away > 1000).sum()}
    assert problems(0 * points) == {problem_kinds.NO_RETURN_POINTS: 500, problem_kinds.EMPTY: 1}
    for axis in range(3):
        with pytest.raises(
            ValueError,
            match=r"half of its points are more than .* km from their middle: give metres",
        ):
            problems(points * np.where(np.arange(3) == axis, 1000, 1))
