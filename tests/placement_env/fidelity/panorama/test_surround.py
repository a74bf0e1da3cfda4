"""Strips of one place: packed finely enough, and only those ahead of a sensor are looked at."""

import numpy as np
import pytest

from placement_env.fidelity.panorama.ray_table import AZIMUTHS, PER_TURN, RayTable
from placement_env.fidelity.panorama.still import Still
from placement_env.fidelity.panorama.surround import FINENESS, Packed, ScoredItems, Surround
from toolkit.rendering.strips import BEYOND, OUTSIDE, WITHIN, Strips
from toolkit.sensors.models import DepthCamera, SpinningLidar

CAMERA, LIDAR = DepthCamera(width=200, height=150), SpinningLidar(channels=32, azimuth_step=0.02)
ITEMS = 40


@pytest.fixture(scope="module")
def strips():
    rng = np.random.default_rng(0)
    start, low = rng.uniform(-2 * np.pi, np.pi, 600), rng.uniform(-1.0, 0.1, 600)
    angles = (start, start + rng.uniform(0.003, 0.1, 600), low, low + rng.uniform(0.002, 0.2, 600))
    item, shows = rng.integers(ITEMS, size=600), rng.choice([OUTSIDE, WITHIN, BEYOND], 600)
    left, right, bottom, top = (each.astype(np.float32) for each in angles)
    return Strips(np.zeros(600, np.int32), item.astype(np.int32), left, right, bottom, top, shows.astype(np.int32))


@pytest.fixture(scope="module")
def scored():
    place = np.concatenate([np.arange(30), np.full(10, 30)])  # the last ten objects do not count
    return ScoredItems(place, np.arange(ITEMS) % 3, 30, 3)


def still(sent, far):
    shape = (1, 240, 640)
    return Still(np.full(shape, sent, np.uint8), np.full(shape, far, np.uint8))


def test_packing_keeps_angles_and_sorts_by_azimuth(strips):
    packed = Packed.of(strips)
    assert all(each.dtype == np.uint16 for each in packed[:4])
    assert (np.diff(packed.left.astype(int)) >= 0).all()
    assert packed.left.max() < AZIMUTHS * FINENESS
    left = (strips.left + np.pi) % (2 * np.pi) * PER_TURN * FINENESS
    order = np.argsort(np.rint(left) % (AZIMUTHS * FINENESS), kind="stable")
    np.testing.assert_allclose(packed.left, left[order] % (AZIMUTHS * FINENESS), atol=0.6)
    np.testing.assert_array_equal(packed.item, strips.item[order])
    np.testing.assert_array_equal(packed.shows, strips.shows[order])
    np.testing.assert_allclose(packed.width, ((strips.right - strips.left) * PER_TURN * FINENESS)[order], atol=1.1)
    np.testing.assert_allclose(packed.high / FINENESS * np.pi / 3600 - np.pi / 2, strips.top[order], atol=1e-4)
    np.testing.assert_allclose(packed.low / FINENESS * np.pi / 3600 - np.pi / 2, strips.bottom[order], atol=1e-4)


@pytest.mark.parametrize("model", [CAMERA, LIDAR], ids=["camera", "lidar"])
@pytest.mark.parametrize("more", [0.0, 8.0])
def test_what_is_ahead_is_all_that_is_seen(strips, scored, model, more):
    around = Surround.of(Packed.of(strips), scored, {model: still(100, 50)})
    table, seen_any = RayTable(model, 0.3, 0.0), 0
    for heading in (-3.1, -1.0, 0.0, 2.0, 3.1):
        place = float(np.float32(heading * PER_TURN))
        points, sent, far = around.seen(model, table, place, more, scored)
        held, rays = table.counts(around.rectangles, np.float32(place), np.float32(more))
        np.testing.assert_array_equal(points, np.bincount(around.item[held], rays, 31)[:30])
        frame, shows = around.frame[held], Packed.of(strips).shows[held]
        everything = float(np.prod(model.shape))
        added = np.bincount(frame, rays * ((shows >= WITHIN) - 0.4), 3)
        np.testing.assert_allclose(sent, everything * 0.4 + added, rtol=1e-5)
        added = np.bincount(frame, rays * ((shows == BEYOND) - 0.2), 3)
        np.testing.assert_allclose(far, everything * 0.2 + added, rtol=1e-5, atol=1e-2)
        seen_any += points.sum() > 0
        pieces = around._ahead(table, place)
        assert sum(each.stop - each.start for each in pieces) <= 600
        if model is CAMERA:
            assert sum(each.stop - each.start for each in pieces) < 400
    assert seen_any == 5


def test_what_is_outside_or_not_scored_counts_for_nobody(strips, scored):
    around = Surround.of(Packed.of(strips), scored, {LIDAR: still(0, 0)})
    packed = Packed.of(strips)
    nobody = (packed.shows == OUTSIDE) | (packed.item >= 30)
    np.testing.assert_array_equal(around.item == 30, nobody)
    np.testing.assert_array_equal(around.frame, packed.item % 3)
    assert around.widest == pytest.approx(0.1 * PER_TURN, rel=0.02)
