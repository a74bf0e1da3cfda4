"""Frames as drawn: clouds, boxes and outcomes.

They are counted from one origin, on level ground if wanted. Outcomes are by the rule `measured` of
`toolkit.detection.evaluation`. A detection is true if its IoU by volume with a label of its class, which no surer
detection took, is at least `toolkit.detection.metrics.TRUE_IOU`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from toolkit.arrays import Float, Float32, Float64, UInt8
from toolkit.detection.breakdown import select_truth
from toolkit.detection.detect import Detected, detect_frames
from toolkit.detection.metrics import TRUE_IOU, match
from toolkit.detection.place import Place, find_middle
from toolkit.frame import Frame, OtherObjects
from toolkit.objects import LABELS, Detections, Detector, label_index
from toolkit.plots.palette import Outcome, sensor_colour

Marked = Literal["hits", "missed", "false alarms"]
MARKED: dict[Marked, Outcome] = {"hits": "hit", "missed": "missed", "false alarms": "false alarm"}

BoxesByKind = dict[str, Float64[np.ndarray, "_ 7"]]


def sort_outcomes(each: Detected) -> dict[Marked, BoxesByKind]:
    """Boxes of each outcome and class, world frame. Empty if nothing is labelled."""
    made: dict[Marked, BoxesByKind] = {name: {} for name in MARKED}
    if not len(each.frame.objects):
        return {}
    scored = select_truth(each.frame, each.stand.corners).judge(each.detections)
    for label, name in enumerate(LABELS):
        what = match(scored.found, scored.truths, TRUE_IOU[label], label=label, counted=scored.counted)
        rows = {
            "hits": scored.found.boxes[~what.ignored & (what.truth >= 0)],
            "missed": scored.truths.boxes[what.scored & ~what.hit],
            "false alarms": scored.found.boxes[~what.ignored & (what.truth < 0)],
        }
        for outcome, so_far in made.items():
            so_far |= {name: rows[outcome]} if len(rows[outcome]) else {}
    return made


OTHERS = "others"  # labels of classes other than ours
BOX_KINDS = (*LABELS, OTHERS)
GROUND_PERCENTILE = 5.0  # percentile of heights where the ground of a cloud that is not levelled is taken to be

Colouring = Literal["sensor", "height", "intensity", "age"]
COLOURINGS: tuple[Colouring, ...] = ("sensor", "height", "intensity", "age")


@dataclass(frozen=True, eq=False)
class DrawnCloud:
    """Points and place of one sensor, from the origin. intensity: as the set gives it; time: of each point, seconds
    from the frame's. Each is None if the set has none."""

    name: str
    points: Float32[np.ndarray, "n 3"]
    place: Float64[np.ndarray, "3"]
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None


@dataclass(frozen=True, eq=False)
class DrawnSample:
    """One instant to be drawn. truth, detections: boxes by kind of `BOX_KINDS`, without the kinds that are absent;
    warning: of ground that is not level; outcomes: hits, missed and false alarms, empty if unknown."""

    name: str
    time: float
    clouds: tuple[DrawnCloud, ...]
    truth: dict[str, Float64[np.ndarray, "_ 7"]]
    detections: dict[str, Float64[np.ndarray, "_ 7"]]
    warning: str | None = None
    outcomes: dict[Marked, BoxesByKind] = field(default_factory=dict)

    def describe(self) -> str:
        """Describe its contents in one line."""
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
    """Options for drawing frames. detector: its boxes are drawn too; place: where it looks, and on what ground;
    least_score: of the boxes that are drawn; classes, sensors: only boxes of these, and only the clouds of these, all
    when None."""

    detector: Detector | None = None
    place: Place = Place("none")
    least_score: float = 0.0
    classes: Sequence[str] | None = None
    sensors: Sequence[int | str] | None = None

    def origin(self, sample: Frame) -> Float64[np.ndarray, "3"]:
        """Origin (m) for a recording that begins with this frame. It is in the world frame: the middle of the sensors,
        and their ground if that stays as it is."""
        points = sample.points()
        stays = self.place.level == "none" and len(points) > 0
        low = np.round(np.percentile(points[:, 2], GROUND_PERCENTILE)) if stays else 0.0
        return np.array([*(find_middle(sample) if self.place.middle is None else self.place.middle), low], np.float64)

    def draw(self, sample: Frame, origin: Float64[np.ndarray, "3"]) -> DrawnSample:
        """Draw a frame. Raises ValueError for an unknown levelling."""
        sample = sample if self.sensors is None else sample.seen_by(self.sensors)
        detector = self.detector or _detects_nothing
        (each,) = detect_frames([sample], detector, self.place)
        each = self._chosen(each)
        sample = each.frame
        ground, to_middle = each.stand.ground, np.array([*each.stand.middle, 0.0])
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
        known = {} if self.detector is None else sort_outcomes(each)
        outcomes = {name: {kind: boxes(rows) for kind, rows in by.items()} for name, by in known.items()}
        return DrawnSample(sample.name, sample.time, clouds, truth, found, each.stand.warning, outcomes)

    def _chosen(self, each: Detected) -> Detected:
        """Select the labels and detections to be drawn."""
        found = each.detections[each.detections.scores >= self.least_score]
        if self.classes is None:
            return replace(each, detections=found)
        wanted = [label_index(label) for label in self.classes]
        sample = replace(each.frame.of(np.isin(each.frame.objects.labels, wanted)), others=OtherObjects())
        return replace(each, frame=sample, detections=found[np.isin(found.labels, wanted)])

    def draw_all(
        self, samples: Iterable[Frame], progress: Callable[[int], None] = lambda done: None
    ) -> list[DrawnSample]:
        """Draw frames from the origin of the first. progress: called with the number of frames done."""
        drawn: list[DrawnSample] = []
        origin: np.ndarray | None = None
        for sample in samples:
            origin = self.origin(sample) if origin is None else origin
            drawn.append(self.draw(sample, origin))
            progress(len(drawn))
        return drawn


