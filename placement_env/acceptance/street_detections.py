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
class Fusion:
    """Fusion of a plan: its place, detector, scheme and codec."""

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
    fusion: Fusion,
    frames: int,
    *,
    halved: bool,
    progress: Callable[[int], None] | None = None,
) -> list[FrameBoxes]:
    """Detect in the first frames of a recording.

    Args:
        recording: Frames of the street, with the sensors' noise.
        fusion: Scheme and detector of the plan.
        frames: Number of frames to use.
        halved: True to detect in both halves of the sensors too.
        progress: Called with the number of frames done."""
    needs_images = recording[0].has_images or sends_images(fusion.scheme, fusion.codec)
    scenes = Scenes(recording) if needs_images else None
    memory: LinkMemory = {}
    results = []
    samples = (recording[number] for number in range(frames))
    for frame, stand in Place().stands(samples, fusion.site):
        view = stand_view(
            frame, fusion.detector, stand, codec=fusion.codec, scenes=scenes, memory=memory
        )
        results.append(_detect_frame(frame, view, fusion.scheme, halved=halved))
        if progress is not None:
            progress(len(results))
    return results


def _detect_frame(frame: Frame, view: View, scheme: Scheme, *, halved: bool) -> FrameBoxes:
    """Detect by all sensors of a frame, and by its halves if they are asked for."""
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
