import numpy as np

from toolkit.bodies.trucks import trucks


def test_heavy_vehicles_hide_what_is_behind_them():
    sizes = np.array([np.ptp(mesh.vertices, axis=0) for mesh in trucks().values()])
    assert (sizes[:, 0] > 6).all()
    assert (sizes[:, 2] > 2.6).all()
    assert (sizes < [13, 3.4, 4]).all()


def test_wheels_stand_on_the_ground():
    assert all(abs(mesh.vertices[:, 2].min()) < 0.02 for mesh in trucks().values())
