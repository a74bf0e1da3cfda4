import numpy as np

from toolkit.bodies.body import include_mirrors, make_body, make_boxed_body, stretch_randomly
from toolkit.bodies.fleet import catalogue
from toolkit.mesh import box
from toolkit.objects import VEHICLE

CAR = catalogue()[0]


def test_a_body_is_in_the_middle_of_its_box():
    body = make_body(
        "plank", VEHICLE, np.array([[5.0, 5, 5], [9, 6, 5], [9, 6, 6.5]]), np.array([[0, 1, 2]])
    )
    assert body.size == (4.0, 1.0, 1.5)
    assert np.allclose(body.vertices[0], [-2, -0.5, -0.75])


def test_stretched_bodies_vary_by_six_percent():
    rng = np.random.default_rng(4)
    varied = [stretch_randomly(CAR, rng) for _ in range(50)]
    ratios = np.array([body.size for body in varied]) / CAR.size
    assert all(
        np.allclose(b.vertices.min(axis=0), -b.vertices.max(axis=0), atol=1e-5) for b in varied
    )
    assert (np.abs(ratios - 1) <= 0.0601).all()
    assert ratios.std(axis=0).min() > 0.015


def test_what_sticks_out_of_the_box_is_mesh_alone():
    body = make_boxed_body(
        "m", VEHICLE, box((4.0, 2.0, 1.5), (1, 1, 1)), box((0.2, 0.4, 0.2), (1.5, 2.1, 1))
    )
    assert body.size == body.truth == (4.0, 2.0, 1.5)
    assert np.allclose(body.bounds, [0, 0.15, 0, 4, 2.3, 1.5], atol=1e-6)
    assert np.allclose(include_mirrors(body).size, (4, 2.3, 1.5), atol=1e-6)
    assert include_mirrors(body).truth is None
    assert np.allclose(include_mirrors(CAR).bounds, [0, 0, 0, *include_mirrors(CAR).size])
    assert CAR.bounds[4] > CAR.size[1] + 0.1  # its mirrors
    stretched = stretch_randomly(body, np.random.default_rng(1))
    factors = np.ptp(stretched.vertices, axis=0) / np.ptp(body.vertices, axis=0)
    assert np.allclose(stretched.size, body.size * factors, rtol=1e-5)
