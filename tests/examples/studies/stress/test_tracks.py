"""Where what was detected is by now."""

import numpy as np
import pytest

from examples.studies.stress.tracks import Tracks
from toolkit.objects import Detections


def cars(xy, scores=None, labels=None):
    xy = np.array(xy, float).reshape(-1, 2)
    boxes = np.column_stack([xy, np.tile([0.75, 4.5, 1.8, 1.5, 0.3], (len(xy), 1))])
    scores = np.full(len(xy), 0.5) if scores is None else np.array(scores)
    return Detections(boxes, scores, np.zeros(len(xy), np.int64) if labels is None else labels)


def drive(speed, noise=0.05, frames=20, seed=0):
    rng, tracks = np.random.default_rng(seed), Tracks()
    for k in range(frames):
        tracks.update(
            cars(np.array([[speed * 0.1 * k, 0.0]]) + rng.normal(0, noise, (1, 2))), 0.1 * k
        )
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
    assert tracks.state[0, 2] == pytest.approx(across / (position + p))
    assert tracks.state[0, 0] == pytest.approx(position / (position + p))
    assert tracks.covariance[0, 2, 2] == pytest.approx(v + q * 0.01 - across**2 / (position + p))
    np.testing.assert_allclose(tracks.covariance[0, 1::2, 1::2], tracks.covariance[0, ::2, ::2])


def test_the_nearest_is_joined_once_in_order():
    tracks = Tracks()
    tracks.update(cars([[0, 0], [2, 0], [1, 0]], labels=np.array([0, 0, 1])), 0.0)
    tracks.update(cars([[2.4, 0], [0.4, 0], [1.4, 0]], labels=np.array([0, 0, 1])), 0.1)
    assert len(tracks) == 3
    assert tracks.rows.tolist() == [1, 0, 2]
    tracks.update(cars([[30, 0]]), 0.2)
    assert len(tracks) == 4
    for apart, step, tracks_then in (
        (3.0, 0.1, 1),
        (3.2, 0.1, 2),
        (7.9, 0.5, 1),
        (8.0, 0.5, 1),
        (8.1, 0.5, 2),
    ):
        tracks = Tracks()
        tracks.update(cars([[0.0, 0.0]]), 0.0)
        tracks.update(cars([[apart, 0.0]]), step)
        assert len(tracks) == tracks_then, apart
    tracks = drive(10.0)
    before = tracks.state.copy(), tracks.covariance.copy()
    tracks.update(cars([[19.1, 0.0]]), 0.1 * 19)
    np.testing.assert_array_equal(tracks.state, before[0])
    np.testing.assert_array_equal(tracks.covariance, before[1])
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
    [
        (0, np.nan, 2.0),
        (6, np.inf, 2.0),
        (3, 0.0, 2.0),
        (5, -1.5, 2.0),
        (0, 1.0, np.nan),
        (0, 1.0, np.inf),
    ],
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
    assert tracks.rows.tolist() == [0]
    assert tracks.state[1, 0] == 0.9
    tracks.state[0, 2:] = 3.0, 4.0  # a speed of 5 m/s, sure below a deviation of 2.5 m/s
    for across, along, moved in (
        (0.1, 6.1, 0.3),
        (6.1, 0.1, 0.3),
        (3.125, 3.125, 0.0),
        (0.1, 6.2, 0.0),
    ):
        tracks.covariance[0, [2, 3], [2, 3]] = across, along
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
        assert tracks.rows.tolist() == rows
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


