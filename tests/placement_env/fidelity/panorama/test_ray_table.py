"""Rays counted in rectangles are those that lie there."""

from typing import Any

import numpy as np
import pytest

from placement_env.fidelity import ray_table
from placement_env.fidelity.cells import CELL_COLUMNS, CELL_EDGES, cell_elevations, find_cells
from placement_env.fidelity.ray_table import Lookup, RayTable, compute_aim, get_ray_table
from placement_env.fidelity.rectangles import (
    AZIMUTHS,
    AZIMUTHS_PER_RAD,
    ELEVATIONS_PER_RAD,
    Rectangles,
)
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor

CAMERA = DepthCamera(width=120, height=90)
MODELS: list[Any] = [
    CAMERA,
    SpinningLidar(channels=16, azimuth_step=0.03),
    SolidStateLidar(rows=20, columns=60),
]


def angles(model, heading, tilt, roll=0.0):
    turn = pose(yaw=heading, pitch=tilt, roll=roll)[:3, :3] @ model.body_SE3_sensor[:3, :3]
    x, y, z = (model.rays().reshape(-1, 3) @ turn.T).T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def rectangles(rng, count):
    """With edges between places of the grid, so that no ray lies on one."""
    left = rng.integers(0, AZIMUTHS, count)
    low = rng.integers(0, 3000, count)
    places = np.stack(
        [left, left + rng.integers(1, 900, count), low, low + rng.integers(1, 600, count)]
    )
    azimuth, elevation = (
        places[:2] * 2 * np.pi / AZIMUTHS - np.pi,
        places[2:] * np.pi / 3600 - np.pi / 2,
    )
    return [each.astype(np.float32) for each in (*azimuth, *elevation)]


def counted(model, rects, heading, tilt, roll=0.0):
    azimuth, elevation = (each[:, None] for each in angles(model, heading, tilt, roll))
    left, right, bottom, top = (each.astype(np.float64) for each in rects)
    across = sum(
        (left <= azimuth + turn) & (azimuth + turn < right) for turn in (0, 2 * np.pi, 4 * np.pi)
    )
    return (across * ((bottom <= elevation) & (elevation < top))).sum(axis=0)


def whole(table, rects, heading=0.0, more=0.0):
    where, counts = table.counts(
        Rectangles.from_edges(*rects),
        np.float32(heading * AZIMUTHS_PER_RAD),
        np.float32(more * ELEVATIONS_PER_RAD),
    )
    every = np.zeros(len(rects[0]), np.int64)
    every[where] = counts
    return every


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@pytest.mark.parametrize("tilt", [0.0, 0.3, 1.2])
def test_they_are_counted(model, tilt):
    rects = rectangles(np.random.default_rng(1), 300)
    expected = counted(model, rects, 0.0, tilt)
    assert expected.max() > 50
    assert (
        np.abs(whole(RayTable(model, tilt, 0.0), rects) - expected) <= 1 + 0.01 * expected
    ).all()


