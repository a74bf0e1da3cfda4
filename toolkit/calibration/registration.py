"""Registration of a sensor against a reference, point to plane, coarse to fine.

Each measured point is paired with the nearest point of the reference
(`toolkit.calibration.reference_surface`), and the pose that brings the points onto the planes there
is solved for with Tukey's weights, again and again with a smaller radius (Y. Chen and G. Medioni,
1992; J. W. Tukey).

Whatever the points do not determine stays as it was believed: the eigenvectors of the information
matrix that hardly any point resists (on a bare plane: two moves and a turn) are left out of every
step (J. Zhang, M. Kaess and S. Singh, 2016) and reported. Open3D's registration solves for those
too, from noise, so the step is implemented here."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Float, Float64, Points, Pose
from toolkit.calibration.motions import LEVER_M, Motion, apply_motion, motion_between, resistance
from toolkit.calibration.reference_surface import Surface, thin_rows
from toolkit.geometry import transform

_Deviations = Float[np.ndarray, " n"]
_Levels = Sequence[tuple[float, float, float]]
# Each level: radius (m) of the search for counterparts, voxel (m) that keeps one point, smallest
# limit (m) of Tukey's weights. Walls may be farther off than the ground, which has more points.
_COARSE = ((3.0, 1.0, 1.5), (1.5, 0.7, 0.75), (0.7, 0.5, 0.35))
_FINE = ((0.35, 0.3, 0.2), (0.2, 0.25, 0.1), (0.15, 0.25, 0.05))
# turns about z that the coarse levels start with
_START_TURNS_RAD = tuple(np.deg2rad([0.0, -2.5, 2.5, -5.0, 5.0]))
_STEPS = 20  # limit for each level
CONVERGED = 1e-4  # fraction of the radius: a smaller step is the last one
_AGREEMENT_M = 0.3  # from the surface, of a point that agrees with a start
_MIN_START_GAP_M = 0.05  # between different results of two starts
_MAX_AGREEMENT_LOSS = 0.002  # by a result that is as good as the best
TUKEY = 4.685
MIN_SCALE_M = 0.01  # of the residuals in Tukey's weights
_MIN_RESISTANCE = 0.15  # fraction of a unit motion across the plane: less is the noise of normals
# points that must resist a motion for it to be observed: their share, and their number
_MIN_RESISTING_SHARE = 0.0004
_MIN_RESISTING_POINTS = 2.0
CORRELATED_POINTS = 9.0  # points that weigh as much as one, since errors of neighbours are alike


@dataclass(frozen=True, eq=False)
class Registration:
    """A pose that was found.

    Attributes:
        pose: world_SE3_sensor.
        covariance: covariance of a motion's six numbers (rad and m), as far as it is observed.
        unobserved: unit motions, turns times `LEVER_M`, that the points do not determine.
        overlap: share of the points that have a counterpart.
        scatter: robust standard deviation of their distances from it (m).
    """

    pose: Pose
    covariance: Float64[np.ndarray, "6 6"]
    unobserved: Float64[np.ndarray, "k 6"]
    overlap: float
    scatter: float

    @property
    def deviations(self) -> Motion:
        """Standard deviations of the six numbers, infinite where unobserved."""
        is_hidden = (np.abs(self.unobserved) > 0.3).any(axis=0)
        return np.where(is_hidden, np.inf, np.sqrt(np.diag(self.covariance)))


def register(
    points: Points, surface: Surface, believed: Pose, *, deviation: _Deviations | None = None
) -> Registration:
    """Find the pose world_SE3_sensor near the believed one.

    points: measured points in the sensor's frame; deviation: standard deviation of each (m), which
    lowers its weight. Raises ValueError if fewer than 50 points have a counterpart within 3 m."""
    points = np.asarray(points, np.float64)
    noise = np.full(len(points), MIN_SCALE_M)
    if deviation is not None:
        noise = np.maximum(deviation, MIN_SCALE_M)
    believed = np.array(believed, np.float64)
    starts = _find_starts(points, noise, surface, believed)
    fine = [align_levels(points, noise, surface, start, _FINE) for start in starts]
    best = max(system.agreement for _, system in fine)
    as_good = [
        candidate for candidate in fine if candidate[1].agreement >= best - _MAX_AGREEMENT_LOSS
    ]

    def distance_from_believed(candidate: tuple[Pose, _System]) -> float:
        return float(np.linalg.norm(motion_between(believed, candidate[0])))

    pose, system = min(as_good, key=distance_from_believed)
    hidden = system.hidden_motions
    if len(hidden):  # a coarse level may have gone astray along these
        motion = motion_between(believed, pose)
        motion -= hidden.T @ (hidden @ motion)
        pose, system = align_levels(points, noise, surface, apply_motion(believed, motion), _FINE)
    return Registration(
        pose, system.covariance(), system.hidden_motions, system.overlap, system.scatter
    )


def _find_starts(
    points: Points, noise: _Deviations, surface: Surface, believed: Pose
) -> list[np.ndarray]:
    """Poses that coarse levels find from several turns about z, each once."""
    poses: list[np.ndarray] = []
    for turn in _START_TURNS_RAD:
        start = apply_motion(believed, np.array([0, 0, turn * LEVER_M, 0, 0, 0]))
        pose, _ = align_levels(points, noise, surface.thin, start, _COARSE)
        gaps = [np.abs(motion_between(pose, earlier)).max() for earlier in poses]
        if all(gap > _MIN_START_GAP_M for gap in gaps):
            poses.append(pose)
    return poses


def align_levels(
    points: Points, noise: _Deviations, surface: Surface, pose: Pose, levels: _Levels
) -> "tuple[Pose, _System]":
    """Align the points level by level. Returns the pose and the last system that was solved."""
    for radius, voxel, min_limit in levels:
        rows = thin_rows(points, voxel)
        for _ in range(_STEPS):
            system = _pair_points(points[rows], noise[rows], surface, pose, (radius, min_limit))
            step = system.step()
            pose = apply_motion(pose, step)
            if np.abs(step).max() < CONVERGED * radius:
                break
    return pose, system


def _pair_points(
    points: Points, noise: _Deviations, surface: Surface, pose: Pose, limits: tuple[float, float]
) -> "_System":
    """Pair points with their nearest neighbours on a surface.

    limits: search radius and smallest limit of the weights (m)."""
    radius, min_limit = limits
    world = transform(pose, points)
    distance, neighbours = surface.tree.query(world, distance_upper_bound=radius)
    near = np.flatnonzero(np.isfinite(distance))
    if len(near) < 50:
        problem = (
            f"{len(near)} of {len(points)} points lie within {radius:g} m of the "
            "reference, 50 are needed"
        )
        remedy = "is it of the same place and frame, and the sensor no farther off than that?"
        raise ValueError(f"{problem}: {remedy}")
    counterparts = neighbours[near]
    normals = surface.normals[counterparts]
    residual = ((world[near] - surface.points[counterparts]) * normals).sum(axis=1)
    scatter = max(1.4826 * float(np.median(np.abs(residual))), MIN_SCALE_M)
    variance = noise[near] ** 2 + surface.roughness[counterparts] ** 2 + scatter**2
    spread = np.sqrt(variance)
    limit = np.maximum(TUKEY * spread, min_limit)
    weight = tukey_weight(residual / limit, 1.0) / spread**2
    jacobian = resistance(world[near], pose[:3, 3], normals)
    return _System(jacobian, residual, weight, len(near) / len(points), scatter)


def tukey_weight(residual: Float64[np.ndarray, " n"], limit: float) -> Float64[np.ndarray, " n"]:
    """Tukey's weight of each residual, zero from the limit on."""
    return np.clip(1 - (residual / limit) ** 2, 0, None) ** 2


