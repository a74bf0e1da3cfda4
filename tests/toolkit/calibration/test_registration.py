"""A sensor is registered against the surface of a site, a cloud or other sensors' empty scenes."""

import numpy as np
import pytest

from toolkit.calibration import reference_surface, registration
from toolkit.calibration.empty_scene import EmptyScene
from toolkit.calibration.motions import LEVER_M, apply_motion, motion_between, resistance
from toolkit.calibration.reference_surface import (
    SURFACE_SPACING_M,
    Surface,
    cloud_surface,
    scene_points,
    site_surface,
    thin_rows,
)
from toolkit.calibration.registration import LinearSystem, register, tukey_weight
from toolkit.geometry import invert, look, pose, transform
from toolkit.sensors.error_terms import make_rotation
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site, save_site
from toolkit.sites.site import Site, Solid


def plane(rng, origin, one, two, count):
    """Points on a parallelogram, and its normal for each."""
    one, two = np.array(one, float), np.array(two, float)
    points = np.array(origin) + rng.random((count, 1)) * one + rng.random((count, 1)) * two
    normal = np.cross(one, two)
    return points, np.tile(normal / np.linalg.norm(normal), (count, 1))


def surface_of(*planes):
    points, normals = (np.concatenate(parts) for parts in zip(*planes, strict=True))
    return Surface(points, normals, np.zeros(len(points)))


def corner(rng, count=4000):
    """Ground, and two walls at a corner."""
    return surface_of(
        plane(rng, [-10, -10, 0], [30, 0, 0], [0, 30, 0], 4 * count),
        plane(rng, [-10, 20, 0], [30, 0, 0], [0, 0, 6], count),
        plane(rng, [20, -10, 0], [0, 30, 0], [0, 0, 6], count),
    )


def off(deg, metres, rng):
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = make_rotation(np.deg2rad(deg) * axis), metres * way
    return error


def turned(a, b):
    return np.rad2deg(np.linalg.norm((a[:3, :3] @ b[:3, :3].T - np.eye(3)).ravel()) / np.sqrt(2))


TRUE = look((0.0, 0.0, 5.0), heading=0.7, tilt=0.3)


@pytest.mark.parametrize(("deg", "metres"), [(1.0, 0.1), (3.0, 0.22), (5.0, 0.5)])
def test_a_crooked_sensor_is_put_right(deg, metres):
    rng = np.random.default_rng(0)
    reference, seen = corner(rng), corner(rng, 1500)
    points = transform(invert(TRUE), seen.points) + 0.01 * rng.standard_normal(seen.points.shape)
    found = register(points, reference, TRUE @ off(deg, metres, rng))
    assert turned(found.pose, TRUE) < 0.02
    assert np.linalg.norm(found.pose[:3, 3] - TRUE[:3, 3]) < 0.005
    assert len(found.unobserved) == 0
    assert found.overlap > 0.4
    assert found.scatter < 0.02
    assert np.isfinite(found.deviations).all()
    assert (found.deviations[3:] < 0.01).all()


def test_planes_and_walls_leave_moves_along_them_as_believed():
    rng = np.random.default_rng(1)
    ground = surface_of(plane(rng, [-20, -20, 0], [40, 0, 0], [0, 40, 0], 20000))
    true = pose(1.0, 2.0, 5.0, yaw=0.4)
    points = transform(invert(true), ground.points[::5]) + 0.01 * rng.standard_normal((4000, 3))
    found = register(points, ground, pose(1.0, 2.0, 5.2, yaw=0.4, pitch=0.02, roll=-0.01))
    assert len(found.unobserved) == 3
    hidden = np.abs(found.unobserved).max(axis=0)
    assert hidden[[0, 1, 5]].max() < 0.05
    assert hidden[[2, 3, 4]].min() > 0.5
    assert np.isinf(found.deviations).tolist() == [False, False, True, True, True, False]
    assert found.pose[2, 3] == pytest.approx(5.0, abs=0.005)
    assert turned(found.pose, true) < 0.1
    assert np.abs(found.pose[:2, 3] - [1.0, 2.0]).max() < 0.03
    rng = np.random.default_rng(2)
    street = surface_of(
        plane(rng, [-20, -5, 0], [40, 0, 0], [0, 15, 0], 12000),
        plane(rng, [-20, 10, 0], [40, 0, 0], [0, 0, 6], 6000),
    )
    points = transform(invert(TRUE), street.points[::4])
    found = register(points, street, TRUE @ off(0.5, 0.05, rng))
    assert len(found.unobserved) == 1
    np.testing.assert_allclose(np.abs(found.unobserved[0]), [0, 0, 0, 1, 0, 0], atol=0.05)
    assert found.pose[1, 3] == pytest.approx(0.0, abs=0.01)


