"""Crooked lidars of a recording of clouds are put right, by each other and by what stands there."""

import json
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from toolkit.calibration import corrected_recording, empty_scene, found_pose, object_pairs, poses
from toolkit.calibration.alignment import Alignment
from toolkit.calibration.reference_surface import Surface, scene_points, site_surface
from toolkit.calibration.registration import Registration
from toolkit.datasets.recording_views import ReadRecording, Reads
from toolkit.doctor import drift
from toolkit.frame import Frame, SensorCloud, unproject
from toolkit.geometry import invert, look, pose, transform
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.error_terms import make_rotation
from toolkit.sensors.models import DepthCamera, RowLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import save_site
from toolkit.sites.site import Site, Solid

AREA = np.array([-12.0, -12, 12, 12])


def place(*corners):
    outlines = [
        np.array([[x, y], [x + 4.0, y], [x + 4.0, y + 3.0], [x, y + 3.0]]) for x, y in corners
    ]
    return Site(
        "place", AREA, solids=tuple(Solid(each, 0.0, 4.0, "container") for each in outlines)
    )


PLACE, PLACE_TOGETHER = (
    place((-8, 4), (3, 5), (-2, -9), (6, -5)),
    place((-8, 4), (3, 5), (-2, -2), (6, -5)),
)
MODEL = DepthCamera(width=160, height=120, stride=2)
TRUE = (
    Sensor("a", MODEL, look((-9.0, -9.0, 5.0), heading=0.8, tilt=0.35)),
    Sensor("b", MODEL, look((9.0, 9.0, 5.0), heading=-2.3, tilt=0.35)),
)


@lru_cache(maxsize=1)
def surface():
    return site_surface(PLACE)


def crooked(sensor, deg=1.0, metres=0.1, seed=0):
    rng = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = make_rotation(np.deg2rad(deg) * axis), metres * way
    return Sensor(sensor.name, sensor.model, sensor.pose @ error)


@lru_cache(maxsize=1)
def images():
    return Renderer(PLACE, [], TRUE, threads=1).background


def recording(sensors, count=6):
    """Noise-free frames of the empty place by sensors that are believed to be there."""
    return [Frame(tuple(sensors), images(), Objects.empty(), 0.1 * k, k) for k in range(count)]


def test_every_sensor_of_a_recording_is_put_right():
    believed = [crooked(sensor, seed=k) for k, sensor in enumerate(TRUE)]
    done = []
    found = poses.find_poses(recording(believed), surface(), progress=done.append)
    assert done == [1, 2]
    for each, true, wrong in zip(found, TRUE, believed, strict=True):
        assert each.sensor is wrong
        assert np.linalg.norm(each.pose[:3, 3] - true.pose[:3, 3]) < 0.01
        assert each.distance == pytest.approx(0.1, abs=0.01)
        assert np.rad2deg(each.turn) == pytest.approx(1.0, abs=0.03)
        assert each.has_drifted
        assert each.refusal == ""


def test_sensors_where_they_should_be_have_not_drifted_and_errors_of_a_profile_turn_them():
    for each in poses.find_poses(recording(TRUE), surface()):
        assert not each.has_drifted
        assert each.distance < 0.01
    for each, true in zip(
        poses.find_poses(ReadRecording(recording(TRUE), Reads("typical", 3)), surface()),
        TRUE,
        strict=True,
    ):
        assert np.linalg.norm(each.sensor.pose[:3, 3] - true.pose[:3, 3]) > 0.005
        assert np.linalg.norm(each.pose[:3, 3] - true.pose[:3, 3]) < 0.02


