"""The renderer measures what analytic geometry says; moments and sight lines agree with it."""

import pickle

import numpy as np
import open3d as o3d
import pytest

from placement_env.fidelity.occlusion import SensorRays
from toolkit.bodies.body import Body, make_body, make_boxed_body
from toolkit.bodies.fleet import catalogue, fleet_named
from toolkit.boxes import corners
from toolkit.geometry import invert, look, pose, transform
from toolkit.mesh import box, merge, place
from toolkit.objects import VEHICLE, Objects
from toolkit.rendering import renderer as module
from toolkit.rendering.renderer import GRAZE, Moment, Renderer, SightLines
from toolkit.rendering.static_scene import build_scenery
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import NEAR, Sensor
from toolkit.sites.site import Relief, Site, Solid
from toolkit.traffic.snapshots import Snapshot

AREA = np.array([-30.0, -20, 30, 20])
FLAT = Site("flat", AREA)
CUBE = make_body("cube", VEHICLE, *box((2.0, 2.0, 2.0)))
CAMERA = DepthCamera(80, 60, 1)


def snapshot(
    bodies: tuple[Body, ...], *rows: tuple[int, float, float, float], lift: float = 0.0
) -> Snapshot:
    """Rows (body, x, y, yaw) as objects on the ground at z = lift."""
    boxes = np.array(
        [[x, y, bodies[b].size[2] / 2 + lift, *bodies[b].size, yaw] for b, x, y, yaw in rows]
    ).reshape(-1, 7)
    chosen = np.array([row[0] for row in rows], np.int64)
    return Snapshot(Objects(boxes, np.array([bodies[b].label for b in chosen], np.int64)), chosen)


def camera(position, heading=0.0, tilt=0.0, model: DepthCamera | SpinningLidar = CAMERA) -> Sensor:
    return Sensor("camera", model, look(position, heading, tilt))


def lidar(position, heading=0.0, **options) -> Sensor:
    return Sensor("lidar", SpinningLidar(**options), pose(*position, yaw=heading))


@pytest.mark.parametrize("tilt", [0.2, 0.5, np.pi / 2])
def test_flat_ground_has_the_depth_of_a_plane(tilt):
    sensor = camera((0.0, 0.0, 6.0), 0.3, tilt)
    depth = Renderer(FLAT, (CUBE,), (sensor,)).background[0]
    slope = (sensor.model.rays() @ sensor.pose[:3, :3].T)[..., 2]
    with np.errstate(divide="ignore"):
        plane = np.where(slope < 0, -6.0 / slope, 0.0)
    near = (plane > 0) & (plane < 80)
    assert np.allclose(depth[near], plane[near], rtol=1e-4)
    assert (depth[slope > 0] == 0).all()


