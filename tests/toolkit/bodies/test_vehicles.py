import numpy as np
import pytest

from toolkit.bodies.body import Body, make_boxed_body
from toolkit.bodies.catalogue_cars import CAR_SHAPES, cars
from toolkit.bodies.catalogue_trucks import trucks
from toolkit.objects import VEHICLE

BODIES = [make_boxed_body(name, VEHICLE, *meshes) for name, meshes in cars().items()]
WIDTHS = [row[2] for row in CAR_SHAPES["catalogue"].values()]


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_cars_have_the_measures_of_cars(body):
    length, width, height = body.size
    assert 3.5 <= length <= 5.6
    assert 1.45 <= width <= 2.0
    assert 1.15 <= height <= 2.3
    ends = np.abs(body.vertices[:, 0]) > 0.48 * length
    assert np.ptp(body.vertices[ends, 1]) < 0.92 * width  # bumpers are rounded in plan
    roof = body.vertices[:, 2] > 0.40 * height
    assert np.ptp(body.vertices[roof, 1]) < 0.89 * width  # tumblehome
    touching = body.vertices[body.vertices[:, 2] < -0.499 * height]
    assert np.ptp(touching[:, 0]) > 0.5 * length  # stands on four wheels
    assert np.ptp(touching[:, 1]) > 0.6 * width
    assert np.allclose(np.sort(body.vertices[:, 1]), np.sort(-body.vertices[:, 1]), atol=1e-5)


def test_vehicles_have_their_width_and_mirrors():
    for body, width in zip(BODIES, WIDTHS, strict=True):
        assert body.size[1] == pytest.approx(width, abs=0.03)
        out = np.abs(body.vertices[:, 1]).max() - body.size[1] / 2
        assert 0.05 < out < 0.12
        beyond = np.abs(body.vertices[:, 1]) > body.size[1] / 2 + 1e-4
        assert (np.abs(body.vertices[~beyond]) <= np.array(body.size) / 2 + 1e-4).all()


def test_trucks_stand_on_the_ground_and_have_high_mirrors():
    assert all(abs(mesh.vertices[:, 2].min()) < 0.02 for mesh, _ in trucks().values())
    for mesh, mirrors in trucks().values():
        y, z = np.abs(mirrors.vertices[:, 1]), mirrors.vertices[:, 2]
        assert y.max() > np.abs(mesh.vertices[:, 1]).max() + 0.05
        assert z.min() > 1.2
        np.testing.assert_allclose(
            np.sort(mirrors.vertices[:, 1]), np.sort(-mirrors.vertices[:, 1]), atol=1e-9
        )


def test_vehicles_differ_from_each_other():
    def profile(body: Body) -> np.ndarray:
        """Size and, along the length, the height of the body."""
        x, z = body.vertices[:, 0] / body.size[0], body.vertices[:, 2] + body.size[2] / 2
        bins = np.clip(((x + 0.5) * 12).astype(int), 0, 11)
        return np.array([*body.size, *(z[bins == b].max() for b in range(12))])

    profiles = np.array([profile(body) for body in BODIES])
    apart = np.abs(profiles[:, None] - profiles[None]).max(axis=2)
    assert apart[~np.eye(len(profiles), dtype=bool)].min() > 0.08


def test_trucks_have_the_sizes_of_trucks():
    sizes = np.array([np.ptp(mesh.vertices, axis=0) for mesh, _ in trucks().values()])
    assert (sizes[:, 0] > 6).all()
    assert (sizes[:, 2] > 2.6).all()
    assert (sizes < [13, 2.66, 4]).all()
