import json

import h5py
import numpy as np
import pytest

from toolkit.calibration.corrected_recording import copy_corrected, write_corrected
from toolkit.calibration.found_pose import FoundPose
from toolkit.calibration.registration import Registration
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_file import Header, Scene, encode
from toolkit.datasets.simulation import simulate_dataset
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

CAMERA, LIDAR = DepthCamera(width=40, height=30), SpinningLidar(channels=4, azimuth_step=0.5)
SENSORS = (
    *(
        Sensor("one", CAMERA, look((-9.0, 0.0, 5.0), heading=0.0, tilt=0.3)),
        Sensor("spun", LIDAR, pose(0.0, 3.0, 4.0)),
    ),
    Sensor("two", CAMERA, look((9.0, 0.0, 5.0), heading=np.pi, tilt=0.3)),
)
PLACE = Site(
    "place",
    np.array([-12.0, -12, 12, 12]),
    sensors=SENSORS,
    map_SE3_site=pose(700.0, -50.0, 3.0, yaw=0.4),
)
MOVED = {
    "two": look((9.1, 0.0, 5.0), heading=3.1, tilt=0.31),
    "spun": pose(0.0, 3.0, 4.2, yaw=0.02),
}


@pytest.fixture
def recording(tmp_path):
    frames = [
        Frame(
            SENSORS,
            tuple(np.full(s.model.shape, 4.0 + k, np.float32) for s in SENSORS),
            Objects.empty(),
            0.1 * k,
            k,
        )
        for k in range(2)
    ]
    path = tmp_path / "few.hdf5"
    header = Header(PLACE, SENSORS, plan=json.dumps({"site": "place", "seed": 3}))
    path.write_bytes(encode(header, [Scene(frame, np.zeros(0, np.int64)) for frame in frames]))
    with CoopDataset(path) as opened:
        yield opened


def test_only_the_poses_of_the_named_sensors_change(recording, tmp_path):
    out = tmp_path / "corrected.hdf5"
    copy_corrected(recording, MOVED, out, note={"two": {"turned_deg": 1.0}})
    with CoopDataset(out) as corrected:
        assert [s.name for s in corrected.sensors] == ["one", "spun", "two"]
        for sensor, before in zip(corrected.sensors, SENSORS, strict=True):
            assert sensor.model == before.model
            np.testing.assert_array_equal(sensor.pose, MOVED.get(sensor.name, before.pose))
        for sensor, before in zip(corrected.site.sensors, SENSORS, strict=True):
            np.testing.assert_allclose(sensor.pose, MOVED.get(sensor.name, before.pose), atol=1e-6)
        for frame, before in zip(corrected, recording, strict=True):
            assert frame.time == before.time
            for image, as_it_was in zip(frame.measurements, before.measurements, strict=True):
                assert image.tobytes() == as_it_was.tobytes()
    with h5py.File(out) as file:
        assert json.loads(file.attrs["calibration"]) == {"two": {"turned_deg": 1.0}}
        plan = json.loads(file["coview"].attrs["plan"])
        assert plan["seed"] == 3
        assert sorted(plan["calibrated"]) == ["spun", "two"]


def test_readers_see_new_extrinsics_and_poses_are_checked(recording, tmp_path):
    out = tmp_path / "corrected.hdf5"
    copy_corrected(recording, MOVED, out)
    with h5py.File(out, "r+") as file:
        del file["coview"].attrs["sensors"]
        for camera in file["cameras"].values():
            del camera.attrs["site_SE3_sensor"]
    with CoopDataset(out) as corrected:
        poses = {tuple(s.pose[:3, 3].round(3)) for s in corrected.sensors}
        assert {(9.1, 0.0, 5.0), (-9.0, 0.0, 5.0), (0.0, 3.0, 4.2)} == poses
    with h5py.File(out) as file:
        assert "calibration" not in file.attrs
    out = tmp_path / "corrected.hdf5"
    copy_corrected(recording, MOVED, out)
    with pytest.raises(FileExistsError, match="calibrated"):
        simulate_dataset(PLACE, out, run=Run(frames=2, seed=3))
    out = tmp_path / "others.hdf5"
    with pytest.raises(
        ValueError, match=r"there is no sensor 'three' in .*few.hdf5: choose among one, spun, two"
    ):
        copy_corrected(recording, {"three": np.eye(4)}, out)
    with pytest.raises(ValueError, match="pose of sensor 'one' must be a rotation"):
        copy_corrected(recording, {"one": 2 * np.eye(4) - np.diag([0, 0, 0, 1.0])}, out)
    assert not out.exists()


def test_a_recording_of_images_is_copied_with_a_note_of_what_was_found(recording, tmp_path):
    found = [
        FoundPose(SENSORS[2], Registration(MOVED["two"], np.eye(6), np.zeros((0, 6)), 1.0, 0.01))
    ]
    out = tmp_path / "corrected.hdf5"
    write_corrected(recording, found, out)
    with h5py.File(out) as file:
        assert json.loads(file.attrs["calibration"]) == json.loads(
            json.dumps({"two": found[0].as_dict()})
        )
        assert (
            h5py.h5g.get_objinfo(file.id, b"coview/site").mtime == 0
        )  # the same again is the same file
    with CoopDataset(out) as corrected:
        np.testing.assert_array_equal(corrected.sensors[2].pose, MOVED["two"])
        np.testing.assert_array_equal(corrected.sensors[1].pose, SENSORS[1].pose)


def test_a_recording_without_a_plan_is_copied_too(recording, tmp_path):
    for number, remove in enumerate(
        (lambda file: file["coview"].attrs.pop("plan"), lambda file: file.pop("coview"))
    ):
        bare, out = tmp_path / f"bare{number}.hdf5", tmp_path / f"corrected{number}.hdf5"
        copy_corrected(recording, {}, bare)
        with h5py.File(bare, "r+") as file:
            remove(file)
        with CoopDataset(bare, PLACE) as opened:
            copy_corrected(opened, {opened.sensors[0].name: MOVED["two"]}, out)
        with h5py.File(out) as file:
            assert "plan" not in getattr(file.get("coview"), "attrs", ())
