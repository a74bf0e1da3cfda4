from dataclasses import replace

import numpy as np
import pytest

from toolkit.sensors.errors.draws import Draws

BASE = Draws(seed=3, sensor=5, frame=7, term=11)


def first(rng):
    return rng.random()


def test_each_stream_depends_on_what_it_is_drawn_for_and_on_nothing_else():
    at = np.array([1.0, 2.0, 6.0])
    streams = {
        "of_frame": (lambda d: first(d.of_frame()), {"seed", "sensor", "frame", "term"}),
        "of_sensor": (lambda d: first(d.of_sensor()), {"seed", "sensor", "term"}),
        "of_pole": (lambda d: first(d.of_pole(at)), {"seed", "term"}),
        "of_objects": (lambda d: d.of_objects(np.array([4]))[0], {"seed", "term"}),
        "own_noise": (lambda d: first(d.own_noise()), {"seed", "sensor", "frame"}),
    }
    values = {name: draw(BASE) for name, (draw, _) in streams.items()}
    assert len(set(values.values())) == len(values)
    for name, (draw, on) in streams.items():
        for field in ("seed", "sensor", "frame", "term"):
            other = draw(replace(BASE, **{field: getattr(BASE, field) + 1}))
            assert (other != values[name]) == (field in on), (name, field)


def test_the_own_noise_is_drawn_as_it_always_was():
    assert first(BASE.own_noise()) == np.random.default_rng([3, 7, 5]).random()


def test_objects_keep_their_number_in_any_company():
    together = BASE.of_objects(np.array([4, -1, 2**40, 4]))
    assert together.tolist() == [BASE.of_objects(np.array([each]))[0] for each in (4, -1, 2**40, 4)]
    assert len(set(together.tolist())) == 3
    assert BASE.of_objects(np.zeros(0, np.int64)).shape == (0,)
    many = BASE.of_objects(np.arange(2000))
    assert many.mean() == pytest.approx(0.5, abs=0.03)


def test_sensors_of_one_pole_share_its_numbers():
    one, above, beside = (np.array(p) for p in ([-3.0, 2.0, 5.0], [-3.001, 2.0, 6.0], [-3.02, 2.0, 5.0]))
    assert first(BASE.of_pole(one)) == first(replace(BASE, sensor=6).of_pole(above)) != first(BASE.of_pole(beside))
