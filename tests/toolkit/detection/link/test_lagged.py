"""What the centre has when messages are late, lost, rare or repeated."""

import numpy as np
import pytest

from toolkit.detection.link.channel import LinkChannel
from toolkit.detection.link.lagged import lagged_frames
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSORS = tuple(Sensor(name, DepthCamera(width=4, height=4), np.eye(4)) for name in "ab")


def recording(frames=12, apart=0.1, anew=()):
    """Every image holds 1 + the number of its frame; track 7 goes on but where traffic begins anew."""
    made, track = [], 7
    for k in range(frames):
        track += k in anew
        images = tuple(np.full((2, 2), 1.0 + k, np.float32) for _ in SENSORS)
        objects = Objects(np.array([[k, 0, 1, 4, 2, 1.5, 0.0]]), np.array([0]), np.array([track]))
        made.append(Frame(SENSORS, images, objects, apart * k, k))
    return made


def shown(channels, frames=None, **options):
    """The frame that each sensor's measurement is of, instant after instant; -1 for none."""
    lagged = list(lagged_frames(frames or recording(), channels, noise_seed=None, **options))
    return [[int(image[0, 0]) - 1 for image in each.frame.measurements] for each in lagged], lagged


def test_without_delay_it_is_now():
    which, lagged = shown(LinkChannel())
    assert which == [[k, k] for k in range(12)]
    assert [each.ages.tolist() for each in lagged] == [[0, 0]] * 12
    assert lagged[5].since == pytest.approx(0.5)


def test_each_sensor_has_its_own_channel_and_the_truth_is_of_now():
    which, lagged = shown([LinkChannel(delay=0.2), LinkChannel(every=3)])
    assert which == [[max(k - 2, -1), k - k % 3] for k in range(12)]
    np.testing.assert_allclose(lagged[7].ages, [0.2, 0.1])
    assert np.isnan(lagged[1].ages[0])
    assert [each.frame.objects.boxes[0, 0] for each in lagged] == list(range(12))
    assert lagged[7].frame.time == pytest.approx(0.7)


def test_what_is_lost_leaves_the_one_before_until_it_is_stale():
    which, _ = shown([LinkChannel(loss=0.9, burst=200.0), LinkChannel()], recording(40), seed=3)
    first = [row[0] for row in which]
    kept = first.index(-1) if first[0] >= 0 else 0
    assert set(first[kept:]) <= {-1, *range(40)}
    assert [row[1] for row in which] == list(range(40))
    stale, _ = shown([LinkChannel(every=30), LinkChannel()], recording(25))
    assert [row[0] for row in stale] == [0] * 11 + [-1] * 14


def test_traffic_that_begins_anew_forgets_the_messages_before():
    which, lagged = shown(LinkChannel(delay=0.1), recording(anew=(6,)))
    assert which == [[-1, -1], *([k, k] for k in range(5)), [-1, -1], *([k, k] for k in range(6, 11))]
    assert [round(each.since, 1) for each in lagged] == [0, 0.1, 0.2, 0.3, 0.4, 0.5] * 2


def test_a_frozen_sensor_repeats_its_first_image_and_says_it_is_of_now():
    which, lagged = shown(LinkChannel(), frozen=(1,))
    assert which == [[k, 0] for k in range(12)]
    assert lagged[9].ages.tolist() == [0, 0]


def test_frames_far_apart_cannot_be_late_but_can_be_as_they_are():
    far = recording(apart=5.0)
    assert shown(LinkChannel(), far)[0] == [[k, k] for k in range(12)]
    with pytest.raises(ValueError, match="frames 5 s apart cannot show"):
        shown(LinkChannel(delay=0.1), far)
    assert len(shown(LinkChannel(), frames=recording(), seed=1)[0]) == 12
    assert len(list(lagged_frames(recording(), LinkChannel(), frames=3))) == 3


class Lossy:
    """A line that loses some messages, by their numbers."""

    def __init__(self, lost):
        self.lost, self.sent, self.channel = lost, -1, LinkChannel(delay=1e-9)

    def arrival(self, time):
        self.sent += 1
        return np.inf if self.sent in self.lost else time


@pytest.mark.parametrize(
    ("needed", "expected"),
    [
        (None, [0, 1, 1, 3, 4, 4, 6, 7, 8, 9, 9, 11]),
        (ForegroundDifferences(key_every=5).needed, [0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]),
        (ForegroundDifferences(key_every=5, refers_to="key").needed, [0, 1, 1, 3, 4, 4, 4, 4, 4, 4, 4, 4]),
        (ForegroundDifferences(key_every=3).needed, [0, 1, 1, 3, 4, 4, 6, 7, 8, 9, 9, 9]),
    ],
)
def test_what_was_lost_takes_with_it_what_cannot_be_read_without(needed, expected, monkeypatch):
    monkeypatch.setattr("toolkit.detection.link.lagged.Line", lambda channel, seed: Lossy({2, 5, 10}))
    which, lagged = shown(LinkChannel(), needed=needed)
    assert [row[0] for row in which] == expected
    assert [int(each.sent.measurements[0][0, 0]) - 1 for each in lagged] == list(range(12))


def test_a_frozen_sensor_sends_what_it_repeats():
    lagged = list(lagged_frames(recording(), LinkChannel(delay=0.2), noise_seed=None, frozen=(1,)))
    assert [[int(image[0, 0]) - 1 for image in each.sent.measurements] for each in lagged] == [
        [k, 0] for k in range(12)
    ]
