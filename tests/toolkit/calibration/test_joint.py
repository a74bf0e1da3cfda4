from functools import partial

import numpy as np
import pytest

from toolkit.calibration import alignment, joint_system, motions
from toolkit.calibration.alignment import align, face_sensor
from toolkit.calibration.joint_system import Pairs
from toolkit.calibration.motions import LEVER_M, apply_motion
from toolkit.calibration.object_pairs import SensorBoxes, detect_boxes, object_pairs
from toolkit.calibration.reference_surface import Surface
from toolkit.frame import Frame
from toolkit.geometry import invert, look, transform
from toolkit.objects import Detections, Objects
from toolkit.sensors.error_terms import make_rotation
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Relief, Site

TRUE = (
    *(
        look((-8.0, -8.0, 6.0), heading=0.7, tilt=0.4),
        look((8.0, -8.0, 6.0), heading=2.4, tilt=0.4),
    ),
    look((0.0, -9.0, 6.0), heading=1.6, tilt=0.4),
)


def plane(rng, origin, one, two, count, noise=0.005):
    one, two = np.array(one, float), np.array(two, float)
    normal = np.cross(one, two) / np.linalg.norm(np.cross(one, two))
    points = np.array(origin) + rng.random((count, 1)) * one + rng.random((count, 1)) * two
    return points + noise * rng.standard_normal((count, 1)) * normal, np.tile(normal, (count, 1))


def world(rng, walls=True):
    """Ground and two walls, drawn anew for each sensor."""
    planes = [plane(rng, [-10, -10, 0], [20, 0, 0], [0, 20, 0], 3000)]
    if walls:
        planes += [plane(rng, [-10, 10, 0], [20, 0, 0], [0, 0, 5], 1200)]
        planes += [plane(rng, [10, -10, 0], [0, 20, 0], [0, 0, 5], 1200)]
    return (np.concatenate(parts) for parts in zip(*planes, strict=True))


def seen_by(pose, rng, walls=True):
    points, normals = world(rng, walls)
    local = Surface(
        transform(invert(pose), points), normals @ pose[:3, :3], np.full(len(points), 0.005)
    )
    return face_sensor(local)


def off(pose, rng, deg=1.0, metres=0.1):
    axis, way = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
    error = np.eye(4)
    error[:3, :3], error[:3, 3] = make_rotation(np.deg2rad(deg) * axis), metres * way
    return pose @ error


def apart(found, true):
    between = invert(true) @ found
    return np.rad2deg(np.linalg.norm(between[:3, :3] - np.eye(3)) / np.sqrt(2)), np.linalg.norm(
        between[:3, 3]
    )


def test_sensors_are_fitted_to_the_one_held():
    rng = np.random.default_rng(0)
    surfaces = [seen_by(pose, rng) for pose in TRUE]
    found = align(surfaces, [TRUE[0], off(TRUE[1], rng), off(TRUE[2], rng)], held=[0])
    assert found.poses[0].tobytes() == TRUE[0].tobytes()
    for pose, true in zip(found.poses[1:], TRUE[1:], strict=True):
        turned, moved = apart(pose, true)
        assert turned < 0.05
        assert moved < 0.02
    assert len(found.unobserved) == 0
    assert np.all(np.diag(found.covariance)[:6] == 0.0)
    assert (np.diag(found.covariance)[6:] > 0.0).all()
    assert found.shared[0, 1] > 100
    assert (found.shared == found.shared.T).all()
    assert (found.scatter < 0.03).all()


def test_motions_along_bare_ground_are_hidden():
    rng = np.random.default_rng(2)
    surfaces = [seen_by(pose, rng, walls=False) for pose in TRUE]
    found = align(surfaces, [TRUE[0], off(TRUE[1], rng, 0.3, 0.03), TRUE[2]], held=[0])
    assert len(found.unobserved) == 6
    hidden = found.hidden_motions(1)
    assert len(hidden) == 3
    assert np.abs(hidden[:, [0, 1, 5]]).max() < 0.1
    assert len(found.hidden_motions(0)) == 0


def test_a_sensor_out_of_reach_stays():
    rng = np.random.default_rng(3)
    far = TRUE[2].copy()
    far[0, 3] += 500.0
    found = align(
        [seen_by(TRUE[0], rng), seen_by(TRUE[1], rng), seen_by(TRUE[2], rng)],
        [*TRUE[:2], far],
        held=[0],
    )
    assert len(found.hidden_motions(2)) == 6
    assert found.poses[2].tobytes() == far.tobytes()
    assert found.shared[2].sum() == 0


