"""Mistakes in stored objects: each classic mistake is undone and the fits are compared."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Pose
from toolkit.doctor.moving_points import Rows, Witness, collect_clouds, share_on_boxes
from toolkit.doctor.object_mistakes import LIFTED, OBJECT_MISTAKES
from toolkit.doctor.suspicions import (
    MIN_CLEAR_GAIN,
    MIN_EXPLAINED_FIT,
    MIN_MOVING_POINTS,
    Mistake,
    Suspicion,
)
from toolkit.sensors.sensor import Sensor

# short names of the published columns; l, w and h are half extents (m), angles are in degrees
_COLUMNS = ("x", "y", "z", "pitch", "roll", "yaw", "l", "w", "h", "label")


class UndoneObjects(NamedTuple):
    """Stored objects without their suspected mistakes.

    Attributes:
        suspicions: mistakes that are undone.
        rows: published rows of each frame without them.
        fit: share of the moving points on these boxes, 0 to 1; 1 if points are too few."""

    suspicions: list[Suspicion]
    rows: list[Rows]
    fit: float


def suspect_objects(
    witnesses: Sequence[Witness],
    sensors: Sequence[Sensor],
    rows: Sequence[Rows],
    map_SE3_site: Pose,
) -> UndoneObjects:
    """Find the mistake, or pair of mistakes, in the objects whose undoing raises the fit most.

    Pairs are tried only if no single mistake explains a bad fit. Without a mistake, the rows stay
    as they are.

    Args:
        witnesses: moving pixels of all sensors and frames.
        sensors: sensors that the numbers in the witnesses refer to.
        rows: published rows of the objects of each frame.
        map_SE3_site: pose of the site in the map."""
    clouds = collect_clouds(witnesses, sensors, len(rows))
    if sum(map(len, clouds)) < MIN_MOVING_POINTS:
        return UndoneObjects(suspicions=[], rows=list(rows), fit=1.0)
    current_fit = share_on_boxes(clouds, rows, map_SE3_site)
    for attempts in (  # mistakes that are undone together
        list(combinations(OBJECT_MISTAKES + LIFTED, 1)),
        list(combinations(OBJECT_MISTAKES, 2)),
    ):
        # rows of each frame without the mistakes of each attempt, and the fit of these rows
        undone_rows = [_undo_in_frames(mistakes, rows) for mistakes in attempts]
        fits = [share_on_boxes(clouds, tables, map_SE3_site) for tables in undone_rows]
        best = int(np.argmax(fits))
        if fits[best] >= current_fit + MIN_CLEAR_GAIN and fits[best] >= MIN_EXPLAINED_FIT:
            suspicions = [
                Suspicion(
                    mistake=mistake.mistake,
                    remedy=mistake.remedy,
                    fit_before=current_fit,
                    fit_after=fits[best],
                )
                for mistake in attempts[best]
            ]
            return UndoneObjects(suspicions=suspicions, rows=undone_rows[best], fit=fits[best])
        if current_fit >= MIN_EXPLAINED_FIT:  # no pair of mistakes in boxes that fit
            break
    return UndoneObjects(suspicions=[], rows=list(rows), fit=current_fit)


def _undo_in_frames(mistakes: Sequence[Mistake], tables: Sequence[Rows]) -> list[Rows]:
    """Return the published rows of all frames without some mistakes.

    tables: published rows of each frame."""
    return [_undo_in_rows(mistakes, rows) for rows in tables]


def _undo_in_rows(mistakes: Sequence[Mistake], rows: Rows) -> Rows:
    """Return one frame's published rows without some mistakes, undone in the given order."""
    for mistake in mistakes:
        column_by_name = dict(zip(_COLUMNS, rows.T, strict=True))
        column_by_name |= mistake.undo(column_by_name)
        rows = np.column_stack([column_by_name[name] for name in _COLUMNS])
    return rows
