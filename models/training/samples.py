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
from toolkit.arrays import Float, Float32, Float64, Mask, Rng, Shaped
from toolkit.boxes import count_points, points_in_boxes
from toolkit.geometry import level_rows, plane_rotation
from toolkit.objects import HEAVY, Objects, label_index
from toolkit.points import has_centre_inside
from toolkit.sensors import error_terms
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.readings import ErrorTerm, TrueImage
from toolkit.sensors.sensor import Sensor

_Points = Float32[np.ndarray, "n 3"]
_Boxes = Float[np.ndarray, "m 7"]
_Place = Float[np.ndarray, "2"]

MIN_KEPT_SHARE = 0.1  # points
LIFT_DEVIATION_M = 0.07  # height of the ground, as in surveys and imported sites
SLOPE_DEVIATION = 0.006  # slope of the ground along x and along y; 12 cm at 20 m
OUTSIDE_DEPTH_M = 150.0  # assumed distance of surfaces outside the crop, absent from packed files
MAX_JITTER_RAD = np.deg2rad(18.0)
_MAX_SPEEDS_M_S = np.array([14.0, 7.0, 1.8, 12.0])  # by class, in the order of `LABELS`


def random_errors(rng: Rng) -> ErrorProfile:
    """Random sensor errors, from none to beyond the profile `poor`."""

    def strength(chance: float, highest: float) -> float:
        """A strength up to the highest with this chance, else 0."""
        return float(rng.uniform(0, highest)) if rng.random() < chance else 0.0

    # Each strength needs the generator, so their order is part of the result. Lengths are in m,
    # rain in mm/h, times in s, the focal length and disparity in pixels.
    terms: tuple[ErrorTerm, ...] = (
        error_terms.Glass(share=strength(chance=0.6, highest=1.0)),
        error_terms.Paint(share=strength(chance=0.3, highest=0.4)),
        error_terms.DropOut(
            share=strength(chance=0.8, highest=0.06),
            half_range=float(rng.uniform(150, 400)) if rng.random() < 0.3 else 0.0,
        ),
        error_terms.MixedPixels(share=strength(chance=0.7, highest=0.3)),
        error_terms.rain(strength(chance=0.2, highest=15.0)),
        error_terms.DeadRows(share=strength(chance=0.3, highest=0.04)),
        error_terms.BlindSector(share=strength(chance=0.15, highest=0.4)),
        error_terms.OwnNoise(),
        error_terms.RangeBias(deviation=strength(chance=0.3, highest=0.04)),
        error_terms.stereo_noise(
            baseline=1.0, focal=2000.0, disparity=strength(chance=0.7, highest=0.2)
        ),
        error_terms.lidar_noise(constant=0.0, proportional=strength(chance=0.7, highest=0.001)),
        error_terms.Calibration(
            rotation=float(np.deg2rad(strength(chance=0.8, highest=0.6))),
            translation=strength(chance=0.8, highest=0.06),
        ),
        error_terms.ClockOffset(offset=strength(chance=0.3, highest=0.07)),
    )
    return ErrorProfile("random", terms)


def apply_errors(
    frames: PackedFrames,
    k: int,
    errors: ErrorProfile,
    seed: int,
    sensors: Iterable[int] | None = None,
) -> list[_Points]:
    """Points of frame k with sensor errors, in the crop of each chosen sensor (None: all), on level
    ground.

    Points are computed from the poses that the sensors are believed to have. Surfaces outside the
    crop can mix with surfaces inside, but give no points.
    """
    rig = frames.rig(k)
    objects = frames.objects(k)
    clouds = []
    velocities = _draw_velocities(objects, seed) if errors.needs_velocities else None
    changed_pixels, changed_steps = frames.changes(k)
    for s in range(len(rig.sensors)) if sensors is None else sensors:
        sensor = rig.sensors[s]
        changed_depth = changed_steps[s].astype(np.float32) / STEPS_PER_METRE
        outside_m = np.float32(min(OUTSIDE_DEPTH_M, 0.99 * sensor.model.max_range))
        image = np.full(sensor.model.shape, outside_m)
        true_depth = image.ravel()  # a view: it fills the image
        true_depth[rig.pixels[s]] = rig.depth[s]
        true_depth[changed_pixels[s]] = np.where(changed_depth > 0, changed_depth, outside_m)
        truth = TrueImage(sensor, image, objects, velocities=velocities)
        reading = errors.read(truth, seed=seed, sensor=s, frame=k)
        depth = reading.measurement.ravel()
        # a pixel of the outside counts if a term put something much nearer there, such as rain
        has_point = reading.valid.ravel() & ((true_depth < outside_m) | (depth < 0.9 * outside_m))
        pixels = np.flatnonzero(has_point).astype(np.uint32)
        believed_rig = Rig(
            sensors=(Sensor(sensor.name, sensor.model, reading.pose),),
            area=rig.area,
            height=rig.height,
            pixels=(),
            depth=(),
        )
        points = believed_rig.world(0, pixels, depth[pixels])
        if reading.shift is not None:
            points += reading.shift.reshape(-1, 3)[pixels]
        clouds.append(level_rows(points[rig.in_crop(points)], rig.slope))
    return clouds