def test_common_poses_and_thin_walls():
    rng = np.random.default_rng(1)
    surfaces = [seen_by(pose, rng) for pose in TRUE]
    believed = [off(pose, rng) for pose in TRUE]
    found = align(surfaces, believed)
    for k in (1, 2):
        relative = invert(found.poses[0]) @ found.poses[k]
        turned, moved = apart(relative, invert(TRUE[0]) @ TRUE[k])
        assert turned < 0.05
        assert moved < 0.02
    moved_by = np.mean(
        [pose[:3, 3] - wrong[:3, 3] for pose, wrong in zip(found.poses, believed, strict=True)],
        axis=0,
    )
    assert np.linalg.norm(moved_by) < 0.05
    assert len(found.unobserved) == 0
    rng = np.random.default_rng(4)
    planes = [plane(rng, [-10, -10, 0], [20, 0, 0], [0, 20, 0], 3000)]
    front = [*planes, plane(rng, [-10, 0.0, 0], [20, 0, 0], [0, 0, 4], 2000)]
    back = [*planes, plane(rng, [-10, 0.3, 0], [20, 0, 0], [0, 0, 4], 2000)]
    poses = [
        look((0.0, -8.0, 6.0), heading=1.57, tilt=0.4),
        look((0.0, 8.0, 6.0), heading=-1.57, tilt=0.4),
    ]
    surfaces = []
    for pose, side in zip(poses, (front, back), strict=True):
        points, normals = (np.concatenate(parts) for parts in zip(*side, strict=True))
        local = Surface(
            transform(invert(pose), points), normals @ pose[:3, :3], np.full(len(points), 0.005)
        )
        surfaces.append(face_sensor(local))
    found = align(surfaces, poses, held=[0])
    assert np.abs(found.poses[1][:2, 3] - poses[1][:2, 3]).max() < 0.02
    ahead = Surface(
        np.array([[0.0, 0, 5], [0, 0, 5]]), np.array([[0.0, 0, 1], [0, 0, -1]]), np.zeros(2)
    )
    assert face_sensor(ahead).normals[:, 2].tolist() == [-1.0, -1.0]
    near = Surface(
        np.array([[0.0, 0, 0.5], [1, 0, 0]]), np.array([[0.0, 0, 1], [0, 0, 1]]), np.zeros(2)
    )
    assert face_sensor(near).normals[:, 2].tolist() == [-1.0, 1.0]  # one that is seen edge on stays
    surface = seen_by(TRUE[0], np.random.default_rng(6))
    with pytest.raises(ValueError, match="got 1 surfaces and 1 poses"):
        align([surface], [TRUE[0]])
    with pytest.raises(ValueError, match="got 2 surfaces and 1 poses"):
        align([surface] * 2, TRUE[:1])
    for held in ([2], [0, 2], [-1]):
        with pytest.raises(
            ValueError, match=rf"held must be sensor numbers from 0 to 1, got \[{held[0]}"
        ):
            align([surface] * 2, TRUE[:2], held=held)


def test_more_pairs_say_what_the_scene_does_not():
    """Points that both sensors see at once fix the moves along a bare plane."""
    rng = np.random.default_rng(5)
    surfaces = [seen_by(pose, rng, walls=False) for pose in TRUE[:2]]
    marks = rng.uniform(-8, 8, (80, 3)) * [1, 1, 0.1]
    local = [transform(invert(pose), marks) for pose in TRUE[:2]]

    def more(poses, radius):
        here, there = (transform(pose, points) for pose, points in zip(poses, local, strict=True))
        rows = []
        for axis in np.eye(3):
            normals = np.tile(axis, (80, 1))
            turn = [
                np.cross(at - pose[:3, 3], normals) / LEVER_M
                for at, pose in zip((here, there), poses, strict=True)
            ]
            rows.append(
                (
                    np.hstack([turn[0], normals]),
                    -np.hstack([turn[1], normals]),
                    (here - there) @ axis,
                )
            )
        one, other, residual = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        return [Pairs(0, 1, one, other, residual, np.full(240, 0.01), np.full(240, 1.0))]

    found = align(surfaces, [TRUE[0], off(TRUE[1], rng, 0.5, 0.05)], held=[0], more=more)
    assert len(found.unobserved) == 0
    turned, moved = apart(found.poses[1], TRUE[1])
    assert turned < 0.05
    assert moved < 0.02


