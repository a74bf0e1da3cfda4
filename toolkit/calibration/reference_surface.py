"""Surfaces to register sensors against, from a site, a cloud or empty scenes."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float64, ImageMask, Int64, Points
from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.datasets.cloud_files import read_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.geometry import transform
from toolkit.rendering.static_scene import build_scenery
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

SURFACE_SPACING_M = 0.15  # m between the sampled points of a surface
OUTSKIRTS_M = 30.0  # m beyond the detection area; a site's surface reaches that far
MIN_FLAT_POINTS = 50  # points that a surface must have
LEAFY_KINDS = ("tree", "bush")  # kinds of solids left out, since a site has no leaves
# largest distance (m) and number of the points that a normal is fitted to
_NEIGHBOUR_M = 2.0
_NEIGHBOURS = 24
# Extents are standard deviations of the points around one point, along three axes.
_MAX_FLAT_RATIO = 0.35  # largest ratio of the smallest to the middle extent, for a flat surface
_MIN_PLANE_RATIO = 0.15  # least ratio of the middle to the largest extent; below it is a line


@dataclass(frozen=True, eq=False)
class Surface:
    """Standing surfaces as points.

    Attributes:
        points: points on the surfaces (m).
        normals: unit normal at each point, to either side.
        roughness: standard deviation (m) of the surface from the plane at each point."""

    points: Points
    normals: Points
    roughness: Float64[np.ndarray, " n"]

    @cached_property
    def tree(self) -> "cKDTree":
        """Search tree of the points."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def thinned_surface(self) -> "Surface":
        """Surface for coarse steps, thinned to one point in each cube of 0.4 m."""
        rows = thin_rows(self.points, 0.4)
        return Surface(self.points[rows], self.normals[rows], self.roughness[rows])


def read_surface(reference: str | Path, *, frames: int | None = None) -> Surface:
    """Read the surface of a site by name, or of a file.

    reference: name of a site, or path; frames: number of first frames of a recording, all if None.
    The ending of a file decides: a recording (.hdf5, .h5), a site (.json, .geojson), else a cloud
    in the frame of the site (see `toolkit.datasets.cloud_files`). A recording gives what its
    sensors saw in its first `frames` frames, from their believed poses, noise-free. Raises
    ValueError and OSError as the readers do."""
    ending = Path(reference).suffix.lower()
    if ending in (".hdf5", ".h5"):
        with CoopDataset(reference) as recording:
            scenes = learn_empty_scenes(recording, frames=frames)
            clouds = []
            for scene, sensor in zip(scenes, recording.sensors, strict=True):
                points, _ = scene_points(scene)
                clouds.append(transform(sensor.pose, points))
            return cloud_surface(np.concatenate(clouds))
    if ending in ("", ".json", ".geojson"):
        return site_surface(load_site(reference))
    return cloud_surface(read_points(reference))


def site_surface(site: Site, *, seed: int = 0) -> Surface:
    """Spread points evenly over a site's ground and its solids, without trees and bushes.

    Normals are exact and roughness is 0. seed: seed of the random points."""
    solids = tuple(solid for solid in site.solids if solid.kind not in LEAFY_KINDS)
    mesh = build_scenery(replace(site, solids=solids))
    corners = mesh.vertices[mesh.triangles]  # (triangles, 3 corners, xyz)
    # normal of each triangle, twice its area long
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normals, axis=1)
    # corners x, y (m) of the area and its surroundings
    low = site.area[:2] - OUTSKIRTS_M
    high = site.area[2:] + OUTSKIRTS_M
    middle = corners.mean(axis=1)[:, :2]
    in_reach = (double_area > 0) & ((middle > low) & (middle < high)).all(axis=1)
    corners = corners[in_reach]
    unit_normals = normals[in_reach] / double_area[in_reach, None]
    rng = np.random.default_rng(seed)
    mean_count = double_area[in_reach] / 2 / SURFACE_SPACING_M**2
    # points of each triangle, rounded at random so that their mean is in proportion to its area
    count = np.floor(mean_count + rng.random(len(mean_count))).astype(np.int64)
    triangles = np.repeat(np.arange(len(count)), count)
    # square root, so that points are even over a triangle; do not change the order of the draws
    u = np.sqrt(rng.random(len(triangles)))
    v = rng.random(len(triangles))
    corner_weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    points = np.einsum("nk,nkd->nd", corner_weights, corners[triangles])
    return Surface(points, normals=unit_normals[triangles], roughness=np.zeros(len(points)))


