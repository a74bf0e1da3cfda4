from collections import Counter
from functools import cache

import numpy as np
import pytest
import trimesh

from toolkit.bodies.body import include_mirrors
from toolkit.bodies.drawn_bodies import draw_body, draw_heavy
from toolkit.bodies.drawn_buses import BUSES
from toolkit.bodies.drawn_people import PEOPLE, draw_person, draw_pose
from toolkit.bodies.drawn_trucks import SUPERSTRUCTURES
from toolkit.bodies.drawn_two_wheelers import TWO_WHEELERS, draw_two_wheeler
from toolkit.mesh import box, stand
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE


@cache
def built():
    """Heavy vehicles: kind, mesh and mirrors of each."""
    return [draw_heavy(np.random.default_rng([1, k])) for k in range(250)]


def of(*ends: str) -> list:
    return [mesh for kind, mesh, _ in built() if kind.startswith(ends) or kind.endswith(ends)]


def test_buses_and_all_superstructures_are_built():
    assert sum(SUPERSTRUCTURES.values()) == pytest.approx(1)
    kinds = {kind for kind, _, _ in built()}
    assert set(BUSES) <= kinds
    assert {f"{load}_truck" for load in SUPERSTRUCTURES} <= kinds


def test_mirrors_stick_out_on_both_sides_at_the_front():
    for kind, mesh, mirrors in built():
        body, out = np.abs(mesh.vertices[:, 1]).max(), mirrors.vertices
        assert 0.05 < np.abs(out[:, 1]).max() - body < 0.3, kind
        assert np.allclose(np.sort(out[:, 1]), np.sort(-out[:, 1]))
        assert out[:, 0].min() > 0.25 * np.ptp(mesh.vertices[:, 0])
        assert out[:, 0].max() < mesh.vertices[:, 0].max() + 0.01


def test_cars_of_one_length_differ_in_width_and_height():
    length, width, height = np.array(
        [draw_body(VEHICLE, np.random.default_rng([9, k])).size for k in range(400)]
    ).T
    for other, least in ((width, 0.08), (height, 0.16)):
        fit = np.polyfit(length, other, 1)
        assert np.std(other - np.polyval(fit, length)) > least
    assert 0.3 < np.corrcoef(length, width)[0, 1] < 0.85  # a kei car is not 6 m long
    assert length[width < 1.6].mean() < 3.9
    assert np.ptp(length) > 2.6
    assert np.ptp(width) > 0.6
    assert np.ptp(height) > 1.0


@pytest.mark.parametrize(
    ("kinds", "lengths", "heights"),
    [
        *((("_truck",), (5.2, 11.6), (1.9, 4.4)), (("articulated_",), (12.4, 17.1), (2.8, 4.6))),
        *((("bendy_bus",), (16.4, 18.6), (2.5, 4.7)), (("minibus",), (6.1, 8.0), (2.5, 4.8))),
    ],
)
def test_sizes_are_those_of_the_kind(kinds, lengths, heights):
    meshes = of(*kinds)
    assert len(meshes) > 3
    for mesh in meshes:
        length, width, height = np.ptp(mesh.vertices, axis=0).tolist()
        assert lengths[0] <= length <= lengths[1]
        assert 1.8 <= width <= 2.65
        assert heights[0] <= height <= heights[1]
        assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)


@cache
def drawn():
    """People: kind, mesh and the rest of each."""
    return [draw_person(np.random.default_rng([1, k])) for k in range(400)]


def heights(kind: str) -> np.ndarray:
    return np.array([np.ptp(mesh.vertices[:, 2]) for each, mesh, _ in drawn() if each == kind])


def test_people_have_their_shares():
    counts = Counter(kind for kind, _, _ in drawn())
    assert set(counts) == set(PEOPLE)
    for kind, share in {
        "adult": 0.73,
        "child": 0.165,
        "pram": 0.05,
        "walker": 0.02,
        "wheelchair": 0.035,
    }.items():
        assert counts[kind] / len(drawn()) == pytest.approx(share, abs=0.05)


