"""What does not count when tracks are scored."""

import numpy as np

from toolkit.objects import HEAVY, Objects
from toolkit.tracking.frame_overlap import measure_overlap
from toolkit.tracking.tracks import Tracks

CAR = np.array([0.0, 0, 0.75, 4.5, 1.9, 1.5, 0.0])


def boxes(*places):
    rows = np.tile(CAR, (len(places), 1))
    rows[:, 0] = places
    return rows


def test_tracks_on_what_is_not_to_be_found_are_left_out():
    objects = Objects(boxes(0, 20, 40), ids=np.array([4, 5, 6]))
    tracks = Tracks(boxes(0, 20, 60), np.ones(3), ids=np.array([1, 2, 3]))
    counted = np.array([True, False, True])
    found = measure_overlap(tracks, objects, 0, counted=counted).scored(0.5)
    assert found.pairs.truth.tolist() == [4, 6]
    assert found.pairs.tracks.tolist() == [1, 3]
    assert found.track_rows.tolist() == [0, 2]


def test_tracks_outside_may_match_but_are_no_false_alarms():
    objects = Objects(boxes(0))
    tracks = Tracks(boxes(0.1, 60), np.ones(2))
    found = measure_overlap(tracks, objects, 0, outside=np.ones(2, bool)).scored(0.5)
    assert found.pairs.tracks.tolist() == [0]


def test_a_vehicle_on_a_truck_is_no_false_alarm():
    objects = Objects(boxes(0, 20), np.array([0, HEAVY]))
    tracks = Tracks(boxes(0, 20), np.ones(2))
    found = measure_overlap(tracks, objects, 0).scored(0.5)
    assert (len(found.pairs.truth), len(found.pairs.tracks)) == (1, 1)
    assert len(measure_overlap(tracks, objects, HEAVY).scored(0.5).pairs.truth) == 1


def test_nothing_to_leave_out_stays_as_it_is():
    overlap = measure_overlap(Tracks(boxes(0), np.ones(1)), Objects(boxes(0)), 0)
    assert overlap.scored(0.5) is overlap
