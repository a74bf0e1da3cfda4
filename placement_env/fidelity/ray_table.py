"""`RayTable`: number of rays in rectangles of azimuth and elevation, for a sensor model at a tilt.

Counts of rays up to a place of a fine grid are summed over both angles once (Crow 1984, a
summed-area table). A rectangle then costs four of these sums, however many rays it holds."""

from itertools import pairwise
from threading import Lock
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.bounded import Bounded
from placement_env.fidelity.cells import CELL_ROWS, find_cells
from placement_env.fidelity.rectangles import AZIMUTHS, ELEVATIONS, PER_STEEP, PER_TURN, Rectangles
from toolkit.arrays import Int64, Shaped
from toolkit.geometry import pose
from toolkit.sensors.sensor import Sensor, SensorModel

TABLE_TILT_STEP_RAD = float(np.deg2rad(1.0))  # rad between the tilts of tables
MAX_TABLE_BYTES = 220_000_000  # memory of the tables kept at a time, 3 to 12 MB each
Counts = Shaped[np.ndarray, " m"]  # rays in each rectangle
RAY_TABLES = Bounded()  # `RayTable` by model, tilt and roll (rad), shared by all threads
_LOCK = Lock()


class Aim(NamedTuple):
    """Angles of a sensor's optical axis in the world (rad)."""

    heading: float  # counter-clockwise from x
    tilt: float  # below the horizon
    roll: float  # about the optical axis


def compute_aim(sensor: Sensor) -> Aim:
    """Heading, tilt and roll of a sensor.

    One that looks straight down or up has roll 0; its heading comes from the y axis of its body,
    that is from the top of its image."""
    turn = sensor.world_SE3_body[:3, :3]
    tilt = float(np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0])))
    if np.hypot(turn[0, 0], turn[1, 0]) < 1e-6:
        return Aim(float(np.arctan2(-turn[0, 1], turn[1, 1])), tilt, 0.0)
    return Aim(
        float(np.arctan2(turn[1, 0], turn[0, 0])), tilt, float(np.arctan2(turn[2, 1], turn[2, 2]))
    )


class Lookup(NamedTuple):
    """Aim of a sensor in the table of rays with the nearest tilt.

    Attributes:
        model: Model of the sensor.
        tilt: Tilt of the table (rad).
        roll: Roll of the table (rad).
        heading: Heading of the sensor, in places of azimuth (`PER_TURN` to a radian).
        more: Places of elevation (`PER_STEEP` to a radian) by which the sensor is tilted more than
            the table, < 0 if it is tilted less."""

    model: SensorModel
    tilt: float
    roll: float
    heading: np.float32
    more: np.float32

    @staticmethod
    def of(sensor: Sensor) -> "Lookup":
        """Aim of a sensor in the table of nearest tilt; nothing is computed before `table`."""
        aim = compute_aim(sensor)
        tilt = round(aim.tilt / TABLE_TILT_STEP_RAD) * TABLE_TILT_STEP_RAD
        more = aim.tilt - tilt if abs(aim.tilt - tilt) >= 1e-6 else 0.0
        turned = np.float32(aim.heading) * PER_TURN
        further = np.float32(more) * PER_STEEP
        # + 0.0 makes -0.0 to 0.0
        return Lookup(sensor.model, tilt, round(aim.roll, 4) + 0.0, turned, further)

    @property
    def table(self) -> "RayTable":
        """Table of rays of this model, tilt and roll, from memory or made now."""
        return get_ray_table(self.model, self.tilt, self.roll)


