"""`KeptDetections`: a detector that is asked once for each cloud.

Under most conditions most sensors measure what they measure under others, and boxes of one sensor are the same however
points are sent, so that most clouds come again. Kept on disk as well, a stress test that was killed goes on where it
was, and one with other schemes, levels or IoU thresholds asks only for what is new.
"""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from toolkit.arrays import Float32
from toolkit.objects import Detections, Detector, known_labels
from toolkit.runtime.cache import Cache, key_of
from toolkit.runtime.code_digest import code_digest


class KeptDetections:
    """detector: asked where nothing is kept; cache: what is kept, None for memory alone.

    Raises ValueError for a cache with a path and a detector without the attribute `digest`.
    """

    def __init__(self, detector: Detector, cache: Cache | None = None) -> None:
        digest, self._cache, self.asked = getattr(detector, "digest", None), Cache() if cache is None else cache, 0
        if digest is None and self._cache.path is not None:
            raise ValueError(
                "to keep what a detector says, it needs an attribute digest, a text that changes with all it depends "
                "on: add one, or keep nothing"
            )
        self.labels = known_labels(detector)
        self._detector, self._depends_on = detector, [digest, code_digest(type(detector).__module__)]

    @staticmethod
    def of(detector: Detector) -> KeptDetections:
        """The detector itself where it keeps already, else one that keeps in memory."""
        return detector if isinstance(detector, KeptDetections) else KeptDetections(detector)

    def __call__(self, points: Float32[np.ndarray, "n 3"], /) -> Detections:
        """What the detector says of these points, in this order."""
        content = sha256(np.ascontiguousarray(points).tobytes()).hexdigest()
        key = key_of("detections", *self._depends_on, len(points), content)
        kept = self._cache.get([key])[0]
        if kept is None:
            self.asked += 1
            detections = self._detector(points)
            kept = detections.boxes, detections.scores, detections.labels
            self._cache.put({key: kept})
        return Detections(*kept)
