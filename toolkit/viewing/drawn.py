"""Frames as drawn: clouds, boxes and outcomes, counted from one origin."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.display import describe_count
from toolkit.objects import LABELS
from toolkit.plots.line_style import Outcome
from toolkit.viewing.outcomes import MARKED, Marked

BoxesByKind = dict[str, Float64[np.ndarray, "_ 7"]]
OTHERS = "others"  # labels of classes other than ours
BOX_KINDS = (*LABELS, OTHERS)


@dataclass(frozen=True, eq=False)
class DrawnCloud:
    """Points and place of one sensor, from the origin. intensity: as the set gives it; time: of
    each point, seconds from the frame's. Each is None if the set lacks it."""

    name: str
    points: Float32[np.ndarray, "n 3"]
    place: Float64[np.ndarray, "3"]
    time: Float64[np.ndarray, " n"] | None = None
    intensity: Float32[np.ndarray, " n"] | None = None


class Tag(NamedTuple):
    """Class and score of a box, with its outcome, and their place: the middle of the roof."""

    kind: str
    outcome: Outcome
    text: str
    place: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class DrawnSample:
    """One instant to be drawn.

    Attributes:
        name: name of the frame.
        time: its time (s).
        clouds: points of the sensors.
        truth: labelled boxes by kind of `BOX_KINDS`, without absent kinds.
        detections: detected boxes by kind.
        warning: warning of ground that is not level.
        outcomes: boxes by outcome, empty if unknown.
        tags: tags of detected and missed boxes.
    """

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


def sort_kinds(boxes: np.ndarray, labels: np.ndarray) -> BoxesByKind:
    """Sort boxes by kind."""
    return {LABELS[label]: boxes[labels == label] for label in np.unique(labels).tolist()}


def limit_points(cloud: DrawnCloud, max_points: int) -> DrawnCloud:
    """Thin a cloud evenly to at most `max_points` points."""
    if len(cloud.points) <= max_points:
        return cloud
    rows = np.linspace(0, len(cloud.points), max_points, endpoint=False).astype(np.int64)
    time, intensity = (
        None if column is None else column[rows] for column in (cloud.time, cloud.intensity)
    )
    return replace(cloud, points=cloud.points[rows], time=time, intensity=intensity)


def find_newest(sample: DrawnSample) -> float:
    """Time of a frame's newest point, in seconds from the frame's time; 0 if no time is known."""
    times = [
        float(cloud.time.max())
        for cloud in sample.clouds
        if cloud.time is not None and len(cloud.time)
    ]
    return max(times, default=0.0)
