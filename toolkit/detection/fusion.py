"""Early, late and hybrid fusion: what is detected from what several sensors measured, and what each had to send.

    early    every sensor sends its points; the points together go through the detector once      (paper section II-C)
    late     every sensor detects in its own points and sends boxes                                         (II-D)
    hybrid   every sensor sends its boxes, and its points farther off than a radius; the far points together
             go through the detector as well                                                                (II-E)

Last, of boxes that overlap the surest stays (non-maximum suppression at BEV IoU 0.1, for all three as in the published
code, whatever the boxes' classes), so that one sensor gives the same early and late.

`early`, `late` and `hybrid` take a frame; `fuse_early`, `fuse_late` and `fuse_hybrid` take what its sensors have
computed already, so that an evaluation of many sensor sets computes that once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float32, Int64
from toolkit.boxes import nms
from toolkit.frame import Frame
from toolkit.objects import Detections, Detector
from toolkit.points import Area, Metric, beyond, frame_points, select_sensors
from toolkit.sites.site import Site

NMS_IOU = 0.1
HYBRID_RADIUS = {"tjunction": 20.0, "roundabout": 12.0}


@dataclass(frozen=True)
class Accounting:
    """Bits that sending costs. The defaults fit the paper: a point is 3 float32; a box 8, its 7 numbers and a score."""

    bits_per_point: int = 96
    bits_per_box: int = 256


PAPER = Accounting()


@dataclass(frozen=True)
class Fused:
    """What the fusion centre reports for a frame, and the bits that each sensor sent, in the order they were named."""

    detections: Detections
    bits: Int64[np.ndarray, " sensors"]

    @property
    def kbit_per_sensor(self) -> float:
        """Mean over the sensors, 1 kbit = 1000 bit (paper section IV-A); 0 without sensors."""
        return float(self.bits.mean()) / 1000 if len(self.bits) else 0.0


def early(
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    accounting: Accounting = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Detect once in the points of all sensors together (paper section II-C).

    sensors: indices or names, None for all; their order does not matter. site: a site, or its area xmin, ymin, xmax,
    ymax (m); height: of the crop (m), else the site's own, else 4. The frame is taken as it is: draw noise first with
    `toolkit.datasets.dataset.noisy`. Raises ValueError for a sensor the frame does not have.
    """
    chosen = select_sensors(frame.sensors, sensors)
    clouds = frame_points(frame, sorted(chosen), area=site, height=height)
    fused = fuse_early(clouds, detector, accounting=accounting, iou_threshold=iou_threshold)
    return Fused(fused.detections, fused.bits[_places(chosen)])


def late(
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    accounting: Accounting = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Detect in the points of each sensor and fuse the boxes (paper section II-D). Arguments as in `early`."""
    chosen = select_sensors(frame.sensors, sensors)
    clouds = frame_points(frame, chosen, area=site, height=height)
    return fuse_late([detector(points) for points in clouds], accounting=accounting, iou_threshold=iou_threshold)


def hybrid(
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    radius: float | None = None,
    metric: Metric = "horizontal",
    accounting: Accounting = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Late fusion, joined by what is detected in the points farther than `radius` from their sensor (section II-E).

    radius: in metres; 20 at the T-junction, 12 at the roundabout and 20 elsewhere if not given (section IV-B);
    metric: how it is measured, see `toolkit.points.beyond`; other arguments as in `early`.
    """
    chosen = select_sensors(frame.sensors, sensors)
    radius = hybrid_radius(site) if radius is None else radius
    clouds = frame_points(frame, sorted(chosen), area=site, height=height)
    far = [
        points[beyond(points, frame.sensors[which], radius, metric)]
        for which, points in zip(sorted(chosen), clouds, strict=True)
    ]
    centre = fuse_early(far, detector, accounting=accounting, iou_threshold=iou_threshold)
    local = [detector(points) for points in clouds]
    fused = fuse_hybrid(local, centre, accounting=accounting, iou_threshold=iou_threshold)
    return Fused(fused.detections, fused.bits[_places(chosen)])


def fuse_early(
    clouds: Sequence[Float32[np.ndarray, "_ 3"]],
    detector: Detector,
    *,
    accounting: Accounting = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Early fusion of the sensors' cropped clouds, world frame."""
    together = np.concatenate([np.zeros((0, 3), np.float32), *clouds])
    bits = np.array([len(points) * accounting.bits_per_point for points in clouds], np.int64)
    return Fused(suppress(detector(together), iou_threshold), bits)


def fuse_late(
    detections: Sequence[Detections], *, accounting: Accounting = PAPER, iou_threshold: float = NMS_IOU
) -> Fused:
    """Late fusion of what each sensor detected."""
    bits = np.array([len(boxes) * accounting.bits_per_box for boxes in detections], np.int64)
    return Fused(suppress(Detections.merge(detections), iou_threshold), bits)


def fuse_hybrid(
    detections: Sequence[Detections],
    far: Fused,
    *,
    accounting: Accounting = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Hybrid fusion of what each sensor detected with the early fusion of the points far from their sensors."""
    late_part = fuse_late(detections, accounting=accounting, iou_threshold=iou_threshold)
    everything = Detections.merge([*detections, far.detections])
    return Fused(suppress(everything, iou_threshold), late_part.bits + far.bits)


def suppress(detections: Detections, iou_threshold: float = NMS_IOU) -> Detections:
    """The detections, best first, less those whose BEV IoU with a surer one exceeds the threshold.

    Equal scores are settled by the boxes' numbers, so that the order they come in makes no difference.
    """
    ordered = detections[np.lexsort(detections.boxes.T)]
    return ordered[nms(ordered.boxes, ordered.scores, iou_threshold)]


def hybrid_radius(site: Area) -> float:
    """The radius (m) within which hybrid fusion sends no points (section IV-B); 20 where the paper has none."""
    return HYBRID_RADIUS.get(site.name, 20.0) if isinstance(site, Site) else 20.0


def _places(chosen: list[int]) -> np.ndarray:
    """Where each of `chosen` stands in `sorted(chosen)`."""
    return np.argsort(np.argsort(chosen, kind="stable"), kind="stable")
