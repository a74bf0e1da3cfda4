"""A sensor model of one's own works everywhere: the shipped ones, and a fisheye camera that only
this file knows."""

from dataclasses import dataclass, replace
from typing import ClassVar

import gymnasium as gym
import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, strategies as st

import placement_env.envs.registration
from models.training.packed import PackedFrames
from models.training.packing import pack, recording
from placement_env.candidates.candidates import aim_sensor, aims, paper_candidates, pool
from placement_env.envs.scenario import poses
from placement_env.fidelity.occlusion import SensorRays
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import Traffic
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.bodies.body import Body
from toolkit.bodies.fleet import catalogue
from toolkit.boxes import footprints
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.doctor.stored_file import diagnose_file
from toolkit.frame import Frame, unproject
from toolkit.geometry import BODY_SE3_CAMERA, invert, look, pose, transform
from toolkit.objects import Objects
from toolkit.plots.plan_view import draw_frame, draw_site
from toolkit.points import frame_points, is_beyond, is_inside
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.static_scene import build_scenery
from toolkit.runtime.run import Run
from toolkit.sensors.models import (
    MODELS,
    DepthCamera,
    SolidStateLidar,
    SpinningLidar,
    find_model,
    make_model,
    register_sensor_model,
)
from toolkit.sensors.sensor import (
    NEAR,
    Measure,
    Sensor,
    SensorModel,
    angle,
    check_noise,
    check_numbers,
    is_return,
    nearest,
    with_noise,
)
from toolkit.sites.files import document, load_site, parse
from toolkit.sites.site import Mount, Relief, Site, Solid
from toolkit.traffic.snapshots import Snapshot

placement_env.envs.registration.register_environments()


@register_sensor_model
@dataclass(frozen=True)
class FisheyeCamera:
    """An equidistant fisheye, a square of pixels; frame: x right, y down, z forward; measures range
    along each ray."""

    kind: ClassVar[str] = "fisheye"
    measures: ClassVar[Measure] = "range"
    body_SE3_sensor: ClassVar[np.ndarray] = BODY_SE3_CAMERA

    pixels: int = 64
    horizontal_fov: float = angle(np.pi)
    sigma: float = 0.01
    max_range: float = 60.0
    label: str = "ceiling"
    offset: tuple[float, float] | None = None

    def __post_init__(self):
        check_numbers(self)
        check_noise(self.sigma, self.max_range)

    @property
    def vertical_fov(self):
        return self.horizontal_fov

    @property
    def shape(self):
        return self.pixels, self.pixels

    def rays(self):
        steps = ((np.arange(self.pixels) + 0.5) / self.pixels - 0.5) * self.horizontal_fov
        x, y = np.meshgrid(steps, steps)
        theta = np.hypot(x, y)
        across = np.sinc(theta / np.pi)
        return np.stack([x * across, y * across, np.cos(theta)], axis=-1).astype(np.float32)

    def deviation(self, measurement):
        return np.float32(self.sigma)

    def noisy(self, measurement, rng):
        return with_noise(measurement, self, rng)

    def in_view(self, points):
        x, y, z = np.moveaxis(points, -1, 0)
        across = np.maximum(np.hypot(x, y), 1e-12)
        theta = np.arctan2(across, z)
        half = self.horizontal_fov / 2
        ahead = (np.abs(theta * x / across) <= half) & (np.abs(theta * y / across) <= half)
        return ahead & (np.hypot(across, z) < self.max_range)

    def windows(self, sensor_corners):
        return np.array(
            [[k, 0, self.pixels, 0, self.pixels] for k in range(len(sensor_corners))]
        ).reshape(-1, 5)


EACH = [
    *(
        DepthCamera(width=120, height=90),
        SpinningLidar(channels=20, azimuth_step=float(np.deg2rad(2.0))),
    ),
    *(SolidStateLidar(rows=24, columns=90), FisheyeCamera(72, offset=(1.5, -2.0))),
]
models = pytest.mark.parametrize("model", EACH, ids=lambda model: type(model).__name__)
SPOTS = [
    ((-18.0, -12.0, 6.0), 0.6, 0.3),
    ((17.0, 10.0, 5.0), -2.5, 0.25),
    ((0.0, -13.0, 4.0), 1.5, 0.4),
]
BODIES = catalogue()


def hung(
    model: SensorModel, name: str, at: tuple[float, float, float], heading: float, tilt: float
) -> Sensor:
    return Sensor(name, model, pose(*at, yaw=heading, pitch=tilt) @ model.body_SE3_sensor)


