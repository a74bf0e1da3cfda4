"""Hybrid fusion: every sensor sends its boxes, and its points farther off than a radius; the far points together go
through the detector as well (paper section II-E).

It is ready after the slower of the two, the sensors' own detection and that in the far points, and the fusion of boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.arrays import Bool, Float32
from toolkit.detection.scheme import Counts, Fused, fused
from toolkit.detection.view import View
from toolkit.points import Area, Distance, beyond
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import HYBRID_RADIUS, Site


@dataclass(frozen=True)
class Hybrid:
    """Hybrid fusion. radius: within which no points are sent (m), None for the site's own; metric: how it is measured,
    see `toolkit.points.beyond`."""

    radius: float | None = None
    metric: Distance = "horizontal"
    name: str = "hybrid"
    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.radius is not None and not self.radius >= 0:
            raise ValueError(f"radius must be at least 0 m, got {self.radius}: None is the site's own")

    @property
    def digest(self) -> str:
        """Name and parameters."""
        return repr(self)

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Late fusion, joined by what is detected in the far points."""
        radius = self.radius_at(view.site)

        def far(points: Float32[np.ndarray, "n 3"], sensor: Sensor) -> Bool[np.ndarray, " n"]:
            return beyond(points, sensor, radius, self.metric)

        name = f"beyond {radius} m, {self.metric}"
        points = [view.send_points(view.part(view.cloud(sensor), name, far)) for sensor in sensors]
        centre = view.suppressed([view.detect([each.arrived for each in points])])
        boxes = [view.send_boxes(view.detect([view.cloud(sensor)])) for sensor in sensors]
        everything = view.suppressed([*(each.arrived for each in boxes), centre])
        return fused(everything, [box.bits + point.bits for box, point in zip(boxes, points, strict=True)])

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "C F"]:
        """The far points. Raises ValueError for a radius or metric of its own: these are counted by the site's."""
        if self.radius is not None or self.metric != "horizontal":
            raise ValueError(
                f"far points are counted by the site's hybrid radius, not by {self}: take Hybrid() at "
                "dataclasses.replace(site, hybrid_radius=...)"
            )
        return counts.far

    def pooled_beside(self, distance: Float32[np.ndarray, "C O"], radius: float, /) -> Bool[np.ndarray, "C O"]:
        """Objects beyond the radius."""
        return distance > (radius if self.radius is None else self.radius)

    def radius_at(self, site: Area) -> float:
        """The radius at a site or, for a bare area, the paper's usual one."""
        if self.radius is not None:
            return self.radius
        return site.hybrid_radius if isinstance(site, Site) else HYBRID_RADIUS
