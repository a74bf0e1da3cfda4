"""`PerceptionEntropy`: a surrogate of AP from the literature, in objects and points so that it
compares with ours.

T. Ma, Z. Liu, Y. Li, "Perception Entropy: A Metric for Multiple Sensors Configuration Evaluation
and Design", arXiv 2104.06615. Of m lidar points on a place,

    AP = a ln m + b, a = 0.152, b = 0.659     σ = 1/AP - 1     H = 2 ln σ + 1 + ln 2π

Early fusion adds the m of all sensors, late fusion their 1/σ², and the entropy is the mean of H.
Checked against the formulas and constants that an implementation quotes from the paper
(github.com/robosquiggles/go4robo). Only abstract and introduction of the paper itself were
available. So its equation numbers are not checked, nor whether m counts the points of an object or
of a voxel of the space around the car. Here m counts those of an object.

Adapted: the mean is over the vehicles of our frames rather than over weighted voxels around a car;
AP is held within 0.001 to 0.999, as in that implementation; late fusion joins single sensors, there
kinds of sensors; the entropy is reversed and scaled, so that 0 stands for nothing seen and 1 for
0.999 everywhere; hybrid is treated as late.

kbit is as in `placement_env.fidelity.coverage`, recall is the same figure as AP."""

import numpy as np

from placement_env.fidelity.coverage import SentData
from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import Estimate
from placement_env.subsets import MemberSums, Sets
from toolkit.arrays import Float
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme

SLOPE = 0.152  # a of AP = a ln m + b
OFFSET = 0.659  # b
LOWEST = 0.001  # AP of an object without points
HIGHEST = 0.999  # largest AP
UNSEEN_SPREAD = 1 / LOWEST - 1  # σ of an object without points


class PerceptionEntropy:
    """Score sets by perception entropy (Ma, Liu and Li), scaled to 0 to 1.

    Args:
        visibility: Points of the candidates on objects.
        scheme: Fusion scheme, or its name; one that sends boxes is treated as late fusion.
        codec: Codec of the data sent."""

    name = "perception entropy"

    def __init__(
        self, visibility: Visibility, scheme: Scheme | str = "early", *, codec: Codec = PAPER
    ) -> None:
        self._adds_points = not find_scheme(scheme).sends_boxes
        points = visibility.points.astype(np.float32)
        self._sums = MemberSums(
            points if self._adds_points else np.where(points > 0, _spread(points) ** -2, 0)
        )
        self._sent = SentData(visibility, scheme, codec)

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Score of each set: 1 for the least entropy, 0 for the greatest, if nothing is seen."""
        score = np.zeros(len(subsets))
        (max_entropy, min_entropy), objects = (
            2 * np.log(_spread(np.array([0.0, np.inf]))),
            self._sums.rows.shape[1],
        )
        for block, sums in self._sums.blocks(subsets):
            spread = (
                np.log(_spread(sums))
                if self._adds_points
                else -0.5 * np.log(np.maximum(sums, UNSEEN_SPREAD**-2))
            )
            entropy = 2 * spread.sum(axis=1, dtype=np.float64) / max(1, objects)
            score[block] = (
                np.clip((max_entropy - entropy) / (max_entropy - min_entropy), 0, 1)
                if objects
                else 0.0
            )
        return Estimate(score, score.copy(), self._sent.kbit(subsets))


def _spread(points: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """σ = 1/AP - 1 for a number of points; AP = a ln points + b, kept in `LOWEST` to `HIGHEST`."""
    with np.errstate(divide="ignore"):
        return 1 / np.clip(SLOPE * np.log(points) + OFFSET, LOWEST, HIGHEST) - 1
