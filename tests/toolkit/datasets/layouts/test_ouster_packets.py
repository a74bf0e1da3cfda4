"""Captures of an Ouster, made by ouster-sdk from images of ranges."""

import numpy as np
import pytest

from toolkit.datasets.layouts.pcap import PARTIAL_TURN, SECOND_RETURNS
from toolkit.datasets.recordings import open_recording

pytestmark = pytest.mark.filterwarnings("ignore:.*is read as layout pcap")
pytest.importorskip("velodyne_decoder")
core = pytest.importorskip("ouster.sdk.core")
sdk = pytest.importorskip("ouster.sdk")
recorder = pytest.importorskip("ouster.sdk.pcap")

START_NS = 1_700_000_000 * 10**9
WIDTH = 512


def lidar(serial=1234, *, dual=False):
    """Metadata of an OS-1-64 of 512 columns at 10 Hz."""
    info = core.SensorInfo.from_default(core.LidarMode._512x10)
    info.sn = serial
    info.fw_rev = "v3.1.0"
    info.config.udp_port_lidar, info.config.udp_port_imu = 7502, 7503
    if dual:
        profile = core.UDPProfileLidar.RNG19_RFL8_SIG16_NIR16_DUAL
        info.format.udp_profile_lidar = info.config.udp_profile_lidar = profile
    return info


def measured(info, number, columns=WIDTH, millimetres=10_000):
    """A frame: no return in the first row, signal by column, only the first columns measured."""
    frame = core.LidarFrame(info)
    frame.field("RANGE")[:] = millimetres
    frame.field("RANGE")[0] = 0
    frame.field("SIGNAL")[:] = np.arange(WIDTH)
    frame.status[:columns] = 1
    steps = np.arange(WIDTH) * 195_312
    frame.timestamp[:] = (55 * 10**9 + number * 10**8 + steps).astype(np.uint64)
    frame.measurement_id[:] = np.arange(WIDTH)
    frame.frame_id = number + 1
    return frame


def capture(path, info, frames):
    packets = []
    for frame in frames:
        packets += core.frame_to_packets(frame, core.PacketFormat(info), info.init_id, info.sn)
    for k, packet in enumerate(packets):
        packet.host_timestamp = START_NS + k * 3_125_000
    recorder.record(packets, str(path))
    path.with_suffix(".json").write_text(info.to_json_string())
    return path


def test_points_are_the_sensors_by_its_lookup_table(tmp_path):
    info = lidar()
    made = [measured(info, k) for k in range(3)]
    frames = list(open_recording(capture(tmp_path / "a.pcap", info, made)))
    assert len(frames) == 3
    for k, (frame, written) in enumerate(zip(frames, made, strict=True)):
        (cloud,) = frame.clouds
        assert cloud.name == "ouster"
        assert frame.problems == {}
        assert frame.time == pytest.approx(1.7e9 + 0.1 * k, abs=1e-5)
        expected = core.XYZLut(info)(written)[1:]
        np.testing.assert_allclose(cloud.points, expected.reshape(-1, 3), atol=1e-5)
        assert cloud.time is not None
        assert np.unique(cloud.ring).tolist() == list(range(1, 64))
        np.testing.assert_array_equal(cloud.intensity, np.tile(np.arange(WIDTH), 63))
        np.testing.assert_allclose(cloud.time[:WIDTH], np.arange(WIDTH) * 195_312e-9, atol=1e-9)


def test_partial_turns_are_counted_and_frames_read_in_any_order(tmp_path):
    info = lidar()
    made = [
        measured(info, 0),
        measured(info, 1, 200, 20_000),
        measured(info, 2, millimetres=30_000),
    ]
    recording = open_recording(capture(tmp_path / "a.pcap", info, made))
    for number in (2, 0, 1, 1):
        (cloud,) = recording[number].clouds
        ranges = np.linalg.norm(cloud.points, axis=1)
        assert abs(ranges - 10.0 * (number + 1)).max() < 0.02
    assert recording[1].problems == {PARTIAL_TURN: 1}
    assert len(recording[1].points()) == 63 * 200


def test_second_returns_are_counted(tmp_path):
    info = lidar(dual=True)
    frame = measured(info, 0)
    frame.field("RANGE2")[5] = 15_000
    frames = list(open_recording(capture(tmp_path / "a.pcap", info, [frame])))
    assert frames[0].problems == {SECOND_RETURNS: WIDTH}
    assert len(frames[0].points()) == 63 * WIDTH


def test_missing_and_damaged_metadata_are_named(tmp_path):
    info = lidar()
    path = capture(tmp_path / "a.pcap", info, [measured(info, 0)])
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(ValueError, match=r"a\.pcap is no capture that can be read"):
        open_recording(path)
    (tmp_path / "a.json").unlink()
    with pytest.raises(ValueError, match=r"an Ouster's needs its metadata next to it, a\.json"):
        open_recording(path)
