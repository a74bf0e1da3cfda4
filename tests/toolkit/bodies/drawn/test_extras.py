from dataclasses import replace

import numpy as np
import pytest

from toolkit.bodies.drawn.extras import CARRIED, TRAILERS, mirrors, on_roof, trailer
from toolkit.bodies.drawn.proportions import drawn_proportions

CARS = [drawn_proportions(np.random.default_rng([6, k])) for k in range(300)]


def test_mirrors_stick_out_by_8_to_25_cm_on_both_sides_or_on_one_or_there_are_none():
    sides = []
    for number, car in enumerate(CARS):
        vertices = mirrors(car, np.random.default_rng([1, number])).vertices
        beyond = vertices[np.abs(vertices[:, 1]) > car.width / 2 + 1e-6]
        sides.append(len(set(np.sign(beyond[:, 1]).tolist())))
        if len(beyond):
            assert 0.079 < np.abs(beyond[:, 1]).max() - car.width / 2 < 0.256
            assert (beyond[:, 0] > 0).all()
            assert (beyond[:, 2] > 0.4 * car.height).all()
            assert (beyond[:, 2] < car.height).all()
    assert np.mean(np.array(sides) == 0) == pytest.approx(0.3, abs=0.07)
    assert 0 < np.mean(np.array(sides) == 1) < 0.06


def test_what_is_on_a_roof_stands_on_it():
    seen = set()
    for number, car in enumerate(CARS):
        carried, load = on_roof(car, np.random.default_rng([2, number]))
        seen.add(carried)
        assert bool(carried) == bool(len(load.triangles))
        if carried in ("taxi", "light_bar", "roof_box", "rack", "rails"):
            low, high = load.vertices.min(axis=0), load.vertices.max(axis=0)
            assert car.height - 0.08 < low[2] < car.height + 0.05, carried
            assert car.height < high[2] < car.height + 0.5, carried
            assert max(-low[1], high[1]) < car.width / 2
            assert max(-low[0], high[0]) < 0.62 * car.length
    assert seen == {"", *CARRIED}


def test_a_pick_ups_load_lies_in_its_bed():
    pickup = next(car for car in CARS if car.kind == "pickup")
    for number in range(40):
        carried, load = on_roof(pickup, np.random.default_rng(number))
        if carried == "load":
            low, high = load.vertices.min(axis=0), load.vertices.max(axis=0)
            assert low[0] > -pickup.length / 2
            assert high[0] < 0
            assert high[1] - low[1] < 0.8 * pickup.width


def test_a_trailer_follows_its_car_on_wheels():
    seen = set()
    for number in range(30):
        car = replace(CARS[number], height=1.5)
        kind, mesh = trailer(car, np.random.default_rng(number))
        seen.add(kind)
        assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert -car.length / 2 < mesh.vertices[:, 0].max() < -car.length / 2 + 0.2
        assert -car.length / 2 - 8.5 < mesh.vertices[:, 0].min() < -car.length / 2 - 2.5
        assert 1.3 < np.ptp(mesh.vertices[:, 1]) < 2.6
    assert seen == set(TRAILERS)
