import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import h5py
import numpy as np
import pytest

from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.recording_file import Header, Scene, encode, join
from toolkit.datasets.recording_views import with_errors
from toolkit.detection.survey import survey
from toolkit.doctor.stored_file import diagnose_file
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

SITE = Site(
    "corner", np.array([-30.0, -20, 30, 20]), map_SE3_site=pose(104.0, -196.0, yaw=np.pi / 2)
)
NORTH = Sensor("north", DepthCamera(), look((0.0, 25.0, 6.0), -np.pi / 2, 0.2))
WEST = Sensor("d west", DepthCamera(fov=1.2), look((-30.0, 0.0, 5.0), 0.0, 0.1))
SMALL = Sensor(
    "small", DepthCamera(width=40, height=31, stride=3, sigma=0.1), look((0.0, -25.0, 6.0), 1.0)
)
LIDAR = Sensor("a lidar", SpinningLidar(channels=8, azimuth_step=0.1), pose(1.0, 2.0, 5.0, yaw=1.0))


DEPTHS: dict[tuple[str, bytes, bytes], np.ndarray] = {}


def box_depths(sensor: Sensor, boxes: np.ndarray) -> np.ndarray:
    """Measurement of every ray, cast once for all tests."""
    key = (repr(sensor.model), sensor.pose.tobytes(), boxes.tobytes())
    if key not in DEPTHS:
        DEPTHS[key] = cast_rays(sensor, boxes)
        DEPTHS[key].setflags(write=False)
    return DEPTHS[key]


