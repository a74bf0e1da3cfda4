"""What a fidelity that is made of others has of the first of them: name, classes, and how many frames there are."""

from __future__ import annotations

from typing import cast

from placement_env.classes import Classes
from placement_env.protocol import ByClass, ByFrames, Fidelity


class LikeFirst:
    """A fidelity with the name and the classes of another."""

    def __init__(self, first: Fidelity) -> None:
        self._first = first

    @property
    def name(self) -> str:
        """Of the fidelity."""
        return self._first.name

    @property
    def classes(self) -> Classes:
        """Which count, and how they are combined."""
        return cast(ByClass, self._first).classes


class LikeFirstByFrames(LikeFirst):
    """The same of a fidelity that scores some frames alone."""

    @property
    def frames(self) -> int:
        """How many there are."""
        return cast(ByFrames, self._first).frames
