"""Labels of a frame: boxes, categories and tracks, checked as they are read."""

from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64, Int64, Mask, Shaped
from toolkit.class_names import CATEGORIES
from toolkit.datasets.problem_kinds import (
    DOUBLED,
    FULL_TURNS,
    NO_SIZE,
    NOT_FINITE,
    OTHER_KINDS,
    TOO_LARGE,
    Problems,
    add_problem,
)
from toolkit.frame import OtherObjects
from toolkit.geometry import MAX_COORDINATE_M
from toolkit.objects import LABELS, Objects

FULL_TURN_RAD = 2 * np.pi + 0.01  # no file in radians exceeds it
MAX_DOUBLED_GAP = 1e-3  # m and rad; two boxes that differ by less are one label given twice
MIN_BOX_SIDE_M = 0.01  # no side of a road user is shorter
MAX_BOX_SIDE_M = 100.0  # no side of a road user is longer
COMMON_NAMES = {  # names of our classes in other layouts
    "vehicle": "Car",
    "cyclist": "Cyclist",
    "pedestrian": "Pedestrian",
    "heavy": "Truck",
}
MAX_TRACK = 10**16  # below it a number's text is short enough to stay a number


class FrameLabels(NamedTuple):
    """Labels of one frame as `toolkit.frame.Frame` holds them.

    Attributes:
        objects: labels of our classes.
        categories: name of each one's class as the data set has it.
        counts: the data set's number of points on each, None if one is unknown.
        others: objects of other classes.
    """

    objects: Objects
    categories: tuple[str, ...]
    counts: Int64[np.ndarray, " n"] | None
    others: OtherObjects


def make_labels(
    boxes: Shaped[np.ndarray, "n 7"],
    categories: Sequence[str],
    ids: Sequence[object] | None,
    problems: Problems,
    counts: Sequence[int] | Int64[np.ndarray, " n"] | None = None,
) -> FrameLabels:
    """Turn labels as a data set gives them into objects of our classes and others.

    Args:
        boxes: box of each label, world frame, in m and rad.
        categories: name of its class in the data set.
        ids: its track id of any kind; None for row numbers.
        problems: kinds and numbers of labels left out are added to it.
        counts: the data set's number of points on it, below 0 if unknown."""
    boxes = np.asarray(boxes, np.float64).reshape(-1, 7)
    names = [str(name).strip().lower().replace(" ", "") for name in categories]
    classes = np.array([CATEGORIES.get(name, -1) for name in names], np.int64)
    rows = np.flatnonzero(_mark_possible(boxes, problems))
    doubled_rows = _find_doubled(boxes, categories, rows)
    add_problem(problems, DOUBLED, len(doubled_rows))
    rows = np.setdiff1d(rows, doubled_rows)
    yaws = np.where(np.isfinite(boxes).all(axis=1), boxes[:, 6], 0.0)
    boxes = np.column_stack([boxes[:, :6], np.arctan2(np.sin(yaws), np.cos(yaws))])
    count_full_turns(yaws[rows], problems)
    other_rows = rows[classes[rows] < 0]
    rows = rows[classes[rows] >= 0]
    add_problem(problems, OTHER_KINDS, len(other_rows))
    tracks = np.array(
        [track_number(row if ids is None else ids[row]) for row in rows.tolist()], np.int64
    )
    object_counts = None
    other_counts = None
    if counts is not None:
        row_counts = np.asarray(counts, np.int64)
        object_counts = _known_counts(row_counts[rows])
        other_counts = _known_counts(row_counts[other_rows])
    other_objects = OtherObjects(
        boxes[other_rows],
        categories=tuple(str(categories[row]) for row in other_rows.tolist()),
        counts=other_counts,
    )
    return FrameLabels(
        objects=Objects(boxes[rows], labels=classes[rows], ids=tracks),
        categories=tuple(str(categories[row]) for row in rows.tolist()),
        counts=object_counts,
        others=other_objects,
    )


