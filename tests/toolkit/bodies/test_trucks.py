import numpy as np

from toolkit.bodies.trucks import trucks


def test_heavy_vehicles_hide_what_is_behind_them():
    sizes = np.array([np.ptp(mesh.vertices, axis=0) for mesh, _ in trucks().values()])
    assert (sizes[:, 0] > 6).all()
    assert (sizes[:, 2] > 2.6).all()
    assert (sizes < [13, 2.66, 4]).all()


def test_wheels_stand_on_the_ground():
    assert all(abs(mesh.vertices[:, 2].min()) < 0.02 for mesh, _ in trucks().values())


def test_mirrors_stick_out_of_cabs_and_buses():
    for mesh, mirrors in trucks().values():
        y, z = np.abs(mirrors.vertices[:, 1]), mirrors.vertices[:, 2]
        assert y.max() > np.abs(mesh.vertices[:, 1]).max() + 0.05
        assert z.min() > 1.2
        np.testing.assert_allclose(np.sort(mirrors.vertices[:, 1]), np.sort(-mirrors.vertices[:, 1]), atol=1e-9)