def cast_rays(sensor: Sensor, boxes: np.ndarray) -> np.ndarray:
    """Measurement of every ray against upright boxes and the ground z = 0, by the slab method; 0
    for none."""
    rays = sensor.model.rays().reshape(-1, 3).astype(np.float64)
    direction, origin = rays @ sensor.pose[:3, :3].T, sensor.position
    with np.errstate(divide="ignore"):
        nearest = np.where(direction[:, 2] < 0, -origin[2] / direction[:, 2], np.inf)
        for x, y, z, *size, yaw in boxes:
            turn = np.array(
                [[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
            )
            o, d = turn @ (origin - [x, y, z]), direction @ turn.T
            low, high = np.sort(
                [(-np.array(size) / 2 - o) / d, (np.array(size) / 2 - o) / d], axis=0
            )
            enter, leave = low.max(axis=1), high.min(axis=1)
            nearest = np.where((enter < leave) & (enter > 0), np.minimum(nearest, enter), nearest)
    depth = np.where(nearest < 200, nearest, 0).astype(np.float32).reshape(sensor.model.shape)
    return np.round(depth * 1024) / np.float32(1024)


def scenes(sensors, frames=3, site=SITE):
    rng = np.random.default_rng(4)
    made = []
    for k in range(frames):
        n = 0 if k == 1 else 5
        x, y, z, yaw = (
            np.linspace(-16, 16, n),
            rng.uniform(-8, 8, n),
            np.full(n, 0.8),
            rng.uniform(-3, 3, n),
        )
        boxes = np.column_stack([x, y, z, rng.uniform([3, 1.5, 1.6], [5, 2, 1.6], (n, 3)), yaw])
        objects = Objects(boxes, rng.integers(0, 4, n), rng.integers(0, 999, n))
        measurements = tuple(box_depths(sensor, boxes) for sensor in sensors)
        made.append(Scene(Frame(tuple(sensors), measurements, objects, 5.0 * k, k), np.arange(n)))
    return made


def write(path, sensors, frames=3, site=SITE):
    made = scenes(sensors, frames, site)
    path.write_bytes(encode(Header(site, tuple(sensors), ("a", "b")), made))
    return [scene.frame for scene in made]


def same(read: Frame, made: Frame) -> bool:
    assert read.sensors == made.sensors
    assert (read.time, read.index) == (made.time, made.index)
    assert np.allclose(read.objects.boxes, made.objects.boxes, atol=1e-9)
    assert read.objects.labels.tolist() == made.objects.labels.tolist()
    assert read.objects.ids.tolist() == made.objects.ids.tolist()
    return all(np.array_equal(a, b) for a, b in zip(read.images, made.measurements, strict=True))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "recording.hdf5"


@pytest.fixture
def published(path):
    """A file as the authors wrote theirs: full images, colour, other cameras, no group of ours,
    CARLA coordinates."""
    site = load_site("tjunction")
    frames = write(path, site.sensors[:2], site=site)
    with h5py.File(path, "r+") as file:
        del file["coview"], file["slices"]
        depth = file["dslices"][:]
        del file["dslices"]
        file["dslices"] = np.where(depth > 0, depth, 3.0).astype(np.float64)
        file["slices"] = np.zeros((3, 2, 3, 4, 3), np.uint8)
        for old, new in (("d00", "depth1"), ("d01", "depth2")):
            file.move(f"cameras/{old}", f"cameras/{new}")
            file[f"cameras/{new}"].attrs.clear()
            file.copy(f"cameras/{new}", file["cameras"], f"camera{new}")
    return frames


@pytest.mark.parametrize(
    "sensors",
    [(NORTH,), (NORTH, WEST), (LIDAR, NORTH, WEST), (LIDAR,), (NORTH, SMALL), (SMALL, LIDAR, WEST)],
)
def test_frames_come_back(path, sensors):
    made = write(path, sensors)
    with CoopDataset(path) as dataset:
        assert dataset.sensors == sensors
        assert dataset.site == SITE
        assert len(dataset) == 3
        assert all(same(read, frame) for read, frame in zip(dataset, made, strict=True))
        objects = [dataset.read_objects(k) for k in range(3)]
    for alone, frame in zip(objects, made, strict=True):
        np.testing.assert_allclose(alone.boxes, frame.objects.boxes, atol=1e-9)
        np.testing.assert_array_equal(alone.ids, frame.objects.ids)


def test_ids_last_only_if_the_file_holds_them(path, published):
    assert not CoopDataset(path, load_site("tjunction")).has_ids
    path.unlink()
    write(path, (NORTH,))
    assert CoopDataset(path).has_ids


def test_joined_parts_are_one_recording(tmp_path, path):
    sensors = (NORTH, LIDAR)
    made = scenes(sensors, 4)
    header = Header(SITE, sensors, ("a", "b"))
    parts = [tmp_path / "1", tmp_path / "2"]
    parts[0].write_bytes(encode(header, made[:3]))
    parts[1].write_bytes(encode(header, made[3:]))
    join(header, parts, path)
    with CoopDataset(path) as dataset:
        assert all(same(read, scene.frame) for read, scene in zip(dataset, made, strict=True))


def test_frames_are_a_sequence_of_cameras_where_the_file_says(path):
    write(path, (NORTH,))
    with CoopDataset(path) as dataset:
        assert dataset[-1].index == dataset[np.int64(2)].index == 2
        assert [frame.index for frame in dataset[::-2]] == [2, 0]
        assert dataset[3:] == []
        assert "3 frames, 1 sensor, site 'corner'" in repr(dataset)
        for outside in (3, -4):
            with pytest.raises(IndexError, match="has 3 frames, 0 to 2"):
                dataset[outside]
        with pytest.raises(TypeError):
            dataset["1"]
    write(path, (NORTH, WEST))
    with h5py.File(path, "r+") as file:
        file["cameras/d00/extrinsic"][2, 3] += 1.0
    with CoopDataset(path) as dataset:
        assert dataset.sensors[0].name == "north"
        assert np.allclose(dataset.sensors[0].position, NORTH.position + NORTH.pose[:3, 1])
    damage(path, lambda file: file["cameras/d01"].attrs.__setitem__("name", NORTH.name))
    with pytest.raises(ValueError, match="name of its own"):
        CoopDataset(path)


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_goes_to_other_processes(path, method):
    made = write(path, (NORTH,))
    dataset = CoopDataset(path)
    assert same(dataset[0], made[0])
    assert same(pickle.loads(pickle.dumps(dataset))[2], made[2])
    with ProcessPoolExecutor(1, get_context(method)) as pool:
        assert same(pool.submit(dataset.__getitem__, 1).result(), made[1])
    assert same(dataset[2], made[2])


def test_the_published_files_and_those_from_elsewhere(path, published):
    dataset = CoopDataset(path)
    assert dataset.site.name == "tjunction"
    assert [sensor.name for sensor in dataset.sensors] == ["depth1", "depth2"]
    for read, made in zip(dataset, published, strict=True):
        assert np.allclose(read.objects.boxes, made.objects.boxes)
        assert read.objects.labels.tolist() == made.objects.labels.tolist()
        for a, b, sensor in zip(read.images, made.measurements, read.sensors, strict=True):
            assert a.dtype == np.float32
            assert np.array_equal(a, b)
            assert sensor.model == DepthCamera()
        for ours, theirs in zip(read.sensors, made.sensors, strict=True):
            assert np.allclose(ours.pose, theirs.pose)
    dataset.close()
    with h5py.File(path, "r+") as file:
        for objects in file["objects"].values():
            objects[:, :2] += 1000
        for camera in file["cameras"].values():
            camera["extrinsic"][:3, 3] += 1000
    with pytest.raises(ValueError, match="pass site="):
        CoopDataset(path)
    assert np.abs(CoopDataset(path, SITE)[0].objects.boxes[:, :2]).min() > 500


def back_projected(file: h5py.File, k: int, camera: str, channel: int) -> np.ndarray:
    """Points in CARLA's world as the formats document says, written down a second time: X = d,
    Y = (u - cu) d / f, Z = -(v - cv) d / f on every second pixel, then the inverse extrinsic."""
    intrinsic, matrix = (
        file[f"cameras/{camera}/intrinsic"][()],
        file[f"cameras/{camera}/extrinsic"][()],
    )
    depth = file["dslices"][k, channel][::2, ::2]
    v, u = np.meshgrid(np.arange(0, 300, 2), np.arange(0, 400, 2), indexing="ij")
    y, z = (
        (u - intrinsic[0, 0]) * depth / intrinsic[0, 1],
        -(v - intrinsic[1, 0]) * depth / intrinsic[0, 1],
    )
    points = np.stack([depth, y, z, np.ones_like(depth)]).reshape(4, -1)
    return (np.linalg.inv(matrix) @ points)[:3, depth.ravel() < 999].T


def test_the_published_reader_finds_points_on_the_surfaces_of_the_boxes(path):
    sensors = (NORTH, WEST)
    write(path, sensors)
    on_boxes = 0
    with h5py.File(path) as file:
        names = [name for name in file["cameras"] if name[0] == "d"]
        assert len(names) == file["dslices"].shape[1] == len(sensors)
        assert file["dslices"].shape == (3, 2, 300, 400)
        assert file["slices"].shape[0] == 3
        for k in range(3):
            points = np.concatenate(
                [back_projected(file, k, name, i) for i, name in enumerate(names)]
            )
            above = points[points[:, 2] > 0.01]
            explained = np.zeros(len(above), bool)
            for x, y, z, _, _, yaw, *half, _ in file[f"objects/{k}"]:
                c, s = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
                local = np.abs((above - [x, y, z]) @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]) - half
                explained |= (local < 0.005).all(axis=1) & (local.max(axis=1) > -0.005)
            assert explained.all()
            on_boxes += len(above)
            assert np.allclose(points[points[:, 2] <= 0.01, 2], 0, atol=0.01)
    assert on_boxes > 2000


def test_noise_depends_on_seed_frame_and_sensor_alone(path):
    write(path, (NORTH, WEST, LIDAR))
    frame = CoopDataset(path)[2]
    alone = Frame(frame.sensors[1:2], frame.images[1:2], frame.objects, frame.time, frame.index)
    noise = [
        a - b
        for a, b in zip(with_errors(frame, "paper", 7).images, frame.measurements, strict=True)
    ]
    assert np.array_equal(
        with_errors(alone, "paper", 7).images[0], with_errors(frame, "paper", 7).measurements[1]
    )
    assert not np.array_equal(
        with_errors(alone, "paper", 8).images[0], with_errors(frame, "paper", 7).measurements[1]
    )
    for sensor, measurement, difference in zip(frame.sensors, frame.images, noise, strict=True):
        assert not difference[measurement == 0].any()
        assert difference[measurement > 0].std() == pytest.approx(
            float(sensor.model.deviation(measurement)), rel=0.1
        )


def damage(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def put(name, content):
    def change(file):
        del file[name]
        if content is not None:
            file[name] = content

    return change


nan_pose = np.full((4, 4), np.nan)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (put("dslices", None), "'dslices' .* is missing"),
        (
            put("dslices", np.zeros((3, 300, 400), np.float32)),
            r"must be floats of shape \[T, C, H, W\]",
        ),
        (put("dslices", np.zeros((3, 2, 300, 400), np.uint8)), "must be floats"),
        (
            put("dslices", np.zeros((3, 1, 300, 400), np.float32)),
            "1 depth images a frame, but cameras/ has 2",
        ),
        (put("dslices", np.zeros((2, 2, 300, 400), np.float32)), "one length"),
        (put("dslices", np.zeros((3, 2, 30, 40), np.float32)), "intrinsic"),
        *(
            (put("cameras/d00", None), "cameras/ has 1 "),
            (put("cameras", np.eye(4)), "cameras must be an HDF5 group"),
        ),
        (put("cameras/d01", np.eye(4)), "cameras/d01 must be an HDF5 group"),
        (put("objects", np.zeros((3, 5, 10))), "objects must be an HDF5 group"),
        (put("cameras", None), "cameras/ has 0 .* none"),
        (put("cameras/d01/extrinsic", None), "cameras/d01/extrinsic is missing"),
        (put("cameras/d01/extrinsic", nan_pose), "cameras/d01/extrinsic holds NaN"),
        (put("cameras/d01/extrinsic", np.zeros((4, 4))), "cameras/d01/extrinsic is singular"),
        (put("cameras/d01/extrinsic", np.eye(3)), "cameras/d01/extrinsic must have shape"),
        (put("cameras/d01/intrinsic", DepthCamera().intrinsic), "cameras/d01/intrinsic must be"),
        (put("coview/site", "{"), "coview/site is damaged"),
    ],
)
def test_damaged_files_are_refused_with_what_is_wrong(path, change, says):
    write(path, (NORTH, WEST))
    damage(path, change)
    with pytest.raises(ValueError, match=rf"recording.hdf5: .*{says}"):
        CoopDataset(path)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *((None, "objects/2 is missing"), (np.full((5, 10), b"x"), "objects/2 must hold numbers")),
        (np.zeros((5, 7)), "objects/2 must have 10 columns"),
        (np.full((5, 10), np.nan), "objects/2 row 0 holds NaN"),
        (np.ones((2, 10)), "objects/2 has 2 rows, but there are 5 coview/object_ids for it"),
    ],
)
def test_a_damaged_frame_spares_the_others(path, content, says):
    made = write(path, (NORTH,))
    damage(path, put("objects/2", content))
    dataset = CoopDataset(path)
    assert same(dataset[0], made[0])
    with pytest.raises(ValueError, match=says):
        dataset[2]


