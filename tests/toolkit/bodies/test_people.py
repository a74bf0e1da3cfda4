import numpy as np
import pytest

from toolkit.bodies.figures import Figure, person, striding
from toolkit.bodies.people import pedestrians
from toolkit.bodies.two_wheelers import two_wheelers
from toolkit.traffic.supply import MAX_BICYCLE_LENGTH_M


def test_people_have_their_measures():
    heights = [
        np.ptp(mesh.vertices[:, 2])
        for name, mesh in pedestrians().items()
        if "umbrella" not in name
    ]
    assert min(heights) == pytest.approx(1.12, abs=0.05)
    assert max(heights) == pytest.approx(1.95, abs=0.05)
    lengths = [np.ptp(person(striding(step), 1.8).vertices[:, 0]) for step in (0.1, 0.3, 0.5)]
    assert lengths == sorted(lengths)
    vertices = person(Figure(), 1.75).vertices
    assert np.ptp(vertices[:, 2]) == pytest.approx(1.75, abs=0.05)
    assert abs(vertices[:, 2].min()) < 0.05


def test_two_wheelers_have_their_measures():
    for mesh in two_wheelers().values():
        length, width, height = np.ptp(mesh.vertices, axis=0)
        assert 1.1 < length < 2.3
        assert 0.3 < width < 1.1
        assert 1.2 < height < 1.95
        assert abs(mesh.vertices[:, 2].min()) < 0.02

    long = {name: np.ptp(mesh.vertices[:, 0]) for name, mesh in two_wheelers().items()}
    assert long["motorcycle"] > MAX_BICYCLE_LENGTH_M > long["child_bicycle"]
