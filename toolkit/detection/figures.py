"""Figures of an evaluation by scheme, sensor set, class and IoU threshold."""

from dataclasses import dataclass, field

from toolkit.detection.metrics import Curve, Reliability
from toolkit.objects import LABELS, VEHICLE
from toolkit.runtime.text_values import replace_infinite


@dataclass(frozen=True)
class Row:
    """Figures of one scheme, sensor set, class and IoU threshold.

    Attributes:
        scheme: name of the scheme.
        sensors: indices of the sensors.
        iou: threshold from which a detection is true.
        ap: average precision.
        recall: recall over all detections.
        precision: precision over all detections.
        kbit_per_sensor: mean kbit that a sensor sends of a frame.
        ms_per_frame: median milliseconds from measurements to fused boxes.
        curve: precision and recall down to each score.
        label: class.
        truths: objects to find in all frames.
        false_alarms_per_frame: mean number of false alarms in a frame.
    """

    scheme: str
    sensors: tuple[int, ...]
    iou: float
    ap: float
    recall: float
    precision: float
    kbit_per_sensor: float
    ms_per_frame: float
    curve: Curve = field(repr=False, compare=False)
    label: str = LABELS[VEHICLE]
    truths: int = 0
    false_alarms_per_frame: float = 0.0

    def as_dict(self) -> dict[str, object]:
        """Return the row without its curve for JSON, undefined as None."""
        return replace_infinite(
            {name: value for name, value in vars(self).items() if name != "curve"}
        )


@dataclass(frozen=True)
class ClassFigures:
    """Figures of a class at the detector's score threshold, for one scheme and sensor set.

    The second label of an object (`second_labels`) is a false alarm here.

    Attributes:
        scheme: name of the scheme.
        sensors: indices of the sensors.
        label: class.
        iou: threshold from which a detection is true (`TRUE_IOU`).
        frames: number of frames.
        truths: objects to find in all frames.
        detections: detections that count in all frames.
        recall: share of the truths that were detected.
        precision: share of the detections that are true.
        false_alarms_per_frame: mean number of false alarms in a frame.
        reliability: share of true detections by score.
    """

    scheme: str
    sensors: tuple[int, ...]
    label: str
    iou: float
    frames: int
    truths: int
    detections: int
    recall: float
    precision: float
    false_alarms_per_frame: float
    reliability: Reliability = field(repr=False, compare=False)

    def as_dict(self) -> dict[str, object]:
        """Return the figures for JSON, undefined as None."""
        bins = {name: column.tolist() for name, column in vars(self.reliability).items()}
        return replace_infinite(
            {**vars(self), "calibration_error": self.reliability.error, "reliability": bins}
        )
