"""`Still`: the still scene seen from one place, as chances of a point in each cell."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from placement_env.fidelity.cells import CELL_COLUMNS, CELL_ROWS, find_cells, list_cell_directions
from placement_env.fidelity.occlusion import worth
from placement_env.fidelity.ray_table import Lookup
from placement_env.fidelity.rectangles import AZIMUTHS
from toolkit.arrays import Float32, Float64, UInt8
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import NEAR, SensorModel
from toolkit.sites.site import Site

CHANCE_STEPS = np.float32(250.0)  # steps of chances, so that one half is exact


@dataclass(frozen=True, eq=False)
class Still:
    """Chances of a point to be sent, and to be sent and far, in 250ths, for each cell."""

    sent: UInt8[np.ndarray, " cells"]
    far: UInt8[np.ndarray, " cells"]

    @staticmethod
    def of(
        renderer: Renderer, site: Site, viewpoint: Float64[np.ndarray, "3"], model: SensorModel
    ) -> "Still":
        """Chances seen from a viewpoint, with a model's noise. The noise is the same everywhere in
        its image."""
        rays = list_cell_directions()
        mean = _mean_length(model)
        images = np.zeros((2, len(rays)), np.uint8)
        origin = viewpoint.astype(np.float32)
        lines = np.concatenate([origin + np.float32(NEAR) * rays, rays], axis=1)
        length = renderer.cast_still(lines) + np.float32(NEAR)
        returning = np.flatnonzero(length < model.max_range)
        length = length[returning]
        directions = rays[returning]
        spread = (mean * np.abs(directions[:, 2]) * model.deviation(length / mean)).astype(
            np.float32
        )
        points = directions * length[:, None] + origin
        chances = worth(points, spread, np.broadcast_to(origin[:2], (len(returning), 2)), site)
        images[:, returning] = np.rint(CHANCE_STEPS * np.array(chances))
        return Still(*images)

    def alone(self, lookup: Lookup) -> tuple[float, float]:
        """Points that a sensor sends in a still scene, and the far ones."""
        table = lookup.table
        columns = round(float(lookup.heading) * CELL_COLUMNS / AZIMUTHS) % CELL_COLUMNS
        cell = table.cells + columns * CELL_ROWS
        sums = (
            float(table.cell_rays @ image.take(cell, mode="wrap"))
            for image in (self.sent, self.far)
        )
        sent, far = (rays / float(CHANCE_STEPS) for rays in sums)
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
