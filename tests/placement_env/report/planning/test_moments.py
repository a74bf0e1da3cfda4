"""Frames for pictures: hits, misses and false alarms, and clouds that are thinned."""

import numpy as np

from placement_env.report.planning.moments import moments, thinned


def test_a_moment_says_what_was_hit_and_what_does_not_count(street):
    shots = moments(street.detected, (0, 2), count=3, points=10)
    assert len(shots) == 3
    shot = shots[0]
    assert shot.truth_hit.tolist() == [True, True, False, True, False]
    assert shot.truth_ignored.tolist() == [False, False, False, False, True]  # a walker
    places = shot.detections.boxes[:, :2].tolist()
    assert len(places) == 4
    assert dict(zip(map(tuple, places), shot.detection_hit.tolist(), strict=True))[(-14.0, -14.0)] is False
    assert shot.detection_hit.sum() == 3
    assert not shot.detection_ignored.any()
    assert [len(cloud) for cloud in shot.clouds] == [10, 10]


def test_no_more_frames_than_there_are(street):
    assert len(moments(street.detected, (0,), count=50)) == 8


def test_the_busiest_frames_are_taken(street, monkeypatch):
    counts = [1, 0, 2, 4, 4, 1, 0, 3]
    monkeypatch.setattr(street.detected, "scored", lambda k: np.arange(5) < counts[k])
    (shot,), taken = moments(street.detected, (0,), count=1), []

    def noted(detected, chosen, k, *_):
        taken.append(k)
        return shot

    monkeypatch.setattr("placement_env.report.planning.moments._moment", noted)
    moments(street.detected, (0,), count=2)
    assert taken == [3, 4]


def test_thinned_clouds_are_the_same_again_and_in_order():
    cloud = np.arange(300, dtype=np.float32).reshape(100, 3)
    few = thinned(cloud, 20, [0, 1])
    assert few.shape == (20, 3)
    assert np.array_equal(few, thinned(cloud, 20, [0, 1]))
    assert (np.diff(few[:, 0]) > 0).all()
    assert thinned(cloud, 100, [0]) is cloud
