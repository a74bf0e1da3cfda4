"""What a sensor is registered against: the surface of the site, of a survey's cloud, or of what sensors saw before.

A file says by its ending what it is: a recording (.hdf5, .h5), a cloud in the frame of the site (see
`toolkit.datasets.cloud_files`), or a site (.json, .geojson, or the name of a built-in one).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from toolkit.arrays import Bool, Float, Float64
from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.calibration.registration import Surface
from toolkit.datasets.cloud_files import read_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.geometry import transform
from toolkit.rendering.static_scene import scenery
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

SURFACE_SPACING = 0.15  # m between the points a surface is sampled with
OUTSKIRTS = 30.0  # m beyond the detection area, as far as a site's surface is sampled
LEAST_FLAT = 50  # points of a surface
GROWS = ("tree", "bush")  # kinds of solids that no drawing of a site holds leaf by leaf
_NEIGHBOURHOOD, _NEIGHBOURS = 2.0, 24  # m and points at most, that a normal is fitted to
_FLAT, _LONG = 0.35, 0.15  # least extent by the middle one of what is not flat; middle by largest of what is a line


def read_surface(reference: str | Path, *, frames: int | None = None) -> Surface:
    """The surface behind the name of a site or a file. Of a recording: what its sensors saw in its first `frames`
    frames, from where they were believed to be, noise-free. Raises ValueError and OSError as the readers do."""
    ending = Path(reference).suffix.lower()
    if ending in (".hdf5", ".h5"):
        with CoopDataset(reference) as recording:
            scenes = learn_empty_scenes(recording, frames=frames, noise_seed=None)
            return scenes_surface(scenes, [sensor.pose for sensor in recording.sensors])
    if ending in ("", ".json", ".geojson"):
        return site_surface(load_site(reference))
    return cloud_surface(read_points(reference))


def site_surface(site: Site, *, seed: int = 0) -> Surface:
    """The ground and all that stands on it, without what grows leaves, sampled evenly."""
    mesh = scenery(replace(site, solids=tuple(solid for solid in site.solids if solid.kind not in GROWS)))
    corners = mesh.vertices[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(across, axis=1)
    low, high = site.area[:2] - OUTSKIRTS, site.area[2:] + OUTSKIRTS
    middle = corners.mean(axis=1)[:, :2]
    wanted = (size > 0) & ((middle > low) & (middle < high)).all(axis=1)
    corners, across, size = corners[wanted], across[wanted], size[wanted]
    rng = np.random.default_rng(seed)
    share = size / 2 / SURFACE_SPACING**2
    count = np.floor(share + rng.random(len(share))).astype(np.int64)  # on average as many as its size asks
    chosen = np.repeat(np.arange(len(count)), count)
    u, v = np.sqrt(rng.random(len(chosen))), rng.random(len(chosen))
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    points = np.einsum("nk,nkd->nd", weights, corners[chosen])
    return Surface(points, across[chosen] / size[chosen, None], np.zeros(len(points)))


def cloud_surface(points: Float[np.ndarray, "n 3"]) -> Surface:
    """The surface of a cloud, thinned, with the normals of the planes through neighbours; points about which the cloud
    is not flat are left out. Raises ValueError where nothing is left."""
    import open3d as o3d

    points = np.asarray(points, np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < LEAST_FLAT:
        raise ValueError(f"the reference has {len(points)} points on flat ground or walls, {LEAST_FLAT} are needed")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(SURFACE_SPACING)
    around = o3d.geometry.KDTreeSearchParamHybrid(_NEIGHBOURHOOD, _NEIGHBOURS)
    cloud.estimate_normals(around)
    cloud.estimate_covariances(around)
    extents = np.linalg.eigvalsh(np.asarray(cloud.covariances).reshape(-1, 3, 3))
    flat = (extents[:, 0] < _FLAT**2 * extents[:, 1]) & (extents[:, 1] > _LONG**2 * extents[:, 2])
    if flat.sum() < LEAST_FLAT:
        raise ValueError(f"the reference has {int(flat.sum())} points on flat ground or walls, {LEAST_FLAT} are needed")
    return Surface(np.asarray(cloud.points)[flat], np.asarray(cloud.normals)[flat], np.sqrt(extents[flat, 0].clip(0)))


def scene_points(
    scene: EmptyScene, *, least_share: float = 0.5
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, " n"]]:
    """What a sensor measures of its empty scene, in its own frame, and the standard deviation of each point (m).

    Pixels that show something else in more than `least_share` of the frames are left out.
    """
    model = scene.model
    seen: Bool[np.ndarray, "rows columns"] = (scene.first > 0) & (scene.share >= least_share)
    rays = model.rays().astype(np.float64)[seen]
    length = np.linalg.norm(rays, axis=1)
    deviation = scene.spread[seen] * length / np.sqrt(np.maximum(scene.share[seen] * scene.frames, 1))
    return rays * scene.first[seen].astype(np.float64)[:, None], deviation.astype(np.float64)


def scenes_surface(scenes: Sequence[EmptyScene], poses: Sequence[Float64[np.ndarray, "4 4"]]) -> Surface:
    """The surface that sensors at these poses see of their empty scenes together."""
    parts = [transform(pose, scene_points(scene)[0]) for scene, pose in zip(scenes, poses, strict=True)]
    return cloud_surface(np.concatenate([np.zeros((0, 3)), *parts]))