def _draw_velocities(objects: Objects, seed: int) -> Float64[np.ndarray, "n 3"]:
    """Random velocities (m/s) along the headings, since packed frames have no tracks; half of the
    objects are still."""
    rng = np.random.default_rng([seed, 7])  # 7: another stream than others of this seed
    yaw = objects.boxes[:, 6]
    max_speed = rng.uniform(0, 1, len(objects)) * _MAX_SPEEDS_M_S[objects.labels]
    speed = max_speed * (rng.random(len(objects)) < 0.5)
    return np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros(len(yaw))])


def thin_cloud(points: _Points, rng: Rng) -> Float32[np.ndarray, "k 3"]:
    """Random tenth to all of the points, in their order."""
    return points[rng.random(len(points)) < rng.uniform(MIN_KEPT_SHARE, 1.0)]


def tilt(points: _Points, boxes: _Boxes, centre: _Place, rng: Rng) -> tuple[_Points, _Boxes]:
    """Points and boxes on ground that is lifted and tilted at random; boxes stay upright.

    The lift is N(0, 7 cm), the slopes along x and y are N(0, 0.6 %) about `centre` (x, y in m).
    """
    lift = rng.normal(0, LIFT_DEVIATION_M)
    slope = rng.normal(0, SLOPE_DEVIATION, 2)
    points = points.copy()
    boxes = boxes.copy()
    points[:, 2] += lift + (points[:, :2] - centre) @ slope
    boxes[:, 2] += lift + (boxes[:, :2] - centre) @ slope
    return points, boxes


class Batch(NamedTuple):
    """Examples ready for training, of B clouds.

    Attributes:
        voxels: Points of all clouds, by voxel.
        labels: POSITIVE, NEGATIVE or IGNORED of `models.training.losses` for each anchor.
        boxes: Box that each positive anchor should detect; meaningless for other anchors.
    """

    voxels: Voxels
    labels: Shaped[Tensor, "B H W A"]
    boxes: Float32[Tensor, "B H W A 7"]

    def to(self, device: torch.device | str) -> "Batch":
        """Copy of the batch on a device."""
        return Batch(
            voxels=self.voxels.to(device),
            labels=self.labels.to(device),
            boxes=self.boxes.to(device),
        )


@dataclass(frozen=True)
class SampleRecipe:
    """Recipe that turns a frame into examples.

    Attributes:
        subsets: Share of frames seen by a random subset of the sensors, so that one network serves
            any set.
        augmentation: "object": turn and shift each object with its points (the paper's); "scene":
            turn and mirror everything.
        positive: IoU above which an anchor is positive, if the network has no kinds of anchors:
            kinds have thresholds of their own.
        negative: IoU up to which an anchor is negative, if the network has no kinds of anchors.
        sampled: Anchors in the loss, 0 for all.
        seen: Points below which an object need not be detected.
        errors: Share of frames with sensor errors.
        thinned: Share of examples with thinned points.
        tilted: Share of examples with uneven ground.
        elsewhere: Share of the windows anywhere in the area instead of near an object.
        windows: Examples from each reading of a frame, which costs three times as much as the
            rest.
    """

    subsets: float = 0.5
    augmentation: Literal["none", "object", "scene"] = "none"
    positive: float = 0.5
    negative: float = 0.35
    sampled: int = 0
    seen: int = 3
    errors: float = 0.0
    thinned: float = 0.0
    tilted: float = 0.0
    elsewhere: float = 0.0
    windows: int = 1


