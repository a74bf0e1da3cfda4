"""`Coverage`: score sensor sets by the share of objects that enough of their sensors see well
enough.

With `views` 1 it is monotone and submodular, so greedy search is within 1 - 1/e of the best set.
The AP of a detector is not submodular, nor is the worst of several classes."""

import numpy as np

from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.visibility import Visibility
from placement_env.protocol import ClassEstimates, Estimate
from placement_env.subsets import MemberSums, Sets, sum_figures
from toolkit.arrays import Float64
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme, estimate_bits, scheme_codec
from toolkit.detection.schemes import find_scheme

LEAST = 20.0  # points on a vehicle that make a view


class SentData:
    """Data that sensor sets send, if each sensor sends a box for every object that it sees.

    Args:
        visibility: Points of the candidates on objects, and points sent.
        scheme: Fusion scheme, or its name.
        codec: Codec of the data.
        min_points: Points on an object from which a sensor sends a box."""

    def __init__(
        self,
        visibility: Visibility,
        scheme: Scheme | str,
        codec: Codec = PAPER,
        min_points: float = LEAST,
    ) -> None:
        """Estimate what each candidate sends.

        min_points: points from which an object is seen."""
        # boxes that each candidate sends in all frames
        boxes = (visibility.points >= min_points).sum(axis=1).astype(np.float64)
        self._bits = estimate_bits(find_scheme(scheme), codec, visibility, boxes)
        self._frames = visibility.frames

    def kbit(self, subsets: Sets) -> Float64[np.ndarray, " n"]:
        """Data of each set (kbit per frame, mean of all frames)."""
        return sum_figures(subsets, self._bits) / (1000 * self._frames)


def sent_per_frame(
    visibility: Visibility, scheme: Scheme, codec: Codec
) -> Float64[np.ndarray, "candidates frames"]:
    """Data that each candidate (row) sends in each frame (column), in kbit.

    In schemes that send boxes, a candidate sends one for each object that it has `LEAST` points or
    more on."""
    boxes = np.zeros((len(visibility), visibility.frames))  # boxes sent, by candidate and frame
    if scheme.sends_boxes:
        for candidate_boxes, points in zip(boxes, visibility.points, strict=True):
            frames_of_seen = visibility.frame[points >= LEAST]
            candidate_boxes += np.bincount(frames_of_seen, minlength=visibility.frames)
    sent_points = scheme.sent_points(visibility).astype(np.float64)
    bits = scheme_codec(scheme, codec).bits(points=sent_points, boxes=boxes)
    return np.asarray(bits / 1000, np.float64)


class Coverage:
    """Score sets by the share of objects that enough of their sensors see well enough.

    This share is given as AP and as recall; kbit are as in `SentData`.

    Args:
        visibility: Points of the candidates on objects.
        scheme: Fusion scheme, or its name, for the data sent.
        min_points: Points on an object from which a sensor sees it.
        views: Number of sensors that must see an object.
        codec: Codec of the data sent.
        classes: Classes of the objects that count; the shares of several are combined.

    Raises ValueError for `min_points` that is not positive or fewer views than 1."""

    name = "coverage"

    def __init__(
        self,
        visibility: Visibility,
        scheme: Scheme | str = "early",
        *,
        min_points: float = LEAST,
        views: int = 1,
        codec: Codec = PAPER,
        classes: Classes = VEHICLES,
    ) -> None:
        """Find which candidates see each object of the classes.

        min_points: points from which a sensor sees an object; views: sensors that must see it, to
        cover it. Raises ValueError if either number is too small."""
        if not 0 < min_points < np.inf or views < 1 or views != int(views):
            raise ValueError(
                f"a view needs more than 0 points and a set 1 view or more, got {min_points} and "
                f"{views}"
            )
        counted_visibility = visibility.of_classes(classes.labels)
        self.views = views
        self.classes = classes
        # sums over a set are the number of its sensors that see each object
        self._view_sums = MemberSums((counted_visibility.points >= min_points).astype(np.uint16))
        self._sent = SentData(
            visibility=counted_visibility, scheme=scheme, codec=codec, min_points=min_points
        )
        masks = [counted_visibility.labels == label for label in classes.labels]
        # for each class, the columns of its objects and their number
        self._class_columns = [
            (slice(None) if mask.all() else np.flatnonzero(mask), int(mask.sum())) for mask in masks
        ]

    def __call__(self, subsets: Sets, /) -> Estimate:
        """Share of objects that each set covers, classes combined; 0 without an object."""
        return self.by_class(subsets).combined(self.classes).without_nan()

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """Share of the objects of each class that each set covers; NaN if the class has none."""
        share = np.full((len(subsets), len(self.classes)), np.nan)
        # block: slice of sets; view_counts: sensors of each set (row) that see each object
        for block, view_counts in self._view_sums.blocks(subsets):
            for k, (columns, count) in enumerate(self._class_columns):
                if count:
                    # `self.views`: number of sensors that must see an object
                    share[block, k] = (view_counts[:, columns] >= self.views).sum(axis=1) / count
        return ClassEstimates(ap=share, recall=share.copy(), kbit=self._sent.kbit(subsets))