def test_too_few_frames_and_other_places_are_refused():
    with pytest.raises(ValueError, match="4 frames are too few"):
        poses.find_poses(recording(TRUE), surface(), frames=4)
    elsewhere = Surface(surface().points + 500.0, surface().normals, surface().roughness)
    refused = poses.find_poses(recording(TRUE[:1] + TRUE[1:]), elsewhere)[0]
    assert refused.registration is None
    assert "points lie within 3 m of the reference" in refused.refusal
    assert refused.pose is TRUE[0].pose
    assert (refused.turn, refused.distance, refused.has_drifted) == (0.0, 0.0, False)
    assert refused.as_dict()["found"] is False
    learner = empty_scene.SceneLearner(TRUE[0])
    for _ in range(5):
        learner.add(images()[0])
    near = np.hypot(*(surface().points[:, :2] - TRUE[0].position[:2]).T) < 6.0
    patch = Surface(surface().points[near], surface().normals[near], surface().roughness[near])
    found = poses.find_pose(scene_points(learner.scene())[0], TRUE[0], patch)
    assert "% are needed: is it of the same place" in found.refusal
    with pytest.raises(ValueError, match="3 frames are too few"):
        poses.find_poses(recording_together(TRUE_TOGETHER[:2]), frames=3)
    with pytest.raises(ValueError, match="no sensor 'c'"):
        poses.find_poses(recording_together(TRUE_TOGETHER[:2]), held=["c"])
    with pytest.raises(ValueError, match=r"two or more are needed, got .+: give a reference"):
        poses.find_poses(recording_together(TRUE_TOGETHER[:1]))
    nobody = Frame.of_clouds(
        "0", (SensorCloud("a", np.zeros((0, 3), np.float32), np.eye(4)),), Objects.empty()
    )
    with pytest.raises(ValueError, match="no frame has a point"):
        poses.find_poses([nobody])
    samples = recording_sample_poses(1)
    with pytest.raises(ValueError, match="no sensor 'c'"):
        poses.find_poses(samples, held=["c"])
    with pytest.raises(ValueError, match="two or more are needed, got a: give a reference"):
        poses.find_poses([each.seen_by(["a"]) for each in samples])


def found_at(pose, deviation=1e-4, unobserved=()):
    sensor = Sensor("c", MODEL, np.eye(4))
    rows = np.array(unobserved, float).reshape(-1, 6)
    return found_pose.FoundPose(
        sensor, Registration(pose, np.eye(6) * deviation**2, rows, 0.8, 0.01)
    )


def test_a_drift_is_larger_than_its_deviation():
    little, much = np.eye(4), np.eye(4)
    little[0, 3], much[0, 3] = 0.015, 0.05
    assert not found_at(little).has_drifted
    assert found_at(much).has_drifted
    assert not found_at(much, deviation=0.05).has_drifted


def test_turns_drift_too():
    turned = np.eye(4)
    turned[:3, :3] = make_rotation(np.array([0.0, 0.0, np.deg2rad(0.2)]))
    assert found_at(turned).has_drifted
    assert np.rad2deg(found_at(turned).turn) == pytest.approx(0.2)


def test_found_poses_have_figures_in_degrees_and_metres():
    moved = np.eye(4)
    moved[:3, 3] = [0.0, 0.3, 0.4]
    said = found_at(moved, 0.01, [[0, 0, 0, -1.0, 0, 0]]).as_dict()
    assert said["moved_m"] == pytest.approx(0.5)
    assert said["unobserved"] == ["move along x 1.00"]
    assert said["standard_deviation"]["move_m"] == [np.inf, 0.01, 0.01]
    assert said["standard_deviation"]["turn_deg"] == [pytest.approx(0.573, abs=1e-3)] * 3
    assert (
        found_pose.describe_motion(np.array([0.05, 0, 0.7, 0, -0.7, 0]))
        == "turn about z 0.70, move along y -0.70"
    )


def test_drifts_are_findings_in_degrees_and_centimetres():
    findings = drift.drift_findings(
        [found(pose(0.3, 0.4, 0.0, yaw=np.deg2rad(1.5))), found(pose(0.001))], "tjunction"
    )
    assert [(each.severity, each.where) for each in findings] == [("warning", "sensor north")]
    assert (
        "turned by 1.50° and moved by 50.0 cm against tjunction, to within 0.10° and 0.2 cm"
        in findings[0].evidence
    )
    findings = drift.drift_findings(
        [found_pose.FoundPose(SENSOR, None, "only 4% of its points")], "tjunction"
    )
    assert findings[0].suspected == "its pose cannot be checked against tjunction"
    assert findings[0].evidence == "only 4% of its points"