def test_strangers_noise_and_distance_do_not_pull():
    """Two in five points lie on parked cars that the reference does not have."""
    rng = np.random.default_rng(3)
    reference, seen = corner(rng), corner(rng, 1000)
    cars = rng.uniform([0, 0, 0.1], [12, 12, 1.6], (4000, 3))
    points = transform(invert(TRUE), np.concatenate([seen.points, cars]))
    found = register(points, reference, TRUE @ off(1.0, 0.1, rng))
    assert turned(found.pose, TRUE) < 0.05
    assert np.linalg.norm(found.pose[:3, 3] - TRUE[:3, 3]) < 0.02
    rng = np.random.default_rng(4)
    reference, seen = corner(rng), corner(rng, 1000)
    world = seen.points.copy()
    far = world[:, 0] > 12
    world[far] += 0.08 * rng.standard_normal((int(far.sum()), 3)) + np.array([[0.06, 0, 0.06]])
    points = transform(invert(TRUE), world)
    equal = register(points, reference, TRUE)
    weighed = register(points, reference, TRUE, deviation=np.where(far, 0.3, 0.01))
    error = [np.linalg.norm(each.pose[:3, 3] - TRUE[:3, 3]) for each in (equal, weighed)]
    assert error[1] < error[0]
    rng = np.random.default_rng(6)
    reference = corner(rng, 500)
    with pytest.raises(
        ValueError, match=r"0 of \d+ points lie within 3 m of the reference, 50 are needed"
    ):
        register(rng.uniform(400, 410, (500, 3)), reference, np.eye(4))
    with pytest.raises(ValueError, match="0 of 0 points"):
        register(np.zeros((0, 3)), reference, np.eye(4))


