"""`coview/SensorPose-v0`: turn, tilt, raise and lower the chosen sensors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from gymnasium.spaces import Box

from placement_env.candidates.candidates import Candidates, aim_sensor
from placement_env.envs.config import PoseConfig
from placement_env.envs.env import Ends, PlacementEnv, PlacementVectorEnv, Task
from placement_env.envs.scenario import Episode, EpisodeSource, Options, Scenario, keep_few, poses
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.subsets import find_index
from toolkit.arrays import Bool, Float64, Int64, Mask, Rng, Shaped

UNIT_MOVE = np.array([0.5, np.deg2rad(15.0), np.deg2rad(5.0)])  # height (m), heading, tilt (rad)
TILT_LIMITS_RAD = (np.deg2rad(-10.0), np.deg2rad(60.0))  # below the horizon


@dataclass(frozen=True, eq=False)
class PoseRig:
    """Sensors on their mounts.

    Attributes:
        candidates: The sensors, in the poses of the start.
        aim: Present height above the mount's foot (m), heading from +x and tilt below the horizon
            (rad) of each sensor.
    """

    candidates: Candidates
    aim: Float64[np.ndarray, "sensors 3"]

    @staticmethod
    def from_candidates(candidates: Candidates) -> "PoseRig":
        """Rig of sensors in the poses of the candidates."""
        sensor_poses = poses(candidates)
        z = sensor_poses.position[:, 2]
        height = z - _feet_z(candidates)
        aim = np.stack([height, sensor_poses.heading, sensor_poses.tilt], axis=1)
        return PoseRig(candidates, aim)

    def move(self, action: Float64[np.ndarray, "sensors 3"]) -> "PoseRig":
        """Rig after an action, within the mounts' heights and `TILT_LIMITS_RAD`.

        A sensor that was beyond a limit may stay beyond it.

        action: change of height, heading and tilt of each sensor in units of `UNIT_MOVE`, clipped
        to -1..1."""
        mounts = [self.candidates.mounts[index] for index in self.candidates.mount]
        present_height = self.aim[:, 0]
        present_tilt = self.aim[:, 2]
        height, heading, tilt = (self.aim + np.clip(action, -1, 1) * UNIT_MOVE).T
        min_height = np.minimum([mount.min_height for mount in mounts], present_height)
        max_height = np.maximum([mount.max_height for mount in mounts], present_height)
        lowest_tilt, highest_tilt = TILT_LIMITS_RAD
        min_tilt = np.minimum(lowest_tilt, present_tilt)
        max_tilt = np.maximum(highest_tilt, present_tilt)
        aim = [
            np.clip(height, min_height, max_height),
            np.arctan2(np.sin(heading), np.cos(heading)),  # in -π..π
            np.clip(tilt, min_tilt, max_tilt),
        ]
        return PoseRig(self.candidates, np.stack(aim, axis=1))

    def to_candidates(self) -> Candidates:
        """Sensors in their present poses."""
        start = self.candidates
        # above the mount's foot (m)
        height = self.aim[:, 0]
        sensor_z = _feet_z(start) + height
        sensors = []
        for row, sensor in enumerate(start.sensors):
            x, y = sensor.position[:2]
            position = np.array([x, y, sensor_z[row]])
            heading, tilt = self.aim[row, 1:].tolist()  # rad
            sensors.append(aim_sensor(sensor, position, heading, tilt))
        return Candidates.from_poses(sensors, start.mount, self.aim, start)


@dataclass(frozen=True, eq=False, kw_only=True)
class _PoseEpisode(Episode):
    """Episode of sensors that move at a site."""

    preparation: Preparation
    rig: PoseRig


class _PoseScenarios(EpisodeSource):
    """Sites and sensors of the episodes.

    Raises ValueError if a site has too few mounts or no surrogate.
    """

    def __init__(self, config: PoseConfig) -> None:
        """Prepare the sites of a configuration.

        Raises ValueError if a site has too few mounts for the budget, or no surrogate."""
        super().__init__(config)
        _, self.slots = config.budgets  # the largest budget
        self.moves = config.moves
        _, max_failures = config.failure_counts
        for index in range(len(self.sites)):
            mount_count = len(np.unique(self.candidates(index).mount))
            # a mount for each sensor, and one more for each failure
            if mount_count < self.slots + max_failures:
                raise ValueError(
                    f"{self.sites[index].name} has {mount_count} mounts with candidates, too few "
                    f"for a budget of {self.slots} and {max_failures} failures: lower them"
                )
        self.check_scorable()
        self._preparations: dict[tuple[int, str, int], Preparation] = {}  # by `Conditions.key`

    def draw(self, rng: Rng, options: Options | None) -> _PoseEpisode:
        """Draw sensors that have not failed, on different mounts. Raises ValueError if there are
        too few."""
        conditions = self.draw_conditions(rng, options)
        budget = conditions.budget
        if budget > self.slots:
            raise ValueError(
                f"budget must lie in 1..{self.slots}, the sensors that an action moves, got "
                f"{budget}"
            )
        if conditions.key not in self._preparations:
            setting = self.setting(conditions.site, conditions.scheme)
            run = self.config.run.part(conditions.traffic)
            new_preparation = Preparation(setting, replace(run, workers=1, ray=None))
            keep_few(self._preparations, conditions.key, new_preparation)
        preparation = self._preparations[conditions.key]
        candidates = preparation.setting.pool
        names = [sensor.name for sensor in candidates.sensors]
        failed = {find_index(member, names) for member in conditions.failed}
        # indices of the candidates that have not failed
        usable = np.array([c for c in range(len(candidates)) if c not in failed], np.int64)
        mounts = np.unique(candidates.mount[usable])
        if len(mounts) < budget:
            raise ValueError(
                f"{len(mounts)} mounts have a sensor that works, too few for a budget of {budget}"
            )
        drawn_mounts = np.sort(rng.choice(mounts, budget, replace=False))
        mount_of = candidates.mount[usable]
        members = [int(rng.choice(usable[mount_of == mount])) for mount in drawn_mounts]
        rig = PoseRig.from_candidates(candidates.select(members))
        slots = np.arange(self.slots)
        scenario = self.scenario(preparation, rig, previous=None)
        return _PoseEpisode(
            scenario=scenario,
            budget=budget,
            failed=np.zeros(self.slots, np.bool_),
            chosen=slots < budget,
            preparation=preparation,
            rig=rig,
        )

    def scenario(
        self,
        preparation: Preparation,
        rig: PoseRig,
        previous: tuple[PoseRig, Visibility | None] | None,
    ) -> Scenario:
        """Scenario with the sensors of a rig in their present poses.

        Args:
            preparation: Traffic at the site.
            rig: Sensors and their poses.
            previous: Rig before its sensors moved, and its visibility, from which rows of unmoved
                sensors are copied; None if no sensor has been seen yet.
        """
        candidates = rig.to_candidates()
        is_still = np.zeros(len(candidates), np.bool_)
        old_visibility = None
        if previous is not None:
            old_rig, old_visibility = previous
            is_still = (rig.aim == old_rig.aim).all(axis=1)
        visibility = _update_visibility(preparation, candidates, old_visibility, is_still)
        weights = self.config.setting.weights
        objective = Objective.from_view(preparation, candidates, visibility, weights)
        return Scenario(objective, self.slots)


class _PoseTask(Task):
    """n episodes of moving sensors. Each has a separate objective, replaced after each move."""

    config_type = PoseConfig
    scenarios_type = _PoseScenarios

    def __init__(self, n: int, scenarios: _PoseScenarios) -> None:
        super().__init__(n, scenarios, max_steps=scenarios.moves, fixed=True)
        self.action_space = Box(-1.0, 1.0, (3 * scenarios.slots,), np.float32)
        self._source = scenarios
        self.episodes = dict[int, _PoseEpisode]()  # by row, with the present poses

    def reset(
        self, rows: Int64[np.ndarray, " m"], rngs: Sequence[Rng], options: Options | None
    ) -> None:
        """Start new episodes in some rows, one from each generator."""
        episodes = [self._source.draw(rng, options) for rng in rngs]
        self.state.reset(rows, episodes)
        self.episodes.update(zip(rows.tolist(), episodes, strict=True))

    def step(self, active: Mask, actions: Shaped[np.ndarray, "n ..."]) -> Ends:
        """Move the sensors of each active row; return rewards, terminated and truncated by row.

        A move that overloads a link more than before is illegal and changes nothing. Episodes never
        terminate; they are truncated after their last step.

        actions: a row for each episode, with three numbers for each sensor."""
        state = self.state
        # axes: episode, sensor, and change of height, heading and tilt
        moves = np.asarray(actions, np.float64).reshape(len(actions), -1, 3)
        is_illegal = np.zeros(state.n, np.bool_)
        scenarios = dict[int, Scenario]()
        for row in np.flatnonzero(active).tolist():
            episode = self.episodes[row]
            objective, _ = state.placement(row)
            rig = episode.rig.move(moves[row, : len(episode.rig.aim)])
            if (rig.aim == episode.rig.aim).all():
                continue
            # rig and view before the move: sensors that stay need no new view
            scenario = self._source.scenario(
                episode.preparation, rig, (episode.rig, objective.visibility)
            )
            moved_objective = scenario.objective
            sends_more = moved_objective.loads > objective.loads  # a flag for each sensor
            is_illegal[row] = (~moved_objective.linked & sends_more).any()
            if not is_illegal[row]:
                self.episodes[row] = replace(episode, rig=rig)
                scenarios[row] = scenario
        state.step(active, illegal=is_illegal, scenarios=scenarios)
        terminated = np.zeros(state.n, np.bool_)
        return state.gain, terminated, active & (state.steps >= state.max_steps)

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Mask of entries that move a sensor: three for each slot with one."""
        return np.repeat(self.state.chosen, 3, axis=1)


