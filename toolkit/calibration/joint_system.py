"""Linear system of one step of a joint alignment: six numbers for each sensor.

A motion of n sensors is m = 6 n numbers, sensor by sensor: three turns (rad) times `LEVER_M`, three
moves (m), see `toolkit.calibration.motions`. A pair of points or objects pulls two sensors together
along a direction (see `toolkit.calibration.registration`). The
common pose of all sensors is not observed, so steps are the smallest possible ones. Motions of a
sensor that shares too little with the others are not observed either. The usual errors of mounting,
`USUAL_TURN_RAD` and `USUAL_MOVE_M`, are weighed against what few pairs show."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from toolkit.arrays import Bool, Float64, Int64, Pose
from toolkit.calibration import registration
from toolkit.calibration.motions import LEVER_M, MotionModes

# least part of a unit motion across a pair's plane that resists it: less is the noise of normals
_MIN_RESISTANCE = 0.1
_MIN_RESISTING_POINTS = 5.0  # number of points that must resist a motion for it to be observed
# standard deviations of the believed poses, per axis
USUAL_TURN_RAD = float(np.deg2rad(1.5))
USUAL_MOVE_M = 0.15
Poses = Sequence[Pose]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Rows of the linear system, each pulling two sensors together along a direction.

    Attributes:
        first_sensor: its number.
        second_sensor: its number.
        first_rows: growth of each residual per unit of the six numbers of the first one's motion.
        second_rows: the same for the motion of the second one.
        residual: distance from the second to the first along the direction (m), or their turn
            (rad).
        deviation: standard deviation of the residual, larger if rows err alike.
        limit: absolute residual from which a row has no weight.
    """

    first_sensor: int
    second_sensor: int
    first_rows: Float64[np.ndarray, "n 6"]
    second_rows: Float64[np.ndarray, "n 6"]
    residual: Float64[np.ndarray, " n"]
    deviation: Float64[np.ndarray, " n"]
    limit: Float64[np.ndarray, " n"]

    @property
    def system_rows(self) -> tuple[Float64[np.ndarray, "n 12"], Int64[np.ndarray, "12"]]:
        """Rows (n, 12) of both sensors, and the numbers of the motion that the columns are for."""
        columns = np.concatenate(
            [6 * self.first_sensor + np.arange(6), 6 * self.second_sensor + np.arange(6)]
        )
        return np.concatenate([self.first_rows, self.second_rows], axis=1), columns

    @cached_property
    def weight(self) -> Float64[np.ndarray, " n"]:
        """Weight of each row: Tukey's, 1 to 0 at the limit, over the variance."""
        return registration.tukey_weight(self.residual / self.limit, 1.0) / self.deviation**2


