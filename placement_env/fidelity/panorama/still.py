"""Points of the standing scene from a place.

They are chances of each direction's point to be in the crop, and far off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from placement_env.fidelity.occlusion import worth
from placement_env.fidelity.panorama.ray_table import CELL_COLUMNS, CELL_ROWS, Cells, cell_elevations, find_cells
from toolkit.arrays import Float32, Float64, Int32, UInt8
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import NEAR, SensorModel
from toolkit.sites.site import Site

CHANCE_STEPS = np.float32(250.0)  # steps of chances, so that one half is exact


@dataclass(frozen=True, eq=False)
class Still:
    """Chances of a point to be sent, and far.

    Both are in 250ths, the second for sent and far together. They are of the directions of cells (of `ray_table`), seen
    from V viewpoints.
    """

    sent: UInt8[np.ndarray, "V columns rows"]
    far: UInt8[np.ndarray, "V columns rows"]

    @staticmethod
    def of(renderer: Renderer, site: Site, viewpoints: Float64[np.ndarray, "V 3"], model: SensorModel) -> Still:
        """Chances seen from viewpoints, with a model's noise. The noise is the same everywhere in its image."""
        rays = _directions()
        mean = np.linalg.norm(model.rays(), axis=-1).mean()  # m along a ray per unit of measurement
        images = np.zeros((2, len(viewpoints), len(rays)), np.uint8)
        for v, place in enumerate(viewpoints.astype(np.float32)):
            lines = np.concatenate([place + np.float32(NEAR) * rays, rays], axis=1)
            length = renderer.cast_still(lines) + np.float32(NEAR)
            some = np.flatnonzero(length < model.max_range)
            length, toward = length[some], rays[some]
            spread = (mean * np.abs(toward[:, 2]) * model.deviation(length / mean)).astype(np.float32)
            points = toward * length[:, None] + place
            chances = worth(points, spread, np.broadcast_to(place[:2], (len(some), 2)), site)
            for image, chance in zip(images[:, v], chances, strict=True):
                image[some] = np.rint(CHANCE_STEPS * chance)
        return Still(*images.reshape(2, len(viewpoints), CELL_COLUMNS, CELL_ROWS))

    def of_cells(self, viewpoint: int, cells: Cells, heading: float) -> tuple[float, float]:
        """Points that a sensor sends in a still scene.

        The cells are the sensor's; the far points come too; heading in rad.
        """
        columns = round(heading * CELL_COLUMNS / (2 * np.pi)) % CELL_COLUMNS
        cell = cells.places + columns * CELL_ROWS
        sent, far = (
            float(cells.rays @ flat.take(cell, mode="wrap")) / float(CHANCE_STEPS)
            for flat in (self.sent[viewpoint].ravel(), self.far[viewpoint].ravel())
        )
        return sent, far

    def behind(
        self,
        viewpoint: Int32[np.ndarray, " n"],
        azimuth: Float32[np.ndarray, " n"],
        elevation: Float32[np.ndarray, " n"],
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Chances of the scene in some directions (rad)."""
        column, row = find_cells(azimuth, elevation)
        cell = (viewpoint.astype(np.int64) * CELL_COLUMNS + column) * CELL_ROWS + row
        sent, far = (flat.take(cell) / CHANCE_STEPS for flat in (self.sent.ravel(), self.far.ravel()))
        return sent, far


def _directions() -> Float32[np.ndarray, "cells 3"]:
    """Directions through the middle of each cell."""
    azimuth = (np.arange(CELL_COLUMNS) + 0.5)[:, None] * (2 * np.pi / CELL_COLUMNS) - np.pi
    elevation = cell_elevations()
    flat = np.cos(elevation)
    axes = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth)
    return np.stack(axes, axis=-1).reshape(-1, 3).astype(np.float32)
