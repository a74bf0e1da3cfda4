"""Errors of tracks against the true objects that they match, and how soon objects are found.

Objects and tracks match as for MOTA.

    speed error         mean over all matches of |speed of the track - speed of the object|; a true
                        speed comes from the object's places in the frames before and after
    heading error       mean over all matches of the angle between the headings
    first detection     seconds from the frame in which a true object is first to be found to its
                        first match, over the objects that come in after the first frame of their
                        recording. Quantiles count objects that are never matched as infinite.
    never found         share of these objects without any match
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.objects import Objects
from toolkit.tracking.frame_overlap import FrameOverlap
from toolkit.tracking.scores import ClearMatch
from toolkit.tracking.tracks import Tracks


class TruthMotion(NamedTuple):
    """True objects of one frame, with time and motion.

    Attributes:
        objects: All objects of the frame.
        velocities: (n, 3), m/s, NaN if unknown.
        time: Time of the frame (s), NaN if unknown.
        is_first: True for the first frame of a recording."""

    objects: Objects
    velocities: Float64[np.ndarray, "n 3"]
    time: float
    is_first: bool


class ObjectErrors(NamedTuple):
    """Errors of one class, as defined at the top of the module.

    Attributes:
        speed_error_mps: Mean error of speed (m/s), NaN if no speed is known.
        heading_error_deg: Mean error of heading (degrees), NaN without a match.
        first_detection_s: Median time to the first detection (s), NaN if no object comes in.
        first_detection_95_s: Its 95 % quantile (s).
        never_found: Share of the objects that come in and are never matched, NaN if none comes in.
        entering: Number of objects that come in."""

    speed_error_mps: float
    heading_error_deg: float
    first_detection_s: float
    first_detection_95_s: float
    never_found: float
    entering: int


def measure_errors(
    overlaps: Sequence[FrameOverlap],
    matches: Sequence[ClearMatch],
    tracks: Sequence[Tracks],
    truths: Sequence[TruthMotion],
) -> ObjectErrors:
    """Measure the errors of the tracks of one class in all frames.

    Args:
        overlaps: Objects and tracks of the class that count, by frame.
        matches: Matches among them, by frame.
        tracks: All tracks of each frame, with velocities of NaN if they are unknown.
        truths: All objects of each frame."""
    speed_errors = [np.zeros(0)]
    heading_errors = [np.zeros(0)]
    frames = zip(overlaps, matches, tracks, truths, strict=True)
    for overlap, match, frame_tracks, truth in frames:
        truth_rows = overlap.truth_rows[match.rows]
        track_rows = overlap.track_rows[match.columns]
        speed_errors.append(_measure_speed_errors(overlap, match, frame_tracks, truth))
        turn = frame_tracks.boxes[track_rows, 6] - truth.objects.boxes[truth_rows, 6]
        heading_errors.append(np.abs(np.arctan2(np.sin(turn), np.cos(turn))))
    speed_error = np.concatenate(speed_errors)
    ways = collect_ways(overlaps, matches, tracks, truths)
    waits = np.array([way.wait_s for way in ways if way.comes_in], np.float64)
    median = tail = never = float("nan")
    if len(waits):
        median = find_quantile(waits, 0.5)
        tail = find_quantile(waits, 0.95)
        never = float(np.isinf(waits).mean())
    return ObjectErrors(
        speed_error_mps=_mean(speed_error[np.isfinite(speed_error)]),
        heading_error_deg=float(np.rad2deg(_mean(np.concatenate(heading_errors)))),
        first_detection_s=median,
        first_detection_95_s=tail,
        never_found=never,
        entering=len(waits),
    )


class TrackedWay(NamedTuple):
    """True road user in all frames in which it is to be found, and how it was followed.

    Attributes:
        id: Its number.
        frames: Number of frames in which it is to be found.
        matched_frames: Number of frames in which a track matches it too.
        comes_in: False if it is to be found in the first frame of its recording already.
        wait_s: Seconds from the first such frame to the first match; infinite without a match,
            NaN without times.
        speed_error_mps: Mean error of speed over its matches, NaN if no speed is known."""

    id: int
    frames: int
    matched_frames: int
    comes_in: bool
    wait_s: float
    speed_error_mps: float


def collect_ways(
    overlaps: Sequence[FrameOverlap],
    matches: Sequence[ClearMatch],
    tracks: Sequence[Tracks],
    truths: Sequence[TruthMotion],
) -> list[TrackedWay]:
    """Return the ways of one class, in the order in which they are first to be found.

    Args:
        overlaps: Objects and tracks of the class that count, by frame.
        matches: Matches among them, by frame.
        tracks: All tracks of each frame, with velocities of NaN if they are unknown.
        truths: All objects of each frame."""
    frame_counts: dict[int, int] = {}
    entry_times: dict[int, float] = {}
    match_times: dict[int, float] = {}
    errors_by_way: dict[int, list[float]] = {}
    present_at_first: set[int] = set()
    frames = zip(overlaps, matches, tracks, truths, strict=True)
    for overlap, match, frame_tracks, truth in frames:
        for number in overlap.pairs.truth.tolist():
            frame_counts[number] = frame_counts.get(number, 0) + 1
            entry_times.setdefault(number, truth.time)
            if truth.is_first:
                present_at_first.add(number)
        speed_errors = _measure_speed_errors(overlap, match, frame_tracks, truth).tolist()
        matched_ids = overlap.pairs.truth[match.rows].tolist()
        for number, error in zip(matched_ids, speed_errors, strict=True):
            match_times.setdefault(number, truth.time)
            errors_by_way.setdefault(number, []).append(error)
    ways = []
    for number, entry_time in entry_times.items():
        errors = np.array(errors_by_way.get(number, []), np.float64)
        way = TrackedWay(
            id=number,
            frames=frame_counts[number],
            matched_frames=len(errors),
            comes_in=number not in present_at_first,
            wait_s=match_times[number] - entry_time if number in match_times else float("inf"),
            speed_error_mps=_mean(errors[np.isfinite(errors)]),
        )
        ways.append(way)
    return ways


def _measure_speed_errors(
    overlap: FrameOverlap, match: ClearMatch, tracks: Tracks, truth: TruthMotion
) -> Float64[np.ndarray, " k"]:
    """Absolute error of speed (m/s) of each of k matches of a frame, NaN if a speed is unknown.

    Args:
        overlap: Objects and tracks of the frame that count.
        match: Matches among them.
        tracks: All tracks of the frame.
        truth: All objects of the frame."""
    true_velocities = truth.velocities[overlap.truth_rows[match.rows]]
    velocities = tracks.velocities[overlap.track_rows[match.columns]]
    speeds = np.linalg.norm(velocities, axis=1)
    return np.abs(speeds - np.linalg.norm(true_velocities, axis=1))


def find_quantile(values: Float64[np.ndarray, " n"], share: float) -> float:
    """Smallest value that at least this share (0 to 1) of the values does not exceed.

    NaN if one of the values is NaN. values: at least one."""
    if np.isnan(values).any():
        return float("nan")
    ordered = np.sort(values)
    return float(ordered[max(0, int(np.ceil(share * len(ordered))) - 1)])


def _mean(values: Float64[np.ndarray, " n"]) -> float:
    """Mean of values, NaN without any."""
    return float(values.mean()) if len(values) else float("nan")
