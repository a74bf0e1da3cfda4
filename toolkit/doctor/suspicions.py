"""Suspected mistakes in stored objects and poses, and the fits that reveal them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

MIN_CLEAR_GAIN = 0.05  # in fit, for a suspicion of a mistake
MIN_EXPLAINED_FIT = 0.6  # without the mistake
MIN_MOVING_POINTS = 200  # with fewer nothing is suspected


class Suspicion(NamedTuple):
    """A mistake whose undoing raises the fit."""

    mistake: str
    remedy: str
    before: float
    after: float

    @property
    def evidence(self) -> str:
        """Both fits in words."""
        return (
            f"{self.before:.0%} of the moving points lie on boxes as it is, {self.after:.0%} with "
            "that undone"
        )


class Mistake(NamedTuple):
    """Mistake in the objects.

    undo: returns the changed columns of a table of columns, by short names."""

    mistake: str
    remedy: str
    undo: Callable[..., dict[str, np.ndarray]]
