"""A whole run of a centre over a short recording, and what it writes."""

from threading import Event

import numpy as np
import pytest

from toolkit.calibration.place import Place
from toolkit.centre.centre_config import OutputConfig
from toolkit.centre.centre_run import CentreParts, run_centre
from toolkit.centre.detection_pool import Detection
from toolkit.centre.health import HealthLog
from toolkit.centre.input_pumps import read_in_thread
from toolkit.centre.recording_input import RecordingInput
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Detections, Objects

FRAMES = 5


class Recording:
    """Clouds of one lidar, 0.1 s apart."""

    site = None

    def __len__(self):
        return FRAMES

    def __getitem__(self, k):
        cloud = SensorCloud("north", np.full((3, 3), k, np.float32), np.eye(4))
        return Frame.of_clouds(f"{k}", [cloud], Objects.empty(), time=7.0 + 0.1 * k)


def detect(points):
    return Detections(np.array([[10.0, 0, 0.8, 4, 2, 1.6, 0]]), np.array([0.9]))


@pytest.mark.parametrize("with_clouds", [False, True])
def test_frames_come_out_in_order_and_clouds_are_written_if_wanted(tmp_path, with_clouds):
    reader = pytest.importorskip("mcap.reader")
    output = OutputConfig({"mcap": tmp_path / "mcap"}, clouds=with_clouds)
    parts = CentreParts(
        [RecordingInput(Recording())],
        Detection(detect, Place("none")),
        interval_s=0.1,
        output=output,
        read=read_in_thread,
    )
    shown = []
    figures = run_centre(parts, HealthLog(None), Event(), show=shown.append)
    assert [frame.frame.index for frame in shown] == [0, 1, 2, 3, 4]
    assert [frame.frame.name for frame in shown] == [f"00000{k}" for k in range(FRAMES)]
    assert [frame.frame.time for frame in shown] == pytest.approx([7.0, 7.1, 7.2, 7.3, 7.4])
    assert figures["frames"] == FRAMES
    (path,) = (tmp_path / "mcap").iterdir()
    with path.open("rb") as file:
        topics = [channel.topic for _, channel, _ in reader.make_reader(file).iter_messages()]
    assert topics.count("/points/north") == (FRAMES if with_clouds else 0)
