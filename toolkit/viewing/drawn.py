"""Frames as drawn: clouds, boxes and outcomes, counted from one origin, on level ground if wanted.
Outcomes are by the rule `measured` of `toolkit.detection.evaluation`: a detection is true if its
IoU by volume with a label of its class, which no surer detection took, is at least
`toolkit.detection.metrics.TRUE_IOU`."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from toolkit.arrays import Float32, Float64, UInt8
from toolkit.detection.breakdown import select_truth
from toolkit.detection.detect import Detected, detect_frames
from toolkit.detection.metrics import TRUE_IOU, matches, second_labels
from toolkit.detection.place import Place
from toolkit.display import describe_count
from toolkit.frame import Frame, OtherObjects
from toolkit.objects import LABELS, Detections, Detector, label_index
from toolkit.plots.canvas import Outcome, sensor_colour

Marked = Literal["hits", "missed", "false alarms", "ignored"]
_OUTCOMES: tuple[tuple[Marked, Outcome], ...] = (
    ("hits", "hit"),
    ("missed", "missed"),
    ("false alarms", "false alarm"),
)
MARKED: dict[Marked, Outcome] = {**dict(_OUTCOMES), "ignored": "not scored"}

BoxesByKind = dict[str, Float64[np.ndarray, "_ 7"]]


def sort_outcomes(detected: Detected) -> dict[Marked, dict[str, Detections]]:
    """Detections of each outcome and class, world frame, and labelled boxes that were missed, with
    scores NaN.

    Every detection is a hit, a false alarm or ignored: beyond the area or the complete labels, or
    on an object that does not count. The second label of an object is a false alarm."""
    by_outcome: dict[Marked, dict[str, Detections]] = {name: {} for name in MARKED}
    if not len(detected.frame.objects):
        return {}
    truth = select_truth(detected.frame, detected.stand.corners)
    detections = detected.detections
    outside = ~truth.inside(detected.detections)
    match_class = partial(
        matches, detections, truth.objects, counted=truth.counted, outside=outside
    )
    second = second_labels(detections, truth.objects, counted=truth.counted, outside=outside)
    for label, name in enumerate(LABELS):
        (what,) = match_class([TRUE_IOU[label]], label=label)
        of_class = detections.labels == label
        false = (~what.ignored & (what.truth < 0)) | (second & of_class)
        missed = truth.objects[what.scored & ~what.hit]
        rows: dict[Marked, Detections] = {
            "hits": detections[~what.ignored & (what.truth >= 0)],
            "missed": Detections(missed.boxes, np.full(len(missed), np.nan), missed.labels),
            "false alarms": detections[false],
            "ignored": detections[what.ignored & of_class & ~second],
        }
        for outcome, so_far in by_outcome.items():
            so_far |= {name: rows[outcome]} if len(rows[outcome]) else {}
    return by_outcome


OTHERS = "others"  # labels of classes other than ours
BOX_KINDS = (*LABELS, OTHERS)
GROUND_PERCENTILE = (
    5.0  # percentile of heights where the ground of a cloud that is not levelled is taken to be
)

Colouring = Literal["sensor", "height", "intensity", "age"]
COLOURINGS: tuple[Colouring, ...] = ("sensor", "height", "intensity", "age")


@dataclass(frozen=True, eq=False)
class DrawnCloud:
    """Points and place of one sensor, from the origin. intensity: as the set gives it; time: of
    each point, seconds from the frame's. Each is None if the set has none."""

    name: str
    points: Float32[np.ndarray, "n 3"]
    place: Float64[np.ndarray, "3"]
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None


class Tag(NamedTuple):
    """Class and score beside a box, with its outcome, and where that stands: the middle of the
    roof."""

    kind: str
    outcome: Outcome
    text: str
    place: tuple[float, float, float]


def _list_tags(outcome: Outcome, kind: str, boxes: np.ndarray, rows: Detections) -> list[Tag]:
    tags = []
    for (x, y, z, _, _, height, _), score in zip(boxes.tolist(), rows.scores, strict=True):
        text = f"{kind} missed" if outcome == "missed" else f"{kind} {score:.2f}"
        tags.append(
            Tag(
                kind,
                outcome,
                text + (" false" if outcome == "false alarm" else ""),
                (x, y, z + height / 2),
            )
        )
    return tags


