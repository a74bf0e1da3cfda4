"""Fusion schemes of the paper: early, late and hybrid."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from toolkit.arrays import Bool, Float32
from toolkit.detection.parameters import Parameters
from toolkit.detection.scheme import Counts, DetectsOnce, Fused
from toolkit.detection.view import View
from toolkit.points import Area, Distance, is_beyond
from toolkit.sites.site import HYBRID_RADIUS_M, Site


@dataclass(frozen=True)
class Early(DetectsOnce):
    """Early fusion: sensors send all cropped points, and the centre detects in them together."""

    name: str = "early"

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Detect in the points of the sensors (indices, ascending), joined at the centre."""
        return view.fuse_points(view.share_points(sensors))

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "candidates frames"]:
        """Return the number of points in the crop: all are sent.

        counts: numbers of points of candidates in frames."""
        return counts.sent


@dataclass(frozen=True)
class Late(Parameters):
    """Late fusion: sensors send detected boxes, and the centre drops duplicates."""

    name: str = "late"
    sends_points: ClassVar[bool] = False
    sends_boxes: ClassVar[bool] = True

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Pool the boxes that each sensor (index, ascending) detects in its points."""
        sent_boxes = view.share_boxes(sensors)
        boxes = view.suppress([message.arrived for message in sent_boxes])
        bits = np.array([message.bits for message in sent_boxes], np.int64)
        return Fused(boxes.detections, bits=bits, ms=boxes.ms)

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "candidates frames"]:
        """Return zeros: no points are sent."""
        return np.zeros_like(counts.sent)

    def mask_pooled(
        self, distance: Float32[np.ndarray, "candidates objects"], radius: float, /
    ) -> None:
        """Return None: no points are sent."""


@dataclass(frozen=True)
class Hybrid(Parameters):
    """Hybrid fusion: sensors send the boxes that they detect, and the points far from them.

    radius: distance from the sensor (m) within which no points are sent, None for the site's;
    metric: plane in which the distance is measured, see `toolkit.points.is_beyond`."""

    radius: float | None = None
    metric: Distance = "horizontal"
    name: str = "hybrid"
    sends_points: ClassVar[bool] = True
    sends_boxes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.radius is not None and not self.radius >= 0:
            raise ValueError(
                f"radius must be at least 0 m, got {self.radius}: None is the site's own"
            )

    def fuse(self, view: View, sensors: Sequence[int], /) -> Fused:
        """Pool the boxes of each sensor with the centre's detections in all far points, joined.

        Far points are beyond the hybrid radius of the sensor that measured them. sensors: indices,
        ascending. A sensor's bits count its boxes and its far points."""
        radius = self.find_radius(view.site)
        keep_far = partial(is_beyond, radius=radius, metric=self.metric)
        name = f"beyond {radius} m, {self.metric}"  # names the selection in the view's cache
        point_messages = view.share_points(sensors, part=name, keep=keep_far)
        far_clouds = [message.arrived for message in point_messages]
        centre_boxes = view.suppress([view.detect(far_clouds)])
        box_messages = view.share_boxes(sensors)
        sensor_boxes = [message.arrived for message in box_messages]
        boxes = view.suppress([*sensor_boxes, centre_boxes])
        point_bits = np.array([message.bits for message in point_messages], np.int64)
        box_bits = np.array([message.bits for message in box_messages], np.int64)
        return Fused(boxes.detections, bits=box_bits + point_bits, ms=boxes.ms)

    def sent_points(self, counts: Counts, /) -> Float32[np.ndarray, "candidates frames"]:
        """Return the number of points beyond the site's hybrid radius.

        counts: numbers of points of candidates in frames. Raises ValueError if the scheme has
        another radius or metric, for which nothing was counted."""
        if self.radius is not None or self.metric != "horizontal":
            remedy = "use Hybrid() at dataclasses.replace(site, hybrid_radius=...)"
            raise ValueError(
                f"far points are counted by the site's hybrid radius, not by {self}: {remedy}"
            )
        return counts.far

    def mask_pooled(
        self, distance: Float32[np.ndarray, "candidates objects"], radius: float, /
    ) -> Bool[np.ndarray, "candidates objects"]:
        """Mark objects whose points reach the centre, as they are beyond the radius.

        distance: distance (m) of objects from candidates; radius: the site's (m), used if the
        scheme has no other."""
        return distance > (radius if self.radius is None else self.radius)

    def find_radius(self, site: Area) -> float:
        """Radius (m) at a site: the scheme's, else the site's, else the paper's for a bare area."""
        if self.radius is not None:
            return self.radius
        return site.hybrid_radius if isinstance(site, Site) else HYBRID_RADIUS_M
