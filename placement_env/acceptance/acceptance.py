"""Acceptance of a street: comparison of a recording with the plan."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from placement_env.acceptance.class_checks import ClassCheck, compare_classes, find_blocks
from placement_env.acceptance.consistency import Consistency, check_consistency
from placement_env.acceptance.sensor_checks import SensorCheck, check_sensors
from placement_env.acceptance.street_detections import FrameBoxes, PlannedDetection, detect_street
from placement_env.report.planning.plan_folder import StatedClass
from toolkit.calibration.reference_surface import Surface
from toolkit.display import describe_count
from toolkit.doctor.findings import Finding
from toolkit.frame import Frames
from toolkit.sites.site import Site
from toolkit.tracking.frame_times import find_time_problem
from toolkit.tracking.tracker import track_live
from toolkit.tracking.tracks import Tracks


@dataclass(frozen=True)
class Promise:
    """Promise of a plan.

    Attributes:
        site: planned site with its sensors.
        classes: results for each class.
        recall: share of the road users that are found, combined over the classes that count."""

    site: Site
    classes: tuple[StatedClass, ...]
    recall: float


@dataclass(frozen=True)
class Acceptance:
    """Comparison of a street with its plan.

    Attributes:
        site: name of the site.
        frames: number of frames that were used.
        seconds: time from the first to the last frame (s), NaN if unknown.
        sensors: check of each planned sensor.
        extra_sensors: names of sensors that are not in the plan.
        classes: check of each class, empty without labels.
        consistency: figures of a recording without labels, None with labels.
        promised_recall: share of the road users that the plan promises to find.
        findings: what the doctor suspects in the recording."""

    site: str
    frames: int
    seconds: float
    sensors: tuple[SensorCheck, ...]
    extra_sensors: tuple[str, ...]
    classes: tuple[ClassCheck, ...]
    consistency: Consistency | None
    promised_recall: float
    findings: tuple[Finding, ...] = ()

    @property
    def sensor_faults(self) -> tuple[str, ...]:
        """Faults of sensors, each in a sentence."""
        return tuple(
            f"Sensor {sensor.name} {fault}." for sensor in self.sensors for fault in sensor.faults()
        )

    @property
    def detection_faults(self) -> tuple[str, ...]:
        """Shortfalls of detection, each in a sentence.

        A class falls short of the plan's AP. Without labels, a half of the sensors finds a smaller
        share of what the other half finds than the recall that the plan promises."""
        sentences = []
        for check in self.classes:
            if check.falls_short and check.measured is not None:
                sentences.append(
                    f"AP of {check.label} is {check.measured.ap:.3f} (at most "
                    f"{check.measured.high:.3f}), the plan promises {check.promised.ap:.3f} (at "
                    f"least {check.promised.low:.3f})."
                )
        consistency = self.consistency
        if consistency is not None and consistency.recall_high < self.promised_recall:
            sentences.append(
                f"Both halves of the sensors find at most {consistency.recall_high:.1%} of the "
                f"road users, the plan promises {self.promised_recall:.1%}."
            )
        return tuple(sentences)

    @property
    def faults(self) -> tuple[str, ...]:
        """All reasons why the street does not keep the promise."""
        return (*self.sensor_faults, *self.detection_faults)

    @property
    def verdict(self) -> str:
        """The answer in one sentence."""
        if self.faults:
            return (
                f"The street does not keep the plan's promise: "
                f"{describe_count(len(self.faults), 'fault')}."
            )
        compared = [check for check in self.classes if check.is_promised and check.is_compared]
        if not compared and self.consistency is None:
            return "No fault of a sensor was found; the recording is too short to compare AP."
        return "The street keeps the plan's promise."

    def as_dict(self) -> dict[str, object]:
        """Return all figures as plain values for JSON; numbers may still be NaN or infinite."""
        return {
            "site": self.site,
            "kept": not self.faults,
            "verdict": self.verdict,
            "faults": list(self.faults),
            "frames": self.frames,
            "seconds": self.seconds,
            "sensors": [sensor.as_dict() for sensor in self.sensors],
            "extra_sensors": list(self.extra_sensors),
            "classes": [check.as_dict() for check in self.classes],
            "consistency": None if self.consistency is None else self.consistency.as_dict(),
            "promised_recall": self.promised_recall,
            "findings": [asdict(finding) for finding in self.findings],
        }


def accept_street(
    recording: Frames,
    promise: Promise,
    planned: PlannedDetection,
    surface: Surface,
    frames: int,
    *,
    findings: Sequence[Finding] = (),
    progress: Callable[[int], None] | None = None,
) -> Acceptance:
    """Compare a street with its plan, by the first frames of a recording.

    With labels, each class is scored; without, two halves of the sensors are compared, unless there
    is only one sensor.

    Args:
        recording: Frames of the street, whose sensors have the plan's names, with their noise.
        promise: What the plan promises.
        planned: Place, detector, scheme and codec of the plan.
        surface: Standing surfaces by which poses are found.
        frames: Number of frames to use.
        findings: What the doctor suspects in the recording.
        progress: Called with the number of frames in which detection is done.

    Raises ValueError for too few frames, and for a recording without any planned sensor."""
    names = {sensor.name for sensor in promise.site.sensors}
    recorded = [sensor.name for sensor in recording[0].sensors]
    if not names.intersection(recorded):
        raise ValueError(
            f"the recording has none of the plan's sensors {', '.join(sorted(names))}, but "
            f"{', '.join(recorded) or 'none'}: rename them as in the plan"
        )
    sensors = check_sensors(recording, promise.site, surface, frames)
    has_labels = any(len(recording[number].objects) for number in range(frames))
    boxes = detect_street(recording, planned, frames, halved=not has_labels, progress=progress)
    times = [frame.time for frame in boxes]
    tracks = track_boxes(boxes, promise.site)
    classes: tuple[ClassCheck, ...] = ()
    consistency = None
    if has_labels:
        classes = compare_classes(boxes, promise.classes, promise.site, tracks)
    elif len(recorded) > 1:
        consistency = check_consistency(boxes, find_blocks(times), promise.site, tracks)
    return Acceptance(
        site=promise.site.name,
        frames=frames,
        seconds=times[-1] - times[0],
        sensors=sensors,
        extra_sensors=tuple(name for name in recorded if name not in names),
        classes=classes,
        consistency=consistency,
        promised_recall=promise.recall,
        findings=tuple(findings),
    )


def track_boxes(frames: Sequence[FrameBoxes], site: Site) -> list[Tracks] | None:
    """Return the live tracks after each frame; None if frames are too far apart or unordered.

    site: planned site, at whose border tracks end."""
    times = [frame.time for frame in frames]
    if len(times) < 2 or find_time_problem(times) is not None:
        return None
    return track_live([frame.detections for frame in frames], times, site.area.tolist())