@dataclass(frozen=True, eq=False)
class DrawnSample:
    """One instant to be drawn. truth, detections: boxes by kind of `BOX_KINDS`, without the kinds
    that are absent; warning: of ground that is not level; outcomes: boxes by outcome, empty if
    unknown; tags: of detected and missed."""

    name: str
    time: float
    clouds: tuple[DrawnCloud, ...]
    truth: BoxesByKind
    detections: BoxesByKind
    warning: str | None = None
    outcomes: dict[Marked, BoxesByKind] = field(default_factory=dict)
    tags: tuple[Tag, ...] = ()

    def describe(self) -> str:
        """Describe its contents in one line."""
        labelled, detected = (
            sum(map(len, boxes.values())) for boxes in (self.truth, self.detections)
        )
        of_labels = of_detections = ""
        if self.outcomes:
            hits, missed, false, ignored = (
                sum(map(len, self.outcomes[name].values())) for name in MARKED
            )
            of_labels = f" ({hits} hit, {missed} missed, {labelled - hits - missed} not counted)"
            alarms = describe_count(false, "false alarm")
            of_detections = f" ({describe_count(hits, 'hit')}, {alarms}, {ignored} ignored)"
        points = sum(len(cloud.points) for cloud in self.clouds)
        return (
            f"{self.name}: {points} points, {labelled} labelled{of_labels}, {detected} "
            f"detected{of_detections}"
        )


@dataclass(frozen=True)
class Drawing:
    """Options for drawing frames. detector: its boxes are drawn too; place: where it looks, and on
    what ground; least_score: of the boxes that are drawn; classes, sensors: only boxes of these,
    and only the clouds of these, all when None."""

    detector: Detector | None = None
    place: Place = Place("none")
    least_score: float = 0.0
    classes: Sequence[str] | None = None
    sensors: Sequence[int | str] | None = None

    def origin(self, sample: Frame) -> Float64[np.ndarray, "3"]:
        """Origin (m) for a recording that begins with this frame. It is in the world frame: the
        middle of the sensors, and their ground if that stays as it is."""
        points = sample.points()
        stays = self.place.level == "none" and len(points) > 0
        low = np.round(np.percentile(points[:, 2], GROUND_PERCENTILE)) if stays else 0.0
        return np.array([*self.place.find_middle(sample), low], np.float64)

    def draw(self, sample: Frame, origin: Float64[np.ndarray, "3"]) -> DrawnSample:
        """Draw a frame. Raises ValueError for an unknown levelling."""
        sample = sample if self.sensors is None else sample.seen_by(self.sensors)
        detector = self.detector or (lambda points: Detections.empty())
        (detected,) = detect_frames([sample], detector, self.place)
        detected = replace(
            detected, detections=detected.detections[detected.detections.scores >= self.least_score]
        )
        if self.classes is not None:
            wanted_labels = [label_index(label) for label in self.classes]
            frame = replace(
                detected.frame.of(np.isin(detected.frame.objects.labels, wanted_labels)),
                others=OtherObjects(),
            )
            class_detections = detected.detections[
                np.isin(detected.detections.labels, wanted_labels)
            ]
            detected = replace(detected, frame=frame, detections=class_detections)
        sample = detected.frame
        found_detections = detected.detections
        ground = detected.stand.ground
        to_middle = np.array([*detected.stand.middle, 0.0])
        back = to_middle - origin

        def placed(points: np.ndarray) -> np.ndarray:
            near = points - to_middle
            return (near if ground is None or not len(near) else ground.points(near)) + back

        def boxes(rows: np.ndarray) -> np.ndarray:
            near = rows - np.array([*to_middle, 0, 0, 0, 0])
            return (near if ground is None or not len(near) else ground.boxes(near)) + np.array(
                [*back, 0, 0, 0, 0]
            )

        clouds = []
        for cloud in sample.clouds:
            points = placed(cloud.in_world()).astype(np.float32)
            position = placed(cloud.world_SE3_sensor[None, :3, 3])[0]
            clouds.append(DrawnCloud(cloud.name, points, position, cloud.time, cloud.intensity))
        truth = sort_kinds(boxes(sample.objects.boxes), sample.objects.labels)
        truth |= {OTHERS: boxes(sample.others.boxes)} if len(sample.others.boxes) else {}
        detections = sort_kinds(boxes(found_detections.boxes), found_detections.labels)
        by_outcome = {} if self.detector is None else sort_outcomes(detected)
        outcomes: dict[Marked, dict[str, np.ndarray]] = {}
        for name, by_kind in by_outcome.items():
            outcomes[name] = {kind: boxes(rows.boxes) for kind, rows in by_kind.items()}
        marked = [
            (MARKED[name], kind, rows)
            for name, by in by_outcome.items()
            for kind, rows in by.items()
        ]
        marked = marked or [
            ("detection", LABELS[label], found_detections[found_detections.labels == label])
            for label in set(found_detections.labels)
        ]
        tags = tuple(
            tag
            for outcome, kind, rows in marked
            for tag in _list_tags(outcome, kind, boxes(rows.boxes), rows)
        )
        drawn = DrawnSample(sample.name, sample.time, tuple(clouds), truth, detections)
        return replace(drawn, warning=detected.stand.warning, outcomes=outcomes, tags=tags)

    def draw_all(
        self, samples: Iterable[Frame], progress: Callable[[int], None] = lambda done: None
    ) -> list[DrawnSample]:
        """Draw frames from the origin of the first."""
        drawn: list[DrawnSample] = []
        origin: np.ndarray | None = None
        for sample in samples:
            origin = self.origin(sample) if origin is None else origin
            drawn.append(self.draw(sample, origin))
            progress(len(drawn))
        return drawn


