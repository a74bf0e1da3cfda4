"""An Ouster that sends its packets to a port of this machine."""

import socket
import time
from itertools import islice
from threading import Event, Thread

import numpy as np
import pytest

from toolkit.centre.ouster_input import OusterInput, load_ouster_metadata
from toolkit.geometry import pose

WIDTH = 512


def lidar(core, serial=1234):
    """Metadata of an OS-1-64 of 512 columns at 10 Hz."""
    info = core.SensorInfo.from_default(core.LidarMode._512x10)
    info.sn = serial
    info.fw_rev = "v3.1.0"
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    return info


def make_packets(core, info, frames=4):
    """Packets of turns of which every pixel is at 10 m and the next ones a metre further."""
    packets = []
    for number in range(frames):
        frame = core.LidarFrame(info)
        frame.field("RANGE")[:] = 10_000 + 1000 * number
        frame.status[:] = 1
        steps = np.arange(WIDTH) * 195_312
        frame.timestamp[:] = (55 * 10**9 + number * 10**8 + steps).astype(np.uint64)
        frame.measurement_id[:] = np.arange(WIDTH)
        frame.frame_id = number + 1
        packets += core.frame_to_packets(frame, core.PacketFormat(info), info.init_id, info.sn)
    return [bytes(packet.buf) for packet in packets]


def receive(source, datagrams, count):
    """First messages of an input to whose port datagrams are sent again and again."""
    stop = Event()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not stop.is_set():
                for data in datagrams:
                    sender.sendto(data, ("127.0.0.1", source.port.number))
                    time.sleep(2e-4)

    thread = Thread(target=send)
    thread.start()
    messages = source.messages(stop)
    try:
        return [next(messages) for _ in range(count)]
    finally:
        stop.set()
        thread.join()
        messages.close()


def test_a_message_for_every_turn_at_the_lidars_pose(tmp_path, free_port):
    core = pytest.importorskip("ouster.sdk.core")
    info = lidar(core)
    (tmp_path / "north.json").write_text(info.to_json_string())
    world_SE3_north = pose(0.0, 0.0, 5.0)
    source = OusterInput("north", free_port, world_SE3_north, metadata=tmp_path / "north.json")
    first, second, third = receive(source, make_packets(core, info), 3)[:3]
    clouds = [message.measurement for message in (first, second, third)]
    whole = [cloud for cloud in clouds if len(cloud.points) == 64 * WIDTH]
    assert len(whole) >= 2
    for cloud in whole:
        ranges = np.linalg.norm(cloud.points, axis=1)
        assert np.ptp(ranges) < 0.05
        assert min(abs(ranges.mean() - np.arange(10.0, 14.0))) < 0.05
        np.testing.assert_allclose(cloud.time.max(), 511 * 195_312e-9, atol=1e-6)
        assert np.array_equal(cloud.world_SE3_sensor, world_SE3_north)
    assert first.sensor == "north"
    assert first.time_s == pytest.approx(first.measurement.stamp_s + first.measurement.time.max())
    assert abs(first.time_s - time.time()) < 60


def test_packets_of_another_sensor_are_named_and_passed_over(tmp_path, free_port):
    core = pytest.importorskip("ouster.sdk.core")
    info = lidar(core)
    (tmp_path / "north.json").write_text(info.to_json_string())
    source = OusterInput("north", free_port, metadata=tmp_path / "north.json")
    datagrams = []
    for data in make_packets(core, info):
        datagrams += [data, bytes(1206)]
    with pytest.warns(UserWarning, match="packets of 1206 bytes"):
        messages = receive(source, datagrams, 2)
    assert [message.sensor for message in messages] == ["north", "north"]


def test_metadata_that_are_none_are_named(tmp_path):
    pytest.importorskip("ouster.sdk.core")
    (tmp_path / "north.json").write_text("{}")
    with pytest.raises(ValueError, match=r"north\.json is no metadata of an Ouster"):
        load_ouster_metadata(tmp_path / "north.json")


def test_a_port_passes_over_packets_of_other_sizes_and_senders(free_port):
    port = free_port
    stop = Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        packets = port.receive(4, stop, ignored_bytes=(2,))

        def send():
            while not stop.is_set():
                for data in (b"ab", b"abc", b"abcd"):
                    sender.sendto(data, ("127.0.0.1", port.number))
                time.sleep(0.01)

        thread = Thread(target=send)
        thread.start()
        try:
            with pytest.warns(UserWarning, match="of 3 bytes from 127.0.0.1") as warned:
                received = list(islice(packets, 2))
        finally:
            stop.set()
            thread.join()
    assert [data for _, data in received] == [b"abcd", b"abcd"]
    arrived_s = received[0][0]
    assert abs(arrived_s - time.time()) < 60
    assert len(warned) == 1
