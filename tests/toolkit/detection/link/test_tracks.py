"""Where what was detected is by now."""

import numpy as np
import pytest

from toolkit.detection.link.channel import Tracks
from toolkit.objects import Detections


def cars(xy, scores=None, labels=None):
    xy = np.array(xy, float).reshape(-1, 2)
    boxes = np.column_stack([xy, np.tile([0.75, 4.5, 1.8, 1.5, 0.3], (len(xy), 1))])
    scores = np.full(len(xy), 0.5) if scores is None else np.array(scores)
    return Detections(boxes, scores, np.zeros(len(xy), np.int64) if labels is None else labels)


def drive(speed, noise=0.05, frames=20, seed=0):
    rng, tracks = np.random.default_rng(seed), Tracks()
    for k in range(frames):
        tracks.update(cars(np.array([[speed * 0.1 * k, 0.0]]) + rng.normal(0, noise, (1, 2))), 0.1 * k)
        assert len(tracks) == 1
    return tracks


def test_tracks_go_on_by_the_books_filter_or_stay():
    tracks = drive(10.0)
    ahead = tracks.at(1.9 + 0.3).boxes[0]
    assert ahead[0] == pytest.approx(19 + 3, abs=0.35)
    assert ahead[1] == pytest.approx(0, abs=0.35)
    np.testing.assert_array_equal(ahead[2:], [0.75, 4.5, 1.8, 1.5, 0.3])
    moved = [np.abs(drive(0.0, seed=seed).at(1.9 + 0.3).boxes[0, :2]).max() for seed in range(20)]
    assert np.mean(np.array(moved) < 0.2) >= 0.9
    tracks = drive(10.0)
    here = cars([[19.0, 0.0], [50.0, 3.0]], scores=[0.9, 0.2], labels=np.array([0, 2]))
    tracks.update(here, 2.0)
    shown = tracks.at(2.0)
    np.testing.assert_array_equal(shown.boxes, here.boxes)
    assert (shown.scores.tolist(), shown.labels.tolist()) == ([0.9, 0.2], [0, 2])
    np.testing.assert_array_equal(tracks.at(2.3).boxes[1], here.boxes[1])
    # Two measurements, by hand: the prior of the speed and the measured difference.
    tracks = Tracks()
    tracks.update(cars([[0.0, 0.0]]), 0.0)
    tracks.update(cars([[1.0, 0.0]]), 0.1)
    p, v, q = 0.15**2, 8.0**2, 3.0**2
    position = p + 0.01 * v + q * 0.1**4 / 4
    across = 0.1 * v + q * 0.1**3 / 2
    assert tracks._state[0, 2] == pytest.approx(across / (position + p))
    assert tracks._state[0, 0] == pytest.approx(position / (position + p))
    assert tracks._covariance[0, 2, 2] == pytest.approx(v + q * 0.01 - across**2 / (position + p))
    np.testing.assert_allclose(tracks._covariance[0, 1::2, 1::2], tracks._covariance[0, ::2, ::2])


def test_the_nearest_is_joined_once_in_order():
    tracks = Tracks()
    tracks.update(cars([[0, 0], [2, 0], [1, 0]], labels=np.array([0, 0, 1])), 0.0)
    tracks.update(cars([[2.4, 0], [0.4, 0], [1.4, 0]], labels=np.array([0, 0, 1])), 0.1)
    assert len(tracks) == 3
    assert tracks._rows.tolist() == [1, 0, 2]
    tracks.update(cars([[30, 0]]), 0.2)
    assert len(tracks) == 4
    for apart, step, tracks_then in ((3.0, 0.1, 1), (3.2, 0.1, 2), (7.9, 0.5, 1), (8.1, 0.5, 2)):
        tracks = Tracks()
        tracks.update(cars([[0.0, 0.0]]), 0.0)
        tracks.update(cars([[apart, 0.0]]), step)
        assert len(tracks) == tracks_then, apart
    tracks = drive(10.0)
    before = tracks._state.copy(), tracks._covariance.copy()
    tracks.update(cars([[19.1, 0.0]]), 0.1 * 19)
    np.testing.assert_array_equal(tracks._state, before[0])
    np.testing.assert_array_equal(tracks._covariance, before[1])
    assert tracks.at(0.1 * 19).boxes[0, 0] == 19.1
    tracks = Tracks()
    tracks.update(cars([[0, 0]]), 0.0)
    for k in range(1, 6):
        tracks.update(cars([[40, 0]]), 0.25 * k)
        assert len(tracks) == (2 if k < 5 else 1)
    assert tracks.at(1.25).boxes[0, 0] == 40
    tracks.update(cars([]), 1.5)
    assert len(tracks.at(1.5)) == 0
    tracks = drive(1.0)
    with pytest.raises(ValueError, match=r"got 1\.0 s after 1\.9"):
        tracks.update(cars([[0, 0]]), 1.0)