def sort_kinds(boxes: np.ndarray, labels: np.ndarray) -> BoxesByKind:
    """Sort boxes by kind."""
    return {LABELS[label]: boxes[labels == label] for label in np.unique(labels).tolist()}


def thinned(cloud: DrawnCloud, max_points: int) -> DrawnCloud:
    """Thin a cloud evenly to at most `max_points` points."""
    if len(cloud.points) <= max_points:
        return cloud
    rows = np.linspace(0, len(cloud.points), max_points, endpoint=False).astype(np.int64)
    time, intensity = (
        None if column is None else column[rows] for column in (cloud.time, cloud.intensity)
    )
    return replace(cloud, points=cloud.points[rows], time=time, intensity=intensity)


def list_colourings(samples: Sequence[DrawnSample]) -> tuple[Colouring, ...]:
    """Colourings that the points of some frames allow."""
    clouds = [cloud for sample in samples for cloud in sample.clouds]
    timed = any(cloud.time is not None for cloud in clouds)
    bright = any(cloud.intensity is not None for cloud in clouds)
    return tuple(
        colouring
        for colouring in COLOURINGS
        if {"intensity": bright, "age": timed}.get(colouring, True)
    )


UNKNOWN_SHADE = (150, 150, 150)  # of points without the coloured attribute
_SPREAD = (2.0, 98.0)  # percentiles that the scales span
_STEPS = 256

_Span = tuple[float, float]


@dataclass(frozen=True)
class Scales:
    """Ranges of the colours. height is in m, intensity as the set gives it, age in s."""

    height: _Span = (0.0, 1.0)
    intensity: _Span = (0.0, 1.0)
    age: _Span = (0.0, 1.0)

    @staticmethod
    def of(sample: DrawnSample) -> "Scales":
        """Choose ranges that cover nearly all points of a frame."""
        spans = {}
        newest = find_newest(sample)
        for colouring in COLOURINGS[1:]:
            columns = [_values(cloud, colouring, newest) for cloud in sample.clouds]
            values = np.concatenate(
                [np.zeros(0), *(column for column in columns if column is not None)]
            )
            values = values[np.isfinite(values)]
            if len(values):
                spans[colouring] = tuple(np.percentile(values, _SPREAD).tolist())
        return Scales(**spans)

    def describe(self, colouring: Colouring) -> str:
        """Describe the range of a colouring."""
        if colouring == "sensor":
            return "sensor"
        low, high = getattr(self, colouring)
        unit = {"height": " m", "age": " s"}.get(colouring, "")
        return f"{colouring}, {low:.3g} to {high:.3g}{unit}"


def find_newest(sample: DrawnSample) -> float:
    """Time of a frame's newest point, in seconds from the frame's time; 0 if no time is known."""
    times = [
        float(cloud.time.max())
        for cloud in sample.clouds
        if cloud.time is not None and len(cloud.time)
    ]
    return max(times, default=0.0)


def _values(cloud: DrawnCloud, colouring: Colouring, newest: float) -> np.ndarray | None:
    if colouring == "age":
        return None if cloud.time is None else newest - cloud.time
    return cloud.points[:, 2] if colouring == "height" else cloud.intensity


def shades(
    cloud: DrawnCloud, colouring: Colouring, scales: Scales, *, index: int, newest: float
) -> UInt8[np.ndarray, "n 3"]:
    """Red, green and blue of the points of sensor `index`. Dark is low, or new. newest: as
    `find_newest`."""
    from matplotlib import colormaps

    values = None if colouring == "sensor" else _values(cloud, colouring, newest)
    if values is None:
        colour = (
            tuple(bytes.fromhex(sensor_colour(index)[1:]))
            if colouring == "sensor"
            else UNKNOWN_SHADE
        )
        return np.tile(np.array(colour, np.uint8), (len(cloud.points), 1))
    low, high = getattr(scales, colouring)
    share = np.clip((values.astype(np.float64) - low) / max(high - low, 1e-9), 0.0, 1.0)
    # without its end that is lost on white
    viridis = np.asarray(colormaps["viridis"](np.linspace(0.0, 0.92, _STEPS)))
    return np.round(255 * viridis[:, :3]).astype(np.uint8)[(share * (_STEPS - 1)).astype(np.int64)]
