"""Ray casting: what every sensor measures of a moment, noise-free, and which object each ray meets.

What stands still is cast once per sensor and kept. What moves is cast body by body: every body has
a ray casting scene of its own, in its own frame, built once, and only the rays that can meet an
object's box are turned into that frame. The nearest hit counts. A `Moment` holds everything that
moves in one frame in one scene, which is faster for many lines from many places."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import BoxRows, Float32, Float64, Int32, Int64, Mask, Pose
from toolkit.bodies.body import Body
from toolkit.boxes import corners
from toolkit.geometry import LEVEL, Slope, invert, level_motion, pose, transform
from toolkit.mesh import Mesh
from toolkit.rendering.static_scene import build_scenery as build_scenery
from toolkit.runtime.light_open3d import o3d
from toolkit.sensors.sensor import NEAR, Sensor, SensorModel
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

RaycastingScene = o3d.t.geometry.RaycastingScene
_Bodies = Sequence[Body]
# an object to cast: its body's ray casting scene in the body's frame, and body_SE3_world (4, 4),
# sheared if the ground slopes
Mover = tuple[RaycastingScene, np.ndarray]
_Image = Float32[np.ndarray, "_ _"]
Hits = Int32[np.ndarray, "_ _"]
GRAZE = 1e-3  # m; hits this close to the end of a line are of the surface that the end is on
MAX_MISFIT_M = 0.02  # largest difference between the sides of a box and of its body


class Footprints(NamedTuple):
    """Ground that the n objects of a moment cover, and how high they reach (m, world frame)."""

    # x, y corners of the convex footprints, object after object
    points: Float64[np.ndarray, "k 2"]
    # (n + 1,) rows in `points`: object i has the corners first[i] to first[i + 1] - 1
    first: Int64[np.ndarray, " _"]
    low: Float64[np.ndarray, " n"]  # z of each object's lowest point
    high: Float64[np.ndarray, " n"]  # z of its highest point
    # rectangle around each footprint along its heading: x and y of the middle, half length, half
    # width, cos and sin of yaw
    rectangles: Float64[np.ndarray, "n 6"]


class Moment:
    """Moving objects of one frame in one ray casting scene, world frame.

    Args:
        bodies: mesh of each object, in the frame of its box.
        boxes: box of each object (x, y, z, length, width, height in m, yaw in rad).
        threads: threads of Open3D, 0 for all cores.
        slope: slope of the ground; meshes are sheared with it, so that they stay upright."""

    def __init__(
        self, bodies: Sequence[Body], boxes: BoxRows, threads: int = 0, *, slope: Slope = LEVEL
    ) -> None:
        """Move the meshes to their boxes, and build the scene from them.

        bodies: mesh of each object, in the frame of its box; boxes: x y z length width height yaw
        (n, 7); threads: number of threads, 0 for all cores; slope: rise of the ground (m) per metre
        along x and y, by which the meshes are sheared."""
        self.bodies = tuple(bodies)
        self.boxes = boxes
        self._threads = threads
        self._slope = np.array(slope)
        self._turns = _yaw_matrices(boxes[:, 6])  # turn row vectors by each object's yaw
        self.ground = self._find_footprints()  # where the bodies stand
        vertices = []
        for body, turn, box in zip(bodies, self._turns, boxes, strict=True):
            # from the body's frame: turned by yaw, sheared with the ground, moved to the box
            body_vertices = body.vertices.astype(np.float64)
            body_vertices[:, :2] = body_vertices[:, :2] @ turn
            body_vertices[:, 2] += body_vertices[:, :2] @ self._slope
            vertices.append(body_vertices + box[:3])
        # triangles are rows of their body's vertices: the row of its first vertex is added
        first = np.cumsum([0, *map(len, vertices)])[:-1]  # without the number of all vertices
        triangles = [body.triangles + start for body, start in zip(bodies, first, strict=True)]
        triangle_counts = [len(body_triangles) for body_triangles in triangles]
        objects = np.arange(-1, len(bodies), dtype=np.int32)  # -1 for no object
        # row of the object of each triangle, by the triangle's number plus 1; entry 0 is for no
        # triangle
        self._triangle_object = np.repeat(objects, [1, *triangle_counts])
        self._scene = None
        if sum(triangle_counts):
            self._scene = build_scene(np.concatenate(vertices), np.concatenate(triangles), threads)

    def __len__(self) -> int:
        return len(self.boxes)

    def met(
        self, lines: Float32[np.ndarray, "n 6"]
    ) -> tuple[Int32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Find the first object that each line meets, and how far away.

        lines: start and direction (x, y, z each; world frame). The first result is the object's
        row, -1 for none; the second is the distance as a multiple of the line's direction (m for
        unit directions), infinite for none."""
        if self._scene is None or not len(lines):
            return np.full(len(lines), -1, np.int32), np.full(len(lines), np.inf, np.float32)
        cast = self._scene.cast_rays(o3d.core.Tensor.from_numpy(lines), self._threads)
        # Open3D reports no triangle as the largest uint32; plus 1 it wraps round to 0, and entry 0
        # of `_triangle_object` is -1
        next_triangle = cast["primitive_ids"].numpy() + np.uint32(1)
        return self._triangle_object.take(next_triangle), cast["t_hit"].numpy()

    def _find_footprints(self) -> Footprints:
        """Return the footprints and heights of the objects, of their bodies' whole meshes.

        An outline (k, 2) is in the frame of its body; `points` are in the world frame."""
        centres = self.boxes[:, :2]
        outlines = [_body_outline(body) for body in self.bodies]
        points = [
            outline @ turn + centre
            for outline, turn, centre in zip(outlines, self._turns, centres, strict=True)
        ]
        # lowest and highest z of each body's vertices, above the middle of its box
        z_bounds = [_z_bounds(body) for body in self.bodies]
        reach = np.array(z_bounds, np.float64).reshape(-1, 2)
        # a sheared body reaches lower and higher by the ground's fall and rise below its footprint
        if self._slope.any():
            rises = [
                (outline - centre) @ self._slope
                for outline, centre in zip(points, centres, strict=True)
            ]
            reach += np.array([(rise.min(), rise.max()) for rise in rises]).reshape(-1, 2)
        low, high = (reach + self.boxes[:, 2:3]).T
        # lowest and highest x and y of each outline in its body's frame: (n, 2 ends, 2 axes)
        ends = [(outline.min(axis=0), outline.max(axis=0)) for outline in outlines]
        ends_by_body = np.array(ends).reshape(-1, 2, 2)
        middle = np.einsum("ni,nij->nj", ends_by_body.mean(axis=1), self._turns) + centres
        half_sizes = np.ptp(ends_by_body, axis=1) / 2
        cos_sin = self._turns[:, 0]  # first row of each matrix: cos and sin of yaw
        return Footprints(
            points=np.concatenate([np.zeros((0, 2)), *points]),
            first=np.cumsum([0, *map(len, points)]),
            low=low,
            high=high,
            # x, y, half length, half width, cos and sin of yaw
            rectangles=np.column_stack([middle, half_sizes, cos_sin]),
        )


