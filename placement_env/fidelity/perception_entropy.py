"""`PerceptionEntropy`: a surrogate of AP from the literature, in objects and points so that it
compares with ours.

T. Ma, Z. Liu, Y. Li, "Perception Entropy: A Metric for Multiple Sensors Configuration Evaluation
and Design", arXiv 2104.06615. Of m lidar points on a place,

    AP = a ln m + b, a = 0.152, b = 0.659     σ = 1/AP - 1     H = 2 ln σ + 1 + ln 2π

Early fusion adds the m of all sensors, late fusion their 1/σ², and the entropy is the mean of H.
Checked against the formulas and constants that an implementation quotes from the paper
(github.com/robosquiggles/go4robo). Only abstract and introduction of the paper itself were
available. So its equation numbers are not checked, nor whether m counts the points of an object or
of a voxel of the space around the car. Here m counts an object's points.

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
MIN_AP = 0.001  # AP of an object without points
MAX_AP = 0.999  # largest AP
UNSEEN_SIGMA = 1 / MIN_AP - 1  # σ of an object without points


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
        """Keep of each candidate and object what adds up over the sensors of a set."""
        self._adds_points = not find_scheme(scheme).sends_boxes
        points = visibility.points.astype(np.float32)
        # early fusion sums points over the sensors of a set, late fusion 1/σ²
        inverse_squares = np.where(points > 0, _compute_sigma(points) ** -2, 0)
        self._sums = MemberSums(points if self._adds_points else inverse_squares)
        self._sent = SentData(visibility, scheme, codec)

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Score of each set as AP and recall, and its kbit.

        The score is 1 for the least entropy, 0 for the greatest, if nothing is seen."""
        score = np.zeros(len(subsets))
        objects = self._sums.rows.shape[1]  # number of objects
        # entropy 2 ln σ without points and with very many; constant terms of H cancel in the score
        max_entropy, min_entropy = 2 * np.log(_compute_sigma(np.array([0.0, np.inf])))
        # block: slice of sets; sums: over the sensors of each set (row), for each object
        for block, sums in self._sums.blocks(subsets):
            if self._adds_points:
                log_sigma = np.log(_compute_sigma(sums))
            else:
                log_sigma = -0.5 * np.log(np.maximum(sums, UNSEEN_SIGMA**-2))  # sums of 1/σ²
            entropy = 2 * log_sigma.sum(axis=1, dtype=np.float64) / max(1, objects)
            scaled_entropy = np.clip((max_entropy - entropy) / (max_entropy - min_entropy), 0, 1)
            score[block] = scaled_entropy if objects else 0.0
        return Estimate(ap=score, recall=score.copy(), kbit=self._sent.kbit(subsets))


def _compute_sigma(points: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """σ = 1/AP - 1 for a number of points; AP = a ln points + b, kept in `MIN_AP` to `MAX_AP`."""
    with np.errstate(divide="ignore"):
        return 1 / np.clip(SLOPE * np.log(points) + OFFSET, MIN_AP, MAX_AP) - 1
