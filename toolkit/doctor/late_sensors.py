"""Sensors whose clouds are late or early.

Boxes that are moved along their tracks fit the points of a late sensor, and of no other."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, SHIFTS_S, GroundView, measure_view_fits
from toolkit.doctor.findings import Finding
from toolkit.doctor.moving_boxes import MovingBoxes, find_moving
from toolkit.doctor.sensor_clouds import sensor_names

MIN_LATE_GAIN = 0.05  # least gain in mean fit for a sensor to be late
MIN_LATE_OBJECTS = 5  # least number of objects that fit better, and hardly any worse
MIN_TIMELY_OBJECTS = 3  # least number of moving objects with a fit, for a sensor to be on time
MIN_FIT_CHANGE = 0.01  # smaller changes of an object's fit do not count


class _TimeShift(NamedTuple):
    """Time by which labels must be moved to fit one sensor's points.

    Attributes:
        seconds: the time (s), negative if labels must be moved back.
        fits_before: mean fit of each moving object's boxes as they are.
        fits_after: the same with the boxes moved."""

    seconds: float
    fits_before: Float64[np.ndarray, " tracks"]
    fits_after: Float64[np.ndarray, " tracks"]


def suspect_late_sensors(views: Sequence[GroundView]) -> Iterator[Finding]:
    """Find sensors whose points show moving objects at another time than other sensors.

    views: consecutive frames with their ground. Nothing is found without a sensor on time."""
    samples = [view.sample for view in views]
    names = sensor_names(samples)
    movers = [find_moving(samples, k) for k in range(len(samples))]
    if len(names) < 2 or sum(len(moving.boxes) for moving in movers) < MIN_FITTED_BOXES:
        return
    shifts_s = [sign * seconds for seconds in SHIFTS_S for sign in (1, -1)]
    time_shifts: dict[str, _TimeShift] = {}  # by name of the late sensor
    timely_names = []  # sensors on time
    for name in names:
        sensor_views = [_restrict_sensor(view, name) for view in views]
        current_fits = _measure_moved_fits(sensor_views, movers, 0.0)
        shifted_fits = [_measure_moved_fits(sensor_views, movers, shift_s) for shift_s in shifts_s]
        best = max(range(len(shifts_s)), key=lambda i: float(shifted_fits[i].mean()))
        if _fits_moved_boxes(current_fits, shifted_fits[best]):
            time_shifts[name] = _TimeShift(
                seconds=shifts_s[best], fits_before=current_fits, fits_after=shifted_fits[best]
            )
        elif (current_fits > 0).sum() >= MIN_TIMELY_OBJECTS:
            timely_names.append(name)
    if not timely_names:
        return
    for name, (shift_s, fits_before, fits_after) in time_shifts.items():
        side = "ahead of" if shift_s > 0 else "behind"
        words = (
            f"its clouds are about {abs(shift_s):g} s {side} the labels and "
            f"{', '.join(timely_names)}"
        )
        means = f"{fits_before.mean():.0%} as they are, {fits_after.mean():.0%} with that undone"
        evidence = f"mean fit of {len(fits_before)} moving objects to its points: {means}"
        yield Finding(
            severity="warning",
            where=f"sensor {name}",
            suspected=words,
            evidence=evidence,
            remedy="pair clouds by their times, or move its points",
        )


def _fits_moved_boxes(
    fits_before: Float64[np.ndarray, " tracks"], fits_after: Float64[np.ndarray, " tracks"]
) -> bool:
    """Return True if nearly all moving objects fit better with their boxes moved.

    The boxes were moved along their way by the time that the sensor is perhaps late.

    fits_before, fits_after: mean fit of each object's boxes as they are, and moved."""
    has_fit = (fits_before > 0) | (fits_after > 0)  # other objects do not count
    changes = (fits_after - fits_before)[has_fit]
    improved_count = int((changes > MIN_FIT_CHANGE).sum())
    spoilt_count = int((changes < -MIN_FIT_CHANGE).sum())
    return (
        improved_count >= MIN_LATE_OBJECTS
        and spoilt_count <= 0.1 * improved_count  # at most a tenth as many
        and float(changes.mean()) >= MIN_LATE_GAIN
    )


def _measure_moved_fits(
    views: Sequence[GroundView], movers: Sequence[MovingBoxes], shift_s: float
) -> Float64[np.ndarray, " tracks"]:
    """Mean fit of each moving object's boxes, moved along its track by some time.

    All frames of one object count as one, as they show the same.

    Args:
        views: frames with the points to fit.
        movers: moving boxes of each frame.
        shift_s: time (s) by which boxes are moved, backwards if negative."""
    moved_boxes = [moving.move(shift_s) for moving in movers]
    ids = np.concatenate([moving.ids for moving in movers if len(moving.ids)])  # one for each box
    # track_of_box: index, for each box, of its id in `tracks`
    tracks, track_of_box = np.unique(ids, return_inverse=True)
    fit_sums = np.bincount(track_of_box, measure_view_fits(views, moved_boxes))
    return fit_sums / np.bincount(track_of_box, minlength=len(tracks))


def _restrict_sensor(view: GroundView, name: str) -> GroundView:
    """Return a frame with only one sensor's points above the ground. name: the sensor's."""
    points = [cloud.in_world() for cloud in view.sample.clouds if cloud.name == name]
    sensor_points = np.concatenate([np.zeros((0, 3)), *points])
    return GroundView(view.sample, view.above_ground(sensor_points), view.ground)
