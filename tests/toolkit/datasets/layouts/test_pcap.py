"""Captures of Velodyne's packets, packed by hand by the manual of the VLP-16 (63-9243)."""

import json
import struct

import numpy as np
import pytest

from toolkit.datasets.clock_times import UNPAIRED
from toolkit.datasets.layouts.pcap import PARTIAL_TURN, pcap
from toolkit.datasets.problem_kinds import EMPTY
from toolkit.datasets.recordings import guess_layout, open_recording
from toolkit.geometry import pose, transform

pytestmark = pytest.mark.filterwarnings("ignore:.*is read as layout pcap")
pytest.importorskip("velodyne_decoder")
dpkt = pytest.importorskip("dpkt")

START_S = 1_700_000_000.0
STEP_DEG = 0.4  # azimuth from block to block of 12
PACKET_S = 1.327e-3
VLP16, HDL32 = 0x22, 0x21


def data(azimuth_deg, seconds, last=VLP16, metres=10.0):
    """1206 bytes: 12 blocks of an azimuth and 32 returns, the time in the hour, and the model."""
    content = b""
    for block in range(12):
        azimuth = round((azimuth_deg + block * STEP_DEG) * 100) % 36000
        content += struct.pack("<HH", 0xEEFF, azimuth)
        content += b"".join(struct.pack("<HB", round(metres / 0.002), k) for k in range(32))
    return content + struct.pack("<I", round(seconds % 3600 * 1e6)) + bytes([0x37, last])


def framed(content, address="192.168.1.201"):
    udp = dpkt.udp.UDP(sport=2368, dport=2368, data=content)
    udp.ulen = len(udp)
    source = bytes(int(part) for part in address.split("."))
    ip = dpkt.ip.IP(src=source, dst=b"\xff" * 4, p=17, data=udp)
    ip.len = len(ip)
    return bytes(dpkt.ethernet.Ethernet(data=ip, type=0x800))


def capture(path, packets):
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for time_s, content in packets:
            writer.writepkt(content, time_s)
    return path


def turning(count=190, first_deg=300.0, address="192.168.1.201", start_s=START_S, **more):
    """Packets of a lidar that turns at 10 Hz."""
    for k in range(count):
        seconds = start_s + k * PACKET_S
        azimuth = first_deg + 12 * STEP_DEG * k
        yield seconds, framed(data(azimuth, seconds, **more), address)


def test_a_capture_that_was_cut_off_meanwhile_is_refused(tmp_path):
    path = capture(tmp_path / "a.pcap", turning(400))
    recording = open_recording(path)
    last = len(recording) - 1
    content = path.read_bytes()
    capture(path, turning(100))
    for _ in range(2):
        with pytest.raises(ValueError, match="fewer turns than when it was opened"):
            recording[last]
    assert len(recording[0].clouds) == 1
    path.write_bytes(content)
    assert len(recording[last].clouds) == 1


def test_turns_of_a_vlp16_are_frames(tmp_path):
    path = capture(tmp_path / "a.pcap", turning())
    assert guess_layout(path) == "pcap"
    frames = list(open_recording(path))
    assert len(frames) == 4  # 60 degrees, two turns, and the rest of 190 packets
    partial = [frame.problems for frame in frames]
    assert partial == [{PARTIAL_TURN: 1}, {}, {}, {PARTIAL_TURN: 1}]
    (cloud,) = frames[1].clouds
    assert cloud.name == "velodyne"
    assert cloud.ring is not None
    assert cloud.time is not None
    assert np.unique(cloud.ring).tolist() == list(range(16))


def test_rays_of_a_vlp16_turn_clockwise_by_its_manual(tmp_path):
    frames = list(open_recording(capture(tmp_path / "a.pcap", turning())))
    (cloud,) = frames[1].clouds
    assert cloud.ring is not None
    assert cloud.time is not None
    ranges = np.linalg.norm(cloud.points, axis=1)
    np.testing.assert_allclose(ranges, 10.0, atol=0.01)  # beams begin 4 cm beside the axis
    elevations = np.rad2deg(np.arcsin(cloud.points[:, 2] / ranges))
    np.testing.assert_allclose(elevations, -15.0 + 2.0 * cloud.ring, atol=0.15)
    assert 0 <= cloud.time.min() < 1e-6
    assert cloud.time.max() == pytest.approx(75 * PACKET_S, abs=2 * PACKET_S)
    # azimuth 0 is the sensor's x, and azimuths turn clockwise: after a quarter turn it looks at -y
    quarter = cloud.points[np.abs(cloud.time - cloud.time.max() / 4) < 1e-3]
    assert (quarter[:, 1] < -9).all()


