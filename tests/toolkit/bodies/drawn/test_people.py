from collections import Counter

import numpy as np
import pytest

from toolkit.bodies.drawn.people import PEOPLE, drawn_person, drawn_pose, standing
from toolkit.mesh import box

DRAWN = [drawn_person(np.random.default_rng([1, k])) for k in range(400)]


def heights(kind: str) -> np.ndarray:
    return np.array([np.ptp(mesh.vertices[:, 2]) for each, mesh in DRAWN if each == kind])


def test_kinds_have_their_shares():
    counts = Counter(kind for kind, _ in DRAWN)
    assert set(counts) == set(PEOPLE)
    for kind, share in {"adult": 0.73, "child": 0.165, "pram": 0.05, "walker": 0.02, "wheelchair": 0.035}.items():
        assert counts[kind] / len(DRAWN) == pytest.approx(share, abs=0.05)


def test_people_are_as_tall_as_people():
    assert np.percentile(heights("adult"), 2) > 1.4
    assert np.median(heights("adult")) == pytest.approx(1.72, abs=0.04)
    assert heights("adult").max() < 2.45  # under an umbrella
    assert 0.9 < heights("child").min() < heights("child").max() < 1.65
    assert np.ptp(heights("child")) > 0.4
    assert np.median(heights("wheelchair")) < 1.6


def test_all_stand_on_the_ground():
    assert max(abs(mesh.vertices[:, 2].min()) for _, mesh in DRAWN) < 1e-9


def test_strides_go_either_way_and_some_stand():
    lengths = np.array([np.ptp(mesh.vertices[:, 0]) for kind, mesh in DRAWN if kind == "adult"])
    assert lengths.min() < 0.4
    assert lengths.max() > 0.9
    assert {drawn_pose(np.random.default_rng(k), 1.1).hands[0][2] for k in range(20)} == {0.47, 0.80}
    assert drawn_pose(np.random.default_rng(0), 1.1).stout == 1.1


def test_standing_lets_a_mesh_down():
    assert standing(box((1, 1, 1), (0, 0, 7))).vertices[:, 2].min() == 0
