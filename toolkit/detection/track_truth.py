"""Tracks of a file next to the truth of a recording, frame by frame.

Frames are matched by time, by name if one side has no times, and by number if the file has neither.
What does not match is refused: frames that only one side has, and tracks that come near no true
object. CSV and KITTI's text do not list frames without road users."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Mask
from toolkit.calibration.place import Place, Stand
from toolkit.detection.breakdown import select_truth
from toolkit.detection.track_evaluation import ScoredFrame
from toolkit.exchange.track_frames import TrackFile
from toolkit.exchange.track_lookup import FrameKey, TrackLookup
from toolkit.frame import Recording, Region
from toolkit.objects import Objects
from toolkit.points import has_centre_inside
from toolkit.sensors.track_velocities import MOST_APART, velocities
from toolkit.tracking.object_errors import TruthMotion

MAX_NEAR_M = 5.0  # between a track and a true object of one place


class TrueFrame(NamedTuple):
    """True objects of one frame of a recording.

    Attributes:
        key: Number, name and time of the frame.
        objects: All labelled objects.
        counted: Mask of the objects that are to be found.
        corners: Detection area: xmin, ymin, xmax, ymax (m, world frame).
        complete: Region in which labels are complete."""

    key: FrameKey
    objects: Objects
    counted: Mask
    corners: Float64[np.ndarray, "4"]
    complete: Region


def read_truth(
    recording: Recording,
    count: int,
    place: Place,
    *,
    needs_points: bool,
    progress: Callable[[int], None] = lambda done: None,
) -> list[TrueFrame]:
    """Read the true objects of the first frames of a recording.

    Args:
        recording: Recording with labels, whose frames have their numbers.
        count: Number of first frames.
        place: Detection area; the site's if it gives none.
        needs_points: True if only objects with a point, in the region of complete labels, are to be
            found; else all in the area.
        progress: Called with the number of frames read."""
    site = recording.site
    half_x, half_y = place.half
    area = np.array([-half_x, -half_y, half_x, half_y])
    frames = []
    for k in range(count):
        frame = recording[k]
        stand = Stand(area, place.find_middle(frame))
        if site is not None and place.uses_site(site):  # the site's area is used
            stand = Stand(site, np.zeros(2))
        corners = stand.corners
        if needs_points:
            is_counted = select_truth(frame, corners).counted
        else:
            is_counted = has_centre_inside(frame.objects.boxes, corners)
        frames.append(
            TrueFrame(
                key=FrameKey(number=frame.index, name=frame.name, time=frame.time),
                objects=frame.objects,
                counted=is_counted,
                corners=corners,
                complete=frame.complete,
            )
        )
        progress(k + 1)
    return frames


def pair_with_truth(
    file: TrackFile, truth: Sequence[TrueFrame], *, is_part: bool = False
) -> list[ScoredFrame]:
    """Return the tracks and the truth of each frame of a recording.

    Args:
        file: Tracks of the recording.
        truth: Its true objects.
        is_part: True if the recording goes on after these frames; later tracks are left out.

    Raises ValueError, by name, for frames that only one side has, and if no track comes near a
    true object."""
    tracks = TrackLookup(file).list_tracks([frame.key for frame in truth], is_part=is_part)
    moving_truths = find_motions(
        [frame.objects for frame in truth], [frame.key.time for frame in truth]
    )
    scored_frames = []
    for frame_tracks, frame, moving_truth in zip(tracks, truth, moving_truths, strict=True):
        is_inside = has_centre_inside(frame_tracks.boxes, frame.corners)
        # only where all true objects are labelled
        is_inside &= frame.complete.covers(frame_tracks.boxes)
        scored_frames.append(
            ScoredFrame(frame_tracks, truth=moving_truth, counted=frame.counted, outside=~is_inside)
        )
    check_near(str(file.path), scored_frames)
    return scored_frames


def find_motions(truth: Sequence[Objects], times: Sequence[float]) -> list[TruthMotion]:
    """Return the objects of each frame of a recording with their velocities.

    truth: objects of each frame, in order; times: time of each frame (s), NaN if unknown. A
    velocity is unknown (NaN) without times, next to frames more than `MOST_APART` seconds away, and
    of an object that is not in the frames next to it."""
    motions = []
    for k, objects in enumerate(truth):
        neighbours = []  # objects and time (s) of the frames before and after
        for neighbour in (k - 1, k + 1):
            if 0 <= neighbour < len(truth):
                gap_s = abs(times[neighbour] - times[k])
                if 0 < gap_s <= MOST_APART:
                    neighbours.append((truth[neighbour], times[neighbour]))
        vectors = np.full((len(objects), 3), np.nan)  # velocities along x, y and z (m/s)
        if neighbours:
            neighbour_ids = np.concatenate([others.ids for others, _ in neighbours])
            is_known = np.isin(objects.ids, neighbour_ids)
            vectors[is_known] = velocities(objects, times[k], neighbours)[is_known]
        motions.append(TruthMotion(objects, vectors, time=times[k], is_first=k == 0))
    return motions


def check_near(path: str, frames: Sequence[ScoredFrame]) -> None:
    """Raise ValueError if there are tracks and objects, but never one near the other.

    path: name of the file of tracks."""
    pair_count = 0
    for frame in frames:
        boxes = frame.truth.objects.boxes
        offsets = frame.tracks.boxes[:, None, :2] - boxes[None, :, :2]
        distances = np.hypot(offsets[..., 0], offsets[..., 1])
        if (distances <= MAX_NEAR_M).any():
            return
        pair_count += distances.size
    if pair_count:
        raise ValueError(
            f"no road user of {path} comes within {MAX_NEAR_M:g} m of a true one in its frame: is "
            "it of another place, or in another coordinate frame?"
        )
