"""A lidar that sends its packets to a port of this machine."""

import socket
import struct
import time
from threading import Event, Thread

import numpy as np
import pytest

from toolkit.centre.input_pumps import InputPumps
from toolkit.centre.message_queue import MessageQueue
from toolkit.centre.velodyne_input import VelodyneInput
from toolkit.geometry import pose

pytest.importorskip("velodyne_decoder")
STEP_DEG = 0.4
PACKET_S = 1.327e-3
VLP16 = 0x22


def packet(number, last=VLP16):
    """1206 bytes of a VLP-16 by its manual: 12 blocks of 32 returns at 10 m."""
    content = b""
    for block in range(12):
        azimuth = round((12 * number + block) * STEP_DEG * 100) % 36000
        content += struct.pack("<HH", 0xEEFF, azimuth)
        content += b"".join(struct.pack("<HB", round(10.0 / 0.002), k) for k in range(32))
    microseconds = round(number * PACKET_S * 1e6)
    return content + struct.pack("<I", microseconds) + bytes([0x37, last])


def send(port, stop, last=VLP16):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as lidar:
        number = 0
        while not stop.is_set():
            lidar.sendto(packet(number, last), ("127.0.0.1", port))
            number += 1
            time.sleep(1e-4)


def receive(source, last=VLP16, count=3):
    """First messages of a lidar, and the input's pumps."""
    stop = Event()
    queue = MessageQueue(stop)
    pumps = InputPumps([source], {}, queue, stop)
    sender = Thread(target=send, args=(source.port.number, stop, last))
    pumps.start()
    sender.start()
    messages = []
    while len(messages) < count:
        taken = queue.take(20.0)
        if taken is None:
            break
        messages += taken
    stop.set()
    sender.join()
    pumps.stop()
    return messages, pumps


def test_a_message_for_every_turn(free_port):
    world_SE3_north = pose(0.0, 0.0, 5.0)
    source = VelodyneInput("north", free_port, world_SE3_north)
    messages, _ = receive(source)
    turn = messages[1]
    ranges = np.linalg.norm(turn.measurement.points, axis=1)
    assert ranges == pytest.approx(10.0, abs=0.01)
    assert len(ranges) == pytest.approx(16 * 24 * 75, rel=0.02)
    assert np.array_equal(turn.measurement.world_SE3_sensor, world_SE3_north)
    assert turn.measurement.time.max() == pytest.approx(turn.time_s - turn.measurement.stamp_s)
    assert [m.sensor for m in messages] == ["north"] * len(messages)
    times = [m.time_s for m in messages]
    assert times == sorted(times)


def test_an_unknown_model_is_refused(free_port):
    source = VelodyneInput("north", free_port)
    messages, pumps = receive(source, last=0x99)
    assert messages == []
    with pytest.raises(ValueError, match="end in 0x99"):
        pumps.check()