def _update_visibility(
    preparation: Preparation,
    candidates: Candidates,
    visibility: Visibility | None,
    is_still: Bool[np.ndarray, " candidates"],
) -> Visibility:
    """Visibility of the traffic from candidates; rows of unmoved candidates are copied.

    Args:
        preparation: Traffic and, if it makes them, panoramas of the mounts.
        candidates: Sensors in their present poses.
        visibility: Visibility before the move, copied for candidates that have not moved; None if
            it is unknown.
        is_still: True for candidates that have not moved; all False without `visibility`.
    """
    moved_rows = np.flatnonzero(~is_still)
    all_moved = len(moved_rows) == len(is_still)
    moved_candidates = candidates if all_moved else candidates.select(moved_rows)
    live = preparation.live
    labels = preparation.setting.counted.labels
    if live is None:
        moved_view = see(preparation.traffic, moved_candidates, labels=labels)
    else:
        moved_view = live.see(moved_candidates)
    if visibility is None or all_moved:
        return moved_view
    # fields with a row for each candidate
    fields = {
        name: getattr(visibility, name).copy() for name in ("points", "distance", "sent", "far")
    }
    for name, rows in fields.items():
        rows[moved_rows] = getattr(moved_view, name)
    return replace(visibility, **fields)


class SensorPoseEnv(PlacementEnv):
    """Turn, tilt, raise and lower mounted sensors at a junction.

    ## Action Space
    `Box(-1, 1, (3 · budget,), float32)`: movement of each sensor: height above the foot of its
    mount (1 is 0.5 m), heading (15°, counter-clockwise) and tilt (5°, downwards). Sensors keep
    their mount; heights stay in the mount's range, tilts in −10°..60° below the horizon. If the
    option `budget` is smaller, the entries of absent sensors do nothing.

    An illegal action, one that overloads a link more than before, changes nothing: the reward is 0,
    `info["illegal"]` is True, and a move is used up. `action_masks()` marks the entries that move a
    sensor.

    ## Observation Space
    `Box(-1, 1, (14 · budget + 13,), float32)`, as in `coview/SensorSelect-v0`, a slot for each
    sensor.

    ## Rewards
    Increase of the objective's reward, AP − λ_comm · kbit per sensor − λ_price · price.

    ## Starting State
    Sensors drawn from the candidates that have not failed, at most one from each mount. Everything
    that the config leaves open (site, scheme, budget, failed candidates) is drawn first.

    ## Episode End
    Never terminates; truncated after `moves` moves.

    ## Info
    As in `coview/SensorSelect-v0`.

    ## Arguments
    config: a `placement_env.envs.config.PoseConfig`; or its fields by name, the same as in
    `coview/SensorSelect-v0` except `actions`, `slots` and `objective`, with moves: of an episode.
    fidelity: surrogate, coverage or detector; rendering: "auto" looks up the view of a moved sensor
    in panoramas from its mount, rendered when a sensor first uses it, and is some fifty times
    faster than "full", which casts every ray; "auto" casts rays too if the range of a candidate
    ends within the site; cache: folder that keeps panoramas. `reset` takes the options site,
    scheme, budget (up to the environment's) and failed."""

    task_type = _PoseTask


class SensorPoseVectorEnv(PlacementVectorEnv):
    """n of `SensorPoseEnv`, which describes the arguments."""

    task_type = _PoseTask


def _feet_z(candidates: Candidates) -> Float64[np.ndarray, " candidates"]:
    """Height of the foot of each candidate's mount (m, site frame)."""
    return np.array([candidates.mounts[index].position[2] for index in candidates.mount])
