"""Joint alignment of sensors by the parts of a standing scene that several see, without a
reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from toolkit.arrays import Float64, Int64, Pose
from toolkit.calibration import registration
from toolkit.calibration.joint_system import JointSystem, Pairs, Poses
from toolkit.calibration.motions import LEVER_M, apply_motion, motion_between, resistance
from toolkit.calibration.reference_surface import Surface, thin_rows
from toolkit.geometry import invert, transform

# Each level: radius (m) of the search for counterparts, voxel (m), least limit (m) of Tukey's
# weights.
_LEVELS = ((1.5, 0.8, 0.75), (0.7, 0.5, 0.35), (0.35, 0.4, 0.15), (0.2, 0.4, 0.08))
_STEPS = 15  # limit for each level
_MIN_SIDE_COSINE = 0.7  # cosine of the angle between the normals of a pair: a hedge has two sides
# further pairs for poses and a search radius (m)
MorePairs = Callable[[Poses, float], Sequence[Pairs]]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses that fit each other.

    Attributes:
        poses: pose of each sensor.
        covariance: covariance of the motions of all sensors, six numbers each (rad and m); for
            motions that are not observed, the covariance of the usual errors.
        unobserved: unit motions of all sensors, turns times `LEVER_M`, without the common ones.
        shared: number of rows that each two sensors share.
        scatter: robust standard deviation (m) of each sensor's rows.
    """

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
        thinned = [thin_rows(surface.points, voxel) for surface in surfaces]
        for _ in range(_STEPS):
            pairs = pair_surfaces(surfaces, thinned, poses, (radius, min_limit))
            pairs += list(more(poses, radius)) if more is not None else []
            pose_pairs = zip(believed, poses, strict=True)
            off = [motion_between(*pose_pair) for pose_pair in pose_pairs]
            system = JointSystem(pairs, free, np.concatenate(off))
            step = system.step()
            poses = list(map(apply_motion, poses, step.reshape(-1, 6)))
            if np.abs(step).max() < registration.CONVERGED * radius:
                break
    hidden = system.hidden_motions(_find_common_motions(poses))
    shared, scatter = _count_rows(pairs, count)
    return Alignment(tuple(poses), system.covariance(), hidden, shared, scatter)


def _find_common_motions(poses: Poses) -> Float64[np.ndarray, "6 m"]:
    """Orthonormal motions of all sensors together, as if they were on one rigid frame."""
    middle = np.mean([pose[:3, 3] for pose in poses], axis=0)
    motions = np.zeros((6, len(poses), 6))
    for axis, direction in enumerate(np.eye(3)):
        for sensor, pose in enumerate(poses):
            motions[axis, sensor, :3] = direction * LEVER_M
            motions[axis, sensor, 3:] = np.cross(direction, pose[:3, 3] - middle)
            motions[3 + axis, sensor, 3:] = direction
    return np.linalg.qr(motions.reshape(6, -1).T)[0].T


def _count_rows(
    pairs: Sequence[Pairs], sensors: int
) -> tuple[Int64[np.ndarray, "n n"], Float64[np.ndarray, " n"]]:
    """Rows that each two sensors share, and the robust deviation (m) of each sensor's rows."""
    shared = np.zeros((sensors, sensors), np.int64)
    residuals: list[list[np.ndarray]] = [[np.empty(0)] for _ in range(sensors)]
    for pair in pairs:
        is_used = pair.weight > 0
        shared[pair.one, pair.other] += int(is_used.sum())
        for sensor in (pair.one, pair.other):
            residuals[sensor].append(np.abs(pair.residual[is_used]))
    scatter = np.zeros(sensors)
    for sensor, arrays in enumerate(residuals):
        pooled = np.concatenate(arrays)
        if len(pooled):
            scatter[sensor] = 1.4826 * float(np.median(pooled))
    return shared + shared.T, scatter


def face_sensor(surface: Surface) -> Surface:
    """Turn a surface's normals towards its sensor, the origin."""
    away = (surface.points * surface.normals).sum(axis=1) > 0
    normals = np.where(away[:, None], -surface.normals, surface.normals)
    return Surface(surface.points, normals, surface.roughness)


def pair_surfaces(
    surfaces: Sequence[Surface],
    thinned: Sequence[np.ndarray],
    poses: Poses,
    limits: tuple[float, float],
) -> list[Pairs]:
    """Pair each thinned point with other sensors' nearest points, if they face the same way.

    thinned: rows of each surface; limits: search radius and smallest limit of the weights (m)."""
    pairs = []
    for one, other in permutations(range(len(surfaces)), 2):
        pairs.append(_pair_two(surfaces, (one, other), thinned[one], poses, limits))
    return pairs


def _pair_two(
    surfaces: Sequence[Surface],
    numbers: tuple[int, int],
    rows: Int64[np.ndarray, " k"],
    poses: Poses,
    limits: tuple[float, float],
) -> Pairs:
    """Pair some rows of one sensor's surface with the nearest points of another's."""
    one, other = numbers
    radius, min_limit = limits
    surface = surfaces[one]
    target = surfaces[other]
    world = transform(poses[one], surface.points[rows])
    in_target = transform(invert(poses[other]), world)
    distance, neighbours = target.tree.query(in_target, distance_upper_bound=radius)
    near = np.flatnonzero(np.isfinite(distance))
    facing = surface.normals[rows] @ poses[one][:3, :3].T
    normals = target.normals[neighbours[near]] @ poses[other][:3, :3].T
    is_alike = (facing[near] * normals).sum(axis=1) > _MIN_SIDE_COSINE
    near = near[is_alike]
    normals = normals[is_alike]
    target_rows = neighbours[near]
    counterparts = transform(poses[other], target.points[target_rows])
    roughness = np.hypot(surface.roughness[rows[near]], target.roughness[target_rows])
    deviation = np.hypot(roughness, registration.MIN_SCALE_M)
    return Pairs(
        one,
        other,
        one_row=resistance(world[near], poses[one][:3, 3], normals),
        other_row=-resistance(world[near], poses[other][:3, 3], normals),
        residual=((world[near] - counterparts) * normals).sum(axis=1),
        deviation=deviation * np.sqrt(registration.CORRELATED_POINTS),
        limit=np.maximum(registration.TUKEY * deviation, min_limit),
    )
