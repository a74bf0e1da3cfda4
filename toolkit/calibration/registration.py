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
from toolkit.calibration.motions import (
    LEVER_M,
    Motion,
    MotionModes,
    apply_motion,
    motion_between,
    resistance,
)
from toolkit.calibration.reference_surface import Surface, thin_rows
from toolkit.geometry import transform

_Deviations = Float[np.ndarray, " n"]
_Levels = Sequence[tuple[float, float, float]]
# Each level of refinement: radius (m) of the search for counterparts, edge (m) of the voxels that
# keep one point each, least residual (m) from which Tukey's weights are 0. The limit is not taken
# from the scatter only, since walls may be farther off than the ground, which has more points.
COARSE_LEVELS = ((3.0, 1.0, 1.5), (1.5, 0.7, 0.75), (0.7, 0.5, 0.35))
_FINE = ((0.35, 0.3, 0.2), (0.2, 0.25, 0.1), (0.15, 0.25, 0.05))
# turns about z that the coarse levels start with
_START_TURNS_RAD = tuple(np.deg2rad([0.0, -2.5, 2.5, -5.0, 5.0]))
MAX_LEVEL_STEPS = 20  # largest number of steps in each level
CONVERGED = 1e-4  # fraction of the radius: a smaller step is the last one
_AGREEMENT_M = 0.3  # distance from the surface within which a point agrees with a pose
_MIN_START_GAP_M = 0.05  # least motion between poses from two starts that count as different
MAX_AGREEMENT_LOSS = 0.002  # poses whose agreement is this close to the best are as good
TUKEY = 4.685  # limit of Tukey's weights in standard deviations: 95 % efficient for normal noise
MIN_SCALE_M = 0.01  # least standard deviation of residuals
# least part of a unit motion across a pair's plane that resists it: less is the noise of normals
_MIN_RESISTANCE = 0.15
# least share and least number of points that must resist a motion for it to be observed
_MIN_RESISTING_SHARE = 0.0004
_MIN_RESISTING_POINTS = 2.0
CORRELATED_POINTS = 9.0  # points that weigh as much as one, since errors of neighbours are alike


@dataclass(frozen=True, eq=False)
class Registration:
    """A sensor's pose that was found, with its errors.

    Attributes:
        pose: world_SE3_sensor.
        covariance: covariance of a motion's six numbers, three turns (rad) and three moves (m)
            about the world's axes, 0 along motions that are not observed.
        unobserved: (k, 6) unit motions, turns times `LEVER_M`, that the points do not determine.
        overlap: share of the points that have a counterpart, 0 to 1.
        scatter: robust standard deviation of the points' distances from their counterparts (m).
    """

    pose: Pose
    covariance: Float64[np.ndarray, "6 6"]
    unobserved: Float64[np.ndarray, "k 6"]
    overlap: float
    scatter: float

    @property
    def deviations(self) -> Motion:
        """Standard deviations of the six numbers (rad and m), infinite for unobserved ones."""
        # a number counts as unobserved if it is a clear part of a hidden unit motion
        is_hidden = (np.abs(self.unobserved) > 0.3).any(axis=0)
        return np.where(is_hidden, np.inf, np.sqrt(np.diag(self.covariance)))


