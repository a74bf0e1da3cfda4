from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies.car_extras import CARRIED, draw_load, draw_mirrors
from toolkit.bodies.car_shapes import (
    CAR_HEIGHTS_M,
    CAR_KINDS,
    CAR_LENGTHS_M,
    CAR_WIDTHS_M,
    build_block_car,
    draw_proportions,
    loft_car,
)
from toolkit.bodies.mesh_parts import mound, plank, stretch
from toolkit.bodies.trailers import TRAILERS, draw_trailer
from toolkit.mesh import box

CARS = [draw_proportions(np.random.default_rng([2, k])) for k in range(400)]


def test_kinds_have_their_shares():
    assert sum(kind.share for kind in CAR_KINDS) == pytest.approx(1)
    for kind in CAR_KINDS:
        assert np.mean([car.kind == kind.name for car in CARS]) == pytest.approx(
            kind.share, abs=0.055
        )


def test_sizes_fill_their_ranges():
    for measure, (low, high) in (
        *(("length", CAR_LENGTHS_M), ("width", CAR_WIDTHS_M), ("height", CAR_HEIGHTS_M)),
    ):
        values = [getattr(car, measure) for car in CARS]
        assert low <= min(values) < low + 0.1 * (high - low)
        assert high >= max(values) > high - 0.25 * (high - low)


def test_the_same_seed_draws_the_same_car():
    first, again = (draw_proportions(np.random.default_rng(8)) for _ in range(2))
    assert first.length == again.length
    assert first.profile.tobytes() == again.profile.tobytes()


def test_wheels_lie_below_the_body():
    for car in CARS:
        front, rear = car.axles
        assert car.wheel < front < rear < car.length - car.wheel
        assert 0.5 * car.length <= rear - front <= 0.78 * car.length, car.kind
        assert car.clearance < car.wheel * 1.1


def test_profiles_go_from_end_to_end_and_differ():
    for car in CARS:
        stations, heights = car.profile.T
        assert stations[0] == 0
        assert stations[-1] == 1
        assert (np.diff(stations) > 0).all()
        assert heights.max() == 1
        assert heights.min() > 0.2
    assert len({car.profile.tobytes() for car in CARS}) == len(CARS)


CARS_CARS = [draw_proportions(np.random.default_rng([3, k])) for k in range(40)]
SHUT = [car for car in CARS_CARS if car.kind != "pickup"]


def first_hits(mesh, starts, direction):
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    rays = np.concatenate([starts, np.broadcast_to(direction, starts.shape)], axis=1).astype(
        np.float32
    )
    return scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


@pytest.mark.parametrize(
    "build", [loft_car, lambda car: build_block_car(car, np.random.default_rng(0))]
)
def test_cars_are_as_large_as_they_were_drawn(build):
    for car in CARS_CARS:
        vertices = build(car).vertices
        assert np.allclose(np.ptp(vertices, axis=0), (car.length, car.width, car.height), atol=1e-9)
        assert vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert np.allclose(np.sort(vertices[:, 1]), np.sort(-vertices[:, 1]), atol=1e-9)


def test_meshes_of_cars_have_no_holes_wheels_and_round_corners():
    """Rays from above meet the body above its floor wherever it is, and rays from the left its left
    half."""
    for car in SHUT:
        mesh = loft_car(car)
        x, y = np.meshgrid(
            np.linspace(-0.45, 0.45, 31) * car.length, np.linspace(-0.28, 0.28, 15) * car.width
        )
        height = 5 - first_hits(
            mesh, np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)]), [0.0, 0, -1]
        )
        assert height.min() > 0.25 * car.height, car.kind
        assert height.max() <= car.height + 1e-4
        # above the lips of the bumpers
        z = np.linspace(car.clearance + 0.16, 0.65 * car.belt * car.height, 8)
        x, z = np.meshgrid(np.linspace(-0.43, 0.43, 41) * car.length, z)
        across = 5 - first_hits(
            mesh, np.column_stack([x.ravel(), np.full(x.size, 5.0), z.ravel()]), [0.0, -1, 0]
        )
        assert across.min() > 0.2 * car.width, car.kind
    for car in CARS_CARS:
        vertices = loft_car(car).vertices
        low = vertices[vertices[:, 2] < 0.02]
        assert len({(x > 0, y > 0) for x, y in low[:, :2].tolist()}) == 4
        assert np.ptp(low[:, 0]) > 0.45 * car.length
        assert np.ptp(low[:, 1]) > 0.6 * car.width
    assert (
        max(len(build_block_car(car, np.random.default_rng(1)).triangles) for car in CARS_CARS)
        < 420
    )
    assert min(len(loft_car(car).triangles) for car in CARS_CARS) > 1200
    car = replace(CARS_CARS[0], rounding=(0.1, 0.1), ends=(0.7, 0.8))
    width = car.half_width(np.array([0.0, 0.5, 1.0])) / (car.width / 2)
    assert width == pytest.approx(
        [0.7 * (1 - 0.05 * 1.05**2), 1, 0.8 * (1 - 0.05 * 0.95**2)], abs=2e-3
    )


