"""`RayTable`: number of rays in rectangles of azimuth and elevation, for a sensor model at a tilt.

Counts of rays up to a place of a fine grid are summed over both angles once (Crow 1984, a
summed-area table). A rectangle then costs four sums, however many rays it holds."""

from itertools import pairwise
from threading import Lock
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.bounded import Bounded
from placement_env.fidelity.cells import CELL_ROWS, find_cells
from placement_env.fidelity.rectangles import (
    AZIMUTHS,
    AZIMUTHS_PER_RAD,
    ELEVATIONS,
    ELEVATIONS_PER_RAD,
    Rectangles,
)
from toolkit.arrays import Int64, Shaped
from toolkit.geometry import pose
from toolkit.sensors.sensor import Sensor, SensorModel

TABLE_TILT_STEP_RAD = float(np.deg2rad(1.0))  # rad between the tilts of tables
MAX_TABLE_BYTES = 220_000_000  # memory of the tables kept at a time, 3 to 12 MB each
MAX_AHEAD_SHARE = 0.85  # share of this memory that tables made ahead may fill
Counts = Shaped[np.ndarray, " m"]  # rays in each rectangle
RAY_TABLES = Bounded()  # `RayTable` by model, tilt and roll (rad), shared by all threads
_LOCK = Lock()


class Aim(NamedTuple):
    """Angles of a sensor's optical axis in the world (rad).

    Attributes:
        heading: Counter-clockwise from x.
        tilt: Below the horizon.
        roll: About the optical axis."""

    heading: float
    tilt: float
    roll: float


def compute_aim(sensor: Sensor) -> Aim:
    """Heading, tilt and roll of a sensor.

    One that looks straight down or up has roll 0; its heading comes from the y axis of its body,
    that is from the top of its image."""
    turn = sensor.world_SE3_body[:3, :3]  # columns: forward (optical axis), left and up
    x, y, z = turn[:, 0].tolist()  # optical axis
    horizontal_length = np.hypot(x, y)
    tilt = float(np.arctan2(-z, horizontal_length))
    if horizontal_length < 1e-6:
        # the left axis is horizontal, a quarter turn counter-clockwise from the heading
        left_x, left_y = turn[:2, 1].tolist()
        return Aim(heading=float(np.arctan2(-left_x, left_y)), tilt=tilt, roll=0.0)
    left_z, up_z = turn[2, 1:].tolist()
    return Aim(heading=float(np.arctan2(y, x)), tilt=tilt, roll=float(np.arctan2(left_z, up_z)))


class Lookup(NamedTuple):
    """Aim of a sensor in the table of rays with the nearest tilt.

    Attributes:
        model: Model of the sensor.
        tilt: Tilt of the table (rad).
        roll: Roll of the table (rad).
        heading: Heading of the sensor, in places of azimuth (`AZIMUTHS_PER_RAD` to a radian).
        extra_tilt: Places of elevation (`ELEVATIONS_PER_RAD` to a radian) by which the sensor is
            tilted more than the table, < 0 if it is tilted less."""

    model: SensorModel
    tilt: float
    roll: float
    heading: np.float32
    extra_tilt: np.float32

    @staticmethod
    def from_sensor(sensor: Sensor) -> "Lookup":
        """Aim of a sensor in the table of rays with the nearest tilt.

        The table is made when `table` is first read."""
        aim = compute_aim(sensor)
        table_tilt = round(aim.tilt / TABLE_TILT_STEP_RAD) * TABLE_TILT_STEP_RAD
        extra_tilt_rad = aim.tilt - table_tilt
        if abs(extra_tilt_rad) < 1e-6:  # rounding
            extra_tilt_rad = 0.0
        return Lookup(
            model=sensor.model,
            tilt=table_tilt,
            # heading and extra tilt are in columns and rows of the table
            roll=round(aim.roll, 4) + 0.0,  # + 0.0 makes -0.0 to 0.0
            heading=np.float32(aim.heading) * AZIMUTHS_PER_RAD,
            extra_tilt=np.float32(extra_tilt_rad) * ELEVATIONS_PER_RAD,
        )

    @property
    def table(self) -> "RayTable":
        """Table of rays of this model, tilt and roll, from memory or made now."""
        return get_ray_table(self.model, self.tilt, self.roll)