def test_lidars_and_boxes_have_range_and_depth():
    sensor = lidar((0.0, 0.0, 4.0), 1.0)
    found = Renderer(FLAT, (CUBE,), (sensor,)).background[0]
    slope = sensor.model.rays()[..., 2]
    near = slope < -0.1
    assert np.allclose(found[near], -4.0 / slope[near], rtol=1e-4)
    assert (found[slope >= 0] == 0).all()
    renderer = Renderer(FLAT, (CUBE,), (camera((0.0, 0.0, 1.0)),))
    (depth,), (hits,) = renderer.render(snapshot((CUBE,), (0, 20.0, 9.0, 0.0), (0, 11.0, 0.0, 0.0)))
    x, y = CAMERA.rays()[..., 0], CAMERA.rays()[..., 1]
    front = (np.abs(x * 10) < 0.999) & (np.abs(y * 10) < 0.999)
    assert np.allclose(
        depth[front], 10.0, atol=1e-5
    )  # depth, not distance, so the whole face is equally deep
    assert (hits[front] == 1).all()
    assert set(np.unique(hits)) == {-1, 0, 1}
    still = hits < 0
    assert np.array_equal(depth[still], renderer.background[0][still])
    plank = make_body("plank", VEHICLE, *box((6.0, 0.2, 1.0)))
    sensor = camera((0.0, 0.0, 10.0), 0.0, np.pi / 2)  # up in the picture is +x, left is +y
    _, (hits,) = Renderer(FLAT, (plank,), (sensor,)).render(
        snapshot((plank,), (0, 0.0, 0.0, np.pi / 4))
    )
    rows, columns = np.nonzero(hits == 0)
    assert np.corrcoef(rows, columns)[0, 1] > 0.9  # up and left together
    lifted = snapshot((CUBE,), (0, 12.0, 0.0, 0.0), lift=3.0)
    (depth,), (hits,) = Renderer(FLAT, (CUBE,), (camera((0.0, 0.0, 4.0)),)).render(lifted)
    assert (hits == 0).sum() > 30
    assert depth[30, 40] == pytest.approx(11.0, abs=1e-4)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_hit_counts(order):
    rows = [(0, 6.0, 0.0, 0.0), (0, 10.0, 2.0, 0.0)]
    wall = Site(
        "wall",
        AREA,
        solids=(Solid(np.array([[14.0, -9], [15, -9], [15, 0], [14, 0]]), 0.0, 5.0, "wall"),),
    )
    renderer = Renderer(wall, (CUBE,), (camera((0.0, 0.0, 1.0)),))
    hidden = (0, 20.0, -3.0, 0.0)
    (depth,), (hits,) = renderer.render(snapshot((CUBE,), *(rows[i] for i in order), hidden))
    assert hits[30, 40] == order.index(0)
    assert depth[30, 40] == pytest.approx(5.0, abs=1e-4)
    assert not (hits == 2).any()
    assert (hits == order.index(1)).any()
    seen_wall = (hits < 0) & (np.abs(depth - 14) < 1e-3)
    assert seen_wall.any()


def everything_at_once(
    site: Site, bodies: tuple[Body, ...], frame: Snapshot, sensor: Sensor
) -> tuple[np.ndarray, np.ndarray]:
    """The oracle: one scene with all meshes in the world, all rays cast."""
    scene, still = o3d.t.geometry.RaycastingScene(), build_scenery(site)
    scene.add_triangles(still.vertices.astype(np.float32), still.triangles.astype(np.uint32))
    for (x, y, z, *_, yaw), body in zip(frame.objects.boxes, frame.bodies, strict=True):
        vertices = transform(pose(x, y, z, yaw=yaw), bodies[body].vertices.astype(np.float64))
        vertices[:, 2] += (vertices[:, :2] - [x, y]) @ site.relief.slope
        scene.add_triangles(vertices.astype(np.float32), bodies[body].triangles.astype(np.uint32))
    direction = sensor.model.rays() @ sensor.pose[:3, :3].T
    origin = sensor.position + NEAR * direction
    hit = scene.cast_rays(np.concatenate([origin, direction], axis=-1).astype(np.float32))
    depth = hit["t_hit"].numpy() + NEAR
    depth[~(depth < sensor.model.max_range)] = 0
    hits = hit["geometry_ids"].numpy().astype(np.int64) - 1
    return depth, np.where((depth > 0) & (hits < 1000), hits, -1)


@pytest.mark.parametrize(
    ("seed", "slope"), [*((seed, (0.0, 0.0)) for seed in range(4)), (4, (0.05, -0.03))]
)
def test_agrees_with_casting_everything_at_once(seed, slope):
    rng = np.random.default_rng(seed)
    bodies = catalogue()
    house = Solid(np.array([[5.0, 5], [12, 5], [12, 9], [5, 9]]), -0.3, 5.0, "building")
    tree = Solid(np.array([[-8.0, -8], [-5, -8], [-5, -5], [-8, -5]]), 2.0, 6.0, "tree")
    site = Site("mixed", AREA, solids=(house, tree), relief=Relief(0.05, 1, slope))
    rows = [
        (int(rng.integers(len(bodies))), *rng.uniform(AREA[:2], AREA[2:]), rng.uniform(-4, 4))
        for _ in range(25)
    ]
    frame = snapshot(bodies, *rows)
    x, y = frame.objects.boxes[0, :2]
    sensors = (
        camera((-25.0, 3.0, 5.0), 0.1, 0.15, DepthCamera(200, 150, 1)),
        camera((0.0, 0.0, 1.0), 2.0, -0.2, DepthCamera(160, 120, 2, max_range=15.0)),
        camera(
            (x, y, 4.5), 1.0, 1.2, DepthCamera(100, 75, 1, fov=2.2)
        ),  # close above an object, which reaches behind
        lidar((2.0, -3.0, 3.0), rng.uniform(-4, 4), channels=32),
        lidar((x + 1.0, y, 2.5), 0.5, channels=16, azimuth_fov=2.0, max_range=12.0),
    )
    rendered = Renderer(site, bodies, sensors).render(frame)
    for sensor, depth, hits in zip(sensors, *rendered, strict=True):
        whole, ids = everything_at_once(site, bodies, frame, sensor)
        same = np.isclose(depth, whole, atol=2e-3)
        assert same.mean() > 0.9995, sensor  # a grazing ray may pass an edge on either side
        assert (hits == ids).mean() > 0.9995, sensor
        assert depth.dtype == np.float32
        assert hits.dtype == np.int32


