"""Average precision of a network in training."""

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

IOU_THRESHOLDS = (0.7, 0.8, 0.9)
AREAS_KEPT = 4
OTHER_THRESHOLDS = (0.25, 0.5, 0.7)  # of cyclists, pedestrians and heavy vehicles, which are small, or vary more


def detector_by_area(
    network: VoxelNet, device: str | torch.device = "cpu", score_threshold: float = 0.05
) -> Callable[[Area], Detector]:
    """Return a function that makes the network's detector of an area; the last few are kept."""

    @lru_cache(maxsize=AREAS_KEPT)  # each has its anchors on the whole area, and a packed file may show thousands
    def at_work(area: Area) -> Detector:
        return VoxelNetDetector(relocate(network, area, "general"), device=device, score_threshold=score_threshold)

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
    """Detect in the first `count` frames (None: all) by early fusion.

    Returns detections, truth and a mask of objects centred in the frame's area. subsets, errors: see `read_points`.
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
    """AP3D of early fusion over the first `count` frames (None: all), in the protocol "exact".

    Names are "AP@0.7" and so on for vehicles, "pedestrian AP@0.5" and so on for others; classes without objects are
    left out. seed: of the sensors' noise.
    """
    judged = detect_frames(network, frames, count=count, seed=seed, device=device)
    detections, truths, counted = zip(*judged, strict=True)
    figures: dict[str, float] = {}
    for label in network.config.labels:
        vehicle = label == LABELS[VEHICLE]
        thresholds, prefix = (IOU_THRESHOLDS, "") if vehicle else (OTHER_THRESHOLDS, f"{label} ")
        at = evaluate(detections, truths, iou_thresholds=thresholds, counted=counted, label=label)
        figures |= {f"{prefix}AP@{at_iou:g}": each.ap for at_iou, each in at.items() if each.truths or vehicle}
    return figures


def validation(
    data: Path, *, count: int | None = None, device: str | torch.device = "cpu"
) -> Callable[[VoxelNet], dict[str, float]]:
    """Return `average_precision` on a packed file, as `train` calls it."""
    frames = PackedFrames(data)
    return lambda network: average_precision(network, frames, count=count, device=device)
