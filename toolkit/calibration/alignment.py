"""Joint alignment of sensors by the parts of a standing scene that several see, without a
reference.

Poses are world_SE3_sensor. A motion of all n sensors is 6 n numbers, sensor by sensor: three turns
(rad) times `LEVER_M`, three moves (m), see `toolkit.calibration.motions`."""

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

# Each level of refinement: radius (m) of the search for counterparts, edge (m) of the voxels that
# keep one point each, least residual (m) from which Tukey's weights are 0.
_LEVELS = ((1.5, 0.8, 0.75), (0.7, 0.5, 0.35), (0.35, 0.4, 0.15), (0.2, 0.4, 0.08))
_STEPS = 15  # largest number of steps in each level
MIN_SIDE_COSINE = 0.7  # cosine of the angle between the normals of a pair: a hedge has two sides
# a function that returns further pairs for given poses and a search radius (m)
MorePairs = Callable[[Poses, float], Sequence[Pairs]]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Sensor poses fitted to each other, with their errors.

    Attributes:
        poses: world_SE3_sensor of each sensor.
        covariance: covariance of the motions of all sensors, six numbers each (rad and m), m = 6 n;
            for motions that are not observed, the covariance of the usual mounting errors.
        unobserved: (k, 6 n) unit motions of all sensors that the pairs do not determine, turns
            times `LEVER_M`, without the motions of all sensors together.
        shared: (n, n) number of pairs of points or objects that two sensors share, symmetric.
        scatter: (n,) robust standard deviation of the residuals of each sensor's pairs (m).
    """

    poses: tuple[Pose, ...]
    covariance: Float64[np.ndarray, "m m"]
    unobserved: Float64[np.ndarray, "k m"]
    shared: Int64[np.ndarray, "n n"]
    scatter: Float64[np.ndarray, " n"]

    def hidden_motions(self, sensor: int) -> Float64[np.ndarray, "_ 6"]:
        """Orthonormal motions of one sensor that nothing determines, turns times `LEVER_M`.

        sensor: its number."""
        # the six columns of this sensor in the motions of all sensors
        sensor_motions = self.unobserved[:, 6 * sensor : 6 * sensor + 6]
        _, size, motions = np.linalg.svd(sensor_motions, full_matrices=False)
        # a size is the sensor's part, 0 to 1, in the joint unit motions; small ones are noise
        return motions[size > 0.3]


def align(
    surfaces: Sequence[Surface],
    believed: Poses,
    *,
    held: Sequence[int] = (),
    more: MorePairs | None = None,
) -> Alignment:
    """Fit sensor poses, near the believed ones, to each other by their surfaces.

    Args:
        surfaces: each sensor's empty scene in the sensor's frame, normals towards the sensor.
        believed: world_SE3_sensor of each, as mounted.
        held: numbers of sensors whose poses stay.
        more: returns further pairs for poses and a search radius (m), such as pairs of objects.

    Raises ValueError for fewer than two sensors, and for an unknown held one."""
    count = len(surfaces)
    if count != len(believed) or count < 2:
        got = f"got {count} surfaces and {len(believed)} poses"
        raise ValueError(
            f"alignment needs two or more sensors, each with a surface and a pose: {got}"
        )
    if any(not 0 <= sensor < count for sensor in held):
        raise ValueError(f"held must be sensor numbers from 0 to {count - 1}, got {list(held)}")
    # mask of the 6 n numbers that may change
    is_free = np.repeat([sensor not in held for sensor in range(count)], 6)
    poses = [np.array(pose, np.float64) for pose in believed]
    for radius, voxel, min_limit in _LEVELS:
        thinned_points = [thin_rows(surface.points, voxel) for surface in surfaces]
        for _ in range(_STEPS):
            pairs = pair_surfaces(surfaces, thinned_points, poses, (radius, min_limit))
            pairs += list(more(poses, radius)) if more is not None else []
            pose_pairs = zip(believed, poses, strict=True)
            off = [motion_between(*pose_pair) for pose_pair in pose_pairs]
            system = JointSystem(pairs, is_free, np.concatenate(off))
            step = system.step()
            poses = list(map(apply_motion, poses, step.reshape(-1, 6)))
            if np.abs(step).max() < registration.CONVERGED * radius:
                break
    hidden_motions = system.hidden_motions(_find_common_motions(poses))
    shared, scatter = _count_pairs(pairs, count)
    return Alignment(
        poses=tuple(poses),
        covariance=system.covariance(),
        unobserved=hidden_motions,
        shared=shared,
        scatter=scatter,
    )


def _find_common_motions(poses: Poses) -> Float64[np.ndarray, "6 m"]:
    """Orthonormal motions of all sensors together, as if they were on one rigid frame.

    Three turns about the middle of the sensors, then three moves; m = 6 n numbers each."""
    positions = [pose[:3, 3] for pose in poses]
    middle = np.mean(positions, axis=0)
    motions = np.zeros((6, len(poses), 6))  # motion, sensor, number
    for axis, direction in enumerate(np.eye(3)):
        for sensor, position in enumerate(positions):
            # a common turn about an axis also moves sensors that are away from the middle
            motions[axis, sensor, :3] = direction * LEVER_M
            motions[axis, sensor, 3:] = np.cross(direction, position - middle)
            motions[3 + axis, sensor, 3:] = direction
    orthonormal, _ = np.linalg.qr(motions.reshape(6, -1).T)
    return orthonormal.T


def _count_pairs(
    pairs: Sequence[Pairs], sensors: int
) -> tuple[Int64[np.ndarray, "n n"], Float64[np.ndarray, " n"]]:
    """Count used pairs by sensors, and measure the scatter of each sensor's residuals.

    pairs: pairs of points or objects, of two sensors each; sensors: number of sensors. Returns a
    symmetric matrix of counts, and robust standard deviations (m, from the median of the absolute
    residuals), 0 for a sensor without pairs."""
    pair_counts = np.zeros((sensors, sensors), np.int64)
    # absolute residuals of the pairs of each sensor
    residuals: list[list[np.ndarray]] = [[np.empty(0)] for _ in range(sensors)]
    for pair in pairs:
        is_used = pair.weight > 0
        pair_counts[pair.first_sensor, pair.second_sensor] += int(is_used.sum())
        for sensor in (pair.first_sensor, pair.second_sensor):
            residuals[sensor].append(np.abs(pair.residual[is_used]))
    scatter = np.zeros(sensors)
    for sensor, sensor_residuals in enumerate(residuals):
        pooled_residuals = np.concatenate(sensor_residuals)
        if len(pooled_residuals):
            # 1.4826 makes the median deviation of normal noise its standard deviation
            scatter[sensor] = 1.4826 * float(np.median(pooled_residuals))
    # pairs of sensors 0 and 1 are counted at (0, 1) and at (1, 0): both searched for the other
    return pair_counts + pair_counts.T, scatter


def face_sensor(surface: Surface) -> Surface:
    """Return a surface with its normals turned towards the sensor, at the origin of its frame."""
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

    Args:
        surfaces: standing scene of each sensor in its frame, normals towards the sensor.
        thinned: for each surface, rows of the points to pair.
        poses: world_SE3_sensor of each sensor.
        limits: search radius, and least residual from which a pair has no weight (m).

    Returns the pairs of every ordered two sensors: (0, 1) and (1, 0) pair different points."""
    pairs = []
    for one, other in permutations(range(len(surfaces)), 2):
        pairs.append(
            _pair_sensors(
                surfaces, numbers=(one, other), rows=thinned[one], poses=poses, limits=limits
            )
        )
    return pairs