@pytest.mark.parametrize("heading", [0.0, np.pi, 3.0])
def test_lidar_sees_a_box_across_the_seam_of_its_turn(heading):
    sensor = lidar((0.0, 0.0, 1.0), heading, channels=32)
    hits = Renderer(FLAT, (CUBE,), (sensor,)).render(snapshot((CUBE,), (0, -6.0, 0.0, 0.0))).hits[0]
    assert isinstance(sensor.model, SpinningLidar)
    seen = np.flatnonzero((hits == 0).any(axis=0)) * sensor.model.azimuth_step
    assert len(seen) * sensor.model.azimuth_step == pytest.approx(2 * np.arctan(1 / 5), abs=0.02)


def test_nothing_returns_out_of_range_or_of_ones_own_post():
    short = camera((0.0, 0.0, 1.0), model=DepthCamera(80, 60, 1, max_range=8.0))
    measured, hits = Renderer(FLAT, (CUBE,), (short,)).render(
        snapshot((CUBE,), (0, 11.0, 0.0, 0.0))
    )
    assert not (hits[0] >= 0).any()
    assert measured[0].max() < 8.0
    around = Renderer(FLAT, (CUBE,), (camera((0.0, 0.0, 1.0)),)).render(
        snapshot((CUBE,), (0, 1.0 + 0.5 * NEAR, 0.0, 0.0))
    )
    assert np.allclose(
        around.measurements[0][30, 40], 2.0 + 0.5 * NEAR, atol=1e-4
    )  # through the near face to the far one
    angle = np.arange(8) * np.pi / 4
    post = Solid(0.1 * np.column_stack([np.cos(angle), np.sin(angle)]), 0.0, 8.0, "post")
    seen = Renderer(
        Site("post", AREA, solids=(post,)), (CUBE,), (camera((0.0, 0.0, 5.0), 0.0, 0.4),)
    ).background
    assert np.allclose(
        seen[0],
        Renderer(FLAT, (CUBE,), (camera((0.0, 0.0, 5.0), 0.0, 0.4),)).background[0],
        atol=1e-4,
    )
    renderer = Renderer(FLAT, (CUBE,), (camera((0.0, 0.0, 5.0), 0.0, 0.2), lidar((0.0, 0.0, 5.0))))
    rendered = renderer.render(Snapshot(Objects.empty(), np.zeros(0, np.int64)))
    for image, hit, background in zip(*rendered, renderer.background, strict=True):
        assert np.array_equal(image, background)
        assert (hit == -1).all()
    mesh = merge([place(box((1.0, 40.0, 20.0)), 9.0)])
    depth = Renderer(FLAT, (CUBE,), (camera((0.0, 0.0, 5.0)),), scenery=mesh).background[0]
    assert depth[30, 40] == pytest.approx(8.5, abs=1e-4)


