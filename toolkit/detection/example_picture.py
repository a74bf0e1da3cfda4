"""A picture of one frame of a recording: what early fusion of all its sensors detects, beside the truth."""

from __future__ import annotations

from pathlib import Path

from toolkit.datasets.dataset import CoopDataset, noisy
from toolkit.detection.fusion import early
from toolkit.objects import Detector
from toolkit.plots import draw_frame
from toolkit.points import frame_points


def draw_example(recording: CoopDataset, detector: Detector, out: str | Path, *, seed: int = 0) -> None:
    """Draw the frame with the most objects from above; seed: of the sensors' noise."""
    site = recording.site
    frame = noisy(max(recording, key=lambda frame: len(frame.objects)), seed)
    draw_frame(
        site, out, clouds=frame_points(frame, area=site), truth=frame.objects,
        detections=early(frame, detector, site=site).detections,
        title=f"{site.name}, frame {frame.index}: early fusion of {len(frame.sensors)} sensors",
    )  # fmt: skip
