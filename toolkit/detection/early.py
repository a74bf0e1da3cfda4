"""Early fusion: every sensor sends its points, and the points together go through the detector (paper section II-C).

It is ready when the slowest sensor has cropped and the detector has run.
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
class Early:
    """Early fusion."""

    name: str = "early"
    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = False

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect once in the points of all sensors together."""
        sent = [view.send_points(view.cloud(sensor)) for sensor in sensors]
        centre = view.detect([each.arrived for each in sent])
        return fused(view.suppressed([centre]), [each.bits for each in sent])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """All points in the crop."""
        return counts.sent

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> None:
        """No boxes are sent."""
