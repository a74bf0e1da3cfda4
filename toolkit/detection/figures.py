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
        iou: IoU from which a detection is true.
        ap: average precision.
        recall: recall over all detections.
        precision: precision over all detections.
        kbit_per_sensor: mean kbit (1000 bits) that a sensor sends in a frame.
        ms_per_frame: median milliseconds from measurements to fused boxes.
        curve: precision and recall down to each score.
        label: name of the class.
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
        """Return the row without its curve for JSON; NaN and infinity become None."""
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
        label: name of the class.
        iou: IoU from which a detection is true (`TRUE_IOU`).
        frames: number of frames.
        truths: objects to find in all frames.
        detections: detections that count in all frames.
        recall: share (0 to 1) of the truths that were detected.
        precision: share (0 to 1) of the detections that are true, NaN without detections.
        false_alarms_per_frame: mean number of false alarms in a frame.
        reliability: mean score and share of true detections in bins of scores.
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
        """Return the figures for JSON, with the bins of reliability as lists.

        NaN and infinity become None."""
        bins = {name: column.tolist() for name, column in vars(self.reliability).items()}
        return replace_infinite(
            {**vars(self), "calibration_error": self.reliability.error, "reliability": bins}
        )
