"""Cells over all directions, coarser than the places of `rectangles`, for the static scene."""

from functools import lru_cache

import numpy as np

from toolkit.arrays import Float, Float32, Float64, Int64

CELL_COLUMNS = 240  # columns of cells in a turn of azimuth
# elevation of the edges of rows (rad), finest below the horizon
CELL_EDGES = np.deg2rad(np.r_[-90.0:-30.0:0.5, -30.0:5.0:0.1, 5.0:90.5:0.5])
CELL_ROWS = len(CELL_EDGES) - 1
Angles = Float[np.ndarray, " n"]  # rad


def find_cells(
    azimuth: Angles, elevation: Angles
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Column and row of the cell of each direction.

    Columns go by azimuth (rad, counter-clockwise) from -pi on, rows by elevation (rad) from
    straight down."""
    columns_from_back = np.floor((azimuth + np.pi) * (CELL_COLUMNS / (2 * np.pi)))
    column = columns_from_back.astype(np.int64) % CELL_COLUMNS  # azimuths repeat after a turn
    row = np.searchsorted(CELL_EDGES, elevation, side="right") - 1
    return column, np.clip(row, 0, CELL_ROWS - 1)


def cell_elevations() -> Float64[np.ndarray, " rows"]:
    """Elevation of the middle of each row of cells (rad), from straight down on."""
    return (CELL_EDGES[1:] + CELL_EDGES[:-1]) / 2


@lru_cache(maxsize=1)
def list_cell_directions() -> Float32[np.ndarray, "cells 3"]:
    """Unit vectors through the middle of each cell, column after column (column * rows + row)."""
    # azimuth (columns, 1) and elevation (rows,) are broadcast to (columns, rows)
    azimuth = (np.arange(CELL_COLUMNS) + 0.5)[:, None] * (2 * np.pi / CELL_COLUMNS) - np.pi
    elevation = cell_elevations()
    horizontal_length = np.cos(elevation)
    x = horizontal_length * np.cos(azimuth)
    y = horizontal_length * np.sin(azimuth)
    z = np.sin(elevation) + 0 * azimuth  # + 0 * azimuth gives it both axes
    return np.stack((x, y, z), axis=-1).reshape(-1, 3).astype(np.float32)
