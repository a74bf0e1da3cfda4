"""Average precision of a network in training. It needs neither Open3D nor a simulator."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch

from models.detector import VoxelNetDetector, relocate
from models.network.voxelnet import VoxelNet
from models.training.packed import Area, PackedFrames
from models.training.samples import read_points
from toolkit.arrays import Bool
from toolkit.detection.metrics import evaluate
from toolkit.objects import LABELS, VEHICLE, Detections, Detector, Objects
from toolkit.points import has_centre_inside

VEHICLE_LABEL = LABELS[VEHICLE]
IOU_THRESHOLDS = (0.7, 0.8, 0.9)
AREAS_KEPT = 4
OTHER_THRESHOLDS = (0.25, 0.5, 0.7)  # of cyclists, pedestrians and heavy vehicles, which are small, or vary more


def detector_by_area(
    network: VoxelNet, device: str | torch.device = "cpu", score_threshold: float = 0.05
) -> Callable[[Area], Detector]:
    """Return a function that makes an area's detector.

    The detector is the network's. The last few are kept: each has its anchors on the whole area, and a packed file may
    show thousands.
    """

    @lru_cache(maxsize=AREAS_KEPT)
    def at_work(area: Area) -> Detector:
        there = relocate(network, area, "general")
        return VoxelNetDetector(there, device=device, score_threshold=score_threshold)

    return at_work


def detect_frames(
    network: VoxelNet,
    frames: PackedFrames,
    *,
    count: int | None = None,
    seed: int = 0,
    device: str | torch.device = "cpu",
    subsets: float = 0.0,
    errors: float = 0.0,
) -> list[tuple[Detections, Objects, Bool[np.ndarray, " n"]]]:
    """Detect in the first `count` frames by early fusion.

    count: None for all. Returns detections, truth and a mask of objects centred in the frame's area. subsets, errors:
    shares of the frames seen by some of the sensors, and by sensors with errors (`read_points`).
    """
    training = network.training
    detector_in, results = detector_by_area(network, device), []
    for k in range(min(len(frames), count or len(frames))):
        area = frames.rig(k).area
        points = read_points(frames, k, np.random.default_rng([seed, k]), subsets=subsets, errors=errors)
        truth = frames.level_objects(k)
        results.append((detector_in(area)(points), truth, has_centre_inside(truth.boxes, np.array(area))))
    network.train(training)
    return results


def average_precision(
    network: VoxelNet,
    frames: PackedFrames,
    *,
    count: int | None = None,
    seed: int = 0,
    device: str | torch.device = "cpu",
) -> dict[str, float]:
    """AP3D of early fusion over the first `count` frames.

    count: None for all. Names are "AP@0.7" and so on for vehicles, "pedestrian AP@0.5" and so on for others; classes
    without objects are left out. Only objects centred in the area count; others are neither missed nor false alarms
    (protocol "exact"). Each frame is detected in its own area. seed: of the sensors' noise.
    """
    frame_by_frame = detect_frames(network, frames, count=count, seed=seed, device=device)
    detections, truths, counted = zip(*frame_by_frame, strict=True)
    figures: dict[str, float] = {}
    for label in network.config.labels:
        vehicle = label == VEHICLE_LABEL
        thresholds = IOU_THRESHOLDS if vehicle else OTHER_THRESHOLDS
        at = evaluate(detections, truths, iou_thresholds=thresholds, counted=counted, label=label)
        prefix = "" if vehicle else f"{label} "
        known = {threshold: result.ap for threshold, result in at.items() if result.truths or vehicle}
        figures |= {f"{prefix}AP@{threshold:g}": ap for threshold, ap in known.items()}
    return figures


def validation(
    data: Path, *, count: int | None = None, device: str | torch.device = "cpu"
) -> Callable[[VoxelNet], dict[str, float]]:
    """Return `average_precision` on a packed file, for `models.training.loop.train`."""
    frames = PackedFrames(data)
    return lambda network: average_precision(network, frames, count=count, device=device)
