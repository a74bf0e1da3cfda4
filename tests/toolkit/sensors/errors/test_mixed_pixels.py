from dataclasses import replace

import numpy as np
import pytest

from toolkit.sensors.errors.mixed_pixels import MixedPixels


@pytest.fixture
def halves(wall, sensor):
    """Left of the middle 10 m, right of it 20 m."""
    truth = wall(sensor, 10.0)
    truth.measurement[:, truth.measurement.shape[1] // 2 :] = 20.0
    return truth


def test_only_the_two_columns_at_the_edge_mix_and_lie_between(read, halves):
    image = np.stack([read(MixedPixels(0.6), halves, frame=f).measurement for f in range(40)])
    changed = image != halves.measurement
    middle = image.shape[2] // 2
    assert set(np.flatnonzero(changed.any(axis=(0, 1)))) == {middle - 1, middle}
    assert changed[..., middle - 1 : middle + 1].mean() == pytest.approx(0.6 / 4, rel=0.1)  # one neighbour of four
    between = image[changed]
    assert between.min() > 10
    assert between.max() < 20
    assert between.mean() == pytest.approx(15.0, abs=0.25)
    assert between.std() == pytest.approx(10 / np.sqrt(12), rel=0.06)


def test_gap_and_reach_bound_what_mixes(read, halves):
    for still in (MixedPixels(1.0, gap=10.5), MixedPixels(1.0, reach=9.5)):
        assert np.array_equal(read(still, halves).measurement, halves.measurement)
    assert (read(MixedPixels(1.0, gap=9.5, reach=10.5), halves).measurement != halves.measurement).any()


def test_the_open_sky_mixes_with_nothing(read, halves):
    image = np.where(halves.measurement > 15, np.float32(0), halves.measurement)
    assert np.array_equal(read(MixedPixels(1.0), replace(halves, measurement=image)).measurement, image)


def test_it_mixes_what_is_read_and_not_what_was_there(read, street):
    """Edges of returns that an earlier term took are none."""
    said = read(MixedPixels(1.0), street).measurement
    assert (said != street.measurement).mean() > 0.005
    assert not said[~street.valid].any()


def test_no_strength_no_change(harmless, street):
    harmless(MixedPixels(), street)
    harmless(MixedPixels(0.0, gap=0.0), street)


def test_wrong_numbers():
    with pytest.raises(ValueError, match=r"share of MixedPixels must be a share from 0 to 1, got 1\.5"):
        MixedPixels(1.5)
    with pytest.raises(ValueError, match="gap of MixedPixels"):
        MixedPixels(0.5, gap=-1.0)
