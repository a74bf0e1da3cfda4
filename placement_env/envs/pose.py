"""`coview/SensorPose-v0`: turn, tilt, raise and lower the chosen sensors; what has moved is rendered again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space

from placement_env.candidates.aim import aimed
from placement_env.candidates.candidates import Axes, Candidates
from placement_env.envs.env import GameEnv, observation_space
from placement_env.envs.scenario import Scene, Sites, check_budget, checked, poses
from placement_env.envs.state import Boards
from placement_env.fidelity.preparation import Preparation, site_candidates
from placement_env.fidelity.visibility import Visibility, see
from placement_env.objective import AP_ONLY, FidelityName, Objective, Weights, check_fidelity, index_of
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import scheme_of
from toolkit.objects import Detector
from toolkit.sites.site import Site

MOVES = np.array([0.5, np.deg2rad(15.0), np.deg2rad(5.0)])  # m up, rad of heading and of tilt, for an action of 1
TILTS = (np.deg2rad(-10.0), np.deg2rad(60.0))  # lowest and highest, rad below the horizon


@dataclass(frozen=True, eq=False)
class Rig:
    """Sensors on their mounts. candidates: they as they were chosen; state: (B, 3) height above the mount's foot (m),
    heading and tilt (rad) of each now."""

    candidates: Candidates
    state: Float64[np.ndarray, "B 3"]

    @staticmethod
    def of(candidates: Candidates) -> Rig:
        """Sensors where they are."""
        position, heading, tilt, _, _ = poses(candidates)
        return Rig(candidates, np.stack([position[:, 2] - _feet(candidates), heading, tilt], axis=1))

    def moved(self, action: Float64[np.ndarray, "B 3"]) -> Rig:
        """After an action: within the mounts' heights, and `TILTS`; a sensor that was beyond them may stay there."""
        mounts = [self.candidates.mounts[index] for index in self.candidates.mount]
        height, heading, tilt = (self.state + np.clip(action, -1, 1) * MOVES).T
        low = np.minimum([mount.min_height for mount in mounts], self.state[:, 0])
        high = np.maximum([mount.max_height for mount in mounts], self.state[:, 0])
        turned = np.arctan2(np.sin(heading), np.cos(heading))
        tilts = np.minimum(TILTS[0], self.state[:, 2]), np.maximum(TILTS[1], self.state[:, 2])
        return Rig(self.candidates, np.stack([np.clip(height, low, high), turned, np.clip(tilt, *tilts)], axis=1))

    def placed(self) -> Candidates:
        """The sensors where they are now."""
        height, heading, tilt = self.state.T
        count = np.arange(len(self.state))
        models = tuple(dict.fromkeys(sensor.model for sensor in self.candidates.sensors))
        model = np.array([models.index(sensor.model) for sensor in self.candidates.sensors])
        mount = self.candidates.mount
        factors = np.stack([mount, count, count, count, model], axis=1)
        feet = _feet(self.candidates)
        sensors = tuple(
            aimed(s, np.array([*s.position[:2], foot + h]), float(y), float(t))
            for s, foot, h, y, t in zip(self.candidates.sensors, feet, height, heading, tilt, strict=True)
        )
        return Candidates(sensors, mount, self.candidates.mounts, factors, Axes(height, heading, tilt, models))


@dataclass(frozen=True, eq=False)
class PoseStart:
    """How an episode starts: with which sensors, at what site and traffic."""

    preparation: Preparation
    rig: Rig