def test_pairs_as_sure_as_the_usual_errors_move_a_sensor_half_the_way():
    """A Gaussian prior at the believed pose and one measurement of the same spread: their mean,
    half the variance."""
    rng, far = np.random.default_rng(7), np.eye(4)
    far[0, 3] = 500.0
    surface = seen_by(TRUE[0], rng)
    usual = np.repeat([LEVER_M * joint_system.USUAL_TURN_RAD, joint_system.USUAL_MOVE_M], 3)
    target = 0.2 * usual * [1, -1, 1, 1, 1, -1]

    def more(poses, radius):
        residual = motions.motion_between(far, poses[1]) - target
        rows, ten = np.repeat(np.eye(6), 10, axis=0), np.repeat(usual, 10) * np.sqrt(10)
        return [
            Pairs(0, 1, np.zeros((60, 6)), rows, np.repeat(residual, 10), ten, np.full(60, 1e6))
        ]

    found = align([surface, surface], [np.eye(4), far], held=[0], more=more)
    assert found.shared[0, 1] == 60
    assert motions.motion_between(far, found.poses[1]) == pytest.approx(
        target / 2, abs=1e-3 * usual.max()
    )
    variance = np.repeat([joint_system.USUAL_TURN_RAD**2, joint_system.USUAL_MOVE_M**2], 3) / 2
    assert np.diag(found.covariance)[6:] == pytest.approx(variance, rel=1e-3)


def test_neighbouring_points_err_alike():
    """Nine points weigh as one alone, so a plane of N points gives its distance to no better than 9
    deviations² / N."""
    rng, above = np.random.default_rng(8), look((0.0, 0.0, 6.0), heading=0.0, tilt=np.pi / 2)
    found = align([seen_by(above, rng, walls=False) for _ in range(2)], [above, above], held=[0])
    deviation2 = 2 * 0.005**2 + 0.01**2
    least = np.linalg.eigvalsh(found.covariance[9:, 9:])[0]
    assert 7 * deviation2 / found.shared[0, 1] < least < 30 * deviation2 / found.shared[0, 1]


TWO = TRUE[:2]


def cars(rng, count=6):
    x = np.linspace(-9, 9, count) + rng.uniform(-0.3, 0.3, count)
    centres = np.column_stack([x, rng.uniform(-6, 6, count), np.full(count, 0.8)])
    sizes = np.tile([4.2, 1.8, 1.5], (count, 1))
    return np.column_stack([centres, sizes, rng.uniform(-3.1, 3.1, count)])


def seen_frames(rng, frames=30, noise=0.05):
    """The same cars as seen by sensors at the true poses, each with its own noise."""
    spread = noise * np.array([1, 1, 1, 0, 0, 0, 0.2])
    truths = (cars(rng) for _ in range(frames))
    return [
        [SensorBoxes.from_boxes(each + spread * rng.standard_normal(each.shape), at) for at in TWO]
        for each in truths
    ]


def test_road_users_say_what_a_bare_plane_does_not_by_their_derivatives():
    rng = np.random.default_rng(0)
    surfaces = [seen_by(at, rng, walls=False) for at in TWO]
    motion = np.array([0.0, 0.0, LEVER_M * np.deg2rad(1.0), 0.2, -0.15, 0.0])
    believed = [TWO[0], apply_motion(TWO[1], motion)]
    alone = align(surfaces, believed, held=[0])
    assert len(alone.hidden_motions(1)) == 3
    found = align(surfaces, believed, held=[0], more=partial(object_pairs, seen_frames(rng)))
    assert len(found.unobserved) == 0
    assert np.abs(found.poses[1][:2, 3] - TWO[1][:2, 3]).max() < 0.03
    heading = [np.arctan2(at[1, 2], at[0, 2]) for at in (found.poses[1], TWO[1])]
    assert np.rad2deg(abs(heading[0] - heading[1])) < 0.2
    assert found.shared[0, 1] > alone.shared[0, 1]
    rng = np.random.default_rng(1)
    seen = seen_frames(rng, frames=2)
    for sensor in (0, 1):
        for number in range(6):
            motion = np.zeros(6)
            motion[number] = 1e-6
            poses = list(TWO)
            before = object_pairs(seen, poses, 1.5)[0]
            poses[sensor] = apply_motion(poses[sensor], motion)
            after = object_pairs(seen, poses, 1.5)[0]
            rows = (before.first_rows, before.second_rows)[sensor][:, number]
            centres = np.arange(len(rows)) < 36  # 12 cars, three numbers each
            np.testing.assert_allclose(
                (after.residual - before.residual)[centres] / 1e-6, rows[centres], atol=0.05
            )


