"""Detections of a street's recording, fused as its plan fuses them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from toolkit.calibration.place import Place
from toolkit.calibration.recording_scenes import Scenes
from toolkit.detection.codec import Codec
from toolkit.detection.frame_scores import sends_images
from toolkit.detection.scheme import Scheme
from toolkit.detection.view import LinkMemory, View, stand_view
from toolkit.frame import Frame, Frames
from toolkit.objects import Detections, Detector, Objects
from toolkit.sites.site import Site

MIN_HALVED_SENSORS = 2  # with fewer, a set has no halves


@dataclass(frozen=True)
class PlannedDetection:
    """Place, detector, scheme and codec of a plan.

    Attributes:
        site: planned site, whose area is cropped.
        detector: detector of the fused points, or of each sensor's.
        scheme: fusion scheme.
        codec: codec of what the sensors send."""

    site: Site
    detector: Detector
    scheme: Scheme
    codec: Codec


@dataclass(frozen=True, eq=False)
class FrameBoxes:
    """Detections and labels of one frame, world frame.

    Attributes:
        time: time of the frame (s).
        detections: detections of all sensors together.
        halves: detections of every other sensor, and of the rest; empty if they were not asked
            for.
        objects: labels, empty without any."""

    time: float
    detections: Detections
    halves: tuple[Detections, ...]
    objects: Objects


def detect_street(
    recording: Frames,
    planned: PlannedDetection,
    frames: int,
    *,
    halved: bool,
    progress: Callable[[int], None] | None = None,
) -> list[FrameBoxes]:
    """Detect in the first frames of a recording.

    Args:
        recording: Frames of the street, with the sensors' noise.
        planned: Place, detector, scheme and codec of the plan.
        frames: Number of frames to use.
        halved: True to detect in both halves of the sensors too.
        progress: Called with the number of frames done."""
    needs_images = recording[0].has_images or sends_images(planned.scheme, planned.codec)
    scenes = Scenes(recording) if needs_images else None
    memory: LinkMemory = {}
    results = []
    samples = (recording[number] for number in range(frames))
    for frame, stand in Place().stands(samples, planned.site):
        view = stand_view(
            frame, planned.detector, stand, codec=planned.codec, scenes=scenes, memory=memory
        )
        results.append(_detect_frame(frame, view, planned.scheme, halved=halved))
        if progress is not None:
            progress(len(results))
    return results


def _detect_frame(frame: Frame, view: View, scheme: Scheme, *, halved: bool) -> FrameBoxes:
    """Detect by all sensors of a frame, and by its halves if they are asked for.

    view: the frame's measurements and the detector; halved: True to detect by every other sensor
    and by the rest too, which needs `MIN_HALVED_SENSORS`."""
    sensors = range(len(frame.sensors))
    groups: list[Sequence[int]] = []
    if halved and len(sensors) >= MIN_HALVED_SENSORS:
        groups = [sensors[::2], sensors[1::2]]
    return FrameBoxes(
        time=frame.time,
        detections=scheme.fuse(view, sensors).detections,
        halves=tuple(scheme.fuse(view, group).detections for group in groups),
        objects=frame.objects,
    )
