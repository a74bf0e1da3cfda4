"""`Coverage`: score sensor sets by seen objects.

The score is the share of objects that enough sensors of a set see well enough. With `views` 1 it is monotone and
submodular, so greedy search is within 1 - 1/e of the best set. The AP of a detector is not submodular, nor is the worst
of several classes.
"""

from __future__ import annotations

import numpy as np

from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import ClassEstimates, Estimate
from placement_env.subsets import MemberSums
from toolkit.arrays import Bool, Float64
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme, estimate_bits
from toolkit.detection.schemes import find_scheme

LEAST = 20.0  # points on a vehicle that make a view


class Coverage:
    """Share of scored objects that a set covers.

    An object is covered by at least `least` points from each of at least `views` sensors. Both `ap` and `recall` of the
    estimate are this share. The data sent is known for points. Where the scheme sends boxes, each sensor is assumed to
    send one for each object that it sees with `least` points. classes: of the objects that count, several combined.
    Raises ValueError for `least` that is not positive or fewer views than 1.
    """

    name = "coverage"

    def __init__(
        self,
        visibility: Visibility,
        scheme: Scheme | str = "early",
        *,
        least: float = LEAST,
        views: int = 1,
        codec: Codec = PAPER,
        classes: Classes = VEHICLES,
    ) -> None:
        if not 0 < least < np.inf or views < 1 or views != int(views):
            raise ValueError(f"a view needs more than 0 points and a set 1 view or more, got {least} and {views}")
        visibility = visibility.of_classes(classes.labels)
        seen = visibility.points >= least
        self.views, self.classes = views, classes
        self._sums = MemberSums(seen.astype(np.uint16))
        self._own = [np.flatnonzero(visibility.labels == label) for label in classes.labels]
        self._bits = estimate_bits(find_scheme(scheme), codec, visibility, seen.sum(axis=1).astype(np.float64))
        self._frames = visibility.frames

    def __call__(self, subsets: Bool[np.ndarray, "n C"], /) -> Estimate:
        """Share of objects covered by each set. For several classes their shares are combined; 0 without an object."""
        if len(self.classes) > 1:
            estimate = self.by_class(subsets).combined(self.classes)
            share = np.nan_to_num(estimate.ap)
            return Estimate(share, share.copy(), estimate.kbit)
        covered = np.zeros(len(subsets))
        for block, views in self._sums.blocks(subsets):
            covered[block] = (views >= self.views).sum(axis=1)
        share = covered / max(1, self._sums.rows.shape[1])
        return Estimate(share, share.copy(), self._kbit(subsets))

    def by_class(self, subsets: Bool[np.ndarray, "n C"], /) -> ClassEstimates:
        """Share of the objects of each class. NaN where the class has no objects."""
        share = np.full((len(subsets), len(self.classes)), np.nan)
        for block, views in self._sums.blocks(subsets):
            for k, own in enumerate(self._own):
                if len(own):
                    share[block, k] = (views[:, own] >= self.views).mean(axis=1)
        return ClassEstimates(share, share.copy(), self._kbit(subsets))

    def _kbit(self, subsets: Bool[np.ndarray, "n C"]) -> Float64[np.ndarray, " n"]:
        return np.asarray(subsets @ self._bits / (1000 * self._frames))
