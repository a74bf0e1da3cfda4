"""`coview track`: follow road users through a recording."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_least, check_positive
from coview.commands.detection.placed_detectors import Detectors, detect_in_turn
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.exchange import Exchange
from coview.outputs import OK, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from coview.tracks import TEXT, find_sequence, number_frames
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.arrays import Float64
    from toolkit.exchange.geo_origin import GeoOrigin
    from toolkit.frame import Recording
    from toolkit.objects import Detections
    from toolkit.tracking.tracks import Tracks

MAX_INTERVAL_S = 1.0  # median time between frames; farther apart, road users are not recognised
_FIRST_FRAMES = 3
USUAL_DETECTOR = "general"
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
    detections: Path | None = None
    """Detections to follow instead of a detector's: KITTI's tracking text, whose frames are
    numbered as the recording's."""
    rate: float | None = None
    """Frames in a second, for recordings and texts without times."""


@dataclass
class _Tracked:
    """Frames of a recording, in order.

    Attributes:
        names: name of each frame.
        times: time of each frame (s).
        detections: detections in each frame, world frame.
        area: border of the detections (m, world frame), None if unknown."""

    names: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    detections: "list[Detections]" = field(default_factory=list)
    area: Sequence[float] | None = None

    def add(self, name: str, time: float, detections: "Detections") -> None:
        """Add a frame."""
        self.names.append(name)
        self.times.append(time)
        self.detections.append(detections)


def track_command(
    recording: Positional[Path],
    /,
    *,
    out: Path,
    detector: str = USUAL_DETECTOR,
    tracking: Tracking = Tracking(),
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Exchange = Exchange(),
) -> int:
    """Follow road users through a recording: a number, velocity and one size for each of them.

    Example: coview track street.hdf5 --detector tjunction+background --offline --out tracks.json

    Example: coview track junction.bag --layout rosbag --to mcap kitti-tracking --out tracks

    Example: coview track detections.txt --rate 10 --offline --out tracks.json

    Args:
        recording: Folder, bag or recording in any layout, with the time of each frame; or
            detections in KITTI's tracking text (.txt).
        out: File of tracks (.json or .csv), or what --to writes.
        detector: Detector, as in coview detect."""
    check_least("--frames", tracking.frames, 1, "leave it out for all")
    check_positive("--rate", tracking.rate)
    spec = DetectorSpec.from_name(detector)
    path = tracking.detections
    is_text = recording.suffix.lower() == TEXT
    if is_text or path is not None:
        if detector != USUAL_DETECTOR:
            raise ValueError("--detector does not go with detections of a text: leave it out")
    else:
        check_detector(spec)
    texts = [] if path is None else [path]
    inputs = [recording, *opening.files, *texts]
    files = writing.check(out, inputs) if writing.to else {}
    if not files:
        check_ending(out, ENDINGS, "a file of tracks")
        check_file(out, inputs=inputs, overwrite=writing.overwrite)
    if is_text:
        tracked = _read_text(recording, tracking)
        origin = writing.place(None)
    else:
        with opening.open(recording) as opened:
            origin = writing.place(opened.site)
            if path is None:
                tracked = _detect(opened, Detectors(spec, place), tracking, hidden=writing.json)
            else:
                sequence = find_sequence(recording, opening)
                tracked = _read_beside(opened, path, tracking, place, sequence)
    _check_times(tracked.times)
    tracks = _follow(tracked, offline=tracking.offline)
    if files:
        _export(tracked, tracks, files, origin)
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


def _detect(
    opened: "Recording", detectors: Detectors, tracking: Tracking, *, hidden: bool
) -> _Tracked:
    """Detect in the frames of a recording.

    detectors: detector by what is known about the recording; hidden: True to show no progress."""
    from toolkit.datasets.recording_views import Part, ReadRecording, Reads
    from toolkit.detection.standing import learn_standing_scene
    from toolkit.sites.site import Site

    samples = Part(ReadRecording(opened, Reads(tracking.errors)), tracking.frames)
    # the first frames show most mistakes in times before the long work
    first_frames = range(min(_FIRST_FRAMES, len(samples)))
    _check_times([_find_time(k, opened[k].time, tracking.rate) for k in first_frames])
    learns_scene = opened.site is None and detectors.spec.learns_scene
    scene = learn_standing_scene(samples) if learns_scene else None
    placed = detectors.choose([samples], [scene])
    tracked = _Tracked()
    with progress_bar("frame", len(samples), hidden=hidden) as bar:
        results = detect_in_turn([(samples, placed[0], scene)], bar.to)
        for k, result in enumerate(results):
            time = _find_time(k, result.frame.time, tracking.rate)
            tracked.add(result.frame.name, time, result.detections)
            if isinstance(result.stand.area, Site):
                tracked.area = result.stand.area.area.tolist()
    return tracked


