"""`coview track`: follow road users through a recording."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.commands.detection.detections_in_order import detect_in_order
from coview.commands.detection.placed_detectors import Detectors
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.exchange import Exchange
from coview.outputs import OK, check_file, print_result
from coview.recordings import Opening
from toolkit.calibration.place import Place

if TYPE_CHECKING:
    from toolkit.arrays import Float64
    from toolkit.tracking.tracks import Tracks

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
    check_least("--frames", tracking.frames, 1, "leave it out for all")
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    inputs = [recording, *opening.files]
    files = writing.check(out, inputs) if writing.to else {}
    if not files:
        check_ending(out, ENDINGS, "a file of tracks")
        check_file(out, inputs=inputs, overwrite=writing.overwrite)
    detectors = Detectors(spec, place)
    with opening.open(recording) as opened:
        origin = writing.place(opened.site)
        followed = detect_in_order(
            opened, detectors, errors=tracking.errors, frames=tracking.frames, hidden=writing.json
        )
    tracks = followed.track(offline=tracking.offline)
    if files:
        from toolkit.exchange.instant import Instant
        from toolkit.exchange.standards import open_writers

        with open_writers(files, origin=origin) as write:
            for time, now in zip(followed.times, tracks, strict=True):
                write(Instant.from_tracks(time, now))
    else:
        from toolkit.tracking.track_files import write_tracks

        write_tracks(out, followed.names, followed.times, tracks)
    figures = _summarise(tracks)
    text = (
        f"{out}: {figures['tracks']} road users in {figures['frames']} frames, "
        f"{figures['seconds']:.1f} s in the median"
    )
    print_result(figures | {"out": str(out)}, text, as_json=writing.json)
    return OK


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
