"""`PointCount`: score sensor sets by the points that they have on the objects, up to as many as a
tight box needs."""

import math

import numpy as np

from placement_env.fidelity.coverage import SentData
from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import Estimate
from placement_env.subsets import MemberSums, Sets
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme

ENOUGH_POINTS = 299.0  # on an object, beyond which more points add nothing


class PointCount:
    """Score sets by the logarithm of their points on each object, up to `ENOUGH_POINTS`.

    The score is the mean of min(log(1 + points), log(1 + `ENOUGH_POINTS`)) over the objects, as a
    share of its greatest value. It is monotone and submodular. kbit is as in
    `placement_env.fidelity.coverage`, recall is the same figure as AP."""

    name = "point count"

    def __init__(
        self, visibility: Visibility, scheme: Scheme | str = "early", *, codec: Codec = PAPER
    ) -> None:
        self._point_sums = MemberSums(visibility.points.astype(np.float32))
        self._sent = SentData(visibility, scheme, codec)

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Score of each set as AP and recall, from 0 for nothing seen to 1, and its kbit.

        It is the mean over the objects of log(1 + points), as a share of its greatest value."""
        score = np.zeros(len(subsets))
        objects = self._point_sums.rows.shape[1]  # number of objects
        max_sum = max(1, objects) * math.log1p(ENOUGH_POINTS)
        # block: slice of sets; points: points of all sensors of each set on each object
        for block, points in self._point_sums.blocks(subsets):
            logarithms = np.log1p(np.minimum(points, ENOUGH_POINTS))
            score[block] = logarithms.sum(axis=1, dtype=np.float64) / max_sum
        return Estimate(ap=score, recall=score.copy(), kbit=self._sent.kbit(subsets))
