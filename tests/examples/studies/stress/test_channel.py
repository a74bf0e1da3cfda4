"""Delays, losses and bursts as often as they are said to be."""

import math
from dataclasses import replace

import numpy as np
import pytest

from examples.differences.scheme import ForegroundDifferences
from examples.studies.stress.channel import Line, LinkChannel, delay_frames
from toolkit.frame import Frame
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.sensors.error_profiles import PAPER_ERRORS
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor


def arrivals(channel, n=4000, seed=0):
    line = Line(channel, seed)
    return np.array([line.arrival(0.1 * k) for k in range(n)]) - 0.1 * np.arange(n)


def test_channels_have_delays_and_rates():
    np.testing.assert_allclose(arrivals(LinkChannel(), 50), 0, atol=1e-12)
    late = arrivals(LinkChannel(delay=0.2, jitter=0.05))
    assert late.min() == pytest.approx(0.2)
    assert np.median(late) == pytest.approx(0.2, abs=0.003)
    assert np.quantile(late, 0.975) == pytest.approx(0.2 + 1.96 * 0.05, abs=0.01)
    assert np.isfinite(arrivals(LinkChannel(every=3), 9)).tolist() == [True, False, False] * 3
    a, b = (arrivals(LinkChannel(delay=delay, loss=0.2), 300, seed=4) for delay in (0.0, 0.3))
    np.testing.assert_array_equal(np.isinf(a), np.isinf(b))
    assert not np.array_equal(np.isinf(a), np.isinf(arrivals(LinkChannel(loss=0.2), 300, seed=5)))


def test_a_frozen_sensor_repeats_its_first_image():
    which, lagged = shown(LinkChannel(), frozen=(1,))
    assert which == [[k, 0] for k in range(12)]
    assert lagged[9].ages.tolist() == [0, 0]
    lagged = list(delay_frames(recording(), LinkChannel(delay=0.2), noise_seed=None, frozen=(1,)))
    assert [[int(image[0, 0]) - 1 for image in each.sent.images] for each in lagged] == [
        [k, 0] for k in range(12)
    ]


def test_late_messages_need_frames_close_together():
    far = recording(apart=5.0)
    assert shown(LinkChannel(), far)[0] == [[k, k] for k in range(12)]
    assert len(shown(LinkChannel(delay=0.1), recording(apart=0.5))[0]) == 12
    with pytest.raises(ValueError, match="to show late or lost messages, got 5 s"):
        shown(LinkChannel(delay=0.1), far)
    assert len(shown(LinkChannel(), frames=recording(), seed=1)[0]) == 12
    assert len(list(delay_frames(recording(), LinkChannel(), frames=3))) == 3


@pytest.mark.parametrize("burst", [None, 5.0])
def test_losses_are_as_many_and_as_long_as_said(burst):
    channel = LinkChannel(loss=0.3, burst=burst)
    lost = np.isinf(arrivals(channel, 40_000))
    assert lost.mean() == pytest.approx(0.3, abs=0.02)
    ends = np.flatnonzero(np.diff(lost.astype(int)) == -1)
    begins = np.flatnonzero(np.diff(lost.astype(int)) == 1)
    runs = ends[1:] - begins[: len(ends) - 1] if ends[0] < begins[0] else ends - begins[: len(ends)]
    assert runs.mean() == pytest.approx(channel.mean_burst, rel=0.08)
    assert channel.mean_burst == (5.0 if burst else pytest.approx(1 / 0.7))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        *(({"delay": -0.1}, "delay must be"), ({"jitter": math.nan}, "jitter must be")),
        *(({"loss": 1.0}, "loss must be"), ({"loss": -0.1}, "loss must be")),
        *(
            ({"loss": 0.5, "burst": 1.5}, "burst must be at least 2"),
            ({"every": 0}, "every must be"),
        ),
        *(({name: math.inf}, f"{name} must be") for name in ("delay", "jitter", "burst")),
    ],
)
def test_nonsense_is_refused(wrong, said):
    assert LinkChannel(loss=0.5, burst=2.0).mean_burst == LinkChannel(loss=0.5).mean_burst == 2.0
    with pytest.raises(ValueError, match=said):
        LinkChannel(**wrong)


SENSORS = tuple(Sensor(name, DepthCamera(width=4, height=4), np.eye(4)) for name in "ab")


def recording(frames=12, apart=0.1, anew=()):
    """Every image holds 1 + the number k of its frame, in which its sensor stands k m along x.

    Track 7 goes on but where traffic begins anew.
    """
    made, track = [], 7
    for k in range(frames):
        track += k in anew
        images = tuple(np.full((2, 2), 1.0 + k, np.float32) for _ in SENSORS)
        objects = Objects(np.array([[k, 0, 1, 4, 2, 1.5, 0.0]]), np.array([0]), np.array([track]))
        sensors = tuple(replace(sensor, pose=pose(float(k))) for sensor in SENSORS)
        made.append(Frame(sensors, images, objects, apart * k, k))
    return made