def _yaw_matrices(yaw: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2 2"]:
    """Matrices that turn row vectors (x, y) by each yaw (rad), multiplied from the right."""
    rows = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], axis=1)
    return rows.reshape(-1, 2, 2)


def _z_bounds(body: Body) -> tuple[float, float]:
    """Lowest and highest z (m) of a body's vertices, body frame."""
    z = body.vertices[:, 2]
    return z.min(), z.max()


def build_scene(vertices: np.ndarray, triangles: np.ndarray, threads: int) -> RaycastingScene:
    """Build Open3D's ray casting scene of one mesh.

    Args:
        vertices: (v, 3) m; hits are found in the same frame.
        triangles: (t, 3) rows of `vertices`.
        threads: threads of Open3D, 0 for all cores."""
    scene = RaycastingScene(threads)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, np.float32)),
        o3d.core.Tensor.from_numpy(np.ascontiguousarray(triangles, np.uint32)),
    )
    return scene


@lru_cache(maxsize=4096)
def _body_outline(body: Body) -> Float64[np.ndarray, "k 2"]:
    """Corners x, y (m, body frame) of the convex hull of a body seen from above.

    The first one is not repeated."""
    hull = shapely.convex_hull(shapely.MultiPoint(body.vertices[:, :2].astype(np.float64)))
    return np.array(hull.exterior.coords[:-1])


