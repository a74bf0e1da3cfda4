from dataclasses import replace

import numpy as np
import pytest

from toolkit.objects import Objects
from toolkit.sensors.errors.clock import ClockOffset, velocities


def moved(objects, by):
    boxes = objects.boxes.copy()
    boxes[:, :3] += by
    return Objects(boxes, objects.labels, objects.ids)


def test_velocities_of_tracks(street):
    now, speed = street.objects, np.array([[10.0, 0, 0], [0, -5, 0], [1, 1, 0], [0, 0, 0]])
    before, after = (moved(now, speed * t) for t in (-0.1, 0.1))
    both = velocities(now, 4.0, [(before, 3.9), (after, 4.1)])
    assert np.allclose(both, speed)
    one = velocities(now, 4.0, [(after[[3, 0]], 4.1)])
    assert np.allclose(one, [[10, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert np.allclose(velocities(now, 4.0, [(before[[1]], 3.9), (after, 4.1)]), speed)


@pytest.mark.parametrize("times", [(), (5.0,), (3.9, 9.0), (4.0,)])
def test_frames_far_apart_do_not_say_velocities(street, times):
    with pytest.raises(ValueError, match=r"velocities need frames at most 0.5 s apart, got .*leave the clock's offset"):
        velocities(street.objects, 4.0, [(street.objects, time) for time in times])


def test_points_on_a_car_move_by_its_velocity_times_the_offset(read, street):
    speed = np.array([[10.0, 2, 0], [0, 0, 0], [-4, 0, 0], [0, 0, 0]])
    said = read(ClockOffset(0.02), replace(street, velocities=speed))
    late = np.random.default_rng([0, 1, 5, 1]).standard_normal() * 0.02
    for row in range(4):
        assert np.allclose(said.shift[street.owners == row], speed[row] * late, atol=1e-6)
    assert not said.shift[street.owners < 0].any()
    assert said.measurement is street.measurement
    again = read(ClockOffset(0.02), replace(street, velocities=speed), frame=99)
    assert np.array_equal(again.shift, said.shift)  # constant over a recording


def test_a_drop_before_a_car_stays(read, street):
    speed = np.full((4, 3), 10.0)
    near = np.where(street.owners == 0, np.float32(2.0), street.measurement)
    from toolkit.sensors.errors.draws import Draws
    from toolkit.sensors.errors.reading import Reading

    reading = replace(Reading.of(replace(street, velocities=speed)), measurement=near)
    said = ClockOffset(0.05).apply(reading, Draws(0, 1, 2, 3))
    assert said.shift is not None
    assert not said.shift[street.owners == 0].any()
    assert said.shift[street.owners == 1].any()


def test_it_needs_velocities_unless_it_has_no_strength(read, harmless, street):
    assert ClockOffset().needs_velocities
    harmless(ClockOffset(), street)
    with pytest.raises(ValueError, match="needs the objects' velocities"):
        read(ClockOffset(0.01), street)
    with pytest.raises(ValueError, match="offset of ClockOffset"):
        ClockOffset(-1.0)
