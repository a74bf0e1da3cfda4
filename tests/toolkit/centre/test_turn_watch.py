"""Sensors of the T-junction turned by two degrees, and one that is not."""

from concurrent.futures import Future

import numpy as np
import pytest

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.centre.turn_watch import IMAGE_EVERY_S, MAX_ROUND_S, TurnProcess, TurnWatch, find_turn
from toolkit.geometry import pose
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site

SITE = load_site("tjunction")
AXES = ("x", "y", "z")
ANGLE = np.deg2rad(2.0)


def turn_about(axis):
    """Turn by two degrees about an axis of the world through the origin."""
    if axis == 2:
        return pose(yaw=ANGLE)
    turn = np.eye(4)
    i, j = ((1, 2), (2, 0))[axis]
    turn[i, i] = turn[j, j] = np.cos(ANGLE)
    turn[i, j], turn[j, i] = -np.sin(ANGLE), np.sin(ANGLE)
    return turn


@pytest.fixture(scope="module")
def rendered():
    """Two sensors with their empty scenes, and images of each by its turn: none, x, y, z."""
    sensors = SITE.sensors[:2]
    variants = list(sensors)
    for sensor in sensors:
        for axis in range(3):
            turned = sensor.pose.copy()
            turned[:3, :3] = turn_about(axis)[:3, :3] @ turned[:3, :3]
            variants.append(Sensor(f"{sensor.name}{AXES[axis]}", sensor.model, turned))
    images = Renderer(SITE, (), variants, threads=1).background
    by_name = {sensor.name: image for sensor, image in zip(variants, images, strict=True)}
    scenes = {
        sensor.name: EmptyScene.from_render(sensor, by_name[sensor.name]) for sensor in sensors
    }
    return {sensor.name: sensor for sensor in sensors}, scenes, by_name


def noisy(sensor, image, count=8):
    rng = np.random.default_rng(4)
    return [sensor.model.noisy(image, rng) for _ in range(count)]


@pytest.mark.parametrize("axis", AXES)
def test_a_turn_is_found_about_each_axis(rendered, axis):
    sensors, scenes, images = rendered
    sensor = sensors["d0"]
    turn = find_turn(scenes["d0"], sensor.pose, noisy(sensor, images[f"d0{axis}"]))
    assert turn == pytest.approx(ANGLE, abs=np.deg2rad(0.3))


def test_no_turn_is_found_of_a_sensor_as_mounted(rendered):
    sensors, scenes, images = rendered
    assert find_turn(scenes["d1"], sensors["d1"].pose, noisy(sensors["d1"], images["d1"])) == 0.0


class NowFinder:
    """Finder that is done when it is asked."""

    def submit(self, *job):
        future = Future()
        future.set_result(find_turn(*job))
        return future


def test_the_turned_sensor_is_named_in_time_and_no_other(rendered):
    sensors, scenes, images = rendered
    watch = TurnWatch(sensors, scenes, NowFinder())
    rng = np.random.default_rng(1)
    onset_s = 6.0
    time_s = 0.0
    while not watch.turned and time_s < 60.0:
        time_s += IMAGE_EVERY_S
        shown = "d0y" if time_s >= onset_s else "d0"
        watch.look("d0", sensors["d0"].model.noisy(images[shown], rng), time_s)
        assert not watch.look("d1", sensors["d1"].model.noisy(images["d1"], rng), time_s)
    assert watch.turned == {"d0"}
    assert onset_s < time_s <= onset_s + min(30.0, 3 * MAX_ROUND_S)


class ScriptedFinder:
    """Finder that gives turns (rad) in the order of a list, and notes whose they are."""

    def __init__(self, turns):
        self.turns = list(turns)
        self.names = []

    def submit(self, scene, world_SE3_sensor, images):
        self.names.append(scene.name)
        future = Future()
        future.set_result(self.turns.pop(0))
        return future


def watch_turns(rendered, turns):
    """Watch over two sensors until a finder has given all turns; return it and the watch."""
    sensors, scenes, images = rendered
    finder = ScriptedFinder(turns)
    watch = TurnWatch(sensors, scenes, finder)
    time_s = 0.0
    while finder.turns:
        time_s += IMAGE_EVERY_S
        for name in sensors:
            watch.look(name, images[name], time_s)
    watch.look("d0", images["d0"], time_s)
    return finder, watch


def test_a_failed_registration_neither_ends_nor_confirms_a_turn(rendered):
    # checks are of d0, d1, d0 and so on, but d0 is checked again once it seems turned
    finder, watch = watch_turns(rendered, [ANGLE, ANGLE, 0.0, None])
    assert finder.names == ["d0", "d0", "d1", "d0"]
    assert watch.turned == {"d0"}
    finder, watch = watch_turns(rendered, [ANGLE, None, 0.0, ANGLE])
    assert finder.names == ["d0", "d0", "d1", "d0"]  # d1 gets its turn though d0 is open
    assert watch.turned == {"d0"}
    assert not watch_turns(rendered, [ANGLE, None, 0.0, None])[1].turned
    assert not watch_turns(rendered, [ANGLE, None, 0.0, 0.0])[1].turned
    _, watch = watch_turns(rendered, [ANGLE, ANGLE, 0.0, None, 0.0, 0.0])
    assert not watch.turned


@pytest.mark.slow
def test_another_process_finds_the_same(rendered):
    sensors, scenes, images = rendered
    job = (scenes["d0"], sensors["d0"].pose, noisy(sensors["d0"], images["d0x"]))
    process = TurnProcess()
    assert process.submit(*job).result(timeout=120) == pytest.approx(find_turn(*job))
    process.close()
