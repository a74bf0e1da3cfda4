"""What every sensor would measure of a moment, noise-free, and which object each of its rays meets.

What stands still is cast once per sensor and kept; the nearer hit counts. What moves is cast body by body: every body has a
ray casting scene of its own, in its own frame, built once. Per frame only the rays that can meet an object's box are turned into
the frame of its body and cast there, so nothing is rebuilt between frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import open3d as o3d

from toolkit.arrays import Float32, Float64, Int32
from toolkit.bodies import Body
from toolkit.boxes import corners
from toolkit.geometry import invert, pose, transform
from toolkit.mesh import Mesh
from toolkit.scenery import scenery as build_scenery
from toolkit.sensors import DepthCamera, Sensor, SensorModel, SpinningLidar
from toolkit.site import Site
from toolkit.traffic import Snapshot

NEAR = 0.3  # m; nothing nearer returns, so a sensor does not see the post it hangs on


class Rendered(NamedTuple):
    """Per sensor an image: measurement (m, depth of a camera, range of a lidar, 0 no return), and the row of the object
    in the snapshot that was hit (-1: none, or what stands still)."""

    measurements: tuple[Float32[np.ndarray, "_ _"], ...]
    hits: tuple[Int32[np.ndarray, "_ _"], ...]


class Renderer:
    """Casts the rays of sensors at a site.

    bodies: what `Snapshot.bodies` counts; scenery: the mesh of what stands still, made from the site unless given;
    threads: of Open3D, 0 for all cores. Holds one image per sensor (`background`, the measurements of the empty site) and
    no rays, so thousands of sensors fit. Pickles as its arguments; the scenes are built again where it is unpickled.
    """

    def __init__(
        self,
        site: Site,
        bodies: Sequence[Body],
        sensors: Sequence[Sensor],
        scenery: Mesh | None = None,
        threads: int = 0,
    ) -> None:
        self.sensors = tuple(sensors)
        self.bodies = tuple(bodies)
        self._arguments = (site, self.bodies, self.sensors, scenery or build_scenery(site), threads)
        self._threads = threads
        self._scenes: dict[int, o3d.t.geometry.RaycastingScene] = {}
        self._sizes = np.array([body.size for body in bodies]).reshape(-1, 3)
        still = _scene(*self._arguments[3], threads)
        self.background = tuple(self._cast_all(still, sensor) for sensor in self.sensors)

    def __reduce__(self) -> tuple[Any, ...]:
        return Renderer, self._arguments

    def render(self, snapshot: Snapshot) -> Rendered:
        """Measurements and hits of all sensors. Raises ValueError where a box is not the box of its body."""
        boxes, chosen = snapshot.objects.boxes, snapshot.bodies
        self._check(boxes, chosen)
        world_corners = corners(boxes)
        images = [self._render(sensor, i, boxes, chosen, world_corners) for i, sensor in enumerate(self.sensors)]
        return Rendered(tuple(depth for depth, _ in images), tuple(hit for _, hit in images))

    def _render(
        self, sensor: Sensor, index: int, boxes: np.ndarray, chosen: np.ndarray, world_corners: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        depth = np.where(self.background[index] > 0, self.background[index], np.float32(sensor.model.max_range))
        hits = np.full(depth.shape, -1, np.int32)
        rays = sensor.model.rays()
        sensor_corners = transform(invert(sensor.pose), world_corners)
        for row, pixels in windows(sensor.model, sensor_corners):
            x, y, z, *_, yaw = boxes[row]
            body_SE3_sensor = invert(pose(x, y, z, yaw=yaw)) @ sensor.pose
            found = self._cast(self._scene_of(chosen[row]), rays[pixels], body_SE3_sensor)
            nearer = found < depth[pixels]
            depth[pixels] = np.where(nearer, found, depth[pixels])
            hits[pixels] = np.where(nearer, np.int32(row), hits[pixels])
        empty = (hits < 0) & (self.background[index] == 0)
        depth[empty] = 0.0
        return depth, hits

    def _cast_all(self, scene: o3d.t.geometry.RaycastingScene, sensor: Sensor) -> np.ndarray:
        found = self._cast(scene, sensor.model.rays(), sensor.pose)
        return np.where(found < sensor.model.max_range, found, np.float32(0))

    def _cast(
        self, scene: o3d.t.geometry.RaycastingScene, rays: np.ndarray, scene_SE3_sensor: np.ndarray
    ) -> Float32[np.ndarray, "_ _"]:
        """Measurement along each ray (rows, columns, 3), infinite where it meets nothing beyond `NEAR`."""
        lines = np.empty((*rays.shape[:-1], 6), np.float32)
        lines[..., 3:] = rays @ scene_SE3_sensor[:3, :3].T.astype(np.float32)
        lines[..., :3] = scene_SE3_sensor[:3, 3].astype(np.float32) + np.float32(NEAR) * lines[..., 3:]
        hit = scene.cast_rays(o3d.core.Tensor.from_numpy(lines), self._threads)
        return hit["t_hit"].numpy() + np.float32(NEAR)

    def _scene_of(self, body: int) -> o3d.t.geometry.RaycastingScene:
        if body not in self._scenes:
            self._scenes[body] = _scene(self.bodies[body].vertices, self.bodies[body].triangles, self._threads)
        return self._scenes[body]

    def _check(self, boxes: np.ndarray, chosen: np.ndarray) -> None:
        misfit = np.abs(boxes[:, 3:6] - self._sizes[chosen]).max(axis=1, initial=0) > 0.02
        if misfit.any():
            row = int(np.flatnonzero(misfit)[0])
            body = self.bodies[chosen[row]]
            raise ValueError(
                f"object {row} has a box of {boxes[row, 3:6].round(3).tolist()} m, but its body {body.name!r} measures "
                f"{np.round(body.size, 3).tolist()}: simulate and render with the same bodies"
            )


def windows(model: SensorModel, sensor_corners: Float64[np.ndarray, "n 8 3"]) -> Iterator[tuple[int, tuple[slice, slice]]]:
    """(row, pixels) for every box, given by its corners in the sensor frame, that some ray may meet: a rectangle of pixels
    which holds all of those rays. A box behind a lidar's seam comes twice."""
    if isinstance(model, DepthCamera):
        bounds = _camera_bounds(model, sensor_corners)
    else:
        bounds = _lidar_bounds(model, sensor_corners)
    rows, columns = model.shape
    for row, top, bottom, left, right in bounds:
        top, bottom, left, right = max(top, 0), min(bottom, rows), max(left, 0), min(right, columns)
        if top < bottom and left < right:
            yield row, (slice(top, bottom), slice(left, right))


