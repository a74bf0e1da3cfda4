"""SUMO's vehicle types for a fleet of bodies: class, size, and how each kind behaves on the road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

if TYPE_CHECKING:
    from toolkit.bodies.body import Body

HEAVY_SHARE = 0.08  # of the vehicles
SHARES = {VEHICLE: 0.6 * (1 - HEAVY_SHARE), HEAVY: 0.6 * HEAVY_SHARE, CYCLIST: 0.2, PEDESTRIAN: 0.2}  # paper, Dataset
SWAY = {VEHICLE: 0.5, HEAVY: 0.3, CYCLIST: 2.0, PEDESTRIAN: 8.0}  # degrees; deviation of yaw from the path's
ASIDE = {VEHICLE: 0.25, HEAVY: 0.0, CYCLIST: 0.8, PEDESTRIAN: 0.0}  # m; deviation from the middle of the lane
BICYCLE_LENGTH = 1.75  # m; a longer two-wheeler has an engine
POSITIONS = 3  # lateral positions in the lane, drawn per body


@dataclass(frozen=True, eq=False)
class VehicleTypes:
    """A vehicle type per body, pedestrians included. labels: class numbers; sizes: length, width, height (m); classes:
    SUMO's vehicle classes, which say what lanes are open to it."""

    labels: Int64[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]
    classes: tuple[str, ...]

    @staticmethod
    def of(bodies: Sequence[Body]) -> VehicleTypes:
        """The vehicle types of these bodies."""
        labels = np.array([body.label for body in bodies], np.int64)
        sizes = np.array([body.size for body in bodies], np.float64)
        classes = tuple(_sumo_class(label, size[0]) for label, size in zip(labels.tolist(), sizes, strict=True))
        return VehicleTypes(labels, sizes, classes)

    def sumo_types(self, rng: np.random.Generator) -> str:
        """SUMO's additional file, which declares type "row-position" for each row and lateral position in the lane."""
        rows = [self._sumo_type(row, position, rng) for row in range(len(self.labels)) for position in range(POSITIONS)]
        return "<additional>\n" + "\n".join(rows) + "\n</additional>\n"

    def _sumo_type(self, row: int, position: int, rng: np.random.Generator) -> str:
        label = int(self.labels[row])
        length, width, height = self.sizes[row]
        aside = np.clip(rng.normal(0, ASIDE[label]), -1.2, 1.2)
        gap = rng.uniform(1.0, 2.5) if label != PEDESTRIAN else 0.5
        return (
            f'<vType id="{row}-{position}" vClass="{self.classes[row]}" length="{length:.3f}" width="{width:.3f}" '
            f'height="{height:.3f}" minGap="{gap:.2f}" latAlignment="{aside:.2f}"/>'
        )


def _sumo_class(label: int, length: float) -> str:
    two_wheeler = "bicycle" if length <= BICYCLE_LENGTH else "motorcycle"
    return {VEHICLE: "passenger", HEAVY: "truck", CYCLIST: two_wheeler, PEDESTRIAN: "pedestrian"}[label]