def test_rendering_repeats_itself_and_refuses_other_bodies():
    renderer = Renderer(FLAT, catalogue(), (camera((-10.0, 0.0, 5.0), 0.0, 0.2),))
    before = renderer.background[0].copy()
    frame = snapshot(catalogue(), (3, 0.0, 0.0, 0.4), (30, 2.0, 4.0, 1.0))
    first, again, elsewhere = (
        r.render(frame) for r in (renderer, renderer, pickle.loads(pickle.dumps(renderer)))
    )
    for other in (again, elsewhere):
        assert np.array_equal(first.measurements[0], other.measurements[0])
        assert np.array_equal(first.hits[0], other.hits[0])
    assert np.array_equal(before, renderer.background[0])
    renderer = Renderer(FLAT, catalogue(), (camera((0.0, 0.0, 5.0)),))
    frame = snapshot(catalogue(), (3, 0.0, 0.0, 0.4))
    with pytest.raises(
        ValueError, match=r"object 0 has a box of .*simulate and render with the same bodies"
    ):
        renderer.render(Snapshot(frame.objects, np.array([4])))
    sensor = camera((0.0, 0.0, 1.0))
    boxes = np.array([[20.0, 0, 1, 2, 2, 2, 0], [-20, 0, 1, 2, 2, 2, 0], [5, 40, 1, 2, 2, 2, 0]])
    found = sensor.model.windows(transform(invert(sensor.pose), corners(boxes)))
    assert found[:, 0].tolist() == [0]
    _, top, bottom, left, right = found[0]
    assert (bottom - top) * (right - left) < 60


@pytest.mark.parametrize("seed", range(2))
def test_what_sticks_out_of_a_box_is_seen_as_if_everything_was_cast_at_once(seed):
    """Wide mirrors, on one side only too, that reach out of the boxes by which rays are chosen."""
    rng = np.random.default_rng(seed)
    wing = make_boxed_body(
        "wing", VEHICLE, box((4.0, 1.6, 1.5)), box((0.3, 3.0, 0.3), (1.5, 2.3, 0.4))
    )
    bodies = (wing, *fleet_named("own").bodies(1, rng))
    rows = [(0, 3.0, 2.0, 0.7), (0, -4.0, -6.0, -2.5)]
    rows += [
        (int(rng.integers(len(bodies))), *rng.uniform(AREA[:2], AREA[2:]), rng.uniform(-4, 4))
        for _ in range(14)
    ]
    frame = snapshot(bodies, *rows)
    sensors = (
        camera((-25.0, 3.0, 5.0), 0.1, 0.15, DepthCamera(200, 150, 1)),
        camera((0.0, 0.0, 9.0), 2.0, 1.4, DepthCamera(160, 120, 1, fov=2.0)),
        lidar((2.0, -3.0, 3.0), 1.0, channels=32),
    )
    renderer = Renderer(FLAT, catalogue(), sensors).with_bodies(bodies)
    rendered, out = renderer.render(frame), 0
    for sensor, depth, hits in zip(sensors, *rendered, strict=True):
        whole, ids = everything_at_once(FLAT, bodies, frame, sensor)
        assert np.isclose(depth, whole, atol=2e-3).mean() > 0.9997
        assert (hits == ids).mean() > 0.9997
        rays = (sensor.model.rays() * depth[..., None])[hits == 0].astype(np.float64)
        x, y, z, *_, yaw = frame.objects.boxes[0]
        in_body = transform(invert(pose(x, y, z, yaw=yaw)) @ sensor.pose, rays)
        out += int((in_body[:, 1] > 0.81).sum())
    assert out > 50
    rays = SensorRays(renderer, sensors)
    seen = rays.silhouette(0, frame.objects.boxes[0]).points
    assert (
        transform(invert(pose(x, y, z, yaw=yaw)), seen.astype(np.float64))[:, 1] > 0.81
    ).sum() >= out


def test_only_so_many_scenes_are_kept():
    bodies = catalogue()[:4]
    renderer = Renderer(FLAT, bodies, (camera((-10.0, 0.0, 5.0), 0.0, 0.2),))
    frame = snapshot(bodies, *((k, 4.0 * k, 0.0, 0.3) for k in range(4)))
    first = renderer.render(frame)
    module.body_scene.cache_clear()
    again = renderer.render(frame)
    assert module.body_scene.cache_info()[1:] == (4, 400, 4)
    assert np.array_equal(first.hits[0], again.hits[0])


