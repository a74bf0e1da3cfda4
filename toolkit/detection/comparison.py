"""Schemes and sensor sets to compare, and the rules of their scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from toolkit.boxes import Overlap
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.metrics import USUAL_IOUS
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme
from toolkit.detection.view import NMS_IOU
from toolkit.frame import Frame, select_sensors
from toolkit.objects import LABELS, label_index

ALL_CLOUDS = "all clouds"  # name of detection in all clouds together
# rule for the objects that count, see `toolkit.detection.evaluation`
Scoring = Literal["exact", "published", "measured"]


@dataclass(frozen=True)
class Comparison:
    """Schemes and sensor sets to compare, and the rules.

    Attributes:
        schemes: objects or names, None for all clouds together, uncropped.
        sensor_sets: indices or names of sensors, None for all.
        classes: names or numbers of `toolkit.objects.LABELS`.
        iou_thresholds: thresholds of all classes, None for the usual ones of each class
            (`toolkit.detection.metrics.USUAL_IOUS`).
        protocol: rule for the objects that count, None for exact at a known site, else measured.
        metric: IoU of boxes or of footprints, see `toolkit.detection.metrics.evaluate`.
        codec: coding of the messages.
        nms_iou: BEV IoU above which the less sure of two boxes of one label is dropped.
        radius: hybrid radius (m), None for the site's.
        rate: frames per second (Hz) for the load on a link, None for no loads.
        breakdown: whether AP is broken down by range, points and other sets' protocols, None for
            only at unknown sites.
        timings: True to summarise the times of stages.
    """

    schemes: Sequence[Scheme | str | None] = PAPER_SCHEMES
    sensor_sets: Sequence[Sequence[int | str] | None] = (None,)
    classes: Sequence[str | int] = ("vehicle",)
    iou_thresholds: Sequence[float] | None = None
    protocol: Scoring | None = None
    metric: Overlap = "3d"
    codec: Codec = PAPER
    nms_iou: float = NMS_IOU
    radius: float | None = None
    rate: float | None = None
    breakdown: bool | None = None
    timings: bool = False


def list_ious(comparison: Comparison) -> dict[str, tuple[float, ...]]:
    """IoU thresholds of each class, by its name.

    Raises ValueError if there is no scheme, sensor set, class or threshold to evaluate."""
    class_numbers = dict.fromkeys(map(label_index, comparison.classes))  # without repetition
    labels = [LABELS[number] for number in class_numbers]
    ious = {label: class_thresholds(comparison.iou_thresholds, label) for label in labels}
    is_empty = not len(comparison.schemes) or not len(comparison.sensor_sets)
    if is_empty or not ious or not all(ious.values()):
        raise ValueError(
            "there must be a scheme, a sensor set, a class and an IoU threshold to evaluate"
        )
    return ious


def name_schemes(schemes: Sequence[Scheme | str | None]) -> dict[str, Scheme | None]:
    """Return fusion schemes by name, None for detection in all clouds together.

    schemes: objects or names, None for all clouds together. Raises ValueError for an unknown
    scheme, and if two different schemes have one name."""
    by_name: dict[str, Scheme | None] = {}
    for scheme_or_name in schemes:
        scheme = None if scheme_or_name is None else find_scheme(scheme_or_name)
        name = ALL_CLOUDS if scheme is None else scheme.name
        # setdefault returns the scheme that has the name already, if there is one
        if by_name.setdefault(name, scheme) != scheme:
            raise ValueError(
                f"two schemes are called {name!r}, {by_name[name]} and {scheme}: rename one"
            )
    return by_name


def name_sets(
    frame: Frame, sensor_sets: Sequence[Sequence[int | str] | None]
) -> dict[tuple[int, ...], tuple[str, ...]]:
    """Names of the sensors in each set, by the set's indices in a frame.

    sensor_sets: indices or names of each set, None for all sensors of the frame."""
    names_by_set = {}
    for sensors in sensor_sets:
        indices = tuple(select_sensors(frame.sensors, sensors))
        names_by_set[indices] = tuple(frame.sensors[index].name for index in indices)
    return names_by_set


def class_thresholds(iou_thresholds: Sequence[float] | None, label: str) -> tuple[float, ...]:
    """IoU thresholds of a class, each once, in the order given.

    iou_thresholds: None for the usual ones of the class; label: name of the class."""
    thresholds = USUAL_IOUS[label_index(label)] if iou_thresholds is None else iou_thresholds
    return tuple(dict.fromkeys(map(float, thresholds)))
