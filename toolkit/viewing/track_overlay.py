"""Tracks that are drawn over the frames of a recording, with trails of their past places."""

from dataclasses import dataclass

import numpy as np

from toolkit.arrays import BoxRows
from toolkit.exchange.track_lookup import FrameKey, TrackLookup
from toolkit.frame import Frame
from toolkit.objects import LABELS
from toolkit.tracking.tracks import Tracks
from toolkit.viewing.box_lines import Segments

TRAIL_FRAMES = 30  # frames of the file before the one that is drawn


@dataclass(frozen=True, eq=False)
class TrackOverlay:
    """Tracks of a file, by the frames of a recording.

    Attributes:
        lookup: the file's tracks by frame."""

    lookup: TrackLookup

    def find(self, frame: Frame) -> Tracks:
        """Return the tracks of a frame.

        Raises ValueError, by name, for a frame that a complete file lacks."""
        key = FrameKey(frame.index, frame.name, frame.time)
        tracks = self.lookup.find(key)
        if tracks is None and self.lookup.file.is_complete:
            raise ValueError(
                f"{self.lookup.file.path} lacks frame {key.describe()}: is it of this recording?"
            )
        return Tracks.empty() if tracks is None else tracks

    def trace(self, frame: Frame, tracks: Tracks) -> dict[str, BoxRows]:
        """Return the boxes that some tracks had in a frame and before it, in the order of time.

        frame: the frame; tracks: tracks to trace in it. Boxes are by class and number of the track,
        such as "vehicle 7"."""
        index = self.lookup.find_index(FrameKey(frame.index, frame.name, frame.time))
        if index is None:
            return {}
        names = {}
        for number, label in zip(tracks.ids.tolist(), tracks.labels.tolist(), strict=True):
            names[number] = f"{LABELS[label]} {number}"
        boxes: dict[str, list[BoxRows]] = {}
        for past in self.lookup.file.frames[max(0, index - TRAIL_FRAMES) : index + 1]:
            for row, number in enumerate(past.tracks.ids.tolist()):
                if number in names:
                    boxes.setdefault(names[number], []).append(past.tracks.boxes[[row]])
        return {name: np.concatenate(rows) for name, rows in boxes.items()}


def trail_segments(boxes: BoxRows) -> Segments:
    """Lines on the ground from each of a track's boxes to the next."""
    floor = boxes[:, :3] - np.array([0.0, 0, 0.5]) * boxes[:, 5:6]
    return np.stack([floor[:-1], floor[1:]], axis=1).astype(np.float64)
