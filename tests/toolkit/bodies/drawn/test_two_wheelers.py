from collections import Counter

import numpy as np
import pytest

from toolkit.bodies.drawn.two_wheelers import RIDERLESS, TWO_WHEELERS, drawn_two_wheeler

DRAWN = [drawn_two_wheeler(np.random.default_rng([1, k])) for k in range(400)]


def sizes(kind: str) -> np.ndarray:
    return np.array([np.ptp(mesh.vertices, axis=0) for each, mesh in DRAWN if each == kind])


def test_kinds_have_their_shares_and_few_go_without_a_rider():
    counts = Counter(kind.removesuffix("_alone") for kind, _ in DRAWN)
    assert set(counts) == set(TWO_WHEELERS)
    shares = {"bicycle": 0.5, "cargo_bicycle": 0.05, "e_scooter": 0.15, "motorcycle": 0.17, "scooter": 0.13}
    for kind, share in shares.items():
        assert counts[kind] / len(DRAWN) == pytest.approx(share, abs=0.06)
    alone = np.mean([kind.endswith("_alone") for kind, _ in DRAWN])
    assert alone == pytest.approx(RIDERLESS, abs=0.04)


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [
        ("bicycle", (0.85, 0.3, 0.9), (2.1, 0.75, 2.2)), ("cargo_bicycle", (1.9, 0.4, 1.4), (2.7, 0.75, 2.2)),
        ("e_scooter", (0.9, 0.45, 1.4), (1.4, 0.75, 2.25)), ("motorcycle", (1.7, 0.5, 1.4), (2.8, 0.85, 1.95)),
        ("scooter", (1.4, 0.5, 1.4), (2.2, 0.85, 2.0)), ("e_scooter_alone", (0.9, 0.45, 0.95), (1.4, 0.55, 1.3)),
    ],
)  # fmt: skip
def test_sizes_are_those_of_the_kind(kind, low, high):
    assert len(sizes(kind))
    assert (sizes(kind) >= low).all(), sizes(kind).min(axis=0)
    assert (sizes(kind) <= high).all(), sizes(kind).max(axis=0)


def test_wheels_stand_on_the_ground_front_and_rear():
    for kind, mesh in DRAWN:
        low = mesh.vertices[mesh.vertices[:, 2] < 0.03]
        assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert np.ptp(low[:, 0]) > 0.5 * np.ptp(mesh.vertices[:, 0]) * (0.7 if "cargo" in kind else 1), kind
        assert np.ptp(low[:, 1]) < 0.3, kind
