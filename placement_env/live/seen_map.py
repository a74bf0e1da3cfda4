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

CELL_M = 0.5
MAP_FRAMES = 48  # of the traffic, evenly chosen; a bit of 64 each
MAP_HEIGHTS = {"a child": 1.0, "a car": 1.5}  # m above the ground where a place must be seen
MAX_BITS_BYTES = 20_000_000  # 8 for each cell and place of a sensor in memory


@dataclass(frozen=True, eq=False)
class SeenMap:
    """Share of the frames in which sensors see each cell of the detection area.

    Attributes:
        x: Centres of the columns (m).
        y: Centres of the rows (m).
        share: Share of the frames in which some sensor sees the cell, NaN inside buildings.
        height: Height above the ground at which the cell is seen (m).
        frames: Number of frames.
    """

    x: Float64[np.ndarray, " nx"]
    y: Float64[np.ndarray, " ny"]
    share: Float32[np.ndarray, "ny nx"]
    height: float
    frames: int


class SeenMaps:
    """Maps of what sensors see at a site with traffic, over its frames."""

    def __init__(self, preparation: Preparation, height: float) -> None:
        self._preparation = preparation
        self.height = height
        self._x, self._y, targets, self._open = lay_grid(preparation.setting.place, CELL_M, height)
        self._targets = targets[self._open]
        count = min(MAP_FRAMES, preparation.frames)
        self._frames = np.linspace(0, preparation.frames - 1, count).round().astype(np.int64)
        self._bits = Bounded()  # by eye

    def draw(self, sensors: Iterable[Sensor]) -> SeenMap:
        """Map of some sensors."""
        seen = np.zeros(len(self._targets), np.uint64)
        for sensor in sensors:
            seen |= np.where(self._in_view(sensor), self._find_sight(sensor.position), np.uint64(0))
        share = np.full(self._open.shape, np.nan, np.float32)
        share[self._open] = np.bitwise_count(seen) / len(self._frames)
        return SeenMap(self._x, self._y, share, self.height, len(self._frames))

    def _in_view(self, sensor: Sensor) -> Bool[np.ndarray, " cells"]:
        """Mask of the cells in the field of view of a sensor, hidden or not."""
        return np.asarray(sensor.model.in_view(transform(invert(sensor.pose), self._targets)))

    def _find_sight(self, eye: Float64[np.ndarray, "3"]) -> Shaped[np.ndarray, " cells"]:
        """Frames in which nothing hides each cell from an eye, a bit for each frame.

        Bits of the latest eyes stay in memory."""
        key = eye.round(3).tobytes()
        bits: Shaped[np.ndarray, " cells"] | None = self._bits.get(key)
        if bits is None:
            live = self._preparation.live
            with live.casting if live is not None else nullcontext():
                bits = self._cast_sight(eye)
        self._bits.keep({key: bits}, MAX_BITS_BYTES)
        return bits

    def _cast_sight(self, eye: Float64[np.ndarray, "3"]) -> Shaped[np.ndarray, " cells"]:
        """Bits of `_find_sight`, from rays that end at the cells."""
        traffic = self._preparation.traffic
        origins = np.broadcast_to(eye, self._targets.shape)
        rays = np.concatenate([origins, self._targets - eye], axis=1).astype(np.float32)
        bits = np.zeros(len(rays), np.uint64)
        # the still scene hides a cell in all frames; only the others are asked of each frame
        free = np.flatnonzero(~build_renderer(traffic).still_hides(rays))
        for bit, frame in enumerate(self._frames.tolist()):
            # length of the way to the first vehicle; 1 is the length of the ray
            _, length = build_moment(traffic, frame).met(rays[free])
            bits[free] |= np.where(length >= 1, np.uint64(1 << bit), np.uint64(0))
        return bits
