"""Where a sensor is, from points it measured of a scene whose surface is known: point to plane, coarse to fine.

Each point is paired with the nearest point of the surface, and the pose that brings the points onto the planes there
is solved for, with Tukey's weights, over and over with a smaller radius (Y. Chen and G. Medioni, 1992; J. W. Tukey).
Motions are six numbers: turns (rad) about the world's axes through the sensor, and moves (m) along them,

    pose = [exp(turn) R, t + move].

What the points cannot say stays as it was believed: the eigenvectors of the information matrix along which next to no
point resists (on a bare plane: two moves and a turn) are left out of every step (J. Zhang, M. Kaess and S. Singh, 2016)
and reported. Open3D's own registration solves for those too, from noise, which is why the step is ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from toolkit.arrays import Float, Float64, Int64
from toolkit.geometry import transform

NAMES = ("turn about x", "turn about y", "turn about z", "move along x", "move along y", "move along z")
LEVER = 10.0  # m; a turn by an angle is compared with a move as that of a point so far off
# Level by level the radius (m) within which counterparts are looked for, the voxel (m) that leaves one point, and the
# least limit (m) of Tukey's weights: walls may be farther off than the ground, of which there is so much more.
_COARSE = ((3.0, 1.0, 1.5), (1.5, 0.7, 0.75), (0.7, 0.5, 0.35))
_FINE = ((0.35, 0.3, 0.2), (0.2, 0.25, 0.1), (0.15, 0.25, 0.05))
_STARTS = tuple(np.deg2rad([0.0, -2.5, 2.5, -5.0, 5.0]))  # turns about z from which the coarse levels begin
_STEPS = 20  # at most, of one level
_CONVERGED = 1e-4  # of the radius, that the last step is smaller than
_AGREES = 0.3  # m, within which a point agrees with a start
_SAME, _AS_GOOD = 0.05, 0.002  # m between starts that came to the same; agreement that is as good as another
_TUKEY = 4.685
_LEAST_SCALE = 0.01  # m, of the residuals that Tukey's weights are scaled by
_RESISTS = 0.15  # of a unit motion, across the plane: less is the noise of normals
_LEAST_SHARE, _LEAST_POINTS = 0.0004, 2.0  # of the points, that must resist a motion for it to be observed
_CORRELATED = 9.0  # points that say as much as one alone: errors of neighbours are alike


@dataclass(frozen=True, eq=False)
class Surface:
    """What stands still: points (m) and the unit normals there, either way round, in one frame; roughness: standard
    deviation (m) of the surface about the plane of each point."""

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    roughness: Float64[np.ndarray, " n"]

    @cached_property
    def tree(self) -> Any:
        """SciPy's tree of the points."""
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def thin(self) -> Surface:
        """One of its points in each cube of 0.4 m, for what need not be exact yet."""
        some = one_each(self.points, 0.4)
        return Surface(self.points[some], self.normals[some], self.roughness[some])


@dataclass(frozen=True, eq=False)
class Registration:
    """A pose that was found again.

    covariance: of the six numbers of a motion (rad and m), as far as it is observed; unobserved: (k, 6) unit motions,
    turns times `LEVER`, of which the points say nothing. overlap: share of the points that have a counterpart; scatter:
    robust standard deviation of their distances from it (m).
    """

    pose: Float64[np.ndarray, "4 4"]
    covariance: Float64[np.ndarray, "6 6"]
    unobserved: Float64[np.ndarray, "k 6"]
    overlap: float
    scatter: float

    @property
    def deviations(self) -> Float64[np.ndarray, "6"]:
        """Standard deviation of each of the six numbers, infinite where it is not observed."""
        hidden = (np.abs(self.unobserved) > 0.3).any(axis=0) if len(self.unobserved) else np.zeros(6, bool)
        return np.where(hidden, np.inf, np.sqrt(np.diag(self.covariance)))


