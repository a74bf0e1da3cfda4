"""coview calibrate: crooked sensors are put right, and what cannot be is refused."""

import json

import numpy as np
import pytest

from coview.outputs import SUSPECTED
from toolkit.calibration.corrected_recording import copy_corrected
from toolkit.clouds import from_points, save
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.pose_files import read_poses
from toolkit.datasets.recording_file import Header, Scene, encode
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.error_terms import make_rotation
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import save_site
from toolkit.sites.site import Site, Solid

MODEL = DepthCamera(width=160, height=120, stride=2)
SENSORS = (
    Sensor("a", MODEL, look((-9.0, -9.0, 5.0), heading=0.8, tilt=0.35)),
    Sensor("b", MODEL, look((9.0, 9.0, 5.0), heading=-2.3, tilt=0.35)),
)
SOLIDS = tuple(
    Solid(np.array([[x, y], [x + 4.0, y], [x + 4.0, y + 3.0], [x, y + 3.0]]), 0.0, 4.0, "container")
    for x, y in ((-8, 4), (3, 5), (-2, -9), (6, -5))
)
PLACE = Site("place", np.array([-12.0, -12, 12, 12]), solids=SOLIDS, sensors=SENSORS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """true.hdf5, a recording of six frames of an empty place; crooked.hdf5, whose sensor b is 1°
    and 10 cm off."""
    folder = tmp_path_factory.mktemp("calibrate")
    images = Renderer(PLACE, [], SENSORS, threads=1).background
    scenes = [
        Scene(Frame(SENSORS, images, Objects.empty(), 0.1 * k, k), np.zeros(0, np.int64))
        for k in range(6)
    ]
    (folder / "true.hdf5").write_bytes(encode(Header(PLACE, SENSORS), scenes))
    save_site(PLACE, folder / "place.geojson")
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = make_rotation(np.deg2rad([0.6, 0.8, 0.0])), [0.06, 0.0, 0.08]
    with CoopDataset(folder / "true.hdf5") as true:
        copy_corrected(true, {"b": SENSORS[1].pose @ error}, folder / "crooked.hdf5")
    return folder


def test_crooked_sensors_are_put_right_against_the_site(folder, tmp_path, run):
    out, poses = tmp_path / "corrected.hdf5", tmp_path / "poses.json"
    code, text, err = run(
        "calibrate",
        folder / "crooked.hdf5",
        "--reference",
        folder / "place.geojson",
        "--out",
        out,
        "--poses",
        poses,
    )
    assert code == 0, err
    assert text.startswith("a: turned by 0.0")
    assert "b: turned by 1.0" in text
    with CoopDataset(out) as corrected:
        for sensor, true in zip(corrected.sensors, SENSORS, strict=True):
            assert np.linalg.norm(sensor.position - true.position) < 0.01
    said = json.loads(poses.read_text())
    assert said["b"]["drifted"] is True
    assert said["b"]["moved_m"] == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(read_poses(poses)["b"], SENSORS[1].pose, atol=0.01)


def test_the_doctor_warns_of_drift_but_not_against_another_place(folder, run, tmp_path):
    site = folder / "place.geojson"
    _, text, _ = run("doctor", folder / "crooked.hdf5", "--reference", site)
    assert "sensor b: it hangs crooked or has drifted (turned by 1.0" in text
    assert "sensor a: it hangs" not in text
    assert "hangs crooked" not in run("doctor", folder / "true.hdf5", "--reference", site)[1]
    far = np.random.default_rng(0).uniform([900, 900, 0], [920, 920, 0.01], (3000, 3))
    save(from_points(far.astype(np.float32)), tmp_path / "far.ply")
    code, text, _ = run("calibrate", folder / "true.hdf5", "--reference", tmp_path / "far.ply")
    assert code == SUSPECTED
    assert "a: not found: 0 of" in text


def test_an_earlier_recording_and_a_survey_are_references_too(folder, tmp_path, run):
    from toolkit.calibration.reference_surface import site_surface

    survey = tmp_path / "survey.ply"
    points = site_surface(PLACE).points
    save(
        from_points(points[np.abs(points[:, :2]).max(axis=1) < 16][::2].astype(np.float32)), survey
    )
    for reference in (folder / "true.hdf5", survey):
        code, text, _ = run(
            "calibrate", folder / "crooked.hdf5", "--reference", reference, "--json"
        )
        assert code == 0
        found = np.array(json.loads(text)["b"]["world_SE3_sensor"])
        assert np.linalg.norm(found[:3, 3] - SENSORS[1].position) < 0.02


def test_refusals(folder, recording, tmp_path, refused):
    assert "4 frames are too few" in refused("calibrate", recording, "--reference", "tjunction")
    assert "no site 'nowhere'" in refused(
        "calibrate", folder / "true.hdf5", "--reference", "nowhere"
    )
    there = tmp_path / "there.json"
    there.write_text("{}")
    line = refused(
        "calibrate", folder / "true.hdf5", "--reference", folder / "place.geojson", "--poses", there
    )
    assert "there.json" in line
    same = folder / "true.hdf5"
    assert "true.hdf5" in refused(
        "calibrate", same, "--reference", "tjunction", "--out", same, "--overwrite"
    )


def test_without_a_reference_sensors_are_fitted_to_a_held_one(folder, refused, run):
    code, text, _ = run("calibrate", folder / "crooked.hdf5", "--held", "a", "--json")
    assert code == 0
    said = json.loads(text)
    assert said["a"]["moved_m"] == 0.0
    assert said["b"]["moved_m"] > 0.0
    assert said["b"]["unobserved"], (
        "they look at opposite faces, which says nothing of where these are"
    )
    line = refused(
        "calibrate", folder / "crooked.hdf5", "--held", "a", "--reference", folder / "place.geojson"
    )
    assert "leave them or --reference out" in line


def test_road_users_are_looked_for_where_a_detector_is_given(folder, run, work_in, tmp_path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "from toolkit.objects import Detections\n"
        "def find(points):\n"
        "    return Detections(np.array([[0.0, 0, 0.8, 4, 2, 1.5, 0.3]]), np.ones(1))\n"
    )
    work_in(tmp_path)
    shared = []
    for more in ([], ["--detector", "mine:find"]):
        code, text, err = run("calibrate", folder / "true.hdf5", "--held", "a", "--json", *more)
        assert code == 0, err
        shared.append(json.loads(text)["b"])
    assert len(shared[1]["unobserved"]) < len(shared[0]["unobserved"]) or (
        shared[0]["covariance_rad_m"] != shared[1]["covariance_rad_m"]
    )
