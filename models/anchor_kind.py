"""`AnchorKind`: anchors of one class."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class AnchorKind:
    """Anchors of one class: in every cell, one for each yaw.

    Raises ValueError for impossible values.

    Attributes:
        label: Class.
        size: Length, width and height (m).
        z: Height of the centres (m).
        yaws: Yaw of each anchor of a cell (rad).
        margin: Metres by which length and width of anchors and objects grow during matching, so
            that a small object matches more than one anchor.
        positive: IoU threshold of positive anchors in that matching.
        negative: IoU threshold of negative anchors in that matching.
    """

    label: str
    size: tuple[float, float, float]
    z: float
    yaws: tuple[float, ...] = (0.0, math.pi / 2)
    margin: float = 0.0
    positive: float = 0.5
    negative: float = 0.35

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is out of range."""
        if len(self.size) != 3 or min(self.size) <= 0 or not self.yaws:
            raise ValueError(
                f"anchors need three sizes above 0 and a yaw, got {self.size} and {self.yaws}"
            )
        if self.margin < 0 or not 0 <= self.negative <= self.positive <= 1:
            got = f"got {self.margin}, {self.negative} and {self.positive}"
            raise ValueError(
                f"anchors need a margin of at least 0 and 0 <= negative <= positive <= 1, {got}"
            )
