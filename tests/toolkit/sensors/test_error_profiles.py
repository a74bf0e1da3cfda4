from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import (
    PAPER_ERRORS,
    POOR,
    PROFILES,
    SURVEYED,
    TYPICAL,
    check_drawn,
    find_profile,
    only_own_noise,
)
from toolkit.sensors.error_terms import (
    BlindSector,
    Calibration,
    ClockOffset,
    DropOut,
    OwnNoise,
    RangeBias,
    RangeNoise,
    rain,
)
from toolkit.sensors.readings import Draws, ErrorTerm, Reading


@dataclass(frozen=True)
class Offset:
    """A term that exists here only: all measurements are too large."""

    needs_velocities: ClassVar[bool] = False
    metres: float = 0.1

    def apply(self, reading, draws):
        return reading.measuring(reading.measurement + np.float32(self.metres) * reading.valid)


def test_digests_follow_terms_and_order():
    one = ErrorProfile("one", (OwnNoise(), Calibration(0.01, 0.05)))
    assert one.digest == ErrorProfile("two", one.terms).digest
    assert len(one.digest) == 64
    others = [
        *(
            (OwnNoise(), Calibration(0.01, 0.06)),
            (Calibration(0.01, 0.05), OwnNoise()),
            (OwnNoise(),),
            (),
        ),
        (OwnNoise(), DropOut(0.01, 0.05)),
    ]
    assert len({ErrorProfile("x", terms).digest for terms in others} | {one.digest}) == 6
    assert ErrorProfile("x", (Calibration(np.float64(0.01), np.float64(0.05)),)).digest
    assert one.origin == {"profile": "one", "digest": one.digest}
    assert hash(one) == hash(ErrorProfile("one", one.terms))
    with pytest.raises(ValueError, match="needs a name"):
        ErrorProfile("", ())


def test_profiles_are_found_by_name():
    assert list(PROFILES) == ["paper", "surveyed", "typical", "glare", "typical-clock", "poor"]
    assert [find_profile(name) for name in ("paper", "surveyed", "typical", "poor")] == [
        *(PAPER_ERRORS, SURVEYED, TYPICAL, POOR)
    ]
    assert find_profile("poor") is POOR
    assert find_profile(TYPICAL) is TYPICAL
    with pytest.raises(
        ValueError, match=r"unknown error profile 'bad': choose among paper, surveyed, .* poor, or"
    ):
        find_profile("bad")
    assert len({profile.digest for profile in PROFILES.values()}) == 6


def test_drawn_errors_need_a_seed():
    check_drawn(PAPER_ERRORS, None)
    check_drawn(TYPICAL, 0)
    with pytest.raises(
        ValueError, match=r"errors 'typical' are drawn from a seed, got noise_seed None"
    ):
        check_drawn(TYPICAL, None)


@pytest.mark.parametrize("terms", [(Calibration,), ("rain",), (3,), (OwnNoise(), None)])
def test_what_is_no_term_is_refused(terms):
    with pytest.raises((ValueError, TypeError)) as refused:
        ErrorProfile("x", terms)
    assert "term" in str(refused.value)


def test_own_terms_take_part(street):
    assert isinstance(Offset(), ErrorTerm)
    mine = ErrorProfile("mine", (Offset(0.25),))
    said = mine.read(street, seed=0, sensor=1, frame=2)
    assert np.allclose((said.measurement - street.measurement)[street.valid], 0.25, atol=1e-5)
    assert not said.measurement[~street.valid].any()
    assert mine.modules == [__name__]
    assert not mine.needs_velocities


def test_terms_draw_the_same_in_any_company(street):
    rainy = ErrorProfile("a", (rain(30.0),)).read(street, seed=1, sensor=2, frame=3)
    later = ErrorProfile("b", (Calibration(0.01, 0.1), DropOut(0.0), rain(30.0))).read(
        street, seed=1, sensor=2, frame=3
    )
    assert np.array_equal(rainy.measurement, later.measurement)
    assert (later.pose != rainy.pose).any()


def test_no_terms_change_nothing(street):
    said = ErrorProfile("none", ()).read(street, seed=0, sensor=0, frame=0)
    assert said.measurement is street.measurement
    assert said.pose is street.sensor.pose
    assert replace(ErrorProfile("none", ()), name="x").terms == ()


def test_two_terms_of_one_kind_draw_apart(wall, sensor):
    term, truth = RangeNoise(constant=0.1), wall(sensor, 20.0)
    said = ErrorProfile("twice", (term, term)).read(truth, seed=1, sensor=2, frame=3)
    assert (said.measurement - truth.measurement).std() == pytest.approx(0.1 * np.sqrt(2), rel=0.05)