TRUE_TOGETHER = (
    Sensor("a", MODEL, look((-9.0, -9.0, 5.0), heading=0.8, tilt=0.35)),
    Sensor("b", MODEL, look((9.0, -9.0, 5.0), heading=2.3, tilt=0.35)),
    Sensor("away", MODEL, look((-60.0, -60.0, 5.0), heading=-2.3, tilt=0.35)),
)
ERROR = np.eye(4)
ERROR[:3, :3], ERROR[:3, 3] = make_rotation(np.deg2rad([0.5, 0.6, 0.0])), [0.05, 0.0, 0.05]


@lru_cache(maxsize=1)
def images_together():
    return Renderer(PLACE_TOGETHER, [], TRUE_TOGETHER, threads=1).background


class Recorded(list):
    site = PLACE_TOGETHER


def recording_together(sensors, count=6):
    return Recorded(
        Frame(tuple(sensors), images_together()[: len(sensors)], Objects.empty(), 0.1 * k, k)
        for k in range(count)
    )


def test_sensors_are_put_right_by_each_other():
    crooked = Sensor("b", MODEL, TRUE_TOGETHER[1].pose @ ERROR)
    found = poses.find_poses(
        recording_together([TRUE_TOGETHER[0], crooked, TRUE_TOGETHER[2]]), held=["a"]
    )
    assert [each.sensor.name for each in found] == ["a", "b", "away"]
    assert found[0].pose.tobytes() == TRUE_TOGETHER[0].pose.tobytes()
    assert np.linalg.norm(found[1].pose[:3, 3] - TRUE_TOGETHER[1].position) < 0.02
    assert [each.has_drifted for each in found[:2]] == [False, True]
    assert "it shares 0 points with the other sensors, 50 are needed" in found[2].refusal
    # with none held both move half way
    a, b = poses.find_poses(recording_together([TRUE_TOGETHER[0], crooked]))
    assert a.distance == pytest.approx(b.distance, abs=0.03)
    assert 0.0 < a.distance < 0.06


MODEL_CLOUDS = RowLidar(tuple(np.deg2rad(np.linspace(0, -50, 48))), columns=360)
TRUE_CLOUDS = (
    Sensor("a", MODEL_CLOUDS, pose(-9.0, -9.0, 5.0, yaw=0.8)),
    Sensor("b", MODEL_CLOUDS, pose(-9.0, -2.0, 4.0, yaw=0.2)),
)


@lru_cache(maxsize=1)
def clouds():
    """What both see, each in its own frame."""
    images = Renderer(PLACE_TOGETHER, [], TRUE_CLOUDS, threads=1).background
    made = []
    for sensor, image in zip(TRUE_CLOUDS, images, strict=True):
        points, valid = unproject(sensor, image)
        made.append(
            transform(invert(sensor.pose), points.T[valid].astype(np.float64)).astype(np.float32)
        )
    return made


def recording_sample_poses(count, *, driving=0.0, frame="sensor"):
    """b is believed to be elsewhere; the rig drives so far between samples."""
    believed = (TRUE_CLOUDS[0].pose, ERROR @ TRUE_CLOUDS[1].pose)
    samples = []
    for k in range(count):
        own = [
            SensorCloud(s.name, p, pose_)
            for s, p, pose_ in zip(TRUE_CLOUDS, clouds(), believed, strict=True)
        ]
        if frame == "world":
            own = [replace(c, points=c.in_world().astype(np.float32), frame="world") for c in own]
        samples.append(
            Frame.of_clouds(str(k), tuple(own), Objects.empty(), map_SE3_world=pose(driving * k))
        )
    return samples


def apart(one, other):
    turn = one[:3, :3] @ other[:3, :3].T
    return np.rad2deg(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))), np.linalg.norm(
        one[:3, 3] - other[:3, 3]
    )


@pytest.mark.parametrize(("count", "driving"), [(5, 0.0), (2, 0.0), (6, 3.0)])
def test_by_each_other(count, driving):
    found = poses.find_poses(recording_sample_poses(count, driving=driving), held=["a"])
    assert [each.sensor.name for each in found] == ["a", "b"]
    np.testing.assert_array_equal(found[0].pose, TRUE_CLOUDS[0].pose)
    assert apart(ERROR @ TRUE_CLOUDS[1].pose, TRUE_CLOUDS[1].pose)[0] == pytest.approx(
        0.78, abs=0.01
    )
    turn, move = apart(found[1].pose, TRUE_CLOUDS[1].pose)
    assert turn < 0.1
    assert move < 0.04


