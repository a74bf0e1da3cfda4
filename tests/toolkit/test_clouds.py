import gc
from typing import Any

import numpy as np
import open3d as o3d
import pytest

from toolkit.clouds import (
    attributes,
    crop,
    down_sample,
    from_attributes,
    from_depth,
    from_points,
    fuse,
    load,
    points_per_box,
    positions,
    save,
    sensor_numbers,
)
from toolkit.geometry import look, pose, transform
from toolkit.points import is_beyond
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = (-40, -20, 40, 20)
CAMERA = Sensor("c", DepthCamera(), look((5.0, -3.0, 5.2), heading=1.0, tilt=0.2))
LIDAR = Sensor("l", SpinningLidar(channels=8), pose(5.0, -3.0, 5.2, yaw=0.3))


def random_depth(sensor, seed=0):
    return np.random.default_rng(seed).uniform(1, 30, sensor.model.shape).astype(np.float32)


def random_cloud(n=500, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.uniform([-50, -30, -2], [50, 30, 6], (n, 3)).astype(np.float32)
    return from_points(points, rng.integers(0, 6, n))


def test_clouds_are_open3ds_with_noise_along_rays():
    depth = random_depth(CAMERA)
    # every second pixel: half of K
    intrinsic = o3d.camera.PinholeCameraIntrinsic(200, 150, 100, 100, 100, 75)
    theirs: Any = o3d.geometry.PointCloud.create_from_depth_image(
        o3d.geometry.Image(depth), intrinsic, depth_scale=1.0, depth_trunc=1000.0
    ).transform(CAMERA.pose)
    np.testing.assert_allclose(
        positions(from_depth(CAMERA, depth)), np.asarray(theirs.points), atol=1e-4
    )
    depth = random_depth(CAMERA)
    clean, noisy = (
        positions(from_depth(CAMERA, depth, rng=rng)).astype(np.float64) - CAMERA.position
        for rng in (None, np.random.default_rng(1))
    )
    assert (
        0.005 < np.abs(np.linalg.norm(noisy, axis=1) - np.linalg.norm(clean, axis=1)).mean() < 0.03
    )
    direction = np.cross(noisy, clean) / np.linalg.norm(clean, axis=1, keepdims=True) ** 2
    assert np.abs(direction).max() < 1e-5


@pytest.mark.parametrize("sensor", [CAMERA, LIDAR])
def test_depth_is_measurement_times_ray_where_it_returned(sensor):
    depth = random_depth(sensor)
    cloud = from_depth(sensor, depth, sensor_id=4)
    expected = transform(
        sensor.pose, (depth[..., None] * sensor.model.rays()).reshape(-1, 3).astype(np.float64)
    )
    np.testing.assert_allclose(positions(cloud), expected, atol=1e-4)
    assert cloud.point.positions.dtype == o3d.core.float32
    assert cloud.point["sensor"].dtype == o3d.core.int32
    assert tuple(cloud.point["sensor"].shape) == (depth.size, 1)
    assert (sensor_numbers(cloud) == 4).all()
    depth = np.zeros(sensor.model.shape, np.float32)
    depth[0, :6] = [np.nan, np.inf, -np.inf, -1.0, sensor.model.max_range, 7.0]
    assert len(positions(from_depth(sensor, depth))) == 1
    assert positions(from_depth(sensor, np.zeros_like(depth))).shape == (0, 3)


def test_fused_and_empty_clouds_keep_points_and_sensors():
    parts = [
        from_depth(CAMERA, random_depth(CAMERA), sensor_id=2),
        random_cloud(50),
        from_points(np.zeros((0, 3))),
    ]
    fused = fuse(parts)
    np.testing.assert_array_equal(
        positions(fused), np.concatenate([positions(part) for part in parts])
    )
    np.testing.assert_array_equal(
        sensor_numbers(fused), np.concatenate([sensor_numbers(part) for part in parts])
    )
    for empty in (fuse([]), crop(random_cloud(), (90, 90, 91, 91)), o3d.t.geometry.PointCloud()):
        assert positions(fuse([empty, empty])).shape == (0, 3)
        assert positions(crop(empty, AREA)).shape == (0, 3)
        assert points_per_box(empty, np.array([[0, 0, 1, 4, 2, 1.5, 0]])).tolist() == [0]


def test_crop_keeps_the_areas_edge_neither_ground_nor_ceiling_and_other_attributes():
    points = np.array(
        [[40, 20, 1], [40.01, 0, 1], [0, 0, 0], [0, 0, 4], [0, 0, 3.9], [-40, -20, 0.1]], np.float32
    )
    cloud = from_points(points)
    np.testing.assert_array_equal(positions(crop(cloud, AREA)), points[[0, 4, 5]])
    for low in (
        crop(cloud, AREA, 3.0),
        crop(cloud, Site("low", np.array(AREA, float), height=3.0)),
    ):
        np.testing.assert_array_equal(positions(low), points[[0, 5]])
    cloud = random_cloud(20)
    cloud.point["intensity"] = o3d.core.Tensor(positions(cloud)[:, :1].copy())
    cropped = crop(cloud, AREA)
    np.testing.assert_array_equal(cropped.point["intensity"].numpy(), positions(cropped)[:, :1])


@pytest.mark.parametrize("area", [(1, 1, 0, 0), (0, 0, 1), (0, 0, np.nan, 1), (0, 0, 0, 1)])
def test_an_area_that_encloses_nothing_is_refused(area):
    with pytest.raises(ValueError, match="area"):
        crop(random_cloud(), area)


def test_radii_are_horizontal_published_or_refused():
    points = np.array([[5, 7.1, 90], [5, 6.9, -90], [15.1, -3, 0], [5, -3, 100]], np.float32)
    assert is_beyond(points, CAMERA, 10.0).tolist() == [True, False, True, False]
    cloud = random_cloud(2000)
    in_camera = (positions(cloud) - CAMERA.position) @ CAMERA.pose[:3, :3]
    expected = np.hypot(in_camera[:, 0], in_camera[:, 2]) > 20
    for camera in (CAMERA, CAMERA.pose):
        np.testing.assert_array_equal(
            is_beyond(positions(cloud), camera, 20.0, "published"), expected
        )
    for sensor in (Sensor("level", DepthCamera(), look((5.0, -3.0, 5.2), heading=1.0)), LIDAR):
        both = [
            is_beyond(positions(cloud), sensor, 20.0, metric)
            for metric in ("horizontal", "published")
        ]
        np.testing.assert_array_equal(*both)
    with pytest.raises(ValueError, match=r"'c' measures \(150, 200\) pixels"):
        from_depth(CAMERA, np.ones((3, 4), np.float32))
    with pytest.raises(ValueError, match="radius"):
        is_beyond(positions(random_cloud()), CAMERA, -1.0)
    with pytest.raises(ValueError, match="intensity must have one row for each of 3 points, got 2"):
        from_attributes({"positions": np.zeros((3, 3)), "intensity": np.zeros(2)})


def test_points_per_box_by_hand():
    boxes = np.array(
        [[0, 0, 1, 4, 2, 1.5, 0.3], [20, 10, 1, 9, 9, 5, 1.0], [99, 99, 1, 4, 2, 1.5, 0]]
    )
    cloud = random_cloud(5000)
    counts = points_per_box(cloud, boxes)
    np.testing.assert_array_equal(counts, points_per_box(positions(cloud), boxes))
    assert counts[1] > 0 == counts[2]


@pytest.mark.parametrize("ending", ["ply", "pcd", "npz"])
def test_files_keep_every_attribute(tmp_path, ending):
    scattered = np.random.default_rng(0).normal(0, 9, (50, 3))
    for cloud in (
        rich_cloud(),
        *(from_points(scattered.astype(t), np.arange(50) % 7) for t in (np.float32, np.float64)),
    ):
        save(cloud, tmp_path / f"cloud.{ending}")
        ours, theirs = attributes(load(tmp_path / f"cloud.{ending}")), attributes(cloud)
        assert ours.keys() == theirs.keys()
        for name, column in ours.items():
            # see toolkit.point_writing
            single = ending == "pcd" and name in ("positions", "normals")
            expected = theirs[name].astype(np.float32) if single else theirs[name]
            assert column.dtype == expected.dtype
            np.testing.assert_array_equal(column, expected, err_msg=name)
        assert [path.name for path in tmp_path.iterdir()] == [f"cloud.{ending}"]


def test_files_that_cannot_be_are_refused(tmp_path):
    with pytest.raises(ValueError, match="no points"):
        save(fuse([]), tmp_path / "a.ply")
    with pytest.raises(ValueError, match=r"\.ply, \.pcd or \.npz"):
        save(random_cloud(), tmp_path / "a.las")
    with pytest.raises(OSError, match="folder exists"):
        save(random_cloud(), tmp_path / "nowhere" / "a.ply")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "missing.ply")
    (tmp_path / "damaged.ply").write_bytes(
        b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n"
    )
    with pytest.raises(ValueError, match="no points that can be read"):
        load(tmp_path / "damaged.ply")