@dataclass(frozen=True, eq=False)
class _System:
    """Linear system of one step.

    Attributes:
        rows: resistance of each pair.
        residual: distance of each pair along the normal (m).
        weight: weight of each pair.
        overlap: share of the points that have a pair.
        scatter: robust standard deviation of the residuals (m).
    """

    rows: Float64[np.ndarray, "n 6"]
    residual: Float64[np.ndarray, " n"]
    weight: Float64[np.ndarray, " n"]
    overlap: float
    scatter: float

    @property
    def agreement(self) -> float:
        """Share of all points on the surface; near ones count more, up to 0.3 m off."""
        return float(tukey_weight(self.residual, _AGREEMENT_M).mean()) * self.overlap

    @cached_property
    def modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eigenvalues and eigenvectors (columns), and mask of observed ones."""
        values, vectors = np.linalg.eigh(self.rows.T @ (self.rows * self.weight[:, None]))
        along = (self.rows @ vectors) ** 2
        sound = self.weight > 0
        resists = np.where(along > _MIN_RESISTANCE**2, along, 0.0)[sound].sum(axis=0)
        return (
            values,
            vectors,
            resists > max(_MIN_RESISTING_SHARE * sound.sum(), _MIN_RESISTING_POINTS),
        )

    @property
    def hidden_motions(self) -> Float64[np.ndarray, "k 6"]:
        """Unit motions (k, 6) that hardly any pair resists."""
        _, vectors, observed = self.modes
        return vectors[:, ~observed].T

    def step(self) -> Motion:
        """Motion, if determined, that brings points onto planes."""
        values, vectors, observed = self.modes
        gradient = vectors.T @ (self.rows.T @ (self.weight * self.residual))
        return vectors @ np.where(observed, -gradient / np.where(observed, values, 1.0), 0.0)

    def covariance(self) -> Float64[np.ndarray, "6 6"]:
        """Covariance of the observed motions, in rad and m."""
        values, vectors, observed = self.modes
        inverse = np.where(observed, CORRELATED_POINTS / np.where(observed, values, 1.0), 0.0)
        unit = np.repeat([1 / LEVER_M, 1.0], 3)
        return unit[:, None] * ((vectors * inverse) @ vectors.T) * unit
