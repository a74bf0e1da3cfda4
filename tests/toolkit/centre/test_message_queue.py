"""The queue between inputs and centre, and the threads that fill it."""

import time
from threading import Event, Thread

import numpy as np
import pytest

from toolkit.centre.input_process import read_in_process
from toolkit.centre.input_pumps import InputPumps, read_in_thread
from toolkit.centre.message_queue import MessageQueue
from toolkit.centre.recording_input import RecordingInput
from toolkit.centre.sensor_message import SensorMessage, SensorSetup
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects

IMAGE = np.zeros((2, 2), np.float32)


class FewFrames:
    """Recording of clouds, 50 ms apart; another process can read it."""

    site = None

    def __init__(self, count, damaged_from=None, error=ValueError):
        self.count = count
        self.damaged_from = damaged_from
        self.error = error

    def __len__(self):
        return self.count

    def __getitem__(self, k):
        if self.damaged_from is not None and k >= self.damaged_from:
            raise self.error(f"frame {k} is damaged")
        cloud = SensorCloud("north", np.full((3, 3), k, np.float32), np.eye(4))
        return Frame.of_clouds(f"{k}", [cloud], Objects.empty(), time=7.0 + 0.05 * k)


def message(k):
    return SensorMessage("a" if k % 2 else "b", float(k), float(k), IMAGE)


def test_a_full_queue_drops_the_oldest_and_counts_them():
    queue = MessageQueue(Event(), 4)
    for k in range(10):
        queue.put(message(k))
    assert len(queue) == 4
    assert [received.time_s for received in queue.take(0.0)] == [6, 7, 8, 9]
    assert queue.drops == {"a": 3, "b": 3}


def test_a_closed_queue_gives_out_what_waits_and_then_ends():
    queue = MessageQueue(Event())
    queue.put(message(0))
    queue.close()
    assert len(queue.take(1.0)) == 1
    assert queue.take(1.0) is None


def test_a_stopped_queue_ends_without_what_waits():
    stop = Event()
    queue = MessageQueue(stop)
    queue.put(message(0))
    stop.set()
    assert queue.take(1.0) is None


def test_who_waits_is_woken():
    queue = MessageQueue(Event())
    thread = Thread(target=queue.put, args=(message(0),))
    thread.start()
    assert len(queue.take(20.0)) == 1
    thread.join()


def test_a_rest_ends_when_woken_and_leaves_messages():
    queue = MessageQueue(Event())
    queue.put(message(0))
    queue.close()
    thread = Thread(target=queue.wake)
    thread.start()
    queue.rest(20.0)
    thread.join()
    queue.wake()  # before the next rest
    queue.rest(20.0)
    assert len(queue.take(0.0)) == 1


def test_the_spread_of_a_recording_is_that_of_its_longest_frame():
    frames = []
    for k, delay_s in enumerate((0.02, 0.07, 0.0)):
        start_s = 7.0 + 0.1 * k
        clouds = [
            SensorCloud(name, np.zeros((3, 3), np.float32), np.eye(4), stamp_s=stamp_s)
            for name, stamp_s in (("north", start_s), ("south", start_s + delay_s))
        ]
        frames.append(Frame.of_clouds(f"{k}", clouds, Objects.empty(), time=start_s))
    assert RecordingInput(frames).spread_s == pytest.approx(0.07)


def drain(queue):
    received = []
    while (messages := queue.take(0.2)) is not None:
        received += messages
    return received


@pytest.mark.parametrize("read", [read_in_thread, read_in_process])
def test_a_recording_is_replayed_in_order_with_poses_and_clocks(read):
    stop = Event()
    queue = MessageQueue(stop)
    moved = pose(1.0, 2.0, 3.0)
    pumps = InputPumps(
        [RecordingInput(FewFrames(8))],
        {"north": SensorSetup(moved, clock_offset_s=2.0)},
        queue,
        stop,
        speed=100.0,
        read=read,
    )
    clock = pumps.start()
    received = drain(queue)
    pumps.check()
    pumps.stop()
    assert clock.now() >= 7.35
    assert [m.time_s for m in received] == pytest.approx([5.0 + 0.05 * k for k in range(8)])
    assert all(m.arrival_s >= 7.0 + 0.05 * k for k, m in enumerate(received))
    assert [m.measurement.points[0, 0] for m in received] == list(range(8))
    assert np.array_equal(received[0].measurement.world_SE3_sensor, moved)


def test_the_clock_of_a_replay_that_is_read_too_slowly_is_set_back(monkeypatch):
    class SlowFrames(FewFrames):
        def __getitem__(self, k):
            time.sleep(0.02)
            return super().__getitem__(k)

    monkeypatch.setattr("toolkit.centre.input_pumps._MAX_LAG_S", 0.1)
    stop = Event()
    queue = MessageQueue(stop)
    source = RecordingInput(SlowFrames(40))  # 2 s, read in 0.8 s
    pumps = InputPumps([source], {}, queue, stop, speed=10.0, read=read_in_thread)
    pumps.start()
    received = drain(queue)
    pumps.check()
    pumps.stop()
    assert [m.time_s for m in received] == pytest.approx([7.0 + 0.05 * k for k in range(40)])
    lags_s = [m.arrival_s - m.time_s for m in received]
    assert sum(lag_s < 0.1 for lag_s in lags_s) >= 3  # at the start, and whenever it is set back
    assert pumps.set_back_s > 2
    assert lags_s[-1] < 3  # 6 if the clock ran on


def test_the_clock_of_a_replay_in_time_is_left_alone():
    stop = Event()
    queue = MessageQueue(stop)
    pumps = InputPumps([RecordingInput(FewFrames(8))], {}, queue, stop, read=read_in_thread)
    pumps.start()
    assert len(drain(queue)) == 8
    pumps.stop()
    assert pumps.set_back_s == 0


@pytest.mark.parametrize(
    ("error", "words"),
    [(ValueError, "frame 25 is damaged"), (KeyError, "the process that reads the input died")],
)
def test_damage_in_another_process_is_an_error_here(error, words):
    stop = Event()
    queue = MessageQueue(stop)
    source = RecordingInput(FewFrames(30, damaged_from=25, error=error))
    pumps = InputPumps([source], {}, queue, stop, speed=100.0)
    pumps.start()
    assert len(drain(queue)) == 25
    with pytest.raises(ValueError, match=words):
        pumps.check()
    pumps.stop()


def test_a_replay_needs_times_in_order():
    class Backwards(FewFrames):
        def __getitem__(self, k):
            return super().__getitem__(-k)

    with pytest.raises(ValueError, match="in the order of time"):
        RecordingInput(Backwards(5))
    with pytest.raises(ValueError, match="2 frames or more"):
        RecordingInput(FewFrames(1))