def _read_text(path: Path, tracking: Tracking) -> _Tracked:
    """Read detections of a text, whose frames are numbered from 0.

    Raises ValueError without --rate, as the text has no times."""
    from toolkit.exchange.track_text import read_detection_text
    from toolkit.objects import Detections

    if tracking.detections is not None:
        raise ValueError(f"{path} holds detections already: leave --detections out")
    if tracking.rate is None:
        raise ValueError(f"{path} has no times: give --rate, the number of frames in a second")
    detections_by_frame = read_detection_text(path)
    if not detections_by_frame:
        raise ValueError(f"{path} has no detections: give another file")
    count = max(detections_by_frame) + 1
    if tracking.frames is not None:
        count = min(count, tracking.frames)
    tracked = _Tracked()
    for number in range(count):
        detections = detections_by_frame.get(number, Detections.empty())
        tracked.add(f"{number:06d}", number / tracking.rate, detections)
    return tracked


def _read_beside(
    opened: "Recording", path: Path, tracking: Tracking, place: Place, sequence: Path | None
) -> _Tracked:
    """Read detections of a text in the frames of a recording.

    path: the text; sequence: KITTI's sequence whose camera the boxes are in and whose frames are
    named by their numbers, None for a recording in the frame that coview writes. Raises ValueError
    for detections in frames that the recording does not have."""
    from toolkit.datasets.layouts.kitti_sequences import find_camera
    from toolkit.datasets.recording_views import Part
    from toolkit.exchange.track_text import read_detection_text
    from toolkit.geometry import BODY_SE3_CAMERA
    from toolkit.objects import Detections

    camera = BODY_SE3_CAMERA if sequence is None else find_camera(sequence)
    detections_by_frame = read_detection_text(path, camera)
    area: Sequence[float] | None = place.area
    if opened.site is not None and place.at(opened.site):
        area = opened.site.area.tolist()
    tracked = _Tracked(area=area)
    samples = Part(number_frames(opened, sequence), tracking.frames)
    numbers = []
    for k in range(len(samples)):
        frame = samples[k]
        time = _find_time(k, frame.time, tracking.rate)
        numbers.append(frame.index)
        detections = detections_by_frame.get(frame.index, Detections.empty())
        tracked.add(frame.name, time, detections)
    is_part = len(samples) < len(opened)
    strays = [number for number in sorted(detections_by_frame) if number not in numbers]
    if strays and not (is_part and strays[0] > numbers[-1]):
        raise ValueError(
            f"{path} has frame {strays[0]}, which is not among the recording's {len(numbers)} "
            f"frames from {numbers[0]} to {numbers[-1]}: are both of one recording?"
        )
    return tracked


def _find_time(number: int, time: float, rate: float | None) -> float:
    """Return the time of a frame (s).

    number: number from 0; time: time in the recording, NaN if unknown; rate: frames in a
    second, None if not given. Raises ValueError for a rate next to times."""
    if rate is None:
        return time
    if np.isfinite(time):
        raise ValueError("--rate is for recordings without times, but this one has them")
    return number / rate


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


def _follow(tracked: _Tracked, *, offline: bool) -> "list[Tracks]":
    """Return the tracks in each frame."""
    from toolkit.tracking.smoothing import smooth_tracks
    from toolkit.tracking.tracker import Tracker

    if offline:
        return smooth_tracks(tracked.detections, tracked.times, tracked.area)
    tracker = Tracker(tracked.area)
    moments: Iterator[tuple[Detections, float]] = zip(
        tracked.detections, tracked.times, strict=True
    )
    return [tracker.update(detections, time) for detections, time in moments]


def _export(
    tracked: _Tracked,
    tracks: "Sequence[Tracks]",
    files: Mapping[str, Path],
    origin: "GeoOrigin | None",
) -> None:
    """Write tracks in the formats of other programs.

    tracks: tracks in each frame; files: file of each format by its name; origin: place on earth of
    the world frame."""
    from toolkit.exchange.instant import Instant
    from toolkit.exchange.standards import open_writers

    with open_writers(files, origin=origin) as write:
        for time, now in zip(tracked.times, tracks, strict=True):
            write(Instant.from_tracks(time, now))


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
