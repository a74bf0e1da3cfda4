"""A detector in samples of clouds: points put on level ground about the sensors, detected in, boxes put back.

A detector that learnt on ground at z = 0 finds nothing in a raw cloud, whose origin is the lidar. So the ground is
found first (`toolkit.calibration.ground`), in every sample or, where the sensors stand still, once. Detectors work in
float32 about an origin near by: points are counted from the middle of the area to be detected in, and boxes are
brought back into the sample's world frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Literal

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.calibration.ground import Ground, level, level_warning
from toolkit.calibration.scenes import SampleScenes
from toolkit.datasets.sample import Sample
from toolkit.detection.codec import PAPER, Codec, ImageCodec
from toolkit.detection.scheme import Scheme, scheme_codec
from toolkit.detection.view import CROP_HEIGHT, LinkMemory, sample_view
from toolkit.objects import Detections, Detector, Objects
from toolkit.points import is_inside

Level = Literal["map", "plane", "none"]
DETECTION_REACH = 50.0  # m
LEVELS: tuple[Level, ...] = ("map", "plane", "none")


@dataclass(frozen=True, eq=False)
class Detected:
    """What was found in one sample, world frame.

    ground: below its points, counted from the middle; None where it was not levelled. level_ms, detect_ms: what finding
    the ground and detecting took. warning: of ground that is not at z = 0. bits: what each sensor sent of a fusion
    scheme, none without one.
    """

    sample: Sample
    detections: Detections
    ground: Ground | None
    middle: Float64[np.ndarray, "2"]
    level_ms: float
    detect_ms: float
    warning: str | None = None
    bits: tuple[int, ...] = ()

    @property
    def kbit_per_sensor(self) -> float:
        """The mean of what the sensors sent, NaN where none did."""
        return float(np.mean(self.bits)) / 1000 if self.bits else float("nan")


def detect_samples(
    samples: Iterable[Sample],
    detector: Detector,
    *,
    levelling: Level = "map",
    middle: Sequence[float] | None = None,
    still: bool = False,
    sensors: Sequence[str] | None = None,
    scheme: Scheme | None = None,
    half: tuple[float, float] = (DETECTION_REACH, DETECTION_REACH),
    codec: Codec = PAPER,
    scenes: SampleScenes | None = None,
) -> Iterator[Detected]:
    """What the detector finds in each sample, one after the other.

    detector: sees points counted from the middle; middle: x and y, world frame, of where it detects, the sensors' own
    when None; still: the sensors do not move, the ground is found once; sensors: only the clouds of these (names).
    scheme: how the sensors share what they see, all clouds at once when None; half: of the sides of the area (m) that
    schemes crop to, about the middle; codec: of what they send; scenes: of the sensors, for schemes and codecs that
    send pixels of range images.
    A sample without points has no detections, one without ground is detected in as it is, with a warning.
    Raises ValueError for a levelling that there is not.
    """
    if levelling not in LEVELS:
        raise ValueError(f"levelling must be one of {', '.join(LEVELS)}, got {levelling!r}")
    kept: Ground | None = None
    images = scenes if sends_images(scheme, codec) else None
    memory, remembered = LinkMemory(), list[str]()
    for number, every in enumerate(samples):
        centre = middle_of(every) if middle is None else np.array(middle, np.float64)
        sample = every if sensors is None else every.seen_by(sensors)
        points = sample.points() - [*centre, 0.0]
        start = perf_counter()
        ground, warning = (kept, None) if kept is not None else _levelled(points, levelling)
        if still:
            kept = ground
        middle_time = perf_counter()
        if scheme is None:
            upright = points if ground is None or not len(points) else ground.points(points)
            found, bits = detector(upright.astype(np.float32)) if len(points) else Detections.empty(), ()
        else:
            names = [cloud.name for cloud in sample.clouds]
            memory, remembered = (memory if names == remembered else LinkMemory()), names
            view = sample_view(
                sample, detector, ground, centre, np.array([-half[0], -half[1], *half]),
                codec=codec, scenes=images, number=number, memory=memory,
            )  # fmt: skip
            fused = scheme.fuse(view, range(len(sample.clouds)))
            found, bits = fused.detections, tuple(fused.bits.tolist())
        end = perf_counter()
        boxes = found.boxes if ground is None or not len(found) else ground.boxes_back(found.boxes)
        placed = Detections(boxes + np.array([*centre, 0, 0, 0, 0, 0]), found.scores, found.labels)
        times = 1e3 * (middle_time - start), 1e3 * (end - middle_time)
        yield Detected(sample, placed, ground, centre, *times, warning, bits)


def sends_images(scheme: Scheme | None, codec: Codec) -> bool:
    """Whether sensors send pixels of their images."""
    return scheme is not None and scheme.sends_points and isinstance(scheme_codec(scheme, codec), ImageCodec)


def middle_of(sample: Sample) -> Float64[np.ndarray, "2"]:
    """The middle of the sensors' places, world frame, to the metre; the origin where there is no sensor.

    >>> from toolkit.objects import Objects
    >>> middle_of(Sample("0", (), Objects.empty())).tolist()
    [0.0, 0.0]
    """
    places = [cloud.world_SE3_sensor[:2, 3] for cloud in sample.clouds]
    return np.asarray(np.round(np.mean(places, axis=0)), np.float64) if places else np.zeros(2)


def _levelled(points: np.ndarray, levelling: Level) -> tuple[Ground | None, str | None]:
    """The ground below points, and what is to be said of it."""
    if not len(points):
        return None, None
    if levelling == "none":
        return None, level_warning(points)
    try:
        return level(points, method=levelling), None
    except ValueError as error:
        return None, f"not levelled: {error}"


MARGIN_AROUND = 5.0  # m around the area, in which objects are kept, so that those on its edge are known


@dataclass(frozen=True, eq=False)
class LevelSample:
    """Names of sensors and their points in the area, below 4 m; objects in the area or close beside it; the area:
    xmin ymin xmax ymax (m), about the origin."""

    sensors: tuple[str, ...]
    clouds: tuple[Float32[np.ndarray, "_ 3"], ...]
    objects: Objects
    area: tuple[float, float, float, float]


def level_samples(
    samples: Iterable[Sample],
    *,
    levelling: Level = "map",
    middle: tuple[float, float] | None = None,
    half: tuple[float, float] = (DETECTION_REACH, DETECTION_REACH),
    still: bool = False,
) -> Iterator[LevelSample]:
    """Samples on level ground; arguments as of `toolkit.detection.detect.detect_samples`. Samples without
    points, or without ground where it is looked for, are left out."""
    area = (-half[0], -half[1], half[0], half[1])
    kept: Ground | None = None
    for sample in samples:
        centre = middle_of(sample) if middle is None else np.array(middle, np.float64)
        points = sample.points() - [*centre, 0.0]
        if not len(points):
            continue
        if kept is None and levelling != "none":
            try:
                kept = level(points, method=levelling)
            except ValueError:
                continue
        yield _level_sample(sample, kept, centre, area)
        if not still:
            kept = None


def _level_sample(
    sample: Sample, ground: Ground | None, centre: np.ndarray, area: tuple[float, float, float, float]
) -> LevelSample:
    clouds = []
    for cloud in sample.clouds:
        points = cloud.in_world()
        # a point is where labels are complete if a small box there is
        small = np.column_stack([points, np.full((len(points), 3), 0.1), np.zeros(len(points))])
        points = points[sample.complete.covers(small)] - [*centre, 0.0]
        upright = (points if ground is None or not len(points) else ground.points(points)).astype(np.float32)
        clouds.append(upright[is_inside(upright, np.array(area), CROP_HEIGHT)])
    boxes = sample.objects.boxes - np.array([*centre, 0, 0, 0, 0, 0])
    boxes = boxes if ground is None or not len(boxes) else ground.boxes(boxes)
    near = (np.abs(boxes[:, :2]) <= np.array(area[2:]) + MARGIN_AROUND).all(axis=1)
    objects = Objects(boxes, sample.objects.labels, sample.objects.ids)[np.asarray(near)]
    return LevelSample(tuple(cloud.name for cloud in sample.clouds), tuple(clouds), objects, area)
