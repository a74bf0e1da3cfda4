"""Clouds as images in the grid of their sensor."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Float32, ImageRanges, Int64, Mask
from toolkit.calibration.lidar_grid import LidarGrid, compute_angles, nearest_row
from toolkit.frame import SensorCloud

SHARED_CELL = "points in a cell with a nearer one"
OUTSIDE_GRID = "points outside the rows and columns of their sensor"


@dataclass(frozen=True, eq=False)
class CloudImage:
    """A cloud as an image. measurement: ranges (m), 0 where nothing returned; cells: of every point
    of the cloud, counted row by row, the nearest one for points outside; inside: mask of the points
    in the grid; shown: mask of those that the image shows."""

    grid: LidarGrid
    measurement: ImageRanges
    cells: Int64[np.ndarray, " n"]
    inside: Mask
    shown: Mask

    @property
    def left_out(self) -> dict[str, int]:
        """Number of points missing from the image, by kind."""
        counts = {
            SHARED_CELL: int((self.inside & ~self.shown).sum()),
            OUTSIDE_GRID: int((~self.inside).sum()),
        }
        return {kind: count for kind, count in counts.items() if count}

    @cached_property
    def points(self) -> Float32[np.ndarray, "m 3"]:
        """Points of the image, sensor frame, in the cloud's order."""
        cells = self.cells[self.shown]
        rays = self.grid.model.rays().reshape(-1, 3)
        return rays[cells] * self.measurement.ravel()[cells, None]


def rasterize_cloud(cloud: SensorCloud, grid: LidarGrid) -> CloudImage:
    """Return a cloud in its sensor's grid: points in the row of their laser, else in the nearest
    one if near enough."""
    model = grid.model
    elevation, azimuth, distance = compute_angles(cloud.in_sensor())
    rows = np.array(model.elevations)
    if grid.rings and cloud.ring is not None:
        numbers = np.array(grid.rings)
        order = np.argsort(numbers)
        row = order[
            np.minimum(np.searchsorted(numbers[order], cloud.ring), len(numbers) - 1)
        ].astype(np.int64)
        in_rows = numbers[row] == cloud.ring
    else:
        row = nearest_row(elevation, rows)
        gaps = -np.diff(rows)
        widest = (
            np.maximum(np.append(gaps, 0), np.insert(gaps, 0, 0))
            if len(gaps)
            else np.full(1, np.inf)
        )
        in_rows = np.abs(elevation - rows[row]) <= widest[row]
    turned = (azimuth - model.heading + np.pi) % (2 * np.pi) - np.pi
    raw_column = np.floor(turned / (model.azimuth_fov / model.columns) + model.columns / 2).astype(
        np.int64
    )
    column = np.clip(raw_column, 0, model.columns - 1)
    in_columns = (raw_column == column) | (model.azimuth_fov >= 2 * np.pi)
    ranges = distance.astype(np.float32)
    inside = in_rows & in_columns & (ranges > 0) & (ranges < model.max_range)
    cells = row * model.columns + column
    within = np.flatnonzero(inside)
    order = within[np.lexsort((ranges[within], cells[within]))]
    is_shown = np.zeros(len(cells), bool)
    is_shown[order[np.diff(cells[order], prepend=-1) > 0]] = True  # the nearest of each cell
    image = np.zeros(len(rows) * model.columns, np.float32)
    image[cells[is_shown]] = ranges[is_shown]
    return CloudImage(grid, image.reshape(model.shape), cells, inside, is_shown)
