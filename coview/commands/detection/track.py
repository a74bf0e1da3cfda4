"""`coview track`: follow road users through a recording."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.commands.detection.placed_detectors import Detectors, detect_in_turn
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.exchange import Exchange
from coview.outputs import OK, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.arrays import Float64
    from toolkit.detection.detect import FrameDetections
    from toolkit.objects import Detections
    from toolkit.tracking.tracks import Tracks

MAX_INTERVAL_S = 1.0  # median time between frames; farther apart, road users are not recognised
_FIRST_FRAMES = 3
ENDINGS = (".json", ".csv")


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """Frames, and what is known at each of them."""

    offline: bool = False
    """Use all frames for each moment: surer, once a recording is complete. Otherwise only what was
    seen before."""
    errors: str = "paper"
    """Error profile of simulated sensors, as in coview evaluate."""
    frames: int | None = None
    """Number of first frames to use; all when left out."""


@dataclass
class _Tracked:
    """Frames of a recording, in order.

    Attributes:
        names: name of each frame.
        times: time of each frame (s).
        detections: detections in each frame, world frame."""

    names: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    detections: "list[Detections]" = field(default_factory=list)

    def add(self, result: "FrameDetections") -> None:
        """Add a frame."""
        self.names.append(result.frame.name)
        self.times.append(result.frame.time)
        self.detections.append(result.detections)


def track_command(
    recording: Positional[Path],
    /,
    *,
    out: Path,
    detector: str = "general",
    tracking: Tracking = Tracking(),
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Exchange = Exchange(),
) -> int:
    """Follow road users through a recording: a number, velocity and one size for each of them.

    Example: coview track street.hdf5 --detector tjunction+background --offline --out tracks.json

    Example: coview track junction.bag --layout rosbag --to mcap kitti-tracking --out tracks

    Args:
        recording: Folder, bag or recording in any layout, with the time of each frame.
        out: File of tracks (.json or .csv), or what --to writes.
        detector: Detector, as in coview detect."""
    from toolkit.datasets.recording_views import Part, ReadRecording, Reads
    from toolkit.detection.standing import learn_standing_scene
    from toolkit.sites.site import Site

    check_least("--frames", tracking.frames, 1, "leave it out for all")
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    inputs = [recording, *opening.files]
    files = writing.check(out, inputs) if writing.to else {}
    if not files:
        check_ending(out, ENDINGS, "a file of tracks")
        check_file(out, inputs=inputs, overwrite=writing.overwrite)
    detectors = Detectors(spec, place)
    tracked = _Tracked()
    area = None
    with opening.open(recording) as opened:
        origin = writing.place(opened.site)
        samples = Part(ReadRecording(opened, Reads(tracking.errors)), tracking.frames)
        # the first frames show most mistakes in times before the long work
        first_frames = range(min(_FIRST_FRAMES, len(samples)))
        _check_times([opened[k].time for k in first_frames])
        learns_scene = opened.site is None and spec.learns_scene
        scene = learn_standing_scene(samples) if learns_scene else None
        placed = detectors.choose([samples], [scene])
        with progress_bar("frame", len(samples), hidden=writing.json) as bar:
            for result in detect_in_turn([(samples, placed[0], scene)], bar.to):
                tracked.add(result)
                if isinstance(result.stand.area, Site):
                    area = result.stand.area.area.tolist()
    _check_times(tracked.times)
    tracks = _follow(tracked, area, offline=tracking.offline)
    if files:
        from toolkit.exchange.instant import Instant
        from toolkit.exchange.standards import open_writers

        with open_writers(files, origin=origin) as write:
            for time, now in zip(tracked.times, tracks, strict=True):
                write(Instant.from_tracks(time, now))
    else:
        from toolkit.tracking.track_files import write_tracks

        write_tracks(out, tracked.names, tracked.times, tracks)
    figures = _summarise(tracks)
    text = (
        f"{out}: {figures['tracks']} road users in {figures['frames']} frames, "
        f"{figures['seconds']:.1f} s in the median"
    )
    print_result(figures | {"out": str(out)}, text, as_json=writing.json)
    return OK


def _check_times(times: Sequence[float]) -> None:
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


def _follow(tracked: _Tracked, area: Sequence[float] | None, *, offline: bool) -> "list[Tracks]":
    """Return the tracks in each frame. area: border of the detections, None if unknown."""
    from toolkit.tracking.smoothing import smooth_tracks
    from toolkit.tracking.tracker import Tracker

    if offline:
        return smooth_tracks(tracked.detections, tracked.times, area)
    tracker = Tracker(area)
    moments: Iterator[tuple[Detections, float]] = zip(
        tracked.detections, tracked.times, strict=True
    )
    return [tracker.update(detections, time) for detections, time in moments]


def _summarise(tracks: "Sequence[Tracks]") -> dict[str, float]:
    """Count frames and road users, with the median of the seconds that they are followed."""
    ages: dict[int, float] = {}
    for frame_tracks in tracks:
        ages |= dict(zip(frame_tracks.ids.tolist(), frame_tracks.ages.tolist(), strict=True))
    seconds: Float64[np.ndarray, " n"] = np.array(list(ages.values()), np.float64)
    return {
        "frames": len(tracks),
        "tracks": len(ages),
        "seconds": float(np.median(seconds)) if len(seconds) else 0.0,
    }