class SlowTracks:
    """The same by the book, one track and one axis after the other."""

    def __init__(self):
        self.tracks, self.rows, self.time = [], [], 0.0

    def update(self, detections, time):
        step, again = (
            (time - self.time if self.tracks else 0.0),
            bool(self.tracks) and time == self.time,
        )
        move, push = np.array([[1, step], [0, 1]]), 3.0 * np.array([step**2 / 2, step])
        for track in self.tracks:
            track["state"] = [move @ axis for axis in track["state"]]
            track["covariance"] = move @ track["covariance"] @ move.T + np.outer(push, push)
        places, labels = detections.boxes[:, :2], detections.labels
        pairs = []
        for d, place in enumerate(places):
            for t, track in enumerate(self.tracks):
                apart = float(np.hypot(*(place - [axis[0] for axis in track["state"]])))
                gate = min(1.0 + 2.5 * np.sqrt(track["covariance"][0, 0]), 8.0)
                if labels[d] == track["label"] and apart <= gate:
                    pairs.append((apart, d, t))
        joined = {}
        for _, d, t in sorted(pairs):
            if d not in joined and t not in joined.values():
                joined[d] = t
        for d, t in joined.items():
            track = self.tracks[t]
            track["seen"] = time
            if not again:
                before = track["covariance"]
                gain = before[:, 0] / (before[0, 0] + 0.15**2)
                track["state"] = [
                    axis + gain * (measured - axis[0])
                    for axis, measured in zip(track["state"], places[d], strict=True)
                ]
                track["covariance"] = before - np.outer(gain, before[0])
        rows = []
        for d, place in enumerate(places):
            if d not in joined:
                state, spread = [np.array([x, 0.0]) for x in place], np.diag([0.15**2, 8.0**2])
                self.tracks.append(
                    {"state": state, "covariance": spread, "label": labels[d], "seen": time}
                )
                joined[d] = len(self.tracks) - 1
            rows.append(self.tracks[joined[d]])
        self.tracks = [track for track in self.tracks if time - track["seen"] <= 1.0]
        self.rows, self.time = rows, time


@pytest.mark.parametrize("seed", range(4))
def test_many_tracks_are_those_of_a_slow_filter(seed):
    """Cars and walkers that come and go, at uneven times and now and then twice at the same."""
    rng, tracks, slow, time = np.random.default_rng(seed), Tracks(), SlowTracks(), 5.0
    speeds, starts, labels = (
        rng.normal(0, 8, (9, 2)),
        rng.uniform(-6, 6, (9, 2)),
        rng.integers(0, 2, 9),
    )
    for _ in range(40):
        seen = np.flatnonzero(rng.random(9) < 0.6)
        found = cars(
            starts[seen] + speeds[seen] * (time - 5.0) + rng.normal(0, 0.1, (len(seen), 2)),
            labels=labels[seen],
        )
        tracks.update(found, time)
        slow.update(found, time)
        states = [
            [*(axis[0] for axis in t["state"]), *(axis[1] for axis in t["state"])]
            for t in slow.tracks
        ]
        assert tracks.state == pytest.approx(np.array(states).reshape(-1, 4), abs=1e-9)
        assert tracks.covariance[:, ::2, ::2] == pytest.approx(
            np.array([t["covariance"] for t in slow.tracks]).reshape(-1, 2, 2), abs=1e-9
        )
        assert tracks.labels.tolist() == [t["label"] for t in slow.tracks]
        assert tracks.seen.tolist() == [t["seen"] for t in slow.tracks]
        after = tracks.at(time + 0.4)
        for row, track in enumerate(slow.rows):
            assert slow.tracks[tracks.rows[row]] is track
            speed = np.array([axis[1] for axis in track["state"]])
            sure = speed @ speed > 4 * 2 * track["covariance"][1, 1]
            moved = found.boxes[row, :2] + (0.4 * speed if sure else 0.0)
            assert after.boxes[row, :2] == pytest.approx(moved, abs=1e-9)
        time += float(rng.choice([0.0, 0.1, 0.1, 0.3, 1.0, 1.1]))


@pytest.mark.parametrize("count", [20, 40, 100])
def test_of_equally_near_detections_the_first_joins(count):
    """The second half of them lies half as far off."""
    tracks = Tracks()
    tracks.update(cars([[0, 0]]), 0.0)
    half = count // 2
    tracks.update(cars([[0.5, 0.0]] * half + [[0.25, 0.0]] * half), 0.1)
    assert tracks.rows.tolist() == [*range(1, half + 1), 0, *range(half + 1, count)]


def test_a_detection_at_time_0_begins_a_track_and_moves_it_at_once():
    tracks = Tracks()
    for time in (0.0, 0.0):
        tracks.update(cars([[0.3, 0.0]]), time)
        assert (len(tracks), tracks.state[0].tolist()) == (1, [0.3, 0.0, 0.0, 0.0])