def test_people_have_the_heights_of_their_kind():
    assert np.percentile(heights("adult"), 2) > 1.4
    assert np.median(heights("adult")) == pytest.approx(1.72, abs=0.04)
    assert heights("adult").max() < 2.45  # under an umbrella
    assert 0.9 < heights("child").min() < heights("child").max() < 1.65
    assert np.ptp(heights("child")) > 0.4
    assert np.median(heights("wheelchair")) < 1.6


def test_people_stand_on_the_ground_and_stride():
    assert max(abs(mesh.vertices[:, 2].min()) for _, mesh, _ in drawn()) < 1e-9
    lengths = np.array(
        [np.ptp(mesh.vertices[:, 0]) for kind, mesh, _ in drawn() if kind == "adult"]
    )
    assert lengths.min() < 0.4
    assert lengths.max() > 0.9


def test_poses_have_hands_and_stoutness():
    assert {draw_pose(np.random.default_rng(k), 1.1).hands[0][2] for k in range(20)} == {0.47, 0.80}
    assert draw_pose(np.random.default_rng(0), 1.1).stout == 1.1
    assert stand(box((1, 1, 1), (0, 0, 7))).vertices[:, 2].min() == 0


def test_two_wheelers_have_their_shares():
    counts = Counter(kind for kind, _, _ in DRAWN_TWO_WHEELERS)
    assert set(counts) == set(TWO_WHEELERS)
    shares = {
        "bicycle": 0.5,
        "cargo_bicycle": 0.05,
        "e_scooter": 0.15,
        "motorcycle": 0.17,
        "scooter": 0.13,
    }
    for kind, share in shares.items():
        assert counts[kind] / len(DRAWN_TWO_WHEELERS) == pytest.approx(share, abs=0.06)


def test_two_wheelers_stand_on_both_wheels():
    for kind, mesh, _ in DRAWN_TWO_WHEELERS:
        low = mesh.vertices[mesh.vertices[:, 2] < 0.03]
        assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert np.ptp(low[:, 0]) > 0.5 * np.ptp(mesh.vertices[:, 0]) * (
            0.7 if "cargo" in kind else 1
        ), kind
        assert np.ptp(low[:, 1]) < 0.3, kind


DRAWN_TWO_WHEELERS = [draw_two_wheeler(np.random.default_rng([1, k])) for k in range(400)]


def sizes(kind: str) -> np.ndarray:
    return np.array(
        [np.ptp(mesh.vertices, axis=0) for each, mesh, _ in DRAWN_TWO_WHEELERS if each == kind]
    )


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [
        *(
            ("bicycle", (0.85, 0.3, 0.9), (2.1, 0.75, 2.2)),
            ("cargo_bicycle", (1.9, 0.4, 1.4), (2.7, 0.75, 2.2)),
        ),
        *(
            ("e_scooter", (0.9, 0.45, 1.4), (1.4, 0.75, 2.25)),
            ("motorcycle", (1.7, 0.5, 1.4), (2.8, 0.85, 1.95)),
        ),
        ("scooter", (1.4, 0.5, 1.4), (2.2, 0.85, 2.0)),
    ],
)
def test_sizes_are_those_of_the_kind_of_two_wheelers(kind, low, high):
    assert len(sizes(kind))
    assert (sizes(kind) >= low).all(), sizes(kind).min(axis=0)
    assert (sizes(kind) <= high).all(), sizes(kind).max(axis=0)


COUNT = 120


def draw_bodies(rng, label, count):
    return [draw_body(label, rng) for _ in range(count)]


BODIES = {
    label: draw_bodies(np.random.default_rng(label), label, COUNT) for label in range(len(LABELS))
}
RANGES = {
    VEHICLE: ((3.0, 6.3), (1.45, 2.2), (1.25, 2.6)),
    CYCLIST: ((0.8, 3.0), (0.3, 1.0), (0.5, 2.2)),
    PEDESTRIAN: ((0.15, 2.0), (0.25, 1.1), (0.9, 2.5)),
    HEAVY: ((5.0, 18.6), (1.45, 2.65), (1.25, 4.7)),
}


def sizes_bodies(label: int) -> np.ndarray:
    return np.array([body.size for body in BODIES[label]])


