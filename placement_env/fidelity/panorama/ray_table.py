"""`RayTable`: number of rays in rectangles of azimuth and elevation, for a sensor model at a tilt.

Counts of rays up to a place of a fine grid are summed over both angles once (Crow 1984, a summed-area table). A
rectangle then costs four of these sums, however many rays it holds. Azimuth is measured from the sensor's heading. A
sensor tilted slightly more than a table is looked up in that table, with the rectangles turned by the difference.
"""

from __future__ import annotations

from itertools import pairwise
from threading import Lock
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.panorama.bounded import Bounded
from toolkit.arrays import Float, Float32, Float64, Int64, Shaped
from toolkit.geometry import pose
from toolkit.sensors.sensor import Sensor, SensorModel

AZIMUTHS = 3600  # places of azimuth in a turn
ELEVATIONS = 3600  # places of elevation from straight down to straight up
TABLE_TILTS = float(np.deg2rad(1.0))  # rad between the tilts of tables
MOST_TABLE_BYTES = 400_000_000  # of the tables kept at a time, 3 to 12 MB each
CELL_COLUMNS = 240  # columns of cells over all directions, for the standing scene
CELL_EDGES = np.deg2rad(np.r_[-90.0:-30.0:0.5, -30.0:5.0:0.1, 5.0:90.5:0.5])  # finest towards the horizon
CELL_ROWS = len(CELL_EDGES) - 1

PI, PER_TURN, PER_STEEP = (np.float32(each) for each in (np.pi, AZIMUTHS / (2 * np.pi), ELEVATIONS / np.pi))

Angles = Float[np.ndarray, " n"]
Counts = Shaped[np.ndarray, " m"]  # of rays


class Aim(NamedTuple):
    """Heading, tilt below the horizon and roll about the viewing direction (rad)."""

    heading: float
    tilt: float
    roll: float


def compute_aim(sensor: Sensor) -> Aim:
    """Aim of a sensor; one that looks straight down or up takes its heading from the top of its image.

    >>> from toolkit.geometry import look
    >>> from toolkit.sensors.models import DepthCamera
    >>> np.round(compute_aim(Sensor("c", DepthCamera(), look((0.0, 0.0, 5.0), 1.0, 0.25))), 6).tolist()
    [1.0, 0.25, 0.0]
    """
    turn = sensor.world_SE3_body[:3, :3]
    tilt = float(np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0])))
    if np.hypot(turn[0, 0], turn[1, 0]) < 1e-6:
        return Aim(float(np.arctan2(-turn[0, 1], turn[1, 1])), tilt, 0.0)
    return Aim(float(np.arctan2(turn[1, 0], turn[0, 0])), tilt, float(np.arctan2(turn[2, 1], turn[2, 2])))


class Lookup(NamedTuple):
    """Table of a sensor, and its aim there.

    tilt, roll: of the table (rad); heading: places of azimuth; more: places of elevation by which the sensor is tilted
    more than the table.
    """

    model: SensorModel
    tilt: float
    roll: float
    heading: np.float32
    more: np.float32

    @staticmethod
    def of(sensor: Sensor) -> Lookup:
        """Lookup in the table of nearest tilt."""
        aim = compute_aim(sensor)
        tilt = round(aim.tilt / TABLE_TILTS) * TABLE_TILTS
        more = aim.tilt - tilt if abs(aim.tilt - tilt) >= 1e-6 else 0.0
        turned, further = np.float32(aim.heading) * PER_TURN, np.float32(more) * PER_STEEP
        return Lookup(sensor.model, tilt, round(aim.roll, 4) + 0.0, turned, further)

    @property
    def table(self) -> RayTable:
        """The table, made once."""
        return ray_table(self.model, self.tilt, self.roll)


