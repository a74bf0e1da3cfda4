"""Tracks next to labels in KITTI's tracking text, as its benchmark counts them.

- Truncated and heavily occluded objects, vans and people who sit (Person) are not to be found.
- Tracks without a match are no false alarm if their rectangle in the image is at most 25 pixels
  high, or is by more than half in a DontCare rectangle. Rectangles follow from the boxes if
  there is a calibration, calib/NAME.txt next to the labels' folder; else they are the file's. A
  track without a rectangle is never ignored.
- Frames go by their numbers. A frame without any row has no objects."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Mask
from toolkit.datasets.layouts.kitti import DONT_CARE, IMAGE_PX, LabelRows, read_calibration
from toolkit.datasets.layouts.kitti_track_rows import read_track_rows
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.record_values import name_damage
from toolkit.detection.track_evaluation import ScoredFrame
from toolkit.detection.track_truth import check_near, find_motions
from toolkit.exchange.instant import Instant
from toolkit.exchange.track_frames import TrackFile, TrackFrame
from toolkit.exchange.track_reading import read_track_file
from toolkit.exchange.track_text import place_rows
from toolkit.frame import ImageWedge
from toolkit.geometry import BODY_SE3_CAMERA, invert
from toolkit.objects import Objects
from toolkit.tracking.tracks import Tracks

MAX_TRUNCATION = 0.0
MAX_OCCLUSION = 2.0
MIN_HEIGHT_PX = 25.0
MAX_IGNORED_SHARE = 0.5  # part of a track's rectangle in a DontCare rectangle
UNCOUNTED_KINDS = ("van", "person", "person_sitting")
ID_STEP = 2**32  # between the numbers of two sequences
# columns of `LabelRows.values`
_TRUNCATION = 0
_OCCLUSION = 1
_RECTANGLE = slice(3, 7)  # left, top, right, bottom


class LabelFrame(NamedTuple):
    """Labels of one frame.

    Attributes:
        objects: Labelled objects of our classes, in the axes of a body.
        counted: Mask of the objects that are to be found.
        ignored: (k, 4), left, top, right, bottom (px) of DontCare."""

    objects: Objects
    counted: Mask
    ignored: Float64[np.ndarray, "k 4"]


class LabelledTracks(NamedTuple):
    """Tracks and labels of all sequences.

    Attributes:
        frames: Tracks and truth of each frame, sequence after sequence.
        problems: Number of rows left out, by kind.
        unscored: Names of sequences with labels, but without tracks.
        late: Number of frames with tracks after the last labelled one."""

    frames: list[ScoredFrame]
    problems: Problems
    unscored: list[str]
    late: int


def pair_with_labels(
    truth: Path, tracks: Path, rate_hz: float | None = None, count: int | None = None
) -> LabelledTracks:
    """Read labels and tracks of one sequence, or of folders with a file for each sequence.

    Args:
        truth: Text of labels, or folder of such texts.
        tracks: File of tracks, or folder of texts with the names of the labels.
        rate_hz: Frames in a second, None if unknown.
        count: Number of first frames of each sequence, None for all.

    Raises ValueError, by name, for damaged files and for tracks without labels; OSError for missing
    ones."""
    labels_by_name = _list_texts(truth)
    tracks_by_name = _list_texts(tracks)
    if not truth.is_dir() and not tracks.is_dir():
        tracks_by_name = dict.fromkeys(labels_by_name, tracks)
    unlabelled_names = [name for name in tracks_by_name if name not in labels_by_name]
    if unlabelled_names or not tracks_by_name:
        names = ", ".join(unlabelled_names[:3]) or "no text"
        raise ValueError(
            f"{tracks} has {names}, for which {truth} has no labels: give both files the same name"
        )
    frames: list[ScoredFrame] = []
    problems: Problems = {}
    late_frames = 0
    for sequence, (name, path) in enumerate(tracks_by_name.items()):
        labels = read_label_text(labels_by_name[name])
        file = read_track_file(path)
        for kind, number in file.problems.items():
            add_problem(problems, kind, number)
        late_frames += sum(frame.number > max(labels, default=-1) for frame in file.frames)
        wedge = _find_wedge(labels_by_name[name])
        sequence_frames = _pair_sequence(file, labels, wedge, rate_hz)
        for frame in sequence_frames[:count]:
            frames.append(_shift_ids(frame, sequence * ID_STEP))
    check_near(str(tracks), frames)
    unscored_names = [name for name in labels_by_name if name not in tracks_by_name]
    return LabelledTracks(frames, problems=problems, unscored=unscored_names, late=late_frames)


def read_label_text(path: Path) -> dict[int, LabelFrame]:
    """Read the labels of each frame of a sequence, by its number.

    Raises ValueError that names the file, OSError if it is missing."""
    frames = {}
    with name_damage(path, "list of labels"):
        for number, rows in sorted(read_track_rows(path).items()):
            frames[number] = _parse_frame(rows)
    return frames


def _parse_frame(rows: LabelRows) -> LabelFrame:
    """Parse the labels of one frame: objects with an id, and rectangles without labels.

    Objects that are truncated or hidden too much, or are of `UNCOUNTED_KINDS`, are not to be
    found: they are not `counted`. rows: rows of a label file, with boxes in the camera's frame."""
    is_ignored = np.array([kind == DONT_CARE for kind in rows.kinds], np.bool_)
    placed_rows = place_rows(rows, BODY_SE3_CAMERA, problems={})  # objects of our classes
    has_id = placed_rows.ids >= 0
    ids = placed_rows.ids[has_id]
    object_rows = placed_rows.rows[has_id]
    instant = Instant(  # checks the boxes; its time is not used
        np.nan,
        boxes=placed_rows.boxes[has_id],
        labels=placed_rows.labels[has_id],
        scores=placed_rows.scores[has_id],
        ids=ids,
    )
    kinds = [rows.kinds[row].lower() for row in object_rows.tolist()]
    is_uncounted_kind = np.array([kind in UNCOUNTED_KINDS for kind in kinds], np.bool_)
    truncation = rows.values[object_rows, _TRUNCATION]
    occlusion = rows.values[object_rows, _OCCLUSION]
    is_clear = (truncation <= MAX_TRUNCATION) & (occlusion <= MAX_OCCLUSION)
    return LabelFrame(
        objects=Objects(instant.boxes, instant.labels, ids),
        counted=is_clear & ~is_uncounted_kind,
        ignored=rows.values[is_ignored, _RECTANGLE],
    )