@pytest.mark.parametrize("label", RANGES)
def test_sizes_of_a_class_lie_in_its_ranges(label):
    low, high = np.array(RANGES[label]).T
    assert (sizes_bodies(label) >= low - 1e-6).all()
    assert (sizes_bodies(label) <= high + 1e-6).all()
    assert len({body.size for body in BODIES[label]}) == COUNT
    assert {body.label for body in BODIES[label]} == {label}
    assert all(body.name.startswith(f"{LABELS[label]}/") for body in BODIES[label])


@pytest.mark.parametrize("label", RANGES)
def test_meshes_of_a_class_are_sound(label):
    for body in BODIES[label]:
        assert np.isfinite(body.vertices).all()
        assert body.triangles.min() >= 0
        assert body.triangles.max() == len(body.vertices) - 1
        assert 40 <= len(body.triangles) < 3500, body.name
        assert trimesh.Trimesh(body.vertices, body.triangles, process=False).volume > 0
        low = body.vertices[body.vertices[:, 2] < 0.015 - body.size[2] / 2]
        if label != PEDESTRIAN and body.name != "vehicle/block":
            assert np.ptp(low[:, 0]) > 0.3 * body.size[0], (
                body.name
            )  # stands on what is far apart: wheels, no heap


@pytest.mark.parametrize("label", RANGES)
def test_only_mirrors_stick_out_of_the_box_which_is_tight(label):
    """Mirrors: two small parts, beyond the flanks, about as high as a window; everything else ends
    at the box."""
    for body in BODIES[label]:
        half = np.array(body.size) / 2
        beyond = (np.abs(body.vertices) > half + 1e-4).any(axis=1)
        inside = body.vertices[~beyond]
        assert np.allclose([inside.min(axis=0), inside.max(axis=0)], [-half, half], atol=0.01), (
            body.name
        )
        assert np.ptp(include_mirrors(body).vertices, axis=0)[1] <= body.size[1] + 0.62
        if beyond.any():
            assert label in (VEHICLE, HEAVY)
            assert (np.abs(body.vertices[beyond, 1]) > half[1]).all()
            assert (body.vertices[beyond, 2] > -0.25 * body.size[2]).all()
    with_mirrors = sum(np.ptp(body.vertices[:, 1]) > body.size[1] + 0.03 for body in BODIES[label])
    expected = {VEHICLE: (0.5, 0.9), HEAVY: (0.7, 1.0), CYCLIST: (0, 0), PEDESTRIAN: (0, 0)}[label]
    assert expected[0] <= with_mirrors / COUNT <= expected[1]


@pytest.mark.slow
def test_kinds_of_every_class_follow_the_seed():
    kinds = {
        label: {
            body.name.partition("/")[2]
            for body in draw_bodies(np.random.default_rng(1), label, 300)
        }
        for label in RANGES
    }
    assert {"adult", "child", "pram", "walker", "wheelchair"} == kinds[PEDESTRIAN]
    assert {"bicycle", "cargo_bicycle", "e_scooter", "motorcycle", "scooter"} <= kinds[CYCLIST]
    assert {"minibus", "bus", "bendy_bus", "box_truck", "tank_truck", "articulated_box"} <= kinds[
        HEAVY
    ]
    assert any(kind.endswith("with_caravan") for kind in kinds[HEAVY])
    assert {"kei", "van", "pickup", "block_sedan", "estate_rails"} <= kinds[VEHICLE]
    for carried in ("taxi", "roof_box", "rack", "load"):
        assert any(kind.endswith(carried) for kind in kinds[VEHICLE]), carried
    for label in RANGES:
        first, again, other = (draw_body(label, np.random.default_rng(seed)) for seed in (3, 3, 4))
        assert first.vertices.tobytes() == again.vertices.tobytes()
        assert (first.name, first.truth) == (again.name, again.truth)
        assert first.vertices.tobytes() != other.vertices.tobytes()
    with pytest.raises(ValueError, match="label must be one of"):
        draw_body("tram", np.random.default_rng(0))


@pytest.mark.parametrize("name", LABELS)
def test_classes_go_by_their_names_too(name):
    assert draw_body(name, np.random.default_rng(0)).label == LABELS.index(name)
