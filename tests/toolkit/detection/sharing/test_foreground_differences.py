"""The scheme that sends differences: the same points as foreground fusion, in fewer bytes where frames follow."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.link.foreground import Foreground
from toolkit.detection.scheme import Scheme
from toolkit.detection.sharing.foreground_differences import ForegroundDifferences
from toolkit.detection.view import frame_view
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor

AREA = (-20.0, -20.0, 20.0, 20.0)
SENSORS = tuple(
    Sensor(name, DepthCamera(width=160, height=120), look((x, 0.0, 5.0), 0.0, 0.4))
    for name, x in (("a", 0.0), ("b", 3.0))
)


def ground(sensor):
    down = sensor.world_rays[2].reshape(sensor.model.shape)
    with np.errstate(divide="ignore"):
        measured = (0.1 - sensor.position[2]) / down
    return np.where((down < 0) & (measured < 60), measured, 0).astype(np.float32)


SCENES = [EmptyScene.of(sensor, ground(sensor)) for sensor in SENSORS]

ROUGH = np.random.default_rng(9).uniform(7, 8, (30, 50))


def frames(count):
    for k in range(count):
        images = []
        for number, sensor in enumerate(SENSORS):
            image = ground(sensor)
            image[22:52, 15:65] = ROUGH
            noisy = sensor.model.noisy(image, np.random.default_rng([k, number]))
            images.append(noisy)
        yield Frame(SENSORS, tuple(images), Objects.empty(), k / 10, k)


def watched():
    calls = []

    def detector(points):
        calls.append(points)
        return Detections(np.array([[len(points), 0, 1, 4, 2, 1.5, 0.0]]), np.array([0.5]))

    return detector, calls


@pytest.mark.parametrize("refers_to", ["previous", "key"])
def test_the_same_points_arrive_in_fewer_bytes(refers_to):
    scheme, memory, bits = ForegroundDifferences(0.04, refers_to, key_every=4), {}, []
    for frame in frames(6):
        detector, calls = watched()
        view = frame_view(frame, detector, AREA, scene=SCENES.__getitem__, memory=memory)
        whole, got = Foreground(0.04).fuse(view, [0, 1]), scheme.fuse(view, [0, 1])
        np.testing.assert_array_equal(calls[0], calls[1])
        bits.append((whole.bits, got.bits))
        assert scheme.sent_bits(view, [0, 1]) == got.bits.tolist()
        assert got.ms > 0
    whole, got = np.array(bits).transpose(1, 0, 2)
    assert ((got == whole).all(axis=1)).tolist() == [True, False, False, False, True, False]
    assert (got[[1, 2, 3, 5]] < 0.9 * whole[[1, 2, 3, 5]]).all()
    assert set(memory) == {(0, scheme.digest), (1, scheme.digest)}


def test_views_that_remember_nothing_send_whole_images():
    scheme = ForegroundDifferences()
    for frame in frames(2):
        view = frame_view(frame, watched()[0], AREA, scene=SCENES.__getitem__)
        assert scheme.fuse(view, [0, 1]).bits.tolist() == Foreground().fuse(view, [0, 1]).bits.tolist()


def test_it_is_a_scheme_and_checks_its_parameters():
    scheme = ForegroundDifferences()
    assert isinstance(scheme, Scheme)
    assert scheme.digest == (
        "ForegroundDifferences(step=0.02, refers_to='previous', key_every=10, sigmas=4.0, name='differences')"
    )
    assert (scheme.codec.step, scheme.predicted_as, scheme.sends_points, scheme.sends_boxes) == (
        0.02, "early", True, False,
    )  # fmt: skip
    for wrong, said in (({"step": 0.0}, "step must be"), ({"sigmas": 0.0}, "sigmas"), ({"key_every": 0}, "every 1")):
        with pytest.raises(ValueError, match=said):
            ForegroundDifferences(**wrong)


@pytest.mark.parametrize(
    ("refers_to", "number", "needed"),
    [
        ("previous", 12, [10, 11, 12]), ("previous", 10, [10]), ("previous", 0, [0]),
        ("key", 13, [10, 13]), ("key", 11, [10, 11]), ("key", 20, [20]),
    ],
)  # fmt: skip
def test_which_messages_must_have_arrived(refers_to, number, needed):
    assert list(ForegroundDifferences(refers_to=refers_to).needed(number)) == needed
