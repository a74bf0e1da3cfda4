import numpy as np
import pytest

from toolkit.bodies.pedestrians import Figure, pedestrians, person, striding


def test_pedestrians_are_as_tall_as_people():
    heights = [np.ptp(mesh.vertices[:, 2]) for name, mesh in pedestrians().items() if "umbrella" not in name]
    assert min(heights) == pytest.approx(1.12, abs=0.05)
    assert max(heights) == pytest.approx(1.95, abs=0.05)


def test_a_longer_step_makes_a_longer_body():
    lengths = [np.ptp(person(striding(step), 1.8).vertices[:, 0]) for step in (0.1, 0.3, 0.5)]
    assert lengths == sorted(lengths)


def test_a_figure_stands_on_the_ground_at_its_height():
    vertices = person(Figure(), 1.75).vertices
    assert np.ptp(vertices[:, 2]) == pytest.approx(1.75, abs=0.05)
    assert abs(vertices[:, 2].min()) < 0.05