def shown(channels, frames=None, **options):
    """The frame that each sensor's measurement is of, instant after instant; -1 for none."""
    lagged = list(delay_frames(frames or recording(), channels, noise_seed=None, **options))
    for number, each in enumerate(lagged):
        for sensor, image in zip(each.frame.sensors, each.frame.images, strict=True):
            assert sensor.position[0] == (image[0, 0] - 1 if image[0, 0] else number)
    return [[int(image[0, 0]) - 1 for image in each.frame.images] for each in lagged], lagged


def test_a_perfect_channel_shows_every_frame_at_once():
    which, lagged = shown(LinkChannel())
    assert which == [[k, k] for k in range(12)]
    assert [each.ages.tolist() for each in lagged] == [[0, 0]] * 12
    assert lagged[5].since == pytest.approx(0.5)


def test_each_sensor_has_its_delay_and_rate():
    which, lagged = shown([LinkChannel(delay=0.2), LinkChannel(every=3)])
    assert which == [[max(k - 2, -1), k - k % 3] for k in range(12)]
    np.testing.assert_allclose(lagged[7].ages, [0.2, 0.1])
    assert np.isnan(lagged[1].ages[0])
    assert [each.frame.objects.boxes[0, 0] for each in lagged] == list(range(12))
    assert lagged[7].frame.time == pytest.approx(0.7)


def test_what_is_lost_or_too_old_leaves_nothing_to_the_centre():
    which, _ = shown([LinkChannel(loss=0.9, burst=200.0), LinkChannel()], recording(40), seed=3)
    first = [row[0] for row in which]
    kept = first.index(-1) if first[0] >= 0 else 0
    assert set(first[kept:]) <= {-1, *range(40)}
    assert [row[1] for row in which] == list(range(40))
    stale, _ = shown([LinkChannel(every=30), LinkChannel()], recording(25))
    assert [row[0] for row in stale] == [0] * 11 + [-1] * 14


def test_traffic_that_begins_anew_has_no_earlier_frames():
    which, lagged = shown(LinkChannel(delay=0.1), recording(anew=(6,)))
    assert which == [
        [-1, -1],
        *([k, k] for k in range(5)),
        [-1, -1],
        *([k, k] for k in range(6, 11)),
    ]
    assert [round(each.since, 1) for each in lagged] == [0, 0.1, 0.2, 0.3, 0.4, 0.5] * 2


class Lossy:
    def __init__(self, lost):
        self.lost, self.sent, self.channel = lost, -1, LinkChannel(delay=1e-9)

    def arrival(self, time):
        self.sent += 1
        return np.inf if self.sent in self.lost else time


@pytest.mark.parametrize(
    ("needed", "expected"),
    [
        (None, [0, 1, 1, 3, 4, 4, 6, 7, 8, 9, 9, 11]),
        (ForegroundDifferences(key_every=5).dependencies, [0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]),
        (
            ForegroundDifferences(key_every=5, refers_to="key").dependencies,
            [0, 1, 1, 3, 4, 4, 4, 4, 4, 4, 4, 4],
        ),
        (ForegroundDifferences(key_every=3).dependencies, [0, 1, 1, 3, 4, 4, 6, 7, 8, 9, 9, 9]),
    ],
)
def test_what_was_lost_takes_with_it_what_cannot_be_read_without(needed, expected, monkeypatch):
    monkeypatch.setattr(
        "examples.studies.stress.channel.Line", lambda channel, seed: Lossy({2, 5, 10})
    )
    which, lagged = shown(LinkChannel(), needed=needed)
    assert [row[0] for row in which] == expected
    assert [int(each.sent.images[0][0, 0]) - 1 for each in lagged] == list(range(12))


def slowly(channel, seed, times):
    """The chain of Gilbert and Elliott, step by step, on the same random numbers."""
    rng = np.random.default_rng(seed)
    bad = rng.random() < channel.loss
    mean = channel.burst or 1 / (1 - channel.loss)
    for number, time in enumerate(times):
        late, change = max(rng.standard_normal() * channel.jitter, 0.0), rng.random()
        if number % channel.every:
            yield math.inf
            continue
        yield math.inf if bad else time + channel.delay + late
        bad = not change < 1 / mean if bad else change < channel.loss / (mean * (1 - channel.loss))


@pytest.mark.parametrize(
    "channel",
    [
        *(
            LinkChannel(),
            LinkChannel(0.2, 0.1),
            LinkChannel(loss=0.4),
            LinkChannel(loss=0.2, burst=4.0),
        ),
        *(LinkChannel(0.1, 0.05, 0.3, 2.0, 2), LinkChannel(loss=0.1, every=3)),
    ],
)
def test_every_message_arrives_when_an_oracle_says(channel):
    times = [0.1 * k for k in range(300)]
    for seed in (0, [7, 1, 2]):
        line = Line(channel, seed)
        assert [line.arrival(time) for time in times] == list(slowly(channel, seed, times))