class RayTable:
    """Number of rays of a model in each direction, tilted and rolled (rad), heading 0.

    Directions are places as in `rectangles`: `AZIMUTHS` columns to a turn, from straight behind on,
    and `ELEVATIONS` rows from straight down to straight up.

    Attributes:
        first_column: First place of azimuth with rays.
        columns: Number of places of azimuth from the first to the last with rays.
        first_row: Lowest place of elevation with rays.
        cells: Numbers of the cells (see `cells`) with rays: column * `CELL_ROWS` + row, columns by
            azimuth from the heading.
        cell_rays: Number of rays in each such cell, float32.
        nbytes: Bytes of memory."""

    def __init__(self, model: SensorModel, tilt: float, roll: float) -> None:
        """Count a model's rays by direction, at heading 0. tilt, roll: the sensor's (rad)."""
        # rotation from the sensor's axes to axes with x along the heading and z up
        turn = pose(pitch=tilt, roll=roll)[:3, :3] @ model.body_SE3_sensor[:3, :3]
        x, y, z = (model.rays().reshape(-1, 3) @ turn.T).T
        azimuth = np.arctan2(y, x)
        elevation = np.arctan2(z, np.hypot(x, y))
        # place of each ray in the grid of all directions
        column = np.floor((azimuth + np.pi) * (AZIMUTHS / (2 * np.pi))).astype(np.int64) % AZIMUTHS
        row = np.clip(
            np.floor((elevation + np.pi / 2) * (ELEVATIONS / np.pi)), 0, ELEVATIONS - 1
        ).astype(np.int64)
        self.first_column = int(column.min())
        self.first_row = int(row.min())
        self.columns = int(column.max()) - self.first_column + 1
        rows = int(row.max()) - self.first_row + 1
        dtype = np.uint32 if len(column) >> 16 else np.uint16  # 2 ** 16 rays or more need uint32
        # sums[i, j]: rays in the first i columns and the first j rows of the table
        self._sums = np.zeros((self.columns + 1, rows + 1), dtype)
        # + 1, as row and column 0 of the sums stay 0
        flat_place = (column - self.first_column + 1) * (rows + 1) + row - self.first_row + 1
        np.add.at(self._sums.ravel(), flat_place, dtype(1))
        # sums along both axes; column by column, as accumulate along this axis is five times slower
        for before, after in pairwise(self._sums):
            np.add(before, after, out=after)
        np.add.accumulate(self._sums, axis=1, out=self._sums)
        # the same by coarser cells; cells without rays are left out
        cell_column, cell_row = find_cells(azimuth, elevation)
        rays = np.bincount(cell_column * CELL_ROWS + cell_row)
        self.cells = np.flatnonzero(rays)
        self.cell_rays = rays[self.cells].astype(np.float32)
        self.nbytes = self._sums.nbytes + self.cells.nbytes + self.cell_rays.nbytes

    def counts(
        self, rectangles: "Rectangles", heading: np.float32, extra_tilt: np.float32
    ) -> tuple[Int64[np.ndarray, " m"], Counts]:
        """Return the indices of rectangles that hold rays, ascending, and the rays in each.

        Args:
            rectangles: Rectangles of azimuth and elevation of the world.
            heading: Heading of the sensor, in places of azimuth.
            extra_tilt: Places of elevation by which the sensor is tilted more than the table."""
        edges = rectangles.find_edges(heading, extra_tilt)
        # columns begin to begin + width and rows low to up of this table, ends excluded
        begin = np.rint(edges.left).astype(np.int32)
        width = np.rint(edges.right).astype(np.int32) - begin
        begin %= AZIMUTHS
        begin -= self.first_column
        low = np.rint(edges.low).astype(np.int32) - self.first_row
        up = np.rint(edges.high).astype(np.int32) - self.first_row
        last_column = self._sums.shape[0] - 1
        last_row = self._sums.shape[1] - 1
        # before the table's end and beyond its start, or across the seam into its next turn
        is_in_columns = (begin < last_column) & (begin + width > 0) | (begin + width > AZIMUTHS)
        near_rectangles = np.flatnonzero(is_in_columns & (up > 0) & (low < last_row))
        begin = begin.take(near_rectangles)
        low = np.maximum(low.take(near_rectangles), 0)
        up = np.minimum(up.take(near_rectangles), last_row)
        end = begin + width.take(near_rectangles)
        counts = self._count_rays(np.maximum(begin, 0), np.minimum(end, last_column), low, up)
        wrapped_rows = np.flatnonzero(end > AZIMUTHS)  # across the seam behind the sensor
        if len(wrapped_rows):
            wrapped_end = np.minimum(end[wrapped_rows] - AZIMUTHS, last_column)
            counts[wrapped_rows] += self._count_rays(
                np.zeros_like(wrapped_end), wrapped_end, low[wrapped_rows], up[wrapped_rows]
            )
        hit_rows = np.flatnonzero(counts)
        return near_rectangles[hit_rows], counts[hit_rows]

    def _count_rays(
        self, begin: np.ndarray, end: np.ndarray, low: np.ndarray, up: np.ndarray
    ) -> Counts:
        """Rays in columns begin to end and rows low to up of the table; 0 if begin > end.

        Ends are excluded. It is sums[end, up] - sums[end, low] - sums[begin, up] +
        sums[begin, low]: unsigned integers may wrap in between, but the result is right."""
        flat_sums = self._sums.ravel()
        stride = self._sums.shape[1]  # from one column to the next in `flat_sums`
        begin_place = np.minimum(begin, end) * stride
        end_place = end * stride
        counts: Counts = flat_sums.take(end_place + up) - flat_sums.take(end_place + low)
        counts -= flat_sums.take(begin_place + up) - flat_sums.take(begin_place + low)
        return counts