def test_what_stands_still_hides_what_ends_behind_it():
    wall = Solid(np.array([[4.0, -6], [4.4, -6], [4.4, 6], [4, 6]]), 0.0, 4.0)
    renderer = Renderer(
        Site("walled", np.array([-20.0, -20, 20, 20]), solids=(wall,)), (), (), threads=1
    )
    ways = np.array(
        [
            *([0, 0, 1, 3.9, 0, 0], [0, 0, 1, 4.1, 0, 0], [0, 0, 6, 9, 0, -1], [0, 0, 6, 9, 0, -5]),
            *([0, 0, 1, 0, 0, -0.5], [0, 0, 1, 0, 0, -1.5]),
        ],
        np.float32,
    )
    assert renderer.still_hides(ways).tolist() == [False, True, False, True, False, True]
    rng = np.random.default_rng(0)
    ways = np.column_stack([np.tile([0.0, 0, 3], (500, 1)), rng.uniform(-9, 9, (500, 3))]).astype(
        np.float32
    )
    np.testing.assert_array_equal(renderer.still_hides(ways), renderer.cast_still(ways) <= 1)


CAR = make_body("car", VEHICLE, *box((4.0, 2.0, 1.5)))
MIRRORED = make_boxed_body(
    "mirrored", VEHICLE, box((4.0, 2.0, 1.5)), box((0.2, 0.4, 0.2), (1.0, 1.2, 0.2))
)
BEHIND = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0], [10.0, 0, 0.75, 4, 2, 1.5, np.pi / 2]])


def lines(starts, ways):
    return np.concatenate([starts, ways], axis=1).astype(np.float32)


def test_moments_meet_lines():
    moment = Moment((CAR, CAR), BEHIND, threads=1)
    starts = np.array([[-10.0, 0, 0.7], [20, 0, 0.7], [0, 9, 0.7], [10, 9, 0.7]])
    met, length = moment.met(
        lines(starts, np.array([[1.0, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0]]))
    )
    assert met.tolist() == [0, 1, -1, 1]
    np.testing.assert_allclose(length[[0, 1, 3]], [8.0, 4.5, 7.0], atol=1e-5)
    assert np.isinf(length[2])


def test_an_empty_moment_meets_nothing():
    moment = Moment((), np.zeros((0, 7)), threads=1)
    assert len(moment) == 0
    met, length = moment.met(lines(np.zeros((2, 3)), np.ones((2, 3))))
    assert met.tolist() == [-1, -1]
    assert np.isinf(length).all()
    assert moment.ground.points.shape == (0, 2)


def test_bodies_cover_the_ground_below_them():
    turned = np.array([[5.0, 6.0, 0.75, 4, 2, 1.5, np.pi / 2]])
    for body, across in ((CAR, (-1.0, 1.0)), (MIRRORED, (-1.0, 1.4))):
        ground = Moment((body,), turned).ground
        x, y = ground.points.T
        assert (x.min(), x.max()) == pytest.approx((5 - across[1], 5 - across[0]))
        assert (y.min(), y.max()) == pytest.approx((4.0, 8.0))
        assert (ground.low[0], ground.high[0]) == pytest.approx((0.0, 1.5))
        assert ground.first.tolist() == [0, len(x)]
        middle = 5 - sum(across) / 2
        np.testing.assert_allclose(
            ground.rectangles[0], [middle, 6, 2, np.ptp(across) / 2, 0, 1], atol=1e-6
        )


