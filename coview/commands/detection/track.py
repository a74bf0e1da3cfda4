"""`coview track`: follow road users through a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_least, check_positive
from coview.commands.detection.detection_texts import DetectionText, read_text_alone
from coview.commands.detection.detections_in_order import detect_in_order
from coview.commands.detection.placed_detectors import Detectors
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.exchange import Exchange
from coview.outputs import OK, check_file, print_result
from coview.recordings import Opening
from coview.tracks import TEXT, find_sequence
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.arrays import Float64
    from toolkit.exchange.geo_origin import GeoOrigin
    from toolkit.tracking.tracks import Tracks

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
    _check_detector_use(spec, has_detections=is_text or path is not None)
    texts = [] if path is None else [path]
    inputs = [recording, *opening.files, *texts]
    files = writing.check(out, inputs) if writing.to else {}
    if not files:
        check_ending(out, ENDINGS, "a file of tracks")
        check_file(out, inputs=inputs, overwrite=writing.overwrite)
    if is_text:
        if path is not None:
            raise ValueError(f"{recording} holds detections already: leave --detections out")
        followed = read_text_alone(recording, tracking.rate, tracking.frames)
        origin = writing.place(None)
    else:
        with opening.open(recording) as opened:
            origin = writing.place(opened.site)
            if path is not None:
                sequence = find_sequence(recording, opening)
                source = DetectionText(path, place, sequence, rate_hz=tracking.rate)
                followed = source.read(opened, tracking.frames)
            else:
                followed = detect_in_order(
                    opened,
                    Detectors(spec, place),
                    errors=tracking.errors,
                    frames=tracking.frames,
                    hidden=writing.json,
                    rate_hz=tracking.rate,
                )
    tracks = followed.track(offline=tracking.offline)
    if files:
        _export(followed.times, tracks, files, origin=origin, asn1=writing.asn1)
    else:
        from toolkit.tracking.track_files import write_tracks

        write_tracks(out, followed.names, followed.times, tracks)
    figures = _summarise(tracks)
    summary = (
        f"{out}: {figures['tracks']} road users in {figures['frames']} frames, "
        f"{figures['seconds']:.1f} s in the median"
    )
    print_result(figures | {"out": str(out)}, summary, as_json=writing.json)
    return OK


def _check_detector_use(spec: DetectorSpec, *, has_detections: bool) -> None:
    """Raise ValueError for an unknown detector, or for one next to detections of a text."""
    if not has_detections:
        check_detector(spec)
    elif spec.name != USUAL_DETECTOR:
        raise ValueError("--detector does not go with detections of a text: leave it out")


def _export(
    times: Sequence[float],
    tracks: "Sequence[Tracks]",
    files: Mapping[str, Path],
    *,
    origin: "GeoOrigin | None",
    asn1: Path | None,
) -> None:
    """Write tracks in the formats of other programs.

    times: time of each frame (s); tracks: tracks in each frame; files: file of each format by its
    name; origin: place on earth of the world frame, None if no format needs it; asn1: folder of the
    ASN.1 modules for cpm, None without that format."""
    from toolkit.exchange.instant import Instant
    from toolkit.exchange.standards import open_writers

    with open_writers(files, origin=origin, asn1=asn1) as write:
        for time, now in zip(times, tracks, strict=True):
            write(Instant.from_tracks(time, now))


def _summarise(tracks: "Sequence[Tracks]") -> dict[str, float]:
    """Count frames and road users, with the median of the seconds that they are followed."""
    ages: dict[int, float] = {}  # seconds followed up to the last frame with it, by id
    for frame_tracks in tracks:
        ages |= dict(zip(frame_tracks.ids.tolist(), frame_tracks.ages.tolist(), strict=True))
    seconds: Float64[np.ndarray, " n"] = np.array(list(ages.values()), np.float64)
    return {
        "frames": len(tracks),
        "tracks": len(ages),
        "seconds": float(np.median(seconds)) if len(seconds) else 0.0,
    }