def test_beds_planks_and_mounds_lie_as_high_as_they_should():
    pickups = [
        car
        for car in (draw_proportions(np.random.default_rng([4, k])) for k in range(150))
        if car.kind == "pickup"
    ]
    assert pickups
    for car in pickups:
        assert car.bed is not None
        front, rear, _ = car.bed
        assert 0.5 < front < 0.75 < rear < 1
        x = car.length * (0.5 - (front + rear) / 2)
        bed = 5 - first_hits(loft_car(car), np.array([[x, 0.0, 5.0]]), [0.0, 0, -1])[0]
        assert bed < 0.62 * car.height
    moved = stretch(box((1, 2, 3), (7, 7, 7)), (4.0, 2.0, 1.0))
    assert np.allclose(moved.vertices.min(axis=0), [-2, -1, 0])
    assert np.allclose(moved.vertices.max(axis=0), [2, 1, 1])
    assert np.allclose(plank((1.0, 2.0, 3.0), 4.0, 5.0, 6.0).vertices[:, 2].min(), 6)
    vertices = mound((2.0, 1.0, 0.5), 3.0, 0.7).vertices
    assert np.allclose(vertices.min(axis=0)[[0, 2]], [2, 0.7], atol=0.01)
    assert np.allclose(vertices.max(axis=0), [4, 0.5, 1.2], atol=0.02)


CARS_EXTRAS = [draw_proportions(np.random.default_rng([6, k])) for k in range(300)]


def test_mirrors_stick_out_at_the_front():
    sides = []
    for number, car in enumerate(CARS_EXTRAS):
        vertices = draw_mirrors(car, np.random.default_rng([1, number])).vertices
        beyond = vertices[np.abs(vertices[:, 1]) > car.width / 2 + 1e-6]
        sides.append(len(set(np.sign(beyond[:, 1]).tolist())))
        if len(beyond):
            assert 0.079 < np.abs(beyond[:, 1]).max() - car.width / 2 < 0.256
            assert (beyond[:, 0] > 0).all()
            assert (beyond[:, 2] > 0.4 * car.height).all()
            assert (beyond[:, 2] < car.height).all()
    assert np.mean(np.array(sides) == 0) == pytest.approx(0.3, abs=0.07)
    assert 0 < np.mean(np.array(sides) == 1) < 0.06


def test_trailers_follow_on_the_ground():
    seen = set()
    for number in range(30):
        car = replace(CARS_EXTRAS[number], height=1.5)
        kind, mesh = draw_trailer(car, np.random.default_rng(number))
        seen.add(kind)
        assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert -car.length / 2 < mesh.vertices[:, 0].max() < -car.length / 2 + 0.2
        assert -car.length / 2 - 8.5 < mesh.vertices[:, 0].min() < -car.length / 2 - 2.5
        assert 1.3 < np.ptp(mesh.vertices[:, 1]) < 2.6
    assert seen == set(TRAILERS)


def test_loads_lie_on_roofs_and_beds():
    seen = set()
    for number, car in enumerate(CARS_EXTRAS):
        carried, load = draw_load(car, np.random.default_rng([2, number]))
        seen.add(carried)
        assert bool(carried) == bool(len(load.triangles))
        if carried in ("taxi", "light_bar", "roof_box", "rack", "rails"):
            low, high = load.vertices.min(axis=0), load.vertices.max(axis=0)
            assert car.height - 0.08 < low[2] < car.height + 0.05, carried
            assert car.height < high[2] < car.height + 0.5, carried
            assert max(-low[1], high[1]) < car.width / 2
            assert max(-low[0], high[0]) < 0.62 * car.length
    assert seen == {"", *CARRIED}
    pickup = next(car for car in CARS_EXTRAS if car.kind == "pickup")
    for number in range(40):
        carried, load = draw_load(pickup, np.random.default_rng(number))
        if carried == "load":
            low, high = load.vertices.min(axis=0), load.vertices.max(axis=0)
            assert low[0] > -pickup.length / 2
            assert high[0] < 0
            assert high[1] - low[1] < 0.8 * pickup.width