def test_what_is_found_moves_with_the_world_by_the_derivative():
    rng = np.random.default_rng(5)
    reference, seen = corner(rng), corner(rng, 1000)
    points, believed = transform(invert(TRUE), seen.points), TRUE @ off(1.0, 0.1, rng)
    motion = pose(30.0, -12.0, 4.0, yaw=0.5)
    moved_surface = Surface(
        transform(motion, reference.points),
        reference.normals @ motion[:3, :3].T,
        reference.roughness,
    )
    one, other = (
        register(points, reference, believed),
        register(points, moved_surface, motion @ believed),
    )
    np.testing.assert_allclose(other.pose, motion @ one.pose, atol=2e-3)
    rng = np.random.default_rng(7)
    points, normals = rng.uniform(-20, 20, (40, 3)), rng.standard_normal((40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    local = transform(invert(TRUE), points)
    rows = resistance(points, TRUE[:3, 3], normals)
    for k in range(6):
        motion = np.zeros(6)
        motion[k] = 1e-6
        along = ((transform(apply_motion(TRUE, motion), local) - points) * normals).sum(axis=1)
        np.testing.assert_allclose(along / 1e-6, rows[:, k], atol=1e-4)
    after = apply_motion(np.eye(4), np.array([0, 0, 0.1, 1, 2, 3.0]))
    assert np.arctan2(after[1, 0], after[0, 0]) == pytest.approx(0.1 / LEVER_M)
    assert after[:3, 3].tolist() == [1, 2, 3]
    motion = np.array([0.3, -1.2, 0.7, 1.0, 2.0, -3.0])
    np.testing.assert_allclose(motion_between(TRUE, apply_motion(TRUE, motion)), motion, atol=1e-12)
    assert motion_between(TRUE, TRUE).tolist() == [0.0] * 6
    assert tukey_weight(np.array([0.0, 1.0, -1.0, 2.0, 3.0]), 2.0).tolist() == [
        1.0,
        0.5625,
        0.5625,
        0.0,
        0.0,
    ]
    points = np.array([[0.1, 0, 0], [0.2, 0, 0], [1.2, 0, 0], [0.3, -0.2, 0], [0.4, 0, 2.0]])
    assert thin_rows(points, 1.0).tolist() == [0, 2, 3, 4]
    assert thin_rows(points[:0], 1.0).tolist() == []


def test_a_row_of_equal_bays_does_not_catch_a_sensor_that_is_one_bay_off():
    """Walls a metre and a half apart look alike; only the right place has all of them."""
    rng = np.random.default_rng(8)
    ground = plane(rng, [-10, -10, 0], [30, 0, 0], [0, 30, 0], 12000)
    fins = [plane(rng, [x, 12, 0], [0, 2, 0], [0, 0, 3], 800) for x in np.arange(-4, 9, 1.5)]
    end = plane(rng, [9.0, 5, 0], [0, 9, 0], [0, 0, 5], 2500)
    back = plane(rng, [-10, 14.5, 0], [20, 0, 0], [0, 0, 5], 2500)
    reference = surface_of(ground, *fins, end, back)
    points = transform(
        invert(TRUE),
        reference.points[::3] + 0.005 * rng.standard_normal(reference.points[::3].shape),
    )
    turned_off = apply_motion(TRUE, np.array([0, 0, LEVER_M * np.deg2rad(5.0), 0.2, 0.1, 0.0]))
    found = register(points, reference, turned_off)
    assert turned(found.pose, TRUE) < 0.05
    assert np.linalg.norm(found.pose[:3, 3] - TRUE[:3, 3]) < 0.02


SQUARE = np.array([[0.0, 0], [6, 0], [6, 4], [0, 4]])
PLACE = Site(
    "place",
    np.array([-12.0, -12, 12, 12]),
    solids=(Solid(SQUARE, 0.0, 5.0, "container"), Solid(SQUARE - 9.0, 0.0, 6.0, "tree")),
)


def scene(depth, share=1.0, spread=0.02, frames=16):
    model = DepthCamera(width=40, height=30, stride=2)
    values = {"first": depth, "spread": spread, "share": share}
    values |= {"second": np.nan, "second_spread": 0.0, "second_share": 0.0}
    images = {name: np.full(model.shape, value, np.float32) for name, value in values.items()}
    return EmptyScene("c", model, frames=frames, **images)


def test_surfaces_of_sites_have_even_points():
    surface = site_surface(PLACE)
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1.0)
    roof = np.isclose(surface.points[:, 2], 5.0)
    assert roof.sum() == pytest.approx(24 / SURFACE_SPACING_M**2, rel=0.1)
    assert np.allclose(np.abs(surface.normals[roof]), [0, 0, 1])
    wall = np.isclose(surface.points[:, 1], 4.0) & (surface.points[:, 2] > 0.01)
    assert wall.sum() == pytest.approx(30 / SURFACE_SPACING_M**2, rel=0.1)
    assert surface.points[:, 2].max() <= 5.0 + 1e-9
    assert np.abs(surface.points[:, :2]).max() < 60.0
    assert site_surface(PLACE).points.tobytes() == surface.points.tobytes()


def test_surfaces_of_clouds_are_flat():
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-5, 5, (20000, 2)), 0.005 * rng.standard_normal(20000)])
    bush = rng.uniform([6, 6, 0.5], [8, 8, 2.5], (3000, 3))
    surface = cloud_surface(np.concatenate([ground, bush, [[np.nan, 0, 0]]]))
    flat = surface.points[:, 2] < 0.1
    assert np.abs(surface.normals[flat, 2]).mean() > 0.99
    assert (~flat).sum() < 0.2 * flat.sum()
    alone = rng.uniform(0, 100, (60, 3))
    for count, said in ((30, 30), (60, 0)):  # too few to look, and looked at
        with pytest.raises(
            ValueError, match=f"has {said} points on flat ground or walls, 50 are needed"
        ):
            cloud_surface(alone[:count])
    alone[0, 0], alone[1, 2] = np.nan, np.inf
    with pytest.raises(ValueError, match="has 49 points"):
        cloud_surface(alone[:51])