def register(
    points: Float[np.ndarray, "n 3"],
    surface: Surface,
    believed: Float64[np.ndarray, "4 4"],
    *,
    deviation: Float[np.ndarray, " n"] | None = None,
) -> Registration:
    """The pose world_SE3_sensor of a sensor from points of its own frame, near the one it is believed to have.

    deviation: of each point (m), by which it counts less. Raises ValueError where fewer than 50 points have a
    counterpart within 3 m.
    """
    points = np.asarray(points, np.float64)
    noise = np.full(len(points), _LEAST_SCALE) if deviation is None else np.maximum(deviation, _LEAST_SCALE)
    believed = np.array(believed, np.float64)
    coarse: list[np.ndarray] = []
    for turn in _STARTS:
        start = after_motion(believed, np.array([0, 0, turn * LEVER, 0, 0, 0]))
        pose, _ = _aligned(points, noise, surface.thin, start, _COARSE)
        if all(np.abs(motion_between(pose, other)).max() > _SAME for other in coarse):
            coarse.append(pose)
    fine = [_aligned(points, noise, surface, pose, _FINE) for pose in coarse]
    best = max(system.agreement for _, system in fine)
    pose, system = min(
        (each for each in fine if each[1].agreement >= best - _AS_GOOD),
        key=lambda each: float(np.linalg.norm(motion_between(believed, each[0]))),
    )
    if len(system.unobserved):  # along which a coarse level may have gone astray
        motion = motion_between(believed, pose)
        motion -= system.unobserved.T @ (system.unobserved @ motion)
        pose, system = _aligned(points, noise, surface, after_motion(believed, motion), _FINE)
    return Registration(pose, system.covariance(), system.unobserved, system.overlap, system.scatter)


def _aligned(
    points: Float64[np.ndarray, "n 3"],
    noise: Float64[np.ndarray, " n"],
    surface: Surface,
    pose: Float64[np.ndarray, "4 4"],
    levels: Sequence[tuple[float, float, float]],
) -> tuple[Float64[np.ndarray, "4 4"], _System]:
    """The pose after some levels, and the last system that was solved."""
    for radius, voxel, least in levels:
        some = one_each(points, voxel)
        for _ in range(_STEPS):
            system = _system(points[some], noise[some], surface, pose, (radius, least))
            step = system.step()
            pose = after_motion(pose, step)
            if np.abs(step).max() < _CONVERGED * radius:
                break
    return pose, system


def after_motion(pose: Float64[np.ndarray, "4 4"], motion: Float64[np.ndarray, "6"]) -> Float64[np.ndarray, "4 4"]:
    """A pose after a motion whose turns are times `LEVER`."""
    from toolkit.sensors.error_terms import rotation_about

    after = pose.copy()
    after[:3, :3] = rotation_about(motion[:3] / LEVER) @ pose[:3, :3]
    after[:3, 3] += motion[3:]
    return after


def motion_between(before: Float64[np.ndarray, "4 4"], after: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "6"]:
    """The motion, turns times `LEVER`, that `after_motion` needs from one pose to another."""
    turn = after[:3, :3] @ before[:3, :3].T
    sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    length = float(np.linalg.norm(sine))
    angle = float(np.arctan2(length, (np.trace(turn) - 1) / 2))
    return np.concatenate([sine * (LEVER * angle / length if length else 0.0), after[:3, 3] - before[:3, 3]])


