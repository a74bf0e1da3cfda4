import h5py
import numpy as np
import pytest

from toolkit.datasets.doctor.diagnosis import Finding, diagnose
from toolkit.datasets.recording import Header, Scene, encode
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sensors.spinning_lidar import SpinningLidar
from toolkit.sites.site import Site

SITE = Site("crossing", np.array([-25.0, -20, 25, 20]), map_SE3_site=pose(60.0, -90.0, yaw=0.6))
CAMERA = DepthCamera(width=160, height=120)
SENSORS = (
    Sensor("north", CAMERA, look((2.0, 24.0, 7.0), -np.pi / 2, 0.35)),
    Sensor("west", CAMERA, look((-28.0, -3.0, 6.0), 0.1, 0.25)),
    Sensor("lidar", SpinningLidar(channels=24, azimuth_step=0.02), pose(0.0, -22.0, 6.0)),
)
FRAMES = 14


def measured(sensor: Sensor, boxes: np.ndarray) -> np.ndarray:
    """Upright boxes on the ground z = 0, by the slab method."""
    direction = sensor.model.rays().reshape(-1, 3).astype(np.float64) @ sensor.pose[:3, :3].T
    origin = sensor.position
    with np.errstate(divide="ignore"):
        nearest = np.where(direction[:, 2] < 0, -origin[2] / direction[:, 2], np.inf)
        for x, y, z, *size, yaw in boxes:
            turn = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
            o, d = turn @ (origin - [x, y, z]), direction @ turn.T
            low, high = np.sort([(-np.array(size) / 2 - o) / d, (np.array(size) / 2 - o) / d], axis=0)
            enter, leave = low.max(axis=1), high.min(axis=1)
            nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    return np.where(nearest < 80, nearest, 0).astype(np.float32).reshape(sensor.model.shape)


def recording() -> bytes:
    rng = np.random.default_rng(1)
    scenes = []
    for k in range(FRAMES):
        x, y = np.meshgrid([-18.0, -6, 6, 18], [-10.0, 0, 10])
        place = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-2.5, 2.5, (12, 2))
        place, yaw = place[rng.random(12) < 0.6], rng.uniform(-np.pi, np.pi, 12)
        n = len(place)
        size = rng.uniform([3.8, 1.6, 1.4], [5.0, 2.0, 1.8], (n, 3))
        boxes = np.column_stack([place, size[:, 2] / 2, size, yaw[:n]])
        frame = Frame(SENSORS, tuple(measured(s, boxes) for s in SENSORS), Objects(boxes), 5.0 * k, k)
        scenes.append(Scene(frame, np.zeros(n, np.int64)))
    return encode(Header(SITE, SENSORS), scenes)


@pytest.fixture(scope="module")
def healthy():
    return recording()


@pytest.fixture
def spoil(tmp_path, healthy):
    """Write the healthy recording, change it, and say what the doctor says."""

    def spoiled(change, published: bool = False) -> list[Finding]:
        path = tmp_path / "recording.hdf5"
        path.write_bytes(healthy)
        with h5py.File(path, "r+") as file:
            change(file)
            if published:
                del file["coview"]
                for camera in file["cameras"].values():
                    camera.attrs.clear()
        return diagnose(path)

    return spoiled


def columns(**changes):
    """Change columns of all objects: y, yaw, l, ... as functions of the old ones."""
    names = {"x": 0, "y": 1, "z": 2, "yaw": 5, "l": 6, "w": 7, "h": 8}

    def change(file):
        for rows in file["objects"].values():
            old, new = rows[()], rows[()]
            for name, function in changes.items():
                new[:, names[name]] = function({key: old[:, i] for key, i in names.items()})
            rows[...] = new

    return change


def extrinsics(function, only=("d00", "d01")):
    def change(file):
        for name in only:
            file[f"cameras/{name}/extrinsic"][...] = function(file[f"cameras/{name}/extrinsic"][()])

    return change


def depths(function):
    def change(file):
        for k in range(FRAMES):
            file["dslices"][k] = function(file["dslices"][k], k)

    return change


def replaced(name, content):
    def change(file):
        del file[name]
        file[name] = content(file) if callable(content) else content

    return change


def nothing(file):
    pass


@pytest.mark.parametrize("published", [False, True])
def test_a_healthy_recording_has_no_findings(spoil, published):
    assert spoil(nothing, published) == []


MIRROR = np.diag([1.0, -1, 1, 1])
U, V = np.meshgrid((np.arange(160) - 80) / 80, (np.arange(120) - 60) / 80)


