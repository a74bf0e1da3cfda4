"""`HitDomain`: the range of a hit model's training. It tells whether the model is used outside that range."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float, Float32

LITTLE = 0.05  # share of the view that may lie outside without a warning
BEYOND = 1.1  # factor on a range before it counts as exceeded


@dataclass(frozen=True)
class HitDomain:
    """Range of data that a hit model was fitted to.

    farthest: distance (m), the 99 % quantile of everything the sensors saw; most_points: on an object, likewise;
    sensors: kinds of their models, names of classes; sites, objects, sets: their numbers. Raises ValueError where a
    number is not positive.
    """

    farthest: float
    most_points: float
    sensors: tuple[str, ...]
    sites: int
    objects: int
    sets: int

    def __post_init__(self) -> None:
        for name in ("farthest", "most_points", "sites", "objects", "sets"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
                raise ValueError(f"{name} must be a number above 0, got {value!r}")
        if not all(isinstance(name, str) for name in self.sensors):
            raise ValueError(f"sensors must be names of sensor models, got {self.sensors!r}")

    def outside(
        self, points: Float32[np.ndarray, "C O"], distance: Float32[np.ndarray, "C O"], sensors: Iterable[str] = ()
    ) -> tuple[str, ...]:
        """Sentences on how a question differs; empty if not.

        sensors: kinds of models.

        >>> domain = HitDomain(50.0, 900.0, ("DepthCamera",), 1, 10, 5)
        >>> domain.outside(np.float32([[30]]), np.float32([[20]]), ["DepthCamera"])
        ()
        >>> domain.outside(np.float32([[30]]), np.float32([[80]]))
        ('100% of what the candidates see is beyond 50 m, farther than what the surrogate was fitted to',)
        """
        said = []
        seen = points > 0
        for figure, most, words in (
            (distance, self.farthest, "is beyond {:.0f} m, farther than"),
            (points, self.most_points, "has more than {:.0f} points, more than"),
        ):
            share = float((figure[seen] > BEYOND * most).mean()) if seen.any() else 0.0
            if share > LITTLE:
                beyond = words.format(most)
                said.append(f"{share:.0%} of what the candidates see {beyond} what the surrogate was fitted to")
        unlike = sorted(set(sensors) - set(self.sensors))
        if unlike:
            said.append(f"the surrogate was fitted to {', '.join(self.sensors)}, not to {', '.join(unlike)}")
        return tuple(said)


def build_domain(
    points: list[Float[np.ndarray, "_ _"]], distance: list[Float[np.ndarray, "_ _"]], sensors: Iterable[str], sets: int
) -> HitDomain:
    """Domain of the data that sensors of several sites saw."""
    seen = np.concatenate([each[each > 0].ravel() for each in points])
    away = np.concatenate([d[n > 0].ravel() for n, d in zip(points, distance, strict=True)])
    if not len(seen):
        raise ValueError("no sensor has a point on any object, so there is nothing to fit: take more frames or poses")
    most, farthest = float(np.quantile(seen, 0.99)), float(np.quantile(away, 0.99))
    objects = sum(each.shape[1] for each in points)
    return HitDomain(round(farthest, 1), round(most, 1), tuple(sorted(set(sensors))), len(points), objects, sets)
