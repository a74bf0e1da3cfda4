"""`Still`: the still scene seen from one place, as chances of a point in each cell."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.cells import CELL_COLUMNS, CELL_ROWS, find_cells, list_cell_directions
from placement_env.fidelity.occlusion import Chances, find_chances
from placement_env.fidelity.ray_table import Lookup
from placement_env.fidelity.rectangles import AZIMUTHS
from toolkit.arrays import Float32, Float64, UInt8
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import NEAR, SensorModel
from toolkit.sites.site import Site

CHANCE_STEPS = np.float32(250.0)  # steps of chances, so that one half is exact


class SentBackground(NamedTuple):
    """Expected points of the static scene that a sensor sends in a frame without objects.

    Attributes:
        sent: Points in all.
        far: The ones beyond the site's hybrid radius."""

    sent: float
    far: float


@dataclass(frozen=True, eq=False)
class Still:
    """Static scene seen from one place by one sensor model: a chance for each cell of directions.

    Cells are as in `cells`, numbered column * `CELL_ROWS` + row. Chances are whole numbers of
    1 / `CHANCE_STEPS`.

    Attributes:
        sent: Chance that a ray in the cell gives a point that is sent.
        far: Chance that this point is also beyond the hybrid radius."""

    sent: UInt8[np.ndarray, " cells"]
    far: UInt8[np.ndarray, " cells"]

    @staticmethod
    def from_renderer(
        renderer: Renderer, site: Site, viewpoint: Float64[np.ndarray, "3"], model: SensorModel
    ) -> "Still":
        """Cast a ray through each cell of directions and find the chances of its point.

        A point is sent if it is in the detection volume under noise, and far if it is beyond the
        site's hybrid radius too.

        Args:
            renderer: Renderer of the static scene.
            site: Site with the crop and the hybrid radius.
            viewpoint: Place of the sensors (m, world frame).
            model: Sensor model with range and noise. Its rays are taken to have their mean length
                for a measurement everywhere in its image."""
        rays = list_cell_directions()
        mean_length = _mean_length(model)  # length of a ray per metre of measurement
        cell_chances = np.zeros((2, len(rays)), np.uint8)  # rows: sent, far
        origin = viewpoint.astype(np.float32)
        # start and direction of each ray, which begins `NEAR` ahead of the viewpoint
        lines = np.concatenate([origin + np.float32(NEAR) * rays, rays], axis=1)
        distance = renderer.cast_still(lines) + np.float32(NEAR)
        returning = np.flatnonzero(distance < model.max_range)
        distance = distance[returning]
        directions = rays[returning]
        steepness = np.abs(directions[:, 2])
        # standard deviation of a point's height, in metres
        spread = (mean_length * steepness * model.deviation(distance / mean_length)).astype(
            np.float32
        )
        points = directions * distance[:, None] + origin
        positions = np.broadcast_to(origin[:2], (len(returning), 2))
        chances = find_chances(points, spread, positions, site)
        cell_chances[:, returning] = np.rint(CHANCE_STEPS * np.array(chances))
        sent, far = cell_chances
        return Still(sent=sent, far=far)

    def count_background(self, lookup: Lookup) -> SentBackground:
        """Expected points that a sensor sends if no object is there.

        lookup: Aim of the sensor, which must be at this place."""
        table = lookup.table  # numbers of rays by direction, for heading 0
        columns = round(float(lookup.heading) * CELL_COLUMNS / AZIMUTHS) % CELL_COLUMNS
        # cells with rays at heading 0, turned by whole columns; those beyond the last wrap round
        cell = table.cells + columns * CELL_ROWS
        # rays in each cell times its chance, in steps
        sent = float(table.cell_rays @ self.sent.take(cell, mode="wrap"))
        far = float(table.cell_rays @ self.far.take(cell, mode="wrap"))
        return SentBackground(sent=sent / float(CHANCE_STEPS), far=far / float(CHANCE_STEPS))

    def behind(
        self, azimuth: Float32[np.ndarray, " n"], elevation: Float32[np.ndarray, " n"]
    ) -> Chances:
        """Chances that the point of the static scene in each direction is sent, and is far too.

        Args:
            azimuth: Angle from the x axis of the world, counter-clockwise (rad).
            elevation: Angle above the horizon (rad)."""
        column, row = find_cells(azimuth, elevation)
        cell = column * CELL_ROWS + row
        return Chances(
            sent=self.sent.take(cell) / CHANCE_STEPS, far=self.far.take(cell) / CHANCE_STEPS
        )


@lru_cache(maxsize=8)
def _mean_length(model: SensorModel) -> np.floating:
    """Mean length of a model's rays: metres from the sensor for a measurement of 1 m.

    It is 1 for a sensor that measures distance, more for a depth camera."""
    return np.linalg.norm(model.rays(), axis=-1).mean()
