from dataclasses import replace

import numpy as np
import pytest

from toolkit.sensors.errors.clock import ClockOffset
from toolkit.sensors.errors.pose_errors import Calibration
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import (
    PAPER_ERRORS,
    POOR,
    PROFILES,
    SURVEYED,
    TYPICAL,
    check_drawn,
    only_own_noise,
    profile_named,
    profile_of,
)
from toolkit.sensors.errors.range_noise import OwnNoise


def test_the_names():
    assert list(PROFILES) == ["paper", "surveyed", "typical", "poor"]
    assert [profile_named(name) for name in PROFILES] == [PAPER_ERRORS, SURVEYED, TYPICAL, POOR]
    assert profile_of("poor") is POOR
    assert profile_of(TYPICAL) is TYPICAL
    with pytest.raises(ValueError, match=r"no error profile 'bad': choose among paper, surveyed, typical, poor"):
        profile_named("bad")
    assert len({profile.digest for profile in PROFILES.values()}) == 4


def test_the_paper_has_the_models_noise_and_nothing_else(street):
    assert PAPER_ERRORS.terms == (OwnNoise(),)
    said = PAPER_ERRORS.read(street, seed=4, sensor=99, frame=6)
    expected = street.sensor.model.noisy(street.measurement, np.random.default_rng([4, 6, 99]))
    assert said.measurement.tobytes() == expected.tobytes()
    assert said.pose is street.sensor.pose
    assert said.shift is None
    assert [only_own_noise(profile) for profile in PROFILES.values()] == [True, False, False, False]
    assert only_own_noise(ErrorProfile("other", (OwnNoise(),)))


@pytest.mark.parametrize(
    ("name", "degrees", "metres"), [("surveyed", 0.05, 0.01), ("typical", 0.2, 0.03), ("poor", 0.5, 0.05)]
)
def test_calibration_is_what_the_name_says(name, degrees, metres):
    (found,) = [term for term in PROFILES[name].terms if type(term) is Calibration]
    assert (np.rad2deg(found.rotation), found.translation) == (pytest.approx(degrees), metres)
    assert not any(type(term) is ClockOffset for term in PROFILES[name].terms)


def test_each_profile_is_worse_than_the_one_before(street):
    lost, spread = [], []
    for profile in PROFILES.values():
        said = profile.read(street, seed=0, sensor=1, frame=0)
        both = said.valid & street.valid
        lost.append(1 - both.sum() / street.valid.sum())
        off = np.linalg.norm(said.pose[:3, 3] - street.sensor.position)
        spread.append((np.abs(said.measurement - street.measurement)[both].mean(), off))
    assert lost[0] == 0 < lost[1] < 0.01 < lost[2] < 0.05 < lost[3] < 0.3
    assert spread == sorted(spread)
    assert lost == pytest.approx(PINNED, abs=2e-5)


PINNED = [0.0, 0.005284, 0.025493, 0.165173]  # share of returns that each profile takes


@pytest.mark.parametrize("name", list(PROFILES))
def test_what_is_no_number_disturbs_no_profile(street, name):
    image = street.measurement.copy()
    image[::7] = np.nan
    image[3::7] = np.inf
    said = PROFILES[name].read(replace(street, measurement=image), seed=0, sensor=1, frame=0)
    assert np.isfinite(said.measurement).all()
    assert (said.measurement >= 0).all()


def test_errors_are_drawn_from_a_seed():
    check_drawn(PAPER_ERRORS, None)
    check_drawn(TYPICAL, 0)
    with pytest.raises(ValueError, match=r"errors 'typical' are drawn from a seed, got noise_seed None"):
        check_drawn(TYPICAL, None)
