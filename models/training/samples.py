"""Training examples: a packed frame with fresh noise, augmented, voxelised, and what its anchors should find."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.anchors import anchors
from models.network.voxels import Voxels, collate, voxelise
from models.training.augmentation import random_errors, thinned, tilted, with_errors
from models.training.packed import PackedFrames
from models.training.targets import Assignment, assign, assign_by_kind, sample
from toolkit.arrays import Bool, Float, Float32, Shaped
from toolkit.boxes import count_points, points_in_boxes
from toolkit.objects import HEAVY, Objects, label_index
from toolkit.points import centred_in

Augmentation = Literal["none", "object", "scene"]


class Batch(NamedTuple):
    """voxels of B clouds; labels (B, H, W, A) of `models.training.targets`; boxes (B, H, W, A, 7) that positives
    should find."""

    voxels: Voxels
    labels: Tensor
    boxes: Tensor

    def to(self, device: torch.device | str) -> Batch:
        """The same batch on another device."""
        return Batch(self.voxels.to(device), self.labels.to(device), self.boxes.to(device))


@dataclass(frozen=True)
class SampleRecipe:
    """How a frame becomes an example.

    subsets: share of examples made from a random subset of the sensors, so that one network serves any set.
    augmentation: object turns and shifts each object with its points (the paper's); scene turns and mirrors everything.
    positive, negative: IoU thresholds of the anchors; sampled: anchors in the loss, 0 for all; seen: points below which
    a vehicle is not asked for. errors, thinned, tilted: shares of the examples that sensors with errors see, whose
    points are thinned, whose ground is off zero and slopes (`models.training.augmentation`). elsewhere: share of the
    windows laid anywhere in the area, not near an object, where there is nothing but what looks like one. A network of
    several classes has the thresholds of its kinds.
    """

    subsets: float = 0.5
    augmentation: Augmentation = "none"
    positive: float = 0.5
    negative: float = 0.35
    sampled: int = 0
    seen: int = 3
    errors: float = 0.0
    thinned: float = 0.0
    tilted: float = 0.0
    elsewhere: float = 0.0


class Samples(torch.utils.data.Dataset[Batch]):
    """Example (epoch, k) of a packed file: the same whoever asks and whenever, different in every epoch."""

    def __init__(self, frames: PackedFrames, config: VoxelNetConfig, recipe: SampleRecipe, seed: int) -> None:
        self.frames, self.config, self.recipe, self.seed = frames, config, recipe, seed
        self._anchors = anchors(config).double().numpy()

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, epoch_and_frame: tuple[int, int]) -> Batch:
        epoch, k = epoch_and_frame
        rng = np.random.default_rng([self.seed, epoch, k])
        points, objects, inside = self._scene(k, rng)
        seen = count_points(points, objects.boxes) >= self.recipe.seen
        asked = inside & seen & centred_in(objects.boxes, np.array(self.config.area))
        found = self._assigned(objects, asked)
        if self.recipe.sampled:
            found = sample(found, rng, size=self.recipe.sampled, positives=self.recipe.sampled // 2)
        targets = torch.from_numpy(objects.boxes).float() if len(objects) else torch.ones(1, 7)
        return Batch(
            voxelise(points, self.config, rng=rng),
            torch.from_numpy(found.labels)[None],
            targets[torch.from_numpy(found.owner)][None],
        )

    def _assigned(self, objects: Objects, asked: Bool[np.ndarray, " n"]) -> Assignment:
        """What each anchor should find. A network that knows vehicles alone says nothing about heavy ones; one that
        knows both tells them apart."""
        if self.config.kinds:
            return assign_by_kind(self._anchors, self.config.kinds, objects.boxes, objects.labels, asked)
        vehicle = objects.labels == label_index(self.config.labels[0])
        rows = np.flatnonzero(vehicle & asked)
        ignored = objects.boxes[(vehicle & ~asked) | (objects.labels == HEAVY)]
        thresholds = {"positive": self.recipe.positive, "negative": self.recipe.negative}
        found = assign(self._anchors, objects.boxes[rows], **thresholds, ignored=ignored)
        return Assignment(found.labels, np.append(rows, 0)[found.owner])

    def _scene(self, k: int, rng: np.random.Generator) -> tuple[Float32[np.ndarray, "n 3"], Objects, np.ndarray]:
        """Points and objects of frame k in the frame of the grid, and which objects stood in the detection area."""
        points = read_points(self.frames, k, rng, subsets=self.recipe.subsets, errors=self.recipe.errors)
        objects, area = self.frames.level_objects(k), np.array(self.frames.rig(k).area)
        boxes, inside = objects.boxes.copy(), centred_in(objects.boxes, area)
        if self.recipe.augmentation == "object":
            points, boxes = jitter_objects(points, boxes, rng)
        grid = np.array(self.config.area)
        wanted = boxes[inside & (objects.labels == self._wanted(objects.labels[inside], rng)), :2]
        if self.recipe.elsewhere and rng.random() < self.recipe.elsewhere:
            wanted = wanted[:0]
        centre = window_centre(area, grid[2:] - grid[:2], wanted, rng)
        if self.recipe.augmentation == "scene":
            points, boxes = turn_scene(points, boxes, centre, rng)
        points, boxes = self._roughened(points, boxes, centre, rng)
        points[:, :2] += (grid[:2] + grid[2:]) / 2 - centre
        boxes[:, :2] += (grid[:2] + grid[2:]) / 2 - centre
        return points, Objects(boxes, objects.labels, objects.ids), inside

    def _roughened(
        self, points: np.ndarray, boxes: np.ndarray, centre: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """As the recipe says, with fewer points and on other ground; without either it draws no numbers."""
        if self.recipe.thinned and rng.random() < self.recipe.thinned:
            points = thinned(points, rng)
        if self.recipe.tilted and rng.random() < self.recipe.tilted:
            points, boxes = tilted(points, boxes, centre, rng)
        return points, boxes

    def _wanted(self, there: Shaped[np.ndarray, " n"], rng: np.random.Generator) -> int:
        """The class that a window is laid near: of those there each as often, so that rare ones are seen as well."""
        known = [label_index(name) for name in self.config.labels]
        if len(known) == 1:
            return known[0]
        present = [label for label in known if label in there] or known
        return int(rng.choice(present))


def read_points(
    frames: PackedFrames, k: int, rng: np.random.Generator, *, subsets: float, errors: float
) -> Float32[np.ndarray, "n 3"]:
    """Points of frame k in the crop, as all sensors see them together, or with a chance of `subsets` a random set of
    them; with a chance of `errors` with random errors, else with the noise of the sensors' models alone."""
    total, sensors = len(frames.rig(k).sensors), None
    if subsets and rng.random() < subsets:
        sensors = sorted(rng.choice(total, int(rng.integers(1, total + 1)), replace=False).tolist())
    if errors and rng.random() < errors and not frames.recorded(k):
        profile = random_errors(rng)
        return np.concatenate(with_errors(frames, k, profile, int(rng.integers(2**31)), sensors))
    return np.concatenate(frames.points(k, rng, sensors))


def stack(batch: list[Batch]) -> Batch:
    """Several examples as one batch."""
    voxels, labels, boxes = zip(*batch, strict=True)
    return Batch(collate(voxels), torch.cat(labels), torch.cat(boxes))


def window_centre(
    area: Float[np.ndarray, "4"],
    window: Float[np.ndarray, "2"],
    wanted: Float[np.ndarray, "n 2"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "2"]:
    """Where a window (m along x and y) of an area (xmin ymin xmax ymax, m) is centred: near one of the places wanted,
    so that little of it is empty, and inside the area along each side that is no shorter than the window."""
    middle, room = (area[:2] + area[2:]) / 2, ((area[2:] - area[:2] - window) / 2).clip(0)
    near = wanted[rng.integers(len(wanted))] if len(wanted) else rng.uniform(area[:2], area[2:])
    return np.clip(near + rng.uniform(-window / 2, window / 2), middle - room, middle + room)


def jitter_objects(
    points: Float32[np.ndarray, "n 3"],
    boxes: Float[np.ndarray, "m 7"],
    rng: np.random.Generator,
    *,
    yaw: float = np.deg2rad(18.0),
    shift: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:
    """Turn each object by up to ±yaw (rad) and shift it by N(0, shift) (m) in the plane, its points with it (paper,
    training process). An object that would then touch another stays where it was.
    """
    points, boxes = points.copy(), boxes.copy()
    reach = np.linalg.norm(boxes[:, 3:5], axis=1) / 2
    owned = points_in_boxes(points, boxes)
    for index in range(len(boxes)):
        turn, move = rng.uniform(-yaw, yaw), rng.normal(0, shift, 2)
        old = boxes[index, :2].copy()
        others = np.arange(len(boxes)) != index
        if (np.linalg.norm(boxes[others, :2] - (old + move), axis=1) < reach[others] + reach[index]).any():
            continue
        mine = owned[:, index]
        points[mine, :2] = (points[mine, :2] - old) @ _turned(turn).T + old + move
        boxes[index, :2] += move
        boxes[index, 6] += turn
    return points, boxes


def turn_scene(
    points: Float32[np.ndarray, "n 3"],
    boxes: Float[np.ndarray, "m 7"],
    centre: Float[np.ndarray, "2"],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Turn the whole scene about `centre` by any angle, and mirror every second one."""
    angle, mirror = rng.uniform(-np.pi, np.pi), rng.random() < 0.5
    matrix = _turned(angle) @ np.diag([1.0, -1.0 if mirror else 1.0])
    points, boxes = points.copy(), boxes.copy()
    points[:, :2] = (points[:, :2] - centre) @ matrix.T + centre
    boxes[:, :2] = (boxes[:, :2] - centre) @ matrix.T + centre
    boxes[:, 6] = angle + (-boxes[:, 6] if mirror else boxes[:, 6])
    return points, boxes


def _turned(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