def test_turns_of_a_vlp16_have_the_times_of_their_packets(tmp_path):
    frames = list(open_recording(capture(tmp_path / "a.pcap", turning())))
    times = np.array([frame.time for frame in frames])
    assert times[0] == pytest.approx(START_S, abs=1e-5)
    np.testing.assert_allclose(np.diff(times)[1:], 0.0995, atol=2 * PACKET_S)


def test_frames_by_number_in_any_order(tmp_path):
    recording = open_recording(capture(tmp_path / "a.pcap", turning()))
    in_order = [frame.points() for frame in recording]
    for number in (2, 0, 3, 3, 1):
        np.testing.assert_array_equal(recording[number].points(), in_order[number])


def test_two_sensors_are_apart_and_placed_by_their_names(tmp_path):
    north = list(turning(metres=10.0))
    south = list(turning(address="192.168.1.202", start_s=START_S + 0.01, metres=20.0, first_deg=0))
    packets = sorted([*north, *south[:160]])
    path = capture(tmp_path / "a.pcap", packets)
    placed = {"velodyne-192.168.1.201": pose(5.0, 1.0, 4.0), "velodyne-192.168.1.202": pose(-5.0)}
    poses = {name: matrix.tolist() for name, matrix in placed.items()}
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    frames = list(pcap(path, poses=tmp_path / "poses.json"))
    both = [frame for frame in frames if len(frame.clouds) == 2]
    assert both
    for cloud in both[0].clouds:
        np.testing.assert_array_equal(cloud.world_SE3_sensor, placed[cloud.name])
        metres = 10.0 if cloud.name.endswith("201") else 20.0
        np.testing.assert_allclose(np.linalg.norm(cloud.points, axis=1), metres, atol=0.01)
    world = both[0].points()
    cloud = both[0].clouds[0]
    np.testing.assert_allclose(
        world[: len(cloud.points)],
        transform(cloud.world_SE3_sensor, cloud.points.astype(float)),
        atol=1e-5,
    )
    assert all(UNPAIRED in frame.problems for frame in frames if len(frame.clouds) == 1)
    (tmp_path / "poses.json").write_text(json.dumps({"velodyne": np.eye(4).tolist()}))
    with pytest.raises(ValueError, match=r"no pose of velodyne-192\.168\.1\.201"):
        pcap(path, poses=tmp_path / "poses.json")


def test_other_packets_are_passed_over(tmp_path):
    position = (START_S, framed(bytes(512)))  # Velodyne's position packets
    junk = (START_S, b"\x00" * 9)
    packets = [position, junk, *turning()]
    assert len(open_recording(capture(tmp_path / "a.pcap", packets))) == 4


@pytest.mark.parametrize(
    ("packets", "reason"),
    [
        ([], "but no UDP packets: an Ouster's needs its metadata"),
        ([(START_S, framed(bytes(24896)))], "but 1 of 24896 bytes"),
        (list(turning(3, last=0x55)), "end in 0x55, which is none of the known models HDL32E"),
    ],
)
def test_captures_of_other_things_are_refused(tmp_path, packets, reason):
    with pytest.raises(ValueError, match=reason) as raised:
        open_recording(capture(tmp_path / "a.pcap", packets))
    assert str(tmp_path / "a.pcap") in str(raised.value)


def test_no_returns_are_an_empty_cloud(tmp_path):
    frames = list(open_recording(capture(tmp_path / "a.pcap", turning(metres=0.0))))
    assert [frame.problems for frame in frames] == [{EMPTY: 1}] * 4


def test_damage(tmp_path):
    whole = capture(tmp_path / "a.pcap", turning()).read_bytes()
    for content in (b"", b"junk" * 40, whole[:10]):
        (tmp_path / "a.pcap").write_bytes(content)
        with pytest.raises(ValueError, match=r"a\.pcap is no capture that can be read"):
            open_recording(tmp_path / "a.pcap")
    (tmp_path / "a.pcap").write_bytes(whole[:-700])
    with pytest.warns(UserWarning, match="1 packets are shorter than they state and left out"):
        assert len(open_recording(tmp_path / "a.pcap")) == 4
    with pytest.raises(FileNotFoundError, match=r"give a \.pcap file"):
        pcap(tmp_path)


def test_without_the_package_the_extra_is_named(tmp_path, without_packages):
    path = capture(tmp_path / "a.pcap", turning(3))
    without_packages("velodyne_decoder")
    with pytest.raises(ImportError, match=r"needs velodyne-decoder: pip install coview\[scans\]"):
        open_recording(path)