@pytest.mark.slow
def test_clouds_own_their_memory_and_keep_points_when_thinned():
    clouds = [from_points(np.full((1000, 3), k, np.float32), k) for k in range(200)]
    gc.collect()
    assert all(
        (positions(cloud) == k).all() and (sensor_numbers(cloud) == k).all()
        for k, cloud in enumerate(clouds)
    )
    parts = [rich_cloud(20, 1), fuse([]), rich_cloud(30, 2)]
    fused = fuse(parts)
    for name in attributes(parts[0]):
        expected = np.concatenate([attributes(part)[name] for part in (parts[0], parts[2])])
        np.testing.assert_array_equal(attributes(fused)[name], expected)
    with pytest.warns(UserWarning, match=r"fuse drops intensity, ring: not all 2 clouds"):
        poorer = fuse([rich_cloud(20, 1), rich_cloud(30, 2, "intensity", "ring")])
    assert set(attributes(poorer)) == {"positions", "sensor", "normals", "colors", "time"}
    cloud = rich_cloud(3000)
    thin = down_sample(cloud, 4.0)
    cells = [
        set(
            map(
                tuple,
                np.column_stack(
                    [np.floor(positions(c).astype(float) / 4.0), sensor_numbers(c)]
                ).tolist(),
            )
        )
        for c in (cloud, thin)
    ]
    assert cells[0] == cells[1]
    assert len(positions(thin)) == len(cells[0]) < 2500
    row = {tuple(point): k for k, point in enumerate(positions(cloud).tolist())}
    rows = [row[tuple(point)] for point in positions(thin).tolist()]
    assert rows == sorted(rows)
    for name, column in attributes(thin).items():
        np.testing.assert_array_equal(column, attributes(cloud)[name][rows])
    assert len(positions(down_sample(fuse([]), 1.0))) == 0
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="voxel_m"):
            down_sample(cloud, wrong)


