"""Late fusion: every sensor detects in its own points and sends boxes (paper section II-D).

It is ready when the slowest sensor has cropped and detected, and the boxes are fused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.arrays import Float32
from toolkit.detection.scheme import Counts, Fused, fused
from toolkit.detection.view import View


@dataclass(frozen=True)
class Late:
    """Late fusion."""

    name: str = "late"
    sends_points: ClassVar[bool] = False
    sends_boxes: ClassVar[bool] = True

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect in the points of each sensor and fuse the boxes."""
        sent = [view.send_boxes(view.detect([view.cloud(sensor)])) for sensor in sensors]
        return fused(view.suppressed([each.arrived for each in sent]), [each.bits for each in sent])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """None."""
        return np.zeros_like(counts.sent)

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> None:
        """No points are sent."""
