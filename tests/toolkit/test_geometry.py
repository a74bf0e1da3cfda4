import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from toolkit.geometry import (
    check_pose,
    check_slope,
    invert,
    level_motion,
    level_rows,
    look,
    pose,
    tilt_rows,
    transform,
)

metre, angle = st.floats(-1000, 1000), st.floats(-10, 10)
points = arrays(np.float64, st.tuples(st.integers(0, 5), st.just(3)), elements=metre)


@st.composite
def poses(draw):
    x, y, z = (draw(metre) for _ in range(3))
    return pose(x, y, z, yaw=draw(angle), pitch=draw(angle), roll=draw(angle))


@given(poses(), poses())
def test_poses_compose_and_invert(a, b):
    for motion in (a, a @ b, invert(a)):
        check_pose(motion)
        assert np.linalg.det(motion[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(a @ invert(a), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(invert(invert(a)), a, atol=1e-9)
    np.testing.assert_allclose(invert(a @ b), invert(b) @ invert(a), atol=1e-8)


@given(poses(), points)
def test_there_and_back(motion, p):
    np.testing.assert_allclose(transform(invert(motion), transform(motion, p)), p, atol=1e-8)


@given(poses(), poses(), points)
def test_transforms_compose_and_keep_distances(a, b, p):
    np.testing.assert_allclose(transform(a @ b, p), transform(a, transform(b, p)), atol=1e-8)
    if len(p) > 1:
        np.testing.assert_allclose(
            np.linalg.norm(np.diff(transform(a, p), axis=0), axis=1),
            np.linalg.norm(np.diff(p, axis=0), axis=1),
            atol=1e-8,
        )


def test_transform_keeps_dtype_shape_and_levelled_rows():
    image = np.zeros((4, 5, 3), np.float32)
    assert transform(pose(1.0, 2.0, 3.0), image).dtype == np.float32
    assert transform(pose(1.0, 2.0, 3.0), image).shape == (4, 5, 3)
    assert transform(pose(1.0, 2.0, 3.0), np.zeros((0, 3))).shape == (0, 3)
    with pytest.raises((ValueError, TypeError)):
        transform(np.eye(4), np.zeros((3, 120)))
    rows = np.array([[10.0, 20, 3, 4], [0, 0, 1, 5], [-10, 5, 0, 6]])
    flat = level_rows(rows, (0.02, -0.05))
    np.testing.assert_allclose(flat[:, 2], [3 - 0.2 + 1.0, 1, 0.2 + 0.25])
    np.testing.assert_array_equal(flat[:, [0, 1, 3]], rows[:, [0, 1, 3]])
    np.testing.assert_allclose(tilt_rows(flat, (0.02, -0.05)), rows, atol=1e-12)
    assert level_rows(rows, (0.0, 0.0)) is rows
    assert level_rows(rows.astype(np.float32), (0.02, 0.0)).dtype == np.float32


@pytest.mark.parametrize(
    ("turn", "forward", "left", "up"),
    [
        *(
            ({}, (1, 0, 0), (0, 1, 0), (0, 0, 1)),
            ({"yaw": np.pi / 2}, (0, 1, 0), (-1, 0, 0), (0, 0, 1)),
        ),
        ({"pitch": np.pi / 2}, (0, 0, -1), (0, 1, 0), (1, 0, 0)),
        ({"roll": np.pi / 2}, (1, 0, 0), (0, 0, 1), (0, -1, 0)),
        ({"yaw": np.pi / 2, "pitch": np.pi / 2}, (0, 0, -1), (-1, 0, 0), (0, 1, 0)),
    ],
)
def test_pose_turns_axes_by_roll_then_pitch_then_yaw(turn, forward, left, up):
    np.testing.assert_allclose(pose(**turn)[:3, :3].T, [forward, left, up], atol=1e-12)


@given(metre, metre, metre, angle, st.floats(-1.5, 1.5))
def test_look_looks_along_its_heading_with_level_rows(x, y, z, heading, tilt):
    camera = look((x, y, z), heading, tilt)
    right, down, ahead = check_pose(camera)[:3, :3].T
    level = np.cos(tilt)
    np.testing.assert_allclose(
        ahead, [np.cos(heading) * level, np.sin(heading) * level, -np.sin(tilt)], atol=1e-12
    )
    np.testing.assert_allclose(right, [np.sin(heading), -np.cos(heading), 0], atol=1e-12)
    assert down[2] < 0
    np.testing.assert_allclose(camera[:3, 3], [x, y, z])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        *(
            (np.eye(3), r"shape \(4, 4\), got \(3, 3\)"),
            (np.full((4, 4), np.nan), "NaN or infinite"),
        ),
        *((pose(1.0, 2.0, 3.0).T, "pass the transpose"), (np.diag([1.0, -1, 1, 1]), "it mirrors")),
        *((np.diag([2.0, 2, 2, 1]), "determinant 8"), (np.diag([1.0, 1, 0, 1]), "determinant 0")),
    ],
)
def test_what_is_no_rigid_motion_is_refused(matrix, message):
    with pytest.raises(ValueError, match=message):
        check_pose(matrix, "extrinsic")


@given(points, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), metre, metre)
def test_levelling_is_levelled_about_a_place(p, sx, sy, x, y):
    expected = np.add(level_rows(p, (sx, sy)), [0, 0, sx * x + sy * y])
    np.testing.assert_allclose(transform(level_motion((sx, sy), (x, y)), p), expected, atol=1e-6)


@pytest.mark.parametrize("slope", [(0.3, 0.01), (np.nan, 0.0), (0.1,), (0.1, 0.1, 0.0)])
def test_a_slope_is_two_numbers_and_not_too_steep(slope):
    with pytest.raises(
        ValueError, match=r"relief\.slope must be a rise along x and along y, at most 30% together"
    ):
        check_slope(slope, "relief.slope")
    assert check_slope(np.array([0.06, -0.01]), "slope") == (0.06, -0.01)