def resistance(
    points: Float64[np.ndarray, "n 3"], position: Float64[np.ndarray, "3"], normals: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 6"]:
    """How far each point leaves its plane per unit of each number of a motion about a position, turns times `LEVER`."""
    return np.concatenate([np.cross(points - position, normals) / LEVER, normals], axis=1)


def one_each(points: Float64[np.ndarray, "n 3"], voxel: float) -> Int64[np.ndarray, " k"]:
    """Rows of the first point in each cube of that edge (m), so that near ground does not outweigh all else."""
    cube = np.floor(points / voxel).astype(np.int64)
    if len(cube):
        cube -= cube.min(axis=0)
    extent = cube.max(axis=0, initial=0) + 1
    key = (cube[:, 0] * extent[1] + cube[:, 1]) * extent[2] + cube[:, 2]
    return np.sort(np.unique(key, return_index=True)[1])


def tukey(residual: Float64[np.ndarray, " n"], limit: float) -> Float64[np.ndarray, " n"]:
    """Tukey's weight of each residual, zero from the limit on."""
    return np.clip(1 - (residual / limit) ** 2, 0, None) ** 2


@dataclass(frozen=True, eq=False)
class _System:
    """The linear system of one step. rows: resistance of each pair; weight: of each; residual: along the normal."""

    rows: Float64[np.ndarray, "n 6"]
    residual: Float64[np.ndarray, " n"]
    weight: Float64[np.ndarray, " n"]
    overlap: float
    scatter: float

    @property
    def agreement(self) -> float:
        """Share of all points that lie on the surface, near ones more than those 0.3 m off."""
        return float(tukey(self.residual, _AGREES).mean()) * self.overlap

    @cached_property
    def information(self) -> Float64[np.ndarray, "6 6"]:
        """The inverse of the covariance, were the pairs independent."""
        return self.rows.T @ (self.rows * self.weight[:, None])

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eigenvalues and eigenvectors (columns) of the information, and which of them are observed."""
        values, vectors = np.linalg.eigh(self.information)
        along = (self.rows @ vectors) ** 2
        sound = self.weight > 0
        resists = np.where(along > _RESISTS**2, along, 0.0)[sound].sum(axis=0)
        return values, vectors, resists > max(_LEAST_SHARE * sound.sum(), _LEAST_POINTS)

    @property
    def unobserved(self) -> Float64[np.ndarray, "k 6"]:
        """Unit motions that next to no pair resists."""
        _, vectors, observed = self._modes
        return vectors[:, ~observed].T

    def step(self) -> Float64[np.ndarray, "6"]:
        """The motion that brings the points onto their planes, as far as they say."""
        values, vectors, observed = self._modes
        gradient = vectors.T @ (self.rows.T @ (self.weight * self.residual))
        return vectors @ np.where(observed, -gradient / np.where(observed, values, 1.0), 0.0)

    def covariance(self) -> Float64[np.ndarray, "6 6"]:
        """Of what is observed, in rad and m."""
        values, vectors, observed = self._modes
        inverse = np.where(observed, _CORRELATED / np.where(observed, values, 1.0), 0.0)
        unit = np.repeat([1 / LEVER, 1.0], 3)
        return unit[:, None] * ((vectors * inverse) @ vectors.T) * unit


def _system(
    points: Float64[np.ndarray, "n 3"],
    noise: Float64[np.ndarray, " n"],
    surface: Surface,
    pose: Float64[np.ndarray, "4 4"],
    limits: tuple[float, float],
) -> _System:
    radius, least = limits
    world = transform(pose, points)
    apart, other = surface.tree.query(world, distance_upper_bound=radius)
    near = np.flatnonzero(np.isfinite(apart))
    if len(near) < 50:
        raise ValueError(
            f"{len(near)} of {len(points)} points lie within {radius:g} m of the reference, 50 are needed: is it of "
            "the same place and frame, and the sensor no farther off than that?"
        )
    normals = surface.normals[other[near]]
    residual = ((world[near] - surface.points[other[near]]) * normals).sum(axis=1)
    scatter = max(1.4826 * float(np.median(np.abs(residual))), _LEAST_SCALE)
    spread = np.sqrt(noise[near] ** 2 + surface.roughness[other[near]] ** 2 + scatter**2)
    weight = tukey(residual / np.maximum(_TUKEY * spread, least), 1.0) / spread**2
    return _System(resistance(world[near], pose[:3, 3], normals), residual, weight, len(near) / len(points), scatter)
