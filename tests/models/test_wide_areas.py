"""Areas too large for one grid are detected in block by block, with the same boxes and little
memory."""

import numpy as np
import pytest

from models import wide_detector as module
from models.detector import VoxelNetDetector
from models.detector_loading import load_detector
from models.wide_detector import WideVoxelNetDetector
from toolkit.bodies.drawn_bodies import draw_body
from toolkit.boxes import nms
from toolkit.objects import VEHICLE


def cars(rng, low, high, count):
    """Ground and points on drawn cars."""
    parts = [
        np.column_stack(
            [rng.uniform(low, high, (count * 100, 2)), rng.normal(0.02, 0.01, count * 100)]
        )
    ]
    for _ in range(count):
        body = draw_body(VEHICLE, rng)
        corners = body.vertices[body.triangles[rng.integers(len(body.triangles), size=60)]]
        points = (corners * rng.dirichlet([1, 1, 1], 60)[:, :, None]).sum(axis=1)
        middle = np.append(rng.uniform(low, high, 2), body.size[2] / 2)
        parts.append(points + middle)
    return np.concatenate(parts).astype(np.float32)


@pytest.mark.slow
def test_blocks_find_what_one_grid_finds(limits):
    limits(module, BLOCK_CELLS=256)
    area = (-70.0, -60.0, 66.0, 70.0)
    cloud = cars(np.random.default_rng(0), -60, 60, 40)
    whole = load_detector("general", area=area)
    assert type(whole) is VoxelNetDetector
    limits(module, MAX_COLUMNS=100_000)
    wide = load_detector("general", area=area)
    assert type(wide) is WideVoxelNetDetector
    assert wide.area == whole.area
    assert wide.digest != whole.digest
    found, expected = wide(cloud), whole(cloud)
    sure = expected.boxes[expected.scores > 0.5, :3]
    assert len(sure) > 15
    apart = np.linalg.norm(sure[:, None] - found.boxes[None, :, :3], axis=2).min(axis=1)
    assert np.median(apart) < 0.001
    assert apart.max() < 0.3
    assert abs(len(found) - len(expected)) <= 2
    assert not len(wide(cloud[:0]))


def draw_car(rng, x, y):
    """Points (m) all over a drawn car with its middle at a place."""
    body = draw_body(VEHICLE, rng)
    corners = body.vertices[body.triangles[rng.integers(len(body.triangles), size=600)]]
    points = (corners * rng.dirichlet([1, 1, 1], 600)[:, :, None]).sum(axis=1)
    return (points + np.array([x, y, body.size[2] / 2])).astype(np.float32)


@pytest.fixture
def quartered(limits):
    """Detector of a square that has borders of blocks at x = 0 and y = 0, and another whole one."""
    area = (-40.0, -40.0, 40.0, 40.0)
    whole = load_detector("general", area=area)
    limits(module, MAX_COLUMNS=10_000, BLOCK_CELLS=round(40 / whole.config.voxel_size[0]))
    wide = load_detector("general", area=area)
    assert type(wide) is WideVoxelNetDetector
    return wide, whole


def test_a_car_is_found_whose_centre_is_in_a_block_without_points(quartered):
    wide, whole = quartered
    car = draw_car(np.random.default_rng(3), 0.3, 12.0)
    rear = car[car[:, 0] < -0.1]
    (expected,) = whole(rear).boxes[:, :2]
    assert expected[0] > 0.1
    (found,) = wide(rear).boxes[:, :2]
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_cars_on_a_border_are_found_once_even_if_blocks_disagree(quartered, limits):
    limits(module, MARGIN_CELLS=8)  # so narrow that each block sees another part of a car
    wide = load_detector("general", area=quartered[0].area)
    rng = np.random.default_rng(0)
    for x in np.linspace(-1.5, 1.5, 7):
        found = wide(draw_car(rng, x, 12.0))
        kept = nms(found.boxes, found.scores, wide.nms_threshold, labels=found.labels)
        assert 1 <= len(found) == len(kept)


def test_only_blocks_of_the_area_are_detected_in(quartered, spy):
    """The area ends at 40 m, nearer than a centre may be to points of its body."""
    wide, _ = quartered
    blocks = spy(module, "collate")
    assert len(wide(draw_car(np.random.default_rng(0), 35.0, 35.0))) == 1
    assert len(blocks) == 1


def test_few_points_in_a_wide_area_take_little():
    wide = load_detector("general", area=(-600.0, -580.0, 600.0, 580.0))
    cloud = cars(np.random.default_rng(1), 300, 320, 3)
    assert len(wide(cloud)) == pytest.approx(3, abs=2)
    assert wide.anchors.nbytes < 200 << 20
