"""Sensors that freeze or go blind in the middle of a recording."""

import numpy as np
import pytest

from toolkit.datasets import published_layout as published
from toolkit.doctor.findings import Finding
from toolkit.doctor.image_failures import blind_frames, failing_sensors, frozen_frames
from toolkit.doctor.sensor_images import SensorImages
from toolkit.doctor.stored_file import diagnose_file
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SITE = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
SENSORS = [
    Sensor(name, DepthCamera(width=40, height=30, stride=1), look((x, 0.0, 8.0), 0.0, 0.6))
    for name, x in (("a", -12.0), ("b", -10.0))
]


def image(sensor, centre):
    """Flat ground, and the top of a car about a centre, 1.5 m up."""
    rays = sensor.world_rays
    down = np.minimum(rays[2], -0.05)
    top, ground = (1.5 - 8.0) / down, (0.05 - 8.0) / down
    x, y = sensor.position[0] + rays[0] * top, rays[1] * top
    on = (np.abs(x - centre) < 2) & (np.abs(y) < 1)
    return np.where(on, top, np.where(rays[2] < -0.05, ground, 0)).astype(np.float32)


def rows(centres):
    """As published, a frame each."""
    boxes = [np.array([[x, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]]) for x in centres]
    return [
        published.format_objects(Objects(b, np.zeros(1, int), np.arange(1)), SITE.map_SE3_site)
        for b in boxes
    ]


CENTRES = [-4.0, -3.0, 3.0, 9.0, 9.0, 2.0]


def views(shown=CENTRES):
    rays = DepthCamera(width=40, height=30, stride=1).rays().reshape(-1, 3)
    return [SensorImages(each, rays, np.stack([image(each, x) for x in shown])) for each in SENSORS]


def test_healthy_images_are_not_accused():
    assert not any(
        frozen_frames(each, rows(CENTRES), SITE).any() for each in views()
    )  # 9 twice: parked
    assert not blind_frames(views()).any()
    assert list(failing_sensors(views(), rows(CENTRES), SITE, range(6))) == []
    assert list(failing_sensors([], [], SITE, [])) == []


def test_frozen_images_are_named():
    frozen = views([-4.0, -3.0, -3.0, -3.0, 9.0, 2.0])[0]
    assert frozen_frames(frozen, rows(CENTRES), SITE).tolist() == [
        False,
        False,
        True,
        True,
        False,
        False,
    ]
    both = [frozen, views()[1]]
    assert list(failing_sensors(both, rows(CENTRES), SITE, [0, 7, 14, 21, 28, 35])) == [
        Finding(
            "warning",
            "sensor a",
            "it is frozen",
            (
                "2 of 6 frames that were looked at, the first is 14, show objects where nobody is "
                "any more"
            ),
            "leave these frames out, or the sensor",
        )
    ]
    nearby = rows([-4.0, -3.0, -1.0, 9.0, 9.0, 2.0])  # has moved, but stands still where it was
    assert not frozen_frames(frozen, nearby, SITE)[2]


def test_blind_images_are_named():
    images = views()
    dark = images[0].depth.copy()
    there = np.flatnonzero(dark[3] > 0)
    dark[3, there[: int(0.45 * len(there))]] = 0
    dark[4, there[: int(0.55 * len(there))]] = 0
    dark[5] = 0
    other = images[1].depth.copy()
    other[5] = 0
    changed = [
        SensorImages(each.sensor, each.rays, depth)
        for each, depth in zip(images, (dark, other), strict=True)
    ]
    assert blind_frames(changed).tolist() == [
        [False, False, False, False, True, False],
        [False] * 6,
    ]
    (found,) = failing_sensors(changed, rows(CENTRES), SITE, range(6))
    assert (found.where, found.suspected) == ("sensor a", "it goes blind")
    assert found.evidence.startswith(
        "1 of 6 frames that were looked at, the first is 4, return less than half"
    )


def blind(file):
    for k in range(len(file["dslices"])):
        file["dslices"][k] = 1000


def place(change):
    def moved(file):
        file["cameras/d00/extrinsic"][...] = change(file["cameras/d00/extrinsic"][()])

    return moved