def test_the_paper_has_noise_alone_and_each_profile_is_worse(street):
    assert PAPER_ERRORS.terms == (OwnNoise(),)
    said = PAPER_ERRORS.read(street, seed=4, sensor=99, frame=6)
    expected = street.sensor.model.noisy(street.measurement, np.random.default_rng([4, 6, 99]))
    assert said.measurement.tobytes() == expected.tobytes()
    assert said.pose is street.sensor.pose
    assert said.shift is None
    assert [name for name, profile in PROFILES.items() if only_own_noise(profile)] == ["paper"]
    assert only_own_noise(ErrorProfile("other", (OwnNoise(),)))
    lost, spread = [], []
    for name in ("paper", "surveyed", "typical", "poor"):
        said = PROFILES[name].read(street, seed=0, sensor=1, frame=0)
        both = said.valid & street.valid
        lost.append(1 - both.sum() / street.valid.sum())
        off = np.linalg.norm(said.pose[:3, 3] - street.sensor.position)
        spread.append((np.abs(said.measurement - street.measurement)[both].mean(), off))
    assert lost[0] == 0 < lost[1] < 0.01 < lost[2] < 0.05 < lost[3] < 0.3
    assert spread == sorted(spread)
    assert lost == pytest.approx(PINNED, abs=2e-5)


@pytest.mark.parametrize(
    ("name", "degrees", "metres"),
    [("surveyed", 0.05, 0.01), ("typical", 0.2, 0.03), ("poor", 0.5, 0.05)],
)
def test_calibration_is_what_the_name_says(name, degrees, metres):
    (found,) = [term for term in PROFILES[name].terms if type(term) is Calibration]
    assert (np.rad2deg(found.rotation), found.translation) == (pytest.approx(degrees), metres)
    assert not any(type(term) is ClockOffset for term in PROFILES[name].terms)


def test_place_errors_are_the_mean_displacement_of_a_point_across_the_line_of_sight():
    rng = np.random.default_rng(0)
    turns, moves = rng.normal(0, 1 / np.sqrt(3), (2, 20_000, 3))
    point = np.array([15.0, 0.0, 0.0])
    displaced = np.cross(np.deg2rad(0.2) * turns, point) + 0.03 * moves  # small angles
    assert TYPICAL.place_error == pytest.approx(np.abs(displaced[:, 1]).mean(), rel=0.02)
    assert PAPER_ERRORS.place_error == 0
    assert SURVEYED.place_error < TYPICAL.place_error < POOR.place_error


def test_glare_blinds_a_quarter_of_the_columns_of_each_sensor_for_good(street):
    said = [
        BlindSector(share=0.25).apply(Reading.from_truth(street), Draws(5, 1, frame, 2))
        for frame in (0, 9)
    ]
    columns = street.measurement.shape[1]
    for each in said:
        blind = (street.valid & ~each.valid).any(axis=0)
        assert not (each.valid & blind).any()
        assert 0 < blind.sum() <= round(0.25 * columns)
    assert (said[0].measurement == said[1].measurement).all()
    other = BlindSector(share=0.25).apply(Reading.from_truth(street), Draws(5, 2, 0, 2))
    assert (other.measurement != said[0].measurement).any()
    assert (
        BlindSector(share=1.0).apply(Reading.from_truth(street), Draws(5, 1, 0, 2)).valid.sum() == 0
    )


def test_a_bias_of_range_is_one_number_of_a_sensor(street):
    offsets = []
    for sensor in range(200):
        said = RangeBias(deviation=0.05).apply(Reading.from_truth(street), Draws(5, sensor, 0, 2))
        off = (said.measurement - street.measurement)[street.valid]
        assert np.ptp(off) < 1e-4
        offsets.append(off.mean())
    assert np.std(offsets) == pytest.approx(0.05, rel=0.2)
    assert abs(np.mean(offsets)) < 0.02


def test_glare_and_clocks_are_typical_but_for_one_term():
    usual = PROFILES["typical"].terms
    assert PROFILES["glare"].terms == (*usual, BlindSector(share=0.25))
    assert PROFILES["typical-clock"].terms == (*usual, ClockOffset(offset=0.05))
    assert [name for name, each in PROFILES.items() if each.needs_velocities] == ["typical-clock"]


PINNED = [0.0, 0.005284, 0.025493, 0.165173]  # share of returns that each profile takes


@pytest.mark.parametrize(
    "name", [name for name, each in PROFILES.items() if not each.needs_velocities]
)
def test_what_is_no_number_disturbs_no_profile(street, name):
    image = street.measurement.copy()
    image[::7] = np.nan
    image[3::7] = np.inf
    said = PROFILES[name].read(replace(street, measurement=image), seed=0, sensor=1, frame=0)
    assert np.isfinite(said.measurement).all()
    assert (said.measurement >= 0).all()
