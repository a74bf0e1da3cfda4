import numpy as np
import pytest

from toolkit.bodies.drawn.proportions import CAR_KINDS, HEIGHTS, LENGTHS, WIDTHS, drawn_proportions

CARS = [drawn_proportions(np.random.default_rng([2, k])) for k in range(400)]


def test_shares_are_those_of_the_kinds():
    assert sum(kind.share for kind in CAR_KINDS) == pytest.approx(1)
    for kind in CAR_KINDS:
        assert np.mean([car.kind == kind.name for car in CARS]) == pytest.approx(kind.share, abs=0.055)


def test_measures_lie_in_the_ranges():
    for measure, (low, high) in (("length", LENGTHS), ("width", WIDTHS), ("height", HEIGHTS)):
        values = [getattr(car, measure) for car in CARS]
        assert low <= min(values) < low + 0.1 * (high - low)
        assert high >= max(values) > high - 0.25 * (high - low)


def test_a_car_stands_on_its_wheels_within_its_length():
    for car in CARS:
        front, rear = car.axles
        assert car.wheel < front < rear < car.length - car.wheel
        assert 0.5 * car.length <= rear - front <= 0.78 * car.length, car.kind
        assert car.clearance < car.wheel * 1.1


def test_profiles_run_from_the_front_to_the_rear_and_reach_the_roof():
    for car in CARS:
        stations, heights = car.profile.T
        assert stations[0] == 0
        assert stations[-1] == 1
        assert (np.diff(stations) > 0).all()
        assert heights.max() == 1
        assert heights.min() > 0.2
        assert car.top(np.array([0.0, 1.0])) == pytest.approx(car.height * heights[[0, -1]])
    assert len({car.profile.tobytes() for car in CARS}) == len(CARS)


def test_a_seed_gives_a_car():
    first, again = (drawn_proportions(np.random.default_rng(8)) for _ in range(2))
    assert first.length == again.length
    assert first.profile.tobytes() == again.profile.tobytes()
