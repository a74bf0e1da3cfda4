import numpy as np

from toolkit.bodies.body import centred, vary
from toolkit.bodies.fleet import catalogue
from toolkit.objects import VEHICLE

CAR = catalogue()[0]


def test_centring_moves_any_mesh_into_its_box():
    body = centred("plank", VEHICLE, np.array([[5.0, 5, 5], [9, 6, 5], [9, 6, 6.5]]), np.array([[0, 1, 2]]))
    assert body.size == (4.0, 1.0, 1.5)
    assert np.allclose(body.vertices[0], [-2, -0.5, -0.75])


def test_varied_bodies_keep_tight_centred_boxes_and_stay_near_their_size():
    rng = np.random.default_rng(4)
    varied = [vary(CAR, rng) for _ in range(50)]
    ratios = np.array([body.size for body in varied]) / CAR.size
    assert all(np.allclose(b.vertices.min(axis=0), -b.vertices.max(axis=0), atol=1e-5) for b in varied)
    assert (np.abs(ratios - 1) <= 0.0601).all()
    assert ratios.std(axis=0).min() > 0.015
