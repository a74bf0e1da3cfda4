"""`Still`: chances of the standing scene's points to be in the crop, and far off, in each direction from a place."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from placement_env.fidelity.occlusion import worth
from placement_env.fidelity.panorama.ray_table import (
    AZIMUTHS,
    CELL_COLUMNS,
    CELL_ROWS,
    Lookup,
    cell_elevations,
    find_cells,
)
from toolkit.arrays import Float32, Float64, UInt8
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import NEAR, SensorModel
from toolkit.sites.site import Site

CHANCE_STEPS = np.float32(250.0)  # steps of chances, so that one half is exact


@dataclass(frozen=True, eq=False)
class Still:
    """Chances of a point to be sent, and to be sent and far, in 250ths, for each cell (of `ray_table`)."""

    sent: UInt8[np.ndarray, " cells"]
    far: UInt8[np.ndarray, " cells"]

    @staticmethod
    def of(renderer: Renderer, site: Site, viewpoint: Float64[np.ndarray, "3"], model: SensorModel) -> Still:
        """Chances seen from a viewpoint, with a model's noise. The noise is the same everywhere in its image."""
        rays, mean = _directions(), _mean_length(model)
        images, place = np.zeros((2, len(rays)), np.uint8), viewpoint.astype(np.float32)
        lines = np.concatenate([place + np.float32(NEAR) * rays, rays], axis=1)
        length = renderer.cast_still(lines) + np.float32(NEAR)
        some = np.flatnonzero(length < model.max_range)
        length, toward = length[some], rays[some]
        spread = (mean * np.abs(toward[:, 2]) * model.deviation(length / mean)).astype(np.float32)
        points = toward * length[:, None] + place
        chances = worth(points, spread, np.broadcast_to(place[:2], (len(some), 2)), site)
        images[:, some] = np.rint(CHANCE_STEPS * np.array(chances))
        return Still(*images)

    def alone(self, lookup: Lookup) -> tuple[float, float]:
        """Points that a sensor sends in a still scene, and the far ones."""
        table = lookup.table
        columns = round(float(lookup.heading) * CELL_COLUMNS / AZIMUTHS) % CELL_COLUMNS
        cell = table.cells + columns * CELL_ROWS
        sent, far = (
            float(table.cell_rays @ image.take(cell, mode="wrap")) / float(CHANCE_STEPS)
            for image in (self.sent, self.far)
        )
        return sent, far

    def behind(
        self, azimuth: Float32[np.ndarray, " n"], elevation: Float32[np.ndarray, " n"]
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Chances of the scene in some directions (rad)."""
        column, row = find_cells(azimuth, elevation)
        cell = column * CELL_ROWS + row
        return self.sent.take(cell) / CHANCE_STEPS, self.far.take(cell) / CHANCE_STEPS


@lru_cache(maxsize=8)
def _mean_length(model: SensorModel) -> np.floating:
    """Metres along a ray per unit of measurement, on average."""
    return np.linalg.norm(model.rays(), axis=-1).mean()


@lru_cache(maxsize=1)
def _directions() -> Float32[np.ndarray, "cells 3"]:
    """Directions through the middle of each cell."""
    azimuth = (np.arange(CELL_COLUMNS) + 0.5)[:, None] * (2 * np.pi / CELL_COLUMNS) - np.pi
    elevation = cell_elevations()
    flat = np.cos(elevation)
    axes = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth)
    return np.stack(axes, axis=-1).reshape(-1, 3).astype(np.float32)