def test_points_of_scenes_are_shown_in_most_frames():
    points, deviation = scene_points(scene(8.0))
    assert points.shape == scene_points(scene(0.5))[0].shape == (300, 3)
    assert np.allclose(points[:, 2], 8.0)
    slant = np.linalg.norm(points, axis=1) / 8.0
    np.testing.assert_allclose(deviation, 0.02 * slant / 4.0, rtol=1e-5)
    assert len(scene_points(scene(0.0))[0]) == 0
    assert len(scene_points(scene(8.0, share=0.4))[0]) == 0
    assert len(scene_points(scene(8.0, share=0.4), least_share=0.3)[0]) == 300
    assert len(scene_points(scene(8.0, share=0.5))[0]) == 300  # half of the frames are enough


def test_surfaces_of_several_scenes_are_one():
    poses = [look((x, 0.0, 8.0), heading=0.0, tilt=np.pi / 2) for x in (0.0, 20.0)]
    wide = [scene(8.0), scene(8.0)]
    surface = cloud_surface(
        np.concatenate(
            [transform(pose, scene_points(each)[0]) for each, pose in zip(wide, poses, strict=True)]
        )
    )
    assert np.abs(surface.points[:, 2]).max() < 1e-4
    assert (surface.points[:, 0] < 10).any()
    assert (surface.points[:, 0] > 10).any()
    with pytest.raises(ValueError, match="50 are needed"):
        cloud_surface(np.zeros((0, 3)))


def test_it_starts_where_it_is_believed_turned_about_the_vertical(spy):
    calls = spy(registration, "align_levels")
    surface = corner(np.random.default_rng(0), 500)
    register(transform(invert(TRUE), surface.points), surface, TRUE)
    starts = [named["pose"] for _, named in calls if named["levels"] is registration.COARSE_LEVELS]
    turns = [LEVER_M * np.deg2rad(turn) for turn in (0, -2.5, 2.5, -5, 5)]
    motions = [motion_between(TRUE, start) for start in starts]
    np.testing.assert_allclose(motions, [[0, 0, turn, 0, 0, 0] for turn in turns], atol=1e-9)


def system_of(rows, residual=0.0, weight=1.0, overlap=1.0):
    rows = np.asarray(rows, float)
    residual, weight = (
        np.broadcast_to(np.asarray(each, float), len(rows)) for each in (residual, weight)
    )
    return registration.LinearSystem(rows, residual, weight, overlap, 0.01)


EYE = np.eye(6)