class SightLines:
    """Lines of sight from one place to many others, which a static mesh may block.

    scenery: the mesh, world frame; threads: threads of Open3D, 0 for all cores."""

    def __init__(self, scenery: Mesh, threads: int = 0) -> None:
        self._threads = threads
        self._scene = build_scene(*scenery, threads)

    def clear(self, start: Float64[np.ndarray, "3"], ends: Float64[np.ndarray, "n 3"]) -> Mask:
        """Mask of the ends (world frame, m) that are in sight of the start.

        An end nearer than `NEAR` is never in sight. Surfaces nearer than `NEAR` to the start,
        or within `GRAZE` of the end, block nothing."""
        offset = ends - start
        length = np.linalg.norm(offset, axis=1)
        is_far = length > NEAR
        direction = offset / np.where(is_far, length, 1)[:, None]
        # lines begin `NEAR` in front of the start
        lines = np.concatenate([start + NEAR * direction, direction], axis=1).astype(np.float32)
        cast = self._scene.cast_rays(o3d.core.Tensor.from_numpy(lines), self._threads)
        free_length = cast["t_hit"].numpy()  # up to the first surface
        return is_far & (free_length > length - NEAR - GRAZE)


@lru_cache(maxsize=400)  # in a drawn fleet each object has another body, so memory needs a limit
def body_scene(body: Body, threads: int) -> RaycastingScene:
    """Ray casting scene of one body in its frame, kept for the next frames.

    threads: number of threads that cast its rays."""
    return build_scene(body.vertices, body.triangles, threads)


class Rendered(NamedTuple):
    """Noise-free images of one moment, one per sensor in the renderer's order.

    measurements: (rows, columns) m, 0 for no return. hits: (rows, columns) row of the object in
    the snapshot that the ray meets, -1 for the static scene or nothing."""

    measurements: tuple[_Image, ...]
    hits: tuple[Hits, ...]


