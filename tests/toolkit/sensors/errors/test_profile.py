from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from toolkit.sensors.errors.drop_out import DropOut
from toolkit.sensors.errors.pose_errors import Calibration
from toolkit.sensors.errors.profile import ErrorProfile, ErrorTerm
from toolkit.sensors.errors.range_noise import OwnNoise, RangeNoise
from toolkit.sensors.errors.weather import rain


@dataclass(frozen=True)
class Offset:
    """A term that exists here only: all measurements are too large."""

    needs_velocities: ClassVar[bool] = False
    metres: float = 0.1

    def apply(self, reading, draws):
        return reading.measuring(reading.measurement + np.float32(self.metres) * reading.valid)


def test_a_digest_tells_terms_numbers_and_order_but_not_the_name():
    one = ErrorProfile("one", (OwnNoise(), Calibration(0.01, 0.05)))
    assert one.digest == ErrorProfile("two", one.terms).digest
    assert len(one.digest) == 64
    others = [
        (OwnNoise(), Calibration(0.01, 0.06)), (Calibration(0.01, 0.05), OwnNoise()), (OwnNoise(),), (),
        (OwnNoise(), DropOut(0.01, 0.05)),
    ]  # fmt: skip
    assert len({ErrorProfile("x", terms).digest for terms in others} | {one.digest}) == 6
    assert ErrorProfile("x", (Calibration(np.float64(0.01), np.float64(0.05)),)).digest
    assert one.origin == {"profile": "one", "digest": one.digest}
    assert hash(one) == hash(ErrorProfile("one", one.terms))


@pytest.mark.parametrize("terms", [(Calibration,), ("rain",), (3,), (OwnNoise(), None)])
def test_what_is_no_term_is_refused(terms):
    with pytest.raises((ValueError, TypeError)) as refused:
        ErrorProfile("x", terms)
    assert "term" in str(refused.value)


def test_a_profile_needs_a_name():
    with pytest.raises(ValueError, match="needs a name"):
        ErrorProfile("", ())


def test_own_terms_take_part(street):
    assert isinstance(Offset(), ErrorTerm)
    mine = ErrorProfile("mine", (Offset(0.25),))
    said = mine.read(street, seed=0, sensor=1, frame=2)
    assert np.allclose((said.measurement - street.measurement)[street.valid], 0.25, atol=1e-5)
    assert not said.measurement[~street.valid].any()
    assert mine.modules == [__name__]
    assert not mine.needs_velocities


def test_a_term_draws_the_same_whatever_other_terms_there_are(street):
    rainy = ErrorProfile("a", (rain(30.0),)).read(street, seed=1, sensor=2, frame=3)
    later = ErrorProfile("b", (Calibration(0.01, 0.1), DropOut(0.0), rain(30.0))).read(
        street, seed=1, sensor=2, frame=3
    )
    assert np.array_equal(rainy.measurement, later.measurement)
    assert (later.pose != rainy.pose).any()


def test_two_terms_of_one_kind_draw_apart(wall, sensor):
    term, truth = RangeNoise(constant=0.1), wall(sensor, 20.0)
    said = ErrorProfile("twice", (term, term)).read(truth, seed=1, sensor=2, frame=3)
    assert (said.measurement - truth.measurement).std() == pytest.approx(0.1 * np.sqrt(2), rel=0.05)


def test_no_terms_no_change(street):
    said = ErrorProfile("none", ()).read(street, seed=0, sensor=0, frame=0)
    assert said.measurement is street.measurement
    assert said.pose is street.sensor.pose
    assert replace(ErrorProfile("none", ()), name="x").terms == ()
