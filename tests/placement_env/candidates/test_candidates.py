"""Candidates are found by factors, counted by mount, selected in order; sensors look where they are
aimed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from placement_env.candidates.candidates import Candidates, aim_sensor, aims, find_repeat, pool
from toolkit.geometry import look, pose
from toolkit.sensors.models import DepthCamera, SolidStateLidar, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Mount, Site


def square() -> Site:
    """A 40 m square with three mounts along its southern edge, each dearer than the one before."""
    stand = tuple(
        Mount(f"p{i}", np.array([10.0 * i - 10.0, -20.0, 0.5]), price=1.0 + i) for i in range(3)
    )
    return Site("square", np.array([-20.0, -20.0, 20.0, 20.0]), mounts=stand)


def sets(candidates: Candidates, *chosen: tuple[int, ...]) -> np.ndarray:
    rows = np.zeros((len(chosen), len(candidates)), bool)
    for row, members in zip(rows, chosen, strict=True):
        row[list(members)] = True
    return rows


def test_candidates_are_found_by_their_factors():
    candidates = pool(square(), headings=4)
    assert (candidates.at(*candidates.factors.T) == np.arange(len(candidates))).all()
    assert (
        candidates.at(3, 0, 0, 0, 0)
        == candidates.at(-1, 0, 1, 0, 0)
        == candidates.at(0, 99, 1, 0, 0)
        == -1
    )
    assert candidates.at(np.array([[0], [99]]), 0, 1, 0, 0).tolist() == [
        [candidates.at(0, 0, 1, 0, 0)],
        [-1],
    ]
    assert candidates.select([]).at(0, 0, 0, 0, 0) == -1


def test_sensors_are_counted_by_mount():
    candidates = pool(square(), headings=4, blind=True)
    first, second, third = (np.flatnonzero(candidates.mount == m) for m in range(3))
    subsets = sets(
        candidates, (), (first[0],), (first[0], first[1]), (first[0], second[0], third[0])
    )
    assert candidates.per_mount(subsets).tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 1]]
    assert candidates.prices[third[0]] == 3.0
    assert candidates.capacity[third[0]] == 2000.0


def test_selected_candidates_keep_their_factors():
    candidates = pool(square())
    chosen = candidates.select([7, 3])
    assert chosen.sensors == (candidates.sensors[7], candidates.sensors[3])
    assert chosen.at(*candidates.factors[3]) == 1
    assert chosen.at(*candidates.factors[4]) == -1


def test_sensors_look_along_their_axis():
    camera = Sensor("c", DepthCamera(), look((0.0, 0.0, 5.0), 1.0, 0.5))
    lidar = Sensor("l", SpinningLidar(channels=4), pose(0.0, 0.0, 5.0, yaw=-2.0, pitch=0.1))
    headings, tilts = aims([camera, lidar])
    assert np.allclose(headings, [1.0, -2.0])
    assert np.allclose(tilts, [0.5, 0.1])
    assert [len(each) for each in aims([])] == [0, 0]


def test_broken_candidates_and_repeated_names_are_refused():
    good = pool(square())
    twice = (good.sensors[0], *good.sensors[:-1])
    for broken in (
        {"sensors": good.sensors[1:]},
        {"sensors": twice},
        {"factors": good.factors + 1},
        {"mounts": ()},
    ):
        with pytest.raises(ValueError):
            replace(good, **broken)
    assert find_repeat(["a", "b", "c", "b", "a"]) == "b"
    good = pool(square())
    twice = (good.sensors[0], good.sensors[0], *good.sensors[2:])
    with pytest.raises(ValueError, match=f"{good.sensors[0].name}' twice"):
        replace(good, sensors=twice)


MODELS = [DepthCamera(), SpinningLidar(channels=4), SolidStateLidar()]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@given(heading=st.floats(-3.1, 3.1), tilt=st.floats(-1.4, 1.4))
def test_a_sensor_looks_where_it_is_aimed(model, heading, tilt):
    sensor = aim_sensor(Sensor("s", model, np.eye(4)), np.array([1.0, -2.0, 6.0]), heading, tilt)
    assert np.allclose(aims([sensor]), [[heading], [tilt]], atol=1e-9)
    assert sensor.position.tolist() == [1.0, -2.0, 6.0]
    assert (sensor.name, sensor.model) == ("s", model)