def _camera_bounds(camera: DepthCamera, sensor_corners: np.ndarray) -> Iterator[tuple[int, int, int, int, int]]:
    """Row, top, bottom, left, right per box: the rectangle round its projected corners; all pixels where it reaches behind."""
    focal, centre = camera.intrinsic[0, 0], camera.intrinsic[:2, 2]
    depth = sensor_corners[..., 2]
    seen = np.flatnonzero((depth.max(axis=1, initial=0) > NEAR) & (depth.min(axis=1, initial=np.inf) < camera.max_range))
    for row in seen:
        if depth[row].min() <= NEAR:
            yield int(row), 0, camera.shape[0], 0, camera.shape[1]
            continue
        pixels = (sensor_corners[row, :, :2] / depth[row, :, None] * focal + centre) / camera.stride
        left, top = np.floor(pixels.min(axis=0)).astype(int)
        right, bottom = np.ceil(pixels.max(axis=0)).astype(int) + 1
        yield int(row), int(top), int(bottom), int(left), int(right)


def _lidar_bounds(lidar: SpinningLidar, sensor_corners: np.ndarray) -> Iterator[tuple[int, int, int, int, int]]:
    """Row, top, bottom, left, right per box: the rectangle round the sphere through its corners."""
    rows, columns = lidar.shape
    middle = sensor_corners.mean(axis=1)
    radius = np.linalg.norm(sensor_corners - middle[:, None], axis=2).max(axis=1, initial=0)
    flat, distance = np.linalg.norm(middle[:, :2], axis=1), np.linalg.norm(middle, axis=1)
    per_row = (lidar.fov_up - lidar.fov_down) / max(rows - 1, 1) or np.inf
    per_column = lidar.azimuth_fov / columns
    for row in np.flatnonzero((distance - radius < lidar.max_range)):
        top, bottom, left, right = 0, rows, 0, columns
        if distance[row] > radius[row]:
            elevation, half = np.arcsin(middle[row, 2] / distance[row]), np.arcsin(radius[row] / distance[row])
            if np.isfinite(per_row):
                top = int(np.floor((lidar.fov_up - elevation - half) / per_row))
                bottom = int(np.ceil((lidar.fov_up - elevation + half) / per_row)) + 1
        if flat[row] <= radius[row]:
            yield int(row), top, bottom, left, right
            continue
        azimuth, half = np.arctan2(middle[row, 1], middle[row, 0]), np.arcsin(radius[row] / flat[row])
        for turn in (-2 * np.pi, 0.0, 2 * np.pi):
            first = (azimuth + turn - half) / per_column + (columns - 1) / 2
            last = (azimuth + turn + half) / per_column + (columns - 1) / 2
            yield int(row), top, bottom, int(np.floor(first)), int(np.ceil(last)) + 1


def _scene(vertices: np.ndarray, triangles: np.ndarray, threads: int) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(threads)
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)), o3d.core.Tensor(np.ascontiguousarray(triangles, np.uint32))
    )
    return scene
