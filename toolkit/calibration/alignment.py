"""Joint alignment of sensors by the parts of a standing scene that several of them see, without a
reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from toolkit.arrays import Float64, Int64, Pose
from toolkit.calibration import registration as reference_fit
from toolkit.calibration.joint_system import JointSystem, Pairs, Poses
from toolkit.calibration.registration import LEVER, Surface, motion_between, resistance
from toolkit.geometry import invert, transform

# Each level: radius (m) of the search for counterparts, voxel (m), least limit (m) of Tukey's
# weights.
_LEVELS = ((1.5, 0.8, 0.75), (0.7, 0.5, 0.35), (0.35, 0.4, 0.15), (0.2, 0.4, 0.08))
_STEPS = 15  # limit for each level
_SAME_SIDE = 0.7  # cosine of the angle between the normals of a pair: a hedge has two sides
# further pairs for poses and a search radius (m)
MorePairs = Callable[[Poses, float], Sequence[Pairs]]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses that fit each other.

    covariance: of the motions of all sensors, six numbers each (rad and m), that of the usual
    errors where nothing is observed; unobserved: unit motions of all sensors, turns times `LEVER`,
    other than the common ones; shared: number of rows that each two sensors share; scatter: robust
    standard deviation (m) of each sensor's rows."""

    poses: tuple[Pose, ...]
    covariance: Float64[np.ndarray, "m m"]
    unobserved: Float64[np.ndarray, "k m"]
    shared: Int64[np.ndarray, "n n"]
    scatter: Float64[np.ndarray, " n"]

    def hidden_motions(self, sensor: int) -> Float64[np.ndarray, "_ 6"]:
        """Unit motions of one sensor that nothing determines."""
        of_sensor = self.unobserved[:, 6 * sensor : 6 * sensor + 6]
        _, size, motions = np.linalg.svd(of_sensor, full_matrices=False)
        return motions[size > 0.3]


def align(
    surfaces: Sequence[Surface],
    believed: Poses,
    *,
    held: Sequence[int] = (),
    more: MorePairs | None = None,
) -> Alignment:
    """Fit sensor poses, near the believed ones, to each other by their surfaces.

    surfaces: each sensor's empty scene in its own frame, normals towards the sensor; held: numbers
    of sensors that stay; more: returns further pairs for poses and a search radius. Raises
    ValueError for fewer than two sensors, and for an unknown held one."""
    count = len(surfaces)
    if count != len(believed) or count < 2:
        got = f"got {count} surfaces and {len(believed)} poses"
        raise ValueError(
            f"alignment needs two or more sensors, each with a surface and a pose: {got}"
        )
    if any(not 0 <= sensor < count for sensor in held):
        raise ValueError(f"held must be sensor numbers from 0 to {count - 1}, got {list(held)}")
    free = np.repeat([sensor not in held for sensor in range(count)], 6)
    poses = [np.array(pose, np.float64) for pose in believed]
    for radius, voxel, min_limit in _LEVELS:
        thinned = [reference_fit.thin_rows(surface.points, voxel) for surface in surfaces]
        for _ in range(_STEPS):
            pairs = _surface_pairs(surfaces, thinned, poses, (radius, min_limit))
            pairs += list(more(poses, radius)) if more is not None else []
            motions_off = [
                motion_between(*pose_pair) for pose_pair in zip(believed, poses, strict=True)
            ]
            system = JointSystem(pairs, free, np.concatenate(motions_off))
            step = system.step()
            poses = list(map(reference_fit.apply_motion, poses, step.reshape(-1, 6)))
            if np.abs(step).max() < reference_fit.CONVERGED * radius:
                break
    middle = np.mean([pose[:3, 3] for pose in poses], axis=0)
    motions = np.zeros((6, count, 6))  # of all sensors together, as if they hung on one frame
    for axis, direction in enumerate(np.eye(3)):
        for sensor, pose in enumerate(poses):
            motions[axis, sensor] = [
                *(direction * LEVER),
                *np.cross(direction, pose[:3, 3] - middle),
            ]
            motions[3 + axis, sensor, 3:] = direction
    hidden = system.hidden_motions(np.linalg.qr(motions.reshape(6, -1).T)[0].T)
    shared = np.zeros((count, count), np.int64)
    rows = [[np.empty(0)] for _ in poses]
    for pair in pairs:
        counts = pair.weight > 0
        shared[pair.one, pair.other] += int(counts.sum())
        for sensor in (pair.one, pair.other):
            rows[sensor].append(np.abs(pair.residual[counts]))
    residuals_of = [np.concatenate(residuals) for residuals in rows]
    scatter = np.array(
        [
            1.4826 * float(np.median(residuals)) if len(residuals) else 0.0
            for residuals in residuals_of
        ]
    )
    return Alignment(tuple(poses), system.covariance(), hidden, shared + shared.T, scatter)


def face_sensor(surface: Surface) -> Surface:
    """Turn a surface's normals towards its sensor, the origin."""
    away = (surface.points * surface.normals).sum(axis=1) > 0
    return Surface(
        surface.points,
        np.where(away[:, None], -surface.normals, surface.normals),
        surface.roughness,
    )


def _surface_pairs(
    surfaces: Sequence[Surface],
    thinned: Sequence[np.ndarray],
    poses: Poses,
    limits: tuple[float, float],
) -> list[Pairs]:
    """Pair each thinned point with other sensors' nearest points, if they face the same way."""
    (radius, min_limit), pairs = limits, []
    for one, (surface, rows) in enumerate(zip(surfaces, thinned, strict=True)):
        world = transform(poses[one], surface.points[rows])
        facing = surface.normals[rows] @ poses[one][:3, :3].T
        for other, seen in enumerate(surfaces):
            if other == one:
                continue
            distance, row = seen.tree.query(
                transform(invert(poses[other]), world), distance_upper_bound=radius
            )
            near = np.flatnonzero(np.isfinite(distance))
            normals = seen.normals[row[near]] @ poses[other][:3, :3].T
            alike = (facing[near] * normals).sum(axis=1) > _SAME_SIDE
            near = near[alike]
            normals = normals[alike]
            counterparts = transform(poses[other], seen.points[row[near]])
            rough = np.hypot(surface.roughness[rows[near]], seen.roughness[row[near]])
            residual = ((world[near] - counterparts) * normals).sum(axis=1)
            deviation = np.hypot(rough, reference_fit.LEAST_SCALE)
            mine, theirs = (
                resistance(world[near], poses[sensor][:3, 3], normals) for sensor in (one, other)
            )
            spread = deviation * np.sqrt(reference_fit.CORRELATED)
            limit = np.maximum(reference_fit.TUKEY * deviation, min_limit)
            pairs.append(Pairs(one, other, mine, -theirs, residual, spread, limit))
    return pairs
