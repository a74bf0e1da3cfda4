import numpy as np
import pytest

from toolkit.bodies.body import Body, centred, vary
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


@pytest.mark.parametrize("body", of(VEHICLE), ids=lambda body: body.name)
def test_cars_have_the_measures_of_cars(body):
    length, width, height = body.size
    assert 3.5 <= length <= 5.6
    assert 1.6 <= width <= 2.12
    assert 1.15 <= height <= 2.3
    ends = np.abs(body.vertices[:, 0]) > 0.48 * length
    assert np.ptp(body.vertices[ends, 1]) < 0.92 * width  # bumpers are rounded in plan
    roof = body.vertices[:, 2] > 0.40 * height
    assert np.ptp(body.vertices[roof, 1]) < 0.86 * width  # tumblehome
    touching = body.vertices[body.vertices[:, 2] < -0.499 * height]
    assert np.ptp(touching[:, 0]) > 0.5 * length  # stands on four wheels
    assert np.ptp(touching[:, 1]) > 0.6 * width
    assert np.allclose(np.sort(body.vertices[:, 1]), np.sort(-body.vertices[:, 1]), atol=1e-5)


def test_cars_differ_pairwise():
    def profile(body: Body) -> np.ndarray:
        """Size and, along the length, the height of the body."""
        x, z = body.vertices[:, 0] / body.size[0], body.vertices[:, 2] + body.size[2] / 2
        bins = np.clip(((x + 0.5) * 12).astype(int), 0, 11)
        return np.array([*body.size, *(z[bins == b].max() for b in range(12))])

    profiles = np.array([profile(body) for body in of(VEHICLE)])
    apart = np.abs(profiles[:, None] - profiles[None]).max(axis=2)
    assert apart[~np.eye(len(profiles), dtype=bool)].min() > 0.08


def test_pedestrians_and_riders_are_as_tall_as_people():
    heights = [body.size[2] for body in of(PEDESTRIAN) if "umbrella" not in body.name]
    assert min(heights) == pytest.approx(1.12, abs=0.05)
    assert max(heights) == pytest.approx(1.95, abs=0.05)
    assert all(1.2 < body.size[2] < 1.95 and 1.1 < body.size[0] < 2.3 for body in of(CYCLIST))


def test_heavy_vehicles_hide_what_is_behind_them():
    assert all(body.size[0] > 6 and body.size[2] > 2.6 for body in of(HEAVY))


def test_centring_moves_any_mesh_into_its_box():
    body = centred("plank", VEHICLE, np.array([[5.0, 5, 5], [9, 6, 5], [9, 6, 6.5]]), np.array([[0, 1, 2]]))
    assert body.size == (4.0, 1.0, 1.5)
    assert np.allclose(body.vertices[0], [-2, -0.5, -0.75])


def test_varied_bodies_keep_tight_centred_boxes_and_stay_near_their_size():
    rng = np.random.default_rng(4)
    varied = [vary(EVERY[0], rng) for _ in range(50)]
    ratios = np.array([body.size for body in varied]) / EVERY[0].size
    assert all(np.allclose(b.vertices.min(axis=0), -b.vertices.max(axis=0), atol=1e-5) for b in varied)
    assert (np.abs(ratios - 1) <= 0.0601).all()
    assert ratios.std(axis=0).min() > 0.015
