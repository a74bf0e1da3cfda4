from collections import Counter

import numpy as np
import pytest
import trimesh

from toolkit.bodies.body import Body
from toolkit.bodies.drawn_bodies import draw_body
from toolkit.bodies.drawn_people import PEOPLE
from toolkit.bodies.drawn_two_wheelers import TWO_WHEELERS
from toolkit.bodies.fleet import FLEETS, HELD_OUT, LARGEST_DRAW, Fleet, catalogue, fleet_named
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

EVERY = catalogue() + tuple(body for body in catalogue(held_out=True) if body.name in HELD_OUT)
IDS = [body.name for body in EVERY]


def of(label: int, bodies: tuple[Body, ...] = EVERY) -> list[Body]:
    return [body for body in bodies if body.label == label]


def test_the_catalogue_has_enough_of_every_class():
    assert len(of(VEHICLE, catalogue())) >= 20
    assert len(of(CYCLIST)) >= 6
    assert len(of(PEDESTRIAN)) >= 14
    assert len(of(HEAVY)) >= 3
    assert len({body.name for body in EVERY}) == len(EVERY)


def test_held_out_cars_are_tested_alone():
    trained, tested = (
        {body.name for body in of(VEHICLE, catalogue(held_out=flag))} for flag in (False, True)
    )
    assert len(HELD_OUT) == 5
    assert tested == set(HELD_OUT)
    assert not trained & tested


def test_drawn_fleets_follow_seed_and_length():
    own = fleet_named("own")
    few, again, other = (own.bodies(1, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert digests(few) == digests(again) != digests(other)
    counts = [
        [len(of(label, own.bodies(n, np.random.default_rng(0)))) for label in range(4)]
        for n in (1, 2)
    ]
    assert counts == [[30, 13, 20, 6], [34, 15, 22, 7]]
    heavy = Fleet(drawn=(HEAVY,))
    assert len(heavy.bodies(10**6, np.random.default_rng(0))) == len(
        heavy.bodies(LARGEST_DRAW, np.random.default_rng(0))
    )
    assert {body.name for body in few} <= set(own.names)


@pytest.mark.parametrize("body", EVERY, ids=IDS)
def test_box_is_tight_and_mesh_is_sound(body):
    with_mirrors = body.truth is not None
    assert with_mirrors == (body.label in (VEHICLE, HEAVY))
    lowest, highest = body.vertices.min(axis=0), body.vertices.max(axis=0)
    # mirrors stick out to the sides, and of buses to the front
    exact = [2] if with_mirrors else [0, 1, 2]
    assert np.allclose(lowest[exact], -highest[exact], atol=1e-5)
    assert np.allclose((highest - lowest)[exact], np.array(body.size)[exact], atol=1e-5)
    assert (highest - lowest >= np.array(body.size) - 1e-5).all()
    assert (highest - lowest - np.array(body.size) < [0.25, 0.5, 1e-4]).all()
    assert np.isfinite(body.vertices).all()
    assert set(np.unique(body.triangles)) == set(
        range(len(body.vertices))
    )  # no vertex that no triangle uses
    assert 300 <= len(body.triangles) <= 2500
    assert trimesh.Trimesh(body.vertices, body.triangles, process=False).volume > 0


CARS_ONLY = Fleet(tuple(of(VEHICLE, catalogue()))[:3], drawn=(CYCLIST, HEAVY))


def digests(bodies: tuple[Body, ...]) -> list[bytes]:
    return [body.vertices.tobytes() for body in bodies]


def test_fleets_without_drawn_bodies_stay():
    fleet = fleet_named("catalogue")
    assert fleet.bodies(9, np.random.default_rng(0)) == fleet.fixed == catalogue()
    assert fleet.names == tuple(body.name for body in catalogue())
    assert fleet_named("catalogue", held_out=True).fixed == catalogue(held_out=True)
    bodies = CARS_ONLY.bodies(2, np.random.default_rng(0))
    assert {body.name for body in of(VEHICLE, bodies)} == {body.name for body in CARS_ONLY.fixed}
    assert not of(PEDESTRIAN, bodies)


def test_mixed_fleets_are_half_drawn():
    mixed = of(
        VEHICLE, Fleet(CARS_ONLY.fixed, drawn=tuple(range(4))).bodies(2, np.random.default_rng(0))
    )
    fixed = [body for body in mixed if body in CARS_ONLY.fixed]
    assert len(mixed) == 34
    assert abs(len(fixed) - len(mixed) / 2) <= 0.5
    assert [fixed.count(body) for body in CARS_ONLY.fixed] == [6, 6, 5]


def test_boxes_with_mirrors_are_wider():
    out, into = (
        fleet_named("own", mirrors=flag).bodies(1, np.random.default_rng(2))
        for flag in (False, True)
    )
    wider = [b.size[1] - a.size[1] for a, b in zip(out, into, strict=True) if a.label == VEHICLE]
    assert max(wider) > 0.1
    assert min(wider) > -1e-6
    assert all(body.truth is None for body in into)


@pytest.mark.parametrize("label", range(len(LABELS)))
def test_every_name_that_is_drawn_is_announced(label):
    names = {draw_body(label, np.random.default_rng([5, k])).name for k in range(150)}
    assert names <= set(fleet_named("own").names)


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("mine", {}, "fleet must be one of catalogue, own, even, meshes, both, got 'mine'"),
        *(
            ("meshes", {}, "fleet 'meshes' needs a folder"),
            ("both", {}, "fleet 'both' needs a folder"),
        ),
        ("own", {"meshes": "somewhere"}, "fleet 'own' takes no meshes, got somewhere"),
        ("even", {"meshes": "somewhere"}, "fleet 'even' takes no meshes, got somewhere"),
        ("own", {"held_out": True}, "held-out cars are of the catalogue"),
    ],
)
def test_what_cannot_be_combined_is_refused(name, options, says):
    with pytest.raises(ValueError, match=says):
        fleet_named(name, **options)
    assert len(FLEETS) == 5


def test_an_even_fleet_has_many_prams_and_e_scooters_and_the_same_cars():
    own, even = (fleet_named(name).bodies(40, np.random.default_rng(2)) for name in ("own", "even"))
    kinds = Counter(body.name.rpartition("/")[2] for body in even)
    people, wheels = (sum(kinds[kind] for kind in every) for every in (PEOPLE, TWO_WHEELERS))
    assert kinds["pram"] / people == pytest.approx(0.27, abs=0.1)
    assert kinds["adult"] / people == pytest.approx(0.3, abs=0.12)
    assert kinds["e_scooter"] / wheels == pytest.approx(0.34, abs=0.13)
    assert kinds["bicycle"] + kinds["cargo_bicycle"] > kinds["motorcycle"]
    cars = [[body.name for body in fleet if body.label == VEHICLE] for fleet in (own, even)]
    assert cars[0] == cars[1]
