"""OpenLABEL, read as tracks: one file of all frames, whose objects keep their numbers."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.datasets import frame_labels
from toolkit.datasets.clock_times import parse_time
from toolkit.datasets.layouts.openlabel_boxes import CuboidRows
from toolkit.datasets.layouts.openlabel_systems import parse_systems
from toolkit.datasets.problem_kinds import Problems
from toolkit.datasets.record_values import Unchecked, as_number, entry, numbers
from toolkit.exchange.instant import Instant
from toolkit.exchange.track_frames import TrackFile, TrackFrame, check_rising, make_tracks

UNKNOWN_VELOCITY = (float("nan"), float("nan"), float("nan"))  # m/s


def parse_openlabel_tracks(path: Path, content: Unchecked) -> TrackFile:
    """Parse the cuboids of all frames of an OpenLABEL file.

    path: the file; content: its value of "openlabel". Raises the errors of damaged files, for
    `toolkit.datasets.record_values.name_damage`."""
    problems: Problems = {}
    frames = []
    frames_by_key = entry(content, "frames")  # a key is the frame's number as text
    for key in sorted(frames_by_key, key=int):
        frame = frames_by_key[key]
        properties = frame.get("frame_properties") or {}
        seconds = parse_time(properties.get("timestamp"), "timestamp")
        systems = parse_systems(content, frame)
        # the clouds are in the only root of the coordinate systems, unknown if there are several
        roots = systems.list_roots()
        root = roots.pop() if len(roots) == 1 else None
        cuboids = CuboidRows.parse(content, frame, key, systems, root, problems)
        labels = frame_labels.make_labels(
            cuboids.boxes, categories=cuboids.kinds, ids=cuboids.ids, problems=problems
        )
        objects = labels.objects
        values_by_id = _list_openlabel_values(frame)
        values = [
            values_by_id.get(track_id, _OpenLabelValues()) for track_id in objects.ids.tolist()
        ]
        instant = Instant(
            np.nan if seconds is None else seconds,
            boxes=objects.boxes,
            labels=objects.labels,
            scores=np.array([row.score for row in values]),
            ids=objects.ids,
            velocities=np.array([row.velocity for row in values]).reshape(-1, 3),
        )
        tracks = make_tracks(instant)
        frames.append(
            TrackFrame(
                number=int(key),
                name="",
                time=instant.time_s,
                tracks=tracks,
                rectangles=np.full((len(tracks), 4), np.nan),
            )
        )
    has_times = bool(frames) and all(np.isfinite(frame.time) for frame in frames)
    if has_times:
        check_rising(frames)
    return TrackFile(path, tuple(frames), is_complete=True, has_times=has_times, problems=problems)


class _OpenLabelValues(NamedTuple):
    """Score of an object in one frame of OpenLABEL, 1 without one, and velocity (m/s)."""

    score: float = 1.0
    velocity: tuple[float, float, float] = UNKNOWN_VELOCITY


def _list_openlabel_values(frame: Unchecked) -> dict[int, _OpenLabelValues]:
    """Score and velocity of each object of a frame, by its track id.

    A score is a number of that name in the object's data, or else among the attributes of its first
    cuboid; 1 without one."""
    values = {}
    for key, content in (frame.get("objects") or {}).items():
        data = (content or {}).get("object_data") or {}
        cuboids = data.get("cuboid") or []
        cuboid = cuboids[0] if isinstance(cuboids, list) and cuboids else {}
        attributes = cuboid.get("attributes") or {}
        score = 1.0
        # the last score wins, thus the object's before the cuboid's
        for named_number in [*(attributes.get("num") or []), *(data.get("num") or [])]:
            if named_number.get("name") == "score":
                score = as_number(entry(named_number, "val"), "score")
        velocity = UNKNOWN_VELOCITY
        for named_vector in data.get("vec") or []:
            if named_vector.get("name") == "velocity":
                x, y, z = numbers(entry(named_vector, "val"), 3, "velocity").tolist()
                velocity = (x, y, z)
        values[frame_labels.track_number(key)] = _OpenLabelValues(score, velocity)
    return values
