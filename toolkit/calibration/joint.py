"""Joint alignment of sensors by the parts of a standing scene that several of them see, without a reference.

The pairs of all pairs of sensors make one linear system with six numbers per sensor (see
`toolkit.calibration.registration`): a point of one sensor lies on the plane that another measured there. The common
pose of all sensors is not observed, so steps are the smallest possible ones. Motions of a sensor that shares too little
with the others are not observed either; objects that both see at the same time can determine them (`object_pairs`). The
usual errors of mounting, `USUAL_TURN` and `USUAL_MOVE`, are weighed against what few pairs say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from toolkit.arrays import Bool, BoxRows, Float64, Int64, Pose
from toolkit.calibration import registration
from toolkit.calibration.registration import LEVER, Surface, resistance
from toolkit.frame import Frame
from toolkit.geometry import invert, transform
from toolkit.objects import Detector
from toolkit.points import detect_on_ground, frame_points
from toolkit.sites.site import Site

# Each level: radius (m) of the search for counterparts, voxel (m), least limit (m) of Tukey's weights.
_LEVELS = ((1.5, 0.8, 0.75), (0.7, 0.5, 0.35), (0.35, 0.4, 0.15), (0.2, 0.4, 0.08))
_STEPS = 15  # limit for each level
_CONVERGED = 1e-4  # fraction of the radius: a smaller step is the last one
_SAME_SIDE = 0.7  # cosine of the angle between the normals of a pair: a hedge has two sides
_LEAST_SCALE, _TUKEY = 0.01, 4.685
_RESISTS = 0.1  # fraction of a motion across the plane: less is the noise of normals
_LEAST_POINTS = 5.0  # that must resist a motion for it to be observed
_CORRELATED = 9.0  # points that weigh as much as one alone, since errors of neighbours are alike
USUAL_TURN, USUAL_MOVE = float(np.deg2rad(1.5)), 0.15  # standard deviations of the believed poses, per axis

Poses = Sequence[Pose]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Rows of the linear system, each pulling sensors `one` and `other` together along a direction."""

    one: int
    other: int
    one_row: Float64[np.ndarray, "n 6"]  # growth of the residual with the motion of each sensor
    other_row: Float64[np.ndarray, "n 6"]
    residual: Float64[np.ndarray, " n"]  # m, or rad
    deviation: Float64[np.ndarray, " n"]  # its standard deviation, larger where rows err alike
    limit: Float64[np.ndarray, " n"]  # residual beyond which a row does not count

    @property
    def system_rows(self) -> tuple[Float64[np.ndarray, "n 12"], Int64[np.ndarray, "12"]]:
        """Rows of both sensors, and their columns in the system."""
        where = np.concatenate([6 * self.one + np.arange(6), 6 * self.other + np.arange(6)])
        return np.concatenate([self.one_row, self.other_row], axis=1), where

    @cached_property
    def weight(self) -> Float64[np.ndarray, " n"]:
        """Tukey's weight over the variance."""
        return registration.tukey_weight(self.residual / self.limit, 1.0) / self.deviation**2


MorePairs = Callable[[Poses, float], Sequence[Pairs]]  # further pairs for poses and a search radius (m)


@dataclass(frozen=True, eq=False)
class Alignment:
    """Poses that fit each other.

    covariance: of the motions of all sensors, six numbers each (rad and m), that of the usual errors where nothing is
    observed; unobserved: unit motions of all sensors, turns times `LEVER`, other than the common ones; shared: number
    of rows that each two sensors share; scatter: robust standard deviation (m) of each sensor's rows.
    """

    poses: tuple[Pose, ...]
    covariance: Float64[np.ndarray, "m m"]
    unobserved: Float64[np.ndarray, "k m"]
    shared: Int64[np.ndarray, "n n"]
    scatter: Float64[np.ndarray, " n"]

    def hidden_motions(self, sensor: int) -> Float64[np.ndarray, "_ 6"]:
        """Unit motions of one sensor that nothing determines."""
        own = self.unobserved[:, 6 * sensor : 6 * sensor + 6]
        _, size, motions = np.linalg.svd(own, full_matrices=False)
        return motions[size > 0.3]


