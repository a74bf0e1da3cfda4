"""Training of the second stage: boxes as they are detected, and boxes that are off at random, against the truth.

Boxes that are off at random are off by more than the detector is on vehicles it knows, as it is on those it does not:
of a vehicle of another make the first stage's sizes are guesses, and what the points say must count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.network.faces import SORTS, FaceFeatures, FaceNetworks, face_features, face_offsets
from models.network.voxelnet import VoxelNet
from models.training.packed import PackedFrames
from models.training.samples import read_points
from models.training.validation import detector_by_area
from models.training.widening import rebuilt
from toolkit.arrays import Float, Float32, Int64
from toolkit.boxes import count_points, iou_bev
from toolkit.objects import Detections, label_index
from toolkit.points import centred_in

FARTHEST_FACE = 0.6  # m; a face that is farther off than its points are counted cannot be found
FEWEST_POINTS = 5  # on an object, below which it teaches nothing
MATCHED = 0.4  # BEV IoU from which a detection is of an object
LOWEST_SCORE = 0.2  # of a detection to learn from
_SUBSETS, _ERRORS = 0.5, 0.3  # shares of the frames that some of the sensors see, and sensors with errors
BATCH = 512
STEPS = 5000
OFF = {"centre": 0.1, "yaw": np.deg2rad(1.5), "size": (0.06, 0.07, 0.05)}  # deviations of boxes that are off at random


class FaceExamples(NamedTuple):
    """Rows to learn from, by sort of face: what is seen, and how far outwards (m) the face belongs."""

    features: dict[str, Float32[np.ndarray, "n F"]]
    offsets: dict[str, Float32[np.ndarray, " n"]]


def face_examples(
    frames: PackedFrames,
    network: VoxelNet | None,
    labels: Sequence[str],
    *,
    count: int | None = None,
    seed: int = 0,
) -> FaceExamples:
    """Examples of the first `count` frames (None: all), half of them seen by a random subset of the sensors, some by
    sensors with errors. network: what detects them, without a second stage; None: boxes that are off at random alone.
    """
    detector_in = None if network is None else detector_by_area(network, score_threshold=LOWEST_SCORE)
    rows: dict[str, list[np.ndarray]] = {sort: [] for sort in SORTS}
    offsets: dict[str, list[np.ndarray]] = {sort: [] for sort in SORTS}
    wanted = [label_index(label) for label in labels]
    for k in range(min(len(frames), len(frames) if count is None else count)):
        rng = np.random.default_rng([seed, k])
        points = read_points(frames, k, rng, subsets=_SUBSETS, errors=_ERRORS)
        objects = frames.level_objects(k)
        there = np.isin(objects.labels, wanted) & centred_in(objects.boxes, np.array(frames.rig(k).area))
        objects = objects[there & (count_points(points, objects.boxes) >= FEWEST_POINTS)]
        boxes, truths, kinds = off_at_random(objects.boxes, rng), objects.boxes, objects.labels
        if detector_in is not None:
            found, owner = _detected(detector_in(frames.rig(k).area)(points), objects.boxes, objects.labels)
            boxes = np.concatenate([boxes, found])
            truths, kinds = np.concatenate([truths, truths[owner]]), np.concatenate([kinds, kinds[owner]])
        if len(boxes):
            _add(rows, offsets, face_features(points, boxes, kinds), face_offsets(boxes, truths))
    return FaceExamples(
        {sort: np.concatenate(parts) for sort, parts in rows.items()},
        {sort: np.concatenate(parts).astype(np.float32) for sort, parts in offsets.items()},
    )


def with_faces(
    network: VoxelNet, frames: PackedFrames, labels: Sequence[str], *, count: int = 1000, seed: int = 0
) -> VoxelNet:
    """The network with a second stage for the boxes of these labels, trained on the first `count` frames."""
    bare, staged = rebuilt(network, faces=()), rebuilt(network, faces=tuple(labels))
    assert staged.faces is not None
    fit_faces(staged.faces, face_examples(frames, bare, labels, count=count, seed=seed), seed=seed)
    return staged


def off_at_random(boxes: Float[np.ndarray, "n 7"], rng: np.random.Generator) -> Float[np.ndarray, "n 7"]:
    """Boxes that are off in place, size and yaw, and every second time face the other way; their floors stay."""
    boxes = boxes.copy()
    floor = boxes[:, 2] - boxes[:, 5] / 2
    small = np.minimum(boxes[:, 4] / 1.8, 1.0)[:, None]  # of a pedestrian, less
    boxes[:, :2] += rng.normal(0, OFF["centre"], (len(boxes), 2)) * small
    boxes[:, 3:6] *= 1 + rng.normal(0, OFF["size"], (len(boxes), 3))
    boxes[:, 2] = floor + boxes[:, 5] / 2
    boxes[:, 6] += rng.normal(0, OFF["yaw"], len(boxes)) + np.pi * (rng.random(len(boxes)) < 0.1)
    return boxes


def fit_faces(
    networks: FaceNetworks,
    examples: FaceExamples,
    *,
    steps: int | None = None,
    learning_rate: float = 3e-3,
    seed: int = 0,
) -> dict[str, float]:
    """Train the three networks, `STEPS` steps each; returns the mean error (m) of each sort of face before and after,
    over the examples.

    Raises ValueError where a sort of face has no examples.
    """
    figures: dict[str, float] = {}
    steps = STEPS if steps is None else steps
    for number, sort in enumerate(SORTS):
        if not len(examples.offsets[sort]):
            raise ValueError(f"there are no examples of a {sort}: pack frames with vehicles that have points")
        features = torch.from_numpy(examples.features[sort])
        target = torch.from_numpy(examples.offsets[sort]).clamp(-FARTHEST_FACE, FARTHEST_FACE)
        _fit(networks, sort, features, target, steps, learning_rate, seed)
        with torch.inference_mode():
            error = (networks.answers(sort, features)[0] - target).abs().mean()
        networks.prior[number] = target.abs().mean()
        figures |= {f"{sort} before": float(target.abs().mean()), f"{sort} after": float(error)}
    return figures


def _fit(
    networks: FaceNetworks, sort: str, features: Tensor, target: Tensor, steps: int, learning_rate: float, seed: int
) -> None:
    """Adam on the likelihood of the offsets under a Laplace distribution of the answered mean error."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        for layer in getattr(networks, sort):
            if hasattr(layer, "reset_parameters"):
                layer.reset_parameters()
        optimiser = torch.optim.AdamW(getattr(networks, sort).parameters(), learning_rate, weight_decay=1e-3)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, learning_rate, total_steps=steps, pct_start=0.1)
        for _ in range(steps):
            rows = torch.randint(len(target), (BATCH,))
            shift, spread = networks.answers(sort, features[rows])
            loss = ((shift - target[rows]).abs() * torch.exp(-spread) + spread).mean()
            optimiser.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            schedule.step()


def _detected(
    found: Detections, truths: Float[np.ndarray, "n 7"], labels: Int64[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "m 7"], Int64[np.ndarray, " m"]]:
    """The detections that are of an object, and its row."""
    overlap = iou_bev(found.boxes, truths) * (found.labels[:, None] == labels)
    if not overlap.size:
        return found.boxes[:0], np.zeros(0, np.int64)
    owner = overlap.argmax(axis=1)
    of_one = overlap.max(axis=1) > MATCHED
    return found.boxes[of_one], owner[of_one]


def _add(
    rows: dict[str, list[np.ndarray]],
    offsets: dict[str, list[np.ndarray]],
    features: FaceFeatures,
    offset: tuple[np.ndarray, ...],
) -> None:
    """Keep the faces about which there are points."""
    for number, sort in enumerate(SORTS):
        seen = features.counted[number] > 0
        rows[sort].append(features[number][seen])
        offsets[sort].append(offset[number][seen])
