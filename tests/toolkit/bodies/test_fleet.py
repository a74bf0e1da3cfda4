import numpy as np
import pytest

from toolkit.bodies.body import Body
from toolkit.bodies.fleet import HELD_OUT, catalogue
from toolkit.mesh import Mesh, volume
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

EVERY = catalogue() + tuple(body for body in catalogue(held_out=True) if body.name in HELD_OUT)
IDS = [body.name for body in EVERY]


def of(label: int, bodies: tuple[Body, ...] = EVERY) -> list[Body]:
    return [body for body in bodies if body.label == label]


def test_there_are_enough_of_every_class():
    assert len(of(VEHICLE, catalogue())) >= 20
    assert len(of(CYCLIST)) >= 6
    assert len(of(PEDESTRIAN)) >= 14
    assert len(of(HEAVY)) >= 3
    assert len({body.name for body in EVERY}) == len(EVERY)


def test_held_out_cars_are_in_one_catalogue_only():
    trained, tested = ({body.name for body in of(VEHICLE, catalogue(held_out=flag))} for flag in (False, True))
    assert len(HELD_OUT) == 5
    assert tested == set(HELD_OUT)
    assert not trained & tested


@pytest.mark.parametrize("body", EVERY, ids=IDS)
def test_box_is_tight_and_mesh_is_sound(body):
    assert np.allclose(body.vertices.min(axis=0), -body.vertices.max(axis=0), atol=1e-5)
    assert np.allclose(np.ptp(body.vertices, axis=0), body.size)
    assert np.isfinite(body.vertices).all()
    assert set(np.unique(body.triangles)) == set(range(len(body.vertices)))  # no vertex that no triangle uses
    assert 300 <= len(body.triangles) <= 2500
    assert volume(Mesh(body.vertices.astype(float), body.triangles.astype(int))) > 0