class PoseScenes:
    """Where the sensors of an episode come from. arguments: further ones of `placement_env.objective.Objective`."""

    def __init__(
        self, site: Any, budget: int, scheme: Scheme | str, fidelity: FidelityName, arguments: Mapping[str, Any]
    ) -> None:
        if fidelity == "table":
            raise ValueError("a table knows no poses but the site's own: take fidelity surrogate, coverage or detector")
        self.sites = Sites(site)
        self.budget, self.scheme, self.fidelity = check_budget(budget), scheme_of(scheme), check_fidelity(fidelity)
        signature(_prepared).bind_partial(**arguments)
        self.weights: Weights = arguments.get("weights", AP_ONLY)
        self._arguments = dict(arguments)
        self._made: dict[tuple[int, Scheme], Preparation] = {}

    def start(self, rng: np.random.Generator, options: Mapping[str, Any] | None) -> PoseStart:
        """Sensors drawn among those in order, on mounts of their own. Raises ValueError where there are too few."""
        options = checked(options)
        budget = options.get("budget", self.budget)
        if budget > self.budget:
            raise ValueError(f"budget must lie in 1..{self.budget}, the sensors that an action moves, got {budget}")
        preparation = self._preparation(options, rng)
        candidates = preparation.candidates
        names = [sensor.name for sensor in candidates.sensors]
        failed = {index_of(member, names) for member in options.get("failed", ())}
        usable = np.array([c for c in range(len(candidates)) if c not in failed], np.int64)
        mounts = np.unique(candidates.mount[usable])
        if len(mounts) < budget:
            raise ValueError(f"there are {len(mounts)} mounts with sensors in order, too few for a budget of {budget}")
        chosen = [
            int(rng.choice(usable[candidates.mount[usable] == mount]))
            for mount in np.sort(rng.choice(mounts, budget, replace=False))
        ]
        return PoseStart(preparation, Rig.of(candidates.select(chosen)))

    def _preparation(self, options: Mapping[str, Any], rng: np.random.Generator) -> Preparation:
        scheme = scheme_of(options.get("scheme", self.scheme))
        index = self.sites.index(options.get("site"), rng)
        if (index, scheme) not in self._made:
            self._made[index, scheme] = _prepared(self.sites[index], scheme, **self._arguments)
        return self._made[index, scheme]