@pytest.fixture
def align_by(monkeypatch):
    """Align the clouds of all sensors by another function."""

    def set_function(function):
        monkeypatch.setattr(poses, "align_clouds", function)

    return set_function


@pytest.mark.parametrize(
    ("count", "driving", "learns"),
    [(5, 0.0, 1), (5, 0.1, 1), (5, 0.125, 1), (4, 0.0, 0), (5, 0.126, 0), (5, 0.6, 0)],
)
def test_scenes_are_learnt_of_lidars_that_stand_still_in_enough_samples(
    align_by, monkeypatch, count, driving, learns
):
    learnt, fitted = [], []

    def learn(samples):
        learnt.append(len(list(samples)))
        return {}

    def together(points, sensors, *, held, more):
        fitted.append((points, sensors))
        return ()

    monkeypatch.setattr(poses, "learn_sample_scenes", learn)
    align_by(together)
    samples = recording_sample_poses(count, driving=driving)
    moved = tuple(
        replace(cloud, world_SE3_sensor=pose(0.1) @ cloud.world_SE3_sensor)
        for cloud in samples[1].clouds
    )
    samples[1] = samples[1].with_clouds(moved)
    assert poses.find_poses(samples) == ()
    ((points, sensors),) = fitted
    assert learnt == [count] * learns
    assert [sensor.name for sensor in sensors] == ([] if learns else ["a", "b"])
    if not learns:
        np.testing.assert_array_equal(points[1], clouds()[1].astype(np.float64))
        np.testing.assert_array_equal(sensors[1].pose, ERROR @ TRUE_CLOUDS[1].pose)