def test_it_shows_what_the_renderer_draws():
    site, bodies = Site("plain", np.array([-30.0, -20, 30, 20])), catalogue()
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(bodies), size=12)
    cells = rng.permutation(20)[:12]
    sizes = np.array([bodies[b].size for b in chosen])
    xy = np.column_stack([cells % 5 - 2, cells // 5 - 1.5]) * [12.0, 11.0]
    boxes = np.column_stack([xy, sizes[:, 2] / 2, sizes, rng.uniform(-3, 3, 12)])
    snapshot = Snapshot(Objects(boxes, np.array([bodies[b].label for b in chosen])), chosen)
    sensor = Sensor(
        "camera", DepthCamera(width=320, height=240), look((-28.0, -16.0, 6.0), 0.5, 0.2)
    )
    renderer = Renderer(site, bodies, [sensor], threads=1)
    measured, hits = renderer.render(snapshot)
    rays = sensor.world_rays.T
    met, length = renderer.moment(snapshot).met(
        lines(np.broadcast_to(sensor.position, rays.shape), rays)
    )
    drawn = hits[0].ravel()
    seen = drawn >= 0
    assert seen.sum() > 300
    assert (met[seen] != drawn[seen]).mean() < 0.002
    same = seen & (met == drawn)
    np.testing.assert_allclose(length[same], measured[0].ravel()[same], atol=1e-3)
    with pytest.raises(ValueError, match="simulate and render with the same bodies"):
        renderer.moment(Snapshot(Objects(boxes + np.eye(7)[3], snapshot.objects.labels), chosen))


def test_on_a_slope_it_is_what_the_renderer_shows():
    steep = Site("steep", np.array([-30.0, -30, 30, 30]), relief=Relief(0.0, 0, (0.06, -0.04)))
    eye = Sensor(
        "eye", DepthCamera(width=160, height=120, stride=1), look((-14.0, 2.0, 5.0), 0.0, 0.2)
    )
    boxes = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0.3], [6.0, 3, 1.0, 4, 2, 1.5, 2.0]])
    renderer = Renderer(steep, (CAR,), (eye,), threads=1)
    frame = Snapshot(Objects(boxes, np.full(2, VEHICLE)), np.zeros(2, np.int64))
    depth, hits = (images[0].ravel() for images in renderer.render(frame))
    moment, rays = renderer.moment(frame), eye.world_rays.T
    met, length = moment.met(lines(np.broadcast_to(eye.position, rays.shape), rays))
    shown = hits >= 0
    assert shown.sum() > 300
    assert (met[shown] == hits[shown]).mean() > 0.995
    np.testing.assert_allclose(np.median(np.abs(length[shown] - depth[shown])), 0.0, atol=1e-4)
    points = rays[shown] * length[shown, None] + eye.position
    low, high = moment.ground.low[met[shown]], moment.ground.high[met[shown]]
    assert ((points[:, 2] > low - 1e-3) & (points[:, 2] < high + 1e-3)).all()


WALL = box((0.2, 4.0, 3.0), (5.0, 0.0, 1.5))


def test_walls_hide_what_lines_lead_to_unless_near():
    rng = np.random.default_rng(3)
    start, ends = np.array([0.0, 0.3, 2.0]), rng.uniform((6, -9, 0), (20, 9, 4), (4000, 3))
    share = (4.9 - start[0]) / (ends[:, 0] - start[0])  # of the way to the face, and to the back
    hidden = np.zeros(len(ends), bool)
    for s in (share, (5.1 - start[0]) / (ends[:, 0] - start[0])):
        _, y, z = (start + s[:, None] * (ends - start)).T
        hidden |= (np.abs(y) < 2) & (z > 0) & (z < 3)
    y0, y1 = ((start + s[:, None] * (ends - start))[:, 1] for s in (share, 5.1 / ends[:, 0]))
    # not through a narrow end
    sure = (np.minimum(abs(y0), abs(y1)) > 2) == (np.maximum(abs(y0), abs(y1)) > 2)
    assert 0.1 < hidden.mean() < 0.9
    assert np.array_equal(SightLines(WALL, threads=1).clear(start, ends)[sure], ~hidden[sure])
    own_post = box((0.1, 0.1, 6.0), (0.1, 0.0, 0.0))
    ends = np.array([[4.0, 0.0, 1.0], [9.0, 0.0, 1.0]])
    assert SightLines(merge([own_post, WALL])).clear(np.array([0.0, 0, 1]), ends).tolist() == [
        True,
        False,
    ]
    face = np.array([[4.9, 0.0, 1.0], [4.9 + GRAZE / 2, 0, 1], [4.9 + 3 * GRAZE, 0, 1]])
    assert SightLines(WALL).clear(np.array([0.0, 0, 1]), face).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("distance", "seen"), [(0.0, False), (NEAR - 0.01, False), (NEAR + 0.01, True), (4.0, True)]
)
def test_nothing_nearer_than_a_sensor_measures_is_seen(distance, seen):
    assert SightLines(WALL).clear(np.zeros(3), np.array([[distance, 0.0, 0.0]])).tolist() == [seen]
