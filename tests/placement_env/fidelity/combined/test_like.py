"""What is made of several fidelities has the name, classes and frames of the first."""

import pytest

from placement_env.classes import Classes
from placement_env.fidelity.combined.like import LikeFirst, LikeFirstByFrames


class Scoring:
    """A fidelity of a class, which nobody asks."""

    name, classes = "detector", Classes(("cyclist",))

    def __call__(self, subsets, /):
        raise AssertionError


class ScoringFrames(Scoring):
    """One that knows its frames."""

    frames = 8


def test_name_and_classes_of_the_first():
    made = LikeFirst(Scoring())
    assert (made.name, made.classes) == ("detector", Classes(("cyclist",)))
    assert not hasattr(made, "frames")


def test_frames_where_the_first_has_some():
    assert LikeFirstByFrames(ScoringFrames()).frames == 8
    assert LikeFirstByFrames(ScoringFrames()).name == "detector"
    with pytest.raises(AttributeError):
        _ = LikeFirstByFrames(Scoring()).frames