def _pair_sensors(
    surfaces: Sequence[Surface],
    numbers: tuple[int, int],
    rows: Int64[np.ndarray, " k"],
    poses: Poses,
    limits: tuple[float, float],
) -> Pairs:
    """Pair some points of one sensor's surface with the nearest points of another's.

    Args:
        surfaces: standing scene of each sensor in its frame.
        numbers: number of the sensor whose points are paired, and of the sensor that is searched.
        rows: rows of the first sensor's points to pair.
        poses: world_SE3_sensor of each sensor.
        limits: search radius, and least residual from which a pair has no weight (m)."""
    one, other = numbers
    radius, min_limit = limits
    surface = surfaces[one]
    target = surfaces[other]
    world = transform(poses[one], surface.points[rows])
    in_target = transform(invert(poses[other]), world)
    distance, neighbours = target.tree.query(in_target, distance_upper_bound=radius)
    # the distance is infinite without a neighbour
    near_rows = np.flatnonzero(np.isfinite(distance))
    # normals of both sides in world axes
    facing = surface.normals[rows] @ poses[one][:3, :3].T
    normals = target.normals[neighbours[near_rows]] @ poses[other][:3, :3].T
    is_alike = (facing[near_rows] * normals).sum(axis=1) > MIN_SIDE_COSINE
    near_rows = near_rows[is_alike]
    normals = normals[is_alike]
    target_rows = neighbours[near_rows]
    counterparts = transform(poses[other], target.points[target_rows])
    roughness = np.hypot(surface.roughness[rows[near_rows]], target.roughness[target_rows])
    deviation = np.hypot(roughness, registration.MIN_SCALE_M)
    return Pairs(
        first_sensor=one,
        second_sensor=other,
        first_rows=resistance(world[near_rows], poses[one][:3, 3], normals),
        second_rows=-resistance(world[near_rows], poses[other][:3, 3], normals),
        residual=((world[near_rows] - counterparts) * normals).sum(axis=1),
        deviation=deviation * np.sqrt(registration.CORRELATED_POINTS),
        limit=np.maximum(registration.TUKEY * deviation, min_limit),
    )
