"""Each sensor's cloud keeps the time at which it was measured, through every layout that has a
place for it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from toolkit.datasets.clock_times import find_epoch, parse_time
from toolkit.datasets.recordings import find_layout, open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.point_files.pcd import pcd_bytes

START_S = 1_700_000_000.0
LAG_S = 0.05  # of the second sensor
POINTS = np.array([[1.0, 2.0, 0.5], [3.0, -1.0, 0.25]], np.float32)
KEPT = ("folder", "openlabel", "nuscenes", "argoverse", "rosbag", "hdf5")


def frames() -> list[Frame]:
    made = []
    for k in range(2):
        time = START_S + 0.1 * k
        north = SensorCloud("north", POINTS, pose(1.0), stamp_s=time)
        south = SensorCloud("south", POINTS, pose(2.0), stamp_s=time + LAG_S)
        made.append(Frame.of_clouds(str(k), (north, south), Objects.empty(), time=time))
    return made


@pytest.mark.parametrize("layout", KEPT)
def test_the_time_of_each_cloud_comes_back(tmp_path, layout):
    """Within a microsecond, the least unit of nuScenes."""
    place = tmp_path / "clouds.hdf5" if layout == "hdf5" else tmp_path
    write_recording(frames(), place, layout)
    opened = place / "bag" if layout == "rosbag" else place
    for before, after in zip(frames(), find_layout(layout).open(opened), strict=True):
        stamps = [cloud.stamp_s for cloud in after.clouds]
        np.testing.assert_allclose(
            stamps, [cloud.stamp_s for cloud in before.clouds], rtol=0, atol=1e-6
        )
        assert after.time == pytest.approx(before.time, abs=1e-6)


def test_dair_keeps_a_time_that_all_clouds_of_a_frame_share(tmp_path):
    """DAIR-V2X's data_info.json has pointcloud_timestamp, in microseconds as text."""
    together = [
        frame.with_clouds([replace(cloud, stamp_s=frame.time) for cloud in frame.clouds])
        for frame in frames()
    ]
    write_recording(together, tmp_path, "dair")
    assert (
        json.loads((tmp_path / "data_info.json").read_text())[1]["pointcloud_timestamp"]
        == "1700000000100000"
    )
    back = list(open_recording(tmp_path, "dair"))
    assert [frame.clouds[0].stamp_s for frame in back] == [START_S, START_S + 0.1]


@pytest.mark.parametrize("step_s", [0.1, 5.0])
def test_dair_keeps_times_of_a_clock_that_starts_at_0(tmp_path, step_s):
    """Simulated frames 5 s apart are 5000000 microseconds apart, no seconds."""
    cloud = SensorCloud("lidar", POINTS, np.eye(4))
    started = [
        Frame.of_clouds(str(k), (cloud,), Objects.empty(), time=k * step_s) for k in range(3)
    ]
    write_recording(started, tmp_path, "dair")
    times = [frame.time for frame in open_recording(tmp_path, "dair")]
    np.testing.assert_allclose(times, [0.0, step_s, 2 * step_s], atol=1e-9)


def test_clouds_of_unknown_time_have_none(tmp_path):
    untimed = [
        frame.with_clouds([replace(cloud, stamp_s=None) for cloud in frame.clouds])
        for frame in frames()
    ]
    for layout in ("folder", "hdf5"):
        place = tmp_path / ("a.hdf5" if layout == "hdf5" else "a")
        write_recording(untimed, place, layout)
        assert [
            cloud.stamp_s for frame in open_recording(place, layout) for cloud in frame.clouds
        ] == [None] * 4
    write_recording(untimed, tmp_path / "kitti", "kitti")
    (first, _) = open_recording(tmp_path / "kitti", "kitti")
    assert first.clouds[0].stamp_s is None
    with pytest.raises(ValueError, match="stamp_s of 'a' must be seconds, got nan"):
        SensorCloud("a", POINTS, np.eye(4), stamp_s=float("nan"))


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        ("1688625741_047447463", 1688625741.047447463),
        ("1688625741_047447463_s110_lidar_ouster_south", 1688625741.047447463),
        ("1646667310_044", 1646667310.044),
        ("1692685344.400161", 1692685344.400161),
        ("1700000000", 1700000000.0),
        ("1700000000004", 1700000000.004),
        ("1700000000004000", 1700000000.004),
        ("1700000000004000000", 1700000000.004),
        ("20230515101530", None),  # a date of 14 digits, not milliseconds
        ("1646667310_44", None),  # two digits may be hundredths or unpadded milliseconds
        ("000017", None),
        ("1e9", None),
        ("99999999", None),
    ],
)
def test_times_of_names(name, seconds):
    """TUM Traffic writes seconds_nanoseconds, RCooper seconds with decimals, ROS and Argoverse
    nanoseconds."""
    assert find_epoch(name) == seconds


@pytest.mark.parametrize(
    ("stated", "seconds"),
    [
        (1646667310.044, 1646667310.044),
        ("1626155124027000", 1626155124.027),
        (1626155124027, 1626155124.027),
        ("2020-04-11 12:00:01", 1586606401.0),
        ("2020-04-11T12:00:01.5Z", 1586606401.5),
        ("2020-04-11T14:00:01+02:00", 1586606401.0),
        (12.5, 12.5),
        ("", None),
        (None, None),
    ],
)
def test_times_that_files_state(stated, seconds):
    """OpenLABEL 1.0.0: a timestamp is a number or a UTC string."""
    assert (
        parse_time(stated, "timestamp") == pytest.approx(seconds)
        if seconds
        else parse_time(stated, "t") is None
    )


@pytest.mark.parametrize("stated", ["noon", 1e30, 7e12])
def test_other_times_are_refused_by_name(stated):
    with pytest.raises(ValueError, match="timestamp must be"):
        parse_time(stated, "timestamp")


def test_a_stream_of_openlabel_states_its_clouds_time(tmp_path):
    """OpenLABEL 1.0.0: frame_properties.streams.NAME.stream_properties.sync.timestamp."""
    streams = {
        "north": {
            "stream_properties": {"sync": {"frame_stream": 3, "timestamp": "2020-04-11 12:00:01"}}
        }
    }
    properties = {"point_cloud_file_names": ["a.pcd"], "streams": streams}
    document = {
        "openlabel": {
            "metadata": {},
            "frames": {"0": {"frame_properties": properties, "objects": {}}},
        }
    }
    (tmp_path / "a.json").write_text(json.dumps(document))
    (tmp_path / "a.pcd").write_bytes(pcd_bytes(dict(zip("xyz", POINTS.T, strict=True))))
    (frame,) = open_recording(tmp_path, "openlabel")
    assert frame.clouds[0].stamp_s == frame.time == 1586606401.0


def test_two_lidars_of_a_sweep_begin_at_their_first_points(tmp_path):
    """Argoverse 2: offset_ns is counted from the sweep's time, for the points of both lidars."""
    pytest.importorskip("pyarrow")
    write_recording(frames()[:1], tmp_path, "argoverse")
    from pyarrow import feather

    (sweep,) = (tmp_path / "sensors/lidar").glob("*.feather")
    assert feather.read_table(sweep)["offset_ns"].to_pylist() == [0, 0, 50_000_000, 50_000_000]
