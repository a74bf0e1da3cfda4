"""Suspected mistakes in stored objects and poses, and the fits that reveal them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# The fit is the share of moving points on boxes, 0 to 1.
MIN_CLEAR_GAIN = 0.05  # least gain in fit for a suspicion of a mistake
MIN_EXPLAINED_FIT = 0.6  # least fit without the mistake
MIN_MOVING_POINTS = 200  # with fewer moving points nothing is suspected


class Suspicion(NamedTuple):
    """Suspected mistake: undoing it raises the fit.

    Attributes:
        mistake: the mistake in words.
        remedy: what the user should do about it, in words.
        fit_before: share of the moving points on boxes as they are, 0 to 1.
        fit_after: the same with the mistake undone."""

    mistake: str
    remedy: str
    fit_before: float
    fit_after: float

    @property
    def evidence(self) -> str:
        """Both fits in words."""
        return (
            f"{self.fit_before:.0%} of the moving points lie on boxes as it is, "
            f"{self.fit_after:.0%} with that undone"
        )


class Mistake(NamedTuple):
    """Mistake that stored objects may have, and how to undo it.

    Attributes:
        mistake: the mistake in words.
        remedy: what the user should do about it, in words.
        undo: takes the published columns of objects by short names (x, y, z, pitch, roll, yaw, l,
            w, h, label) and returns the columns that change, without the mistake."""

    mistake: str
    remedy: str
    undo: Callable[..., dict[str, np.ndarray]]
