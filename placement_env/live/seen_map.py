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

CELL_M = 0.5  # width of a cell
MAP_FRAMES = 48  # frames of the traffic, evenly chosen; at most 64, as each is a bit of a uint64
MAP_HEIGHTS = {"a child": 1.0, "a car": 1.5}  # m above the ground where a place must be seen
MAX_BITS_BYTES = 20_000_000  # memory: 8 bytes for each cell and place of a sensor


@dataclass(frozen=True, eq=False)
class SeenMap:
    """Share of the frames in which sensors see each cell of the detection area.

    Attributes:
        x: Centres of the columns along the site's x axis (m).
        y: Centres of the rows along the site's y axis (m).
        share: Share of the frames (0 to 1) in which some sensor sees the cell, NaN inside
            buildings.
        height: Height above the ground at which the cell is seen (m).
        frames: Number of frames.
    """

    x: Float64[np.ndarray, " nx"]
    y: Float64[np.ndarray, " ny"]
    share: Float32[np.ndarray, "ny nx"]
    height: float
    frames: int


class SeenMaps:
    """Maps of the cells that sensors see at a site, over frames of its traffic.

    preparation: site and traffic; height: height above the ground (m) at which a cell must be
    seen."""

    def __init__(self, preparation: Preparation, height: float) -> None:
        """Lay a grid of cells over the site. height: places to be seen are this high (m)."""
        self._preparation = preparation
        self.height = height
        self._x, self._y, targets, self._open_cells = lay_grid(
            preparation.setting.place, CELL_M, height
        )
        # places that must be seen (n, 3), one for each cell outside buildings
        self._targets = targets[self._open_cells]
        count = min(MAP_FRAMES, preparation.frames)
        # numbers of evenly chosen frames of the traffic
        self._frames = np.linspace(0, preparation.frames - 1, count).round().astype(np.int64)
        self._bits_by_eye = Bounded()  # result of `_visible_frames` by position of the eye

    def draw(self, sensors: Iterable[Sensor]) -> SeenMap:
        """Map of the share of frames in which any sensor sees each cell; NaN in buildings."""
        # a number for each open cell, whose bit k is 1 if it is seen in the k-th frame of the map
        seen_bits = np.zeros(len(self._targets), np.uint64)
        for sensor in sensors:
            visible_bits = self._visible_frames(sensor.position)
            seen_bits |= np.where(self._cells_in_view(sensor), visible_bits, np.uint64(0))
        share = np.full(self._open_cells.shape, np.nan, np.float32)
        share[self._open_cells] = np.bitwise_count(seen_bits) / len(self._frames)
        return SeenMap(self._x, self._y, share, height=self.height, frames=len(self._frames))

    def _cells_in_view(self, sensor: Sensor) -> Bool[np.ndarray, " cells"]:
        """Mask of the open cells in the field of view of a sensor, hidden or not."""
        return np.asarray(sensor.model.in_view(transform(invert(sensor.pose), self._targets)))

    def _visible_frames(self, eye: Float64[np.ndarray, "3"]) -> Shaped[np.ndarray, " cells"]:
        """Frames in which nothing hides each open cell from an eye, as uint64.

        Bit k of a cell is 1 if nothing hides it in the k-th frame of the map. Bits of the latest
        eyes stay in memory. eye: position in the site's frame (m)."""
        key = eye.round(3).tobytes()  # equal to a millimetre
        bits: Shaped[np.ndarray, " cells"] | None = self._bits_by_eye.get(key)
        if bits is None:
            panoramas = self._preparation.live
            # the lock of the panoramas keeps other threads from casting rays meanwhile
            with panoramas.casting if panoramas is not None else nullcontext():
                bits = self._cast_visible_frames(eye)
        # known bits too: they become the latest, and the oldest ones are dropped first
        self._bits_by_eye.keep({key: bits}, MAX_BITS_BYTES)
        return bits

    def _cast_visible_frames(self, eye: Float64[np.ndarray, "3"]) -> Shaped[np.ndarray, " cells"]:
        """Frames in which nothing hides each open cell from an eye, by casting rays to the cells.

        Bit k of a cell is 1 if nothing hides it in the k-th frame of the map. eye: position in the
        site's frame (m)."""
        traffic = self._preparation.traffic
        origins = np.broadcast_to(eye, self._targets.shape)
        # rows of origin and direction; directions are not unit vectors: length 1 reaches the cell
        rays = np.concatenate([origins, self._targets - eye], axis=1).astype(np.float32)
        bits = np.zeros(len(rays), np.uint64)
        # indices of cells that the still scene does not hide; only these may differ by frame
        unhidden_cells = np.flatnonzero(~build_renderer(traffic).still_hides(rays))
        for bit, frame in enumerate(self._frames.tolist()):
            # way to the first vehicle in parts of the ray; from 1 on, none is before the cell
            _, ray_parts = build_moment(traffic, frame).met(rays[unhidden_cells])
            bits[unhidden_cells] |= np.where(ray_parts >= 1, np.uint64(1 << bit), np.uint64(0))
        return bits
