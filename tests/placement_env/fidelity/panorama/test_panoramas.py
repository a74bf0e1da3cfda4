"""Panoramas of all frames: which sensors they serve, what is kept, and that processes make no
difference."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity import seeing
from placement_env.fidelity.seeing import choose_quick, look_round
from toolkit.geometry import look
from toolkit.objects import VEHICLE
from toolkit.rendering.strips import SuccessiveStrips
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor

CAMERA = DepthCamera(width=80, height=60)
AT = (-22.0, -16.0, 6.0)
SENSORS = [Sensor(str(k), CAMERA, look(AT, k - 2.0, 0.3)) for k in range(4)]


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.fixture(scope="module")
def seen(small_traffic):
    return look_round(small_traffic, SENSORS, (VEHICLE,))


def test_panoramas_are_worthwhile_for_far_sighted_sensors_in_one_place(small_traffic):
    elsewhere = Sensor("e", CAMERA, look((0.0, 0.0, 5.0), 0.0))
    for sensors, quick in (
        *(
            (SENSORS, True),
            (SENSORS[:3], False),
            ([*SENSORS, elsewhere], False),
            ([*SENSORS * 2, elsewhere], True),
        ),
    ):
        assert choose_quick(sensors, small_traffic, "auto").tolist() == [quick] * len(sensors)
    assert not choose_quick(SENSORS, small_traffic, "full").any()
    ranges = [30.0, 50.0, 56.0, 120.0]
    lidars = [Sensor(f"{r}", SpinningLidar(max_range=r), look(AT, 0.0)) for r in ranges]
    assert choose_quick(lidars, small_traffic, "panorama").tolist() == [
        *(False, False, True, True)
    ]  # 42 by 30 m, and height
    first, second, *_ = small_traffic.snapshots
    traffic = replace(small_traffic, snapshots=(first, first, second, first))
    job = seeing.RoundLook(traffic, tuple(SENSORS), (VEHICLE,))
    for block in (seeing.Block(0, 4), seeing.Block(2, 4), seeing.Block(1, 2)):
        assert same(job(block), seeing.RoundLook(traffic, tuple(SENSORS), (VEHICLE,))(block))


def test_blocks_and_processes_make_no_difference(small_traffic, seen, limits):
    limits(seeing, VIEW_BLOCK_FRAMES=2)
    told: list[int] = []
    assert same(
        look_round(
            small_traffic, SENSORS, (VEHICLE,), Run(progress=lambda *stage: told.append(stage[1]))
        ),
        seen,
    )
    assert told == [1, 3, 4]
    job = seeing.RoundLook(small_traffic, tuple(SENSORS), (VEHICLE,))
    job(seeing.Block(0, 1))
    again = pickle.loads(pickle.dumps(job))
    assert "_stills" not in vars(again)
    block = seeing.Block(0, 2)
    assert same(again(block), job(block))


def test_a_short_look_serves_the_longer_one_after_it(small_traffic, seen, limits, monkeypatch):
    limits(seeing, VIEW_BLOCK_FRAMES=2)
    looked: list[int] = []
    find_next = SuccessiveStrips.find_next

    def count(*arguments):
        looked.append(1)
        return find_next(*arguments)

    monkeypatch.setattr(SuccessiveStrips, "find_next", count)
    first = look_round(small_traffic.part(0, 2), SENSORS, (VEHICLE,))
    assert same(look_round(small_traffic, SENSORS, (VEHICLE,)), seen)
    assert len(looked) == len(small_traffic)
    assert same(look_round(small_traffic.part(0, 2), SENSORS, (VEHICLE,)), first)
    assert len(looked) == len(small_traffic)
    look_round(small_traffic.part(0, 2), SENSORS[:2], (VEHICLE,))
    assert len(looked) == len(small_traffic) + 2


def test_a_sensor_sees_the_same_beside_others(small_traffic, seen):
    other = Sensor("other", CAMERA, look((22.0, 16.0, 5.0), -2.4, 0.1))
    together = look_round(small_traffic, [other, *SENSORS[::-1]], (VEHICLE,))
    assert same([each[:0:-1] for each in together], seen)


def test_what_is_kept_is_not_made_again(small_traffic, seen, limits, fail, change_code, tmp_path):
    run = Run(cache=tmp_path)
    limits(seeing, VIEW_BLOCK_FRAMES=4)
    assert same(look_round(small_traffic, SENSORS, (VEHICLE,), run), seen)
    assert len(run.memo) == 2
    fail(SuccessiveStrips, "find_next", AssertionError("made again"))
    assert same(look_round(small_traffic, SENSORS, (VEHICLE,), run), seen)
    turned = [*SENSORS[:3], Sensor("3", CAMERA, look(AT, 2.0, 0.3))]
    others = replace(small_traffic, snapshots=small_traffic.snapshots[::-1])
    for traffic, sensors, labels in (
        *((small_traffic, turned, (0,)), (small_traffic, SENSORS, (0, 1)), (others, SENSORS, (0,))),
    ):
        with pytest.raises(AssertionError, match="made again"):
            look_round(traffic, sensors, labels, run)
    change_code(seeing.__name__)
    with pytest.raises(AssertionError, match="made again"):
        look_round(small_traffic, SENSORS, (VEHICLE,), run)
