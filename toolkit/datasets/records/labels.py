"""Labels as they stand in files made `Objects`: what cannot be an object is left out, and counted by kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np

from toolkit.arrays import Int64, Shaped
from toolkit.datasets.published_layout import FARTHEST_OBJECT, LARGEST_EXTENT
from toolkit.datasets.sample import OtherObjects
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Objects

FULL_TURN = 2 * np.pi + 0.01  # rad, which no file in radians goes beyond
SAME = 1e-3  # m and rad in which two boxes may differ and yet be one label given twice

NOT_FINITE = "labels with NaN or infinite numbers"
NO_SIZE = "boxes of no size"
TOO_LARGE = "boxes too large or too far away to be"
OTHER_KINDS = "labels of other kinds than ours"
DOUBLED = "doubled labels"
FULL_TURNS = "yaws beyond a full turn"

_NAMES = {  # what sets call our classes, in small letters
    VEHICLE: """car van vehicle passengercar suv pickup taxi police emergency_vehicle regular_vehicle vehicle.car
        vehicle.emergency.police""",
    HEAVY: """heavy truck bus tram trailer minibus large_truck construction_truck large_vehicle box_truck truck_cab
        school_bus articulated_bus vehicular_trailer railed_vehicle vehicle.truck vehicle.bus.rigid vehicle.bus.bendy
        vehicle.trailer vehicle.construction vehicle.emergency.ambulance""",
    CYCLIST: """cyclist bicycle bike bicyclist bicyclerider motorcycle motorcyclist motorcyclerider tricycle tricyclist
        scooter scooterrider wheeled_rider vehicle.bicycle vehicle.motorcycle""",
    PEDESTRIAN: """pedestrian person person_sitting walker official_signaler human.pedestrian.adult
        human.pedestrian.child human.pedestrian.construction_worker human.pedestrian.police_officer""",
}
CATEGORIES = {name: label for label, names in _NAMES.items() for name in names.split()}


class Labelled(NamedTuple):
    """As the fields of `toolkit.datasets.sample.Sample`: objects, the set's names of them, its own counts of their
    points where it has some, and what it labels beside our classes."""

    objects: Objects
    categories: tuple[str, ...]
    counts: Int64[np.ndarray, " n"] | None
    others: OtherObjects


def labelled(
    boxes: Shaped[np.ndarray, "n 7"],
    categories: Sequence[str],
    ids: Sequence[Any] | None,
    problems: dict[str, int],
    counts: Sequence[int] | Int64[np.ndarray, " n"] | None = None,
) -> Labelled:
    """Rows of labels, world frame, as objects; what is left out is added to `problems`.

    ids: of tracks, whatever they are; their places when None. counts: the set's own, below 0 where nobody counted.
    """
    boxes = np.asarray(boxes, np.float64).reshape(-1, 7)
    names = [str(name).strip().lower().replace(" ", "") for name in categories]
    classes = np.array([CATEGORIES.get(name, -1) for name in names], np.int64)
    finite = np.isfinite(boxes).all(axis=1)
    sized = (boxes[:, 3:6] > 0).all(axis=1)
    there = ((boxes[:, 3:6] <= 2 * LARGEST_EXTENT) & (np.abs(boxes[:, :3]) <= FARTHEST_OBJECT)).all(axis=1)
    keep = np.ones(len(boxes), bool)
    for problem, sound in ((NOT_FINITE, finite), (NO_SIZE, sized), (TOO_LARGE, there)):
        add_problem(problems, problem, int((keep & ~sound).sum()))
        keep &= sound
    rows = np.flatnonzero(keep)
    named = np.unique(np.array([*categories, ""], str), return_inverse=True)[1][:-1]
    first = _first_of_equals(np.column_stack([boxes[rows], named[rows]]))
    add_problem(problems, DOUBLED, len(rows) - len(first))
    rows = rows[first]
    yaws = np.where(finite, boxes[:, 6], 0.0)
    boxes = np.column_stack([boxes[:, :6], np.arctan2(np.sin(yaws), np.cos(yaws))])
    own = None if counts is None else np.asarray(counts, np.int64)
    count_full_turns(yaws[rows], problems)
    others = rows[classes[rows] < 0]
    add_problem(problems, OTHER_KINDS, len(others))
    rows = rows[classes[rows] >= 0]
    tracks = np.array([track_number(k if ids is None else ids[k]) for k in rows], np.int64)
    return Labelled(
        Objects(boxes[rows], classes[rows], tracks),
        tuple(str(categories[k]) for k in rows),
        _known(own, rows),
        OtherObjects(boxes[others], tuple(str(categories[k]) for k in others), _known(own, others)),
    )


def no_labels() -> Labelled:
    """The labels of a sample that has none."""
    return labelled(np.zeros((0, 7)), [], None, {})


def _known(counts: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    return None if counts is None or (counts[rows] < 0).any() else counts[rows]


def add_problem(problems: dict[str, int], kind: str, number: int) -> None:
    """Add to the problems of a kind, none where there are none."""
    if number:
        problems[kind] = problems.get(kind, 0) + number


def add_problems(total: dict[str, int], problems: Mapping[str, int]) -> None:
    """Add those of one sample to those of all."""
    for kind, number in problems.items():
        add_problem(total, kind, number)


def count_full_turns(yaws: Shaped[np.ndarray, " n"], problems: dict[str, int]) -> None:
    """Add to the problems what no file in radians has; for layouts whose yaws are turned into another frame.

    >>> problems = {}
    >>> count_full_turns(np.array([3.0, -90.0, 7.0, np.nan]), problems)
    >>> problems
    {'yaws beyond a full turn': 2}
    """
    add_problem(problems, FULL_TURNS, int((np.abs(yaws) > FULL_TURN).sum()))


def track_number(name: Any) -> int:
    """A track id as a number: itself where it is one, else of its text, the same in every frame.

    >>> track_number("17"), track_number("b1d0") == track_number("b1d0")
    (17, True)
    """
    text = str(name).strip()
    if text.removeprefix("-").isascii() and text.removeprefix("-").isdigit() and len(text) < 18:
        return int(text)
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 1


def _first_of_equals(rows: np.ndarray) -> np.ndarray:
    """The rows, in order, that differ from every earlier one."""
    kept: list[int] = []
    for k, row in enumerate(rows):
        if not kept or (np.abs(rows[kept] - row) > SAME).any(axis=1).all():
            kept.append(k)
    return np.array(kept, np.int64)
