"""The schemes that go by a name."""

import pytest

from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import (
    PAPER_SCHEMES,
    SCHEMES,
    adaptive_of,
    scheme_of,
    schemes_in_steps,
    sharing_curve,
)
from toolkit.detection.sharing.adaptive import Adaptive
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences


@pytest.mark.parametrize("name", SCHEMES)
def test_each_goes_by_its_name(name):
    scheme = scheme_of(name)
    assert isinstance(scheme, Scheme)
    assert scheme.name == name
    assert scheme_of(scheme) is scheme
    assert scheme.sends_points or scheme.sends_boxes


def test_the_curve_goes_from_boxes_only_to_everything():
    names = [scheme.name for scheme in sharing_curve((2.0, 0.5))]
    assert names == ["late", "adaptive 0.5", "adaptive 2", "foreground", "early"]
    assert sharing_curve((0.5,))[1] == Adaptive(500, name="adaptive 0.5")
    assert sharing_curve((0.5,), sensors=6)[1] == Adaptive(3000, whole_link=True, name="adaptive 0.5")
    assert sharing_curve((1.0,), step=0.08)[2] == Foreground(0.08)


def test_a_budget_in_kbit():
    assert adaptive_of(2.5) == Adaptive(2500)
    assert schemes_in_steps(0.04, adaptive=adaptive_of(1.0, whole_link=True))["adaptive"] == Adaptive(1000, True)
    assert schemes_in_steps(0.04)["adaptive"] == Adaptive()
    for wrong in (-1.0, float("nan"), 5e6):
        with pytest.raises(ValueError, match="a budget must be 0 to 4294967 kbit"):
            adaptive_of(wrong)


def test_differences_in_steps():
    assert schemes_in_steps(0.04)["differences"] == ForegroundDifferences(0.04)
    named = schemes_in_steps(0.08, refers_to="key", key_every=5)
    assert named["differences"] == ForegroundDifferences(0.08, "key", 5)
    assert named["foreground"] == Foreground(0.08)


def test_the_papers_are_there_in_its_order():
    assert PAPER_SCHEMES == tuple(SCHEMES)[:3] == ("early", "late", "hybrid")


@pytest.mark.parametrize("scheme", ["middle", "", None, 3, Early])
def test_what_is_none_is_refused(scheme):
    with pytest.raises((ValueError, TypeError), match="scheme"):
        scheme_of(scheme)


def test_parameters_are_in_the_digest():
    assert len({Hybrid().digest, Hybrid(5.0).digest, Hybrid(metric="published").digest, Early().digest}) == 4
