"""Points of a sweep moved to the time of its frame.

A sensor that turns measures for a whole interval, and sensors need not measure together. What
stands still is not changed by that. A moving road user is: its points lie along its way. So each
track of the frame before, predicted to the time of a point, claims the points in its box, which
move with its velocity to the time of the frame. Points that no moving track claims stay."""

from dataclasses import replace

import numpy as np

from toolkit.arrays import Float64, ImageVectors, Points
from toolkit.boxes import rows_in_boxes
from toolkit.frame import Frame, Image, SensorCloud, unproject
from toolkit.sensors.sensor import Sensor
from toolkit.tracking.tracks import Tracks

MIN_MOVING_M_S = 1.0  # slower tracks move less than a box's error in a sweep
MIN_APART_S = 0.005  # a car at 50 km/h moves 7 cm
BOX_MARGIN_M = 0.4  # around a track's box, but not below it: errors of box and velocity
MIN_CLAIM_M = 0.2  # above a track's underside; nothing below it moves, as it may be ground


def move_to_frame(frame: Frame, times_s: Float64[np.ndarray, " sensors"], tracks: Tracks) -> Frame:
    """Return a frame whose points on moving road users are at the frame's time.

    times_s: time of the last point of each sensor (s); tracks: tracks predicted to the frame's
    time. Points of clouds without times count as measured with the last one."""
    moving = select_moving(tracks)
    if not len(moving):
        return frame
    measurements = list(frame.measurements)
    shifts: list[ImageVectors | None] = [None] * len(frame.sensors)
    for row, measurement in enumerate(frame.measurements):
        last_age_s = float(frame.time - times_s[row])
        shift = frame.shifts[row] if frame.shifts else None
        if isinstance(measurement, SensorCloud):
            measurements[row] = _move_cloud(measurement, last_age_s, moving)
        elif last_age_s >= MIN_APART_S:
            shift = _shift_image(
                sensor=frame.sensors[row],
                image=measurement,
                shift=shift,
                age_s=last_age_s,
                moving=moving,
            )
        shifts[row] = shift
    is_shifted = any(shift is not None for shift in shifts)
    return replace(
        frame, measurements=tuple(measurements), shifts=tuple(shifts) if is_shifted else ()
    )


def select_moving(tracks: Tracks) -> Tracks:
    """Return the tracks that move."""
    return tracks[np.flatnonzero(tracks.speeds >= MIN_MOVING_M_S)]


def point_ages(cloud: SensorCloud, last_age_s: float) -> Float64[np.ndarray, " n"]:
    """Return the age of each point at the frame's time (s); last_age_s: age of the last one."""
    if cloud.time is None or not len(cloud.time):
        return np.full(len(cloud.points), last_age_s)
    return last_age_s + (cloud.time.max() - cloud.time)


def find_moves(
    points: Points, ages: Float64[np.ndarray, " n"], moving: Tracks
) -> Float64[np.ndarray, "n 3"]:
    """Return the move (m, world frame) of each point to the frame's time, 0 if no track claims it.

    points: m, world frame; ages: s at the frame's time; moving: tracks at the frame's time. Of two
    tracks that claim a point, the later row moves it."""
    moves = np.zeros((len(points), 3))
    if not len(points):
        return moves
    claims = moving.boxes.copy()
    claims[:, 3:5] += 2 * BOX_MARGIN_M
    claims[:, 5] += BOX_MARGIN_M - MIN_CLAIM_M
    claims[:, 2] += (BOX_MARGIN_M + MIN_CLAIM_M) / 2
    # boxes that hold all places of a claim since the oldest point
    ways = moving.velocities * float(ages.max())
    search = claims.copy()
    search[:, :3] -= ways / 2
    search[:, 3:5] += np.abs(ways[:, :2]).sum(axis=1)[:, None]
    for row, candidates in enumerate(rows_in_boxes(points, search)):
        candidate_moves = ages[candidates, None] * moving.velocities[row]
        moved = points[candidates] + candidate_moves
        inside = rows_in_boxes(moved, claims[row : row + 1])[0]
        moves[candidates[inside]] = candidate_moves[inside]
    return moves


def _move_cloud(cloud: SensorCloud, last_age_s: float, moving: Tracks) -> SensorCloud:
    """Return a cloud at the frame's time; last_age_s: age of its last point (s)."""
    ages = point_ages(cloud, last_age_s)
    if ages.max(initial=0.0) < MIN_APART_S:
        return cloud
    moves = find_moves(cloud.in_world(), ages, moving)
    if cloud.frame == "sensor":
        moves = moves @ cloud.world_SE3_sensor[:3, :3]
    return replace(cloud, points=(cloud.points + moves).astype(np.float32))


def _shift_image(
    sensor: Sensor, image: Image, shift: ImageVectors | None, age_s: float, moving: Tracks
) -> ImageVectors:
    """Return the shift (m, world frame) of each pixel of an image that is older than its frame.

    shift: shift that the image has already, None for none; age_s: frame's time less the image's
    (s)."""
    world_points, _ = unproject(sensor, image, shift)
    points = world_points.T.astype(np.float64)
    moves = find_moves(points, np.full(len(points), age_s), moving)
    image_moves = moves.astype(np.float32).reshape(*image.shape, 3)
    return image_moves if shift is None else shift + image_moves
