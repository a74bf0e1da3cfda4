import numpy as np
import pytest

from toolkit.calibration.height_map import HeightMap, fit_map


def hilly(rng, count, reach=40.0):
    """Points of a street that falls away 1.2 m to the west, smoothly, and its height."""
    xy = rng.uniform(-reach, reach, (count, 2))
    return np.column_stack([xy, height_at(xy)])


def height_at(xy):
    return -1.2 / (1 + np.exp((xy[:, 0] + 20) / 6))


def test_a_map_follows_what_the_plane_does_not():
    rng = np.random.default_rng(0)
    street = hilly(rng, 30000) + [0, 0, 1] * (0.02 * rng.standard_normal((30000, 1)))
    places = rng.uniform(-36, 36, (500, 2))
    error = fit_map(street).at(places) - height_at(places)
    assert abs(np.median(error)) < 0.01
    assert np.abs(error).max() < 0.08


def test_cars_and_hedges_do_not_lift_it():
    rng = np.random.default_rng(1)
    street = hilly(rng, 20000)
    standing = []
    for x, y in rng.uniform(-30, 30, (12, 2)):
        under = (np.abs(street[:, 0] - x) < 2.2) & (np.abs(street[:, 1] - y) < 0.9)
        street = street[~under]
        car = np.column_stack([rng.uniform(x - 2.2, x + 2.2, 400), rng.uniform(y - 0.9, y + 0.9, 400), np.zeros(400)])
        standing.append(car + np.column_stack([np.zeros((400, 2)), height_at(car) + rng.uniform(0.25, 1.5, 400)]))
    hedge = np.column_stack([rng.uniform(-30, 30, 4000), rng.uniform(20, 21.5, 4000), rng.uniform(0.3, 1.2, 4000)])
    hedge[:, 2] += height_at(hedge)
    points = np.concatenate([street, *standing, hedge])
    places = rng.uniform(-30, 30, (500, 2))
    assert np.abs(fit_map(points).at(places) - height_at(places)).max() < 0.1


def test_stray_points_below_do_not_sink_it_and_far_from_ground_it_is_the_plane():
    rng = np.random.default_rng(2)
    street = np.column_stack([rng.uniform(-20, 20, (8000, 2)), np.zeros(8000)])
    stray = np.column_stack([rng.uniform(-20, 20, (12, 2)), np.full(12, -1.5)])
    alone = np.column_stack([rng.uniform(70, 71, (30, 2)), rng.uniform(0.5, 1.9, 30)])
    surface = fit_map(np.concatenate([street, stray, alone]))
    assert np.abs(surface.at(rng.uniform(-20, 20, (300, 2)))).max() < 0.02
    assert np.abs(surface.at(np.array([[70.0, 70.0]]))).max() < 0.02


def test_beside_a_kerb_the_lower_level_counts():
    rng = np.random.default_rng(3)
    xy = rng.uniform(-20, 20, (20000, 2))
    street = np.column_stack([xy, np.where(xy[:, 1] > 4, 0.15, 0.0)])
    surface = fit_map(street)
    along = np.linspace(-15, 15, 50)
    assert np.abs(surface.at(np.column_stack([along, np.full(50, 2.0)]))).max() < 0.03
    np.testing.assert_allclose(surface.at(np.column_stack([along, np.full(50, 12.0)])), 0.15, atol=0.03)


def test_places_outside_have_the_height_of_the_edge():
    heights = HeightMap(np.array([10.0, 20.0]), np.array([[0.0, 1.0, 2.0], [4.0, 5.0, 6.0]]), cell=2.0)
    places = np.array([[10.0, 20.0], [11.0, 21.0], [12.0, 24.0], [-5.0, 22.0], [99.0, 99.0]])
    assert heights.at(places).tolist() == [0.0, 2.5, 6.0, 1.0, 6.0]
    assert HeightMap(np.zeros(2), np.full((1, 1), 0.3)).at(places).tolist() == [0.3] * 5


def test_nothing_near_the_plane_makes_a_flat_map_and_no_reach_is_refused():
    assert fit_map(np.full((10, 3), 50.0)).at(np.zeros((1, 2))).tolist() == [0.0]
    with pytest.raises(ValueError, match="reach must be a length above 0 m, got -1"):
        fit_map(np.zeros((10, 3)), reach=-1.0)
