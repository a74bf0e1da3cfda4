"""Frames as drawn: clouds, boxes and outcomes, counted from one origin."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.display import describe_count
from toolkit.objects import LABELS
from toolkit.plots.line_style import Outcome
from toolkit.viewing.outcomes import Marked
from toolkit.viewing.scene_parts import thin_evenly

BoxesByKind = dict[str, Float64[np.ndarray, "_ 7"]]
OTHERS = "others"  # labels of classes other than ours
BOX_KINDS = (*LABELS, OTHERS)


@dataclass(frozen=True, eq=False)
class DrawnCloud:
    """Points and position of one sensor, counted from the origin of the drawing.

    Attributes:
        name: name of the sensor.
        points: x, y, z (m) of each point.
        place: x, y, z (m) of the sensor.
        time: time of each point (s, from the time of the frame), None if the set lacks it.
        intensity: intensity of each point in the data set's unit, None if the set lacks it.
    """

    name: str
    points: Float32[np.ndarray, "n 3"]
    place: Float64[np.ndarray, "3"]
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None


class Tag(NamedTuple):
    """Text at a box: its class and score.

    kind: name of the class; outcome: gives the style; place: x, y, z (m) of the middle of the
    roof."""

    kind: str
    outcome: Outcome
    text: str
    place: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class DrawnSample:
    """One instant to be drawn.

    Attributes:
        name: name of the frame.
        time: time of the frame (s), NaN if unknown.
        clouds: points of the sensors.
        truth: labelled boxes by kind of `BOX_KINDS`, without absent kinds.
        detections: detected boxes by kind, without absent kinds.
        warning: warning of ground that is not level, None without one.
        outcomes: boxes by outcome and kind, empty if unknown.
        tags: tags of detected and missed boxes.
        trails: lines of where tracks were, start and end (m), by kind.
    """

    name: str
    time: float
    clouds: tuple[DrawnCloud, ...]
    truth: BoxesByKind
    detections: BoxesByKind
    warning: str | None = None
    outcomes: dict[Marked, BoxesByKind] = field(default_factory=dict)
    tags: tuple[Tag, ...] = ()
    trails: dict[str, Float64[np.ndarray, "_ 2 3"]] = field(default_factory=dict)

    def describe(self) -> str:
        """Describe the frame in one line: numbers of points, labels, detections and outcomes."""
        point_count = sum(len(cloud.points) for cloud in self.clouds)
        label_count = _count_boxes(self.truth)
        detection_count = _count_boxes(self.detections)
        label_note = ""
        detection_note = ""
        if self.outcomes:
            hit_count = _count_boxes(self.outcomes["hits"])
            missed_count = _count_boxes(self.outcomes["missed"])
            alarm_words = describe_count(_count_boxes(self.outcomes["false alarms"]), "false alarm")
            ignored_count = _count_boxes(self.outcomes["ignored"])
            # labels of classes that are not ours, and uncounted labels, are neither hit nor missed
            uncounted_count = label_count - hit_count - missed_count
            label_note = f" ({hit_count} hit, {missed_count} missed, {uncounted_count} not counted)"
            hit_words = describe_count(hit_count, "hit")
            detection_note = f" ({hit_words}, {alarm_words}, {ignored_count} ignored)"
        return (
            f"{self.name}: {point_count} points, {label_count} labelled{label_note}, "
            f"{detection_count} detected{detection_note}"
        )


def _count_boxes(boxes_by_kind: BoxesByKind) -> int:
    """Number of boxes of all kinds together."""
    return sum(map(len, boxes_by_kind.values()))


def sort_kinds(boxes: np.ndarray, labels: np.ndarray) -> BoxesByKind:
    """Group boxes by the names of their classes; labels: class number of each box."""
    return {LABELS[label]: boxes[labels == label] for label in np.unique(labels).tolist()}


def limit_points(cloud: DrawnCloud, max_points: int) -> DrawnCloud:
    """Thin a cloud to at most `max_points` points, evenly over its rows."""
    if len(cloud.points) <= max_points:
        return cloud
    rows = thin_evenly(np.arange(len(cloud.points)), max_points)
    return replace(
        cloud,
        points=cloud.points[rows],
        time=None if cloud.time is None else cloud.time[rows],
        intensity=None if cloud.intensity is None else cloud.intensity[rows],
    )


def find_newest(sample: DrawnSample) -> float:
    """Time of a frame's newest point, in seconds from the frame's time; 0 if no time is known."""
    times = [
        float(cloud.time.max())
        for cloud in sample.clouds
        if cloud.time is not None and len(cloud.time)
    ]
    return max(times, default=0.0)