def rich_cloud(n=60, seed=0, *left_out):
    """A cloud with everything that scanners give."""
    rng = np.random.default_rng(seed)
    made: dict[str, np.ndarray] = {
        "positions": rng.normal(0, 9, (n, 3)).astype(np.float32),
        "sensor": (np.arange(n) % 5).astype(np.int32)[:, None],
        "normals": rng.normal(size=(n, 3)).astype(np.float32),
        "colors": rng.integers(0, 256, (n, 3)).astype(np.uint8),
        "intensity": rng.random((n, 1)).astype(np.float32),
        "time": rng.random((n, 1)) + 1.7e9,
        "ring": rng.integers(0, 64, (n, 1)).astype(np.uint16),
    }
    return from_attributes({name: column for name, column in made.items() if name not in left_out})


class TestFusingCloudsOfAnyKind:
    """`fuse` takes tensor clouds, legacy clouds and arrays, in their sensors' frames where poses
    are given."""

    FAR = pose(500_000.25, 5_400_000.5, 120.0, yaw=0.7)

    def test_poses_move_points_in_float64_and_turn_normals(self):
        points = np.random.default_rng(0).uniform(-20, 20, (30, 3))
        legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        legacy.normals = o3d.utility.Vector3dVector(np.tile([1.0, 0.0, 0.0], (30, 1)))
        theirs: Any = o3d.geometry.PointCloud(legacy).transform(self.FAR)
        fused = fuse([legacy], [self.FAR])
        np.testing.assert_allclose(positions(fused), np.asarray(theirs.points), atol=1e-6)
        np.testing.assert_allclose(
            fused.point.normals.numpy(), np.asarray(theirs.normals), atol=1e-6
        )

    def test_clouds_without_a_number_get_their_place(self):
        points = np.ones((2, 3), np.float32)
        legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        tensors = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))
        fused = fuse([points, legacy, tensors, from_points(points, 7)], [np.eye(4)] * 4)
        assert sensor_numbers(fused).tolist() == [0, 0, 1, 1, 2, 2, 7, 7]
        with pytest.raises(
            ValueError, match="cloud 1 has no sensor number, and another has number 1"
        ):
            fuse([from_points(points, 1), points], [np.eye(4)] * 2)

    def test_a_fourth_column_is_the_intensity(self):
        points = np.array([[1, 2, 3, 0.5], [4, 5, 6, 0.25]], np.float32)
        fused = fuse([points])
        assert attributes(fused)["intensity"].ravel().tolist() == [0.5, 0.25]
        assert positions(fused).tolist() == points[:, :3].tolist()

    def test_clouds_in_sensor_frames_are_not_heaped_in_silence(self):
        points = np.ones((2, 3))
        with pytest.warns(UserWarning, match="clouds 0, 2 have neither a pose nor a sensor number"):
            fuse([points, from_points(points, 5), points])

    @pytest.mark.parametrize(
        ("clouds", "poses", "said"),
        [
            ([np.ones((2, 3))], [np.eye(4)] * 2, "1 clouds but 2 poses"),
            ([np.ones((2, 3))], [np.zeros((4, 4))], "pose 0 must"),
            (np.ones((5, 3)), None, "a list of clouds"),
            (from_points(np.ones((5, 3))), None, "a list of clouds"),
            ([np.ones((3, 9))], None, r"\(3, 9\): pass points.T"),
            (["north.ply"], None, "a cloud must be Open3D's or an array"),
            ([np.ones((5, 7))], None, r"got ndarray \(5, 7\)"),
        ],
    )
    def test_what_is_no_list_of_clouds_is_refused(self, clouds, poses, said):
        with pytest.raises(ValueError, match=said):
            fuse(clouds, poses)

    def test_arrays_and_legacy_clouds_are_cropped_thinned_and_counted(self):
        points = np.array([[1.0, 1.0, 1.0], [1.1, 1.0, 1.0], [90.0, 0.0, 1.0]])
        legacy = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        for cloud in (points, legacy, from_points(points)):
            np.testing.assert_array_equal(positions(crop(cloud, AREA)), points[:2])
            assert len(positions(down_sample(cloud, 1.0))) == 2
            assert points_per_box(cloud, np.array([[1.0, 1, 1, 2, 2, 2, 0]])).tolist() == [2]