def _mark_possible(boxes: Float64[np.ndarray, "n 7"], problems: Problems) -> Mask:
    """Mask of the boxes that an object may have.

    The others are counted by their first problem in `problems`, which is changed in place."""
    centres, sides = boxes[:, :3], boxes[:, 3:6]
    is_sized = (sides >= MIN_BOX_SIDE_M).all(axis=1)
    is_small = (sides <= MAX_BOX_SIDE_M).all(axis=1)
    is_near = (np.abs(centres) <= MAX_COORDINATE_M).all(axis=1)
    checks = (
        (NOT_FINITE, np.isfinite(boxes).all(axis=1)),
        (NO_SIZE, is_sized),
        (TOO_LARGE, is_small & is_near),
    )
    is_kept = np.ones(len(boxes), bool)
    for problem, is_sound in checks:
        add_problem(problems, problem, int((is_kept & ~is_sound).sum()))
        is_kept &= is_sound
    return is_kept


def _find_doubled(
    boxes: Float64[np.ndarray, "n 7"], categories: Sequence[str], rows: Int64[np.ndarray, " m"]
) -> Int64[np.ndarray, " k"]:
    """Numbers of the rows that repeat the box and category of an earlier row, ascending.

    No value of two such boxes differs by more than `MAX_DOUBLED_GAP`. rows: numbers of the rows to
    compare, in order."""
    # equal numbers for equal categories, so that these can be compared like the boxes
    _, category_numbers = np.unique(np.array(categories, str), return_inverse=True)
    values = np.column_stack([boxes, category_numbers])
    x = boxes[:, 0]
    rows_by_x = rows[np.argsort(x[rows], kind="stable")]
    is_near_next = np.diff(x[rows_by_x]) <= MAX_DOUBLED_GAP
    # only rows near the row before or after them along x can be doubled
    near_rows = np.union1d(rows_by_x[:-1][is_near_next], rows_by_x[1:][is_near_next])
    unique_rows: list[int] = []  # near rows that differ from every earlier one
    for row in near_rows.tolist():
        differs = (np.abs(values[unique_rows] - values[row]) > MAX_DOUBLED_GAP).any(axis=1)
        if not unique_rows or differs.all():
            unique_rows.append(row)
    return np.setdiff1d(near_rows, unique_rows)


def _known_counts(counts: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"] | None:
    """Return counts of points, or None if any is unknown (below 0)."""
    return None if (counts < 0).any() else counts


def list_rows(objects: Objects, names: Mapping[str, str]) -> list[tuple[list[float], str, int]]:
    """Box, class name and track id of each object, for a file.

    names: name in the file for each of `LABELS`."""
    rows = zip(objects.boxes.tolist(), objects.labels.tolist(), objects.ids.tolist(), strict=True)
    return [(box, names[LABELS[label]], track) for box, label, track in rows]


def no_labels() -> FrameLabels:
    """Return the labels of a frame that has no objects."""
    return make_labels(np.zeros((0, 7)), categories=[], ids=None, problems={})


def count_full_turns(yaws: Shaped[np.ndarray, " n"], problems: Problems) -> None:
    """Count in `problems` the yaws beyond a full turn, which are probably degrees."""
    add_problem(problems, FULL_TURNS, int((np.abs(yaws) > FULL_TURN_RAD).sum()))


def track_number(name: object) -> int:
    """Track id as a whole number.

    An integer stays itself, also as text; any other text becomes a number of 63 bits by its hash,
    the same in every run."""
    if type(name) is int and abs(name) < MAX_TRACK:  # bool is left out
        return name
    text = str(name).strip()
    digits = text.removeprefix("-")
    if digits.isascii() and digits.isdigit() and len(text) < 18:  # fits into int64
        return int(text)
    hash_64_bits = int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big")
    return hash_64_bits >> 1
