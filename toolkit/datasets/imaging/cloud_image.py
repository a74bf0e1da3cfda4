"""`CloudImage`: the cloud of a lidar as a range image, row by laser and column by azimuth.

A cell holds the range of its nearest point, along the ray through its middle. What does not fit is counted: points that
share a cell with a nearer one, and points outside the grid. A point that the image shows has its range to the bit of a
float32; its direction is that of the cell, at most half a cell off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int64
from toolkit.datasets.imaging.lidar_grid import LidarGrid, angles_of, nearest_row
from toolkit.datasets.sample import SensorCloud

SHARED_CELL, OUTSIDE_GRID = "points in a cell with a nearer one", "points outside the rows and columns of their sensor"


@dataclass(frozen=True, eq=False)
class CloudImage:
    """measurement: ranges (m), 0 where nothing returned; cells: of every point of the cloud, counted row after row, the
    nearest one for those outside; inside: which points lie in the grid; shown: which of them the image shows."""

    grid: LidarGrid
    measurement: Float32[np.ndarray, "rows columns"]
    cells: Int64[np.ndarray, " n"]
    inside: Bool[np.ndarray, " n"]
    shown: Bool[np.ndarray, " n"]

    @property
    def left_out(self) -> dict[str, int]:
        """Points that the image does not show, by kind."""
        counts = {SHARED_CELL: int((self.inside & ~self.shown).sum()), OUTSIDE_GRID: int((~self.inside).sum())}
        return {kind: count for kind, count in counts.items() if count}

    @cached_property
    def points(self) -> Float32[np.ndarray, "m 3"]:
        """What the image says of the points it shows, sensor frame, in their order."""
        cells = self.cells[self.shown]
        rays = self.grid.model.rays().reshape(-1, 3)
        return rays[cells] * self.measurement.ravel()[cells, None]


def image_of(cloud: SensorCloud, grid: LidarGrid) -> CloudImage:
    """The cloud of a sensor in its grid."""
    model = grid.model
    elevation, azimuth, distance = angles_of(cloud.in_sensor())
    row, in_rows = _rows(cloud, grid, elevation)
    turned = (azimuth - model.heading + np.pi) % (2 * np.pi) - np.pi
    place = np.floor(turned / (model.azimuth_fov / model.columns) + model.columns / 2).astype(np.int64)
    column = np.clip(place, 0, model.columns - 1)
    in_columns = (place == column) | (model.azimuth_fov >= 2 * np.pi)
    ranges = distance.astype(np.float32)
    inside = in_rows & in_columns & (ranges > 0) & (ranges < model.max_range)
    cells = row * model.columns + column
    image = np.full(len(model.elevations) * model.columns, np.inf, np.float32)
    within = np.flatnonzero(inside)
    order = within[np.lexsort((ranges[within], cells[within]))]
    first = np.diff(cells[order], prepend=-1) > 0
    shown = np.zeros(len(cells), bool)
    shown[order[first]] = True
    image[cells[shown]] = ranges[shown]
    image[np.isinf(image)] = 0
    return CloudImage(grid, image.reshape(model.shape), cells, inside, shown)


def _rows(
    cloud: SensorCloud, grid: LidarGrid, elevation: Float64[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """The row of each point, and which points are of one: by their laser, else by an elevation no farther from a row
    than the next one is."""
    rows = np.array(grid.model.elevations)
    if grid.rings and cloud.ring is not None:
        numbers = np.array(grid.rings)
        order = np.argsort(numbers)
        place = np.minimum(np.searchsorted(numbers[order], cloud.ring), len(numbers) - 1)
        row = order[place].astype(np.int64)
        return row, numbers[row] == cloud.ring
    row = nearest_row(elevation, rows)
    apart = -np.diff(rows)
    if not len(apart):
        return row, np.ones(len(row), bool)
    widest = np.maximum(np.append(apart, 0), np.insert(apart, 0, 0))
    return row, np.abs(elevation - rows[row]) <= widest[row]
