import numpy as np
import pytest

from toolkit.calibration.ground_plane import fit_plane, heights_over, low_points, lowest_around, supported


def scattered(rng, low, high, height, count, noise=0.0):
    xy = rng.uniform(low, high, (count, 2))
    return np.column_stack([xy, np.broadcast_to(height, count) + noise * rng.standard_normal(count)])


def sloped(points, a, b, c):
    return points + np.column_stack([np.zeros((len(points), 2)), points[:, :2] @ [a, b] + c])


@pytest.mark.parametrize("plane", [(0.0, 0.0, -1.7), (0.06, 0.0, -6.0), (-0.1, 0.18, -1.7), (0.0, -0.05, 12.0)])
def test_the_plane_is_that_of_the_ground_to_a_centimetre(plane):
    street = scattered(np.random.default_rng(0), -40, 40, 0.0, 6000, noise=0.02)
    assert (np.abs(fit_plane(sloped(street, *plane)) - plane) < [2e-3, 2e-3, 0.01]).all()


def test_a_roof_larger_than_the_ground_is_not_it():
    rng = np.random.default_rng(1)
    street, roof = scattered(rng, [-30, -4], [30, 4], 0.0, 2000), scattered(rng, [-30, 5], [30, 30], 5.0, 20000)
    np.testing.assert_allclose(fit_plane(np.concatenate([roof, street])), 0.0, atol=0.01)


def test_walls_hedges_and_cars_do_not_lift_it():
    rng = np.random.default_rng(2)
    street = scattered(rng, [-30, -6], [30, 6], -6.0, 1500, noise=0.02)
    wall = np.column_stack([rng.uniform(-30, 30, 20000), np.full(20000, 6.5), rng.uniform(-6, 4, 20000)])
    hedge = scattered(rng, [-30, -8], [30, -6], -4.8, 5000, noise=0.1)
    cars = scattered(rng, [-10, -2], [10, 2], rng.uniform(-5.8, -4.5, 6000), 6000)
    np.testing.assert_allclose(fit_plane(np.concatenate([street, wall, hedge, cars])), [0, 0, -6.0], atol=0.02)


def test_reflections_below_the_ground_do_not_sink_it():
    rng = np.random.default_rng(3)
    street = scattered(rng, -30, 30, -1.7, 3000, noise=0.02)
    below = scattered(rng, -30, 30, rng.uniform(-9, -3, 30), 30)
    np.testing.assert_allclose(fit_plane(np.concatenate([street, below])), [0, 0, -1.7], atol=0.01)


def test_ground_on_one_side_only_at_a_tilt():
    rng = np.random.default_rng(4)
    ahead = sloped(scattered(rng, [3, -10], [40, 10], 0.0, 3000, noise=0.02), 0.15, -0.1, -6.0)
    assert (np.abs(fit_plane(ahead) - [0.15, -0.1, -6.0]) < [2e-3, 2e-3, 0.03]).all()


def test_near_rings_do_not_outweigh_far_ones():
    rng = np.random.default_rng(5)
    near = scattered(rng, -3, 3, -1.7, 50000, noise=0.05)
    far = scattered(rng, -40, 40, -1.7, 2000, noise=0.02)
    np.testing.assert_allclose(fit_plane(np.concatenate([near, far])), [0, 0, -1.7], atol=0.01)


def test_the_same_seed_gives_the_same_plane_and_the_bound_on_tilt_holds():
    steep = sloped(scattered(np.random.default_rng(6), -20, 20, 0.0, 2000), 0.5, 0.0, 0.0)
    street = scattered(np.random.default_rng(6), -20, 20, 0.0, 2000, noise=0.05)
    assert fit_plane(street, seed=3).tobytes() == fit_plane(street, seed=3).tobytes()
    assert np.hypot(*fit_plane(steep, max_tilt=0.1)[:2]) <= np.tan(0.1)


def test_points_that_make_no_ground_are_refused():
    with pytest.raises(ValueError, match="no ground to be found in 2 points"):
        fit_plane(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="no ground to be found in 0 points"):
        fit_plane(np.zeros((0, 3), np.float32))
    patch = np.random.default_rng(0).uniform([-5, -5, 0], [5, 5, 0.1], (200, 3))
    far = np.concatenate([patch, patch + np.array([[3000.0, 3000.0, 0.0]])])
    with pytest.raises(ValueError, match=r"reach over 30[01]. by 30[01]. m: crop them"):
        fit_plane(far)


def test_points_of_no_number_do_not_count():
    street = scattered(np.random.default_rng(7), -20, 20, -1.7, 2000)
    street[::7, 1] = np.nan
    np.testing.assert_allclose(fit_plane(street), [0, 0, -1.7], atol=1e-6)


def test_the_low_end_of_a_cell_is_a_tenth_of_its_points_up():
    column = np.column_stack([np.full(31, 0.5), np.full(31, 0.5), np.arange(31.0)])
    assert low_points(column, 1.0).tolist() == [[0.5, 0.5, 3.0]]
    assert low_points(column, 1.0, share=0.5).tolist() == [[0.5, 0.5, 15.0]]
    assert low_points(column[:0], 1.0).shape == (0, 3)


def test_heights_over_a_plane():
    assert heights_over(np.array([0.5, -1.0, 2.0]), np.array([[2.0, 1.0, 7.0]])).tolist() == [5.0]


def test_cells_above_others_and_alone_are_left_out():
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), axis=-1).reshape(-1, 2) + 0.5
    cells = np.column_stack([grid, np.zeros(400)])
    cells[210, 2], cells[37, 2] = 1.5, -3.0
    ground = supported(cells, 0.25, 0.1, others=2)
    assert np.flatnonzero(~ground).tolist() == [37, 210]
    cells[37, 2] = 0.0
    assert np.flatnonzero(~lowest_around(cells, 0.1, 0.25, window=5.0)).tolist() == [210]
    assert lowest_around(cells[:0], 0.1, 0.25).shape == (0,)
