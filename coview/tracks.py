"""Files of tracks that commands read, next to a recording."""

from pathlib import Path
from typing import TYPE_CHECKING

from coview.recordings import Opening

if TYPE_CHECKING:
    from toolkit.datasets.recording_views import Numbered
    from toolkit.exchange.track_frames import TrackFile
    from toolkit.frame import Recording

TEXT = ".txt"  # ending of KITTI's tracking text
KITTI_SEQUENCE = "kitti-tracking"  # layout whose frames are named by their numbers


def find_sequence(recording: Path, opening: Opening) -> Path | None:
    """Return a recording's path if it is a sequence of KITTI's tracking, else None."""
    from toolkit.datasets.recordings import guess_layout

    layout = opening.layout or guess_layout(recording)
    return recording if layout == KITTI_SEQUENCE else None


def number_frames(opened: "Recording", sequence: Path | None) -> "Numbered":
    """Return a recording whose frames have the numbers that texts of tracks know them by.

    sequence: its path if it is one of KITTI's, whose frames are named by their numbers."""
    from toolkit.datasets.recording_views import Numbered

    return Numbered(opened, by_name=sequence is not None)


def read_tracks(path: Path, sequence: Path | None) -> "TrackFile":
    """Read a file of tracks of a recording.

    sequence: KITTI's sequence whose camera the boxes of a text are in, None for the frame that
    coview writes. Raises ValueError that names the file, OSError if it is missing."""
    from toolkit.datasets.layouts.kitti_sequences import find_camera
    from toolkit.exchange.track_reading import read_track_file

    if not path.exists():
        raise FileNotFoundError(f"no such file of tracks: {path}")
    if sequence is None or path.suffix.lower() != TEXT:
        return read_track_file(path)
    return read_track_file(path, find_camera(sequence))
