"""`SceneAdaptation`: an empty scene that follows slow changes, and does not learn who parks.

Each image moves the scene, pixel by pixel:

    shows the scene    the median and the spread of the mode it shows move towards it, by 1 - exp(-dt / `seconds`)
    stands nearer      the scene is frozen; what stands there unchanged for `settle` becomes it
    lies farther       what was there has gone, since nothing is seen through it: it becomes the scene when it was there
                       unchanged for `reveal`

Unchanged is what stays within the tolerance of `EmptyScene.shows`, by the spread of the scene. Who passes before it
hides it and interrupts nothing; whatever lies farther begins anew. Nothing returned lies farther than any return.

Sensor and centre need the same scene: a message says by whose digest it was made, so a new scene is sent before it is
used, and `scene` is asked for as often as that is worth it.
"""

from __future__ import annotations

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64
from toolkit.calibration.empty_scene import SIGMAS, EmptyScene
from toolkit.sensors.sensor import returned

SECONDS = 600.0  # time constant of what shows the scene
SETTLE = 86_400.0  # s until what stands nearer is the scene: longer than anybody parks for a visit
REVEAL = 60.0  # s until what lies farther is


class SceneAdaptation:
    """Begins with an empty scene; times in s. Raises ValueError for times that are not above 0."""

    def __init__(
        self, scene: EmptyScene, *, seconds: float = SECONDS, settle: float = SETTLE, reveal: float = REVEAL
    ) -> None:
        for name, value in (("seconds", seconds), ("settle", settle), ("reveal", reveal)):
            if not value > 0:
                raise ValueError(f"{name} must be above 0 s, got {value}")
        self._began, self._seconds, self._settle, self._reveal = scene, seconds, settle, reveal
        self._medians = [np.array(scene.first), np.array(scene.second)]
        self._spreads = [np.array(scene.spread), np.array(scene.second_spread)]
        self._candidate = np.full(scene.first.shape, np.nan, np.float32)  # infinite for nothing returned
        self._since = np.full(scene.first.shape, np.inf)
        self._time: float | None = None
        self._frames = 0

    @property
    def scene(self) -> EmptyScene:
        """The empty scene as it is now."""
        began = self._began
        (first, second), (spread, second_spread) = ([each.copy() for each in pair] for pair in self._modes)
        share, second_share = np.array(began.share), np.where(np.isnan(second), 0, began.second_share)
        return EmptyScene(
            began.name, began.model, first, spread, share, second, second_spread, second_share.astype(np.float32),
            began.frames + self._frames,
        )  # fmt: skip

    def update(self, measurement: Float[np.ndarray, "rows columns"], time: float) -> None:
        """One more image. Raises ValueError for one of another shape, or a time before the last one."""
        if measurement.shape != self._candidate.shape:
            raise ValueError(f"the empty scene has {self._candidate.shape} pixels, got an image of {measurement.shape}")
        if self._time is not None and time < self._time:
            raise ValueError(f"images come in the order of their times, got {time} s after {self._time} s")
        share = 0.0 if self._time is None else 1 - np.exp(-(time - self._time) / self._seconds)
        self._time, self._frames = time, self._frames + 1
        there = returned(measurement, self._began.model.max_range)
        seen = np.where(there, measurement, np.inf).astype(np.float32)
        shown = np.zeros(seen.shape, bool)
        for median, spread in zip(*self._modes, strict=True):
            shown |= self._moved(median, spread, seen, share)
        self._taken_in(seen, shown, time)

    @property
    def _modes(self) -> tuple[list[Float32[np.ndarray, "rows columns"]], list[Float32[np.ndarray, "rows columns"]]]:
        return self._medians, self._spreads

    def _moved(
        self,
        median: Float32[np.ndarray, "rows columns"],
        spread: Float32[np.ndarray, "rows columns"],
        seen: Float32[np.ndarray, "rows columns"],
        share: float,
    ) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels show a mode; their median and spread follow."""
        finite = np.isfinite(seen)
        off = np.where(finite, seen, 0) - median
        shows = finite & (median > 0) & (np.abs(off) <= SIGMAS * spread)
        median[shows] += share * off[shows]
        least = np.broadcast_to(self._began.model.deviation(np.nan_to_num(median)), median.shape)
        squared = (1 - share) * spread[shows] ** 2 + share * off[shows] ** 2
        spread[shows] = np.maximum(np.sqrt(squared), least[shows])
        return shows | (~finite & (median == 0))

    def _taken_in(
        self, seen: Float32[np.ndarray, "rows columns"], shown: Bool[np.ndarray, "rows columns"], time: float
    ) -> None:
        """What stands out begins to count, goes on, or becomes the scene."""
        first, spread = self._medians[0], self._spreads[0]
        surface = np.where(first > 0, first, np.inf)
        known = np.where(np.isfinite(self._candidate), self._candidate, 0)
        within = SIGMAS * np.maximum(spread, self._began.model.deviation(known))
        with np.errstate(invalid="ignore"):
            same = (np.abs(seen - self._candidate) <= within) | (np.isinf(seen) & np.isinf(self._candidate))
            hidden = seen < self._candidate - within
        goes_on = np.isfinite(self._since) & (same | (hidden & ~shown))
        begins = ~shown & ~goes_on
        self._candidate = np.where(goes_on, self._candidate, np.where(begins, seen, np.nan)).astype(np.float32)
        self._since = np.where(goes_on, self._since, np.where(begins, time, np.inf))
        farther = self._candidate > surface
        waited: Float64[np.ndarray, "rows columns"] = time - self._since
        ripe = goes_on & same & (waited >= np.where(farther, self._reveal, self._settle))
        if ripe.any():
            gone = np.isinf(self._candidate) & ripe
            first[ripe] = np.where(gone, 0, self._candidate)[ripe]
            spread[ripe] = np.where(gone, 0, np.broadcast_to(self._began.model.deviation(known), first.shape))[ripe]
            self._medians[1][ripe], self._spreads[1][ripe] = np.nan, 0
            self._candidate[ripe], self._since[ripe] = np.nan, np.inf
