import zlib
from dataclasses import dataclass, replace

import numpy as np
import pytest

from toolkit.datasets.recording_views import read_frame, with_errors
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import PAPER_ERRORS, POOR, TYPICAL
from toolkit.sensors.error_terms import Calibration, ClockOffset
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor

SENSORS = (
    Sensor("camera", DepthCamera(width=80, height=60, stride=1), look((-15.0, 0.0, 5.0), 0.0, 0.3)),
    Sensor("lidar", SpinningLidar(channels=16, azimuth_step=0.05), pose(0.0, 9.0, 4.0)),
    Sensor("flash", SolidStateLidar(rows=16, columns=60), pose(0.0, -9.0, 4.0, yaw=1.0)),
)
BOXES = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0], [4.0, 5, 0.75, 4, 2, 1.5, 1.0]])
AREA = [-40, -40, 40, 40]


def frame_at(k, apart=0.1):
    depths = []
    for sensor in SENSORS:
        down = sensor.world_rays[2].reshape(sensor.model.shape)
        with np.errstate(divide="ignore"):
            # half a metre above the ground
            depth = np.where(down < -0.05, -(sensor.position[2] - 0.5) / down, 0)
        depths.append(depth.astype(np.float32))
    boxes = BOXES + np.array([10.0 * apart * k, 0, 0, 0, 0, 0, 0])
    return Frame(SENSORS, tuple(depths), Objects(boxes, ids=np.array([3, 5])), apart * k, k)


@dataclass
class Frames:
    apart: float = 0.1

    def __len__(self):
        return 4

    def __getitem__(self, k):
        return frame_at(k, self.apart)


def same(one, other):
    return all(
        a.pose.tobytes() == b.pose.tobytes() and m.tobytes() == n.tobytes()
        for a, b, m, n in zip(
            one.sensors, other.sensors, one.images, other.measurements, strict=True
        )
    )


@pytest.mark.parametrize("seed", [0, 7])
def test_paper_is_the_noise_there_was_to_the_bit(seed):
    for k in (0, 3):
        frame, now = frame_at(k), with_errors(frame_at(k), "paper", seed)
        own = [
            np.random.default_rng([seed, k, zlib.crc32(sensor.name.encode())]) for sensor in SENSORS
        ]
        noisy = [
            s.model.noisy(image, rng)
            for s, image, rng in zip(SENSORS, frame.images, own, strict=True)
        ]
        before = replace(frame, measurements=tuple(noisy))
        assert same(now, before)
        assert now.sensors == SENSORS
        assert now.shifts == ()
        assert same(read_frame(Frames(), k, noise_seed=seed), before)
    assert same(read_frame(Frames(), 2, noise_seed=None), frame_at(2))


def test_models_have_the_errors_of_a_profile():
    said, true = with_errors(frame_at(1), POOR, 0), frame_at(1)
    for sensor, before, image, seen in zip(
        said.sensors, SENSORS, said.images, true.measurements, strict=True
    ):
        assert sensor.name == before.name
        assert sensor.model == before.model
        assert 0 < np.linalg.norm(sensor.position - before.position) < 0.3
        assert 0.6 < (image > 0)[seen > 0].mean() < 0.95
        assert image.dtype == np.float32
    assert np.array_equal(said.objects.boxes, true.objects.boxes)
    assert (said.index, said.time) == (true.index, true.time)


def test_errors_of_a_sensor_do_not_depend_on_the_others():
    frame = frame_at(2)
    turned = replace(frame, sensors=frame.sensors[::-1], measurements=frame.images[::-1])
    alone = replace(frame, sensors=frame.sensors[1:2], measurements=frame.images[1:2])
    all_, back, one = (with_errors(each, POOR, 4) for each in (frame, turned, alone))
    for c in range(3):
        assert all_.images[c].tobytes() == back.measurements[2 - c].tobytes()
        assert np.array_equal(all_.sensors[c].pose, back.sensors[2 - c].pose)
    assert one.images[0].tobytes() == all_.measurements[1].tobytes()
    assert same(with_errors(frame, POOR, 4), all_)
    assert not same(with_errors(frame, POOR, 5), all_)


def test_calibration_and_clocks_move_clouds_and_cars():
    poses = [
        [sensor.pose.tolist() for sensor in read_frame(Frames(), k, errors=TYPICAL).sensors]
        for k in range(4)
    ]
    assert poses[0] == poses[1] == poses[3]
    still = replace(frame_at(0), index=1)
    one, two = with_errors(frame_at(0), TYPICAL, 0), with_errors(still, TYPICAL, 0)
    assert not np.array_equal(one.images[0], two.measurements[0])
    moved = ErrorProfile("moved", (Calibration(0.0, 0.5),))
    frame = frame_at(0)
    said = with_errors(frame, moved, 0)
    clouds = (frame_points(each, area=[-900, -900, 900, 900], height=9.0) for each in (frame, said))
    for c, (true, placed) in enumerate(zip(*clouds, strict=True)):
        assert np.array_equal(said.images[c], frame.measurements[c])
        assert np.allclose(placed - true, said.sensors[c].position - SENSORS[c].position, atol=1e-4)
    late = ErrorProfile("late", (ClockOffset(0.05),))
    pair = [
        frame_points(each, area=AREA)
        for each in (frame_at(1), read_frame(Frames(), 1, errors=late))
    ]
    count = 0
    for true, shifted in zip(*pair, strict=True):
        step = shifted - true
        some = np.abs(step).sum(axis=1) > 0
        assert np.allclose(step[:, 1:], 0)
        assert len(np.unique(step[some, 0].round(4))) <= 1
        count += some.sum()
    assert 10 < count < sum(map(len, pair[0])) / 2
    late = ErrorProfile("late", (ClockOffset(0.05),))
    with pytest.raises(ValueError, match=r"at most 0\.5 s apart, got 5 s"):
        read_frame(Frames(5.0), 1, errors=late)
    with pytest.raises(ValueError, match="needs the objects' velocities"):
        with_errors(frame_at(1), late, 0)


def test_no_terms_numbers_for_names_and_what_is_refused():
    frame = frame_at(1)
    before = [image.copy() for image in frame.images]
    assert same(with_errors(frame, ErrorProfile("none", ()), 0), frame)
    with_errors(frame, POOR, 0)
    assert all(np.array_equal(*pair) for pair in zip(before, frame.images, strict=True))
    frame = frame_at(1)
    one, two = (
        with_errors(frame, TYPICAL, 0, numbers=numbers) for numbers in ([9, 8, 7], [9, 1, 2])
    )
    assert np.array_equal(one.images[0], two.measurements[0])
    assert not np.array_equal(one.images[1], two.measurements[1])
    with pytest.raises(ValueError, match="seed must not be negative, got -1"):
        with_errors(frame_at(0), PAPER_ERRORS, -1)
    with pytest.raises(ValueError, match="unknown error profile 'rotten'"):
        read_frame(Frames(), 0, errors="rotten")
    with pytest.raises(ValueError, match="drawn from a seed"):
        read_frame(Frames(), 0, errors="typical", noise_seed=None)
    with pytest.raises(ValueError, match="3 sensors but 1 shifts"):
        replace(frame_at(0), shifts=(None,))
