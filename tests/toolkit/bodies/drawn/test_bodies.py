import numpy as np
import pytest

from toolkit.bodies.body import tight
from toolkit.bodies.drawn.bodies import drawn_bodies, drawn_body
from toolkit.mesh import Mesh, volume
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

COUNT = 120
BODIES = {label: drawn_bodies(np.random.default_rng(label), {label: COUNT}) for label in range(len(LABELS))}
RANGES = {
    VEHICLE: ((3.0, 6.3), (1.45, 2.2), (1.25, 2.6)),
    CYCLIST: ((0.8, 3.0), (0.3, 1.0), (0.5, 2.2)),
    PEDESTRIAN: ((0.15, 2.0), (0.25, 1.1), (0.9, 2.5)),
    HEAVY: ((5.0, 18.6), (1.45, 2.65), (1.25, 4.7)),
}


def sizes(label: int) -> np.ndarray:
    return np.array([body.size for body in BODIES[label]])


@pytest.mark.parametrize("label", RANGES)
def test_sizes_lie_in_the_ranges_of_their_class_and_spread(label):
    low, high = np.array(RANGES[label]).T
    assert (sizes(label) >= low - 1e-6).all()
    assert (sizes(label) <= high + 1e-6).all()
    assert len({body.size for body in BODIES[label]}) == COUNT
    assert {body.label for body in BODIES[label]} == {label}
    assert all(body.name.startswith(f"{LABELS[label]}/") for body in BODIES[label])


@pytest.mark.parametrize("label", RANGES)
def test_meshes_are_sound_and_stand_on_their_box(label):
    for body in BODIES[label]:
        assert np.isfinite(body.vertices).all()
        assert body.triangles.min() >= 0
        assert body.triangles.max() == len(body.vertices) - 1
        assert 40 <= len(body.triangles) < 3500, body.name
        assert volume(Mesh(body.vertices.astype(np.float64), body.triangles.astype(np.int64))) > 0
        assert body.vertices[:, 2].min() == pytest.approx(-body.size[2] / 2, abs=1e-3), body.name


@pytest.mark.parametrize("label", RANGES)
def test_only_mirrors_stick_out_of_the_box_which_is_tight(label):
    """Mirrors: two small parts, beyond the flanks, about as high as a window; everything else ends at the box."""
    for body in BODIES[label]:
        half = np.array(body.size) / 2
        beyond = (np.abs(body.vertices) > half + 1e-4).any(axis=1)
        inside = body.vertices[~beyond]
        assert np.allclose([inside.min(axis=0), inside.max(axis=0)], [-half, half], atol=0.01), body.name
        assert np.ptp(tight(body).vertices, axis=0)[1] <= body.size[1] + 0.62
        if beyond.any():
            assert label in (VEHICLE, HEAVY)
            assert (np.abs(body.vertices[beyond, 1]) > half[1]).all()
            assert (body.vertices[beyond, 2] > -0.25 * body.size[2]).all()
    with_mirrors = sum(np.ptp(body.vertices[:, 1]) > body.size[1] + 0.03 for body in BODIES[label])
    expected = {VEHICLE: (0.5, 0.9), HEAVY: (0.7, 1.0), CYCLIST: (0, 0), PEDESTRIAN: (0, 0)}[label]
    assert expected[0] <= with_mirrors / COUNT <= expected[1]


def test_the_length_of_a_car_does_not_tell_its_width_nor_its_height():
    length, width, height = np.array([drawn_body(VEHICLE, np.random.default_rng([9, k])).size for k in range(400)]).T
    for other, least in ((width, 0.08), (height, 0.16)):
        fit = np.polyfit(length, other, 1)
        assert np.std(other - np.polyval(fit, length)) > least
    assert 0.3 < np.corrcoef(length, width)[0, 1] < 0.85  # a kei car is not 6 m long
    assert length[width < 1.6].mean() < 3.9
    assert np.ptp(length) > 2.6
    assert np.ptp(width) > 0.6
    assert np.ptp(height) > 1.0


def test_there_are_kinds_of_every_class_with_and_without_riders():
    kinds = {label: {body.name.partition("/")[2] for body in drawn_bodies(np.random.default_rng(1), {label: 300})}
             for label in RANGES}  # fmt: skip
    assert {"adult", "child", "pram", "walker", "wheelchair"} == kinds[PEDESTRIAN]
    assert {"bicycle", "bicycle_alone", "cargo_bicycle", "e_scooter", "motorcycle", "scooter"} <= kinds[CYCLIST]
    assert {"minibus", "bus", "bendy_bus", "box_truck", "tank_truck", "articulated_box"} <= kinds[HEAVY]
    assert any(kind.endswith("with_caravan") for kind in kinds[HEAVY])
    assert {"kei", "van", "pickup", "block_sedan", "estate_rails"} <= kinds[VEHICLE]
    for carried in ("taxi", "roof_box", "rack", "load"):
        assert any(kind.endswith(carried) for kind in kinds[VEHICLE]), carried


def test_a_seed_gives_a_body_and_another_seed_another():
    for label in RANGES:
        first, again, other = (drawn_body(label, np.random.default_rng(seed)) for seed in (3, 3, 4))
        assert first.vertices.tobytes() == again.vertices.tobytes()
        assert (first.name, first.truth) == (again.name, again.truth)
        assert first.vertices.tobytes() != other.vertices.tobytes()


@pytest.mark.parametrize("name", LABELS)
def test_classes_go_by_their_names_too(name):
    assert drawn_body(name, np.random.default_rng(0)).label == LABELS.index(name)


def test_a_class_nobody_knows_is_refused():
    with pytest.raises(ValueError, match="label must be one of"):
        drawn_body("tram", np.random.default_rng(0))
