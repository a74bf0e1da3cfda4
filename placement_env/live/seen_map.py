"""`SeenMap`: share of the time that each half metre of ground is seen, past the site and through
its traffic."""

from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np

from placement_env.fidelity.bounded import Bounded
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.surround import build_moment
from placement_env.fidelity.traffic import build_renderer
from placement_env.handover.ground import lay_grid
from toolkit.arrays import Bool, Float32, Float64, Shaped
from toolkit.geometry import invert, transform
from toolkit.sensors.sensor import Sensor

CELL = 0.5  # m
MAP_FRAMES = 48  # of the traffic, evenly chosen; a bit of 64 each
MAP_HEIGHTS = {"a child": 1.0, "a car": 1.5}  # m above the ground where a place must be seen
KEPT_BYTES = 20_000_000  # of places of sensors in memory, 8 a cell


@dataclass(frozen=True, eq=False)
class SeenMap:
    """Cells of the detection area. x, y: centres of columns and rows (m); share: of the frames in
    which some sensor sees the cell at `height` (m), NaN where nothing can be seen, as in buildings;
    frames: their number."""

    x: Float64[np.ndarray, " nx"]
    y: Float64[np.ndarray, " ny"]
    share: Float32[np.ndarray, "ny nx"]
    height: float
    frames: int


class SeenMaps:
    """Maps of sensors at a site with traffic. What is in sight of a place is worked out once."""

    def __init__(self, preparation: Preparation, height: float) -> None:
        self._preparation = preparation
        self.height = height
        self._x, self._y, targets, self._open = lay_grid(preparation.setting.place, CELL, height)
        self._targets = targets[self._open]
        count = min(MAP_FRAMES, preparation.frames)
        self._frames = np.linspace(0, preparation.frames - 1, count).round().astype(np.int64)
        self._kept = Bounded()  # bits by place

    def draw(self, sensors: Iterable[Sensor]) -> SeenMap:
        """Map of some sensors."""
        seen = np.zeros(len(self._targets), np.uint64)
        for sensor in sensors:
            seen |= np.where(self._in_view(sensor), self._in_sight(sensor.position), np.uint64(0))
        share = np.full(self._open.shape, np.nan, np.float32)
        share[self._open] = np.bitwise_count(seen) / len(self._frames)
        return SeenMap(self._x, self._y, share, self.height, len(self._frames))

    def _in_view(self, sensor: Sensor) -> Bool[np.ndarray, " cells"]:
        return np.asarray(sensor.model.in_view(transform(invert(sensor.pose), self._targets)))

    def _in_sight(self, eye: Float64[np.ndarray, "3"]) -> Shaped[np.ndarray, " cells"]:
        """A bit for each frame in which the way from a place to each cell is free."""
        key = eye.round(3).tobytes()
        bits: Shaped[np.ndarray, " cells"] | None = self._kept.get(key)
        if bits is None:
            live = self._preparation.live
            traffic = self._preparation.traffic
            with live.casting if live is not None else nullcontext():
                ways = np.concatenate(
                    [np.broadcast_to(eye, self._targets.shape), self._targets - eye], axis=1
                )
                lines = ways.astype(np.float32)
                free = np.flatnonzero(~build_renderer(traffic).still_hides(lines))
                bits = np.zeros(len(lines), np.uint64)
                for bit, frame in enumerate(self._frames.tolist()):
                    _, length = build_moment(traffic, frame).met(lines[free])
                    bits[free] |= np.where(length >= 1, np.uint64(1 << bit), np.uint64(0))
        self._kept.keep({key: bits}, KEPT_BYTES)
        return bits