def test_road_users_pair_by_nearest_and_heading():
    boxes = np.array(
        [[0.0, 0, 1, 4, 2, 1.5, 0.0], [5.0, 0, 1, 4, 2, 1.5, 0.0], [9.0, 0, 1, 4, 2, 1.5, 0.0]]
    )
    others = boxes.copy()
    others[0, :2] += [0.5, 0.2]  # a road user seen by both
    others[1, 6] = 1.2  # heads elsewhere
    others[2, 0] += 3.0  # too far away
    # near the first, but not the nearest
    others = np.concatenate([others, [[0.9, 0, 1, 4, 2, 1.5, 0.0]]])
    here = np.eye(4)
    pairs = object_pairs(
        [[SensorBoxes.from_boxes(boxes, here), SensorBoxes.from_boxes(others, here)]],
        [here, here],
        1.5,
    )
    assert len(pairs) == 1
    assert pairs[0].residual.tolist() == pytest.approx([-0.5, -0.2, 0.0, 0.0])
    assert (pairs[0].first_sensor, pairs[0].second_sensor) == (0, 1)
    box = np.array([[0.0, 0, 1, 4, 2, 1.5, 0.1]])
    round_about = box + np.array([[0, 0, 0, 0, 0, 0, np.pi - 0.05]])
    pairs = object_pairs(
        [[SensorBoxes.from_boxes(box, np.eye(4)), SensorBoxes.from_boxes(round_about, np.eye(4))]],
        [np.eye(4)] * 2,
        1.5,
    )
    assert pairs[0].residual[3] == pytest.approx(0.05)
    nothing = SensorBoxes(np.zeros((0, 3)), np.zeros((0, 3)))
    one = SensorBoxes.from_boxes(np.array([[0.0, 0, 1, 4, 2, 1.5, 0.1]]), np.eye(4))
    assert object_pairs([[one, nothing]], [np.eye(4)] * 2, 1.5) == []
    assert object_pairs([], [np.eye(4)] * 2, 1.5) == []
    sensor = Sensor(
        "c", DepthCamera(width=40, height=30), look((0.0, 0.0, 6.0), heading=0.0, tilt=np.pi / 2)
    )
    site = Site("slope", np.array([-20.0, -20, 20, 20]), relief=Relief(slope=(0.05, 0.0)))
    frame = Frame((sensor,), (np.full(sensor.model.shape, 5.0, np.float32),), Objects.empty())

    box = np.array([[2.0, 1.0, 1.0, 4.0, 2.0, 1.5, 0.3]])

    def detector(points):
        assert np.allclose(points[:, 2], 1.0 - 0.05 * points[:, 0], atol=1e-5)
        return Detections(box, np.ones(1))

    seen = detect_boxes([frame], detector, site)[0][0]
    np.testing.assert_allclose(transform(sensor.pose, seen.centres), [[2.0, 1.0, 1.1]], atol=1e-9)
    np.testing.assert_allclose(
        seen.ahead @ sensor.pose[:3, :3].T, [[np.cos(0.3), np.sin(0.3), 0.0]], atol=1e-9
    )


def joint_of(*pairs, free=None):
    return joint_system.JointSystem(
        pairs, np.ones(12, bool) if free is None else free, np.zeros(12)
    )


def rows_along(number, residuals, one=0, other=1):
    """Rows that pull two sensors together along one of their numbers. Of a residual of 1 m or more
    the weight is 0."""
    rows, ones = np.tile(np.eye(6)[number], (len(residuals), 1)), np.ones(len(residuals))
    return Pairs(one, other, rows, -rows, np.array(residuals), ones, ones)


def test_a_motion_of_two_sensors_is_observed_if_rows_that_count_resist_it():
    """Each row resists a motion of both sensors, one unit each, twice, so with 4: two rows are
    enough for 5. One row is not, with any number of others beyond their limit."""
    common = np.concatenate([np.eye(6), np.eye(6)], axis=1) / np.sqrt(2)
    system = joint_of(rows_along(0, [0.0, 0.0]), rows_along(4, [0.0] + [1.0] * 20))
    values, vectors, observed = system.modes
    assert observed.sum() == 1
    assert np.abs(vectors[:, observed][:, 0]) == pytest.approx(
        np.abs(np.eye(12)[0] + np.eye(12)[6]) / np.sqrt(2)
    )
    assert values[observed] == pytest.approx([4.0])
    hidden = system.hidden_motions(common)
    assert len(hidden) == 5
    assert np.abs(hidden[:, 0]).max() < 1e-9
    assert np.abs(hidden @ common.T).max() < 1e-9  # without those of all sensors together