def align(
    surfaces: Sequence[Surface], believed: Poses, *, held: Sequence[int] = (), more: MorePairs | None = None
) -> Alignment:
    """Fit sensor poses, near the believed ones, to each other by their surfaces.

    surfaces: each sensor's empty scene in its own frame, normals towards the sensor; held: numbers of sensors that
    stay; more: returns further pairs for poses and a search radius. Raises ValueError for fewer than two sensors, and
    for an unknown held one.
    """
    count = len(surfaces)
    if count != len(believed) or count < 2:
        got = f"got {count} surfaces and {len(believed)} poses"
        raise ValueError(f"alignment needs two or more sensors, each with a surface and a pose: {got}")
    if any(not 0 <= sensor < count for sensor in held):
        raise ValueError(f"held must be sensor numbers from 0 to {count - 1}, got {list(held)}")
    free = np.repeat([sensor not in held for sensor in range(count)], 6)
    poses = [np.array(pose, np.float64) for pose in believed]
    for radius, voxel, least in _LEVELS:
        thinned = [registration.thin_rows(surface.points, voxel) for surface in surfaces]
        for _ in range(_STEPS):
            pairs = _surface_pairs(surfaces, thinned, poses, (radius, least))
            pairs += list(more(poses, radius)) if more is not None else []
            off = [registration.motion_between(*each) for each in zip(believed, poses, strict=True)]
            system = _Joint(pairs, free, np.concatenate(off))
            step = system.step()
            poses = list(map(registration.apply_motion, poses, step.reshape(-1, 6)))
            if np.abs(step).max() < _CONVERGED * radius:
                break
    middle = np.mean([pose[:3, 3] for pose in poses], axis=0)
    motions = np.zeros((6, count, 6))  # of all sensors together, as if they hung on one frame
    for axis, direction in enumerate(np.eye(3)):
        for sensor, pose in enumerate(poses):
            motions[axis, sensor] = [*(direction * LEVER), *np.cross(direction, pose[:3, 3] - middle)]
            motions[3 + axis, sensor, 3:] = direction
    hidden = system.hidden_motions(np.linalg.qr(motions.reshape(6, -1).T)[0].T)
    shared, rows = np.zeros((count, count), np.int64), [[np.empty(0)] for _ in poses]
    for pair in pairs:
        counts = pair.weight > 0
        shared[pair.one, pair.other] += int(counts.sum())
        for sensor in (pair.one, pair.other):
            rows[sensor].append(np.abs(pair.residual[counts]))
    every = [np.concatenate(own) for own in rows]
    scatter = np.array([1.4826 * float(np.median(own)) if len(own) else 0.0 for own in every])
    return Alignment(tuple(poses), system.covariance(), hidden, shared + shared.T, scatter)


def face_sensor(surface: Surface) -> Surface:
    """Turn a surface's normals towards its sensor, the origin."""
    away = (surface.points * surface.normals).sum(axis=1) > 0
    return Surface(surface.points, np.where(away[:, None], -surface.normals, surface.normals), surface.roughness)