class RayTable:
    """Rays of a model, tilted and rolled (rad).

    first_column, columns: places of azimuth with rays; first_row: the lowest of elevation; cells, cell_rays: cells with
    rays (column after column, azimuth from the heading), for uses that need no fine grid, and number of rays in each;
    nbytes: of memory.
    """

    def __init__(self, model: SensorModel, tilt: float, roll: float) -> None:
        turn = pose(pitch=tilt, roll=roll)[:3, :3] @ model.body_SE3_sensor[:3, :3]
        x, y, z = (model.rays().reshape(-1, 3) @ turn.T).T
        azimuth, elevation = np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))
        column = np.floor((azimuth + np.pi) * (AZIMUTHS / (2 * np.pi))).astype(np.int64) % AZIMUTHS
        row = np.clip(np.floor((elevation + np.pi / 2) * (ELEVATIONS / np.pi)), 0, ELEVATIONS - 1).astype(np.int64)
        self.first_column, self.first_row = int(column.min()), int(row.min())
        shape = int(column.max()) - self.first_column + 1, int(row.max()) - self.first_row + 1
        self.columns = shape[0]
        place = (column - self.first_column) * shape[1] + row - self.first_row
        kind = np.uint32 if len(column) >> 16 else np.uint16
        counts = np.bincount(place, minlength=shape[0] * shape[1]).astype(kind).reshape(shape)
        for before, after in pairwise(counts):  # row by row, as accumulate along this axis is five times slower
            np.add(before, after, out=after)
        self._sums = np.zeros((shape[0] + 1, shape[1] + 1), kind)
        np.add.accumulate(counts, axis=1, out=self._sums[1:, 1:])
        column, row = find_cells(azimuth, elevation)
        rays = np.bincount(column * CELL_ROWS + row)
        self.cells = np.flatnonzero(rays)
        self.cell_rays = rays[self.cells].astype(np.float32)
        self.nbytes = self._sums.nbytes + self.cells.nbytes + self.cell_rays.nbytes

    def counts(
        self, rectangles: Rectangles, heading: np.float32, more: np.float32
    ) -> tuple[Int64[np.ndarray, " m"], Counts]:
        """Rectangles that hold rays, and their number. heading, more: of the sensor, as of `Lookup`."""
        left, right, low, high = rectangles.list_places(heading, more)
        begin = np.rint(left).astype(np.int32)
        width = np.rint(right).astype(np.int32) - begin
        begin %= AZIMUTHS
        begin -= self.first_column
        low, up = (np.rint(each).astype(np.int32) - self.first_row for each in (low, high))
        most, upmost = self._sums.shape[0] - 1, self._sums.shape[1] - 1
        reached = (begin < most) & (begin + width > 0) | (begin + width > AZIMUTHS)
        some = np.flatnonzero(reached & (up > 0) & (low < upmost))
        begin, low, up = begin.take(some), np.maximum(low.take(some), 0), np.minimum(up.take(some), upmost)
        end = begin + width.take(some)
        counts = self._within(np.maximum(begin, 0), np.minimum(end, most), low, up)
        beyond = np.flatnonzero(end > AZIMUTHS)  # across the seam behind the sensor
        if len(beyond):
            over = np.minimum(end[beyond] - AZIMUTHS, most)
            counts[beyond] += self._within(np.zeros_like(over), over, low[beyond], up[beyond])
        held = np.flatnonzero(counts)
        return some[held], counts[held]

    def _within(self, begin: np.ndarray, end: np.ndarray, low: np.ndarray, up: np.ndarray) -> Counts:
        flat, across = self._sums.ravel(), self._sums.shape[1]
        begin, end = np.minimum(begin, end) * across, end * across
        counts: Counts = flat.take(end + up) - flat.take(end + low)
        counts -= flat.take(begin + up) - flat.take(begin + low)
        return counts


_TABLES = Bounded()  # by model, tilt and roll
_LOCK = Lock()


def ray_table(model: SensorModel, tilt: float, roll: float) -> RayTable:
    """Return the table of a model, tilted and rolled (rad), made once as long as `MOST_TABLE_BYTES` hold it."""
    key = model, tilt, roll
    with _LOCK:
        table: RayTable = _TABLES.get(key) or RayTable(*key)
        _TABLES.keep({key: table}, MOST_TABLE_BYTES)
        return table


def make_table_ahead(model: SensorModel, lowest: float, steepest: float) -> bool:
    """Make one of the tables that lack between two tilts (rad). False where none does, or memory is half full."""
    for step in range(round(lowest / TABLE_TILTS), round(steepest / TABLE_TILTS) + 1):
        if (key := (model, step * TABLE_TILTS, 0.0)) not in _TABLES and _TABLES.nbytes < MOST_TABLE_BYTES / 2:
            ray_table(*key)
            return True
    return False


class Rectangles(NamedTuple):
    """Rectangles of azimuth and elevation of the world.

    left, right: in places of azimuth, right up to a turn farther; low, high: in places of elevation; cos, sin: of the
    azimuth of the middle; tan: of its elevation, but no steeper than 3.
    """

    left: Float32[np.ndarray, " n"]
    right: Float32[np.ndarray, " n"]
    low: Float32[np.ndarray, " n"]
    high: Float32[np.ndarray, " n"]
    cos: Float32[np.ndarray, " n"]
    sin: Float32[np.ndarray, " n"]
    tan: Float32[np.ndarray, " n"]

    @staticmethod
    def of(left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray) -> Rectangles:
        """Build from angles (n,) (rad, float32)."""
        middle, tan = (left + right) / 2, np.clip(np.tan((bottom + top) / 2), -3, 3)
        azimuths = (left + PI) * PER_TURN, (right + PI) * PER_TURN
        elevations = (bottom + PI / 2) * PER_STEEP, (top + PI / 2) * PER_STEEP
        return Rectangles(*azimuths, *elevations, np.cos(middle), np.sin(middle), tan)

    def list_places(self, heading: np.float32, more: np.float32) -> tuple[np.ndarray, ...]:
        """Left, right, low and high from the heading on, to first order in the extra tilt of the middle."""
        left, right = self.left - heading, self.right - heading
        if not more:
            return left, right, self.low, self.high
        angle = heading / PER_TURN
        cos, sin = np.cos(angle), np.sin(angle)
        up = more * (self.cos * cos + self.sin * sin)
        aside = (more * PER_TURN / PER_STEEP) * self.tan * (self.sin * cos - self.cos * sin)
        return left + aside, right + aside, self.low + up, self.high + up


def find_cells(azimuth: Angles, elevation: Angles) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Column and row of the cells of directions."""
    column = np.floor((azimuth + np.pi) * (CELL_COLUMNS / (2 * np.pi))).astype(np.int64) % CELL_COLUMNS
    return column, np.clip(np.searchsorted(CELL_EDGES, elevation, side="right") - 1, 0, CELL_ROWS - 1)


def cell_elevations() -> Float64[np.ndarray, " rows"]:
    """Elevations of the middle of each row of cells."""
    return (CELL_EDGES[1:] + CELL_EDGES[:-1]) / 2