def _pair_sequence(
    file: TrackFile, labels: dict[int, LabelFrame], wedge: ImageWedge | None, rate_hz: float | None
) -> list[ScoredFrame]:
    """Tracks and truth of each frame of a sequence, from 0 to the last one with tracks or labels.

    labels: labels of a frame by its number; wedge: image of the labelled camera, None if unknown;
    rate_hz: frames in a second, None if unknown."""
    tracks_by_number = {frame.number: frame for frame in file.frames}
    last_number = max([*labels, *tracks_by_number], default=-1)
    numbers = range(last_number + 1)
    no_labels = LabelFrame(Objects.empty(), counted=np.zeros(0, np.bool_), ignored=np.zeros((0, 4)))
    truth = [labels.get(number, no_labels) for number in numbers]
    times = [np.nan if rate_hz is None else number / rate_hz for number in numbers]
    motions = find_motions([frame.objects for frame in truth], times)
    no_tracks = TrackFrame(
        number=0, name="", time=np.nan, tracks=Tracks.empty(), rectangles=np.zeros((0, 4))
    )
    frames = []
    for number, label_frame, motion in zip(numbers, truth, motions, strict=True):
        frame = tracks_by_number.get(number, no_tracks)
        rectangles = frame.rectangles
        if wedge is not None:
            rectangles = wedge.rectangles(frame.tracks.boxes)
        frames.append(
            ScoredFrame(
                frame.tracks,
                truth=motion,
                counted=label_frame.counted,
                outside=mark_ignored(rectangles, label_frame.ignored),
            )
        )
    return frames


def mark_ignored(
    rectangles: Float64[np.ndarray, "n 4"], regions: Float64[np.ndarray, "k 4"]
) -> Bool[np.ndarray, " n"]:
    """Mark the rectangles that are low, or mostly in one of the regions.

    Both are left, top, right, bottom (px); a rectangle of NaN is not marked."""
    left_top = rectangles[:, None, :2]
    right_bottom = rectangles[:, None, 2:]
    # width and height of the common part, (rectangles, regions, 2)
    overlap = np.minimum(right_bottom, regions[:, 2:]) - np.maximum(left_top, regions[:, :2])
    overlap_area = np.clip(overlap, 0, None).prod(axis=2)
    area = np.clip(rectangles[:, 2:] - rectangles[:, :2], 0, None).prod(axis=1)
    share = overlap_area / np.where(area > 0, area, 1.0)[:, None]
    height = rectangles[:, 3] - rectangles[:, 1]
    is_low = height <= MIN_HEIGHT_PX
    return is_low | (share > MAX_IGNORED_SHARE).any(axis=1)


def _find_wedge(labels: Path) -> ImageWedge | None:
    """Image of the labelled camera, in the axes of a body at its place; None without calibration.

    labels: text of labels; its calibration is calib/NAME.txt next to its folder."""
    calibration = labels.parent.parent / "calib" / labels.name
    if not calibration.is_file():
        return None
    width, height = IMAGE_PX
    projection = read_calibration(calibration).projection @ invert(BODY_SE3_CAMERA)
    return ImageWedge(projection, width, height)


def _list_texts(path: Path) -> dict[str, Path]:
    """Texts of a folder by their names without ending; a file alone."""
    if not path.is_dir():
        return {path.stem: path}
    return {file.stem: file for file in sorted(path.glob("*.txt"))}


def _shift_ids(frame: ScoredFrame, offset: int) -> ScoredFrame:
    """Return a frame with an offset added to the ids of its objects and tracks.

    Sequences with different offsets then share no id."""
    objects = frame.truth.objects
    truth = frame.truth._replace(objects=replace(objects, ids=objects.ids + offset))
    return frame._replace(tracks=replace(frame.tracks, ids=frame.tracks.ids + offset), truth=truth)


def describe_unscored(names: Sequence[str]) -> str:
    """Words for the sequences whose labels are not scored."""
    listed_names = ", ".join(names[:6])
    return f"{len(names)} sequences have labels, but no tracks, and are not scored: {listed_names}"
