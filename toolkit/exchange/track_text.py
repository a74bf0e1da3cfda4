"""KITTI's tracking text, read as tracks, detections or objects.

Boxes are in a camera's frame, whose pose the caller gives. Text whose image rectangles all are the
whole image is of no camera, as coview writes it: its boxes are in the world frame."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64, Pose
from toolkit.class_names import CATEGORIES, check_classes
from toolkit.datasets.layouts.kitti import DONT_CARE, IMAGE_PX, LabelRows, parse_camera_boxes
from toolkit.datasets.layouts.kitti_track_rows import read_track_rows
from toolkit.datasets.problem_kinds import OTHER_KINDS, Problems, add_problem
from toolkit.datasets.record_values import name_damage
from toolkit.exchange.instant import Instant
from toolkit.exchange.track_frames import TrackFile, TrackFrame, make_tracks
from toolkit.geometry import BODY_SE3_CAMERA
from toolkit.objects import Detections

RECTANGLE = slice(3, 7)  # columns left, top, right, bottom of `LabelRows.values`
UNKNOWN_RECTANGLE_PX = (0.0, 0.0, IMAGE_PX[0] - 1.0, IMAGE_PX[1] - 1.0)  # as coview writes it


def read_track_text(path: Path, world_SE3_camera: Pose) -> TrackFile:
    """Read tracks of KITTI's text.

    world_SE3_camera: pose of the camera. Raises ValueError that names the file."""
    problems: Problems = {}
    frames = []
    with name_damage(path, "file of tracks"):
        for number, rows in _place_text(read_track_rows(path), world_SE3_camera, problems):
            try:
                instant = Instant(
                    time_s=np.nan,
                    boxes=rows.boxes,
                    labels=rows.labels,
                    scores=rows.scores,
                    ids=rows.ids,
                )
            except ValueError as error:
                raise ValueError(f"frame {number}: {error}") from None
            frames.append(
                TrackFrame(
                    number=number,
                    name="",
                    time=np.nan,
                    tracks=make_tracks(instant),
                    rectangles=rows.rectangles,
                )
            )
    # not complete: frames without an object have no row
    return TrackFile(path, tuple(frames), is_complete=False, has_times=False, problems=problems)


def read_detection_text(
    path: Path, world_SE3_camera: Pose = BODY_SE3_CAMERA
) -> dict[int, Detections]:
    """Read detections of KITTI's text by the number of their frame; tracks do not matter.

    Scores outside 0 to 1 are logits: all of the file become probabilities. Rows without a score
    have 1. world_SE3_camera: pose of the camera, by default one at the world's origin that faces
    along x. Raises ValueError that names the file."""
    detections = {}
    with name_damage(path, "file of detections"):
        frames = _place_text(read_track_rows(path), world_SE3_camera, problems={})
        all_scores = np.concatenate([np.zeros(0), *(rows.scores for _, rows in frames)])
        are_logits = bool(((all_scores < 0) | (all_scores > 1)).any())
        for number, rows in frames:
            instant = Instant(np.nan, rows.boxes, labels=rows.labels, scores=rows.scores)
            scores = instant.scores
            if are_logits:
                scores = 1 / (1 + np.exp(-np.clip(scores, -500, 500)))  # exp stays finite
            detections[number] = Detections(instant.boxes, scores, instant.labels)
    return detections


class TextRows(NamedTuple):
    """Objects of one frame of KITTI's text.

    Attributes:
        boxes: Boxes in the world frame.
        labels: Their classes, as numbers of `LABELS`.
        scores: Their scores, 1 without one.
        ids: Their track numbers.
        rectangles: As in `TrackFrame`.
        rows: Index of each object among the text's rows of its frame."""

    boxes: Float64[np.ndarray, "n 7"]
    labels: Int64[np.ndarray, " n"]
    scores: Float64[np.ndarray, " n"]
    ids: Int64[np.ndarray, " n"]
    rectangles: Float64[np.ndarray, "n 4"]
    rows: Int64[np.ndarray, " n"]


def _place_text(
    rows_by_frame: dict[int, LabelRows], world_SE3_camera: Pose, problems: Problems
) -> list[tuple[int, TextRows]]:
    """Number and objects of each frame of a text, in ascending order.

    rows_by_frame: rows of the text by the number of their frame; world_SE3_camera: pose of the
    camera of the boxes; problems: numbers of rows of other kinds are added to it."""
    rectangles = [np.zeros((0, 4)), *(rows.values[:, RECTANGLE] for rows in rows_by_frame.values())]
    are_unknown = np.isclose(np.concatenate(rectangles), UNKNOWN_RECTANGLE_PX, atol=0.01).all()
    # coview writes unknown rectangles, for a camera at the world's origin that faces along x
    pose = BODY_SE3_CAMERA if are_unknown else world_SE3_camera
    frames = []
    for number in sorted(rows_by_frame):
        if number < 0:
            raise ValueError(f"frames must be numbered from 0, got {number}")
        objects = place_rows(rows_by_frame[number], pose, problems)
        if are_unknown:
            objects = objects._replace(rectangles=np.full_like(objects.rectangles, np.nan))
        frames.append((number, objects))
    return frames


def place_rows(rows: LabelRows, world_SE3_camera: Pose, problems: Problems) -> TextRows:
    """Return the objects of our classes among the rows of a frame, in the world frame.

    DontCare is passed over; other kinds of KITTI's are counted in `problems`, which is changed.
    Raises ValueError for kinds that nobody knows."""
    row_labels = []
    for kind in rows.kinds:
        name = kind.lower()
        if name not in CATEGORIES and name not in ("misc", DONT_CARE.lower()):
            check_classes([kind])
        add_problem(problems, OTHER_KINDS, int(name == "misc"))
        row_labels.append(CATEGORIES.get(name, -1))
    labels = np.array(row_labels, np.int64)  # -1 for rows that are left out
    known_rows = np.flatnonzero(labels >= 0)
    values = rows.values[known_rows]
    scores = np.ones(len(known_rows))
    if rows.scores is not None:
        scores = np.nan_to_num(rows.scores[known_rows], nan=1.0)
    ids = np.array(rows.ids or [], np.int64).reshape(-1)  # none in a text of detections
    return TextRows(
        boxes=parse_camera_boxes(values, world_SE3_camera),
        labels=labels[known_rows],
        scores=scores,
        ids=ids[known_rows] if len(ids) else np.arange(len(known_rows)),
        rectangles=values[:, RECTANGLE],
        rows=known_rows,
    )