def test_a_motion_of_one_sensor_is_observed_where_the_other_is_held():
    # held, the other resists alone
    one = joint_of(rows_along(0, [0.0] * 4), free=np.arange(12) >= 6)
    assert one.modes[2].sum() == 0
    for free in (np.arange(12) >= 6, np.arange(12) < 6):  # whichever is held
        six = joint_of(rows_along(0, [0.0] * 6), free=free)
        values, vectors, observed = six.modes
        assert observed.sum() == 1
        assert values == pytest.approx([0.0] * 11 + [6.0])
        assert np.abs(vectors[:, observed][:, 0]) == pytest.approx(np.eye(12)[0 if free[0] else 6])


@pytest.mark.parametrize(
    ("strength", "count", "seen"), [(0.3, 56, True), (0.3, 55, False), (0.09, 1000, False)]
)
def test_rows_that_resist_little_count_by_their_square_and_those_that_hardly_do_not_at_all(
    strength, count, seen
):
    """More than five must: with 0.3 of a motion 56 rows are 5.04. Below a tenth is the noise of
    normals."""
    for deviation in (1.0, 10.0):  # however unsure they are
        rows = strength * np.tile(np.eye(6)[3], (count, 1))
        pairs = Pairs(0, 1, rows, -rows, np.zeros(count), np.full(count, deviation), np.ones(count))
        assert joint_of(pairs, free=np.arange(12) >= 6).modes[2].sum() == seen


@pytest.mark.parametrize(("metres", "steps"), [(1e-4, 4), (1e-3, 5)])
def test_levels_end_with_a_step_below_a_ten_thousandth_of_their_radius(metres, steps):
    """Of 1.5 m at first. One step takes a sensor where sure rows want it, and each level makes one
    at least."""
    surface, far, asked = seen_by(TRUE[0], np.random.default_rng(7)), np.eye(4), []
    far[0, 3] = 500.0

    def more(poses, radius):
        asked.append(radius)
        residual = motions.motion_between(far, poses[1]) - [0, 0, 0, metres, 0, 0]
        rows, sure = np.repeat(np.eye(6), 10, axis=0), np.full(60, 1e-3)
        return [
            Pairs(0, 1, np.zeros((60, 6)), rows, np.repeat(residual, 10), sure, np.full(60, 1e6))
        ]

    found = align([surface, surface], [np.eye(4), far], held=[0], more=more)
    assert found.poses[1][0, 3] == pytest.approx(500 + metres, rel=1e-6)
    assert (len(asked), sorted(set(asked))) == (steps, [0.2, 0.35, 0.7, 1.5])


def test_surfaces_pair_by_hand(limits):
    """Sensor 1 is turned by a quarter and sees a point 3 cm above the first's, both on level
    ground."""
    turned = np.eye(4)
    turned[:2, :2], turned[:3, 3] = [[0, -1], [1, 0]], [1.0, 2.0, 0.0]
    up = np.array([[0.0, 0, 1]])
    place = np.array([[4.0, 5.0, 0.0]])
    surfaces = [
        Surface(place, up, np.array([0.03])),
        Surface(
            transform(invert(turned), place + np.array([[0.0, 0.0, 0.03]])), up, np.array([0.04])
        ),
    ]
    rows = [np.array([0])] * 2
    first, second = alignment.pair_surfaces(surfaces, rows, [np.eye(4), turned], (0.5, 0.1))
    assert [(pair.first_sensor, pair.second_sensor) for pair in (first, second)] == [(0, 1), (1, 0)]
    assert first.residual == pytest.approx([-0.03])
    assert second.residual == pytest.approx([0.03])
    deviation = np.sqrt(0.03**2 + 0.04**2 + 0.01**2)
    assert first.deviation == pytest.approx([3 * deviation])
    assert first.limit == pytest.approx([4.685 * deviation])
    assert alignment.pair_surfaces(surfaces, rows, [np.eye(4), turned], (0.5, 0.9))[
        0
    ].limit == pytest.approx([0.9])
    assert first.first_rows == pytest.approx(motions.resistance(place, np.zeros(3), up))
    assert first.second_rows == pytest.approx(
        -motions.resistance(place, np.array([1.0, 2.0, 0.0]), up)
    )
    weight = (1 - (0.03 / (4.685 * deviation)) ** 2) ** 2 / (9 * deviation**2)
    assert first.weight == pytest.approx([weight])
    down = [surfaces[0], Surface(surfaces[1].points, -up, surfaces[1].roughness)]
    assert [
        len(pair.residual)
        for pair in alignment.pair_surfaces(down, rows, [np.eye(4), turned], (0.5, 0.1))
    ] == [0, 0]
    limits(alignment, MIN_SIDE_COSINE=1.0)  # the cosine must be greater
    assert not len(
        alignment.pair_surfaces(surfaces, rows, [np.eye(4), turned], (0.5, 0.1))[0].residual
    )


