"""Sensors that fall silent, freeze, go blind or are pushed aside, and those that do none of it."""

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.centre.sensor_monitor import Fault, SensorMonitor, Shown, farther, standing_before
from toolkit.geometry import look
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

SENSOR = Sensor("a", DepthCamera(width=80, height=60, stride=1), look((-8.0, 0.0, 6.0), 0.0, 0.5))
EMPTY = np.full(SENSOR.model.shape, 20.0, np.float32)
EMPTY[:10] = 0  # sky
SCENE = EmptyScene.from_render(SENSOR, EMPTY)
NOTHING = np.zeros_like(EMPTY)


def measured(seed, image=EMPTY):
    return SENSOR.model.noisy(image, np.random.default_rng(seed))


def with_car(seed, width=12):
    image = EMPTY.copy()
    image[30:40, 20 : 20 + width] = 12.0
    return measured(seed, image)


def whole(time, image):
    return Shown(time, image)


def foreground(time, image):
    sent = ~SCENE.shows(image) & (image > 0)
    return Shown(
        time,
        np.where(sent, np.round(image / 0.02).astype(np.float32) * np.float32(0.02), EMPTY),
        sent,
    )


def watched(messages, covered=None, **settings):
    """The fault at the time of each message, ten a second."""
    monitor = SensorMonitor(SCENE, **settings)
    return [monitor.look(0.1 * k, message, covered) for k, message in enumerate(messages)]


def all_covered():
    return np.ones(EMPTY.shape, bool)


def test_a_working_sensor_is_not_accused():
    for image in (measured, with_car):
        assert watched([whole(0.1 * k, image(k)) for k in range(20)], all_covered) == [None] * 20
    assert (
        watched([foreground(0.1 * k, with_car(k)) for k in range(20)], all_covered) == [None] * 20
    )
    assert (
        watched([foreground(0.1 * k, measured(k)) for k in range(20)]) == [None] * 20
    )  # nobody there


def test_silence_is_noticed():
    last = whole(0.3, measured(0))
    found = watched([whole(0.1 * min(k, 3), measured(min(k, 3))) for k in range(12)])
    assert found == [None] * 9 + [Fault.SILENT] * 3  # more than half a second after 0.3 s
    assert watched([None] * 8, silent_after=0.35) == [None] * 4 + [Fault.SILENT] * 4
    monitor = SensorMonitor(SCENE)
    assert monitor.look(5.0, last) is Fault.SILENT
    assert monitor.look(5.0, whole(4.9, measured(1))) is None
    assert SensorMonitor(SCENE, start=100.0).look(100.4, None) is None


def test_times_from_the_future_do_not_hide_silence():
    for wrong in (3600.0, 0.61, np.nan, np.inf):  # times that switch no monitor off
        monitor = SensorMonitor(SCENE)
        assert monitor.look(0.4, whole(0.4, measured(0))) is None
        assert monitor.look(0.5, whole(wrong, measured(1))) is None
        assert monitor.look(1.0, None) is Fault.SILENT
        assert monitor.look(1.1, whole(1.2, measured(2))) is None  # a clock may be a little ahead
        assert (
            SensorMonitor(SCENE, silent_after=0.4).look(0.5, whole(wrong, measured(1)))
            is Fault.SILENT
        )


def test_wrong_settings_and_images_are_refused():
    with pytest.raises(ValueError, match="above 0"):
        SensorMonitor(SCENE, silent_after=0.0)
    with pytest.raises(
        ValueError, match=r"sensor 'a' measures \(60, 80\) pixels, got an image of \(30, 40\)"
    ):
        SensorMonitor(SCENE).look(0.0, whole(0.0, EMPTY[::2, ::2]))


@pytest.mark.parametrize("sent", [whole, foreground])
def test_frozen_is_noticed_at_the_second_repetition(sent):
    images = [with_car(min(k, 4)) for k in range(9)]
    assert (
        watched([sent(0.1 * k, image) for k, image in enumerate(images)])
        == [None] * 6 + [Fault.FROZEN] * 3
    )
    again = [*images, with_car(99)]
    assert watched([sent(0.1 * k, image) for k, image in enumerate(again)])[-1] is None


