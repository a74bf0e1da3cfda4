"""Detections of a recording in the order of time, to follow road users through it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from coview.commands.detection.placed_detectors import Detectors, detect_in_turn
from coview.progress_bar import progress_bar

if TYPE_CHECKING:
    from toolkit.detection.detect import FrameDetections
    from toolkit.frame import Recording
    from toolkit.objects import Detections, Objects
    from toolkit.tracking.tracks import Tracks

MAX_INTERVAL_S = 1.0  # median time between frames; farther apart, road users are not recognised
_FIRST_FRAMES = 3


@dataclass
class DetectionsInOrder:
    """Detections in the frames of a recording.

    Attributes:
        names: name of each frame.
        times: time of each frame (s).
        detections: detections in each frame, world frame.
        truths: true objects in each frame, empty without truth.
        area: xmin, ymin, xmax, ymax (m) of the detections, None if unknown."""

    names: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    detections: "list[Detections]" = field(default_factory=list)
    truths: "list[Objects]" = field(default_factory=list)
    area: list[float] | None = None

    def add(self, result: "FrameDetections", rate_hz: float | None = None) -> None:
        """Add a frame. rate_hz: frames in a second, None for the recording's times."""
        from toolkit.sites.site import Site

        time = find_frame_time(len(self.names), result.frame.time, rate_hz)
        self.names.append(result.frame.name)
        self.times.append(time)
        self.detections.append(result.detections)
        self.truths.append(result.frame.objects)
        if isinstance(result.stand.area, Site):
            self.area = result.stand.area.area.tolist()

    def track(self, *, offline: bool) -> "list[Tracks]":
        """Return the tracks in each frame.

        offline: True to know each moment from all frames, False from those before it only."""
        from toolkit.tracking.smoothing import smooth_tracks
        from toolkit.tracking.tracker import Tracker

        if offline:
            return smooth_tracks(self.detections, self.times, self.area)
        tracker = Tracker(self.area)
        moments = zip(self.detections, self.times, strict=True)
        return [tracker.update(detections, time) for detections, time in moments]


def detect_in_order(
    recording: "Recording",
    detectors: Detectors,
    *,
    errors: str,
    frames: int | None,
    hidden: bool,
    rate_hz: float | None = None,
) -> DetectionsInOrder:
    """Detect road users in the frames of a recording.

    Args:
        recording: Open recording.
        detectors: Detector at the place of the recording.
        errors: Error profile of simulated sensors.
        frames: Number of first frames to use, None for all.
        hidden: True to show no progress.
        rate_hz: Frames in a second of a recording without times, None for its times.

    Raises ValueError for frames without times, out of order, or too far apart."""
    from toolkit.datasets.recording_views import Part, ReadRecording, Reads
    from toolkit.detection.standing import learn_standing_scene

    in_order = DetectionsInOrder()
    samples = Part(ReadRecording(recording, Reads(errors)), frames)
    # the first frames show most mistakes in times before the long work
    first_frames = range(min(_FIRST_FRAMES, len(samples)))
    check_times([find_frame_time(k, recording[k].time, rate_hz) for k in first_frames])
    learns_scene = recording.site is None and detectors.spec.learns_scene
    scene = learn_standing_scene(samples) if learns_scene else None
    placed = detectors.choose([samples], [scene])
    with progress_bar("frame", len(samples), hidden=hidden) as bar:
        for result in detect_in_turn([(samples, placed[0], scene)], bar.to):
            in_order.add(result, rate_hz)
    check_times(in_order.times)
    return in_order


def find_frame_time(number: int, time: float, rate_hz: float | None) -> float:
    """Return the time of a frame (s).

    Args:
        number: Number of the frame from 0.
        time: Its time in the recording (s), NaN if unknown.
        rate_hz: Frames in a second, None for the recording's times.

    Raises ValueError for a rate next to times."""
    if rate_hz is None:
        return time
    if np.isfinite(time):
        raise ValueError("--rate is for recordings without times, but this one has them")
    return number / rate_hz


def check_times(times: Sequence[float]) -> None:
    """Raise ValueError for frames without times, out of order, or too far apart."""
    steps = np.diff(times)
    if len(steps) and not (steps > 0).all():
        number = int(np.argmin(steps > 0)) + 1
        raise ValueError(
            "tracks need frames in the order of time, each with its own, got "
            f"{times[number]:g} s after {times[number - 1]:g} s at frame {number}"
        )
    if len(steps) and np.median(steps) > MAX_INTERVAL_S:
        raise ValueError(
            f"tracks need frames at most {MAX_INTERVAL_S:g} s apart, got {np.median(steps):g} s: "
            "record more often, or simulate with --every 0.1"
        )
