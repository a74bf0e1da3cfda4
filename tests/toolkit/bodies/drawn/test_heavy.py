import numpy as np
import pytest

from toolkit.bodies.drawn.heavy import BUSES, SUPERSTRUCTURES, drawn_heavy

BUILT = [drawn_heavy(np.random.default_rng([1, k])) for k in range(250)]


def of(*ends: str) -> list:
    return [mesh for kind, mesh, _ in BUILT if kind.startswith(ends) or kind.endswith(ends)]


def test_shares_sum_up_and_every_kind_is_drawn():
    assert sum(SUPERSTRUCTURES.values()) == pytest.approx(1)
    kinds = {kind for kind, _, _ in BUILT}
    assert set(BUSES) <= kinds
    assert {f"{load}_truck" for load in SUPERSTRUCTURES} <= kinds


@pytest.mark.parametrize(
    ("kinds", "lengths", "heights"),
    [
        (("_truck",), (5.2, 11.6), (1.9, 4.4)), (("articulated_",), (12.4, 17.1), (2.8, 4.6)),
        (("bendy_bus",), (16.4, 18.6), (2.5, 4.7)), (("minibus",), (6.1, 8.0), (2.5, 4.8)),
    ],
)  # fmt: skip
def test_sizes_are_those_of_the_kind(kinds, lengths, heights):
    meshes = of(*kinds)
    assert len(meshes) > 3
    for mesh in meshes:
        length, width, height = np.ptp(mesh.vertices, axis=0).tolist()
        assert lengths[0] <= length <= lengths[1]
        assert 1.8 <= width <= 2.65
        assert heights[0] <= height <= heights[1]
        assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)


def test_mirrors_stick_out_at_the_front_on_both_sides():
    for kind, mesh, mirrors in BUILT:
        body, out = np.abs(mesh.vertices[:, 1]).max(), mirrors.vertices
        assert 0.05 < np.abs(out[:, 1]).max() - body < 0.3, kind
        assert np.allclose(np.sort(out[:, 1]), np.sort(-out[:, 1]))
        assert out[:, 0].min() > 0.25 * np.ptp(mesh.vertices[:, 0])
        assert out[:, 0].max() < mesh.vertices[:, 0].max() + 0.01
