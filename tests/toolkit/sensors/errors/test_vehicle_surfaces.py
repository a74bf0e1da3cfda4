from dataclasses import replace

import numpy as np
import pytest

from toolkit.boxes import points_in_boxes
from toolkit.objects import HEAVY, VEHICLE, Objects
from toolkit.sensors.errors.vehicle_surfaces import Glass, Paint


def heights(truth):
    """Share of its object's height at which each pixel lies."""
    boxes = truth.objects.boxes[truth.owners]
    z = truth.points[:, 2].reshape(truth.owners.shape)
    return (z - boxes[..., 2]) / boxes[..., 5] + 0.5


def test_the_window_band_is_that_of_cars_alone(street):
    band, share = Glass(1.0).band(street), heights(street)
    expected = (street.owners >= 0) & (street.owners < 2) & (share > 0.62) & (share < 0.93)
    assert np.array_equal(band, expected)
    assert band.sum() > 300


def test_glass_returns_nothing_or_what_is_inside(read, street):
    said = read(Glass(1.0, behind=0.4), street)
    band = Glass(1.0).band(street)
    assert np.array_equal(said.measurement[~band], street.measurement[~band])
    through = said.valid & band
    assert through.sum() / band.sum() == pytest.approx(0.4, abs=0.06)
    deeper = said.measurement[through] - street.measurement[through]
    assert (deeper >= 0).all()
    assert deeper.mean() > 0.3
    inside = replace(street, measurement=said.measurement).points[np.flatnonzero(through)]
    boxes = street.objects.boxes + np.array([0, 0, 0, 0.02, 0.02, 0.02, 0])
    assert points_in_boxes(inside, boxes[:2]).any(axis=1).all()


def test_the_way_through_a_car_is_that_to_its_far_side(read, street):
    """Oracle: at most where the ray leaves the box, found by steps of a centimetre."""
    said = [read(Glass(1.0, behind=1.0), street, frame=f).measurement for f in range(60)]
    band = np.argwhere(Glass(1.0).band(street))[::40]
    for row, column in band:
        pixel = row * street.measurement.shape[1] + column
        ray = street.sensor.world_rays[:, pixel].astype(np.float64)
        steps = street.measurement[row, column] + np.arange(0, 8, 0.01)
        box = street.objects.boxes[[street.owners[row, column]]] + np.array([0, 0, 0, 0.002, 0.002, 0.002, 0])
        within = points_in_boxes(street.sensor.position + steps[:, None] * ray, box)[:, 0]
        leaves = steps[np.flatnonzero(within)[-1]]
        farthest = max(image[row, column] for image in said)
        entry = street.measurement[row, column]
        assert entry <= farthest <= leaves + 0.02
        assert farthest >= entry + 0.8 * (leaves - entry) - 0.02


def test_pillars_are_left(read, street):
    band = Glass(1.0).band(street)
    lost = ~read(Glass(0.7, behind=0.0), street).valid & band
    assert lost.sum() / band.sum() == pytest.approx(0.7, abs=0.06)


def test_dark_cars_lose_more_the_same_ones_for_every_sensor(read, street, sensor):
    many = np.arange(400)
    boxes = np.column_stack([20 + 0 * many, 0 * many, *np.tile([[0.75], [4], [2], [1.5], [0]], 400)])
    crowd = Objects(boxes, np.full(400, VEHICLE), many)
    owners = np.resize(np.arange(400), street.measurement.shape)
    at_30 = np.full(street.measurement.shape, 30.0, np.float32)
    truth = replace(street, objects=crowd, measurement=at_30)
    vars(truth)["owners"] = owners
    term = Paint(0.3, dark=0.02, half_range=60.0)
    lost = [np.bincount(owners.ravel(), (~read(term, truth, number=n, frame=n).valid).ravel()) for n in (1, 2)]
    dark = [each > 0 for each in lost]
    assert np.array_equal(*dark)
    assert dark[0].mean() == pytest.approx(0.3, abs=0.07)
    assert lost[0].sum() > 1000


def test_the_wet_lose_what_the_law_says(read, street):
    """All vehicles at a fifth of their reflectivity: what stays is the ratio of both chances."""
    from toolkit.sensors.errors.drop_out import chance_of_return

    term = Paint(0.0, wet=0.2, half_range=30.0)
    kept = np.mean([read(term, street, frame=f).valid for f in range(30)], axis=0)
    law = street.ranges, street.cosines, 30.0, 2.0
    expected = chance_of_return(*law, 0.2) / chance_of_return(*law)
    painted = np.isin(street.owners, np.flatnonzero(np.isin(street.objects.labels, (VEHICLE, HEAVY))))
    assert kept[painted].mean() == pytest.approx(expected[painted].mean(), abs=0.01)
    assert kept[painted].mean() < 0.8
    others = street.valid & ~painted
    assert (kept[others] == 1).all()


def test_no_strength_no_change(harmless, street):
    harmless(Glass(), street)
    harmless(Paint(), street)
    harmless(Paint(0.5), replace(street, objects=Objects.empty()))


def test_wrong_numbers():
    with pytest.raises(ValueError, match="lower < upper"):
        Glass(1.0, lower=0.9, upper=0.8)
    for wrong in (lambda: Glass(2.0), lambda: Paint(dark=-1.0), lambda: Paint(half_range=0.0)):
        with pytest.raises(ValueError, match="must be a"):
            wrong()