@dataclass(frozen=True, eq=False)
class _Joint:
    """Linear system of one step."""

    pairs: Sequence[Pairs]
    free: Bool[np.ndarray, " m"]  # which of the 6 n numbers may change
    off: Float64[np.ndarray, " m"]  # difference of each from its believed value

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Eigenvalues and eigenvectors (columns), and mask of observed ones."""
        information = np.zeros((len(self.free), len(self.free)))
        for pair in self.pairs:
            rows, where = pair.system_rows
            information[np.ix_(where, where)] += rows.T @ (rows * pair.weight[:, None])
        information[~self.free], information[:, ~self.free] = 0.0, 0.0
        values, vectors = np.linalg.eigh(information)
        largest = np.linalg.norm(vectors.reshape(-1, 6, len(values)), axis=1).max(axis=0)
        resists = np.zeros(len(values))
        for pair in self.pairs:
            rows, where = pair.system_rows
            along = (rows[pair.weight > 0] @ (vectors[where] / largest)) ** 2
            resists += np.where(along > _RESISTS**2, along, 0.0).sum(axis=0)
        return values, vectors, (resists > _LEAST_POINTS) & (values > 0)

    @cached_property
    def _posterior(self) -> Float64[np.ndarray, "m m"]:
        """Information of the observed motions and of the usual errors."""
        values, vectors, observed = self._modes
        return (vectors * np.where(observed, values, 0.0)) @ vectors.T + np.diag(self._usual)

    @property
    def _usual(self) -> Float64[np.ndarray, " m"]:
        return np.tile(np.repeat([(LEVER * USUAL_TURN) ** -2, USUAL_MOVE**-2], 3), len(self.free) // 6)

    def step(self) -> Float64[np.ndarray, " m"]:
        """Motion of all sensors that brings the pairs together, and moves back what they do not determine."""
        _, vectors, observed = self._modes
        gradient = np.zeros(len(self.free))
        for pair in self.pairs:
            rows, where = pair.system_rows
            gradient[where] += rows.T @ (pair.weight * pair.residual)
        determined = vectors @ np.where(observed, vectors.T @ np.where(self.free, gradient, 0.0), 0.0)
        motion = np.zeros(len(self.free))
        free = np.ix_(self.free, self.free)
        motion[self.free] = -np.linalg.solve(self._posterior[free], (determined + self._usual * self.off)[self.free])
        return motion

    def covariance(self) -> Float64[np.ndarray, "m m"]:
        """Covariance in rad and m, zero for held sensors."""
        covariance = np.zeros((len(self.free),) * 2)
        free = np.ix_(self.free, self.free)
        covariance[free] = np.linalg.inv(self._posterior[free])
        unit = np.tile(np.repeat([1 / LEVER, 1.0], 3), len(self.free) // 6)
        return unit[:, None] * covariance * unit

    def hidden_motions(self, common: Float64[np.ndarray, "6 m"]) -> Float64[np.ndarray, "k m"]:
        """Orthonormal motions that hardly any pair resists, without the common ones if no sensor is held."""
        _, vectors, observed = self._modes
        hidden = np.where(self.free[:, None], vectors[:, ~observed], 0.0).T
        if self.free.all():
            hidden = hidden - hidden @ common.T @ common
        _, size, motions = np.linalg.svd(hidden, full_matrices=False)
        return motions[size > 0.5]


def _surface_pairs(
    surfaces: Sequence[Surface], thinned: Sequence[np.ndarray], poses: Poses, limits: tuple[float, float]
) -> list[Pairs]:
    """Pair each thinned point with other sensors' nearest points, if they face the same way."""
    (radius, least), made = limits, []
    for one, (surface, some) in enumerate(zip(surfaces, thinned, strict=True)):
        world = transform(poses[one], surface.points[some])
        facing = surface.normals[some] @ poses[one][:3, :3].T
        for other, seen in enumerate(surfaces):
            if other == one:
                continue
            apart, row = seen.tree.query(transform(invert(poses[other]), world), distance_upper_bound=radius)
            near = np.flatnonzero(np.isfinite(apart))
            normals = seen.normals[row[near]] @ poses[other][:3, :3].T
            alike = (facing[near] * normals).sum(axis=1) > _SAME_SIDE
            near, normals = near[alike], normals[alike]
            there = transform(poses[other], seen.points[row[near]])
            rough = np.hypot(surface.roughness[some[near]], seen.roughness[row[near]])
            deviation, residual = np.hypot(rough, _LEAST_SCALE), ((world[near] - there) * normals).sum(axis=1)
            mine, theirs = (resistance(world[near], poses[sensor][:3, 3], normals) for sensor in (one, other))
            spread, limit = deviation * np.sqrt(_CORRELATED), np.maximum(_TUKEY * deviation, least)
            made.append(Pairs(one, other, mine, -theirs, residual, spread, limit))
    return made


