from dataclasses import replace

import numpy as np
import pytest

from toolkit.objects import Objects
from toolkit.sensors.readings import Draws, Reading, TrueImage
from toolkit.sensors.sensor import is_return

BASE = Draws(seed=3, sensor=5, frame=7, term=11)


def first(rng):
    return rng.random()


def test_streams_depend_on_what_they_are_drawn_for_alone():
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
    assert first(BASE.own_noise()) == np.random.default_rng([3, 7, 5]).random()
    together = BASE.of_objects(np.array([4, -1, 2**40, 4]))
    assert together.tolist() == [BASE.of_objects(np.array([each]))[0] for each in (4, -1, 2**40, 4)]
    assert len(set(together.tolist())) == 3
    assert BASE.of_objects(np.zeros(0, np.int64)).shape == (0,)
    assert BASE.of_objects(np.arange(2000)).mean() == pytest.approx(0.5, abs=0.03)
    one, above, beside = (
        np.array(p) for p in ([-3.0, 2.0, 5.0], [-3.001, 2.0, 6.0], [-3.02, 2.0, 5.0])
    )
    assert (
        first(BASE.of_pole(one))
        == first(replace(BASE, sensor=6).of_pole(above))
        != first(BASE.of_pole(beside))
    )


def test_owners_are_the_boxes_that_rays_meet(street, cast):
    """Oracle: the image without an object differs where the object is seen, but for the foot, which
    is the ground's."""
    height = street.points[:, 2].reshape(street.measurement.shape)
    for row in range(len(street.objects)):
        shown = (
            cast(street.sensor, street.objects.boxes[np.arange(len(street.objects)) != row])
            != street.measurement
        )
        assert ((street.owners == row)[height > 0.06] == shown[height > 0.06]).mean() > 0.9995
        assert (street.owners == row).sum() > 20
    ground = street.valid & (street.points[:, 2].reshape(street.measurement.shape) < 0.01)
    assert (street.owners[ground] == -1).all()
    assert ground.sum() > 5000
    assert (replace(street, objects=Objects.empty()).owners == -1).all()


def test_cosines_on_even_ground_and_on_a_wall(street, wall, sensor):
    down = street.sensor.world_rays[2].reshape(street.measurement.shape) / street.ray_lengths
    ground = street.valid & (street.owners < 0)
    inner = np.zeros_like(ground)
    inner[1:-1, 1:-1] = (
        ground[1:-1, 1:-1]
        & ground[:-2, 1:-1]
        & ground[2:, 1:-1]
        & ground[1:-1, :-2]
        & ground[1:-1, 2:]
    )
    near = inner & (street.ranges < 30)
    assert near.sum() > 3000
    assert np.percentile(np.abs(street.cosines - -down)[near], 99) < 0.01
    facing = wall(sensor, 10.0)
    expected = (
        1 / facing.ray_lengths if sensor.model.measures == "depth" else np.ones(sensor.model.shape)
    )
    assert np.allclose(facing.cosines, expected, atol=0.01)


def test_ranges_are_distances_of_points(street):
    apart = np.linalg.norm(street.points - street.sensor.position, axis=1).reshape(
        street.ranges.shape
    )
    assert np.allclose(street.ranges, apart, atol=1e-3)
    assert not street.ranges[~street.valid].any()


def test_a_reading_without_error_is_the_truth(street):
    reading = Reading.from_truth(street)
    assert reading.measurement is street.measurement
    assert reading.pose is street.sensor.pose
    assert reading.shift is None
    assert reading.without(np.zeros(street.measurement.shape, np.bool_)) is reading
    half = reading.without(
        np.arange(street.measurement.size).reshape(street.measurement.shape) % 2 == 0
    )
    assert half.valid.sum() == pytest.approx(street.valid.sum() / 2, abs=1)
    assert half.truth is street
    assert street.valid.sum() == is_return(street.measurement).sum()


def test_measurements_that_are_not_finite_are_no_returns(street):
    image = street.measurement.copy()
    image[0, :4] = np.nan, np.inf, -np.inf, -3.0
    reading = Reading.from_truth(replace(street, measurement=image))
    assert reading.measurement[0, :4].tolist() == [0, 0, 0, -3]
    assert not reading.valid[0, :4].any()
    assert not reading.truth.ranges[0, :4].any()


def test_an_image_of_nothing(sensor):
    dark = TrueImage(
        sensor,
        np.zeros(sensor.model.shape, np.float32),
        Objects(np.array([[0.0, 0, 5, 4, 2, 1.5, 0]])),
    )
    assert not dark.valid.any()
    assert not dark.ranges.any()
    assert (dark.cosines == 1).all()
    assert (dark.owners == -1).all()
