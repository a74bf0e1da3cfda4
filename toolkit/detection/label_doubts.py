"""Doubts about tracks that serve as labels, so that an annotator looks at the worst first.

The certainty of a track is its mean score, times the share of its frames in which it was detected,
times its number of frames by `MIN_LABEL_FRAMES` if it has fewer, halved if it jumps and again if it
overlaps another track. Its doubt is 1 minus that.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.boxes import iou_bev
from toolkit.exchange.track_frames import TrackFrame
from toolkit.objects import LABELS

MIN_LABEL_FRAMES = 10
MIN_SURE_SCORE = 0.5
MAX_GAP_SHARE = 0.3
MAX_ACCELERATION_M_S2 = 15.0  # no road user brakes harder
MIN_OVERLAP_IOU = 0.1  # footprints; bodies do not overlap
DOUBT_COLUMNS = (
    *("rank", "id", "label", "doubt", "reasons", "first_frame", "last_frame", "frames", "x", "y"),
)


class DoubtfulTrack(NamedTuple):
    """Track that serves as a label, and the doubt about it.

    Attributes:
        number: Its number.
        label: Name of its class.
        doubt: 0 to 1.
        reasons: Words for what is doubtful.
        first: Name or number of its first frame.
        last: Name or number of its last frame.
        frames: Number of its frames.
        middle: x and y (m, world frame) in the middle of its frames."""

    number: int
    label: str
    doubt: float
    reasons: tuple[str, ...]
    first: str
    last: str
    frames: int
    middle: tuple[float, float]


@dataclass
class _Course:
    """Course of a track.

    Attributes:
        names: name or number of each of its frames.
        times: their times (s), NaN if unknown.
        places: x and y (m) in each.
        labels: class in each.
        scores: score in each.
        unseen_frames: number of frames without a detection.
        overlaps: True if it overlaps another track in a frame."""

    names: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    places: list[Float64[np.ndarray, "2"]] = field(default_factory=list)
    labels: list[int] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    unseen_frames: int = 0
    overlaps: bool = False

    def jumps(self) -> bool:
        """True if the speed changes faster than a road user's can; False without times."""
        if len(self.times) < 3 or not np.isfinite(self.times).all():
            return False
        durations_s = np.diff(self.times)
        velocities = np.diff(np.array(self.places), axis=0) / durations_s[:, None]  # m/s
        velocity_changes = np.linalg.norm(np.diff(velocities, axis=0), axis=1)
        return bool((velocity_changes / durations_s[1:] > MAX_ACCELERATION_M_S2).any())

    def judge(self, track_id: int) -> DoubtfulTrack:
        """Return the track with the doubt about it, from 0 to 1, and the reasons for it.

        The doubt is 1 less the product of mean score, share of frames with a detection, and length
        up to `MIN_LABEL_FRAMES`, halved for jumps and for overlaps."""
        frame_count = len(self.names)
        score = min(1.0, max(0.0, float(np.mean(self.scores))))
        jumps = self.jumps()
        has_reason = {
            "unsure": score < MIN_SURE_SCORE,
            "often unseen": self.unseen_frames > MAX_GAP_SHARE * frame_count,
            "short": frame_count < MIN_LABEL_FRAMES,
            "jumps": jumps,
            "overlaps another": self.overlaps,
        }
        seen_share = 1 - self.unseen_frames / frame_count
        certainty = score * seen_share * min(1.0, frame_count / MIN_LABEL_FRAMES)
        certainty *= 0.5 ** (jumps + self.overlaps)  # halved for each that is True
        # in the middle frame
        x, y = self.places[frame_count // 2].tolist()
        return DoubtfulTrack(
            number=track_id,
            label=LABELS[int(np.bincount(self.labels).argmax())],
            doubt=1 - certainty,
            reasons=tuple(reason for reason, holds in has_reason.items() if holds),
            first=self.names[0],
            last=self.names[-1],
            frames=frame_count,
            middle=(x, y),
        )


def rank_doubts(frames: Sequence[TrackFrame]) -> list[DoubtfulTrack]:
    """List the tracks of a recording, the most doubtful first, equal ones by number.

    frames: frames of the recording in order, with their tracks."""
    # what is gathered of each track, by its number
    courses: dict[int, _Course] = {}
    for frame in frames:
        tracks = frame.tracks
        overlap = iou_bev(tracks.boxes, tracks.boxes)
        # each track with itself
        np.fill_diagonal(overlap, 0.0)
        has_overlap = np.asarray((overlap > MIN_OVERLAP_IOU).any(axis=1))
        for row, track_id in enumerate(tracks.ids.tolist()):
            course = courses.setdefault(track_id, _Course())
            course.names.append(frame.name or str(frame.number))
            course.times.append(frame.time)
            course.places.append(tracks.boxes[row, :2])
            course.labels.append(int(tracks.labels[row]))
            course.scores.append(float(tracks.scores[row]))
            course.unseen_frames += int(tracks.unseen[row] > 0)  # s since the last detection
            course.overlaps |= bool(has_overlap[row])
    doubtful_tracks = [course.judge(track_id) for track_id, course in courses.items()]
    return sorted(doubtful_tracks, key=lambda track: (-track.doubt, track.number))


def format_doubts(tracks: Sequence[DoubtfulTrack]) -> str:
    """Format tracks as CSV with the columns `DOUBT_COLUMNS`, in the order given."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(DOUBT_COLUMNS)
    for rank, track in enumerate(tracks, 1):
        x, y = track.middle
        cells = (
            rank,
            track.number,
            track.label,
            f"{track.doubt:.3f}",
            "; ".join(track.reasons),
            track.first,
            track.last,
            track.frames,
            f"{x:.2f}",
            f"{y:.2f}",
        )
        writer.writerow(cells)
    return text.getvalue()