def _detects_nothing(points: Float32[np.ndarray, "n 3"]) -> Detections:
    return Detections.empty()


def _by_kind(boxes: np.ndarray, labels: np.ndarray) -> dict[str, np.ndarray]:
    return {LABELS[label]: boxes[labels == label] for label in np.unique(labels).tolist()}


def thinned(cloud: DrawnCloud, most: int) -> DrawnCloud:
    """Thin a cloud to at most `most` points. They are taken evenly, with their times and intensities."""
    if len(cloud.points) <= most:
        return cloud
    rows = np.linspace(0, len(cloud.points), most, endpoint=False).astype(np.int64)
    time = None if cloud.time is None else cloud.time[rows]
    intensity = None if cloud.intensity is None else cloud.intensity[rows]
    return replace(cloud, points=cloud.points[rows], time=time, intensity=intensity)


def list_colourings(samples: Sequence[DrawnSample]) -> tuple[Colouring, ...]:
    """Colourings that the points of some frames allow."""
    clouds = [cloud for sample in samples for cloud in sample.clouds]
    known = {
        "intensity": any(cloud.intensity is not None for cloud in clouds),
        "age": any(cloud.time is not None for cloud in clouds),
    }
    return tuple(each for each in COLOURINGS if known.get(each, True))


UNKNOWN_SHADE = (150, 150, 150)  # of points without the coloured attribute
_SPREAD = (2.0, 98.0)  # percentiles that the scales span
_STEPS = 256

Span = tuple[float, float]


@dataclass(frozen=True)
class Scales:
    """Ranges of the colours. height is in m, intensity as the set gives it, age in s."""

    height: Span = (0.0, 1.0)
    intensity: Span = (0.0, 1.0)
    age: Span = (0.0, 1.0)

    @staticmethod
    def of(sample: DrawnSample) -> Scales:
        """Choose ranges that cover nearly all points of a frame."""
        clouds = sample.clouds
        newest = find_newest(sample)
        return Scales(
            _span([cloud.points[:, 2] for cloud in clouds]),
            _span([cloud.intensity for cloud in clouds if cloud.intensity is not None]),
            _span([newest - cloud.time for cloud in clouds if cloud.time is not None]),
        )

    def describe(self, colouring: Colouring) -> str:
        """Describe the range of a colouring.

        >>> Scales(height=(-0.1, 3.04)).describe("height")
        'height, -0.1 to 3.04 m'
        """
        if colouring == "sensor":
            return "sensor"
        low, high = {"height": self.height, "intensity": self.intensity, "age": self.age}[colouring]
        unit = {"height": " m", "intensity": "", "age": " s"}[colouring]
        return f"{colouring}, {low:.3g} to {high:.3g}{unit}"


def find_newest(sample: DrawnSample) -> float:
    """Time of a frame's newest point. It is in seconds from the frame's time; 0 if no time is known."""
    times = [float(cloud.time.max()) for cloud in sample.clouds if cloud.time is not None and len(cloud.time)]
    return max(times, default=0.0)


def shades(
    cloud: DrawnCloud, colouring: Colouring, scales: Scales, *, index: int, newest: float
) -> UInt8[np.ndarray, "n 3"]:
    """Red, green and blue of the points of a sensor. The sensor has number `index`. Dark is low, or new; newest: as
    `find_newest`."""
    if colouring == "sensor":
        return _uniform(tuple(bytes.fromhex(sensor_colour(index)[1:])), len(cloud.points))
    age = None if cloud.time is None else newest - cloud.time
    values = {"height": cloud.points[:, 2], "intensity": cloud.intensity, "age": age}[colouring]
    if values is None:
        return _uniform(UNKNOWN_SHADE, len(cloud.points))
    low, high = {"height": scales.height, "intensity": scales.intensity, "age": scales.age}[colouring]
    share = np.clip((values.astype(np.float64) - low) / max(high - low, 1e-9), 0.0, 1.0)
    return _scale()[(share * (_STEPS - 1)).astype(np.int64)]


def _uniform(colour: tuple[int, ...], count: int) -> np.ndarray:
    return np.tile(np.array(colour, np.uint8), (count, 1))


def _scale() -> UInt8[np.ndarray, "_ 3"]:
    """Viridis without its lightest end, which is lost on white."""
    from matplotlib import colormaps

    rgba = np.asarray(colormaps["viridis"](np.linspace(0.0, 0.92, _STEPS)))
    return np.round(255 * rgba[:, :3]).astype(np.uint8)


def _span(columns: list[Float[np.ndarray, " _"]]) -> Span:
    values = np.concatenate([np.zeros(0), *columns])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = np.percentile(values, _SPREAD).tolist()
    return low, high
