"""What is made of several fidelities has the name, classes and frames of the first."""

import pytest

from placement_env.classes import Classes
from placement_env.fidelity.combined.like import LikeFirst, LikeFirstByFrames


class First:
    """As much of a fidelity as is asked for."""

    name, classes, frames = "detector", Classes(("cyclist",)), 8


def test_name_and_classes_of_the_first():
    made = LikeFirst(First())
    assert (made.name, made.classes) == ("detector", Classes(("cyclist",)))
    assert not hasattr(made, "frames")


def test_frames_where_the_first_has_some():
    assert LikeFirstByFrames(First()).frames == 8
    assert LikeFirstByFrames(First()).name == "detector"
    with pytest.raises(AttributeError):
        _ = LikeFirstByFrames(object()).frames
