import numpy as np
import pytest

from toolkit.bodies.body import tight
from toolkit.bodies.drawn.bodies import drawn_body
from toolkit.bodies.fleet import catalogue
from toolkit.bodies.mesh_shapes import clear_class, measured, mirror_span, surface_points, wrong_stand
from toolkit.mesh import Mesh, box, ellipsoid, merge, tube
from toolkit.objects import CYCLIST, HEAVY, LABELS, PEDESTRIAN, VEHICLE

OURS = {body.name: body for body in catalogue()}
ON_ITS_SIDE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def shape_of(mesh, turn=None):
    vertices = np.asarray(mesh.vertices, np.float64) @ (np.eye(3) if turn is None else turn).T
    return measured(vertices, np.asarray(mesh.triangles, np.int64))


def elephant(length=4.4, width=1.8, height=1.7):
    """A trunk, head, ears, and four legs under a belly."""
    legs = [tube([(x, y, 0), (x, y, 0.9)], 0.2, 8) for x in (-0.9, 0.9) for y in (-0.45, 0.45)]
    parts = [ellipsoid((0, 0, 1.3), (1.5, 0.8, 0.7)), ellipsoid((1.7, 0, 1.7), (0.6, 0.5, 0.5)), *legs]
    parts += [tube([(2.2, 0, 1.6), (2.7, 0, 0.8), (2.8, 0, 0.2)], 0.15), ellipsoid((1.5, 0.7, 1.8), (0.1, 0.4, 0.5)),
              ellipsoid((1.5, -0.7, 1.8), (0.1, 0.4, 0.5))]  # fmt: skip
    mesh = merge(parts)
    return Mesh(mesh.vertices * (np.array([length, width, height]) / np.ptp(mesh.vertices, axis=0)), mesh.triangles)


def table():
    return merge([box((1.8, 0.9, 0.05), (0, 0, 0.75)), *(box((0.06, 0.06, 0.75), (x, y, 0.375))
                                                        for x in (-0.8, 0.8) for y in (-0.4, 0.4))])  # fmt: skip


def horse():
    legs = [tube([(x, y, 0), (x, y, 1.0)], 0.07, 6) for x in (-0.6, 0.6) for y in (-0.2, 0.2)]
    return merge([ellipsoid((0, 0, 1.2), (0.9, 0.3, 0.35)), ellipsoid((1.1, 0, 1.7), (0.3, 0.12, 0.2)), *legs])


@pytest.mark.parametrize("name", ["family_sedan", "large_suv", "double_cab_pickup", "coupe", "delivery_van"])
def test_cars_are_clearly_cars(name):
    shape = shape_of(OURS[name])
    assert [label for label in range(4) if clear_class(shape, label)] == [VEHICLE]
    assert wrong_stand(shape, VEHICLE) is None


@pytest.mark.parametrize(
    ("name", "label"),
    [("city_bus", HEAVY), ("box_truck", HEAVY), ("city_bicycle", CYCLIST), ("motorcycle", CYCLIST),
     ("man_standing", PEDESTRIAN), ("man_striding", PEDESTRIAN)],
)  # fmt: skip
def test_the_others_are_clearly_what_they_are(name, label):
    shape = shape_of(OURS[name])
    assert [each for each in range(4) if clear_class(shape, each)] == [label]
    assert wrong_stand(shape, label) is None


@pytest.mark.parametrize(
    "mesh",
    [elephant(), elephant(6.0, 2.4, 3.2), elephant(3.2, 1.5, 1.45), table(), horse(), box((0.6, 0.6, 1.8)),
     box((0.5, 0.5, 0.9)), ellipsoid((0, 0, 1), (2.2, 0.9, 0.75), 12, 16)],
    ids=["calf", "elephant", "small_elephant", "table", "horse", "wardrobe", "stool", "egg"],
)  # fmt: skip
def test_animals_and_furniture_are_clearly_nothing(mesh):
    assert not [LABELS[label] for label in range(4) if clear_class(shape_of(mesh), label)]


@pytest.mark.parametrize(
    ("turn", "says"),
    [
        (ON_ITS_SIDE, "lies on its side"),
        (np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), "stands across"),
        (np.diag([-1.0, -1, 1]), "face backwards"),
    ],
)
def test_how_a_car_stands_is_seen(turn, says):
    assert says in wrong_stand(shape_of(OURS["compact_hatchback"], turn), VEHICLE)
    assert says == "face backwards" or not clear_class(shape_of(OURS["compact_hatchback"], turn), VEHICLE)


def test_somebody_who_lies_is_seen():
    assert "lies" in wrong_stand(
        shape_of(OURS["man_standing"], np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])), PEDESTRIAN
    )


def test_measures_of_a_box_are_exact():
    shape = shape_of(box((4.0, 2.0, 1.0), (7, 8, 9)))
    assert np.allclose(shape.size, [4, 2, 1])
    assert (shape.fills == 1).all()
    assert (shape.asymmetry < 1e-6).all()
    assert shape.stance == pytest.approx((4, 2), abs=0.05)
    assert shape.clearance == pytest.approx(0)
    assert shape.ahead == pytest.approx(0, abs=1e-6)


def test_flat_meshes_are_refused():
    with pytest.raises(ValueError, match="has no volume"):
        measured(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match="has no surface"):
        surface_points(np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]]), np.array([[0, 1, 2]]))


def test_points_are_spread_by_area():
    two = merge([box((1.0, 1.0, 1.0)), box((2.0, 2.0, 2.0), (5, 0, 0))])
    points = surface_points(two.vertices, two.triangles)
    assert (points[:, 0] > 3).mean() == pytest.approx(0.8, abs=0.01)


def test_mirrors_are_found_to_the_centimetre_and_nothing_else():
    """Drawn bodies know how wide they are without them: an oracle."""
    for number in range(40):
        body = drawn_body(VEHICLE, np.random.default_rng([11, number]))
        whole = tight(body)
        span = mirror_span(whole.vertices.astype(np.float64), whole.triangles.astype(np.int64))
        width = whole.size[1] if span is None else span[1] - span[0]
        assert width == pytest.approx(body.size[1], abs=0.03), body.name
