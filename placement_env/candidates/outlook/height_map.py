"""`HeightMap`: what stands between a sensor and the ground, as heights over a fine raster of the site.

In each place there is what stands on the ground, up to a height, and what hangs above it, as the crown of a tree does,
from a height to another. Posts and trunks are too thin to hide a vehicle and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from toolkit.arrays import Float32, Float64, Int64
from toolkit.sites.site import Site

HEIGHT_CELL = 1.0  # m of a place of the raster
HEIGHT_MARGIN = 25.0  # m round the area
HANGING = 1.0  # m above the ground from which on a solid hangs
THIN = 0.6  # m across, below which a solid hides nothing
NOTHING = 1e4  # m, above all and, negative, below all


@dataclass(frozen=True, eq=False)
class HeightMap:
    """corner: of the raster; top: of what stands on the ground, below all where nothing does; low, high: ends of what
    hangs above it (m, site frame)."""

    corner: Float64[np.ndarray, "2"]
    top: Float32[np.ndarray, "rows columns"]
    low: Float32[np.ndarray, "rows columns"]
    high: Float32[np.ndarray, "rows columns"]

    def places(self, x: Float64[np.ndarray, "*n"], y: Float64[np.ndarray, "*n"]) -> Int64[np.ndarray, "*n"]:
        """Flat place in the raster of each spot, the nearest where that is outside."""
        rows, columns = self.top.shape
        column = np.clip((x - self.corner[0]) / HEIGHT_CELL, 0, columns - 1).astype(np.int64)
        row = np.clip((y - self.corner[1]) / HEIGHT_CELL, 0, rows - 1).astype(np.int64)
        return np.asarray(row * columns + column)


def height_map(site: Site) -> HeightMap:
    """Of a site's solids."""
    corner = site.area[:2] - HEIGHT_MARGIN
    columns, rows = np.ceil((site.area[2:] - site.area[:2] + 2 * HEIGHT_MARGIN) / HEIGHT_CELL).astype(int).tolist()
    top, high = np.full((2, rows * columns), -NOTHING, np.float32)
    low = np.full(rows * columns, NOTHING, np.float32)
    wide = [s for s in site.solids if s.kind != "pond" and np.ptp(s.footprint, axis=0).max() >= THIN]
    if wide:
        solid, place = _touched([each.footprint for each in wide], corner, (rows, columns))
        middles = np.array([each.footprint.mean(axis=0) for each in wide])
        base, up = np.array([[each.base, each.top] for each in wide]).T
        hangs = base - site.ground(middles) >= HANGING
        stands = ~hangs[solid]
        np.maximum.at(top, place[stands], up[solid[stands]].astype(np.float32))
        np.maximum.at(high, place[~stands], up[solid[~stands]].astype(np.float32))
        np.minimum.at(low, place[~stands], base[solid[~stands]].astype(np.float32))
    return HeightMap(corner, *(each.reshape(rows, columns) for each in (top, low, high)))


def _touched(
    footprints: list[np.ndarray], corner: np.ndarray, shape: tuple[int, int]
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Pairs of a footprint and a place that its outline or inside touches."""
    pairs: list[np.ndarray] = []
    for number, footprint in enumerate(footprints):
        low, high = footprint.min(axis=0), footprint.max(axis=0)
        first = np.maximum(np.floor((low - corner) / HEIGHT_CELL), 0).astype(int)
        last = np.minimum(np.floor((high - corner) / HEIGHT_CELL), (shape[1] - 1, shape[0] - 1)).astype(int)
        if (last < first).any():
            continue
        column, row = np.meshgrid(np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1))
        pairs.append(np.stack([np.full(column.size, number), row.ravel(), column.ravel()]))
    if not pairs:
        return np.zeros((2, 0), np.int64)[0], np.zeros(0, np.int64)
    number, row, column = np.concatenate(pairs, axis=1)
    x, y = corner[0] + column * HEIGHT_CELL, corner[1] + row * HEIGHT_CELL
    shapes = np.array([shapely.Polygon(footprint) for footprint in footprints], object)
    squares = shapely.box(x, y, x + HEIGHT_CELL, y + HEIGHT_CELL)
    touches = shapely.intersects(shapes[number], squares)
    return number[touches], (row * shape[1] + column)[touches]
