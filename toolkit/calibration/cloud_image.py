"""Clouds as images in the grid of their sensor."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Float32, Float64, ImageRanges, Int64, Mask
from toolkit.calibration.lidar_grid import LidarGrid, compute_angles, nearest_row
from toolkit.frame import SensorCloud

# reasons why an image lacks points
SHARED_CELL = "points in a cell with a nearer one"
OUTSIDE_GRID = "points outside the rows and columns of their sensor"


@dataclass(frozen=True, eq=False)
class CloudImage:
    """Cloud of n points as an image of ranges.

    Attributes:
        grid: rows and columns of the image.
        measurement: range (m) of the nearest point in each cell, 0 for no return.
        cells: flat index of each point's cell, row by row; the nearest cell for points outside.
        inside: mask of the points in the grid and in the sensor's range.
        shown: mask of the points that the image shows, one for each cell with points.
    """

    grid: LidarGrid
    measurement: ImageRanges
    cells: Int64[np.ndarray, " n"]
    inside: Mask
    shown: Mask

    @property
    def left_out(self) -> dict[str, int]:
        """Number of points missing from the image, by reason; reasons without points are left
        out."""
        counts = {
            SHARED_CELL: int((self.inside & ~self.shown).sum()),
            OUTSIDE_GRID: int((~self.inside).sum()),
        }
        return {kind: count for kind, count in counts.items() if count}

    @cached_property
    def points(self) -> Float32[np.ndarray, "m 3"]:
        """Points (m) of the image, in the sensor's frame and in the cloud's order.

        They are on the middle rays of their cells, at the measured range."""
        cells = self.cells[self.shown]
        rays = self.grid.model.rays().reshape(-1, 3)
        return rays[cells] * self.measurement.ravel()[cells, None]


def rasterize_cloud(cloud: SensorCloud, grid: LidarGrid) -> CloudImage:
    """Return a cloud as an image in its sensor's grid.

    Points are in the row of their laser if cloud and grid both name lasers, else in the nearest row
    if that is near enough. The nearest point of each cell is shown. Ranges are in m, 0 for a cell
    without a point."""
    model = grid.model
    elevation, azimuth, distance = compute_angles(cloud.in_sensor())  # rad, rad, m
    if grid.rings and cloud.ring is not None:
        row, in_rows = _find_laser_rows(cloud.ring, grid.rings)
    else:
        row, in_rows = _find_near_rows(elevation, np.array(model.elevations))
    # azimuth from the middle of the columns, -pi to pi
    offset = (azimuth - model.heading + np.pi) % (2 * np.pi) - np.pi
    column_width = model.azimuth_fov / model.columns
    unbounded_column = np.floor(offset / column_width + model.columns / 2).astype(np.int64)
    column = np.clip(unbounded_column, 0, model.columns - 1)
    # all around, a column beyond the last is only a matter of rounding
    in_columns = (unbounded_column == column) | (model.azimuth_fov >= 2 * np.pi)
    ranges = distance.astype(np.float32)
    inside = in_rows & in_columns & (ranges > 0) & (ranges < model.max_range)
    cells = row * model.columns + column
    shown = _mark_nearest(cells, ranges, inside)
    image = np.zeros(len(model.elevations) * model.columns, np.float32)
    image[cells[shown]] = ranges[shown]
    return CloudImage(
        grid, measurement=image.reshape(model.shape), cells=cells, inside=inside, shown=shown
    )


def _find_laser_rows(
    ring: Int64[np.ndarray, " n"], rings: tuple[int, ...]
) -> tuple[Int64[np.ndarray, " n"], Mask]:
    """Row of each point's laser, and a mask of the points whose laser has a row.

    ring: laser of each point; rings: laser of each row. Other points get any row."""
    row_rings = np.array(rings)
    order = np.argsort(row_rings)
    # position of the point's laser among the sorted ones, if it is there
    position = np.minimum(np.searchsorted(row_rings[order], ring), len(row_rings) - 1)
    row = order[position].astype(np.int64)
    return row, row_rings[row] == ring


def _find_near_rows(
    elevation: Float64[np.ndarray, " n"], rows: Float64[np.ndarray, " m"]
) -> tuple[Int64[np.ndarray, " n"], Mask]:
    """Nearest row of each point, and a mask of the points near enough to it.

    These are no farther from it than the wider one of the gaps to the rows next to it; all are if
    there is a single row. elevation: each point's (rad); rows: each row's (rad), top first."""
    row = nearest_row(elevation, rows)
    gaps = -np.diff(rows)  # rows descend
    wider_gap = np.full(1, np.inf)  # next to each row
    if len(gaps):
        wider_gap = np.maximum(np.append(gaps, 0), np.insert(gaps, 0, 0))
    return row, np.abs(elevation - rows[row]) <= wider_gap[row]


def _mark_nearest(
    cells: Int64[np.ndarray, " n"], ranges: Float32[np.ndarray, " n"], inside: Mask
) -> Mask:
    """Mark the nearest point of each cell, among the points inside the grid.

    cells, ranges: flat index of the cell, and range (m), of each point."""
    rows = np.flatnonzero(inside)
    order = rows[np.lexsort((ranges[rows], cells[rows]))]  # by cell, then by range
    is_first = np.diff(cells[order], prepend=-1) > 0  # point of its cell in this order
    is_nearest = np.zeros(len(cells), bool)
    is_nearest[order[is_first]] = True
    return is_nearest
