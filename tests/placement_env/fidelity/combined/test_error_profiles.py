"""The worst of several error profiles, or their mean, for each set by itself."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.classes import Classes
from placement_env.fidelity.combined.error_profiles import (
    ErrorProfiles,
    ProfileByFrames,
    ProfileFidelity,
    errors_of,
    over_profiles,
    profiles_in,
    several,
)
from placement_env.protocol import ByFrames, ClassEstimates, Estimate
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR, TYPICAL

BOTH = ErrorProfiles((PAPER_ERRORS, POOR))
MEAN = ErrorProfiles((PAPER_ERRORS, POOR), "mean")
SETS = np.array([[True, False], [False, True], [True, True]])


class Fixed:
    """Says the same of SETS whatever is asked; half of it of single frames."""

    name, frames, detector = "detector", 3, "the reader"

    def __init__(self, ap, kbit, classes=("vehicle",), each=None):
        self.ap, self.kbit = np.array(ap), np.array(kbit)
        self.classes, self.each = Classes(classes), each

    def __call__(self, subsets, /):
        return Estimate(self.ap, self.ap + 0.01, self.kbit)

    def partial(self, subsets, frames):
        return Estimate(self.ap / len(frames), self.ap, self.kbit)

    def by_class(self, subsets, /):
        return ClassEstimates(np.array(self.each), np.array(self.each) + 0.01, self.kbit)


EXACT, ROUGH = Fixed([0.9, 0.6, 0.5], [10.0, 20.0, 30.0]), Fixed([0.5, 0.7, 0.5], [11.0, 22.0, 33.0])


def test_of_each_set_the_profile_of_least_ap_counts_with_all_its_figures():
    found = over_profiles([EXACT, ROUGH], BOTH)(SETS)
    assert found.ap.tolist() == [0.5, 0.6, 0.5]
    assert found.recall.tolist() == [0.51, 0.61, 0.51]
    assert found.kbit.tolist() == [11.0, 20.0, 30.0]  # of equal ones the first


def test_or_the_means():
    found = over_profiles([EXACT, ROUGH], MEAN)(SETS)
    assert found.ap == pytest.approx([0.7, 0.65, 0.5])
    assert found.recall == pytest.approx([0.71, 0.66, 0.51])
    assert found.kbit == pytest.approx([10.5, 21.0, 31.5])


def test_each_profile_is_said_by_name():
    made = over_profiles([EXACT, ROUGH], BOTH)
    each = made.at_each(SETS)
    assert list(each) == ["paper", "poor"]
    assert each["poor"].ap.tolist() == [0.5, 0.7, 0.5]
    assert (made.name, made.detector, made.classes.names, made.errors) == ("detector", "the reader", ("vehicle",), BOTH)


def test_some_frames_alone_where_all_fidelities_can():
    made = over_profiles([EXACT, ROUGH], BOTH)
    assert isinstance(made, ProfileByFrames)
    assert isinstance(made, ByFrames)
    assert made.frames == 3
    assert made.partial(SETS, [0, 2]).ap.tolist() == [0.25, 0.3, 0.25]

    class Whole:
        name = "detector"
        __call__ = Fixed.__call__

    one = over_profiles([EXACT, Whole()], BOTH)
    assert type(one) is ProfileFidelity
    assert one.detector == "the reader"
    assert over_profiles([Whole(), EXACT], BOTH).detector is None


@pytest.mark.parametrize(
    ("over", "ap"), [(BOTH, [[0.2, 0.6], [0.6, 0.4], [0.5, 0.5]]), (MEAN, [[0.55, 0.5], [0.65, 0.6], [0.5, 0.5]])]
)
def test_classes_are_those_of_the_profile_that_is_worst_on_the_whole(over, ap):
    """The second class of the first set is worse at the other profile."""
    names = ("vehicle", "pedestrian")
    exact = Fixed([0], [10.0, 20.0, 30.0], names, [[0.9, 0.4], [0.6, 0.4], [0.5, 0.5]])
    rough = Fixed([0], [11.0, 22.0, 33.0], names, [[0.2, 0.6], [0.7, 0.8], [0.5, 0.5]])
    found = ProfileFidelity([exact, rough], over).by_class(SETS)
    assert found.ap == pytest.approx(np.array(ap))
    assert found.recall == pytest.approx(np.array(ap) + 0.01)
    assert found.kbit == pytest.approx([11.0, 20.0, 30.0] if over is BOTH else [10.5, 21.0, 31.5])


def test_a_class_with_nothing_to_find_stays_unknown():
    names = ("vehicle", "pedestrian")
    exact, rough = (Fixed([0], [1.0], names, [[ap, np.nan]]) for ap in (0.9, 0.4))
    found = ProfileFidelity([exact, rough], BOTH).by_class(SETS[:1])
    assert found.ap[0, 0] == 0.4
    assert np.isnan(found.ap[0, 1])
    assert found.combined(Classes(names)).ap.tolist() == [0.4]


def test_figures_over_profiles():
    figures = np.array([[[0.1, 0.9]], [[0.5, 0.3]]])
    assert BOTH.combined(figures).tolist() == [[0.1, 0.3]]
    assert MEAN.combined(figures) == pytest.approx(np.array([[0.3, 0.6]]))


def test_one_is_itself_and_several_are_named():
    assert errors_of("poor") is errors_of([POOR]) is errors_of(POOR) is errors_of(("poor",), "mean") is POOR
    assert errors_of(BOTH, "mean") is BOTH
    assert errors_of(["paper", POOR]) == BOTH
    assert errors_of(["paper", POOR], "mean") == MEAN
    assert (several(POOR), several(BOTH)) == (None, BOTH)
    assert (profiles_in(POOR), profiles_in(BOTH)) == ((POOR,), (PAPER_ERRORS, POOR))
    assert BOTH.described == "at the worst of the error profiles paper and poor"
    assert BOTH.origin == {"profiles": [PAPER_ERRORS.origin, POOR.origin], "combine": "worst"}
    assert MEAN.origin["combine"] == "mean"


@pytest.mark.parametrize(
    ("profiles", "combine", "message"),
    [
        ((), "worst", "several error profiles must be different ones, got none: name each once"),
        ((POOR,), "worst", "must be different ones, got poor"),
        ((POOR, TYPICAL, POOR), "worst", "must be different ones, got poor, typical, poor"),
        ((POOR, replace(POOR, name="other")), "worst", "must be different ones, got poor, other"),
        ((POOR, replace(TYPICAL, name="poor")), "worst", "must be different ones, got poor, poor"),
        ((POOR, TYPICAL), "best", "error profiles are combined by mean or worst, got 'best'"),
    ],
)
def test_what_is_refused(profiles, combine, message):
    with pytest.raises((ValueError, TypeError), match=message if combine != "best" else "best"):
        ErrorProfiles(profiles, combine)


def test_names_there_are_not():
    with pytest.raises(ValueError, match="no error profile 'bad'"):
        errors_of(["paper", "bad"])
    with pytest.raises(ValueError, match="got none"):
        errors_of([])