def test_sensors_are_looked_up_by_tilt_and_turned_back():
    rects, table = rectangles(np.random.default_rng(2), 300), RayTable(CAMERA, 0.3, 0.2)
    heading = np.pi / 2
    expected = counted(CAMERA, rects, heading, 0.3, 0.2)
    assert (np.abs(whole(table, rects, heading) - expected) <= 1 + 0.01 * expected).all()
    every = [np.array([each], np.float32) for each in (-np.pi, np.pi, -np.pi / 2, np.pi / 2)]
    for model in MODELS:
        for heading in (0.0, 1.0, -3.0):
            assert whole(RayTable(model, 0.4, 0.0), every, heading).tolist() == [
                np.prod(model.shape)
            ]
    rects = rectangles(np.random.default_rng(3), 400)
    more = float(np.deg2rad(0.5))
    exact = whole(RayTable(CAMERA, 0.3 + more, 0.0), rects)
    near, far = (
        whole(RayTable(CAMERA, 0.3, 0.0), rects, more=more),
        whole(RayTable(CAMERA, 0.3, 0.0), rects),
    )
    assert np.abs(near - exact).mean() < 0.3 * np.abs(far - exact).mean()
    large = exact > 100
    assert np.abs(near[large] / exact[large] - 1).mean() < 0.02
    steady, tilted = (
        Lookup.from_sensor(Sensor("s", CAMERA, look((0.0, 0.0, 5.0), 0.5, np.deg2rad(tilt))))
        for tilt in (15.0, 15.4)
    )
    assert steady.table is tilted.table
    assert tuple(steady[:3]) == (CAMERA, pytest.approx(np.deg2rad(15.0)), 0.0)
    np.testing.assert_allclose(
        [steady.heading / AZIMUTHS_PER_RAD, tilted.heading / AZIMUTHS_PER_RAD], 0.5, atol=1e-5
    )
    np.testing.assert_allclose(
        [steady.extra_tilt, tilted.extra_tilt / ELEVATIONS_PER_RAD], [0, np.deg2rad(0.4)], atol=1e-5
    )


def test_rays_of_cells_are_counted_once_in_numbers_wide_enough(limits):
    azimuth, elevation = angles(CAMERA, 0.0, 0.3)
    table = RayTable(CAMERA, 0.3, 0.0)
    assert table.cell_rays.sum() == np.prod(CAMERA.shape)
    column, row = find_cells(azimuth, elevation)
    np.testing.assert_array_equal(table.cells, np.unique(column * (len(CELL_EDGES) - 1) + row))
    np.testing.assert_array_equal(
        table.cell_rays, np.unique(column * (len(CELL_EDGES) - 1) + row, return_counts=True)[1]
    )
    middle = CELL_COLUMNS // 2
    assert find_cells(np.array([0.001, -np.pi, np.pi]), np.array([-np.pi / 2, 0.0, np.pi / 2]))[
        0
    ].tolist() == [*(middle, 0, 0)]
    rows = find_cells(np.zeros(3), np.array([-np.pi / 2, cell_elevations()[200], np.pi / 2]))[1]
    assert rows.tolist() == [0, 200, len(CELL_EDGES) - 2]
    large = SolidStateLidar(rows=300, columns=300)
    every = [np.array([each], np.float32) for each in (-np.pi, np.pi, -np.pi / 2, np.pi / 2)]
    assert whole(RayTable(large, 0.0, 0.0), every).tolist() == [90_000]
    assert get_ray_table(CAMERA, 0.3, 0.0) is get_ray_table(
        DepthCamera(width=120, height=90), 0.3, 0.0
    )
    before = get_ray_table(CAMERA, 0.3, 0.0)
    limits(ray_table, MAX_TABLE_BYTES=2 * before.nbytes)
    for tilt in (0.31, 0.32, 0.33):
        get_ray_table(CAMERA, tilt, 0.0)
        assert ray_table.RAY_TABLES.nbytes <= ray_table.MAX_TABLE_BYTES
    assert get_ray_table(CAMERA, 0.3, 0.0) is not before  # dropped meanwhile
    assert compute_aim(Sensor("s", CAMERA, look((0.0, 0.0, 5.0), 0.0))).tilt == pytest.approx(0.0)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@pytest.mark.parametrize(
    ("heading", "tilt", "roll"), [(0.5, 0.2, 0.0), (-3.0, -0.1, 0.4), (2.0, np.pi / 2, 0.0)]
)
def test_an_aim_is_that_of_the_pose(model, heading, tilt, roll):
    at = pose(1.0, 2.0, 5.0, yaw=heading, pitch=tilt, roll=roll)
    aim = compute_aim(Sensor("s", model, at @ model.body_SE3_sensor))
    again = pose(1.0, 2.0, 5.0, yaw=aim.heading, pitch=aim.tilt, roll=aim.roll)
    np.testing.assert_allclose(again, at, atol=1e-6)
    if tilt < 1.5:
        assert aim == pytest.approx((heading, tilt, roll))