def test_truncated_files_and_flipped_bits(path):
    write(path, (NORTH,))
    with h5py.File(path) as file:
        chunk = file["dslices"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    for share in (0.1, 0.5, 0.99):
        path.write_bytes(content[: int(len(content) * share)])
        with pytest.raises(OSError, match="is cut off"):
            CoopDataset(path)
    content[chunk.byte_offset + chunk.size // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(OSError, match="frame 0 cannot be read"):
        CoopDataset(path)[0]


def test_files_that_are_none(path):
    with pytest.raises(FileNotFoundError, match="check the path"):
        CoopDataset(path)
    path.with_name(path.name + ".parts").mkdir()
    with pytest.raises(FileNotFoundError, match="start it again"):
        CoopDataset(path)
    with pytest.raises(IsADirectoryError, match="give the HDF5 file"):
        CoopDataset(path.parent)
    for content, says in ((b"", "is empty"), (b"not this" * 100, "not an HDF5 file")):
        path.write_bytes(content)
        with pytest.raises(OSError, match=says):
            CoopDataset(path)


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        *(
            (6, -1.0, "has half extents"),
            (7, 0.0, "has half extents"),
            (8, 1e6, "has half extents"),
        ),
        *(
            (0, 1e300, "lies at"),
            (5, 1e18, "has yaw"),
            (2, np.nan, "holds NaN"),
            (9, 7.0, "has class"),
        ),
    ],
)
def test_objects_that_cannot_be_are_refused_by_row_or_dropped(path, column, value, says):
    made = write(path, (NORTH,))

    def spoil(file):
        rows = file["objects/2"][()]
        rows[1, column] = value
        file["objects/2"][...] = rows

    damage(path, spoil)
    with CoopDataset(path) as dataset:
        assert same(dataset[0], made[0])
        with pytest.raises(ValueError, match=rf"recording.hdf5: frame 2: objects/2 row 1 {says}"):
            dataset[2]
        with pytest.raises(ValueError, match="row 1"):
            survey(dataset)
    with pytest.warns(
        UserWarning, match=rf"1 objects in 1 frames are left out, .*objects/2 row 1, which {says}"
    ):
        dataset = CoopDataset(path, drop_invalid=True)
    assert dataset[2].objects.ids.tolist() == np.delete(made[2].objects.ids, 1).tolist()
    assert survey(dataset).frames == len(made)
    assert any(f.where == "objects/2" and "row 1" in f.evidence for f in diagnose_file(path))


def test_a_healthy_recording_loses_nothing_when_the_invalid_is_dropped(path, recwarn):
    made = write(path, (NORTH,))
    with CoopDataset(path, drop_invalid=True) as dataset:
        assert all(same(frame, was) for frame, was in zip(dataset, made, strict=True))
    assert not recwarn.list