def test_lines_are_drawn_from_the_seed_the_frame_that_traffic_began_with_and_the_sensor(spy):
    lines = spy("examples.studies.stress.channel", "Line")
    channels = [LinkChannel(delay=0.1), LinkChannel()]
    list(delay_frames(recording(anew=(6,)), channels, noise_seed=None, seed=5))
    asked = [(channel.delay, seed) for (channel, seed), _ in lines]
    assert asked == [(0.1, [5, 0, 0]), (0.0, [5, 0, 1]), (0.1, [5, 6, 0]), (0.0, [5, 6, 1])]
    lines.clear()
    list(delay_frames(recording(2), LinkChannel(), noise_seed=None))
    assert [seed for (_, seed), _ in lines] == [[0, 0, 0], [0, 0, 1]]
    with pytest.raises(ValueError, match="zip"):
        list(delay_frames(recording(2), channels[:1], noise_seed=None))


@pytest.mark.parametrize(("delay", "shown_at"), [(1.0, 10), (1.2, None)])
def test_what_is_just_a_second_old_is_shown_and_nothing_older(delay, shown_at):
    which, _ = shown(LinkChannel(delay=delay), recording(15))
    assert [row[0] for row in which] == [
        k - 10 if shown_at and k >= shown_at else -1 for k in range(15)
    ]


@pytest.mark.parametrize("apart", [0.5, 0.6])
def test_frames_half_a_second_apart_still_show_late_messages(apart):
    if apart == 0.5:
        assert [row[0] for row in shown(LinkChannel(delay=0.5), recording(4, apart))[0]] == [
            -1,
            0,
            1,
            2,
        ]
    else:
        with pytest.raises(ValueError, match=r"frames must be at most 0\.5 s apart"):
            shown(LinkChannel(delay=0.5), recording(4, apart))


def test_frames_are_read_with_the_errors_and_the_noise_that_are_asked(monkeypatch):
    asked = []

    def read(recording, k, *, errors, noise_seed):
        asked.append((k, errors, noise_seed))
        return recording[k]

    monkeypatch.setattr("examples.studies.stress.channel.read_frame", read)
    list(delay_frames(recording(2), LinkChannel(), errors="poor", noise_seed=4))
    list(delay_frames(recording(1), LinkChannel()))
    assert asked == [(0, "poor", 4), (1, "poor", 4), (0, PAPER_ERRORS, 0)]


def test_traffic_goes_on_where_one_of_several_tracks_does():
    frames = recording(6, anew=(3,))
    for frame, ids in zip(frames, ([1, 2], [2, 3], [3, 4], [4, 5], [6, 7], [7, 8]), strict=True):
        boxes = np.repeat(frame.objects.boxes, 2, axis=0)
        object.__setattr__(frame, "objects", Objects(boxes, np.array([0, 0]), np.array(ids)))
    lagged = list(delay_frames(frames, LinkChannel(), noise_seed=None))
    assert [round(each.since, 1) for each in lagged] == [0.0, 0.1, 0.2, 0.3, 0.0, 0.1]


def test_frames_too_far_apart_for_any_channel_are_refused_by_how_far():
    frames = recording(4)
    late = [*frames[:3], replace(frames[3], time=3.2)]
    assert len(shown(LinkChannel(), late)[0]) == 4
    with pytest.raises(
        ValueError, match=r"frames must be at most 0\.5 s apart .*, got 3 s: record"
    ):
        shown([LinkChannel(), LinkChannel(delay=0.1)], late)


def test_points_stay_off_their_rays_by_as_much_as_they_were_measured():
    """The first sensor's message takes a frame, the second's none, and shifts are known from the
    second frame on."""
    frames = recording(4)
    shifts = [
        tuple(np.full((2, 2, 3), k + 0.1 * sensor, np.float32) for sensor in range(2))
        for k in range(4)
    ]
    known = [frames[0], *(replace(frames[k], shifts=shifts[k]) for k in range(1, 4))]
    lagged = delay_frames(known, [LinkChannel(delay=0.1), LinkChannel()], noise_seed=None)
    found = [each.frame.shifts for each in lagged]
    assert found[0] == ()
    assert found[1][0] is None
    assert found[1][1] is shifts[1][1]
    assert all(found[k][0] is shifts[k - 1][0] and found[k][1] is shifts[k][1] for k in (2, 3))
    half = [replace(frames[k], shifts=(None, shifts[k][1])) for k in range(2)]
    assert [
        each.frame.shifts[0] for each in delay_frames(half, LinkChannel(), noise_seed=None)
    ] == [None, None]
    none = [replace(frames[k], shifts=(None, None)) for k in range(2)]
    assert [each.frame.shifts for each in delay_frames(none, LinkChannel(), noise_seed=None)] == [
        (),
        (),
    ]