MISTAKES = (
    (columns(y=lambda o: -o["y"], yaw=lambda o: -o["yaw"]), "mirrored y axis"),
    (columns(yaw=lambda o: -o["yaw"]), "yaw counted the other way round"),
    (columns(yaw=lambda o: np.deg2rad(o["yaw"])), "yaw in radians"),
    (columns(yaw=lambda o: np.rad2deg(o["yaw"])), "yaw turned from radians to degrees twice"),
    (columns(l=lambda o: 2 * o["l"], w=lambda o: 2 * o["w"], h=lambda o: 2 * o["h"]), "full extents"),
    (columns(l=lambda o: o["l"] / 2, w=lambda o: o["w"] / 2, h=lambda o: o["h"] / 2), "half of the half extents"),
    (columns(l=lambda o: o["w"], w=lambda o: o["l"]), "length and width swapped"),
    (columns(x=lambda o: o["y"], y=lambda o: o["x"], yaw=lambda o: 90 - o["yaw"]), "x and y swapped"),
    (columns(z=lambda o: o["z"] - o["h"]), "the centre of the floor"),
    (columns(z=lambda o: o["z"] + 0.6), "the boxes float above the ground"),
    (columns(z=lambda o: o["z"] - 0.4), "the boxes are sunk into the ground"),
    (extrinsics(np.linalg.inv), "its extrinsic is camera → world"),
    (extrinsics(np.linalg.inv, ["d01"]), "its extrinsic is camera → world"),
    (extrinsics(lambda matrix: MIRROR @ matrix @ MIRROR), "camera with x forward, y left, z up"),
    (extrinsics(lambda matrix: np.diag([-1, -1, 1, 1]) @ matrix, ["d00"]), "it looks away"),
    (depths(lambda depth, k: 1000 * depth), "depth in millimetres"),
    (depths(lambda depth, k: np.where(depth < 999, 100 * depth, 0)), "depth in centimetres"),
    (depths(lambda depth, k: depth / 1000), "depth in parts of the far plane"),
    (depths(lambda depth, k: depth * np.sqrt(1 + U**2 + V**2)), "its depth is the distance along the ray"),
)


@pytest.mark.parametrize(
    ("change", "suspected", "published"), [*((*m, False) for m in MISTAKES), *((*m, True) for m in MISTAKES[::4])]
)
def test_classic_mistakes(spoil, change, suspected, published):
    findings = spoil(change, published)
    assert suspected in findings[0].suspected
    assert findings[0].severity == "error"
    assert {finding.suspected for finding in findings} == {findings[0].suspected}
    assert findings[0].evidence
    assert findings[0].remedy


@pytest.mark.parametrize(
    ("change", "suspected", "where"),
    [
        (replaced("objects/3", np.zeros((0, 10))), "frames without objects", "objects/3"),
        (replaced("objects/3", lambda file: file["objects/5"][()]), "duplicated frames", "objects/5"),
        (replaced("objects/3", np.zeros((4, 7))), "damaged objects", "objects/3"),
        (replaced("objects/3", np.full((1, 10), np.nan)), "damaged objects", "objects/3"),
        (replaced("objects/3", np.zeros((1, 10))), "damaged objects", "objects/3"),
        (replaced("objects/3", np.full((4, 10), b"x")), "damaged objects", "objects/3"),
        (replaced("dslices", np.zeros((0, 2, 300, 400), np.float32)), "it cannot be read", "recording.hdf5"),
        (replaced("cameras", np.eye(4)), "it cannot be read", "recording.hdf5"),
        (lambda file: file["objects"].__delitem__("3"), "damaged objects", "objects/3"),
        (depths(lambda depth, k: 0 * depth + 1000), "no points", "sensor north"),
        (replaced("cameras/d00/extrinsic", np.zeros((4, 4))), "it cannot be read", "recording.hdf5"),
        (replaced("cameras/d00/extrinsic", np.full((4, 4), np.nan)), "it cannot be read", "recording.hdf5"),
        (
            extrinsics(lambda matrix: matrix @ pose(0.0, 0.0, 9.0), ["d00"]),
            "it stands under the ground",
            "sensor north",
        ),
        (extrinsics(lambda matrix: np.diag([1, -1, -1, 1]) @ matrix, ["d00"]), "upside down", "sensor north"),
    ],
)
def test_damage(spoil, change, suspected, where):
    findings = spoil(change)
    assert any(suspected in finding.suspected and where in finding.where for finding in findings)


def test_a_dark_frame(spoil):
    def darken(file):
        for name in ("dslices", "coview/ranges/lidar"):
            file[name][4] = 0

    (finding,) = spoil(darken)
    assert (finding.where, finding.suspected) == ("frame 4", "frames without points")
    assert str(finding) == (
        "error: frame 4: frames without points (1 of 14 frames that were looked at, the first is 4);"
        " restore their images or leave them out"
    )


def test_objects_of_other_frames(spoil):
    def turn_over(file):
        file.move("objects", "others")
        for k in range(FRAMES):
            file[f"objects/{k}"] = file[f"others/{(k + 5) % FRAMES}"][()]

    assert any("points and boxes disagree" in finding.suspected for finding in spoil(turn_over))


def test_files_that_cannot_be_read(tmp_path, healthy):
    path = tmp_path / "recording.hdf5"
    with pytest.raises(FileNotFoundError):
        diagnose(path)
    for content, says in (
        (b"", "is empty"),
        (b"text" * 99, "not an HDF5 file"),
        (healthy[: len(healthy) // 2], "cut off"),
    ):
        path.write_bytes(content)
        (finding,) = diagnose(path)
        assert says in finding.evidence