class PoseGame:
    """n episodes of moving sensors; each has an objective of its own, made anew after each move."""

    def __init__(self, n: int, scenes: PoseScenes, moves: int) -> None:
        if moves < 1:
            raise ValueError(f"moves must be at least 1, got {moves}")
        self.scenes, self.boards = scenes, Boards(n, scenes.budget, moves)
        self.boards.scene = np.arange(n)
        self.action_space: Space[Any] = Box(-1.0, 1.0, (3 * scenes.budget,), np.float32)
        self.observation_space = observation_space(scenes.budget)
        self._starts: dict[int, PoseStart] = {}

    def begin(self, rows: Int64[np.ndarray, " m"], starts: list[PoseStart]) -> None:
        """New episodes on some rows, whose sensors are scored where they are."""
        self._starts |= dict(zip(rows.tolist(), starts, strict=True))
        sizes = np.array([len(start.rig.state) for start in starts])
        self.boards.clear(rows, sizes)
        self.boards.chosen[rows] = np.arange(self.boards.slots) < sizes[:, None]
        for row, objective in self._objectives({row: start.rig for row, start in self._starts.items() if row in rows}):
            self.boards.put(row, Scene(objective, self.boards.slots))
        self.boards.score(rows)

    def play(
        self, playing: Bool[np.ndarray, " n"], actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float64[np.ndarray, " n"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Move the sensors of each row that plays; a move that overloads a link, or more than it was, is undone."""
        boards, steps = self.boards, np.asarray(actions, np.float64).reshape(self.boards.n, -1, 3)
        before, rigs = boards.scores.reward.copy(), dict[int, Rig]()
        for row in np.flatnonzero(playing).tolist():
            rig = self._starts[row].rig
            moved = rig.moved(steps[row, : len(rig.state)])
            if (moved.state != rig.state).any():
                rigs[row] = moved
        boards.turns[playing] += 1
        boards.illegal, boards.repeated = np.zeros(boards.n, np.bool_), playing.copy()
        for row, objective in self._objectives(rigs):
            overloaded = ~objective.linked
            if overloaded.any() and (overloaded & (objective.sent > boards.scenes[row].objective.sent)).any():
                boards.illegal[row] = True
                continue
            self._starts[row] = replace(self._starts[row], rig=rigs[row])
            boards.put(row, Scene(objective, boards.slots))
            boards.score(np.array([row]))
            boards.repeated[row] = False
        boards.gain = np.where(playing, boards.scores.reward - before, 0.0)
        return boards.gain, np.zeros(boards.n, np.bool_), playing & (boards.turns >= boards.most_turns)

    def look(self) -> tuple[Float32[np.ndarray, "n size"], dict[str, Any]]:
        """Observations and info."""
        info = {**self.boards.info(), "action_mask": self.masks().astype(np.int8)}
        return self.boards.observations(np.zeros_like(self.boards.chosen)), info

    def masks(self) -> Bool[np.ndarray, "n choices"]:
        """Which entries of an action move a sensor."""
        return np.repeat(self.boards.chosen, 3, axis=1)

    def _objectives(self, rigs: dict[int, Rig]) -> list[tuple[int, Objective]]:
        """The objective of each rig; what has not moved since the row's last one is not rendered again."""
        made: list[tuple[int, Objective]] = []
        for row, rig in rigs.items():
            preparation, candidates = self._starts[row].preparation, rig.placed()
            old = self.boards.scenes[row] if row < len(self.boards.scenes) else None
            still = np.zeros(len(candidates), np.bool_)
            visibility = None if old is None else old.objective.visibility
            if rig.candidates is self._starts[row].rig.candidates and visibility is not None:
                still = (rig.state == self._starts[row].rig.state).all(axis=1) & (rig is not self._starts[row].rig)
            seen = see_moved(preparation, candidates, visibility, still)
            here = preparation.at(candidates, seen)
            of = Objective.of(
                candidates, here.fidelity(self.scenes.fidelity), here.scheme, self.scenes.weights,
                site=here.site, visibility=seen, codec=here.codec,
            )  # fmt: skip
            made.append((row, of))
        return made


def see_moved(
    preparation: Preparation, candidates: Candidates, visibility: Visibility | None, still: Bool[np.ndarray, " C"]
) -> Visibility:
    """What candidates see of the traffic, of which those that stand `still` saw what `visibility` says."""
    moved = np.flatnonzero(~still)
    fresh = see(preparation.traffic, candidates.select(moved))
    if visibility is None or len(moved) == len(still):
        return fresh
    columns = {name: getattr(visibility, name).copy() for name in ("points", "distance", "sent", "far")}
    for name, column in columns.items():
        column[moved] = getattr(fresh, name)
    return replace(visibility, **columns)


class SensorPoseEnv(GameEnv):
    """Turn, tilt, raise and lower sensors that hang at a junction.

    ## Action Space
    `Box(-1, 1, (3 · budget,), float32)`: for each sensor how far to move: height above the foot of its mount (1 is
    0.5 m), heading (15°, counter-clockwise) and tilt (5°, downwards). Sensors keep their mount; heights stay in the
    mount's range, tilts in −10°..60° below the horizon. Where the option `budget` is smaller, the entries of absent
    sensors do nothing.

    An illegal action, after which a link would have to carry more than it can and than before, changes nothing: the
    reward is 0, `info["illegal"]` is True, and a move is used up. `action_masks()` says which entries move a sensor.

    ## Observation Space
    `Box(-1, 1, (14 · budget + 13,), float32)`, as of `coview/SensorSelect-v0`, a slot for each sensor.

    ## Rewards
    By how much the move raised the objective's reward, AP − λ_comm · kbit per sensor − λ_price · price.

    ## Starting State
    Sensors drawn from the candidates, at most one of a mount. With several sites, one is drawn.

    ## Episode End
    Never terminates; truncated after `moves` moves.

    ## Info
    As of `coview/SensorSelect-v0`.

    ## Arguments
    site: a site, its name, or several of these, of which each episode draws one; budget: sensors; moves: of an episode;
    fidelity: surrogate, coverage or detector; scheme, and by name frames, weights, candidates, detector, iou, seed: of
    `placement_env.objective.Objective`. `reset` takes the options site, scheme, budget (up to the environment's) and
    failed.

    ## Version History
    v0: first version.
    """

    def __init__(
        self,
        site: Any = "tjunction",
        *,
        budget: int = 4,
        moves: int = 20,
        scheme: Scheme | str = "early",
        fidelity: FidelityName = "surrogate",
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(PoseGame(1, PoseScenes(site, budget, scheme, fidelity, arguments), moves), render_mode)


def _prepared(
    site: Site,
    scheme: Scheme,
    *,
    frames: int = 200,
    weights: Weights = AP_ONLY,
    candidates: Any = None,
    detector: Detector | None = None,
    iou: float = 0.7,
    seed: int = 0,
) -> Preparation:
    chosen = site_candidates(site, candidates)
    return Preparation(
        site=site, candidates=chosen, frames=frames, scheme=scheme, iou=iou, seed=seed, detector=detector
    )


def _feet(candidates: Candidates) -> Float64[np.ndarray, " C"]:
    return np.array([candidates.mounts[index].position[2] for index in candidates.mount])
