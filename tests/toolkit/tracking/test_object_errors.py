"""Errors of speed and heading, and times to the first detection, by hand."""

import numpy as np
import pytest

from toolkit.objects import Objects
from toolkit.tracking.frame_overlap import measure_overlap
from toolkit.tracking.object_errors import TruthMotion, collect_ways, measure_errors
from toolkit.tracking.scores import match_clear
from toolkit.tracking.tracks import Tracks

CAR = np.array([0.0, 0, 0.75, 4.5, 1.9, 1.5, 0.0])


def measure(frames, figures=measure_errors):
    """frames: places of objects by id, places of tracks by id, at 10 Hz; cars drive 2 m/s."""
    overlaps, tracks, truths = [], [], []
    for number, (true_places, places) in enumerate(frames):
        objects = Objects(boxes(true_places), ids=np.array([*true_places], int))
        found = Tracks(
            boxes(places, 0.1),
            np.ones(len(places)),
            ids=np.array([*places], int),
            velocities=np.tile([0.0, 2.5, 0], (len(places), 1)),
        )
        velocities = np.tile([2.0, 0, 0], (len(objects), 1))
        truths.append(TruthMotion(objects, velocities, 0.1 * number, number == 0))
        tracks.append(found)
        overlaps.append(measure_overlap(found, objects, 0))
    matches = match_clear([overlap.pairs for overlap in overlaps]).matches
    return figures(overlaps, matches, tracks, truths)


def boxes(places, yaw=0.0):
    rows = np.tile(CAR, (len(places), 1))
    rows[:, 0] = [*places.values()]
    rows[:, 6] = yaw
    return rows


def test_errors_of_matches():
    found = measure([({1: 0.0}, {7: 0.0})] * 3)
    assert found.speed_error_mps == pytest.approx(0.5)
    assert found.heading_error_deg == pytest.approx(np.rad2deg(0.1))
    assert found.entering == 0
    assert np.isnan([found.first_detection_s, found.never_found]).all()


def test_waits_of_those_that_come_in():
    frames = [
        ({1: 0.0}, {}),
        ({1: 0.0, 2: 20.0}, {}),
        ({1: 0.0, 2: 20.0, 3: 40.0}, {8: 20.0}),
        ({1: 0.0, 2: 20.0, 3: 40.0}, {8: 20.0}),
    ]
    found = measure(frames)
    assert found.entering == 2
    assert found.first_detection_s == pytest.approx(0.1)
    assert found.first_detection_95_s == np.inf
    assert found.never_found == 0.5


def test_ways_say_how_each_road_user_was_followed():
    frames = [
        ({1: 0.0}, {7: 0.0}),
        ({1: 0.0, 2: 20.0}, {}),
        ({1: 0.0, 2: 20.0, 3: 40.0}, {7: 0.0, 8: 20.0}),
    ]
    first, second, third = measure(frames, collect_ways)
    assert first[:4] == (1, 3, 2, False)
    assert second[:4] == (2, 2, 1, True)
    assert third[:4] == (3, 1, 0, True)
    assert [second.wait_s, third.wait_s] == [pytest.approx(0.1), np.inf]
    assert first.speed_error_mps == pytest.approx(0.5)
    assert np.isnan(third.speed_error_mps)


def test_unknown_motion_stays_unknown():
    objects = Objects(boxes({1: 0.0}))
    tracks = Tracks(boxes({1: 0.0}), np.ones(1), velocities=np.full((1, 3), np.nan))
    overlap = measure_overlap(tracks, objects, 0)
    matches = match_clear([overlap.pairs]).matches
    truth = TruthMotion(objects, np.full((1, 3), np.nan), np.nan, is_first=False)
    found = measure_errors([overlap], matches, [tracks], [truth])
    assert np.isnan([found.speed_error_mps, found.first_detection_s]).all()
    assert found.never_found == 0
