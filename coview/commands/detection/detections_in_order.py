"""Detections of a recording in the order of time, to follow road users through it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from coview.commands.detection.placed_detectors import Detectors, detect_in_turn
from coview.progress_bar import progress_bar

if TYPE_CHECKING:
    from toolkit.frame import Recording
    from toolkit.objects import Detections, Objects
    from toolkit.tracking.tracks import Tracks

_FIRST_FRAMES = 3


@dataclass
class DetectionsInOrder:
    """Detections in the frames of a recording.

    Attributes:
        names: name of each frame.
        times: time of each frame (s).
        detections: detections in each frame, world frame.
        truths: true objects in each frame, empty without truth.
        area: xmin, ymin, xmax, ymax (m) of the detections, None if unknown.
        place_error: expected error of places (m) that all frames share, see `Tracker`."""

    names: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    detections: "list[Detections]" = field(default_factory=list)
    truths: "list[Objects]" = field(default_factory=list)
    area: list[float] | None = None
    place_error: float = 0.0

    def add(self, name: str, time: float, detections: "Detections", truth: "Objects") -> None:
        """Add a frame.

        Args:
            name: Name of the frame.
            time: Its time (s).
            detections: Detections, world frame.
            truth: True objects, empty without truth."""
        self.names.append(name)
        self.times.append(time)
        self.detections.append(detections)
        self.truths.append(truth)

    def track(self, *, offline: bool) -> "list[Tracks]":
        """Return the tracks in each frame.

        offline: True to know each moment from all frames, False from those before it only."""
        from toolkit.tracking.smoothing import smooth_tracks
        from toolkit.tracking.tracker import track_live

        follow = smooth_tracks if offline else track_live
        return follow(self.detections, self.times, self.area, place_error=self.place_error)


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
    from toolkit.sites.site import Site

    reads = Reads(errors)
    in_order = DetectionsInOrder(place_error=reads.profile().place_error)
    samples = Part(ReadRecording(recording, reads), frames)
    # the first frames show most mistakes in times before the long work
    first_frames = range(min(_FIRST_FRAMES, len(samples)))
    check_times([find_frame_time(k, recording[k].time, rate_hz) for k in first_frames])
    learns_scene = recording.site is None and detectors.spec.learns_scene
    scene = learn_standing_scene(samples) if learns_scene else None
    placed = detectors.choose([samples], [scene])
    with progress_bar("frame", len(samples), hidden=hidden) as bar:
        for result in detect_in_turn([(samples, placed[0], scene)], bar.to):
            frame = result.frame
            time = find_frame_time(len(in_order.names), frame.time, rate_hz)
            in_order.add(frame.name, time, result.detections, frame.objects)
            if isinstance(result.stand.area, Site):
                in_order.area = result.stand.area.area.tolist()
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
    from toolkit.tracking.frame_times import find_time_problem

    if (problem := find_time_problem(times)) is not None:
        raise ValueError(problem)
