"""Sensors whose clouds are late or early.

Boxes that are moved along their tracks fit the points of a late sensor, and of no other."""

from collections.abc import Iterator, Sequence

import numpy as np

from toolkit.arrays import Float64
from toolkit.doctor.box_fits import MIN_FITTED_BOXES, SHIFTS_S, GroundView, fits
from toolkit.doctor.findings import Finding
from toolkit.doctor.moving_boxes import MovingBoxes, find_moving
from toolkit.doctor.sensor_clouds import sensor_names

MIN_LATE_GAIN = 0.05  # least gain in mean fit for a sensor to be late
MIN_LATE_OBJECTS = 5  # least number of objects that fit better, and hardly any worse
MIN_TIMELY_OBJECTS = 3  # least number of moving objects with a fit, for a sensor to be on time
MIN_FIT_CHANGE = 0.01  # smaller changes of an object's fit do not count


def suspect_late_sensors(seen: Sequence[GroundView]) -> Iterator[Finding]:
    """Find sensors whose points show moving objects at another time than other sensors.

    seen: consecutive frames with their ground. Nothing is found without a sensor on time."""
    samples = [view.sample for view in seen]
    names = sensor_names(samples)
    movers = [find_moving(samples, k) for k in range(len(samples))]
    if len(names) < 2 or sum(len(moving.boxes) for moving in movers) < MIN_FITTED_BOXES:
        return
    # by name: time (s) by which the labels must be moved, fits before and after
    late: dict[str, tuple[float, np.ndarray, np.ndarray]] = {}
    timely = []
    for name in names:
        views = [_restrict_sensor(view, name) for view in seen]
        now = _measure_moved_fits(views, movers, 0.0)
        shifts = [sign * seconds for seconds in SHIFTS_S for sign in (1, -1)]
        shifted = {shift_s: _measure_moved_fits(views, movers, shift_s) for shift_s in shifts}
        best = max(shifts, key=lambda shift_s: float(shifted[shift_s].mean()))
        if _fits_moved_boxes(now, shifted[best]):
            late[name] = (best, now, shifted[best])
        elif (now > 0).sum() >= MIN_TIMELY_OBJECTS:
            timely.append(name)
    for name, (shift_s, before, after) in late.items() if timely else ():
        side = "ahead of" if shift_s > 0 else "behind"
        words = f"its clouds are about {abs(shift_s):g} s {side} the labels and {', '.join(timely)}"
        share = f"{before.mean():.0%} as they are, {after.mean():.0%} with that undone"
        evidence = f"mean fit of {len(before)} moving objects to its points: {share}"
        yield Finding(
            "warning",
            f"sensor {name}",
            words,
            evidence,
            "pair clouds by their times, or move its points",
        )


def _fits_moved_boxes(
    before: Float64[np.ndarray, " tracks"], after: Float64[np.ndarray, " tracks"]
) -> bool:
    """Return True if nearly all moving objects fit better with their boxes moved.

    before, after: mean fit of each object's boxes as they are, and moved."""
    changes = (after - before)[(before > 0) | (after > 0)]  # objects without a fit do not count
    improved_count = int((changes > MIN_FIT_CHANGE).sum())
    spoilt_count = int((changes < -MIN_FIT_CHANGE).sum())
    return (
        improved_count >= MIN_LATE_OBJECTS
        and spoilt_count <= 0.1 * improved_count
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
    moved_boxes = []
    for moving in movers:
        # x and y change, the other five columns do not
        path = np.column_stack([shift_s * moving.velocities, np.zeros((len(moving.boxes), 5))])
        moved_boxes.append(moving.boxes + path)
    ids = np.concatenate([moving.ids for moving in movers if len(moving.ids)])
    tracks, track_of_box = np.unique(ids, return_inverse=True)
    fit_sums = np.bincount(track_of_box, fits(views, moved_boxes))
    return fit_sums / np.bincount(track_of_box, minlength=len(tracks))


def _restrict_sensor(seen: GroundView, name: str) -> GroundView:
    """Return a frame with only one sensor's points above the ground. name: the sensor's."""
    points = [cloud.in_world() for cloud in seen.sample.clouds if cloud.name == name]
    sensor_points = np.concatenate([np.zeros((0, 3)), *points])
    return GroundView(seen.sample, seen.above_ground(sensor_points), seen.ground)