@pytest.mark.parametrize(
    ("change", "suspected"),
    [
        *(
            (blind, "no points"),
            (place(lambda matrix: matrix @ pose(0.0, 0.0, 9.0)), "it stands under the ground"),
        ),
        (place(lambda matrix: np.diag([1, -1, -1, 1]) @ matrix), "upside down"),
    ],
)
def test_a_sensor_that_cannot_be_right_is_named(spoil, change, suspected):
    findings = spoil(change)
    assert any(
        suspected in finding.suspected and "sensor north" in finding.where for finding in findings
    )


def test_dark_frames_and_objects_of_others_are_named(spoil):
    def darken(file):
        for name in ("dslices", "coview/ranges/lidar"):
            file[name][4] = 0

    (finding,) = spoil(darken)
    assert (finding.where, finding.suspected) == ("frame 4", "frames without points")
    assert str(finding) == (
        "error: frame 4: frames without points (1 of 14 frames that were looked at, the first is "
        "4); restore their images or leave them out"
    )

    def turn_over(file):
        file.move("objects", "others")
        for k in range(14):
            file[f"objects/{k}"] = file[f"others/{(k + 5) % 14}"][()]

    assert any("points and boxes disagree" in finding.suspected for finding in spoil(turn_over))


def replaced(name, content):
    def change(file):
        del file[name]
        file[name] = content(file) if callable(content) else content

    return change


@pytest.mark.parametrize("published", [False, True])
def test_a_healthy_recording_has_no_findings(spoil, published):
    assert spoil(lambda file: None, published) == []


@pytest.mark.parametrize(
    ("change", "suspected", "where"),
    [
        (replaced("objects/3", np.zeros((0, 10))), "frames without objects", "objects/3"),
        (
            replaced("objects/3", lambda file: file["objects/5"][()]),
            "duplicated frames",
            "objects/5",
        ),
        (replaced("objects/3", np.zeros((4, 7))), "damaged objects", "objects/3"),
        (replaced("objects/3", np.full((1, 10), np.nan)), "damaged objects", "objects/3"),
        (replaced("objects/3", np.zeros((1, 10))), "damaged objects", "objects/3"),
        (replaced("objects/3", np.full((4, 10), b"x")), "damaged objects", "objects/3"),
        (
            replaced("dslices", np.zeros((0, 2, 300, 400), np.float32)),
            "it cannot be read",
            "recording.hdf5",
        ),
        (replaced("cameras", np.eye(4)), "it cannot be read", "recording.hdf5"),
        (lambda file: file["objects"].__delitem__("3"), "damaged objects", "objects/3"),
        (
            replaced("cameras/d00/extrinsic", np.zeros((4, 4))),
            "it cannot be read",
            "recording.hdf5",
        ),
        (
            replaced("cameras/d00/extrinsic", np.full((4, 4), np.nan)),
            "it cannot be read",
            "recording.hdf5",
        ),
    ],
)
def test_damage(spoil, change, suspected, where):
    findings = spoil(change)
    assert any(suspected in finding.suspected and where in finding.where for finding in findings)


def test_files_that_cannot_be_read(tmp_path, healthy):
    path = tmp_path / "recording.hdf5"
    with pytest.raises(FileNotFoundError):
        diagnose_file(path)
    for content, says in (
        *(
            (b"", "is empty"),
            (b"text" * 99, "not an HDF5 file"),
            (healthy[: len(healthy) // 2], "cut off"),
        ),
    ):
        path.write_bytes(content)
        (finding,) = diagnose_file(path)
        assert says in finding.evidence


def test_times_that_go_back_or_are_no_seconds_are_named(spoil):
    for change, says in (
        (lambda times: times[::-1], "times that repeat or go back"),
        (lambda times: times * 0, "times that repeat or go back"),
        (lambda times: times * 1e6, "times in another unit than seconds"),
    ):

        def spoiled(file, change=change):
            times = file["coview/time"]
            times[...] = change(np.arange(1.0, 1 + len(times)))

        assert says in [each.suspected for each in spoil(spoiled)]
