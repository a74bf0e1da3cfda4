"""Recordings can be copied and pickled: a copy reads the same frames, in another process too."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from toolkit.datasets.recording_views import Part
from toolkit.datasets.recordings import LAYOUTS, open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects

WRITTEN = sorted(name for name, layout in LAYOUTS.items() if layout.writer)
POINTS = np.array([[9.0, 0.5, -4.0], [11.0, -0.5, -4.5]], np.float32)


def write(folder: Path, layout: str) -> Path:
    cloud = SensorCloud("lidar", POINTS, pose(1.0, yaw=0.5))
    box = Objects(np.array([[10.0, 0, -4.25, 4.2, 1.8, 1.5, 0]]))
    frames = [Frame.of_clouds(str(k), (cloud,), box, time=1.7e9 + 0.1 * k) for k in range(3)]
    place = folder / "clouds.hdf5" if layout == "hdf5" else folder
    write_recording(frames, place, layout)
    return place / "bag" if layout == "rosbag" else place


def same(a: Frame, b: Frame) -> bool:
    return (
        a.points().tolist() == b.points().tolist()
        and a.objects.boxes.tolist() == b.objects.boxes.tolist()
    )


@pytest.mark.filterwarnings("ignore:.*no place for labels")
@pytest.mark.parametrize("layout", WRITTEN)
def test_copies_read_the_same_frames(tmp_path, layout):
    pytest.importorskip({"rosbag": "rosbags", "argoverse": "pyarrow"}.get(layout, "numpy"))
    recording = open_recording(write(tmp_path, layout), layout)
    middle = recording[1]
    for copied in (
        copy.copy(recording),
        copy.deepcopy(recording),
        pickle.loads(pickle.dumps(recording)),
    ):
        assert len(copied) == 3
        assert same(copied[2], recording[2])
        assert same(copied[1], middle)
    part = pickle.loads(pickle.dumps(Part(recording, every=2)))
    assert same(part[1], recording[2])


def test_a_copy_is_read_in_another_process(tmp_path):
    recording = open_recording(write(tmp_path / "in", "folder"), "folder")
    (tmp_path / "recording.pickle").write_bytes(pickle.dumps(recording))
    code = "import pickle, sys; print(len(pickle.load(open(sys.argv[1], 'rb'))[2].points()))"
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "recording.pickle")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["2"]