@dataclass(frozen=True, eq=False)
class JointSystem:
    """Linear system of one Gauss-Newton step for the poses of n sensors.

    Attributes:
        pairs: rows of the system.
        free: mask of the m = 6 n numbers that may change; held sensors have False.
        off: motion of each sensor from its believed pose so far, (m,), turns times `LEVER_M`."""

    pairs: Sequence[Pairs]
    free: Bool[np.ndarray, " m"]
    off: Float64[np.ndarray, " m"]

    @cached_property
    def modes(self) -> MotionModes:
        """Independent motions of all sensors together, with the information about each.

        A mode is observed if enough pairs resist it: it counts as a motion in which the sensor
        that moves most has a unit motion. Information about held sensors is 0."""
        information = np.zeros((len(self.free), len(self.free)))
        for pair in self.pairs:
            # (pairs, 12) growth of each residual per unit of motion, and the 12 numbers of both
            # sensors among the 6 n numbers of all motions
            rows, columns = pair.system_rows
            information[np.ix_(columns, columns)] += rows.T @ (rows * pair.weight[:, None])
        # numbers of held sensors do not change
        information[~self.free] = 0.0
        information[:, ~self.free] = 0.0
        values, vectors = np.linalg.eigh(information)
        # size of each mode in the sensor that moves most
        largest_size = np.linalg.norm(vectors.reshape(-1, 6, len(values)), axis=1).max(axis=0)
        resistance_sum = np.zeros(len(values))
        for pair in self.pairs:
            rows, columns = pair.system_rows
            # (pairs, modes): squared growth of each residual along each mode
            squared_growth = (rows[pair.weight > 0] @ (vectors[columns] / largest_size)) ** 2
            resisting = np.where(squared_growth > _MIN_RESISTANCE**2, squared_growth, 0.0)
            resistance_sum += resisting.sum(axis=0)
        observed = (resistance_sum > _MIN_RESISTING_POINTS) & (values > 0)
        return MotionModes(values, vectors, observed=observed)

    @cached_property
    def _posterior(self) -> Float64[np.ndarray, "m m"]:
        """Information (m, m) of the observed motions plus the usual errors of believed poses."""
        vectors = self.modes.vectors
        values = np.where(self.modes.observed, self.modes.values, 0.0)
        return (vectors * values) @ vectors.T + np.diag(self._mounting_information)

    @property
    def _mounting_information(self) -> Float64[np.ndarray, " m"]:
        """Inverse variance of the usual mounting error, for each of the 6 n numbers."""
        # three turns, then three moves, of each sensor
        sensor_information = np.repeat([(LEVER_M * USUAL_TURN_RAD) ** -2, USUAL_MOVE_M**-2], 3)
        return np.tile(sensor_information, len(self.free) // 6)

    def step(self) -> Float64[np.ndarray, " m"]:
        """Motion (m,) of all sensors that brings the pairs together, turns times `LEVER_M`.

        Numbers that the pairs do not determine move back to their believed values, from which they
        are `off` so far; numbers of held sensors are 0."""
        vectors = self.modes.vectors
        gradient = np.zeros(len(self.free))
        for pair in self.pairs:
            rows, columns = pair.system_rows
            gradient[columns] += rows.T @ (pair.weight * pair.residual)
        along_modes = vectors.T @ np.where(self.free, gradient, 0.0)
        observed_gradient = vectors @ np.where(self.modes.observed, along_modes, 0.0)
        # pull of the pairs, and of the believed poses
        total_gradient = observed_gradient + self._mounting_information * self.off
        motion = np.zeros(len(self.free))
        free_block = np.ix_(self.free, self.free)  # rows and columns of the free numbers
        motion[self.free] = -np.linalg.solve(self._posterior[free_block], total_gradient[self.free])
        return motion

    def covariance(self) -> Float64[np.ndarray, "m m"]:
        """Covariance (m, m) of all sensors' motions in rad and m, zero for held sensors."""
        covariance = np.zeros((len(self.free), len(self.free)))
        free_block = np.ix_(self.free, self.free)  # rows and columns of the free numbers
        covariance[free_block] = np.linalg.inv(self._posterior[free_block])
        # from turns times LEVER_M to rad
        unit = np.tile(np.repeat([1 / LEVER_M, 1.0], 3), len(self.free) // 6)
        return unit[:, None] * covariance * unit

    def hidden_motions(self, common: Float64[np.ndarray, "6 m"]) -> Float64[np.ndarray, "k m"]:
        """Orthonormal motions (k, m) that hardly any pair resists, turns times `LEVER_M`.

        common: orthonormal motions of all sensors together. They are left out if no sensor is held,
        since nothing can determine them."""
        unobserved_vectors = self.modes.vectors[:, ~self.modes.observed]
        # 0 for held sensors
        hidden_vectors = np.where(self.free[:, None], unobserved_vectors, 0.0).T
        if self.free.all():
            # without the part along the common motions
            hidden_vectors = hidden_vectors - hidden_vectors @ common.T @ common
        _, size, motions = np.linalg.svd(hidden_vectors, full_matrices=False)
        # smaller ones are what rounding, held sensors or the common motions left over
        return motions[size > 0.5]