class _Scene(NamedTuple):
    """Points and objects of one frame in the grid's frame.

    Attributes:
        points: x y z, m.
        objects: Objects.
        is_in_area: True for the objects that are centred in the detection area of the site.
    """

    points: _Points
    objects: Objects
    is_in_area: Mask


class Samples(torch.utils.data.Dataset[Batch]):
    """Samples of a packed file: `samples[epoch, k]` has the examples of frame k in an epoch.

    The same seed, epoch and frame give the same examples.
    """

    def __init__(
        self, frames: PackedFrames, config: VoxelNetConfig, recipe: SampleRecipe, seed: int
    ) -> None:
        """Keep the frames and how examples are made from them; seed: for all random numbers."""
        self.frames = frames
        self.config = config
        self.recipe = recipe
        self.seed = seed
        self._anchors = anchors(config).double().numpy()

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, epoch_and_frame: tuple[int, int]) -> Batch:
        """Batch of random windows on a frame; they are different in each epoch."""
        epoch, k = epoch_and_frame
        rng = np.random.default_rng([self.seed, epoch, k])
        recipe = self.recipe
        points = read_sample_points(
            self.frames, k, rng, subsets=recipe.subsets, errors=recipe.errors
        )
        return stack([self._example(k, points, rng) for _ in range(recipe.windows)])

    def _example(self, k: int, points: _Points, rng: Rng) -> Batch:
        """One example from the points (x y z in the site's frame, m) of frame k."""
        scene = self._scene(k, points.copy(), rng)
        points = scene.points
        objects = scene.objects
        is_seen = count_points(points, objects.boxes) >= self.recipe.seen
        is_in_window = has_centre_inside(objects.boxes, np.array(self.config.area))
        is_required = scene.is_in_area & is_seen & is_in_window
        if self.config.kinds:
            assignment = assign_by_kind(
                self._anchors,
                self.config.kinds,
                boxes=objects.boxes,
                labels=objects.labels,
                is_required=is_required,
            )
        else:  # a network only for vehicles ignores heavy ones
            is_vehicle = objects.labels == label_index(self.config.labels[0])
            rows = np.flatnonzero(is_vehicle & is_required)
            ignored = objects.boxes[(is_vehicle & ~is_required) | (objects.labels == HEAVY)]
            assignment = assign(
                self._anchors,
                objects.boxes[rows],
                positive=self.recipe.positive,
                negative=self.recipe.negative,
                ignored=ignored,
            )
            # without vehicles `rows` is empty, but owners are 0: one more row to take
            assignment = assignment._replace(owner=np.append(rows, 0)[assignment.owner])
        if self.recipe.sampled:
            assignment = sample(
                assignment, rng, size=self.recipe.sampled, positives=self.recipe.sampled // 2
            )
        # without objects owners are 0: one box to take
        targets = torch.from_numpy(objects.boxes).float() if len(objects) else torch.ones(1, 7)
        return Batch(
            voxels=voxelise(points, self.config, rng=rng),
            labels=torch.from_numpy(assignment.labels)[None],
            boxes=targets[torch.from_numpy(assignment.owner)][None],
        )

    def _scene(self, k: int, points: _Points, rng: Rng) -> _Scene:
        """Frame k, augmented and moved into a random window of its area.

        points: x y z in the site's frame (m); they may be changed in place.
        """
        recipe = self.recipe
        objects = self.frames.level_objects(k)
        area = np.array(self.frames.rig(k).area)  # xmin ymin xmax ymax, as `grid`
        boxes = objects.boxes.copy()
        is_in_area = has_centre_inside(objects.boxes, area)
        if recipe.augmentation == "object":
            points, boxes = jitter_objects(points, boxes, rng)
        grid = np.array(self.config.area)
        classes = [label_index(name) for name in self.config.labels]
        # the window is near an object of any present class, each equally often
        if len(classes) > 1:
            present_classes = [label for label in classes if label in objects.labels[is_in_area]]
            classes = [int(rng.choice(present_classes or classes))]
        targets = boxes[is_in_area & (objects.labels == classes[0]), :2]
        if recipe.elsewhere and rng.random() < recipe.elsewhere:
            targets = targets[:0]
        window = grid[2:] - grid[:2]
        middle = (area[:2] + area[2:]) / 2
        max_offset = ((area[2:] - area[:2] - window) / 2).clip(0)  # within the area
        target = (
            targets[rng.integers(len(targets))] if len(targets) else rng.uniform(area[:2], area[2:])
        )
        centre = np.clip(
            target + rng.uniform(-window / 2, window / 2), middle - max_offset, middle + max_offset
        )
        if recipe.augmentation == "scene":
            points, boxes = turn_scene(points, boxes, centre, rng)
        if recipe.thinned and rng.random() < recipe.thinned:
            points = thin_cloud(points, rng)
        if recipe.tilted and rng.random() < recipe.tilted:
            points, boxes = tilt(points, boxes, centre, rng)
        shift = (grid[:2] + grid[2:]) / 2 - centre  # from the window to the grid
        points[:, :2] += shift
        boxes[:, :2] += shift
        moved_objects = Objects(boxes=boxes, labels=objects.labels, ids=objects.ids)
        return _Scene(points=points, objects=moved_objects, is_in_area=is_in_area)