class RayTable:
    """Number of rays of a model in each direction, tilted and rolled (rad), heading 0.

    Places are as in `rectangles`: azimuth from straight behind on, elevation from straight down.

    Attributes:
        first_column: First place of azimuth with rays.
        columns: Number of places of azimuth from the first to the last with rays.
        first_row: Lowest place of elevation with rays.
        cells: Numbers of the cells (see `cells`) with rays: column * `CELL_ROWS` + row, columns by
            azimuth from the heading.
        cell_rays: Number of rays in each such cell, float32.
        nbytes: Bytes of memory."""

    def __init__(self, model: SensorModel, tilt: float, roll: float) -> None:
        turn = pose(pitch=tilt, roll=roll)[:3, :3] @ model.body_SE3_sensor[:3, :3]
        x, y, z = (model.rays().reshape(-1, 3) @ turn.T).T
        azimuth = np.arctan2(y, x)
        elevation = np.arctan2(z, np.hypot(x, y))
        column = np.floor((azimuth + np.pi) * (AZIMUTHS / (2 * np.pi))).astype(np.int64) % AZIMUTHS
        row = np.clip(
            np.floor((elevation + np.pi / 2) * (ELEVATIONS / np.pi)), 0, ELEVATIONS - 1
        ).astype(np.int64)
        self.first_column = int(column.min())
        self.first_row = int(row.min())
        shape = int(column.max()) - self.first_column + 1, int(row.max()) - self.first_row + 1
        self.columns = shape[0]
        kind = np.uint32 if len(column) >> 16 else np.uint16  # 2 ** 16 rays or more need uint32
        # sums[i, j]: rays in the first i columns and the first j rows of the table
        self._sums = np.zeros((shape[0] + 1, shape[1] + 1), kind)
        flat_cell = (column - self.first_column + 1) * (shape[1] + 1) + row - self.first_row + 1
        np.add.at(self._sums.ravel(), flat_cell, kind(1))
        for before, after in pairwise(
            self._sums
        ):  # row by row, as accumulate along this axis is five times slower
            np.add(before, after, out=after)
        np.add.accumulate(self._sums, axis=1, out=self._sums)
        column, row = find_cells(azimuth, elevation)
        rays = np.bincount(column * CELL_ROWS + row)
        self.cells = np.flatnonzero(rays)
        self.cell_rays = rays[self.cells].astype(np.float32)
        self.nbytes = self._sums.nbytes + self.cells.nbytes + self.cell_rays.nbytes

    def counts(
        self, rectangles: "Rectangles", heading: np.float32, more: np.float32
    ) -> tuple[Int64[np.ndarray, " m"], Counts]:
        """Return the indices of rectangles that hold rays, ascending, and the rays in each.

        Args:
            rectangles: Rectangles of azimuth and elevation of the world.
            heading: Heading of the sensor, in places of azimuth.
            more: Places of elevation by which the sensor is tilted more than the table."""
        left, right, low, high = rectangles.list_places(heading, more)
        begin = np.rint(left).astype(np.int32)
        width = np.rint(right).astype(np.int32) - begin
        begin %= AZIMUTHS
        begin -= self.first_column
        low, up = (np.rint(bound).astype(np.int32) - self.first_row for bound in (low, high))
        last_column = self._sums.shape[0] - 1
        last_row = self._sums.shape[1] - 1
        # before the table's end and beyond its start, or across the seam into its next turn
        reached = (begin < last_column) & (begin + width > 0) | (begin + width > AZIMUTHS)
        reachable = np.flatnonzero(reached & (up > 0) & (low < last_row))
        begin = begin.take(reachable)
        low = np.maximum(low.take(reachable), 0)
        up = np.minimum(up.take(reachable), last_row)
        end = begin + width.take(reachable)
        counts = self._within(np.maximum(begin, 0), np.minimum(end, last_column), low, up)
        wrapped = np.flatnonzero(end > AZIMUTHS)  # across the seam behind the sensor
        if len(wrapped):
            wrapped_end = np.minimum(end[wrapped] - AZIMUTHS, last_column)
            counts[wrapped] += self._within(
                np.zeros_like(wrapped_end), wrapped_end, low[wrapped], up[wrapped]
            )
        hit = np.flatnonzero(counts)
        return reachable[hit], counts[hit]

    def _within(
        self, begin: np.ndarray, end: np.ndarray, low: np.ndarray, up: np.ndarray
    ) -> Counts:
        # rays in columns begin to end and rows low to up of the table, ends excluded; 0 if
        # begin > end. Sums of unsigned integers may wrap in between: the differences are right.
        flat = self._sums.ravel()
        across = self._sums.shape[1]
        begin = np.minimum(begin, end) * across
        end = end * across
        counts: Counts = flat.take(end + up) - flat.take(end + low)
        counts -= flat.take(begin + up) - flat.take(begin + low)
        return counts


def get_ray_table(model: SensorModel, tilt: float, roll: float) -> RayTable:
    """Return the table of a model, tilted and rolled (rad), from memory or made now.

    It stays in memory until newer uses of others fill `MAX_TABLE_BYTES`. Threads wait while one
    makes a table."""
    key = model, tilt, roll
    with _LOCK:
        table: RayTable = RAY_TABLES.get(key) or RayTable(*key)
        RAY_TABLES.keep({key: table}, MAX_TABLE_BYTES)
        return table


def make_table_ahead(model: SensorModel, lowest: float, steepest: float, around: float) -> bool:
    """Make one missing table of roll 0 between two tilts, the nearest to a third first.

    Args:
        model: Model of the rays.
        lowest: Smallest tilt below the horizon (rad).
        steepest: Largest tilt (rad).
        around: Tilt whose nearest tables come first (rad).

    Returns:
        True if a table was made; False if all are there, or memory is 85 % full."""
    steps = range(round(lowest / TABLE_TILT_STEP_RAD), round(steepest / TABLE_TILT_STEP_RAD) + 1)
    for step in sorted(steps, key=lambda tilt_step: abs(tilt_step - around / TABLE_TILT_STEP_RAD)):
        key = (model, step * TABLE_TILT_STEP_RAD, 0.0)
        has_room = RAY_TABLES.nbytes < 0.85 * MAX_TABLE_BYTES
        if key not in RAY_TABLES and has_room:
            get_ray_table(*key)
            return True
    return False