def test_poses_found_are_of_the_first_sample_in_the_sensors_frame():
    samples = recording_sample_poses(2)
    own = samples[1].clouds[1]
    samples[1] = samples[1].with_clouds(
        (replace(own, world_SE3_sensor=pose(0.1) @ own.world_SE3_sensor),)
    )
    found = poses.find_poses(samples, held=["a"])
    np.testing.assert_array_equal(found[1].sensor.pose, ERROR @ TRUE_CLOUDS[1].pose)
    samples = recording_sample_poses(5)
    found = poses.find_poses(samples, held=["a"])
    made = corrected_recording.Corrected.from_poses(samples, found).corrections
    np.testing.assert_allclose(made["a"], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(ERROR @ TRUE_CLOUDS[1].pose @ made["b"], found[1].pose, atol=1e-9)
    samples = recording_sample_poses(5)
    found = poses.find_poses(samples, site_surface(PLACE_TOGETHER))
    for each, true in zip(found, TRUE_CLOUDS, strict=True):
        turn, move = apart(each.pose, true.pose)
        assert turn < 0.05
        assert move < 0.02


@pytest.mark.parametrize("frame", ["sensor", "world"])
def test_samples_are_put_where_their_sensors_are(frame):
    samples = recording_sample_poses(1, frame=frame)
    corrected = {"b": invert(ERROR @ TRUE_CLOUDS[1].pose) @ TRUE_CLOUDS[1].pose}
    (after,) = corrected_recording.Corrected(samples, corrected)
    assert after.clouds[0] is samples[0].clouds[0]
    np.testing.assert_allclose(after.clouds[1].world_SE3_sensor, TRUE_CLOUDS[1].pose, atol=1e-9)
    np.testing.assert_allclose(
        after.clouds[1].in_world(), transform(TRUE_CLOUDS[1].pose, clouds()[1]), atol=1e-4
    )


SENSOR = Sensor("north", DepthCamera(width=40, height=30), np.eye(4))


def found(moved, deviation=0.001):
    return found_pose.FoundPose(
        SENSOR, Registration(moved, np.eye(6) * deviation**2, np.zeros((0, 6)), 0.8, 0.01)
    )


def test_a_recording_that_cannot_be_read_is_a_finding_and_a_missing_reference_an_error(tmp_path):
    place = tmp_path / "place.geojson"
    save_site(Site("place", np.array([-4.0, -4, 4, 4])), place)
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(b"nothing")
    assert drift.check_drift(broken, place)[0].suspected == "its sensors' poses cannot be checked"
    with pytest.raises(FileNotFoundError, match="no site"):
        drift.check_drift(broken, tmp_path / "missing.json")


def test_sensors_have_their_share_of_what_an_alignment_found(monkeypatch):
    """The first shares 50 rows with the second and the second 250 more with the third; the fourth
    shares 49."""
    shared = np.zeros((4, 4), np.int64)
    shared[0, 1] = shared[1, 0] = 50
    shared[1, 2] = shared[2, 1] = 250
    shared[3, 2] = shared[2, 3] = 49
    rng, placed = np.random.default_rng(0), tuple(pose(float(k)) for k in range(4))
    covariance = rng.random((24, 24))
    unobserved = np.zeros((1, 24))
    unobserved[0, 9] = 1.0
    sensors = [Sensor(f"s{k}", MODEL, np.eye(4)) for k in range(4)]
    asked = []

    def align(surfaces, believed, **options):
        asked.append((len(surfaces), len(believed), options))
        return Alignment(placed, covariance, unobserved, shared, np.array([0.1, 0.2, 0.3, 0.4]))

    monkeypatch.setattr(poses, "align", align)
    street = np.column_stack(
        [np.random.default_rng(0).uniform(-5, 5, (4000, 2)), np.full(4000, -5.0)]
    )
    found = poses.align_clouds([street] * 4, sensors, held=[0])
    assert asked == [(4, 4, {"held": [0], "more": None})]
    assert [each.registration is None for each in found] == [False, False, False, True]
    assert "it shares 49 points with the other sensors, 50 are needed" in found[3].refusal
    first, second, third = (each.registration for each in found[:3])
    assert [each.overlap for each in (first, second, third)] == [50 / 250, 1.0, 1.0]
    assert [each.scatter for each in (first, second, third)] == [0.1, 0.2, 0.3]
    assert second.pose.tolist() == placed[1].tolist()
    assert second.covariance.tolist() == covariance[6:12, 6:12].tolist()
    assert np.abs(second.unobserved).tolist() == [[0, 0, 0, 1, 0, 0]]
    assert len(first.unobserved) == len(third.unobserved) == 0
    shared[:] = 0
    alone = poses.align_clouds([street] * 4, sensors, held=[0])
    assert [each.registration is None for each in alone] == [False, True, True, True]
    assert alone[0].registration.overlap == 0.0  # held, with nothing to share


@pytest.mark.parametrize(
    ("turn_deg", "metres", "deviation", "drifted"),
    [
        *((0.09, 0.019, 1e-6, False), (0.11, 0.0, 1e-6, True), (0.0, 0.021, 1e-6, True)),
        *(
            (0.0, 0.1, 0.02, False),
            (0.0, 0.11, 0.02, True),
            (1.0, 0.0, 0.0034, False),
            (1.1, 0.0, 0.0034, True),
        ),
        (0.0, 0.02, 1e-6, False),
    ],
)
def test_drifts_are_above_what_is_worth_it_and_three_deviations(
    turn_deg, metres, deviation, drifted
):
    """Of 2 cm along each axis the deviation of a distance is 3.5 cm, and three times that 10.4."""
    moved = np.eye(4)
    moved[:3, :3] = make_rotation(np.array([0.0, 0.0, np.deg2rad(turn_deg)]))
    moved[0, 3] = metres
    each = found_at(moved, deviation)
    assert each.has_drifted is drifted
    assert each.deviation == pytest.approx((deviation * np.sqrt(3),) * 2)


@pytest.mark.parametrize(
    ("count", "searched"), [(9, [0, 2, 5, 8]), (6, [0, 1, 3, 5]), (5, [0, 1, 2, 4])]
)
def test_road_users_are_searched_in_a_few_frames_evenly_from_the_first_to_the_last(
    limits, align_by, monkeypatch, count, searched
):
    asked = []

    class Known(list):
        site = PLACE

    def seen(frames, detector, site):
        asked.append(([round(10 * frame.time) for frame in frames], detector, site))
        return "seen"

    def align(clouds, sensors, *, held, more):
        asked.append((len(clouds), held, more.func, more.args))
        return ()

    limits(poses, OBJECT_FRAMES=4)
    monkeypatch.setattr(poses, "detect_boxes", seen)
    align_by(align)
    frames, detector = Known(recording(TRUE, 12)), lambda points: None
    assert poses.find_poses(frames, None, held=["b"], detector=detector, frames=count) == ()
    assert asked == [(searched, detector, PLACE), (2, [1], object_pairs.object_pairs, ("seen",))]
    with pytest.raises(ValueError, match="a detector is for a recording of a known site"):
        poses.find_poses(recording(TRUE), None, detector=detector)


def test_a_pose_has_not_drifted_by_nothing(limits):
    limits(found_pose, MIN_DRIFT_RAD=0.0, MIN_DRIFT_M=0.0)
    assert not found_at(np.eye(4), deviation=0.0).has_drifted


def test_registrations_know_the_deviations_and_need_three_tenths_of_the_points(monkeypatch):
    asked, overlaps = [], [0.299, 0.3]

    def register(points, surface, believed, *, deviation=None):
        asked.append((points, surface, believed, deviation))
        return Registration(believed, np.eye(6), np.zeros((0, 6)), overlaps.pop(), 0.01)

    monkeypatch.setattr("toolkit.calibration.poses.register", register)
    points, deviations = np.zeros((2, 3)), np.ones(2)
    surface = Surface(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1))
    for is_found in (True, False):
        each = poses.find_pose(points, TRUE[0], surface, deviation=deviations)
        assert (each.registration is not None) is is_found
        assert all(
            one is other
            for one, other in zip(
                asked.pop(), (points, surface, TRUE[0].pose, deviations), strict=True
            )
        )


