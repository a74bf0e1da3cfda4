"""Registration of a sensor against a reference, point to plane, coarse to fine.

The reference is a `Surface`: of a site, of a survey's cloud, or of what sensors saw before. Each
measured point is paired with the nearest point of the surface, and the pose that brings the points
onto the planes there is solved for with Tukey's weights, again and again with a smaller radius (Y.
Chen and G. Medioni, 1992; J. W. Tukey). A motion is six numbers: turns (rad) about the world's axes
through the sensor, and moves (m) along them,

    pose = [exp(turn) R, t + move].

Whatever the points do not determine stays as it was believed: the eigenvectors of the information
matrix that hardly any point resists (on a bare plane: two moves and a turn) are left out of every
step (J. Zhang, M. Kaess and S. Singh, 2016) and reported. Open3D's own registration solves for
those too, from noise, so the step is implemented here."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float, Float64, ImageMask, Int64, Points, Pose
from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.datasets.cloud_files import read_points
from toolkit.datasets.dataset import CoopDataset
from toolkit.geometry import transform
from toolkit.rendering.static_scene import build_scenery
from toolkit.sensors.error_terms import make_rotation
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Motion = Float64[np.ndarray, "6"]  # turns times `LEVER` and moves, m
_Deviations = Float[np.ndarray, " n"]
_Levels = Sequence[tuple[float, float, float]]

SURFACE_SPACING = 0.15  # m between the sampled points of a surface
OUTSKIRTS = 30.0  # m beyond the detection area; a site's surface reaches that far
LEAST_FLAT = 50  # points that a surface must have
GROWS = ("tree", "bush")  # kinds of solids whose leaves no drawing of a site has
# radius (m) and number of the points that a normal is fitted to
_NEIGHBOURHOOD = 2.0
_NEIGHBOURS = 24
# A neighbourhood is not flat above this ratio of its least to its middle extent, and is a line
# below this ratio of its
# middle to its largest.
_FLAT = 0.35
_LONG = 0.15

NAMES = (
    "turn about x",
    "turn about y",
    "turn about z",
    "move along x",
    "move along y",
    "move along z",
)
LEVER = 10.0  # m: a turn is compared with a move as the move of a point this far off
# Each level: radius (m) of the search for counterparts, voxel (m) that keeps one point, least limit
# (m) of Tukey's
# weights. Walls may be farther off than the ground, which has many more points.
_COARSE = ((3.0, 1.0, 1.5), (1.5, 0.7, 0.75), (0.7, 0.5, 0.35))
_FINE = ((0.35, 0.3, 0.2), (0.2, 0.25, 0.1), (0.15, 0.25, 0.05))
# turns about z that the coarse levels start with
_STARTS = tuple(np.deg2rad([0.0, -2.5, 2.5, -5.0, 5.0]))
_STEPS = 20  # limit for each level
CONVERGED = 1e-4  # fraction of the radius: a smaller step is the last one
_AGREES = 0.3  # m: a point this near agrees with a start
# m between equal results of two starts; agreement lost by one that is as good
_SAME = 0.05
_AS_GOOD = 0.002
TUKEY = 4.685
LEAST_SCALE = 0.01  # m: least scale of the residuals in Tukey's weights
_RESISTS = 0.15  # fraction of a unit motion across the plane: less is the noise of normals
# of the points that must resist a motion for it to be observed
_LEAST_SHARE = 0.0004
_LEAST_POINTS = 2.0
CORRELATED = 9.0  # points that weigh as much as one alone, since errors of neighbours are alike


@dataclass(frozen=True, eq=False)
class Surface:
    """Standing surfaces: points (m) and unit normals (either way)."""

    points: Points
    normals: Points
    roughness: Float64[np.ndarray, " n"]  # standard deviation (m) about the plane of each point

    @cached_property
    def tree(self) -> "cKDTree":
        """SciPy's tree of the points."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def thin(self) -> "Surface":
        """Surface for coarse steps, thinned to 0.4 m."""
        rows = thin_rows(self.points, 0.4)
        return Surface(self.points[rows], self.normals[rows], self.roughness[rows])


