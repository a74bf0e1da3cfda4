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
        such as "vehicle 7". Frames more than `TRAIL_FRAMES` before are not traced."""
        index = self.lookup.find_index(FrameKey(frame.index, frame.name, frame.time))
        if index is None:
            return {}
        name_by_id = {}
        for track_id, label in zip(tracks.ids.tolist(), tracks.labels.tolist(), strict=True):
            name_by_id[track_id] = f"{LABELS[label]} {track_id}"
        # one array of one row for each frame that has the track
        boxes_by_name: dict[str, list[BoxRows]] = {}
        for past_frame in self.lookup.file.frames[max(0, index - TRAIL_FRAMES) : index + 1]:
            past_tracks = past_frame.tracks
            for row, track_id in enumerate(past_tracks.ids.tolist()):
                if track_id in name_by_id:
                    name = name_by_id[track_id]
                    boxes_by_name.setdefault(name, []).append(past_tracks.boxes[[row]])
        return {name: np.concatenate(arrays) for name, arrays in boxes_by_name.items()}


def trail_segments(boxes: BoxRows) -> Segments:
    """Lines on the ground (start and end, m) from each of a track's boxes to the next.

    boxes: the track's in the order of time, one at least."""
    height = boxes[:, 5:6]
    floor = boxes[:, :3] - np.array([0.0, 0, 0.5]) * height  # middle of each box's floor
    return np.stack([floor[:-1], floor[1:]], axis=1).astype(np.float64)
