"""Picture of one frame, detections beside the truth. Detections are those of early fusion."""

from __future__ import annotations

from pathlib import Path

from toolkit.datasets.dataset import CoopDataset, noisy
from toolkit.detection.metrics import match
from toolkit.detection.provenance import detector_origin
from toolkit.detection.schemes import fuse_frame
from toolkit.objects import Detector
from toolkit.plots.plan_view import FrameOutcome, draw_frame
from toolkit.points import frame_points, has_centre_inside

IOU = 0.7  # at which a detection hits, in the paper's first column


def draw_example(recording: CoopDataset, detector: Detector, out: str | Path, *, seed: int = 0) -> None:
    """Draw the frame with the most objects, and hits, misses and false alarms of vehicles at `IOU`, from above.

    Objects centred outside the area do not count. seed: of the sensors' noise.
    """
    site = recording.site
    frame = noisy(max(recording, key=lambda frame: len(frame.objects)), seed)
    truth, found = frame.objects, fuse_frame("early", frame, detector, site=site).detections
    result = match(found, truth, IOU, counted=has_centre_inside(truth.boxes, site.area))
    sensors = f"{len(frame.sensors)} sensor{'s' * (len(frame.sensors) != 1)}"
    draw_frame(
        site,
        out,
        clouds=frame_points(frame, area=site),
        truth=truth,
        detections=found,
        outcome=FrameOutcome(IOU, result.hit, ~result.scored, result.truth >= 0, result.ignored),
        title=f"{site.name}, frame {frame.index}: early fusion of {sensors}, {detector_origin(detector)['detector']}",
    )