def get_ray_table(model: SensorModel, tilt: float, roll: float) -> RayTable:
    """Return the table of a model, tilted and rolled (rad), from memory or made now.

    It counts the model's rays by direction. It stays in memory until newer uses of others fill
    `MAX_TABLE_BYTES`. Threads wait while one makes a table."""
    key = model, tilt, roll
    with _LOCK:
        table: RayTable = RAY_TABLES.get(key) or RayTable(*key)
        RAY_TABLES.keep({key: table}, MAX_TABLE_BYTES)
        return table


def make_table_ahead(model: SensorModel, lowest: float, steepest: float, around: float) -> bool:
    """Make one missing table of roll 0 between two tilts, the nearest to `around` first.

    Args:
        model: Model of the rays.
        lowest: Smallest tilt below the horizon (rad).
        steepest: Largest tilt (rad).
        around: Tilt whose nearest tables come first (rad).

    Returns:
        True if a table was made; False if all are there, or memory is full up to
        `MAX_AHEAD_SHARE`."""
    steps = range(round(lowest / TABLE_TILT_STEP_RAD), round(steepest / TABLE_TILT_STEP_RAD) + 1)
    for step in sorted(steps, key=lambda tilt_step: abs(tilt_step - around / TABLE_TILT_STEP_RAD)):
        key = (model, step * TABLE_TILT_STEP_RAD, 0.0)
        has_room = RAY_TABLES.nbytes < MAX_AHEAD_SHARE * MAX_TABLE_BYTES
        if key not in RAY_TABLES and has_room:
            get_ray_table(*key)  # made and kept
            return True
    return False
