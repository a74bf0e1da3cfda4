"""Training examples: a packed frame with fresh noise, augmented and voxelised, and its targets.

Augmentations of whole scenes are sensors with errors, fewer points, and ground that is slightly off
zero or slopes.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.grid import Voxels, anchors, collate, voxelise
from models.training.losses import assign, assign_by_kind, sample
from models.training.packed import STEPS_PER_METRE, PackedFrames, Rig
from toolkit.arrays import Float, Float32, Float64, Rng
from toolkit.boxes import count_points, points_in_boxes
from toolkit.geometry import level_rows, plane_rotation
from toolkit.objects import HEAVY, Objects, label_index
from toolkit.points import has_centre_inside
from toolkit.sensors import error_terms
from toolkit.sensors.error_profiles import ErrorProfile
from toolkit.sensors.error_terms import ErrorTerm, TrueImage
from toolkit.sensors.sensor import Sensor

_Points = Float32[np.ndarray, "n 3"]
_Boxes = Float[np.ndarray, "m 7"]
_Place = Float[np.ndarray, "2"]

MIN_KEPT_SHARE = 0.1  # points
LIFT_DEVIATION_M = 0.07  # height of the ground, as in surveys and imported sites
SLOPE_DEVIATION = 0.006  # slope of the ground along x and along y; 12 cm at 20 m
OUTSIDE_DEPTH_M = 150.0  # assumed distance of surfaces outside the crop, absent from packed files
MAX_JITTER_RAD = np.deg2rad(18.0)
_MAX_SPEEDS_M_S = np.array([14.0, 7.0, 1.8, 12.0])  # by class


def random_errors(rng: Rng) -> ErrorProfile:
    """Draw sensor errors, from none to beyond `poor`."""

    def strength(chance: float, maximum: float) -> float:
        return float(rng.uniform(0, maximum)) if rng.random() < chance else 0.0

    terms: tuple[ErrorTerm, ...] = (
        error_terms.Glass(share=strength(0.6, 1.0)),
        error_terms.Paint(share=strength(0.3, 0.4)),
        error_terms.DropOut(
            strength(0.8, 0.06), float(rng.uniform(150, 400)) if rng.random() < 0.3 else 0.0
        ),
        error_terms.MixedPixels(share=strength(0.7, 0.3)),
        error_terms.rain(strength(0.2, 15.0)),
        error_terms.DeadRows(share=strength(0.3, 0.04)),
        error_terms.BlindSector(share=strength(0.15, 0.4)),
        error_terms.OwnNoise(),
        error_terms.RangeBias(deviation=strength(0.3, 0.04)),
        error_terms.stereo_noise(baseline=1.0, focal=2000.0, disparity=strength(0.7, 0.2)),
        error_terms.lidar_noise(constant=0.0, proportional=strength(0.7, 0.001)),
        error_terms.Calibration(
            rotation=float(np.deg2rad(strength(0.8, 0.6))), translation=strength(0.8, 0.06)
        ),
        error_terms.ClockOffset(offset=strength(0.3, 0.07)),
    )
    return ErrorProfile("random", terms)


def with_errors(
    frames: PackedFrames,
    k: int,
    errors: ErrorProfile,
    seed: int,
    sensors: Iterable[int] | None = None,
) -> list[_Points]:
    """Points of frame k with sensor errors, in the crop of each chosen sensor (None: all), on level
    ground.

    Sensors have the poses that they are believed to have. Surfaces outside the crop can mix with
    surfaces inside, but give no points.
    """
    rig = frames.rig(k)
    objects = frames.objects(k)
    clouds = []
    velocities = _draw_velocities(objects, seed) if errors.needs_velocities else None
    pixels, steps = frames.changes(k)
    for s in range(len(rig.sensors)) if sensors is None else sensors:
        sensor = rig.sensors[s]
        depth = steps[s].astype(np.float32) / STEPS_PER_METRE
        outside_m = np.float32(min(OUTSIDE_DEPTH_M, 0.99 * sensor.model.max_range))
        image = np.full(sensor.model.shape, outside_m)
        flat = image.ravel()
        flat[rig.pixels[s]] = rig.depth[s]
        flat[pixels[s]] = np.where(depth > 0, depth, outside_m)
        truth = TrueImage(sensor, image, objects, velocities=velocities)
        reading = errors.read(truth, seed=seed, sensor=s, frame=k)
        measured = reading.measurement.ravel()
        is_inside = (flat < outside_m) | (measured < 0.9 * outside_m)
        seen = np.flatnonzero(reading.valid.ravel() & is_inside).astype(np.uint32)
        believed_rig = Rig(
            (Sensor(sensor.name, sensor.model, reading.pose),), rig.area, rig.height, (), ()
        )
        points = believed_rig.world(0, seen, measured[seen])
        if reading.shift is not None:
            points += reading.shift.reshape(-1, 3)[seen]
        clouds.append(level_rows(points[rig.in_crop(points)], rig.slope))
    return clouds


def _draw_velocities(objects: Objects, seed: int) -> Float64[np.ndarray, "n 3"]:
    """Velocities (m/s) along the headings; every second object is still.

    Packed frames have no tracks.
    """
    rng = np.random.default_rng([seed, 7])
    yaw = objects.boxes[:, 6]
    max_speed = rng.uniform(0, 1, len(objects)) * _MAX_SPEEDS_M_S[objects.labels]
    speed = max_speed * (rng.random(len(objects)) < 0.5)
    return np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros(len(yaw))])


def thin_cloud(points: _Points, rng: Rng) -> Float32[np.ndarray, "k 3"]:
    """Keep a tenth to all of the points at random."""
    return points[rng.random(len(points)) < rng.uniform(MIN_KEPT_SHARE, 1.0)]


def tilt(points: _Points, boxes: _Boxes, centre: _Place, rng: Rng) -> tuple[_Points, _Boxes]:
    """Lift the ground by N(0, 7 cm) and tilt it about `centre` by N(0, 0.6 %) along x and y.

    Boxes stay upright.
    """
    lift = rng.normal(0, LIFT_DEVIATION_M)
    slope = rng.normal(0, SLOPE_DEVIATION, 2)
    points = points.copy()
    boxes = boxes.copy()
    points[:, 2] += lift + (points[:, :2] - centre) @ slope
    boxes[:, 2] += lift + (boxes[:, :2] - centre) @ slope
    return points, boxes


class Batch(NamedTuple):
    """Examples ready for training, of B clouds."""

    voxels: Voxels
    labels: Tensor  # (B, H, W, A), see `models.training.losses`
    boxes: Tensor  # (B, H, W, A, 7), targets of positive anchors

    def to(self, device: torch.device | str) -> "Batch":
        """Move the batch to another device."""
        return Batch(self.voxels.to(device), self.labels.to(device), self.boxes.to(device))


@dataclass(frozen=True)
class SampleRecipe:
    """Recipe that turns a frame into an example.

    A network of several classes has the thresholds of its kinds.
    """

    # share of examples seen by a random subset of the sensors, so that one network serves any set
    subsets: float = 0.5
    augmentation: Literal["none", "object", "scene"] = "none"
    """object: turn and shift each object with its points (the paper's); scene: turn and mirror
    everything."""
    positive: float = 0.5  # IoU thresholds of the anchors
    negative: float = 0.35
    sampled: int = 0  # anchors in the loss, 0 for all
    seen: int = 3  # points below which a vehicle need not be detected
    errors: float = 0.0  # share of examples with sensor errors
    thinned: float = 0.0  # share with thinned points
    tilted: float = 0.0  # share with uneven ground
    elsewhere: float = 0.0  # share of the windows anywhere in the area instead of near an object
    windows: int = 1  # from each reading of a frame, which costs three times as much as the rest


class Samples(torch.utils.data.Dataset[Batch]):
    """Samples (epoch, k) of a packed file, reproducible."""

    def __init__(
        self, frames: PackedFrames, config: VoxelNetConfig, recipe: SampleRecipe, seed: int
    ) -> None:
        self.frames = frames
        self.config = config
        self.recipe = recipe
        self.seed = seed
        self._anchors = anchors(config).double().numpy()

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, epoch_and_frame: tuple[int, int]) -> Batch:
        epoch, k = epoch_and_frame
        rng = np.random.default_rng([self.seed, epoch, k])
        recipe = self.recipe
        points = read_sample_points(
            self.frames, k, rng, subsets=recipe.subsets, errors=recipe.errors
        )
        return stack([self._example(k, points, rng) for _ in range(recipe.windows)])

    def _example(self, k: int, points: _Points, rng: Rng) -> Batch:
        points, objects, is_inside = self._scene(k, points.copy(), rng)
        is_seen = count_points(points, objects.boxes) >= self.recipe.seen
        is_required = (
            is_inside & is_seen & has_centre_inside(objects.boxes, np.array(self.config.area))
        )
        if self.config.kinds:
            assignment = assign_by_kind(
                self._anchors, self.config.kinds, objects.boxes, objects.labels, is_required
            )
        else:  # a network only for vehicles ignores heavy ones
            is_vehicle = objects.labels == label_index(self.config.labels[0])
            rows = np.flatnonzero(is_vehicle & is_required)
            ignored = objects.boxes[(is_vehicle & ~is_required) | (objects.labels == HEAVY)]
            thresholds = {"positive": self.recipe.positive, "negative": self.recipe.negative}
            assignment = assign(self._anchors, objects.boxes[rows], **thresholds, ignored=ignored)
            assignment = assignment._replace(owner=np.append(rows, 0)[assignment.owner])
        if self.recipe.sampled:
            assignment = sample(
                assignment, rng, size=self.recipe.sampled, positives=self.recipe.sampled // 2
            )
        targets = torch.from_numpy(objects.boxes).float() if len(objects) else torch.ones(1, 7)
        voxels = voxelise(points, self.config, rng=rng)
        return Batch(
            voxels,
            torch.from_numpy(assignment.labels)[None],
            targets[torch.from_numpy(assignment.owner)][None],
        )

    def _scene(self, k: int, points: _Points, rng: Rng) -> tuple[_Points, Objects, np.ndarray]:
        """Points and objects of frame k in the grid's frame, and a mask of objects in the detection
        area."""
        recipe = self.recipe
        objects = self.frames.level_objects(k)
        area = np.array(self.frames.rig(k).area)
        boxes = objects.boxes.copy()
        is_inside = has_centre_inside(objects.boxes, area)
        if recipe.augmentation == "object":
            points, boxes = jitter_objects(points, boxes, rng)
        grid = np.array(self.config.area)
        classes = [label_index(name) for name in self.config.labels]
        # the window is near an object of any present class, each equally often
        if len(classes) > 1:
            present = [label for label in classes if label in objects.labels[is_inside]]
            classes = [int(rng.choice(present or classes))]
        targets = boxes[is_inside & (objects.labels == classes[0]), :2]
        if recipe.elsewhere and rng.random() < recipe.elsewhere:
            targets = targets[:0]
        window = grid[2:] - grid[:2]
        middle = (area[:2] + area[2:]) / 2
        room = ((area[2:] - area[:2] - window) / 2).clip(0)
        if len(targets):
            target = targets[rng.integers(len(targets))]
        else:
            target = rng.uniform(area[:2], area[2:])
        offset = rng.uniform(-window / 2, window / 2)
        centre = np.clip(target + offset, middle - room, middle + room)
        if recipe.augmentation == "scene":
            points, boxes = turn_scene(points, boxes, centre, rng)
        if recipe.thinned and rng.random() < recipe.thinned:
            points = thin_cloud(points, rng)
        if recipe.tilted and rng.random() < recipe.tilted:
            points, boxes = tilt(points, boxes, centre, rng)
        points[:, :2] += (grid[:2] + grid[2:]) / 2 - centre
        boxes[:, :2] += (grid[:2] + grid[2:]) / 2 - centre
        return points, Objects(boxes, objects.labels, objects.ids), is_inside


def read_sample_points(
    frames: PackedFrames, k: int, rng: Rng, *, subsets: float, errors: float
) -> _Points:
    """Points of frame k in the crop.

    subsets: chance of a random set of sensors instead of all; errors: chance of random errors
    instead of the sensor models' noise.
    """
    total = len(frames.rig(k).sensors)
    sensors = None
    if subsets and rng.random() < subsets:
        sensors = sorted(rng.choice(total, int(rng.integers(1, total + 1)), replace=False).tolist())
    if errors and rng.random() < errors and not frames.is_recorded(k):
        profile = random_errors(rng)
        return np.concatenate(with_errors(frames, k, profile, int(rng.integers(2**31)), sensors))
    return np.concatenate(frames.points(k, rng, sensors))


def stack(batch: list[Batch]) -> Batch:
    """Join examples into one batch."""
    return Batch(
        voxels=collate([example.voxels for example in batch]),
        labels=torch.cat([example.labels for example in batch]),
        boxes=torch.cat([example.boxes for example in batch]),
    )


def jitter_objects(points: _Points, boxes: _Boxes, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Turn each object with its points by up to ±18°, and shift it by N(0, 0.5) (m) in the plane.

    An object that would then touch another stays put (paper, training process).
    """
    points = points.copy()
    boxes = boxes.copy()
    reach = np.linalg.norm(boxes[:, 3:5], axis=1) / 2
    is_in_box = points_in_boxes(points, boxes)
    for index in range(len(boxes)):
        turn = rng.uniform(-MAX_JITTER_RAD, MAX_JITTER_RAD)
        move = rng.normal(0, 0.5, 2)
        old = boxes[index, :2].copy()
        is_other = np.arange(len(boxes)) != index
        distances = np.linalg.norm(boxes[is_other, :2] - (old + move), axis=1)
        if (distances < reach[is_other] + reach[index]).any():
            continue
        is_in_object = is_in_box[:, index]
        offsets = points[is_in_object, :2] - old
        points[is_in_object, :2] = offsets @ plane_rotation(turn).T + old + move
        boxes[index, :2] += move
        boxes[index, 6] += turn
    return points, boxes


def turn_scene(points: _Points, boxes: _Boxes, centre: _Place, rng: Rng) -> tuple[_Points, _Boxes]:
    """Turn the scene about `centre`, every second one mirrored."""
    angle = rng.uniform(-np.pi, np.pi)
    mirror = rng.random() < 0.5
    matrix = plane_rotation(angle) @ np.diag([1.0, -1.0 if mirror else 1.0])
    points = points.copy()
    boxes = boxes.copy()
    points[:, :2] = (points[:, :2] - centre) @ matrix.T + centre
    boxes[:, :2] = (boxes[:, :2] - centre) @ matrix.T + centre
    boxes[:, 6] = angle + (-boxes[:, 6] if mirror else boxes[:, 6])
    return points, boxes
