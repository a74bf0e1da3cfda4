from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest

from toolkit.bodies.drawn.cars import bed_of, block_car, half_width, lofted_car, mound, plank, stretched
from toolkit.bodies.drawn.proportions import drawn_proportions
from toolkit.mesh import box

CARS = [drawn_proportions(np.random.default_rng([3, k])) for k in range(40)]
SHUT = [car for car in CARS if car.kind != "pickup"]


def first_hits(mesh, starts, direction):
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    rays = np.concatenate([starts, np.broadcast_to(direction, starts.shape)], axis=1).astype(np.float32)
    return scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()


@pytest.mark.parametrize("build", [lofted_car, lambda car: block_car(car, np.random.default_rng(0))])
def test_cars_are_as_large_as_they_were_drawn(build):
    for car in CARS:
        vertices = build(car).vertices
        assert np.allclose(np.ptp(vertices, axis=0), (car.length, car.width, car.height), atol=1e-9)
        assert vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
        assert np.allclose(np.sort(vertices[:, 1]), np.sort(-vertices[:, 1]), atol=1e-9)


def test_there_are_no_holes_from_above_nor_from_the_side():
    """Rays from above meet the body above its floor wherever it is, and rays from the left its left half."""
    for car in SHUT:
        mesh = lofted_car(car)
        x, y = np.meshgrid(np.linspace(-0.45, 0.45, 31) * car.length, np.linspace(-0.28, 0.28, 15) * car.width)
        height = 5 - first_hits(mesh, np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 5.0)]), [0.0, 0, -1])
        assert height.min() > 0.25 * car.height, car.kind
        assert height.max() <= car.height + 1e-4
        z = np.linspace(car.clearance + 0.16, 0.65 * car.belt * car.height, 8)  # above the lips of the bumpers
        x, z = np.meshgrid(np.linspace(-0.43, 0.43, 41) * car.length, z)
        across = 5 - first_hits(mesh, np.column_stack([x.ravel(), np.full(x.size, 5.0), z.ravel()]), [0.0, -1, 0])
        assert across.min() > 0.2 * car.width, car.kind


def test_four_wheels_touch_the_ground():
    for car in CARS:
        vertices = lofted_car(car).vertices
        low = vertices[vertices[:, 2] < 0.02]
        corners = {(x > 0, y > 0) for x, y in low[:, :2].tolist()}
        assert len(corners) == 4
        assert np.ptp(low[:, 0]) > 0.45 * car.length
        assert np.ptp(low[:, 1]) > 0.6 * car.width


def test_block_cars_have_few_triangles_and_lofted_ones_enough():
    assert max(len(block_car(car, np.random.default_rng(1)).triangles) for car in CARS) < 420
    assert min(len(lofted_car(car).triangles) for car in CARS) > 1200


def test_flanks_are_nearly_parallel_and_corners_rounded():
    car = replace(CARS[0], rounding=(0.1, 0.1), ends=(0.7, 0.8))
    width = half_width(car, np.array([0.0, 0.5, 1.0])) / (car.width / 2)
    assert width == pytest.approx([0.7 * (1 - 0.05 * 1.05**2), 1, 0.8 * (1 - 0.05 * 0.95**2)], abs=2e-3)


def test_a_pick_up_has_a_bed_lower_than_its_cab():
    pickups = [
        car for car in (drawn_proportions(np.random.default_rng([4, k])) for k in range(150)) if car.kind == "pickup"
    ]
    assert pickups
    for car in pickups:
        front, rear = bed_of(car)
        assert 0.5 < front < 0.75 < rear < 1
        x = car.length * (0.5 - (front + rear) / 2)
        bed = 5 - first_hits(lofted_car(car), np.array([[x, 0.0, 5.0]]), [0.0, 0, -1])[0]
        assert bed < 0.62 * car.height


def test_stretching_and_planks():
    moved = stretched(box((1, 2, 3), (7, 7, 7)), (4.0, 2.0, 1.0))
    assert np.allclose(moved.vertices.min(axis=0), [-2, -1, 0])
    assert np.allclose(moved.vertices.max(axis=0), [2, 1, 1])
    assert np.allclose(plank((1.0, 2.0, 3.0), 4.0, 5.0, 6.0).vertices[:, 2].min(), 6)


def test_mounds_lie_on_their_height():
    vertices = mound((2.0, 1.0, 0.5), 3.0, 0.7).vertices
    assert np.allclose(vertices.min(axis=0)[[0, 2]], [2, 0.7], atol=0.01)
    assert np.allclose(vertices.max(axis=0), [4, 0.5, 1.2], atol=0.02)