PAIR_GATE = 1.5  # m: greatest distance between the centres that two sensors give one road user
_LEAST_GATE = 0.8  # m
_CENTRE = 0.25  # m, standard deviation of a centre along each axis
_HEADING = float(np.deg2rad(4.0))  # standard deviation of a heading
_WORST_HEADING = float(np.deg2rad(20.0))  # greatest difference of the headings of one road user, up to a half turn
_NO_MATCH = (np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True, eq=False)
class SeenBoxes:
    """Objects of one sensor and frame, in its axes."""

    centres: Float64[np.ndarray, "n 3"]
    ahead: Float64[np.ndarray, "n 3"]

    @classmethod
    def of(cls, boxes: BoxRows, believed: Pose) -> SeenBoxes:
        """Return boxes of the world in the sensor's axes."""
        ahead = np.column_stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6]), np.zeros(len(boxes))])
        return cls(transform(invert(believed), boxes[:, :3]), ahead @ believed[:3, :3])


def seen_objects(frames: Sequence[Frame], detector: Detector, site: Site) -> list[list[SeenBoxes]]:
    """Detect objects in each sensor's cloud alone, per frame."""
    seen: list[list[SeenBoxes]] = []
    for frame in frames:
        clouds = zip(frame_points(frame, area=site), frame.sensors, strict=True)
        found = ((detect_on_ground(detector, cloud, site).boxes, sensor.pose) for cloud, sensor in clouds)
        seen.append([SeenBoxes.of(*each) for each in found])
    return seen


def object_pairs(seen: Sequence[Sequence[SeenBoxes]], poses: Poses, radius: float) -> list[Pairs]:
    """Rows of all road users that two sensors at `poses` see: three for the centre, one for the heading."""
    gate, made = float(np.clip(radius, _LEAST_GATE, PAIR_GATE)), []
    for one, other in combinations(range(len(poses)), 2):
        matches = [_match_boxes(frame[one], frame[other], poses[one], poses[other], gate) for frame in seen]
        here, there, turn = (np.concatenate(parts) for parts in zip(_NO_MATCH, *matches, strict=True))
        if count := len(here):
            axes = np.repeat(np.eye(3), count, axis=0)
            about_z = np.tile([0.0, 0.0, 1 / LEVER, 0.0, 0.0, 0.0], (count, 1))
            places = ((np.tile(here, (3, 1)), poses[one][:3, 3]), (np.tile(there, (3, 1)), poses[other][:3, 3]))
            mine, theirs = (np.concatenate([resistance(*place, axes), about_z]) for place in places)
            residual = np.concatenate([(here - there).T.ravel(), turn])
            deviation = np.repeat([np.sqrt(2) * _CENTRE, np.sqrt(2) * _HEADING], [3 * count, count])
            limit = np.repeat([gate, _WORST_HEADING], [3 * count, count])
            made.append(Pairs(one, other, mine, -theirs, residual, deviation, limit))
    return made


def _match_boxes(
    mine: SeenBoxes, theirs: SeenBoxes, pose: Pose, other_pose: Pose, gate: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres matched by two sensors, and the first one's headings less the other's (rad)."""
    here, there = transform(pose, mine.centres), transform(other_pose, theirs.centres)
    if not (len(here) and len(there)):
        return _NO_MATCH
    apart = np.hypot(*(here[:, None, :2] - there[None, :, :2]).transpose(2, 0, 1))
    nearest = apart.argmin(axis=1)
    row = np.arange(len(here))
    mutual = (apart[:, nearest].argmin(axis=0) == row) & (apart[row, nearest] < gate)
    ways = (boxes.ahead @ at[:3, :3].T for boxes, at in ((mine, pose), (theirs, other_pose)))
    heading, other_heading = (np.arctan2(way[:, 1], way[:, 0]) for way in ways)
    turn = (heading - other_heading[nearest] + np.pi / 2) % np.pi - np.pi / 2
    some = mutual & (np.abs(turn) < _WORST_HEADING)
    return here[some], there[nearest[some]], turn[some]
