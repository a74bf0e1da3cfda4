"""Picture of one frame, detections beside the truth. Detections are those of early fusion."""

from __future__ import annotations

from pathlib import Path

from toolkit.datasets.dataset import CoopDataset, noisy
from toolkit.detection.metrics import match
from toolkit.detection.provenance import detector_origin
from toolkit.detection.schemes import fuse_frame
from toolkit.objects import Detections, Detector, Objects
from toolkit.plots.plan_view import FrameOutcome, draw_frame
from toolkit.points import frame_points, has_centre_inside
from toolkit.sites.site import Site

IOU = 0.7  # at which a detection hits, in the paper's first column


def draw_example(recording: CoopDataset, detector: Detector, out: str | Path, *, seed: int = 0) -> None:
    """Draw the frame with the most objects from above. It shows hits, misses and false alarms of vehicles at `IOU`;
    seed: of the sensors' noise.
    """
    site = recording.site
    frame = noisy(max(recording, key=lambda frame: len(frame.objects)), seed)
    found = fuse_frame("early", frame, detector, site=site).detections
    sensors = f"{len(frame.sensors)} sensor{'s' * (len(frame.sensors) != 1)}"
    draw_frame(
        site,
        out,
        clouds=frame_points(frame, area=site),
        truth=frame.objects,
        detections=found,
        outcome=classify_frame(found, frame.objects, site),
        title=f"{site.name}, frame {frame.index}: early fusion of {sensors}, {detector_origin(detector)['detector']}",
    )


def classify_frame(found: Detections, truth: Objects, site: Site, iou: float = IOU) -> FrameOutcome:
    """Classify detections and vehicles of one frame. Objects centred outside the area do not count."""
    result = match(found, truth, iou, counted=has_centre_inside(truth.boxes, site.area))
    return FrameOutcome(iou, result.hit, ~result.scored, result.truth >= 0, result.ignored)