def cloud_surface(points: Points) -> Surface:
    """Return the flat parts of a cloud, thinned to `SURFACE_SPACING_M`, as a surface.

    Parts that are rough or on a line, such as leaves and wires, are left out. Raises ValueError if
    fewer than `MIN_FLAT_POINTS` points are left."""
    from toolkit.runtime.light_open3d import o3d

    points = np.asarray(points, np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    check_flat(len(points))
    dense_cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud = dense_cloud.voxel_down_sample(SURFACE_SPACING_M)
    neighbour_search = o3d.geometry.KDTreeSearchParamHybrid(_NEIGHBOUR_M, _NEIGHBOURS)
    cloud.estimate_normals(neighbour_search)
    cloud.estimate_covariances(neighbour_search)
    # (points, 3), ascending squares of the extents, so the ratios are squared too
    squares = np.linalg.eigvalsh(np.asarray(cloud.covariances).reshape(-1, 3, 3))
    least, middle, greatest = squares.T
    is_flat = (least < _MAX_FLAT_RATIO**2 * middle) & (middle > _MIN_PLANE_RATIO**2 * greatest)
    check_flat(int(is_flat.sum()))
    return Surface(
        points=np.asarray(cloud.points)[is_flat],
        normals=np.asarray(cloud.normals)[is_flat],
        roughness=np.sqrt(least[is_flat].clip(0)),
    )


def check_flat(count: int) -> None:
    """Raise ValueError if a reference has fewer than `MIN_FLAT_POINTS` points (`count`)."""
    if count < MIN_FLAT_POINTS:
        needed_text = f"{MIN_FLAT_POINTS} are needed: use a denser cloud"
        raise ValueError(f"the reference has {count} points on flat ground or walls, {needed_text}")


def scene_points(
    scene: EmptyScene, *, least_share: float = 0.5
) -> tuple[Points, Float64[np.ndarray, " n"]]:
    """Points (m) of an empty scene in the sensor's frame, and the standard deviation of each (m).

    The deviation is for the mean of the frames that show the scene. Pixels that show its `first`
    surface in less than `least_share` (0 to 1) of the frames are left out."""
    model = scene.model
    is_shown: ImageMask = (scene.first > 0) & (scene.share >= least_share)
    # a point is at its measurement times its ray, which is longer than 1 in images of depth
    rays = model.rays().astype(np.float64)[is_shown]
    ray_length = np.linalg.norm(rays, axis=1)
    frame_count = np.maximum(scene.share[is_shown] * scene.frames, 1)
    deviation = scene.spread[is_shown] * ray_length / np.sqrt(frame_count)
    points = rays * scene.first[is_shown].astype(np.float64)[:, None]
    return points, deviation.astype(np.float64)


def thin_rows(points: Points, voxel: float) -> Int64[np.ndarray, " k"]:
    """Rows, ascending, of the first point in each cube of edge `voxel` (m).

    points: (n, 3) m. So dense ground near a sensor is thinned."""
    cube = np.floor(points / voxel).astype(np.int64)
    cube -= cube.min(axis=0, initial=0)
    cube_number = np.ravel_multi_index(cube.T, cube.max(axis=0, initial=0) + 1)
    _, first_rows = np.unique(cube_number, return_index=True)
    return np.sort(first_rows)
