"""`coview label`: tracks as labels of a recording, for an annotator to correct."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from coview.arguments import check_least
from coview.outputs import OK, Writing, check_empty_folder, check_file, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from coview.tracks import find_sequence, number_frames, read_tracks
from toolkit.datasets.recordings import find_layout

if TYPE_CHECKING:
    from collections.abc import Sequence

    from toolkit.detection.label_doubts import DoubtfulTrack
    from toolkit.exchange.track_lookup import TrackLookup
    from toolkit.frame import Frame, Recording

LISTED_TRACKS = 5  # number of the most doubtful tracks that are printed


def label_command(
    recording: Positional[Path],
    /,
    *,
    tracks: Path,
    out: Path,
    to: str = "sustech",
    frames: int | None = None,
    opening: Opening = Opening(),
    writing: Writing = Writing(),
) -> int:
    """Write tracks as labels of a recording, and a list of them with the most doubtful first.

    An annotator corrects them in a tool that reads the layout; coview reads them back. The list is
    written next to the labels, as NAME-doubtful.csv.

    Example: coview label my-log --layout argoverse --tracks tracks.json --out labelled

    Example: coview label my-clouds --tracks tracks.json --out my-clouds/labels.json

    Args:
        recording: Recording in any layout.
        tracks: File of tracks, as in coview evaluate; offline tracks are the surest.
        out: Folder of clouds and labels, or file of labels (.json) for a folder of clouds.
        to: Layout of the folder: sustech (SUSTechPOINTS), openlabel, kitti, folder, or another one
            that coview convert writes.
        frames: Number of first frames; all when left out."""
    from toolkit.datasets.recording_views import Part
    from toolkit.detection.label_doubts import format_doubts, rank_doubts
    from toolkit.exchange.track_lookup import TrackLookup
    from toolkit.runtime.writing import writing as writing_file

    check_least("--frames", value=frames, minimum=1, remedy="leave it out for all")
    is_file = out.suffix.lower() == ".json"
    target = find_layout(to)
    if target.file:
        raise ValueError(f"--to {to} is no folder that annotators open: give sustech or openlabel")
    write_frames = _write_labels if is_file else target.write
    doubts_file = out.with_name(f"{out.stem if is_file else out.name}-doubtful.csv")
    inputs = [recording, tracks, *opening.files]
    check_out = check_file if is_file else check_empty_folder
    check_out(out, inputs=inputs, overwrite=writing.overwrite)
    check_file(doubts_file, inputs=inputs, overwrite=writing.overwrite)
    with opening.open(recording) as opened:
        sequence = find_sequence(recording, opening)
        lookup = TrackLookup(read_tracks(tracks, sequence))
        samples = Part(number_frames(opened, sequence), frames)
        # the list is opened first, so that it appears right after the labels
        with (
            writing_file(doubts_file) as unfinished,
            progress_bar("frame", len(samples), hidden=writing.json) as bar,
        ):
            is_part = len(samples) < len(opened)
            labelled_frames = _label_frames(samples, lookup, bar.to, is_part=is_part)
            written_count = write_frames(labelled_frames, out)
            # all tracks, the most doubtful first
            doubtful_tracks = rank_doubts(lookup.list_used())
            unfinished.write_bytes(format_doubts(doubtful_tracks).encode())
    worst_tracks = doubtful_tracks[:LISTED_TRACKS]
    figures = {
        "out": str(out),
        "frames": written_count,
        "tracks": len(doubtful_tracks),
        "doubtful": str(doubts_file),
        "worst": [track._asdict() for track in worst_tracks],
    }
    text = f"{out}: {written_count} frames, {len(doubtful_tracks)} road users\n"
    text += _describe_doubts(worst_tracks)
    print_result(figures, f"{text}all in {doubts_file}", as_json=writing.json)
    return OK


def _label_frames(
    samples: "Recording", lookup: "TrackLookup", progress: Callable[[int], None], *, is_part: bool
) -> "Iterator[Frame]":
    """Yield frames whose objects are the tracks of a file, none in a frame that it does not list.

    samples: frames of the recording; lookup: finds the tracks of a frame in the file; progress:
    called with the number of frames done; is_part: True if the recording goes on after these
    frames. Raises ValueError, by name, for a frame that a file of all frames lacks, and for
    frames of the file that the recording does not have."""
    from toolkit.exchange.track_lookup import FrameKey
    from toolkit.frame import OtherObjects
    from toolkit.objects import Objects

    key = FrameKey(-1, "", float("nan"))  # the last frame's after the loop
    for row in range(len(samples)):
        frame = samples[row]
        key = FrameKey(number=frame.index, name=frame.name, time=frame.time)
        tracks = lookup.find(key)
        if tracks is None and lookup.file.is_complete:
            raise ValueError(
                f"{lookup.file.path} lacks frame {key.describe()}: track the whole recording, or "
                "pass --frames"
            )
        objects = Objects.empty()
        if tracks is not None:
            objects = Objects(tracks.boxes, tracks.labels, tracks.ids)
        progress(row + 1)
        # nothing of the recording's labels stays
        yield replace(frame, objects=objects, categories=(), counts=None, others=OtherObjects())
    lookup.check_all_used(len(samples), key if is_part else None)


def _write_labels(frames: "Iterator[Frame]", out: Path) -> int:
    """Write the objects of frames as a file of boxes; return the number of frames."""
    from toolkit.datasets.box_files import boxes_record, write_boxes

    entries = [boxes_record(frame.name, frame.time, frame.objects) for frame in frames]
    write_boxes(out, entries)
    return len(entries)


def _describe_doubts(tracks: "Sequence[DoubtfulTrack]") -> str:
    """Lines for some tracks and the doubts about them, a line each with its end."""
    lines = []
    for track in tracks:
        reasons = ", ".join(track.reasons) or "nothing in particular"
        span = f"frames {track.first} to {track.last}"
        lines.append(
            f"  {track.label} {track.number}: doubt {track.doubt:.2f}, {reasons}, {span}\n"
        )
    return "".join(lines)
