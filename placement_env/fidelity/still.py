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
    """Static scene seen from one place by one sensor model: a chance for each cell of directions.

    Cells are as in `cells`, numbered column * `CELL_ROWS` + row. Chances are whole numbers of
    1 / `CHANCE_STEPS`."""

    sent: UInt8[np.ndarray, " cells"]  # chance that a ray in the cell gives a point that is sent
    far: UInt8[np.ndarray, " cells"]  # chance that it is also beyond the hybrid radius

    @staticmethod
    def of(
        renderer: Renderer, site: Site, viewpoint: Float64[np.ndarray, "3"], model: SensorModel
    ) -> "Still":
        """Cast a ray through each cell from a viewpoint and find the chances of its point.

        Args:
            renderer: Renderer of the static scene.
            site: Site with the crop and the hybrid radius.
            viewpoint: Place of the sensors (m, world frame).
            model: Sensor model with range and noise. Its rays are taken to have their mean length
                for a measurement everywhere in its image."""
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
        """Points that a sensor sends if no object is there, and the far ones among them.

        lookup: Aim of the sensor, which must be at this place."""
        table = lookup.table
        columns = round(float(lookup.heading) * CELL_COLUMNS / AZIMUTHS) % CELL_COLUMNS
        # turned by whole columns; cells beyond the last column wrap round
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
        """Chances (0 to 1) that a ray in each direction is sent, and is sent and far.

        Directions are azimuth from the x axis of the world, and elevation (rad)."""
        column, row = find_cells(azimuth, elevation)
        cell = column * CELL_ROWS + row
        return self.sent.take(cell) / CHANCE_STEPS, self.far.take(cell) / CHANCE_STEPS


@lru_cache(maxsize=8)
def _mean_length(model: SensorModel) -> np.floating:
    """Mean length of a model's rays: metres from the sensor for a measurement of 1 m."""
    return np.linalg.norm(model.rays(), axis=-1).mean()