def test_of_two_road_users_near_a_third_the_nearer_is_it_and_headings_turn_about_z_alone():
    own = np.array([[0.9, 0, 1, 4, 2, 1.5, 0.0], [-0.2, 0, 1, 4, 2, 1.5, 0.1]])
    theirs = np.array([[0.0, 0.0, 1, 4, 2, 1.5, 0.0]])
    (pair,) = object_pairs(
        [[SensorBoxes.from_boxes(each, np.eye(4)) for each in (own, theirs)]], [np.eye(4)] * 2, 1.5
    )
    assert pair.residual == pytest.approx([-0.2, 0.0, 0.0, 0.1])
    assert (
        pair.first_rows[3].tolist()
        == (-pair.second_rows[3]).tolist()
        == [0, 0, 1 / LEVER_M, 0, 0, 0]
    )
    assert pair.deviation == pytest.approx([0.25 * np.sqrt(2)] * 3 + [np.deg2rad(4.0) * np.sqrt(2)])
    assert pair.limit == pytest.approx([1.5] * 3 + [np.deg2rad(20.0)])
    away = SensorBoxes.from_boxes(theirs + np.eye(7)[1], np.eye(4))
    alone = SensorBoxes.from_boxes(theirs, np.eye(4))
    assert object_pairs([[alone, away]], [np.eye(4)] * 2, 1.0) == []  # as far off as the gate
    assert len(object_pairs([[alone, away]], [np.eye(4)] * 2, 1.001)) == 1
    for radius, gate in ((0.1, 0.8), (1.0, 1.0), (9.0, 1.5)):
        (pair,) = object_pairs(
            [[SensorBoxes.from_boxes(each, np.eye(4)) for each in (own, theirs)]],
            [np.eye(4)] * 2,
            radius,
        )
        assert pair.limit[0] == gate


def test_scatter_is_the_robust_spread_of_a_sensors_own_rows():
    """Of the rows of the third sensor, which sees nothing else, the median is 4 cm; one counts for
    nothing."""
    rng, far = np.random.default_rng(3), TRUE[2].copy()
    far[0, 3] += 500.0
    surfaces = [seen_by(pose, rng) for pose in TRUE]
    alone = align(surfaces, [*TRUE[:2], far], held=[0, 1, 2])
    assert alone.scatter[2] == 0.0
    assert alone.scatter[0] == alone.scatter[1] > 0.0

    def more(poses, radius):
        rows = np.zeros((4, 6))
        return [Pairs(2, 1, rows, rows, np.array([0.03, -0.04, 0.05, 9.0]), np.ones(4), np.ones(4))]

    found = align(surfaces, [*TRUE[:2], far], held=[0, 1, 2], more=more)
    assert found.scatter[2] == pytest.approx(1.4826 * 0.04)
    assert found.shared[2].tolist() == [0, 3, 0]
    assert found.shared[:, 2].tolist() == [0, 3, 0]
    assert found.shared[0, 1] == alone.shared[0, 1] > 100


def test_what_nothing_determines_stays_as_unsure_as_usual_errors():
    system = joint_of(rows_along(0, [0.0]))
    variance = np.tile(
        np.repeat([joint_system.USUAL_TURN_RAD**2, joint_system.USUAL_MOVE_M**2], 3), 2
    )
    assert np.diag(system.covariance()) == pytest.approx(variance)
    moved = joint_system.JointSystem([rows_along(0, [0.0])], np.ones(12, bool), np.arange(12.0))
    assert moved.step() == pytest.approx(-np.arange(12.0))  # back to where it was believed
    held = joint_system.JointSystem([rows_along(0, [0.0])], np.arange(12) >= 6, np.arange(12.0))
    assert held.step() == pytest.approx(np.where(np.arange(12) >= 6, -np.arange(12.0), 0.0))
