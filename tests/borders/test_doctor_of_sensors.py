"""The doctor on a sound recording, changed by hand: frames of labels, times, rates, and points of
one sensor.

Rays are cast here by the slab method (T. L. Kay and J. T. Kajiya, 1986), not by the simulator."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.calibration.ground import level
from toolkit.datasets.box_frames import move_boxes
from toolkit.datasets.layouts.folder import write_folder
from toolkit.doctor import box_fits
from toolkit.doctor.diagnosis import diagnose
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, pose, transform
from toolkit.objects import Objects

POLES = {
    "east": pose(25.0, 3.0, 5.0, yaw=2.5),
    "north": pose(-4.0, 26.0, 6.0, yaw=-1.2),
    "south": pose(2.0, -24.0, 5.0),
}
# one quickly, the others with the slow tests
ONE_POLE_QUICKLY = (
    "east",
    pytest.param("north", marks=pytest.mark.slow),
    pytest.param("south", marks=pytest.mark.slow),
)
START_S = 1_700_000_000.0
STEP_S = 0.1
LATE_S = 0.05
COUNT = 10


def beams():
    elevations = np.deg2rad(np.linspace(-32, 2, 32))
    azimuths = np.deg2rad(np.arange(0, 360, 1.0))
    elevation, azimuth = np.meshgrid(elevations, azimuths, indexing="ij")
    level = np.cos(elevation)
    return np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)


BEAMS = beams()


def cars(time_s):
    """Ten cars on two crossing streets, in m and rad, as they are at a time after the start."""
    rows = []
    for k in range(5):
        speed = 7.0 + k
        x = -38.0 + 17.0 * k + speed * time_s
        rows.append([x, -1.8 if k % 2 else 1.8, 0.75, 4.4, 1.8, 1.5, 0.0])
        y = 38.0 - 17.0 * k - speed * time_s
        rows.append([9.0 if k % 2 else 12.6, y, 0.8, 4.2, 1.7, 1.6, -np.pi / 2])
    return np.array(rows)


def cast(sensor_pose, boxes):
    """Points in the sensor's frame of cars on level ground."""
    directions = BEAMS @ sensor_pose[:3, :3].T
    origin = sensor_pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        nearest = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
        for x, y, z, length, width, height, yaw in boxes:
            turn = np.array(
                [[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
            )
            start, along = turn @ (origin - [x, y, z]), directions @ turn.T
            half = np.array([length, width, height]) / 2
            entries = np.sort([(-half - start) / along, (half - start) / along], axis=0)
            enter, leave = entries[0].max(axis=1), entries[1].min(axis=1)
            hit = (enter < leave) & (enter > 0)
            nearest = np.where(hit, np.minimum(nearest, enter), nearest)
    rng = np.random.default_rng(len(boxes))
    ranges = nearest + rng.normal(0, 0.01, len(nearest))
    returned = nearest < 55
    return (BEAMS[returned] * ranges[returned, None]).astype(np.float32)


@cache
def measure(name, time_s):
    """Points of one sensor, which most recordings here share."""
    return cast(POLES[name], cars(time_s))


def record(late=None, stamped=True):
    """Frames of all sensors at 10 Hz. late: sensor that measures `LATE_S` after the others."""
    frames = []
    for k in range(COUNT):
        clouds = []
        for name, place in POLES.items():
            delay_s = LATE_S if name == late else 0.0
            time_s = STEP_S * k + delay_s
            stamp_s = START_S + time_s if stamped else None
            clouds.append(SensorCloud(name, measure(name, time_s), place, stamp_s=stamp_s))
        objects = Objects(cars(STEP_S * k), ids=np.arange(10))
        frames.append(Frame.of_clouds(f"{k:06d}", clouds, objects, time=START_S + STEP_S * k))
    return frames


@pytest.fixture(scope="module", autouse=True)
def ground_found_once(sound):
    """The street is level in all frames, so its ground is found in the first."""
    ground = level(sound[0].points()[::4], method="map")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(box_fits, "level", lambda points, method: ground)
        yield


@pytest.fixture(scope="module")
def sound():
    return record()


def change(frames, name, edit):
    """Frames with one sensor's cloud changed, or left out if `edit` returns None."""
    changed = []
    for k, frame in enumerate(frames):
        clouds = [edit(k, cloud) if cloud.name == name else cloud for cloud in frame.clouds]
        changed.append(frame.with_clouds([cloud for cloud in clouds if cloud is not None]))
    return changed


def findings_of(frames, path):
    write_folder(frames, path)
    return [
        f"{finding.where}: {finding.suspected}" for finding in diagnose(path, "folder").findings
    ]


def test_sound_recordings_are_healthy(sound, tmp_path):
    assert findings_of(sound, tmp_path / "stamped") == []
    assert findings_of(record(stamped=False), tmp_path / "plain") == []


@pytest.mark.parametrize("name", ONE_POLE_QUICKLY)
def test_labels_in_a_sensors_frame(sound, tmp_path, name):
    spoilt = [
        replace(
            frame,
            objects=replace(
                frame.objects, boxes=move_boxes(invert(POLES[name]), frame.objects.boxes)
            ),
        )
        for frame in sound
    ]
    assert findings_of(spoilt, tmp_path) == [
        f"labels: labels are in the frame of sensor {name}, not in the world"
    ]


@pytest.mark.parametrize("name", ONE_POLE_QUICKLY)
def test_labels_moved_out_of_the_world(sound, tmp_path, name):
    spoilt = []
    for frame in sound:
        boxes = move_boxes(POLES[name], frame.objects.boxes)
        spoilt.append(replace(frame, objects=replace(frame.objects, boxes=boxes)))
    assert findings_of(spoilt, tmp_path) == [
        f"labels: labels in the world were moved by the pose of sensor {name}, as if in its frame"
    ]


def test_one_label_in_a_sensors_frame(sound, tmp_path):
    """As a single box of an annotation tool has it."""
    (frame,) = sound[:1]
    box = move_boxes(invert(POLES["south"]), frame.objects.boxes[4:5])
    alone = replace(frame, objects=Objects(box))
    assert findings_of([alone], tmp_path) == [
        "labels: labels are in the frame of sensor south, not in the world"
    ]


def test_labels_elsewhere(sound, tmp_path):
    offset = np.array([110.0, 170.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    spoilt = [
        replace(frame, objects=replace(frame.objects, boxes=frame.objects.boxes + offset))
        for frame in sound
    ]
    assert findings_of(spoilt, tmp_path) == ["labels: boxes without a point from any sensor"]


def test_clouds_whose_stamps_are_50_ms_apart(tmp_path):
    assert findings_of(record(late="south"), tmp_path) == [
        "clouds: clouds of one instant are apart in time"
    ]


@pytest.mark.parametrize("name", ONE_POLE_QUICKLY)
def test_clouds_without_stamps_that_are_50_ms_apart(tmp_path, name):
    (found,) = findings_of(record(late=name, stamped=False), tmp_path)
    assert found.startswith(f"sensor {name}: its clouds are about 0.05 s ahead of the labels and ")


@pytest.mark.slow
def test_sensors_at_two_rates(sound, tmp_path):
    slow = change(sound, "south", lambda k, cloud: None if k % 2 else cloud)
    assert findings_of(slow, tmp_path / "stamped") == ["clouds: sensors of two rates"]
    plain = change(record(stamped=False), "south", lambda k, cloud: None if k % 2 else cloud)
    assert findings_of(plain, tmp_path / "plain") == ["sensor south: it is slower than the frames"]


@pytest.mark.slow
def test_a_slow_sensor_whose_clouds_are_repeated(sound, tmp_path):
    def repeat(k, cloud):
        return next(former for former in sound[k - k % 2].clouds if former.name == "south")

    plain = [
        frame.with_clouds([replace(cloud, stamp_s=None) for cloud in frame.clouds])
        for frame in sound
    ]
    repeated = change(plain, "south", lambda k, cloud: replace(repeat(k, cloud), stamp_s=None))
    assert "sensor south: it is slower than the frames" in findings_of(repeated, tmp_path)


@pytest.mark.slow
def test_boxes_that_hold_no_point_of_one_sensor(sound, tmp_path):
    boxes = [frame.objects.boxes + np.array([0, 0, 0, 0.4, 0.4, 0.2, 0]) for frame in sound]

    def empty(k, cloud):
        inside = np.zeros(len(cloud.points), bool)
        for box in boxes[k]:
            distances = np.abs(cloud.in_world() - box[:3])
            half = box[3:6] / 2 if abs(box[6]) < 1 else box[[4, 3, 5]] / 2
            inside |= (distances < half).all(axis=1) & (cloud.in_world()[:, 2] > 0.1)
        kept = replace(cloud, points=cloud.points[~inside])
        assert not count_points(kept.in_world()[kept.in_world()[:, 2] > 0.1], boxes[k]).any()
        return kept

    found = findings_of(change(sound, "north", empty), tmp_path)
    assert found == ["sensor north: boxes hold points of other sensors, and none of this one"]


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    "turn", [pose(0.0, 0.0, 0.0, yaw=1.0), pose(9.0, -6.0, 0.0)], ids=["turned", "moved"]
)
def test_a_sensor_that_is_elsewhere(sound, tmp_path, turn):
    wrong = pose(*POLES["east"][:3, 3]) @ turn @ invert(pose(*POLES["east"][:3, 3])) @ POLES["east"]
    moved = change(sound, "east", lambda k, cloud: replace(cloud, world_SE3_sensor=wrong))
    assert "sensor east: boxes hold points of other sensors, and none of this one" in findings_of(
        moved, tmp_path
    )


@pytest.mark.one_in(3)
@pytest.mark.parametrize("offset", [(2.0, 0.0), (0.0, -1.0), (0.5, 0.4)])
def test_labels_at_one_offset_from_the_points(sound, tmp_path, offset):
    """Counted from the vehicle's rear axle or another point of the map: named as an offset, with
    its size."""
    aside = np.array([*offset, 0, 0, 0, 0, 0])
    moved = [
        replace(frame, objects=replace(frame.objects, boxes=frame.objects.boxes + aside))
        for frame in sound
    ]
    (found,) = findings_of(moved, tmp_path)
    named = re.search(r"all labels are ([+-][0-9.]+) m in x and ([+-][0-9.]+) m in y", found)
    assert named is not None, found
    np.testing.assert_allclose([float(named[1]), float(named[2])], offset, atol=0.25)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize(
    "wrong",
    [np.eye(4), pose(0.0, 0.0, -3.0) @ POLES["east"], POLES["east"] @ pose(roll=np.pi)],
    ids=str,
)
def test_a_sensor_whose_points_are_below_the_ground(sound, tmp_path, labelled, wrong):
    """A pose that is missing, without its height, or upside down."""
    moved = change(sound, "east", lambda k, cloud: replace(cloud, world_SE3_sensor=wrong))
    if not labelled:
        moved = [
            Frame.of_clouds(frame.name, frame.clouds, Objects.empty(), time=frame.time)
            for frame in moved
        ]
    found = findings_of(moved[::4], tmp_path)
    if wrong[2, 2] > 0:
        assert "sensor east: its points are below the ground that others see" in found
    else:  # its ground is in the sky, where there is nothing to compare it with
        assert not any("below the ground" in finding for finding in found)


def test_one_cloud_under_two_names(sound, tmp_path):
    twins = [
        frame.with_clouds([*frame.clouds, replace(frame.clouds[0], name="again")])
        for frame in sound[:3]
    ]
    assert findings_of(twins, tmp_path) == ["sensor again: it has the same points as east"]


def test_the_scene_is_as_meant():
    points = transform(POLES["south"], cast(POLES["south"], cars(0.0)).astype(np.float64))
    assert points[:, 2].min() > -0.1
    assert (count_points(points, cars(0.0) + np.array([0, 0, 0, 0.2, 0.2, 0.2, 0])) > 5).sum() >= 6
