"""A surrogate of AP from the literature, in objects and points so that it compares with ours.

`InformationGain`: H. Hu et al., "Investigating the Impact of Multi-LiDAR Placement on Object
Detection for Autonomous Driving", CVPR 2022, arXiv 2105.00373. A voxel is occupied in a share p of
the frames and has the entropy H(p) = -p ln p - (1 - p) ln(1 - p); the published metric, to be
maximised, is

    S-MIG = -Σ H(p) over the voxels that rays cross        of the gain Σ H(p) over all voxels +
                                                           S-MIG

Checked against the authors' released code, folder S_MIG of
github.com/HanjiangHu/Multi-LiDAR-Placement-for-3D-Detection, and their description of it in arXiv
2310.05245, section III; the first paper's own text was not available.

It compares placements of equally many lidars. **The sign here is reversed**: among sets of any size
S-MIG prefers those that see least. So a set scores the share of the whole place's Σ H(p) that its
reach covers, as if nothing were uncertain any more where it looks. S-MIG's own correlation is minus
this one's.

Adapted, too: cells are 1 m squares of the ground rather than voxels of 5 cm, and each counts once,
not once per ray; a sensor reaches one when it has a point on some vehicle over it in any frame. The
scheme of fusion changes nothing.

kbit is as in `placement_env.fidelity.coverage`, recall is the same figure as AP.
"""

import numpy as np

from placement_env.fidelity.coverage import SentData
from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import Estimate
from placement_env.subsets import MemberSums
from toolkit.boxes import points_in_boxes
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme

CELL = 1.0  # m


class InformationGain:
    """Entropy of vehicle positions that a set removes. From Hu et al.'s metric, with the sign
    turned."""

    name = "information gain"

    def __init__(
        self, visibility: Visibility, scheme: Scheme | str = "early", *, codec: Codec = PAPER
    ) -> None:
        over = _rasterize(visibility.boxes)
        entropy, reached = (
            _cell_entropy(over, visibility),
            (visibility.points > 0).astype(np.float32) @ over > 0,
        )
        uncertain = entropy > 0
        self._entropy = entropy[uncertain].astype(np.float32)
        self._sums = MemberSums(reached[:, uncertain].astype(np.uint16))
        self._sent = SentData(visibility, scheme, codec)

    def __call__(self, subsets: np.ndarray, /) -> Estimate:
        gain, whole = np.zeros(len(subsets)), float(self._entropy.sum())
        for block, reaching in self._sums.blocks(subsets):
            gain[block] = np.where(reaching > 0, self._entropy, 0).sum(axis=1)
        share = gain / whole if whole else gain
        return Estimate(share, share.copy(), self._sent.kbit(subsets))


def _rasterize(boxes: np.ndarray) -> np.ndarray:
    if not len(boxes):
        return np.zeros((0, 0), np.float32)
    low, high = np.floor(boxes[:, :2].min(axis=0) - 3), np.ceil(boxes[:, :2].max(axis=0) + 3)
    x, y = (np.arange(a + CELL / 2, b, CELL) for a, b in zip(low, high, strict=True))
    middles = np.stack(
        [*(each.ravel() for each in np.meshgrid(x, y)), np.zeros(len(x) * len(y))], axis=1
    )
    flat = boxes.copy()
    flat[:, 2], flat[:, 5] = 0.0, 1.0
    return points_in_boxes(middles, flat).T.astype(np.float32)


def _cell_entropy(over: np.ndarray, visibility: Visibility) -> np.ndarray:
    """Entropy (nat) of each cell, from the share of the frames in which some box is over it."""
    occupied = np.zeros((visibility.frames, over.shape[1]), bool)
    np.logical_or.at(occupied, visibility.frame, over > 0)
    p = occupied.mean(axis=0)
    certain = (p == 0) | (p == 1)
    p = np.where(certain, 0.5, p)
    return np.where(certain, 0.0, -p * np.log(p) - (1 - p) * np.log1p(-p))