def three(model: SensorModel) -> tuple[Sensor, ...]:
    return tuple(hung(model, f"s{i}", *spot) for i, spot in enumerate(SPOTS))


def moment(site: Site, bodies: tuple[Body, ...], seed: int, count: int) -> Snapshot:
    rng = np.random.default_rng(seed)
    chosen, cells = rng.integers(len(bodies), size=count), rng.permutation(20)[:count]
    xy = np.column_stack([cells % 5 - 2, cells // 5 - 1.5]) * [8.0, 7.0]
    sizes = np.array([bodies[b].size for b in chosen]).reshape(-1, 3)
    boxes = np.column_stack([xy, sizes[:, 2] / 2, sizes, rng.uniform(-np.pi, np.pi, count)])
    boxes[:, 2] += site.ground(footprints(boxes)).mean(axis=1)
    return Snapshot(
        Objects(boxes, np.array([bodies[b].label for b in chosen], np.int64)), chosen, 5.0 * seed
    )


def square(model: SensorModel) -> Site:
    house = Solid(np.array([[-4.0, 4.0], [2.0, 4.0], [2.0, 8.0], [-4.0, 8.0]]), -0.2, 5.0)
    mounts = tuple(
        Mount(f"post{i}", np.array([x, y, 0.0])) for i, ((x, y, _), _, _) in enumerate(SPOTS)
    )
    area = np.array([-20.0, -14, 20, 14])
    return Site(
        "square", area, solids=(house,), mounts=mounts, sensors=three(model), relief=Relief(0.05, 1)
    )


def some_traffic(model: SensorModel) -> Traffic:
    site = square(model)
    return Traffic(
        site, BODIES, tuple(moment(site, BODIES, seed, count) for seed, count in ((1, 11), (2, 8)))
    )


def cast_together(traffic: Traffic, k: int, sensor: Sensor) -> np.ndarray:
    """What a sensor measures, by one scene of everything and all rays."""
    scene, still = o3d.t.geometry.RaycastingScene(), build_scenery(traffic.site)
    scene.add_triangles(still.vertices.astype(np.float32), still.triangles.astype(np.uint32))
    snapshot = traffic.snapshots[k]
    for (x, y, z, *_, yaw), b in zip(snapshot.objects.boxes, snapshot.bodies, strict=True):
        vertices = transform(pose(x, y, z, yaw=yaw), BODIES[b].vertices.astype(np.float64))
        scene.add_triangles(vertices.astype(np.float32), BODIES[b].triangles.astype(np.uint32))
    direction = sensor.model.rays() @ sensor.pose[:3, :3].T
    lines = np.concatenate([sensor.position + NEAR * direction, direction], axis=-1)
    depth = scene.cast_rays(lines.astype(np.float32))["t_hit"].numpy() + NEAR
    return np.where(depth < sensor.model.max_range, depth, 0)


@models
def test_a_model_has_rays_in_its_field_of_view(model):
    assert isinstance(model, SensorModel)
    rays = model.rays().astype(np.float64)
    assert rays.shape == (*model.shape, 3)
    assert model.in_view(5 * rays[1:-1, 1:-1]).all()
    assert not model.in_view(2 * model.max_range * rays).any()
    body = rays @ model.body_SE3_sensor[:3, :3].T
    middle = body[:, [(model.shape[1] - 1) // 2, model.shape[1] // 2]].mean(axis=1)
    assert np.allclose(middle[:, 1] / middle[:, 0], 0, atol=0.03)
    length = {"range": np.linalg.norm(body, axis=-1), "depth": body[..., 0]}[model.measures]
    assert np.allclose(length, 1, atol=1e-6)
    heading = np.unwrap(
        np.arctan2(body[model.shape[0] // 2, :, 1], body[model.shape[0] // 2, :, 0])
    )
    width = abs(heading[-1] - heading[0]) * (1 + 1 / model.shape[1])
    assert width == pytest.approx(model.horizontal_fov, abs=0.06)


@models
def test_a_model_has_its_noise(model):
    clean = np.full(model.shape, 0.6 * min(model.max_range, 50.0), np.float32)
    clean[0, :3] = [0.0, np.nan, np.inf]
    noisy = model.noisy(clean, np.random.default_rng(1))
    assert noisy.dtype == np.float32
    assert not noisy[0, :3].any()
    expected = np.broadcast_to(model.deviation(clean[1:]), clean[1:].shape).mean()
    assert (noisy - clean)[1:].std() == pytest.approx(expected, rel=0.1)


@models
def test_a_models_bound_is_below_its_measurements(model):
    rng = np.random.default_rng(0)
    corners = rng.uniform(-20, 20, (50, 1, 3)) + rng.uniform(-2, 2, (50, 8, 3))
    points = rng.dirichlet(np.ones(8), (50, 200)) @ corners
    measured = (
        points @ model.body_SE3_sensor[0, :3]
        if model.measures == "depth"
        else np.linalg.norm(points, axis=-1)
    )
    assert (measured >= nearest(model, corners)[:, None]).all()


@models
def test_rendering_and_silhouettes_agree_with_all_rays_cast_at_once(model):
    traffic = some_traffic(model)
    close = hung(model, "close", (0.3, -3.0, 2.5), 1.0, 0.9)
    sensors = (*traffic.site.sensors, close)
    renderer = Renderer(traffic.site, BODIES, sensors)
    for k, snapshot in enumerate(traffic.snapshots):
        for sensor, depth in zip(sensors, renderer.render(snapshot).measurements, strict=True):
            assert np.isclose(depth, cast_together(traffic, k, sensor), atol=2e-3).mean() > 0.998, (
                sensor
            )
    rays, snapshot = SensorRays(renderer, sensors), traffic.snapshots[0]
    for row, body in enumerate(snapshot.bodies.tolist()):
        alone = Snapshot(snapshot.objects[[row]], snapshot.bodies[[row]])
        hits = np.concatenate([image.ravel() for image in renderer.render(alone).hits])
        found = rays.silhouette(body, snapshot.objects.boxes[row])
        assert len(set(found.pixels.tolist()) ^ set(np.flatnonzero(hits == 0).tolist())) <= 3
        assert np.array_equal(
            found.sensors, np.searchsorted(rays.first, found.pixels, side="right") - 1
        )


@models
def test_sensors_of_a_model_are_aimed(model):
    sensor = hung(model, "s", (1.0, 2.0, 5.0), 1.0, 0.5)
    assert np.allclose(aims([sensor]), [[1.0], [0.5]])
    turned = aim_sensor(sensor, np.array([3.0, 2.0, 6.0]), -2.0, 0.1)
    assert np.allclose(aims([turned]), [[-2.0], [0.1]])
    assert turned.position.tolist() == [3, 2, 6]
    ahead = transform(
        pose(1.0, 2.0, 5.0, yaw=1.0, pitch=0.5), np.array([[9.0, 0.5, 0.0], [3.0, 0.0, 9.0]])
    )
    assert is_beyond(ahead, sensor, 5.0, "published").tolist() == [True, False]


@models
def test_candidates_have_the_model(model):
    site = square(model)
    some = pool(
        site,
        heights=(5.0,),
        headings=4,
        tilts=(0.3,),
        models=[model, replace(model, max_range=20.0)],
    )
    assert all(f"_{model.kind}" in sensor.name for sensor in some.sensors)
    assert {sensor.model.max_range for sensor in some.sensors} == {model.max_range, 20.0}
    assert np.allclose(aims(some.sensors)[1], 0.3)
    assert (
        some.digest()
        != pool(site, heights=(5.0,), headings=4, tilts=(0.3,), models=[model]).digest()
    )
    _, _, _, width, lidar = poses(paper_candidates(site))
    assert np.allclose(width, model.horizontal_fov)
    assert (lidar == (model.measures == "range")).all()


@models
def test_files_keep_the_model(model):
    site = square(model)
    again = parse(document(site))
    for before, after in zip(site.sensors, again.sensors, strict=True):
        assert (after.name, after.model) == (before.name, before.model)
        assert np.allclose(after.pose, before.pose, atol=1e-8)


@models
def test_pictures_show_it(model, tmp_path):
    traffic = some_traffic(model)
    site = traffic.site
    draw_site(site, tmp_path / "site.png")
    (depth, *_), _ = Renderer(site, BODIES, site.sensors[:1]).render(traffic.snapshots[0])
    frame = Frame(site.sensors[:1], (depth,), traffic.snapshots[0].objects)
    clouds = frame_points(frame, area=site, rng=np.random.default_rng(0))
    assert len(clouds[0]) > 100
    draw_frame(
        site, tmp_path / "frame.png", clouds=clouds, sensors=frame.sensors, truth=frame.objects
    )
    assert min(path.stat().st_size for path in tmp_path.iterdir()) > 10_000


@models
def test_recordings_and_packed_files_give_it_back(model, tmp_path):
    pytest.importorskip("libsumo")
    site = load_site("tjunction")
    x, y, _ = site.sensors[0].position
    sensors = tuple(
        hung(model, f"s{i}", (x, y, 5.0 + i), np.arctan2(-y, -x), 0.3) for i in range(2)
    )
    simulate_dataset(site, tmp_path / "r.hdf5", run=Run(frames=2, seed=1), sensors=sensors)
    with CoopDataset(tmp_path / "r.hdf5") as dataset:
        assert dataset.sensors == sensors
        frames = list(dataset)
    assert all(frame.measurements[0].any() for frame in frames)
    assert not [
        str(each) for each in diagnose_file(tmp_path / "r.hdf5", site) if "sensor" in each.where
    ]
    pack([recording(frames, site.area)], tmp_path / "p.h5")
    packed = PackedFrames(tmp_path / "p.h5")
    assert packed.rig(0).sensors == sensors
    theirs = frame_points(frames[1], area=site)
    for ours, expected in zip(packed.points(1, None), theirs, strict=True):
        assert abs(len(ours) - len(expected)) <= 0.02 * len(expected) + 6
        assert np.allclose(np.median(ours, axis=0), np.median(expected, axis=0), atol=0.5)
    theirs = frame_points(frames[1], area=site, rng=np.random.default_rng(1))
    for ours, expected in zip(packed.points(1, np.random.default_rng(0)), theirs, strict=True):
        assert abs(len(ours) - len(expected)) < 0.1 * len(expected) + 20


@models
def test_what_a_fidelity_counts_is_what_was_rendered(model):
    traffic = some_traffic(model)
    some = paper_candidates(traffic.site)
    found = see(traffic, some)
    renderer = Renderer(traffic.site, traffic.bodies, some.sensors)
    total = 0
    for k, snapshot in enumerate(traffic.snapshots):
        measurements, hits = renderer.render(snapshot)
        for c, (sensor, depth, hit) in enumerate(
            zip(some.sensors, measurements, hits, strict=True)
        ):
            xyz, valid = unproject(sensor, depth)
            kept = hit.ravel()[valid & is_inside(xyz.T, traffic.site.area, traffic.site.height)]
            counts = np.bincount(kept[kept >= 0], minlength=len(snapshot.objects))
            total += counts.sum()
            boxes = snapshot.objects.boxes[:, None, :2]
            rows = np.argwhere((boxes == found.boxes[found.frame == k][:, :2]).all(axis=-1))
            assert (
                np.abs(found.points[c, found.frame == k][rows[:, 1]] - counts[rows[:, 0]]) <= 3
            ).all()
    assert total > 100
    sent = [
        [
            [len(Renders(traffic, some, noise_seed=n).clouds(k, c)) for k in range(2)]
            for c in range(3)
        ]
        for n in (1, 2)
    ]
    assert np.allclose(np.mean(sent, axis=0), found.sent, rtol=0.05, atol=15)


@pytest.mark.one_in(2)
@models
def test_objectives_and_environments_take_it(model):
    pytest.importorskip("libsumo")

    def few(site: Site):
        mounts = site.mounts[:4]
        return pool(
            site,
            heights=(5.0,),
            headings=2,
            tilts=(0.3,),
            models=[model],
            mounts=mounts,
            blind=True,
        )

    objective = Objective(Setting("tjunction", fidelity="coverage", candidates=few), Run(frames=2))
    assert objective.score([0, 2]).kbit > 0
    surrogate = Objective(Setting("tjunction", fidelity="surrogate", candidates=few), Run(frames=2))
    assert 0 < surrogate.score([0, 2, 4, 6]).recall <= 1
    env = gym.make("coview/SensorSelect-v0", objective=objective, budget=2, render_mode="rgb_array")
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    observation, reward, *_ = env.step(int(np.flatnonzero(info["action_mask"])[0]))
    assert env.observation_space.contains(observation)
    assert np.isfinite(reward)
    assert np.ptp(env.render()) > 100
    moving = gym.make(
        "coview/SensorPose-v0",
        site="tjunction",
        frames=2,
        fidelity="coverage",
        candidates=few,
        budget=2,
    )
    moving.reset(seed=0)
    observation, reward, *_ = moving.step(moving.action_space.sample())
    assert moving.observation_space.contains(observation)
    assert np.isfinite(reward)


def test_registered_models_go_by_name():
    assert find_model("fisheye-camera") == FisheyeCamera() == find_model("FisheyeCamera")
    assert make_model("FisheyeCamera", {"offset": [1.0, 2.0]}) == FisheyeCamera(offset=(1.0, 2.0))
    assert register_sensor_model(FisheyeCamera) is FisheyeCamera
    assert list(MODELS.values()).count(FisheyeCamera) == 1


def test_sensors_compare_by_value():
    one, other = (Sensor("s", DepthCamera(), pose(1.0, 2.0, 3.0)) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != Sensor("s", DepthCamera(), pose(1.0, 2.0, 4.0)) != "s"


def test_poses_of_sensors_are_copied():
    mine = pose(1.0, 2.0, 3.0)
    sensor = Sensor("s", CAMERA, mine)
    mine[0, 3] = 99
    assert sensor.position[0] == 1
    with pytest.raises(ValueError, match="read-only"):
        sensor.pose[0, 3] = 5


def test_bodies_of_sensors_look_along_x():
    sensor = Sensor("s", DepthCamera(), look((1.0, 2.0, 3.0), 0.4, 0.2))
    assert np.allclose(sensor.world_SE3_body, pose(1.0, 2.0, 3.0, yaw=0.4, pitch=0.2))
    assert np.allclose(invert(sensor.world_SE3_body) @ sensor.pose, BODY_SE3_CAMERA)


def test_digests_of_sensors_leave_out_their_name():
    lidar, place = SpinningLidar(), pose(1.0, 2.0, 3.0)
    sensor = Sensor("a", lidar, place)
    assert sensor.digest == Sensor("b", SpinningLidar(), place.copy()).digest
    others = [
        *(Sensor("a", CAMERA, place), Sensor("a", SpinningLidar(sigma=0.5), place)),
        *(
            Sensor("a", lidar, pose(1.0, 2.0, 3.0 + 1e-9)),
            Sensor("a", lidar, pose(1.0, 2.0, 3.0, yaw=1e-9)),
        ),
    ]
    assert len({sensor.digest, *(other.digest for other in others)}) == 5


CAMERA = DepthCamera()


def test_cameras_and_lidars_have_the_papers_rays():
    assert CAMERA.shape == (150, 200)
    np.testing.assert_allclose(CAMERA.intrinsic, [[200, 0, 200], [0, 200, 150], [0, 0, 1]])
    assert CAMERA.sigma == 0.015
    # X = (u - cu) d / f, Y = (v - cv) d / f, Z = d, on every second pixel of the full image.
    depth = 7.5
    points = CAMERA.rays() * np.float32(depth)
    for row, column in ((0, 0), (149, 199), (75, 100), (31, 180)):
        u, v = 2 * column, 2 * row
        np.testing.assert_allclose(
            points[row, column], [(u - 200) / 200 * depth, (v - 150) / 200 * depth, depth]
        )
    lidar = SpinningLidar(channels=3, fov_up=0.2, fov_down=-0.4, azimuth_step=np.pi / 2)
    rays = lidar.rays()
    assert rays.shape == (3, 4, 3) == (*lidar.shape, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, rtol=1e-6)
    np.testing.assert_allclose(rays[:, 0, 2], np.sin([0.2, -0.1, -0.4]), rtol=1e-6)
    np.testing.assert_allclose(
        np.diff(np.arctan2(rays[0, :, 1], rays[0, :, 0])), np.pi / 2, rtol=1e-6
    )
    rays = SpinningLidar(
        channels=1, fov_up=0.0, fov_down=0.0, azimuth_step=0.1, azimuth_fov=1.0
    ).rays()
    assert rays.shape == (1, 10, 3)
    np.testing.assert_allclose(rays[0, :, 1], -rays[0, ::-1, 1], atol=1e-6)
    assert (rays[..., 0] > np.cos(0.5)).all()
    camera = DepthCamera(width=64, height=41, stride=3, fov=1.2, centre=(30.0, 22.5))
    pixels = camera.rays() @ camera.intrinsic.T
    rows, columns = camera.shape
    across, down = np.meshgrid(np.arange(columns) * 3, np.arange(rows) * 3)
    np.testing.assert_allclose(pixels[..., 0], across, atol=1e-4)
    np.testing.assert_allclose(pixels[..., 1], down, atol=1e-4)
    sensor = Sensor("s", CAMERA, look((3.0, -2.0, 5.2), heading=2.0, tilt=0.3))
    depths = np.random.default_rng(0).uniform(1, 80, CAMERA.shape)
    in_sensor = depths[..., None] * CAMERA.rays().astype(np.float64)
    expected = transform(sensor.pose, in_sensor.reshape(-1, 3))
    np.testing.assert_allclose(
        (sensor.world_rays * depths.ravel()).T + sensor.position, expected, atol=1e-4
    )
    sensor = Sensor("s", CAMERA, look((0.0, 0.0, 5.0), heading=np.pi / 2))
    rays = sensor.world_rays.reshape(3, *CAMERA.shape)
    np.testing.assert_allclose(rays[:, 75, 100], [0, 1, 0], atol=1e-6)
    assert rays[2, -1, 100] < 0 < rays[2, 0, 100]
    assert rays[0, 75, 0] < 0 < rays[0, 75, -1]  # looking north, the image's left is west


@pytest.mark.parametrize("model", [CAMERA, SpinningLidar(channels=16)])
def test_noise_has_the_models_deviation_is_reproducible_and_keeps_nothing_nothing(model):
    nothing = np.zeros(model.shape, np.float32)
    nothing[0, :5] = [np.nan, np.inf, -np.inf, -3.0, model.max_range]
    assert not is_return(nothing, model.max_range).any()
    assert not model.noisy(nothing, np.random.default_rng(0)).any()
    clean = np.full(model.shape, 20.0, np.float32)
    noisy = model.noisy(clean, np.random.default_rng(3))
    assert noisy.dtype == np.float32
    assert abs((noisy - clean).std() / model.sigma - 1) < 0.05
    assert abs((noisy - clean).mean()) < model.sigma / 20
    np.testing.assert_array_equal(noisy, model.noisy(clean, np.random.default_rng(3)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        *(
            (lambda: DepthCamera(fov=90.0), "deg2rad"),
            (lambda: DepthCamera(stride=0), "at least 1"),
        ),
        *(
            (lambda: DepthCamera(sigma=-1.0), "sigma"),
            (lambda: DepthCamera(centre=(np.nan, 5.0)), "centre"),
        ),
        *(
            (lambda: DepthCamera(sigma=np.nan), "sigma"),
            (lambda: DepthCamera(sigma=np.inf), "sigma"),
        ),
        (lambda: DepthCamera(max_range=np.nan), "max_range must be a number, got nan"),
        (lambda: DepthCamera(fov=np.nan), "fov must be a number, got nan"),
        (lambda: DepthCamera(width=400.5), "width must be a whole number, got 400.5"),
        (lambda: DepthCamera(height=300.0), "height must be a whole number"),
        (lambda: DepthCamera(stride=True), "stride must be a whole number, got True"),
        *(
            (lambda: DepthCamera(centre=("a", "b")), "centre"),
            (lambda: DepthCamera(centre=5.0), "centre"),
        ),
        (lambda: SpinningLidar(channels=0), "channels"),
        (lambda: SpinningLidar(channels=1.5), "channels must be a whole number, got 1.5"),
        (lambda: SpinningLidar(azimuth_fov=np.nan), "azimuth_fov must be a number, got nan"),
        (lambda: SpinningLidar(fov_up="10"), "fov_up must be a number, got '10'"),
        (lambda: SpinningLidar(fov_up=-0.5, fov_down=0.5), "fov_down <= fov_up"),
        (lambda: SpinningLidar(azimuth_step=0.0), "azimuth_step"),
        (lambda: Sensor("s", CAMERA, np.diag([1.0, -1, 1, 1])), "mirrors"),
        (lambda: Sensor("s", CAMERA, np.zeros((4, 4))), "'s'"),
        (lambda: Sensor("s", CAMERA, np.full((4, 4), np.nan)), "NaN"),
    ],
)
def test_impossible_sensors_are_refused(make, message):
    # values of another type meet the shape checker first, where tests run with it
    with pytest.raises((ValueError, TypeError), match=f"{message}|Type-check error"):
        make()


@given(st.floats(width=32, allow_nan=True, allow_infinity=True))
def test_returned_means_finite_and_positive(value):
    assert is_return(np.array([value], np.float32))[0] == (
        np.isfinite(value) and value > 0 and value < 3.4028234e38
    )