def read_surface(reference: str | Path, *, frames: int | None = None) -> Surface:
    """Read the surface of a site by name, or of a file.

    The ending of a file decides: a recording (.hdf5, .h5), a site (.json, .geojson), else a cloud
    in the frame of the site (see `toolkit.datasets.cloud_files`). A recording gives what its
    sensors saw in its first `frames` frames, from their believed poses, noise-free. Raises
    ValueError and OSError as the readers do."""
    ending = Path(reference).suffix.lower()
    if ending in (".hdf5", ".h5"):
        with CoopDataset(reference) as recording:
            scenes = zip(
                learn_empty_scenes(recording, frames=frames), recording.sensors, strict=True
            )
            parts = [transform(sensor.pose, scene_points(scene)[0]) for scene, sensor in scenes]
            return cloud_surface(np.concatenate(parts))
    if ending in ("", ".json", ".geojson"):
        return site_surface(load_site(reference))
    return cloud_surface(read_points(reference))


def site_surface(site: Site, *, seed: int = 0) -> Surface:
    """Spread points evenly over a site's ground and all that stands on it, except what grows
    leaves."""
    mesh = build_scenery(
        replace(site, solids=tuple(solid for solid in site.solids if solid.kind not in GROWS))
    )
    corners = mesh.vertices[mesh.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(across, axis=1)
    low, high = site.area[:2] - OUTSKIRTS, site.area[2:] + OUTSKIRTS
    middle = corners.mean(axis=1)[:, :2]
    in_reach = (size > 0) & ((middle > low) & (middle < high)).all(axis=1)
    corners = corners[in_reach]
    across = across[in_reach]
    size = size[in_reach]
    rng = np.random.default_rng(seed)
    share = size / 2 / SURFACE_SPACING**2
    # on average in proportion to its size
    count = np.floor(share + rng.random(len(share))).astype(np.int64)
    triangles = np.repeat(np.arange(len(count)), count)
    u, v = np.sqrt(rng.random(len(triangles))), rng.random(len(triangles))
    weights = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    points = np.einsum("nk,nkd->nd", weights, corners[triangles])
    return Surface(points, across[triangles] / size[triangles, None], np.zeros(len(points)))


def cloud_surface(points: Points) -> Surface:
    """Return the thinned flat surface of a cloud. Raises ValueError if fewer than `LEAST_FLAT`
    points are left."""
    from toolkit.runtime.light_open3d import o3d

    points = np.asarray(points, np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    _check_flat(len(points))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(
        SURFACE_SPACING
    )
    around = o3d.geometry.KDTreeSearchParamHybrid(_NEIGHBOURHOOD, _NEIGHBOURS)
    cloud.estimate_normals(around)
    cloud.estimate_covariances(around)
    extents = np.linalg.eigvalsh(np.asarray(cloud.covariances).reshape(-1, 3, 3))
    flat = (extents[:, 0] < _FLAT**2 * extents[:, 1]) & (extents[:, 1] > _LONG**2 * extents[:, 2])
    _check_flat(int(flat.sum()))
    return Surface(
        np.asarray(cloud.points)[flat],
        np.asarray(cloud.normals)[flat],
        np.sqrt(extents[flat, 0].clip(0)),
    )


def _check_flat(count: int) -> None:
    if count < LEAST_FLAT:
        needed = f"{LEAST_FLAT} are needed: use a denser cloud"
        raise ValueError(f"the reference has {count} points on flat ground or walls, {needed}")


def scene_points(
    scene: EmptyScene, *, least_share: float = 0.5
) -> tuple[Points, Float64[np.ndarray, " n"]]:
    """Points of an empty scene in the sensor's frame, and their standard deviations (m). Pixels
    that show something else in more than `least_share` of the frames are left out."""
    model = scene.model
    seen: ImageMask = (scene.first > 0) & (scene.share >= least_share)
    rays = model.rays().astype(np.float64)[seen]
    length = np.linalg.norm(rays, axis=1)
    deviation = (
        scene.spread[seen] * length / np.sqrt(np.maximum(scene.share[seen] * scene.frames, 1))
    )
    return rays * scene.first[seen].astype(np.float64)[:, None], deviation.astype(np.float64)


@dataclass(frozen=True, eq=False)
class Registration:
    """A pose that was found."""

    pose: Pose
    # of the six numbers of a motion (rad and m), as far as it is observed
    covariance: Float64[np.ndarray, "6 6"]
    # unit motions, turns times `LEVER`, that the points do not determine
    unobserved: Float64[np.ndarray, "k 6"]
    overlap: float  # share of the points that have a counterpart
    scatter: float  # robust standard deviation of their distances from it (m)

    @property
    def deviations(self) -> Motion:
        """Standard deviations of the six numbers, infinite where unobserved."""
        hidden = (
            (np.abs(self.unobserved) > 0.3).any(axis=0)
            if len(self.unobserved)
            else np.zeros(6, bool)
        )
        return np.where(hidden, np.inf, np.sqrt(np.diag(self.covariance)))


def register(
    points: Points, surface: Surface, believed: Pose, *, deviation: _Deviations | None = None
) -> Registration:
    """Find the pose world_SE3_sensor near the believed one. points: measured, in the sensor's own
    frame; deviation: of each point (m), which lowers its weight. Raises ValueError if fewer than 50
    points have a counterpart within 3 m."""
    points = np.asarray(points, np.float64)
    noise = (
        np.full(len(points), LEAST_SCALE)
        if deviation is None
        else np.maximum(deviation, LEAST_SCALE)
    )
    believed = np.array(believed, np.float64)
    coarse: list[np.ndarray] = []
    for turn in _STARTS:
        start = apply_motion(believed, np.array([0, 0, turn * LEVER, 0, 0, 0]))
        pose, _ = _align_levels(points, noise, surface.thin, start, _COARSE)
        if all(np.abs(motion_between(pose, known_pose)).max() > _SAME for known_pose in coarse):
            coarse.append(pose)
    fine = [_align_levels(points, noise, surface, pose, _FINE) for pose in coarse]
    best = max(system.agreement for _, system in fine)
    as_good = [candidate for candidate in fine if candidate[1].agreement >= best - _AS_GOOD]
    pose, system = min(
        as_good, key=lambda candidate: float(np.linalg.norm(motion_between(believed, candidate[0])))
    )
    if len(system.hidden_motions):  # a coarse level may have gone astray along these
        motion = motion_between(believed, pose)
        motion -= system.hidden_motions.T @ (system.hidden_motions @ motion)
        pose, system = _align_levels(points, noise, surface, apply_motion(believed, motion), _FINE)
    return Registration(
        pose, system.covariance(), system.hidden_motions, system.overlap, system.scatter
    )


def _align_levels(
    points: Points, noise: _Deviations, surface: Surface, pose: Pose, levels: _Levels
) -> "tuple[Pose, _System]":
    """Align the points level by level. Returns the pose and the last system that was solved."""
    for radius, voxel, min_limit in levels:
        rows_thinned = thin_rows(points, voxel)
        for _ in range(_STEPS):
            world = transform(pose, points[rows_thinned])
            distance, neighbours = surface.tree.query(world, distance_upper_bound=radius)
            near = np.flatnonzero(np.isfinite(distance))
            if len(near) < 50:
                problem = (
                    f"{len(near)} of {len(rows_thinned)} points lie within {radius:g} m of the "
                    "reference, 50 are needed"
                )
                remedy = (
                    "is it of the same place and frame, and the sensor no farther off than that?"
                )
                raise ValueError(f"{problem}: {remedy}")
            normals = surface.normals[neighbours[near]]
            residual = ((world[near] - surface.points[neighbours[near]]) * normals).sum(axis=1)
            scatter = max(1.4826 * float(np.median(np.abs(residual))), LEAST_SCALE)
            spread = np.sqrt(
                noise[rows_thinned][near] ** 2
                + surface.roughness[neighbours[near]] ** 2
                + scatter**2
            )
            weight = tukey_weight(residual / np.maximum(TUKEY * spread, min_limit), 1.0) / spread**2
            jacobian = resistance(world[near], pose[:3, 3], normals)
            system = _System(jacobian, residual, weight, len(near) / len(rows_thinned), scatter)
            step = system.step()
            pose = apply_motion(pose, step)
            if np.abs(step).max() < CONVERGED * radius:
                break
    return pose, system


def apply_motion(pose: Pose, motion: Motion) -> Pose:
    """Apply a motion, turns times `LEVER`, to a pose."""
    after = pose.copy()
    after[:3, :3] = make_rotation(motion[:3] / LEVER) @ pose[:3, :3]
    after[:3, 3] += motion[3:]
    return after


def motion_between(before: Pose, after: Pose) -> Motion:
    """Motion for `apply_motion` from one pose to another."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
    return np.concatenate([LEVER * turn, after[:3, 3] - before[:3, 3]])


def resistance(
    points: Points, position: Float64[np.ndarray, "3"], normals: Points
) -> Float64[np.ndarray, "n 6"]:
    """Distance that each point leaves its plane per unit of a motion about a position, turns times
    `LEVER`."""
    return np.concatenate([np.cross(points - position, normals) / LEVER, normals], axis=1)


def thin_rows(points: Points, voxel: float) -> Int64[np.ndarray, " k"]:
    """Rows of the first point in each cube of edge `voxel` (m), so that near ground does not
    dominate."""
    cube = np.floor(points / voxel).astype(np.int64)
    cube -= cube.min(axis=0, initial=0)
    key = np.ravel_multi_index(cube.T, cube.max(axis=0, initial=0) + 1)
    return np.sort(np.unique(key, return_index=True)[1])


def tukey_weight(residual: Float64[np.ndarray, " n"], limit: float) -> Float64[np.ndarray, " n"]:
    """Tukey's weight of each residual, zero from the limit on."""
    return np.clip(1 - (residual / limit) ** 2, 0, None) ** 2


@dataclass(frozen=True, eq=False)
class _System:
    """Linear system of one step."""

    rows: Float64[np.ndarray, "n 6"]  # resistance of each pair
    residual: Float64[np.ndarray, " n"]  # along the normal
    weight: Float64[np.ndarray, " n"]
    overlap: float
    scatter: float

    @property
    def agreement(self) -> float:
        """Share of all points that lie on the surface, near ones more than those 0.3 m off."""
        return float(tukey_weight(self.residual, _AGREES).mean()) * self.overlap

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eigenvalues and eigenvectors (columns), and mask of observed ones."""
        values, vectors = np.linalg.eigh(self.rows.T @ (self.rows * self.weight[:, None]))
        along = (self.rows @ vectors) ** 2
        sound = self.weight > 0
        resists = np.where(along > _RESISTS**2, along, 0.0)[sound].sum(axis=0)
        return values, vectors, resists > max(_LEAST_SHARE * sound.sum(), _LEAST_POINTS)

    @property
    def hidden_motions(self) -> Float64[np.ndarray, "k 6"]:
        """Unit motions (k, 6) that hardly any pair resists."""
        _, vectors, observed = self._modes
        return vectors[:, ~observed].T

    def step(self) -> Motion:
        """Motion, if determined, that brings points onto planes."""
        values, vectors, observed = self._modes
        gradient = vectors.T @ (self.rows.T @ (self.weight * self.residual))
        return vectors @ np.where(observed, -gradient / np.where(observed, values, 1.0), 0.0)

    def covariance(self) -> Float64[np.ndarray, "6 6"]:
        """Covariance of the observed motions, in rad and m."""
        values, vectors, observed = self._modes
        inverse = np.where(observed, CORRELATED / np.where(observed, values, 1.0), 0.0)
        unit = np.repeat([1 / LEVER, 1.0], 3)
        return unit[:, None] * ((vectors * inverse) @ vectors.T) * unit