def test_agreement_steps_and_covariances_are_those_by_hand():
    agreeing = system_of(EYE[[5, 5, 5]], [0.0, 0.15, 0.4], overlap=0.5)
    assert agreeing.agreement == pytest.approx(
        (1 + 0.75**2) / 3 / 2
    )  # Tukey's weight of half of 0.3 m
    weight = np.array([4.0, 1.0, 2.0, 3.0])
    up = system_of(EYE[[5] * 4], [0.1, 0.2, -0.1, 0.0], weight)
    assert up.step() == pytest.approx([0, 0, 0, 0, 0, -(0.4 + 0.2 - 0.2) / 10])
    assert len(up.hidden_motions) == 5
    assert np.diag(up.covariance()) == pytest.approx([0, 0, 0, 0, 0, 9 / 10])
    turning = system_of(EYE[[0] * 4], 0.0, weight)
    assert np.diag(turning.covariance()) == pytest.approx([9 / 10 / LEVER_M**2, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("up", "along", "strength", "seen", "weight"),
    [
        *(
            (4000, 3, 1.0, True, 1.0),
            (10000, 3, 1.0, False, 1.0),
            (10000, 5, 1.0, True, 1.0),
            (9, 2, 1.0, False, 1.0),
        ),
        *((9, 100, 0.2, True, 1.0), (9, 200, 0.14, False, 1.0), (9, 100, 1.0, False, 0.0)),
    ],
)
def test_a_motion_is_observed_if_enough_points_resist_it(up, along, strength, seen, weight):
    """Two points, and four of ten thousand, are too few; less than 0.15 of a motion across the
    plane is noise."""
    rows = np.concatenate([EYE[[5] * up], strength * EYE[[3] * along]])
    system = system_of(rows, weight=np.repeat([1.0, weight], [up, along]))
    assert bool(np.abs(system.hidden_motions[:, 3]).max() < 0.5) is seen
    assert np.abs(system.hidden_motions[:, 5]).max() < 1e-9


def test_deviations_are_infinite_for_numbers_that_hidden_motions_change():
    hidden = np.array([[0.3, 0, 0.31, 0, 0, 0], [0, 0, 0, 0, -1.0, 0]])
    found = registration.Registration(np.eye(4), 4.0 * EYE, hidden, 1.0, 0.01)
    assert found.deviations.tolist() == [2, 2, np.inf, 2, np.inf, 2]
    known = registration.Registration(np.eye(4), 4.0 * EYE, np.zeros((0, 6)), 1.0, 0.01)
    assert known.deviations.tolist() == [2.0] * 6


def test_pairs_weigh_by_their_noise_roughness_and_scatter(limits):
    """Eighty points at known heights above a level grid, ten of them too far off."""
    limits(registration, MAX_LEVEL_STEPS=1)
    places = np.array([[x, y, 0.0] for x in range(10) for y in range(8)], float)
    surface = Surface(places, np.tile([0.0, 0, 1], (80, 1)), np.full(80, 0.02))
    rng = np.random.default_rng(0)
    above, noise = rng.normal(0, 0.05, 80), rng.uniform(0.01, 0.1, 80)
    above[:10], above[10] = 0.9, 0.25
    start = pose(0.0, 0.0, 0.0)
    moved, system = registration.align_levels(
        places + above[:, None] * [0, 0, 1], noise, surface, start, ((0.8, 0.01, 0.2),)
    )
    near = above[10:]
    scatter = 1.4826 * np.median(np.abs(near))
    spread = np.sqrt(noise[10:] ** 2 + 0.02**2 + scatter**2)
    limit = np.maximum(4.685 * spread, 0.2)
    assert system.residual == pytest.approx(near)
    assert system.scatter == pytest.approx(scatter)
    assert system.overlap == pytest.approx(70 / 80)
    assert system.weight == pytest.approx(
        np.clip(1 - (near / limit) ** 2, 0, None) ** 2 / spread**2
    )
    world = places[10:] + near[:, None] * [0, 0, 1]
    assert system.rows == pytest.approx(resistance(world, np.zeros(3), surface.normals[10:]))
    assert moved == pytest.approx(apply_motion(start, system.step()))
    _, wide = registration.align_levels(
        places, np.full(80, 0.001), surface, start, ((0.8, 0.01, 5.0),)
    )
    assert wide.scatter == 0.01  # no less
    assert wide.weight == pytest.approx(np.full(80, 1 / (0.001**2 + 0.02**2 + 0.01**2)))


@pytest.mark.parametrize("hidden", [False, True])
def test_starts_that_end_alike_are_one_and_of_those_as_good_the_nearest_is_taken(
    limits, monkeypatch, hidden
):
    """The starts end 0, 4, 6, 6 and 20 cm along x (and 10 along y), of which the second and fourth
    are no new ones."""
    ends, fine = iter([0.0, 0.04, 0.06, 0.06, 0.2]), []
    agreements = {0.0: 0.5, 0.06: 0.503, 0.2: 0.5035}

    rows = np.tile(EYE, (100, 1))
    rows[:, 3] *= not hidden  # no pair resists a move along x

    def system(x):
        """System whose points are all on the surface, so that its overlap is its agreement."""
        overlap = agreements.get(round(x, 6), 0.0)
        return LinearSystem(rows, np.zeros(600), np.ones(600), overlap=overlap, scatter=0.02)

    def align(points, noise, surface, *, pose, levels):
        if levels is registration.COARSE_LEVELS:
            return apply_motion(np.eye(4), np.array([0, 0, 0, next(ends), 0.1, 0])), system(0.0)
        fine.append(motion_between(np.eye(4), pose).round(6).tolist())
        return pose, system(float(pose[0, 3]))

    monkeypatch.setattr(registration, "align_levels", align)
    surface = corner(np.random.default_rng(0), 50)
    found = register(np.zeros((9, 3)), surface, np.eye(4))
    starts = [[0, 0, 0, x, 0.1, 0] for x in (0.0, 0.06, 0.2)]
    assert fine == [*starts, [0, 0, 0, 0, 0.1, 0]] if hidden else fine == starts
    assert found.pose[:2, 3] == pytest.approx([0.0 if hidden else 0.06, 0.1])
    assert (found.overlap, found.scatter) == (0.5 if hidden else 0.503, 0.02)
    ends, agreements[0.0] = iter([0.0, 0.04, 0.06, 0.06, 0.2]), 0.25
    agreements[0.06] = agreements[0.2] = 0.5
    limits(registration, MAX_AGREEMENT_LOSS=0.25)  # the believed pose is just as good
    assert register(np.zeros((9, 3)), surface, np.eye(4)).pose[0, 3] == 0.0


def test_noise_that_few_frames_show_is_no_less_than_one_frames():
    points, deviation = scene_points(scene(8.0, share=0.5, frames=1))
    np.testing.assert_allclose(deviation, 0.02 * np.linalg.norm(points, axis=1) / 8.0, rtol=1e-5)
    _, four = scene_points(scene(8.0, share=0.5, frames=8))
    np.testing.assert_allclose(four, deviation / 2, rtol=1e-5)


def test_fifty_points_are_enough_and_small_things_have_points():
    reference_surface.check_flat(50)
    with pytest.raises(ValueError, match="the reference has 49 points on flat ground"):
        reference_surface.check_flat(49)
    post = np.array([[0.0, 0], [0.6, 0], [0.6, 0.6], [0, 0.6]])
    surface = site_surface(
        Site("s", np.array([-3.0, -3, 3, 3]), solids=(Solid(post, 0.0, 0.9, "container"),))
    )
    assert np.isclose(surface.points[:, 2], 0.9).sum() == 16  # of its 0.36 m², without a remainder
    assert not surface.roughness.any()
    ground = np.abs(surface.points[:, :2]).max()
    assert ground > 20.0  # thirty metres beyond the area
    other = site_surface(Site("s", np.array([-3.0, -3, 3, 3])), seed=1)
    assert (
        other.points.tobytes()
        != site_surface(Site("s", np.array([-3.0, -3, 3, 3])), seed=0).points.tobytes()
    )
    again = site_surface(Site("s", np.array([-3.0, -3, 3, 3])))
    assert (
        again.points.tobytes()
        == site_surface(Site("s", np.array([-3.0, -3, 3, 3])), seed=0).points.tobytes()
    )


def test_a_recording_is_a_reference(monkeypatch):
    """Two cameras look down from 8 m, of which a recording tells the poses."""
    poses = [look((x, 0.0, 8.0), heading=0.0, tilt=np.pi / 2) for x in (0.0, 20.0)]
    asked = []

    class Opened:
        sensors = tuple(
            Sensor("c", DepthCamera(width=40, height=30, stride=2), pose) for pose in poses
        )

        def __init__(self, path):
            asked.append(path)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            asked.append("closed")

    def learn(recording, frames=None):
        asked.append(frames)
        return scene(8.0), scene(8.0)

    monkeypatch.setattr(reference_surface, "CoopDataset", Opened)
    monkeypatch.setattr(reference_surface, "learn_empty_scenes", learn)
    surface = reference_surface.read_surface("a.HDF5", frames=7)
    assert asked == ["a.HDF5", 7, "closed"]
    assert np.abs(surface.points[:, 2]).max() < 1e-4
    assert (surface.points[:, 0] < 10).sum() == (surface.points[:, 0] > 10).sum() > 100


def test_a_site_is_a_reference_by_name_or_file(tmp_path, fail, spy):
    site = Site("small", np.array([-3.0, -3, 3, 3]))
    save_site(site, tmp_path / "a.json")
    found = reference_surface.read_surface(tmp_path / "a.json")
    np.testing.assert_array_equal(found.points, site_surface(site).points)
    fail(reference_surface, "site_surface", KeyError("far enough"))
    calls = spy(reference_surface, "site_surface")
    with pytest.raises(KeyError, match="far enough"):
        reference_surface.read_surface("tjunction")
    assert calls[0].args[0] == load_site("tjunction")


def test_a_cloud_is_a_reference_and_other_endings_are_refused(tmp_path):
    points = grid_of(25, 25)
    header = [
        *("ply", "format ascii 1.0", f"element vertex {len(points)}"),
        *(f"property double {name}" for name in "xyz"),
        "end_header",
    ]
    np.savetxt(tmp_path / "a.ply", points, header="\n".join(header), comments="")
    found = reference_surface.read_surface(tmp_path / "a.ply")
    np.testing.assert_allclose(found.points, cloud_surface(points).points, atol=1e-9)
    (tmp_path / "a.h5x").write_bytes(b"")
    with pytest.raises(ValueError, match="h5x"):
        reference_surface.read_surface(tmp_path / "a.h5x")


def grid_of(rows, columns, noise=0.0, at=(0.0, 0.0, 0.0)):
    """Points as far apart as a surface keeps them, each off its plane."""
    places = (
        np.stack(np.meshgrid(np.arange(rows), np.arange(columns)), axis=-1).reshape(-1, 2)
        * SURFACE_SPACING_M
    )
    above = noise * np.random.default_rng(0).standard_normal(len(places))
    return np.column_stack([places, above]) + np.array(at)


@pytest.mark.parametrize(("noise", "share"), [(0.02, 1.0), (0.2, 0.0)])
def test_a_surface_is_thin_beside_its_extent(noise, share):
    """Twenty-four points 15 cm apart reach 21 cm to either side (standard deviation), of which a
    third is 7."""
    flat, slab = grid_of(25, 25), grid_of(25, 25, noise, at=(90.0, 0.0, 0.0))
    found = cloud_surface(np.concatenate([flat, slab]))
    second = found.points[:, 0] > 50
    assert (~second).sum() == 625
    assert second.mean() / (1 - second.mean()) == pytest.approx(share, abs=0.1)
    assert found.roughness[~second].max() < 1e-6
    if second.any():
        assert np.median(found.roughness[second]) == pytest.approx(noise, rel=0.3)
        assert np.abs(found.normals[second][:, 2]).mean() > 0.95


def test_a_strip_is_a_surface_and_a_wire_is_none():
    """Of three rows of points, and of one that is 2 mm thick."""
    flat, strip = grid_of(25, 25), grid_of(60, 3, at=(0.0, 90.0, 0.0))
    wire = grid_of(60, 1, at=(0.0, -90.0, 0.0)) + 0.002 * np.random.default_rng(1).standard_normal(
        (60, 3)
    )
    found = cloud_surface(np.concatenate([flat, strip, wire])).points[:, 1]
    assert (np.abs(found) < 50).sum() == 625
    assert (found > 50).sum() > 120
    assert (found < -50).sum() < 5


def grid_surface(count=80):
    places = np.array([[x, y, 0.0] for x in range(10) for y in range(8)], float)[:count]
    return places, Surface(places, np.tile([0.0, 0, 1], (count, 1)), np.zeros(count))


def test_fifty_pairs_are_enough():
    for count, enough in ((50, True), (49, False)):
        places, surface = grid_surface(count)
        given = (places, np.full(count, 0.01), surface, np.eye(4), ((0.5, 0.1, 0.2),))
        if enough:
            assert registration.align_levels(*given)[1].overlap == 1.0
        else:
            with pytest.raises(
                ValueError,
                match=r"49 of 49 points lie within 0\.5 m of the reference, 50 are needed",
            ):
                registration.align_levels(*given)


@pytest.mark.parametrize(("above", "steps"), [(4e-5, 1), (1e-4, 2), (0.1, 2)])
def test_a_level_ends_with_a_step_below_a_ten_thousandth_of_its_radius(spy, above, steps):
    """All points lie as high above a level grid, so that one step is enough, and another to see
    that."""
    calls = spy(registration, "resistance")
    places, surface = grid_surface()
    start = pose(0.0, 0.0, above)
    moved, _ = registration.align_levels(
        places, np.full(80, 0.01), surface, start, ((0.5, 0.1, 0.9),)
    )
    assert len(calls) == steps
    assert moved[2, 3] == pytest.approx(0.0, abs=1e-9)


def test_points_are_thinned_in_cubes_of_any_size():
    points = np.random.default_rng(2).uniform(-3, 5, (400, 3))
    for voxel in (0.5, 2.0):
        first: dict[tuple[int, ...], int] = {}
        for row, cube in enumerate(np.floor(points / voxel).astype(int).tolist()):
            first.setdefault(tuple(cube), row)
        assert thin_rows(points, voxel).tolist() == sorted(first.values())
