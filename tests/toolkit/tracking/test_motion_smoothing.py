"""Motions of many tracks together are those that a plain filter and smoother find one by one."""

import numpy as np
import pytest

from toolkit.tracking import motion_smoothing
from toolkit.tracking.motion_model import ACCELERATIONS_M_S2, FIRST_SPEEDS_M_S
from toolkit.tracking.motion_smoothing import MeasuredCourse, smooth_motions


def smooth_alone(course):
    """Filter and smoother of Rauch, Tung and Striebel, written out for one track."""
    count = len(course.seconds)
    rows = {frame: row for row, frame in enumerate(course.seen.tolist())}
    measure = np.eye(2, 4)
    q = ACCELERATIONS_M_S2[course.label] ** 2
    state = measure.T @ course.centres[0]
    spread = np.zeros((4, 4))
    spread[:2, :2] = course.noise[0]
    spread[2:, 2:] = np.eye(2) * FIRST_SPEEDS_M_S[course.label] ** 2
    states, spreads, predicted = [state], [spread], [(state, spread, np.eye(4))]
    for k in range(1, count):
        dt = course.seconds[k] - course.seconds[k - 1]
        step = np.block([[np.eye(2), dt * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
        push = np.vstack([dt**2 / 2 * np.eye(2), dt * np.eye(2)])
        state = step @ state
        spread = step @ spread @ step.T + q * push @ push.T
        predicted.append((state, spread, step))
        if k in rows:
            innovation = course.centres[rows[k]] - measure @ state
            total = measure @ spread @ measure.T + course.noise[rows[k]]
            gain = spread @ measure.T @ np.linalg.inv(total)
            state = state + gain @ innovation
            spread = (np.eye(4) - gain @ measure) @ spread
        states.append(state)
        spreads.append(spread)
    for k in range(count - 2, -1, -1):
        ahead, ahead_spread, step = predicted[k + 1]
        gain = spreads[k] @ step.T @ np.linalg.inv(ahead_spread)
        states[k] = states[k] + gain @ (states[k + 1] - ahead)
    return np.array(states)


def make_course(rng):
    count = int(rng.integers(2, 40))
    seen = np.unique(np.concatenate([[0, count - 1], rng.integers(0, count, count)]))
    turns = rng.normal(size=(len(seen), 2, 2))
    noise = turns @ turns.transpose(0, 2, 1) * 0.01 + 0.001 * np.eye(2)
    seconds = 5.0 + np.cumsum(rng.uniform(0.05, 0.3, count))
    centres = np.cumsum(rng.normal(size=(len(seen), 2)), axis=0)
    return MeasuredCourse(centres, noise, seen, seconds, int(rng.integers(0, 4)))


@pytest.mark.parametrize("rows", [40, 100_000])
def test_together_is_as_one_by_one(limits, rows):
    limits(motion_smoothing, MAX_GROUP_ROWS=rows)  # groups of few, or all
    rng = np.random.default_rng(3)
    courses = [make_course(rng) for _ in range(25)]
    for course, motion in zip(courses, smooth_motions(courses), strict=True):
        assert np.allclose(motion, smooth_alone(course), atol=1e-6)


def test_no_tracks_have_no_motions():
    assert smooth_motions([]) == []