def register(
    points: Points, surface: Surface, believed: Pose, *, deviation: _Deviations | None = None
) -> Registration:
    """Find the pose world_SE3_sensor near the believed one that fits points to a surface.

    Args:
        points: measured points in the sensor's frame (m).
        surface: standing surfaces, world frame.
        believed: world_SE3_sensor as mounted. Of poses that fit as well, the nearest to it is
            taken, and motions that the points do not determine stay as in it.
        deviation: standard deviation of each point (m), which lowers its weight.

    Raises ValueError if fewer than 50 points have a counterpart in the widest search, 3 m."""
    points = np.asarray(points, np.float64)
    noise = np.full(len(points), MIN_SCALE_M)
    if deviation is not None:
        noise = np.maximum(deviation, MIN_SCALE_M)
    believed = np.array(believed, np.float64)
    starts = _find_starts(points, noise, surface, believed)
    fits = [align_levels(points, noise, surface, pose=start, levels=_FINE) for start in starts]
    best_agreement = max(system.agreement for _, system in fits)
    good_fits = [fit for fit in fits if fit[1].agreement >= best_agreement - MAX_AGREEMENT_LOSS]

    def distance_from_believed(fit: tuple[Pose, LinearSystem]) -> float:
        """Length (m) of the change to a fitted pose; turns count as moves of points `LEVER_M`
        away."""
        pose, _ = fit
        return float(np.linalg.norm(motion_between(believed, pose)))

    pose, system = min(good_fits, key=distance_from_believed)
    hidden_motions = system.hidden_motions
    if len(hidden_motions):  # a coarse level may have gone astray along these
        motion = motion_between(believed, pose)
        # without the part along the hidden motions
        motion -= hidden_motions.T @ (hidden_motions @ motion)
        pose, system = align_levels(
            points, noise, surface, pose=apply_motion(believed, motion), levels=_FINE
        )
    return Registration(
        pose,
        covariance=system.covariance(),
        unobserved=system.hidden_motions,
        overlap=system.overlap,
        scatter=system.scatter,
    )


def _find_starts(
    points: Points, noise: _Deviations, surface: Surface, believed: Pose
) -> list[np.ndarray]:
    """Poses that a coarse registration finds from several turns about z, without repetitions.

    points: measured points in the sensor's frame (m); noise: standard deviation of each point (m);
    surface: standing surfaces, world frame; believed: world_SE3_sensor, which is turned."""
    poses: list[np.ndarray] = []
    for turn in _START_TURNS_RAD:
        turn_about_z = np.array([0, 0, turn * LEVER_M, 0, 0, 0])
        start = apply_motion(believed, turn_about_z)
        pose, _ = align_levels(
            points, noise, surface=surface.thinned_surface, pose=start, levels=COARSE_LEVELS
        )
        gaps = [np.abs(motion_between(pose, earlier_pose)).max() for earlier_pose in poses]
        if all(gap > _MIN_START_GAP_M for gap in gaps):
            poses.append(pose)
    return poses


def align_levels(
    points: Points, noise: _Deviations, surface: Surface, pose: Pose, levels: _Levels
) -> "tuple[Pose, LinearSystem]":
    """Align points with a surface level by level, from a first pose.

    Args:
        points: measured points in the sensor's frame (m).
        noise: standard deviation of each point (m).
        surface: standing surfaces, world frame.
        pose: world_SE3_sensor to start from.
        levels: search radius, voxel and least limit of the weights (m) of each level, in order.

    Returns the pose, and the system of the last step, which describes how well it fits."""
    for radius, voxel, min_limit in levels:
        rows = thin_rows(points, voxel)
        for _ in range(MAX_LEVEL_STEPS):
            system = _pair_points(
                points=points[rows],
                noise=noise[rows],
                surface=surface,
                pose=pose,
                limits=(radius, min_limit),
            )
            step = system.step()
            pose = apply_motion(pose, step)
            if np.abs(step).max() < CONVERGED * radius:
                break
    return pose, system


def _pair_points(
    points: Points, noise: _Deviations, surface: Surface, pose: Pose, limits: tuple[float, float]
) -> "LinearSystem":
    """Pair points with their nearest neighbours on a surface.

    Args:
        points: measured points in the sensor's frame (m).
        noise: standard deviation of each point (m).
        surface: standing surfaces, world frame.
        pose: world_SE3_sensor.
        limits: search radius, and least residual from which a pair has no weight (m).

    Returns the linear system of the pairs. Raises ValueError for fewer than 50 pairs."""
    radius, min_limit = limits
    world = transform(pose, points)
    distance, neighbours = surface.tree.query(world, distance_upper_bound=radius)
    # the distance is infinite without a neighbour
    near_rows = np.flatnonzero(np.isfinite(distance))
    if len(near_rows) < 50:
        problem = (
            f"{len(near_rows)} of {len(points)} points lie within {radius:g} m of the "
            "reference, 50 are needed"
        )
        remedy = "is it of the same place and frame, and the sensor no farther off than that?"
        raise ValueError(f"{problem}: {remedy}")
    counterparts = neighbours[near_rows]
    normals = surface.normals[counterparts]
    residual = ((world[near_rows] - surface.points[counterparts]) * normals).sum(axis=1)
    # 1.4826 makes the median deviation of normal noise its standard deviation
    scatter = max(1.4826 * float(np.median(np.abs(residual))), MIN_SCALE_M)
    variance = noise[near_rows] ** 2 + surface.roughness[counterparts] ** 2 + scatter**2
    spread = np.sqrt(variance)
    limit = np.maximum(TUKEY * spread, min_limit)
    weight = tukey_weight(residual / limit, 1.0) / spread**2
    jacobian = resistance(world[near_rows], pose[:3, 3], normals)
    return LinearSystem(
        rows=jacobian,
        residual=residual,
        weight=weight,
        overlap=len(near_rows) / len(points),
        scatter=scatter,
    )


