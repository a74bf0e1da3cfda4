"""Built-in fusion schemes by name, and the fusion of a frame by one of them."""

from collections.abc import Sequence

import numpy as np

from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.paper_schemes import Early, Hybrid, Late
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.view import NMS_IOU, frame_view
from toolkit.frame import Frame, select_sensors
from toolkit.objects import Detector
from toolkit.points import Area

PAPER_SCHEMES = ("early", "late", "hybrid")  # order of schemes in tables and observations
_BUILT_IN: tuple[Scheme, ...] = Early(), Late(), Hybrid(), Foreground()
SCHEMES = {scheme.name: scheme for scheme in _BUILT_IN}


def schemes_in_steps(step: float) -> dict[str, Scheme]:
    """Return the built-in schemes by name; foreground sends measurements in steps of `step` (m)."""
    return {**SCHEMES, "foreground": Foreground(step)}


def find_scheme(scheme: Scheme | str) -> Scheme:
    """Return a fusion scheme by its name, or the scheme itself. Raises ValueError for others."""
    if isinstance(scheme, str) and scheme in SCHEMES:
        return SCHEMES[scheme]
    # an unknown name, a class instead of an instance, or an object that is no scheme
    if isinstance(scheme, str | type) or not isinstance(scheme, Scheme):
        alternative = (
            f"an object with the members of toolkit.detection.scheme.Scheme, got {scheme!r}"
        )
        raise ValueError(f"scheme must be one of {', '.join(SCHEMES)}, or {alternative}")
    return scheme


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
    """Fuse the measurements of a frame by a scheme or its name.

    sensors: indices or names in any order, None for all; site: a site, or its area xmin, ymin,
    xmax, ymax (m); height: height of the crop (m), None for the site's, else 4; iou_threshold: BEV
    IoU above which the less sure of two boxes of one label is dropped. No noise is added: draw it
    first with `toolkit.datasets.recordings`. Raises ValueError for a sensor that the frame does not
    have or that is named twice."""
    indices = select_sensors(frame.sensors, sensors)
    view = frame_view(
        frame, detector, site, height=height, codec=check_codec(codec), nms_iou=iou_threshold
    )
    fused = find_scheme(scheme).fuse(view, sorted(indices))
    # bits are in ascending order of indices: argsort twice (the rank) puts them in the given order
    ranks = np.argsort(np.argsort(indices))
    return Fused(fused.detections, bits=fused.bits[ranks], ms=fused.ms)
