"""Empty scenes of a recording, learnt when asked for."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.calibration.recording_scenes import RecordingScenes
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSORS = tuple(Sensor(name, DepthCamera(width=8, height=6), np.eye(4)) for name in "ab")


class Recording(list):
    """Counts what is read."""

    reads = 0

    def __getitem__(self, index):
        self.reads += 1
        return super().__getitem__(index)


def recording():
    images = [np.full((3, 4), 10.0 * (1 + k), np.float32) for k in range(2)]
    return Recording(Frame(SENSORS, tuple(images), Objects.empty(), 0.1 * k, k) for k in range(5))


def test_they_are_learnt_once_and_only_when_asked_for():
    frames = recording()
    scenes = RecordingScenes(frames)
    assert (frames.reads, scenes.digests) == (0, [])
    assert scenes(1).first[0, 0] == pytest.approx(20, abs=0.05)
    assert scenes(0).name == "a"
    assert frames.reads == 5
    assert scenes.digests == [scene.digest for scene in learn_empty_scenes(frames)]


def test_those_given_are_found_by_name():
    given = learn_empty_scenes(recording(), noise_seed=None)
    scenes = RecordingScenes(recording(), given[::-1])
    assert [scenes(k).digest for k in (0, 1)] == [scene.digest for scene in given]
    with pytest.raises(ValueError, match="empty scenes of b, none of a"):
        RecordingScenes(recording(), given[1:])(0)
