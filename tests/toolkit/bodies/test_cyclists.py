import numpy as np

from toolkit.bodies.cyclists import two_wheelers


def test_two_wheelers_with_riders_have_their_measures_and_stand_on_their_wheels():
    for mesh in two_wheelers().values():
        length, width, height = np.ptp(mesh.vertices, axis=0)
        assert 1.1 < length < 2.3
        assert 0.3 < width < 1.1
        assert 1.2 < height < 1.95
        assert abs(mesh.vertices[:, 2].min()) < 0.02


def test_bicycles_are_shorter_than_what_sumo_takes_for_motorcycles():
    from toolkit.traffic.spawner import BICYCLE_LENGTH

    lengths = {name: np.ptp(mesh.vertices[:, 0]) for name, mesh in two_wheelers().items()}
    assert lengths["motorcycle"] > BICYCLE_LENGTH > lengths["child_bicycle"]