class Renderer:
    """Cast the rays of sensors at a site.

    `background` holds each sensor's image of the empty site (m, 0 for no return). No rays are
    kept, so thousands of sensors fit. Pickles as its arguments: unpickling casts again.

    Args:
        bodies: meshes of moving objects; `Snapshot.bodies` holds rows of this sequence.
        scenery: mesh of the static scene (world frame); None to build it from the site.
        threads: threads of Open3D, 0 for all cores."""

    def __init__(
        self,
        site: Site,
        bodies: _Bodies,
        sensors: Sequence[Sensor],
        scenery: Mesh | None = None,
        threads: int = 0,
    ) -> None:
        """Build the scene of the site, and cast the sensors' images of it.

        scenery: mesh of the static scene, built from the site if None; threads: number of threads
        that cast rays, 0 for all cores."""
        self.sensors = tuple(sensors)
        self.bodies = tuple(bodies)
        self._site = site
        self._scenery = build_scenery(site) if scenery is None else scenery
        self._threads = threads
        self._slope = site.relief.slope
        self._measure_bodies()
        self._still = build_scene(*self._scenery, threads)
        self.background = tuple(self._cast_image(self._still, sensor) for sensor in self.sensors)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return Renderer, (self._site, self.bodies, self.sensors, self._scenery, self._threads)

    def looking(self, sensors: Sequence[Sensor]) -> "Renderer":
        """Renderer of other sensors; shares the static scene and casts their backgrounds."""
        renderer = self._with(sensors=tuple(sensors))
        renderer.background = tuple(
            self._cast_image(self._still, sensor) for sensor in renderer.sensors
        )
        return renderer

    def with_bodies(self, bodies: Sequence[Body]) -> "Renderer":
        """Renderer of other bodies; shares the static scene, sensors and backgrounds."""
        renderer = self._with(bodies=tuple(bodies))
        renderer._measure_bodies()
        return renderer

    def _with(self, **changes: object) -> "Renderer":
        """Copy of the renderer with some attributes replaced, without building scenes again."""
        renderer = object.__new__(Renderer)
        renderer.__dict__.update(self.__dict__, **changes)
        return renderer

    def render(self, snapshot: Snapshot) -> Rendered:
        """Render measurements and hits of all sensors for one snapshot.

        Raises ValueError if the size of a box differs from the size of its body."""
        boxes = snapshot.objects.boxes
        self._check_sizes(boxes, snapshot.bodies)
        world_corners = self.outer_corners(snapshot.bodies, boxes)
        # snapshot.bodies: row in `bodies` of each object's body
        scenes = [body_scene(self.bodies[row], self._threads) for row in snapshot.bodies.tolist()]
        movers = list(zip(scenes, map(self.body_from_world, boxes), strict=True))
        measurements = []
        hits = []
        for sensor_index in range(len(self.sensors)):
            image, image_hits = self._render_sensor(sensor_index, movers, world_corners)
            measurements.append(image)
            hits.append(image_hits)
        return Rendered(tuple(measurements), tuple(hits))

    def outer_corners(
        self, body_rows: Int64[np.ndarray, " n"], boxes: BoxRows
    ) -> Float64[np.ndarray, "n 8 3"]:
        """Corners (m, world frame) of boxes that hold the whole mesh of each object.

        A labelled box may leave out mirrors or a load; these boxes do not. Corners are sheared
        with the slope of the ground.

        Args:
            body_rows: row of each object's body in `bodies`.
            boxes: labelled box of each object."""
        outer_boxes = boxes.copy()
        # objects whose mesh is larger than the labelled box; the others keep that box
        rows = np.flatnonzero(self._exceeds_box[body_rows])
        # middle and size of the mesh's box, in the frame of the labelled box
        mesh_bounds = self._bounds[body_rows[rows]]
        x, y, z = mesh_bounds[:, :3].T
        yaw = boxes[rows, 6]
        outer_boxes[rows, 0] += np.cos(yaw) * x - np.sin(yaw) * y
        outer_boxes[rows, 1] += np.sin(yaw) * x + np.cos(yaw) * y
        outer_boxes[rows, 2] += z
        outer_boxes[rows, 3:6] = mesh_bounds[:, 3:]
        outer_corners = corners(outer_boxes)
        if self._slope != LEVEL:
            from_centre = outer_corners[..., :2] - boxes[:, None, :2]
            outer_corners[..., 2] += from_centre @ np.array(self._slope)
        return outer_corners

    def body_from_world(self, box: Float64[np.ndarray, "7"]) -> Pose:
        """Matrix that takes world points into the frame of the body in a box.

        On sloping ground it also removes the shear of the body, so it is no rigid motion."""
        x, y, z, *_, yaw = box.tolist()
        box_SE3_world = invert(pose(x, y, z, yaw=yaw))
        if self._slope == LEVEL:
            return box_SE3_world
        return box_SE3_world @ level_motion(self._slope, (x, y))

    def cast_body(self, body: int, lines: Float32[np.ndarray, "n 6"]) -> Float32[np.ndarray, " n"]:
        """Distance along each line to a body, as a multiple of the line's direction.

        body: its row in `bodies`; lines: start and direction (x, y, z each; body frame). Infinite
        for a line that misses."""
        return self._hit_distances(body_scene(self.bodies[body], self._threads), lines)

    def cast_still(self, lines: Float32[np.ndarray, "n 6"]) -> Float32[np.ndarray, " n"]:
        """Distance along each line to the static scene, as a multiple of the line's direction.

        lines: start and direction (x, y, z each; world frame). Infinite for a line that misses."""
        return self._hit_distances(self._still, lines)

    def still_hides(self, ways: Float32[np.ndarray, "n 6"]) -> Mask:
        """Mask of the ways that the static scene blocks.

        ways: start, and vector from start to end (x, y, z each; m, world frame)."""
        # only between the start (0) and the end (1) of each way
        is_hidden = self._still.test_occlusions(
            o3d.core.Tensor.from_numpy(ways), 0.0, 1.0, self._threads
        )
        return is_hidden.numpy()

    def moment(self, snapshot: Snapshot) -> Moment:
        """Scene of everything that moves in a snapshot.

        Raises ValueError if the size of a box differs from the size of its body."""
        self._check_sizes(snapshot.objects.boxes, snapshot.bodies)
        bodies = [self.bodies[body] for body in snapshot.bodies.tolist()]
        return Moment(bodies, snapshot.objects.boxes, self._threads, slope=self._slope)

    def _render_sensor(
        self, index: int, movers: list[Mover], world_corners: np.ndarray
    ) -> tuple[_Image, Hits]:
        """Return the image (m, 0 for no return) of a sensor, and the object that each ray meets.

        index: row of the sensor; movers: scene of each object's body, and matrix from world to
        body; world_corners: (n, 8, 3) m, corners of boxes that hold the objects. Each object is
        cast over the background, but only in the window of pixels around its box."""
        sensor = self.sensors[index]
        background = self.background[index]
        image = background.copy()
        hits = np.full(background.shape, -1, np.int32)
        rays = _homogeneous_rays(sensor.model)
        max_range = np.float32(sensor.model.max_range)
        sensor_corners = transform(invert(sensor.pose), world_corners)
        # a window is the object's row, then the first and the end of its image rows and columns
        for row, top, bottom, left, right in sensor.model.windows(sensor_corners).tolist():
            scene, body_from_world = movers[row]
            pixels = slice(top, bottom), slice(left, right)
            # infinite for rays that miss the body, so these are never nearer
            body_image = self._cast(scene, rays[pixels], body_from_world @ sensor.pose)
            is_nearer = body_image < np.where(image[pixels] > 0, image[pixels], max_range)
            np.copyto(image[pixels], body_image, where=is_nearer)
            np.copyto(hits[pixels], np.int32(row), where=is_nearer)
        return image, hits

    def _cast_image(self, scene: RaycastingScene, sensor: Sensor) -> np.ndarray:
        """Image of a whole scene (world frame), 0 for no return."""
        image = self._cast(scene, _homogeneous_rays(sensor.model), sensor.pose)
        return np.where(image < sensor.model.max_range, image, np.float32(0))

    def _cast(
        self, scene: RaycastingScene, rays: np.ndarray, scene_SE3_sensor: np.ndarray
    ) -> _Image:
        """Measurement (m) along each ray, infinite if it meets nothing beyond `NEAR`.

        rays: (rows, columns, 4) ray in the sensor's frame, then a 1; scene_SE3_sensor: (4, 4), may
        hold a shear."""
        # maps (ray, 1) to the start of its line, `NEAR` along the ray, and its direction
        start_and_direction = np.zeros((4, 6), np.float32)
        start_and_direction[:3, 3:] = scene_SE3_sensor[:3, :3].T
        start_and_direction[:3, :3] = NEAR * scene_SE3_sensor[:3, :3].T
        start_and_direction[3, :3] = scene_SE3_sensor[:3, 3]
        lines = (rays.reshape(-1, 4) @ start_and_direction).reshape(*rays.shape[:-1], 6)
        return self._hit_distances(scene, lines) + np.float32(NEAR)

    def _hit_distances(
        self, scene: RaycastingScene, lines: Float32[np.ndarray, "*n 6"]
    ) -> Float32[np.ndarray, "*n"]:
        """Distance along each line (start, direction) as a multiple of the direction, else
        infinite."""
        cast = scene.cast_rays(o3d.core.Tensor.from_numpy(lines), self._threads)
        return cast["t_hit"].numpy()

    def _measure_bodies(self) -> None:
        """Measure the bodies, a row for each of `bodies`.

        A row has the size of the labelled box, the middle and size of the whole mesh's box, and
        True if the mesh is larger than the labelled box."""
        self._sizes = np.array([body.size for body in self.bodies]).reshape(-1, 3)
        self._bounds = np.array([body.bounds for body in self.bodies]).reshape(-1, 6)
        self._exceeds_box = np.array([body.truth is not None for body in self.bodies], bool)

    def _check_sizes(self, boxes: np.ndarray, body_rows: np.ndarray) -> None:
        """Raise ValueError if the length, width or height of a box is 2 cm off its body's.

        boxes: labelled box of each object; body_rows: row of each object's body in `bodies`."""
        box_sizes = boxes[:, 3:6]
        deviation = np.abs(box_sizes - self._sizes[body_rows]).max(axis=1, initial=0)
        misfit_rows = np.flatnonzero(deviation > MAX_MISFIT_M)
        if len(misfit_rows):
            row = int(misfit_rows[0])
            body = self.bodies[body_rows[row]]
            box_size = box_sizes[row].round(3).tolist()
            body_size = np.round(body.size, 3).tolist()
            problem = (
                f"object {row} has a box of {box_size} m, but its body {body.name!r} measures "
                f"{body_size}"
            )
            raise ValueError(f"{problem}: simulate and render with the same bodies")


@lru_cache(maxsize=64)
def _homogeneous_rays(model: SensorModel) -> Float32[np.ndarray, "rows columns 4"]:
    """Rays (x, y, z in the sensor's frame) with a 1 after each, for one product with a matrix."""
    rays = model.rays()
    return np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1)
