import numpy as np
import pytest

from toolkit.calibration.drift import check_drift, drift_findings
from toolkit.calibration.registration import Registration
from toolkit.calibration.sensor_poses import FoundPose
from toolkit.geometry import pose
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import save_site
from toolkit.sites.site import Site

SENSOR = Sensor("north", DepthCamera(width=40, height=30), np.eye(4))


def found(moved, deviation=0.001):
    return FoundPose(SENSOR, Registration(moved, np.eye(6) * deviation**2, np.zeros((0, 6)), 0.8, 0.01))


def test_what_has_drifted_is_said_with_its_numbers():
    findings = drift_findings([found(pose(0.3, 0.4, 0.0, yaw=np.deg2rad(1.5))), found(pose(0.001))], "tjunction")
    assert [(each.severity, each.where) for each in findings] == [("warning", "sensor north")]
    assert "turned by 1.50° and moved by 50.0 cm against tjunction, to within 0.10° and 0.2 cm" in findings[0].evidence


def test_a_sensor_the_reference_does_not_know_is_said():
    findings = drift_findings([FoundPose(SENSOR, None, "only 4% of its points")], "tjunction")
    assert findings[0].suspected == "its pose cannot be checked against tjunction"
    assert findings[0].evidence == "only 4% of its points"


def test_a_recording_that_cannot_be_read_is_a_finding_and_a_missing_reference_an_error(tmp_path):
    place = tmp_path / "place.geojson"
    save_site(Site("place", np.array([-4.0, -4, 4, 4])), place)
    broken = tmp_path / "broken.hdf5"
    broken.write_bytes(b"nothing")
    finding = check_drift(broken, place)[0]
    assert finding.suspected == "its sensors' poses cannot be checked"
    with pytest.raises(FileNotFoundError, match="no site"):
        check_drift(broken, tmp_path / "missing.json")
