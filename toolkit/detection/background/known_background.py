"""`KnownBackground`: a detector whose sensors stand still and know their site empty.

What a detector takes for somebody and is a part of the site stands there in every frame: a bush, a container, a gap in
a hedge. Of a road user most points are not where the empty site has its own, so a detection that holds hardly any other
points is left out. It costs no recall but for who was there while the site was learnt and never left.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Bool, Float
from toolkit.boxes import count_points
from toolkit.detection.background.background import Background
from toolkit.detection.provenance import detector_origin
from toolkit.objects import Detections, Detector, UnionDetector
from toolkit.points import union_of

LEAST_NEW = 0.2  # share of the points in a box that the background does not hold, from which on somebody is in it


@dataclass(frozen=True)
class KnownBackground:
    """A detector less its detections of what stands still; points in the frame of the background.

    least: share of the points in a detection's box that are not background, below which it is left out. Raises
    ValueError for one outside 0 to 1.
    """

    detector: Detector
    background: Background
    least: float = LEAST_NEW

    def __post_init__(self) -> None:
        if not 0 < self.least <= 1:
            raise ValueError(f"least must be a share above 0, at most 1, got {self.least}: such as {LEAST_NEW}")

    @property
    def __name__(self) -> str:
        """What results call it: kind of the detector, and that it knows its background."""
        return f"{detector_origin(self.detector)['detector']}+background"

    @property
    def labels(self) -> tuple[str, ...]:
        """Classes that the detector says it knows; there are none (AttributeError) where it does not say."""
        return self.detector.labels  # type: ignore[attr-defined]

    @property
    def digest(self) -> str:
        """SHA-256 of what the detections depend on; there is none (AttributeError) where the detector has none."""
        own = self.detector.digest  # type: ignore[attr-defined]
        return hashlib.sha256(repr((own, self.background.digest, self.least)).encode()).hexdigest()

    def __call__(self, points: Float[np.ndarray, "n 3"], /) -> Detections:
        """Detect; points: (n, 3), those that are not finite count for nobody."""
        found = self.detector(points)
        return found[self.somebody(found, points)]

    def unions(self, clouds: Sequence[Float[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "U C"]) -> list[Detections]:
        """Detect in many unions of the same clouds, at once if the detector can."""
        if isinstance(self.detector, UnionDetector):
            found = self.detector.unions(clouds, unions)
        else:
            found = [self.detector(union_of(clouds, union)) for union in unions]
        new = [self._new(cloud) for cloud in clouds]
        somebody = (
            self._filled(each, union_of(clouds, union), union_of(new, union))
            for each, union in zip(found, unions, strict=True)
        )
        return [each[rows] for each, rows in zip(found, somebody, strict=True)]

    def somebody(self, found: Detections, points: Float[np.ndarray, "p 3"]) -> Bool[np.ndarray, " n"]:
        """Which detections hold enough points, and one at least, that are not background."""
        return self._filled(found, points, self._new(points)) if len(found) else np.zeros(0, bool)

    def _new(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "q 3"]:
        """The points that are not background."""
        finite = points[np.isfinite(points).all(axis=1)]
        return finite[~self.background.holds(finite)]

    def _filled(
        self, found: Detections, points: Float[np.ndarray, "p 3"], new: Float[np.ndarray, "q 3"]
    ) -> Bool[np.ndarray, " n"]:
        there, not_background = count_points(points, found.boxes), count_points(new, found.boxes)
        return np.asarray((not_background > 0) & (not_background >= self.least * there))