def test_scenes_are_learnt_of_the_frames_that_are_asked_and_sensors_are_the_first_ones(monkeypatch):
    asked = []

    def learn(recording, sample, *, frames):
        asked.append((len(recording), sample, frames))
        return "ab"

    def found(points, sensor, surface, *, deviation):
        asked.append((points, sensor, surface, deviation))
        return sensor.name

    monkeypatch.setattr(poses, "learn_empty_scenes", learn)
    monkeypatch.setattr(
        poses, "scene_points", lambda scene: (f"points {scene}", f"deviations {scene}")
    )
    monkeypatch.setattr(poses, "find_pose", found)
    frames = [
        Frame(TRUE[::-1] if k else TRUE, images(), Objects.empty(), 0.1 * k, k) for k in range(7)
    ]
    names: Any = poses.find_poses(frames, "surface", frames=6, sample=9)  # type: ignore[arg-type]
    assert names == ("a", "b")
    each = [
        (f"points {name}", TRUE[k], "surface", f"deviations {name}") for k, name in enumerate("ab")
    ]
    assert asked == [(7, 9, 6), *each]
    with pytest.raises(ValueError, match="0 frames are too few"):
        poses.find_poses([], "surface")  # type: ignore[arg-type]


def test_poses_are_written_by_name_with_null_for_what_is_not_observed(tmp_path):
    found_pose.save_poses(
        tmp_path / "poses.json", [found_at(pose(0.3), 0.01, [[0, 0, 0, 1.0, 0, 0]])]
    )
    text = (tmp_path / "poses.json").read_text()
    assert text.splitlines()[:2] == ["{", ' "c": {']  # a person may read it
    assert json.loads(text)["c"]["standard_deviation"]["move_m"] == [None, 0.01, 0.01]


def test_clouds_are_written_as_a_folder(spy, tmp_path):
    calls = spy(corrected_recording, "write_recording")
    samples = recording_sample_poses(1)
    crooked = Sensor("b", MODEL_CLOUDS, ERROR @ TRUE_CLOUDS[1].pose)
    each = found_pose.FoundPose(
        crooked, Registration(TRUE_CLOUDS[1].pose, np.eye(6), np.zeros((0, 6)), 1.0, 0.01)
    )
    corrected_recording.write_corrected(samples, [each], tmp_path)
    (((corrected, out, layout), _),) = calls
    assert (out, layout) == (tmp_path, "folder")
    np.testing.assert_allclose(
        corrected[0].clouds[1].world_SE3_sensor, TRUE_CLOUDS[1].pose, atol=1e-9
    )
