"""Early, late and hybrid fusion of one frame: what is detected from what several sensors measured, and what each sent.

    early    every sensor sends its points; the points together go through the detector once      (paper section II-C)
    late     every sensor detects in its own points and sends boxes                                         (II-D)
    hybrid   every sensor sends its boxes, and its points farther off than a radius; the far points together
             go through the detector as well                                                                (II-E)

Last, of boxes of one class that overlap the surest stays (non-maximum suppression at BEV IoU 0.1, for all three as in
the published code, which knows vehicles only), so that one sensor gives the same early and late. A pedestrian beside a
cyclist and a car below a bus's overhang are two objects, so classes do not suppress each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.early import Early
from toolkit.detection.hybrid import Hybrid
from toolkit.detection.late import Late
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.schemes import scheme_of
from toolkit.detection.view import NMS_IOU, frame_view
from toolkit.frame import Frame
from toolkit.objects import Detector
from toolkit.points import Area, Distance, select_sensors


def fuse_frame(
    scheme: Scheme | str,
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    codec: Codec = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Fuse what the sensors of a frame measured, by a scheme or its name.

    sensors: indices or names, None for all; their order does not matter. site: a site, or its area xmin, ymin, xmax,
    ymax (m); height: of the crop (m), else the site's own, else 4; codec: of what is sent. The frame is taken as it is:
    draw noise first with `toolkit.datasets.dataset.noisy`.
    Raises ValueError for a sensor the frame does not have, or one that is named twice.
    """
    chosen = select_sensors(frame.sensors, sensors)
    view = frame_view(frame, detector, site, height=height, codec=check_codec(codec), nms_iou=iou_threshold)
    fused = scheme_of(scheme).fuse(view, sorted(chosen))
    return Fused(fused.detections, fused.bits[np.argsort(np.argsort(chosen))], fused.ms)


def early(
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    codec: Codec = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Detect once in the points of all sensors together (paper section II-C). Arguments as of `fuse_frame`."""
    return fuse_frame(
        Early(), frame, detector, sensors, site=site, height=height, codec=codec, iou_threshold=iou_threshold
    )


def late(
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    codec: Codec = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Detect in the points of each sensor and fuse the boxes (paper section II-D). Arguments as of `fuse_frame`."""
    return fuse_frame(
        Late(), frame, detector, sensors, site=site, height=height, codec=codec, iou_threshold=iou_threshold
    )


def hybrid(
    frame: Frame,
    detector: Detector,
    sensors: Sequence[int | str] | None = None,
    *,
    site: Area,
    height: float | None = None,
    radius: float | None = None,
    metric: Distance = "horizontal",
    codec: Codec = PAPER,
    iou_threshold: float = NMS_IOU,
) -> Fused:
    """Late fusion, joined by what is detected in the points farther than `radius` from their sensor (section II-E).

    radius: in metres, None for the site's own, 20 for a bare area (section IV-B); metric: how it is measured, see
    `toolkit.points.beyond`; other arguments as of `fuse_frame`.
    """
    scheme = Hybrid(radius, metric)
    return fuse_frame(
        scheme, frame, detector, sensors, site=site, height=height, codec=codec, iou_threshold=iou_threshold
    )