def read_sample_points(
    frames: PackedFrames, k: int, rng: Rng, *, subsets: float, errors: float
) -> _Points:
    """Points of frame k in the crop (x y z on level ground, m).

    subsets: chance of a random set of sensors instead of all; errors: chance of random errors
    instead of the sensor models' noise.
    """
    total = len(frames.rig(k).sensors)
    sensors = None
    if subsets and rng.random() < subsets:
        sensors = sorted(rng.choice(total, int(rng.integers(1, total + 1)), replace=False).tolist())
    if errors and rng.random() < errors and not frames.is_recorded(k):
        profile = random_errors(rng)
        return np.concatenate(
            apply_errors(frames, k, errors=profile, seed=int(rng.integers(2**31)), sensors=sensors)
        )
    return np.concatenate(frames.points(k, rng, sensors))


def stack(batch: list[Batch]) -> Batch:
    """One batch of several, in their order."""
    return Batch(
        voxels=collate([example.voxels for example in batch]),
        labels=torch.cat([example.labels for example in batch]),
        boxes=torch.cat([example.boxes for example in batch]),
    )


def jitter_objects(points: _Points, boxes: _Boxes, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Points and boxes, each object turned by up to ±18° and shifted by N(0, 0.5) (m) in the plane.

    Its points go with it. An object that would then touch another stays put (paper, training
    process); circles about the footprints count. boxes: x, y, z, length, width, height (m), yaw.
    """
    points = points.copy()
    boxes = boxes.copy()
    radius = np.linalg.norm(boxes[:, 3:5], axis=1) / 2
    is_in_box = points_in_boxes(points, boxes)
    for row in range(len(boxes)):
        turn = rng.uniform(-MAX_JITTER_RAD, MAX_JITTER_RAD)
        shift = rng.normal(0, 0.5, 2)
        centre = boxes[row, :2].copy()
        is_other = np.arange(len(boxes)) != row
        distance = np.linalg.norm(boxes[is_other, :2] - (centre + shift), axis=1)
        if (distance < radius[is_other] + radius[row]).any():
            continue
        is_in_object = is_in_box[:, row]
        from_centre = points[is_in_object, :2] - centre
        points[is_in_object, :2] = from_centre @ plane_rotation(turn).T + centre + shift
        boxes[row, :2] += shift
        boxes[row, 6] += turn
    return points, boxes


def turn_scene(points: _Points, boxes: _Boxes, centre: _Place, rng: Rng) -> tuple[_Points, _Boxes]:
    """Points and boxes turned about `centre` by any angle, and mirrored in half of the scenes.

    Headings count from +x, so a mirrored y changes the sign of a box's yaw. boxes: x, y, z, length,
    width, height (m), yaw (rad); centre: x, y (m)."""
    angle = rng.uniform(-np.pi, np.pi)
    is_mirrored = rng.random() < 0.5
    # y is mirrored first, then the scene is turned
    matrix = plane_rotation(angle) @ np.diag([1.0, -1.0 if is_mirrored else 1.0])
    points = points.copy()
    boxes = boxes.copy()
    points[:, :2] = (points[:, :2] - centre) @ matrix.T + centre
    boxes[:, :2] = (boxes[:, :2] - centre) @ matrix.T + centre
    boxes[:, 6] = angle + (-boxes[:, 6] if is_mirrored else boxes[:, 6])
    return points, boxes
