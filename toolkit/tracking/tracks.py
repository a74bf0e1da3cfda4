"""`Tracks`: road users at one instant, with what is known of their motion."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, Shaped
from toolkit.frozen import set_fields
from toolkit.objects import Detections


@dataclass(frozen=True)
class Tracks(Detections):
    """Tracked road users at one instant: detections with identity and motion.

    Attributes:
        boxes: (n, 7), see `toolkit.boxes`.
        scores: (n,), confidence of each track now; higher is surer.
        labels: Class numbers of `toolkit.objects.LABELS`.
        doubts: (n, 5), expected error (m) of the front, rear, left, right and top face.
        ids: (n,), number of each track; none is used for a second road user.
        velocities: (n, 3), m/s along x, y and z of the world.
        ages: (n,), seconds since the first detection.
        unseen: (n,), seconds since the last detection; 0 for a track that is detected now.
    """

    ids: Shaped[np.ndarray, " n"] = None  # type: ignore[assignment]  # None: 0..n-1
    velocities: Shaped[np.ndarray, "n 3"] = None  # type: ignore[assignment]  # None: standing
    ages: Shaped[np.ndarray, " n"] = None  # type: ignore[assignment]  # None: 0
    unseen: Shaped[np.ndarray, " n"] = None  # type: ignore[assignment]  # None: 0

    def __post_init__(self) -> None:
        """Turn the fields into arrays, None into defaults. Raises ValueError for wrong shapes.

        The defaults are ids from 0 on, and tracks at rest, of age 0 and just detected."""
        super().__post_init__()
        count = len(self.boxes)
        ids = np.arange(count) if self.ids is None else np.asarray(self.ids, np.int64)
        velocities = np.zeros((count, 3)) if self.velocities is None else self.velocities
        ages = np.zeros(count) if self.ages is None else self.ages
        unseen = np.zeros(count) if self.unseen is None else self.unseen
        columns = {
            "ids": ids,
            "velocities": np.asarray(velocities, np.float64),
            "ages": np.asarray(ages, np.float64),
            "unseen": np.asarray(unseen, np.float64),
        }
        for name, column in columns.items():
            shape = (count, 3) if name == "velocities" else (count,)
            if column.shape != shape:
                raise ValueError(f"{name} must have shape {shape}, got {column.shape}")
        set_fields(self, **columns)

    @property
    def speeds(self) -> Float64[np.ndarray, " n"]:
        """Horizontal speed of each track (m/s)."""
        return np.hypot(self.velocities[:, 0], self.velocities[:, 1])

    @staticmethod
    def empty() -> "Tracks":
        """Tracks without any row."""
        return Tracks(np.zeros((0, 7)), np.zeros(0))
