import numpy as np
import pytest

from toolkit.sensors.errors.range_noise import (
    OwnNoise,
    RangeNoise,
    lidar_noise,
    stereo_noise,
    time_of_flight_noise,
)


@pytest.mark.parametrize("metres", [5.0, 20.0, 60.0])
@pytest.mark.parametrize(
    "term", [RangeNoise(constant=0.03), RangeNoise(0.01, 0.002), RangeNoise(quadratic=1e-4), time_of_flight_noise()]
)
def test_sigma_by_range(read, wall, sensor, term, metres):
    truth = wall(sensor, metres)
    noise = read(term, truth).measurement.astype(np.float64) - metres
    expected = term.constant + term.proportional * metres + term.quadratic * metres**2
    assert noise.std() == pytest.approx(expected, rel=0.03)
    assert abs(noise.mean()) < 4 * expected / np.sqrt(noise.size)


def test_stereo_by_the_textbook():
    """f = 800 pixels and B = 0.5 m: at 20 m one tenth of a pixel is 10 cm."""
    assert stereo_noise(baseline=0.5, focal=800.0).quadratic * 20**2 == pytest.approx(0.1)
    with pytest.raises(ValueError, match="above 0"):
        stereo_noise(baseline=0.0, focal=800.0)


def test_time_of_flight_splits_its_sigma_at_10_m():
    for ambient in (0.0, 0.3, 1.0):
        term = time_of_flight_noise(at_10_m=0.05, ambient=ambient)
        assert term.proportional * 10 + term.quadratic * 100 == pytest.approx(0.05)
        assert term.quadratic * 100 == pytest.approx(0.05 * ambient)
    with pytest.raises(ValueError, match="share"):
        time_of_flight_noise(ambient=1.5)


def test_a_law_may_be_for_some_sensors_only(read, wall, sensor):
    truth = wall(sensor, 10.0)
    laws = {"depth": stereo_noise(baseline=1.0, focal=1000.0), "range": lidar_noise()}
    for measures, term in laws.items():
        same = np.array_equal(read(term, truth).measurement, truth.measurement)
        assert same == (measures != sensor.model.measures)


def test_what_returned_nothing_still_does_and_nothing_comes_from_behind(read, street, wall, sensor):
    assert not read(RangeNoise(constant=1.0), street).measurement[~street.valid].any()
    wild = read(RangeNoise(constant=30.0), wall(sensor, 10.0)).measurement
    assert (wild >= 0).all()
    assert wild.dtype == np.float32


def test_frames_differ_and_seeds_do(read, street):
    term = RangeNoise(constant=0.1)
    said = [
        read(term, street, **with_).measurement.tobytes()
        for with_ in ({}, {"frame": 4}, {"seed": 1}, {"number": 6}, {})
    ]
    assert said[0] == said[4]
    assert len(set(said)) == 4


def test_no_strength_no_change(harmless, street):
    harmless(RangeNoise(), street)


def test_own_noise_is_the_models(read, street):
    said = read(OwnNoise(), street)
    assert (said.measurement - street.measurement)[street.valid].std() == pytest.approx(0.015, rel=0.02)


@pytest.mark.parametrize("wrong", [{"constant": -1.0}, {"quadratic": float("nan")}, {"proportional": float("inf")}])
def test_wrong_numbers(wrong):
    with pytest.raises(ValueError, match="RangeNoise must be a number from 0 on"):
        RangeNoise(**wrong)