@pytest.mark.parametrize(
    ("column", "value", "time"),
    [(0, np.nan, 2.0), (6, np.inf, 2.0), (3, 0.0, 2.0), (5, -1.5, 2.0), (0, 1.0, np.nan), (0, 1.0, np.inf)],
)
def test_boxes_and_times_that_are_none_are_refused(column, value, time):
    tracks = drive(10.0)
    before, wrong = tracks.at(2.0), cars([[19.0, 0.0]])
    wrong.boxes[0, column] = value
    with pytest.raises(ValueError, match=r"finite|positive|order of time"):
        tracks.update(wrong, time)
    with pytest.raises(ValueError, match=r"finite|positive|order of time"):
        Tracks().update(wrong, time)
    np.testing.assert_array_equal(tracks.at(2.0).boxes, before.boxes)


def test_tracks_join_their_label_and_move_at_a_sure_speed():
    tracks = Tracks()
    tracks.update(cars([[0, 0], [0.9, 0]], labels=np.array([0, 1])), 0.0)
    tracks.update(cars([[0.8, 0]], labels=np.array([0])), 0.1)
    assert tracks._rows.tolist() == [0]
    assert tracks._state[1, 0] == 0.9
    tracks._state[0, 2:] = 3.0, 4.0  # a speed of 5 m/s, sure below a deviation of 2.5 m/s
    for across, along, moved in ((0.1, 6.1, 0.3), (6.1, 0.1, 0.3), (0.1, 6.2, 0.0)):
        tracks._covariance[0, [2, 3], [2, 3]] = across, along
        assert tracks.at(0.2).boxes[0, 0] == pytest.approx(0.8 + moved)
        assert tracks.at(0.2).boxes[0, 1] == pytest.approx(4 / 3 * moved)


def test_tracks_and_detections_pair_one_to_one():
    for before, now, rows in (
        ([[0, 0]], [[0.5, 0], [0.2, 0]], [1, 0]),
        *(([[0.9, 0], [0, 0]], [[0.3, 0]], [1]), ([[0, 0], [0.9, 0]], [[0.3, 0]], [0])),
    ):
        tracks = Tracks()
        tracks.update(cars(before), 0.0)
        tracks.update(cars(now), 0.1)
        assert tracks._rows.tolist() == rows
        assert len(tracks) == 2


def test_who_stands_stays_beside_one_that_surely_drives():
    rng, tracks = np.random.default_rng(0), Tracks()
    for k in range(10):
        places = np.array([[1.0 * k, 0.0], [0.0, 30.0]]) + rng.normal(0, 0.02, (2, 2))
        boxes = np.column_stack([places, np.tile([0.8, 4.4, 1.8, 1.6, 0.0], (2, 1))])
        tracks.update(Detections(boxes, np.ones(2), np.zeros(2, int)), 0.1 * k)
    moved = tracks.at(1.9).boxes[:, :2] - boxes[:, :2]
    assert moved[0] == pytest.approx([10.0, 0.0], abs=1.0)
    assert moved[1].tolist() == [0.0, 0.0]


def test_before_any_detection_there_is_none_at_any_time():
    assert len(Tracks().at(1.0)) == 0
