"""Strips of one place: only those ahead of a sensor are looked at."""

import numpy as np
import pytest

from placement_env.fidelity.ray_table import Lookup, RayTable
from placement_env.fidelity.rectangles import AZIMUTHS, AZIMUTHS_PER_RAD
from placement_env.fidelity.still import Still
from placement_env.fidelity.surround import ScoredItems, Surround
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
    return Strips(
        np.zeros(600, np.int32),
        item.astype(np.int32),
        left,
        right,
        bottom,
        top,
        shows.astype(np.int32),
    )


@pytest.fixture(scope="module")
def scored():
    place = np.concatenate([np.arange(30), np.full(10, 30)])  # the last ten objects do not count
    return ScoredItems(place, np.arange(ITEMS) % 3, 30, 3)


def sort_by_azimuth(strips):
    return np.argsort((strips.left.astype(float) + np.pi) % (2 * np.pi))


def still(sent, far):
    shape = 240 * 640
    return Still(np.full(shape, sent, np.uint8), np.full(shape, far, np.uint8))


def test_strips_are_sorted_and_only_what_is_scored_counts(strips, scored):
    around = Surround.from_strips(strips, scored, {LIDAR: still(0, 0)})
    left = around.rectangles.left
    assert (np.diff(left) >= 0).all()
    assert left[0] >= 0
    assert left[-1] <= AZIMUTHS
    np.testing.assert_allclose(
        left, np.sort((strips.left + np.pi) % (2 * np.pi)) * AZIMUTHS_PER_RAD, atol=2e-3
    )
    width = np.sort(around.rectangles.right - left)
    np.testing.assert_allclose(
        width, np.sort(strips.right - strips.left) * AZIMUTHS_PER_RAD, atol=2e-3
    )
    around = Surround.from_strips(strips, scored, {LIDAR: still(0, 0)})
    order = sort_by_azimuth(strips)
    nobody = (strips.shows[order] == OUTSIDE) | (strips.item[order] >= 30)
    np.testing.assert_array_equal(around.item == 30, nobody)
    np.testing.assert_array_equal(around.frame, strips.item[order] % 3)
    assert around.widest == pytest.approx(0.1 * AZIMUTHS_PER_RAD, rel=0.02)


@pytest.mark.parametrize("model", [CAMERA, LIDAR], ids=["camera", "lidar"])
@pytest.mark.parametrize("more", [0.0, 8.0])
def test_what_is_ahead_is_all_that_is_seen(strips, scored, model, more):
    around = Surround.from_strips(strips, scored, {model: still(100, 50)})
    table, seen_any = RayTable(model, 0.3, 0.0), 0
    order = sort_by_azimuth(strips)
    for heading in (-3.1, -1.0, 0.0, 2.0, 3.1):
        place = float(np.float32(heading * AZIMUTHS_PER_RAD))
        lookup = Lookup(model, 0.3, 0.0, np.float32(place), np.float32(more))
        points, sent, far = around.seen(lookup)
        held, rays = table.counts(around.rectangles, lookup.heading, lookup.extra_tilt)
        np.testing.assert_array_equal(points, np.bincount(around.item[held], rays, 31)[:30])
        frame, shows = around.frame[held], strips.shows[order][held]
        everything = float(np.prod(model.shape))
        added = np.bincount(frame, rays * ((shows >= WITHIN) - 0.4), 3)
        np.testing.assert_allclose(sent, everything * 0.4 + added, rtol=1e-5)
        added = np.bincount(frame, rays * ((shows == BEYOND) - 0.2), 3)
        np.testing.assert_allclose(far, everything * 0.2 + added, rtol=1e-5, atol=1e-2)
        seen_any += points.sum() > 0
        pieces = around._list_slices_ahead(table, place)
        assert sum(each.stop - each.start for each in pieces) <= 600
        if model is CAMERA:
            assert sum(each.stop - each.start for each in pieces) < 400
    assert seen_any == 5
