from dataclasses import replace

import numpy as np
import pytest

from toolkit.sensors.errors.weather import Weather, fog, rain, snow


def ranges_of(said):
    return said.measurement * said.truth.ray_lengths


@pytest.mark.parametrize("metres", [3.0, 10.0, 60.0])
def test_near_returns_have_the_law_of_range(read, wall, sensor, metres):
    """P(return before R) = 1 - (1 - share)^(1 - exp(-(R - 0.3) / reach)), so also of those before each r < R."""
    term, truth = Weather(share=0.5, reach=6.0), wall(sensor, metres)
    said = ranges_of(read(term, truth))
    early = said < truth.ranges - 1e-4
    for r in (1.0, 2.0, 5.0, 9.0, 40.0):
        if r < metres:
            expected = 1 - 0.5 ** (1 - np.exp(-(r - 0.3) / 6.0))
            assert (early & (said < r)).mean() == pytest.approx(expected, abs=0.012)
    assert said[early].min() > 0.29


def test_of_rays_into_the_open_the_share_returns(read, street, sensor):
    sky = replace(street, sensor=sensor, measurement=np.zeros(sensor.model.shape, np.float32))
    said = read(Weather(share=0.3, reach=4.0), sky)
    assert said.valid.mean() == pytest.approx(0.3, abs=0.012)
    assert np.percentile(ranges_of(said)[said.valid], 90) < 12


def test_attenuation_is_beers(read, wall, sensor):
    truth = wall(sensor, 40.0)
    kept = read(Weather(extinction=0.01), truth).valid.mean()
    assert kept == pytest.approx(np.exp(-0.02 * truth.ranges).mean(), abs=0.012)


def test_the_laws_of_rain_snow_and_fog():
    """dB per km: rain of 10 mm/h 5.03, dry snow of 1 mm/h 5.55, wet 3.88; fog of 100 m visibility 0.039 per metre."""
    per_km = 10 / np.log(10) * 1000
    assert rain(10.0).extinction * per_km == pytest.approx(1.076 * 10**0.67)
    assert rain(10.0).extinction * per_km == pytest.approx(5.03, abs=0.01)
    assert snow(1.0).extinction * per_km == pytest.approx(5.545, abs=0.01)
    assert snow(1.0, wet=True).extinction * per_km == pytest.approx(3.878, abs=0.01)
    assert fog(100.0).extinction == pytest.approx(0.03912)
    assert rain(10.0).share == pytest.approx(1 - np.exp(-0.03))
    assert fog(50.0).reach == 5.0
    shares = [rain(r).share for r in (0.0, 1.0, 10.0, 100.0)]
    assert shares == sorted(shares)
    assert shares[0] == 0
    for wrong in (lambda: rain(-1.0), lambda: snow(float("nan")), lambda: fog(0.0)):
        with pytest.raises(ValueError, match="must be"):
            wrong()


def test_more_rain_more_of_it(read, street):
    """Metamorphic: whatever a light rain takes or brings, a heavier one does too, since both draw the same numbers."""
    light, heavy = (read(rain(r), street) for r in (5.0, 50.0))
    changed = [each.measurement != street.measurement for each in (light, heavy)]
    assert not (changed[0] & ~changed[1]).any()
    assert changed[0].sum() < changed[1].sum()


def test_no_strength_no_change(harmless, street):
    harmless(Weather(), street)
    harmless(rain(0.0), street)


def test_wrong_numbers():
    with pytest.raises(ValueError, match="below 1"):
        Weather(share=1.0)
    for wrong in (lambda: Weather(-1.0), lambda: Weather(reach=0.0), lambda: Weather(share=-0.1)):
        with pytest.raises(ValueError, match="must be a"):
            wrong()
