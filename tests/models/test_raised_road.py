"""The shipped network at a roadside lidar of a road 3.3 m above the land next to it, with default
levelling."""

import numpy as np
import open3d as o3d
import pytest

from coview.detector_spec import DetectorSpec
from coview.detectors import open_detector
from toolkit.bodies.drawn_bodies import draw_body
from toolkit.calibration.place import Place
from toolkit.detection.detect import detect_frames
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import VEHICLE, Objects

ROAD_M, HALF_WIDTH_M, BANK_RUN = 3.3, 6.0, 1.5
LIDAR_M = (0.0, -5.5, ROAD_M + 5.0)
POINTS = (122, 700)


def land_mesh() -> o3d.t.geometry.TriangleMesh:
    """Level land with a bank along x."""
    y = np.array([-90.0, -HALF_WIDTH_M - BANK_RUN * ROAD_M, -HALF_WIDTH_M])
    profile = np.column_stack([np.concatenate([y, -y[::-1]]), [0.0, 0.0, ROAD_M, ROAD_M, 0.0, 0.0]])
    near, far = (np.column_stack([np.full(6, x), profile]) for x in (-90.0, 90.0))
    corners = [[k, k + 1, k + 7, k, k + 7, k + 6] for k in range(5)]
    mesh = o3d.t.geometry.TriangleMesh()
    mesh.vertex.positions = o3d.core.Tensor(np.concatenate([near, far]).astype(np.float32))
    mesh.triangle.indices = o3d.core.Tensor(np.array(corners, np.int32).reshape(-1, 3))
    return mesh


def cloud_of_cars(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in the lidar's frame, the cars' middles there, and their numbers of points."""
    rng = np.random.default_rng(seed)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(land_mesh())
    middles = []
    for x in (-24.0, -15.0, 13.0, 19.0, 24.0):
        body = draw_body(VEHICLE, rng)
        middle = np.array([x, float(rng.choice([-1.9, 1.9])), ROAD_M + body.size[2] / 2])
        mesh = o3d.t.geometry.TriangleMesh()
        mesh.vertex.positions = o3d.core.Tensor((body.vertices + middle).astype(np.float32))
        mesh.triangle.indices = o3d.core.Tensor(body.triangles.astype(np.int32))
        scene.add_triangles(mesh)
        middles.append(middle)
    up, around = np.meshgrid(
        np.deg2rad(np.linspace(-25, 10, 64)), np.deg2rad(np.arange(0, 360, 0.3)), indexing="ij"
    )
    ways = np.stack(
        [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1
    ).reshape(-1, 3)
    rays = np.column_stack([np.tile(LIDAR_M, (len(ways), 1)), ways]).astype(np.float32)
    hits = scene.cast_rays(o3d.core.Tensor(rays))
    far, mesh_number = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
    hit = far < 120.0
    lengths = far[hit] + 0.02 * rng.standard_normal(hit.sum())
    counts = np.array([(mesh_number == 1 + k).sum() for k in range(len(middles))])
    return lengths[:, None] * ways[hit], np.array(middles) - LIDAR_M, counts


@pytest.mark.one_in(2)
@pytest.mark.parametrize("seed", [0, 1])
def test_cars_on_a_raised_road_are_found_by_default(seed: int) -> None:
    points, middles, counts = cloud_of_cars(seed)
    seen = (counts >= POINTS[0]) & (counts <= POINTS[1])
    assert seen.sum() >= 3
    cloud = SensorCloud("lidar", points.astype(np.float32), np.eye(4))
    frame = Frame.of_clouds("0", (cloud,), Objects.empty())
    (detected,) = detect_frames(
        [frame], open_detector(DetectorSpec.from_name("general"), Place()), Place(level="map")
    )
    found = detected.detections.boxes[detected.detections.labels == VEHICLE, :3]
    apart = np.linalg.norm(middles[seen, None] - found[None], axis=2).min(axis=1)
    assert (apart < 0.7).mean() >= 0.75
