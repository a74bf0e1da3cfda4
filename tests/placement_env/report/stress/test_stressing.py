"""Schemes under stress, on ground with blocks that drive."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from placement_env.report.stress.stressing import kinds_for, stress
from toolkit.detection.evaluation import evaluate_dataset
from toolkit.detection.link.foreground import Foreground
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = np.array([-20.0, -20.0, 20.0, 20.0])
SENSORS = tuple(
    Sensor(name, DepthCamera(width=45, height=30, stride=1), look((-8.0, y, 6.0), 0.0, 0.5))
    for name, y in (("a", -3.0), ("b", 3.0))
)
SPEED = 10.0  # m/s


class Driving:
    """A block that drives along x on flat ground, 0.3 m a side seen from above: a column of points for its detector."""

    site = Site("plain", AREA)
    sensors = SENSORS

    def __init__(self, frames=30, apart=0.1):
        self.frames, self.apart = frames, apart

    def __len__(self):
        return self.frames

    def box(self, k):
        return np.array([[-4.0 + SPEED * self.apart * k % 16, 0.0, 1.0, 4.0, 2.0, 2.0, 0.0]])

    def __getitem__(self, k):
        return scene(self.box(k).tobytes(), self.apart * k, k)


@lru_cache(maxsize=100)
def scene(box, time, index):
    box, images = np.frombuffer(box).reshape(1, 7), []
    for sensor in SENSORS:
        rays = sensor.world_rays.reshape(3, *sensor.model.shape)
        down = np.minimum(rays[2], -0.05)
        ground = (0.05 - sensor.position[2]) / down
        top = (2.0 - sensor.position[2]) / down
        x, y = sensor.position[0] + rays[0] * top, sensor.position[1] + rays[1] * top
        cx, cy = box[0, :2]
        on = (np.abs(x - cx) < 2) & (np.abs(y - cy) < 1) & (rays[2] < -0.05)
        images.append(np.where(on, top, np.where((rays[2] < -0.05) & (ground < 60), ground, 0)).astype(np.float32))
    objects = Objects(box.copy(), np.array([0]), np.array([1]))
    return Frame(SENSORS, tuple(images), objects, time, index)


class Tops:
    """A car about the middle of what is higher than a metre and a half."""

    digest = "tops"

    def __call__(self, points):
        high = points[points[:, 2] > 1.5]
        if len(high) < 5:
            return Detections.empty()
        x, y = (high[:, :2].min(axis=0) + high[:, :2].max(axis=0)) / 2
        return Detections(np.array([[x, y, 1.0, 4.0, 2.0, 2.0, 0.0]]), np.array([0.9]))


def by(rows, **wanted):
    return [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]


@pytest.fixture(scope="module")
def rows():
    both = stress(Driving(), Tops(), schemes=["early", "foreground"], kinds=("bytes", "silent", "frozen"))
    return both + stress(Driving(), Tops(), schemes=["foreground"], kinds=("delay", "rate"))


def test_bytes_are_those_of_an_evaluation_after_the_first_second(rows):
    class Later(Driving):
        def __len__(self):
            return 20

        def __getitem__(self, k):
            return replace(Driving.__getitem__(self, k + 10), index=k + 10)

    found = {(row.scheme, row.codec): row for row in by(rows, kind="bytes")}
    steps = ["2 cm", "4 cm", "8 cm"]
    assert list(found) == [("early", "paper"), *(("early", s) for s in steps), *(("foreground", s) for s in steps)]
    exact = evaluate_dataset(Later(), Tops(), schemes=["early"], iou_thresholds=[0.7], noise_seed=None)[0]
    assert found["early", "paper"].judged.ap == pytest.approx(exact.ap, abs=0.02)
    assert found["early", "paper"].kbit_per_sensor == pytest.approx(exact.kbit_per_sensor, rel=0.02)
    early = [found["early", step].kbit_per_sensor for step in steps]
    assert exact.kbit_per_sensor > early[0] > early[1] > early[2]
    kbit = [found["foreground", step].kbit_per_sensor for step in steps]
    assert kbit[0] > kbit[1] > kbit[2] > 0.3
    judged = found["foreground", "2 cm"].judged
    assert 0.5 < judged.low <= judged.ap <= judged.high <= 1
    assert judged.ap > 0.85
    assert (judged.vehicles, judged.frames, judged.kind) == (20, 20, "vehicle")


def test_delay_costs_what_drives_and_tracks_give_it_back(rows):
    late = {row.level: row for row in by(rows, kind="delay")}
    assert late["0.3 s"].judged.ap == 0
    assert late["0.3 s"].age == pytest.approx(0.35, abs=0.06)
    assert late["0.3 s, tracks"].judged.ap > 0.3  # sensors of different ages smear the car, which no track can mend
    assert late["0.3 s, tracks"].kbit_per_sensor == late["0.3 s"].kbit_per_sensor


def test_a_lower_rate_is_as_old_as_it_is_rare(rows):
    rate = by(rows, kind="rate", level="every 5 frames")[0]
    assert rate.age == pytest.approx(0.2, abs=0.01)
    assert rate.judged.ap < by(rows, kind="rate", level="every 5 frames, tracks")[0].judged.ap


def test_one_silent_sensor_leaves_the_other_and_a_frozen_one_shows_ghosts(rows):
    assert [row.level for row in by(rows, kind="silent", scheme="early")] == ["a", "b"]
    assert all(row.judged.ap > 0.5 for row in by(rows, kind="silent"))
    assert all(row.judged.ap < 0.5 for row in by(rows, kind="frozen", scheme="early"))


def test_what_a_recording_can_show():
    assert "delay" in kinds_for(Driving())
    assert kinds_for(Driving(apart=5.0)) == ("bytes", "pose", "mounting", "silent", "pairs", "blinded", "frozen")
    assert kinds_for(Driving(), ["loss"]) == ("loss",)
    with pytest.raises(ValueError, match=r"'delay' needs frames at most 0\.5 s apart, these are 5 s"):
        kinds_for(Driving(apart=5.0), ["delay"])
    with pytest.raises(ValueError, match="choose among bytes"):
        kinds_for(Driving(), ["storm"])


def test_pose_errors_and_blinded_sensors_far_apart_and_progress():
    done = []
    rows = stress(
        Driving(4, 5.0), Tops(), schemes=[Foreground()], kinds=["pose", "blinded"], frames=3,
        progress=lambda *counts: done.append(counts),
    )  # fmt: skip
    assert [row.level for row in rows[:6]] == [f"{x} m, {x}°" for x in ("0", "0.1", "0.2", "0.4", "0.6", "1")]
    assert [row.level for row in rows[6:]] == ["a", "b"]
    assert [row.amount for row in rows] == [0, 0.1, 0.2, 0.4, 0.6, 1, None, None]
    assert done[0] == (1, 24)
    assert done[-1] == (24, 24)
    assert {row.judged.frames for row in rows} == {3}
    assert len({row.judged.ap for row in rows[:3]} | {row.kbit_per_sensor for row in rows}) > 2


def test_nonsense_is_refused():
    for wrong, said in (
        ({"schemes": []}, "a scheme to stress"),
        ({"ious": ()}, "and an IoU"),
        ({"frames": 0}, "a frame to stress"),
        ({"label": "ox"}, "ox"),
    ):
        with pytest.raises(ValueError, match=said):
            stress(Driving(), Tops(), kinds=["bytes"], **wrong)
