"""Samples as they are drawn: clouds and boxes counted from one origin, on level ground if wanted, with detections."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.datasets.sample import OtherObjects, Sample
from toolkit.detection.samples.detected import DETECTION_REACH, Detected, Level, detect_samples, middle_of
from toolkit.objects import LABELS, Detections, Detector, label_index
from toolkit.viewing.outcomes import MARKED, BoxesByKind, Marked, outcomes_of

OTHERS = "others"  # what a set labels beside our classes
BOX_KINDS = (*LABELS, OTHERS)
GROUND_PERCENTILE = 5.0  # percentile of heights where the ground of a cloud that is not levelled is taken to be

Colouring = Literal["sensor", "height", "intensity", "age"]
COLOURINGS: tuple[Colouring, ...] = ("sensor", "height", "intensity", "age")


@dataclass(frozen=True, eq=False)
class DrawnCloud:
    """Points of one sensor, and where it was, from the origin; intensity: as the set gives it; time: of each point,
    seconds from the sample's. None where the set has none."""

    name: str
    points: Float32[np.ndarray, "n 3"]
    place: Float64[np.ndarray, "3"]
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class DrawnSample:
    """One instant. truth, detections: boxes of each kind of `BOX_KINDS`, none for a kind that is not there; warning: of
    ground that is not level; outcomes: which are hits, missed and false alarms, nothing where nobody knows."""

    name: str
    time: float
    clouds: tuple[DrawnCloud, ...]
    truth: dict[str, Float64[np.ndarray, "_ 7"]]
    detections: dict[str, Float64[np.ndarray, "_ 7"]]
    warning: str | None = None
    outcomes: dict[Marked, BoxesByKind] = field(default_factory=dict)

    def described(self) -> str:
        """How much is in it, in one line."""
        points = sum(len(cloud.points) for cloud in self.clouds)
        counts: dict[str, int] = {"points": points, "labelled": _count(self.truth), "detected": _count(self.detections)}
        for name, boxes in self.outcomes.items():
            number = _count(boxes)
            counts[MARKED[name] if number == 1 else name] = number
        return f"{self.name}: " + ", ".join(f"{number} {what}" for what, number in counts.items())


def _count(boxes: dict[str, np.ndarray]) -> int:
    return sum(map(len, boxes.values()))


@dataclass(frozen=True)
class Drawing:
    """How samples are drawn: with what a detector finds, if there is one, and levelled as
    `toolkit.detection.samples.detected.detect_samples` does; middle: x and y, world frame, of where it detects; half:
    of the sides (m) of the area in which detections count; least_score: of those that are drawn; classes, sensors: only
    boxes of these, and only the clouds of these, all when None."""

    detector: Detector | None = None
    levelling: Level = "none"
    middle: tuple[float, float] | None = None
    half: tuple[float, float] = (DETECTION_REACH, DETECTION_REACH)
    least_score: float = 0.0
    classes: Sequence[str] | None = None
    sensors: Sequence[str] | None = None

    def origin(self, sample: Sample) -> Float64[np.ndarray, "3"]:
        """What a recording that begins with this sample is counted from, in metres, world frame: the middle of its
        sensors, and its ground where that stays as it is."""
        points = sample.points()
        stays = self.levelling == "none" and len(points) > 0
        low = np.round(np.percentile(points[:, 2], GROUND_PERCENTILE)) if stays else 0.0
        return np.array([*(middle_of(sample) if self.middle is None else self.middle), low], np.float64)

    def drawn(self, sample: Sample, origin: Float64[np.ndarray, "3"]) -> DrawnSample:
        """A sample as it is drawn. Raises ValueError for a levelling that there is not."""
        sample = sample if self.sensors is None else sample.seen_by(self.sensors)
        detector = self.detector or _detects_nothing
        (each,) = detect_samples([sample], detector, levelling=self.levelling, middle=self.middle)
        each = self._chosen(each)
        sample = each.sample
        ground, to_middle = each.ground, np.array([*each.middle, 0.0])
        back = to_middle - origin

        def placed(points: np.ndarray) -> np.ndarray:
            near = points - to_middle
            return (near if ground is None or not len(near) else ground.points(near)) + back

        def boxes(rows: np.ndarray) -> np.ndarray:
            near = rows - np.array([*to_middle, 0, 0, 0, 0])
            return (near if ground is None or not len(near) else ground.boxes(near)) + np.array([*back, 0, 0, 0, 0])

        clouds = tuple(
            DrawnCloud(
                cloud.name, placed(cloud.in_world()).astype(np.float32),
                placed(cloud.world_SE3_sensor[None, :3, 3])[0], cloud.time, cloud.intensity,
            )
            for cloud in sample.clouds
        )  # fmt: skip
        truth = _by_kind(boxes(sample.objects.boxes), sample.objects.labels)
        truth |= {OTHERS: boxes(sample.others.boxes)} if len(sample.others.boxes) else {}
        found = _by_kind(boxes(each.detections.boxes), each.detections.labels)
        known = {} if self.detector is None else outcomes_of(each, self.half)
        outcomes = {name: {kind: boxes(rows) for kind, rows in by.items()} for name, by in known.items()}
        return DrawnSample(sample.name, sample.time, clouds, truth, found, each.warning, outcomes)

    def _chosen(self, each: Detected) -> Detected:
        """What is to be drawn of a sample and what was detected in it."""
        found = each.detections[each.detections.scores >= self.least_score]
        if self.classes is None:
            return replace(each, detections=found)
        wanted = [label_index(label) for label in self.classes]
        sample = replace(each.sample.of(np.isin(each.sample.objects.labels, wanted)), others=OtherObjects())
        return replace(each, sample=sample, detections=found[np.isin(found.labels, wanted)])

    def all_of(
        self, samples: Iterable[Sample], progress: Callable[[int], None] = lambda done: None
    ) -> list[DrawnSample]:
        """Samples as they are drawn, counted from the origin of the first; progress: is handed how many are done."""
        drawn: list[DrawnSample] = []
        origin: np.ndarray | None = None
        for sample in samples:
            origin = self.origin(sample) if origin is None else origin
            drawn.append(self.drawn(sample, origin))
            progress(len(drawn))
        return drawn


def _detects_nothing(points: Float32[np.ndarray, "n 3"]) -> Detections:
    return Detections.empty()


def _by_kind(boxes: np.ndarray, labels: np.ndarray) -> dict[str, np.ndarray]:
    return {LABELS[label]: boxes[labels == label] for label in np.unique(labels).tolist()}


def thinned(cloud: DrawnCloud, most: int) -> DrawnCloud:
    """At most so many of a cloud's points, evenly taken, with their times and intensities."""
    if len(cloud.points) <= most:
        return cloud
    rows = np.linspace(0, len(cloud.points), most, endpoint=False).astype(np.int64)
    time = None if cloud.time is None else cloud.time[rows]
    intensity = None if cloud.intensity is None else cloud.intensity[rows]
    return replace(cloud, points=cloud.points[rows], time=time, intensity=intensity)


def colourings_of(samples: Sequence[DrawnSample]) -> tuple[Colouring, ...]:
    """By what the points of some samples can be coloured."""
    clouds = [cloud for sample in samples for cloud in sample.clouds]
    known = {
        "intensity": any(cloud.intensity is not None for cloud in clouds),
        "age": any(cloud.time is not None for cloud in clouds),
    }
    return tuple(each for each in COLOURINGS if known.get(each, True))