def test_shifted_lies_behind_the_scene_and_farther_beyond_it():
    assert watched([whole(0.0, measured(0))] * 5) == [None] * 5
    small = [foreground(0.1 * k, with_car(0, width=4)) for k in range(6)]  # 40 pixels
    assert small[0].sent.sum() == 40
    assert watched(small) == [None] * 6
    pushed = EMPTY.copy()
    pushed[40:, :] = 21.0  # two fifths of what returns
    assert watched([whole(0.1 * k, measured(k, pushed)) for k in range(4)]) == [
        *(None, None, Fault.SHIFTED, Fault.SHIFTED)
    ]
    pushed = EMPTY.copy()
    pushed[40:44, :] = 21.0  # less than a tenth
    assert watched([whole(0.1 * k, measured(k, pushed)) for k in range(4)]) == [None] * 4
    near = np.minimum(EMPTY, np.float32(5))
    assert watched([whole(0.1 * k, measured(k, near)) for k in range(4)]) == [None] * 4
    first = np.full(EMPTY.shape, 20.0, np.float32)
    second = np.full(EMPTY.shape, np.nan, np.float32)
    second[:, 1], second[:, 2], second[:, 3] = 30.0, 10.0, 0.0
    spread, share, none = np.full_like(first, 0.1), np.ones_like(first), np.zeros_like(first)
    scene = EmptyScene("a", SENSOR.model, first, spread, share, second, spread, none, 5)
    image = np.full(EMPTY.shape, 20.5, np.float32)
    assert farther(scene, image)[0, :5].tolist() == [True, False, True, False, True]
    assert not farther(scene, image - np.float32(0.15)).any()
    assert not farther(SCENE, image)[:10].any()  # where nothing returns, everything is nearer


def test_whole_images_show_blindness():
    blind = [whole(0.1 * k, measured(k) if k < 4 else NOTHING) for k in range(9)]
    assert watched(blind) == [None] * 6 + [Fault.BLINDED] * 3
    half = np.where(np.arange(80) < 38, NOTHING, EMPTY).astype(np.float32)
    assert watched([whole(0.1 * k, measured(k, half)) for k in range(5)]) == [None] * 5
    half[:, :44] = 0
    assert watched([whole(0.1 * k, measured(k, half)) for k in range(5)])[-1] is Fault.BLINDED


def test_foreground_shows_blindness_to_what_others_see():
    sent = [foreground(0.1 * k, with_car(k) if k < 4 else NOTHING) for k in range(9)]
    assert watched(sent, all_covered) == [None] * 6 + [Fault.BLINDED] * 3
    assert watched(sent, lambda: np.arange(EMPTY.size).reshape(EMPTY.shape) < 99) == [None] * 9
    assert watched(sent) == [None] * 9


def test_missing_pixels_show_blindness_in_the_view():
    lower = np.zeros(EMPTY.shape, bool)
    lower[30:] = True  # three fifths of what returns

    def dark(k):
        return Shown(0.1 * k, NOTHING, np.zeros(EMPTY.shape, bool), lower)

    assert watched([dark(k) for k in range(5)]) == [None, None, *[Fault.BLINDED] * 3]
    upper = np.zeros(EMPTY.shape, bool)
    upper[:40] = True  # its crop: a third of that is missing
    assert watched([dark(k) for k in range(5)], view=upper) == [None] * 5
    assert watched([dark(k) for k in range(5)], view=~upper)[-1] is Fault.BLINDED


def test_others_are_asked_only_about_hardly_a_pixel():
    def never():
        raise AssertionError("asked")

    assert watched([foreground(0.1 * k, with_car(k)) for k in range(3)], never) == [None] * 3
    few = [foreground(0.1 * k, with_car(k, width=4)) for k in range(4)]
    seen = few[0].sent.copy()
    seen[50:, :20] = True  # 200 pixels more: a fifth of what others see is shown
    assert watched(few, lambda: seen) == [None] * 4
    seen[45:, :60] = True
    assert watched(few, lambda: seen)[-1] is Fault.BLINDED


def test_where_an_object_must_be_seen():
    rays = SENSOR.world_rays
    ground = (0.0 - SENSOR.position[2]) / np.minimum(rays[2], -1e-3)
    depth = np.where(ground < 100, ground, 0).reshape(EMPTY.shape).astype(np.float32)
    scene = EmptyScene.from_render(SENSOR, depth)
    box = np.array([[4.0, 1.0, 0.75, 4.0, 2.0, 1.5, 0.3]])
    covered = standing_before(scene, SENSOR, box)
    assert 20 < covered.sum() < 80
    _, columns = np.nonzero(covered)
    assert columns.mean() < 39.5  # y to the left
    centre = (SENSOR.pose[:3, :3].T @ (box[0, :3] - SENSOR.position)) / 1.0
    assert abs(columns.mean() - (40 + 40 * centre[0] / centre[2])) < 3
    assert not standing_before(
        scene, SENSOR, box + np.array([0, 0, -2.0, 0, 0, 0, 0])
    ).any()  # below the ground
    assert not standing_before(
        scene, SENSOR, box - np.array([20.0, 0, 0, 0, 0, 0, 0])
    ).any()  # behind the sensor
    assert not standing_before(
        EmptyScene.from_render(SENSOR, np.minimum(depth, np.float32(9))), SENSOR, box
    ).any()
    assert not standing_before(scene, SENSOR, np.zeros((0, 7))).any()