def tukey_weight(residual: Float64[np.ndarray, " n"], limit: float) -> Float64[np.ndarray, " n"]:
    """Tukey's weight of each residual: 1 at zero, 0 from the limit on."""
    return np.clip(1 - (residual / limit) ** 2, 0, None) ** 2


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Linear system of one Gauss-Newton step for a sensor's pose.

    Attributes:
        rows: growth of each pair's residual per unit of the motion's six numbers.
        residual: distance of each pair's point from the surface, along the normal (m).
        weight: Tukey's weight of each pair over the variance of its residual.
        overlap: share of the points that have a pair, 0 to 1.
        scatter: robust standard deviation of the residuals (m).
    """

    rows: Float64[np.ndarray, "n 6"]
    residual: Float64[np.ndarray, " n"]
    weight: Float64[np.ndarray, " n"]
    overlap: float
    scatter: float

    @property
    def agreement(self) -> float:
        """Share of all points that are on the surface, 0 to 1.

        A point counts less the farther off it is, and not at all from `_AGREEMENT_M` on."""
        return float(tukey_weight(self.residual, _AGREEMENT_M).mean()) * self.overlap

    @cached_property
    def modes(self) -> MotionModes:
        """Six independent motions, with the information about each.

        A motion is observed if enough pairs with weight resist it. `rows` are the growth of each
        pair's residual per unit of the motion's six numbers."""
        values, vectors = np.linalg.eigh(self.rows.T @ (self.rows * self.weight[:, None]))
        # (pairs, modes): squared growth of each residual along each mode
        squared_growth = (self.rows @ vectors) ** 2
        has_weight = self.weight > 0
        resisting = np.where(squared_growth > _MIN_RESISTANCE**2, squared_growth, 0.0)
        resistance_sum = resisting[has_weight].sum(axis=0)
        min_sum = max(_MIN_RESISTING_SHARE * has_weight.sum(), _MIN_RESISTING_POINTS)
        return MotionModes(values, vectors, observed=resistance_sum > min_sum)

    @property
    def hidden_motions(self) -> Float64[np.ndarray, "k 6"]:
        """Unit motions (k, 6) that hardly any pair resists, turns times `LEVER_M`."""
        return self.modes.vectors[:, ~self.modes.observed].T

    def step(self) -> Motion:
        """Motion that brings the points onto their planes, turns times `LEVER_M`.

        It is 0 along motions that the points do not determine. `rows` are the growth of each pair's
        residual (m) per unit of the motion's six numbers."""
        vectors = self.modes.vectors
        observed = self.modes.observed
        gradient = vectors.T @ (self.rows.T @ (self.weight * self.residual))  # along each mode
        # 1 in place of values that are not used, so that no division is by 0
        divisors = np.where(observed, self.modes.values, 1.0)
        return vectors @ np.where(observed, -gradient / divisors, 0.0)

    def covariance(self) -> Float64[np.ndarray, "6 6"]:
        """Covariance of the six numbers in rad and m, 0 along motions that are not observed."""
        vectors = self.modes.vectors
        observed = self.modes.observed
        # 1 in place of values that are not used, so that no division is by 0
        divisors = np.where(observed, self.modes.values, 1.0)
        variance = np.where(observed, CORRELATED_POINTS / divisors, 0.0)  # along each mode
        # from turns times LEVER_M to rad
        unit = np.repeat([1 / LEVER_M, 1.0], 3)
        return unit[:, None] * ((vectors * variance) @ vectors.T) * unit
