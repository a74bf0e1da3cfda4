"""Scalar and vector environments of a task, the rules of n episodes side by side.

The vector environments agree with `gymnasium.vector.SyncVectorEnv` over the scalar ones, step by
step, including infos and autoreset. Pictures and text summaries of a set of sensors are here too.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from placement_env.defaults import VEHICLES
from placement_env.envs.config import EnvConfig, build_config
from placement_env.envs.scenario import STATIC, EpisodeSource, Options, find_area
from placement_env.envs.state import DYNAMIC, GLOBAL, Info, State
from placement_env.objective import Objective
from toolkit.arrays import Bool, Float32, Float64, Int64, Mask, Rng, Shaped
from toolkit.boxes import footprints
from toolkit.plots import (
    canvas,
    ground_map,
    map_sheet,
    north_arrow,
    palette,
    pole_marks,
    sensor_marks,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RENDER_MODES = ["rgb_array", "ansi"]
METADATA = {"render_modes": RENDER_MODES, "render_fps": 2}
AnyEnv = gym.Env[Any, Any]
Ends = tuple[Float64[np.ndarray, " n"], Mask, Mask]  # rewards, terminated, truncated
Picture = Shaped[np.ndarray, "height width 3"] | str
MAX_DRAWN_VEHICLES = 300
PICTURE_MARGIN_M = 6.0  # around area and sensors
_SIDE_INCHES = 6.4  # side of a square picture
_HEAD_INCHES = 0.5  # strip above the map
_FOOT_INCHES = 0.42  # strip below the map


class Task:
    """Rules of an environment, for n episodes together.

    A subclass has its configuration, scenarios and rules.
    """

    config_type: ClassVar[type[EnvConfig]]
    scenarios_type: ClassVar[type[EpisodeSource]]
    scenarios: EpisodeSource
    state: State
    observation_space: Box
    action_space: Space[Any]

    def __init__(
        self, n: int, scenarios: EpisodeSource, *, max_steps: int | None = None, fixed: bool = False
    ) -> None:
        """Make room for n episodes.

        scenarios: draws the episodes; max_steps: largest number of steps of an episode, None for
        the usual number by its budget; fixed: True if sensors are only moved, so that none may
        join."""
        self.scenarios = scenarios
        self.state = State(n, scenarios.slots, max_steps=max_steps, fixed=fixed)
        size = (len(STATIC) + len(DYNAMIC)) * scenarios.slots + len(GLOBAL)
        self.observation_space = Box(-1.0, 1.0, (size,), np.float32)

    @classmethod
    def build(
        cls, n: int, config: "EnvConfig | Task | None", options: Mapping[str, object]
    ) -> "Task":
        """Task of n episodes side by side.

        Args:
            n: Number of episodes.
            config: Configuration, None for the usual one; or another task, whose scenarios are
                shared and whose configuration is taken.
            options: Fields of the configuration by name, which take precedence over `config`. Not
                used with another task."""
        if isinstance(config, Task):
            return type(config)(n, config.scenarios)
        full_config = build_config(cls.config_type, config, options)
        return cls(n, cls.scenarios_type(full_config))

    def reset(
        self, rows: Int64[np.ndarray, " m"], rngs: Sequence[Rng], options: Options | None
    ) -> None:
        """Start new episodes in some rows, one from each generator.

        options: options of Gymnasium's `reset` for these episodes, None for none."""
        self.state.reset(rows, [self.scenarios.draw(rng, options) for rng in rngs])

    def step(self, active: Mask, actions: Shaped[np.ndarray, "n ..."]) -> Ends:
        """Take one action in each active row and return rewards, terminated, truncated."""
        raise NotImplementedError

    def step_objectives(
        self, active: Mask, actions: Shaped[np.ndarray, "n ..."]
    ) -> tuple[Float32[np.ndarray, "n 3"], Mask, Mask]:
        """Take one action in each active row and return increases, terminated, truncated.

        The increases have the columns AP, -kbit per sensor and -price; they are 0 in other rows.
        """
        objectives_before = self.state.objectives()
        _, terminated, truncated = self.step(active, actions)
        increases = (self.state.objectives() - objectives_before).astype(np.float32)
        increases[~active] = 0.0
        return increases, terminated, truncated

    def observe(self) -> tuple[Float32[np.ndarray, "n size"], Info]:
        """Observations, and info with an array (n, ...) for each key."""
        info = self.state.info()
        info["action_mask"] = self.info_mask().astype(np.int8)  # the type of Gymnasium's masks
        return self.state.observe(), info

    def info_mask(self) -> Bool[np.ndarray, "n entries"]:
        """Mask of legal actions in the info."""
        return self.action_masks()

    def action_masks(self) -> Bool[np.ndarray, "n choices"]:
        """Mask of legal actions."""
        raise NotImplementedError

    def running(self) -> "Task":
        """The task itself. Raises ResetNeeded before the first `reset`."""
        if not self.state.ready:
            raise ResetNeeded("no episode has started: call reset() first")
        return self

    def read_actions(self, actions: ArrayLike) -> Shaped[np.ndarray, "n ..."]:
        """Checked actions as an array, a row for each of n episodes.

        Raises ValueError for a wrong number of values, a value that is not finite, or not whole for
        counted choices; ResetNeeded before the first reset.
        """
        array = np.asarray(actions)
        shape = (self.running().state.n, *(self.action_space.shape or ()))
        # kinds: truth values, signed and unsigned whole numbers, floats
        if array.size != math.prod(shape) or array.dtype.kind not in "biuf":
            raise ValueError(
                f"actions must be numbers of shape {shape}, got {array.dtype} {array.shape}"
            )
        is_float = array.dtype.kind == "f"
        if is_float and not np.isfinite(array).all():
            raise ValueError(f"actions must be finite, got {array.tolist()}")
        takes_floats = np.dtype(self.action_space.dtype).kind == "f"
        if is_float and not takes_floats and (array != np.round(array)).any():
            raise ValueError(
                f"actions must be whole numbers, one of {self.action_space} each, got "
                f"{array.tolist()}"
            )
        return array.reshape(shape)

    def draw(self, row: int, mode: str) -> Picture:
        """Picture of the episode in a row, or its description with mode "ansi"."""
        objective, members = self.running().state.placement(row)
        return bird_view(objective, members) if mode == "rgb_array" else summary(objective, members)


def find_reward_space() -> Box:
    """Space of vector rewards: increases of AP, of -kbit per sensor and of -price."""
    ends = np.array([1.0, np.inf, np.inf], np.float32)
    return Box(-ends, ends, dtype=np.float32)


class PlacementEnv(gym.Env[np.ndarray, Any]):
    """Environment for one episode after another of a task. config: configuration of the task, or
    its fields by name.

    vector_reward: return the increases of AP, of -kbit per sensor and of -price in place of their
    weighted sum, in `reward_space`, as mo-gymnasium takes them.
    """

    metadata: ClassVar[dict[str, Any]] = METADATA  # type: ignore[misc]
    task_type: ClassVar[type[Task]] = Task

    def __init__(
        self,
        config: EnvConfig | None = None,
        *,
        render_mode: str | None = None,
        vector_reward: bool = False,
        **options: object,
    ) -> None:
        """Build the task.

        Args:
            config: Configuration of the task, None for the usual one.
            render_mode: "rgb_array" for pictures, "ansi" for text, None for neither.
            vector_reward: Whether rewards are vectors (`find_reward_space`).
            options: Fields of the configuration by name."""
        self.task = self.task_type.build(1, config, options)
        self.render_mode = _check_render_mode(render_mode)
        self.observation_space = self.task.observation_space
        self.action_space = self.task.action_space
        self.reward_space = find_reward_space() if vector_reward else None

    def reset(
        self, *, seed: int | None = None, options: Options | None = None
    ) -> tuple[np.ndarray, Info]:
        """Start an episode, and return its first observation and info.

        seed: seed of the generator, None to go on with it; options: None, or for this episode site,
        scheme, budget and failed (candidates that have failed, by index or name). Raises ValueError
        if one does not fit.
        """
        super().reset(seed=seed)
        only_row = np.zeros(1, np.int64)
        self.task.reset(only_row, [self.np_random], options)
        observations, info = self.task.observe()
        return observations[0], _first_info(info)

    def step(self, action: ArrayLike) -> tuple[np.ndarray, Any, bool, bool, Info]:
        """Take an action, and return observation, reward, terminated, truncated and info.

        The reward is a number, or an array (3,) with `vector_reward`. Raises ValueError for an
        invalid action, ResetNeeded before the first `reset`.
        """
        has_vector_reward = self.reward_space is not None
        step = self.task.step_objectives if has_vector_reward else self.task.step
        is_active = np.ones(1, np.bool_)
        rewards, terminated, truncated = step(is_active, self.task.read_actions(action))
        observations, info = self.task.observe()
        reward: Any = rewards[0] if has_vector_reward else rewards.item()
        return observations[0], reward, terminated.item(), truncated.item(), _first_info(info)

    def action_masks(self) -> Bool[np.ndarray, " choices"]:
        """Mask of legal actions, in the form of sb3-contrib's MaskablePPO."""
        return self.task.running().action_masks()[0]

    def placement(self) -> tuple[Objective, list[int]]:
        """Objective of the episode, and the chosen candidates as indices."""
        return self.task.running().state.placement(0)

    def render(self) -> Picture | None:
        """Draw the area with the chosen sensors (uint8), or describe them in text."""
        return None if self.render_mode is None else self.task.draw(0, self.render_mode)


class PlacementVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Environment for n episodes of a task.

    An episode that has ended restarts, without options, at the next step, whose reward is 0.
    config: configuration of the task, or its fields by name, or the task of another environment,
    whose scenarios are shared; vector_reward: as in the scalar environment.
    """

    metadata: ClassVar[dict[str, Any]] = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}  # type: ignore[misc]
    task_type: ClassVar[type[Task]] = Task

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | Task | None = None,
        *,
        render_mode: str | None = None,
        vector_reward: bool = False,
        **options: object,
    ) -> None:
        """Build the task.

        Args:
            num_envs: Number of episodes side by side.
            config: Configuration of the task, None for the usual one; or a task to share.
            render_mode: "rgb_array" for pictures, "ansi" for text, None for neither.
            vector_reward: Whether rewards are vectors (`find_reward_space`).
            options: Fields of the configuration by name."""
        task = self.task = self.task_type.build(num_envs, config, options)
        self.render_mode = _check_render_mode(render_mode)
        self.num_envs = task.state.n
        self.single_observation_space = task.observation_space
        self.single_action_space = task.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.reward_space: Space[Any] | None = None
        if vector_reward:
            self.reward_space = batch_space(find_reward_space(), self.num_envs)
        self._generators = [seeding.np_random()[0] for _ in range(self.num_envs)]
        self._ended = np.zeros(self.num_envs, np.bool_)  # these restart at the next step
        self._all_rows = np.ones(self.num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Options | None = None
    ) -> tuple[np.ndarray, Info]:
        """Start all episodes, or those in `options["reset_mask"]`; return observations and info.

        seed: a seed for each episode; with an int, the i-th is seeded by seed + i; None, for all or
        for one, goes on with the generator. options: as for one episode, None for none.
        """
        options = dict(options or {})
        mask = np.asarray(options.pop("reset_mask", self._all_rows))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ValueError(
                f"reset_mask must be {self.num_envs} truth values, got {mask.dtype} {mask.shape}"
            )
        rows = np.flatnonzero(mask)
        # a seed for each row, None to go on with its generator
        seeds = [None] * self.num_envs if seed is None else seed
        seeds = [seeds + i for i in range(self.num_envs)] if isinstance(seeds, int) else seeds
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"there must be a seed for each of {self.num_envs} environments, got {len(seeds)}"
            )
        if not mask.all():
            self.task.running()  # raises ResetNeeded, as the other rows need an episode
        for row in rows.tolist():
            if seeds[row] is not None:
                self._generators[row] = seeding.np_random(seeds[row])[0]
        self._start_episodes(rows, options)
        self._ended[rows] = False
        observations, info = self.task.observe()
        return observations, _batch_info(info, mask)

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Take an action in every episode, or restart it if it ended at the last step.

        Returns observations, rewards, terminated, truncated and info, a row for each episode; the
        reward of a restart is 0."""
        step = self.task.step if self.reward_space is None else self.task.step_objectives
        rewards, terminated, truncated = step(~self._ended, self.task.read_actions(actions))
        rewards = rewards.copy()  # the task's array changes when episodes start
        if self._ended.any():
            self._start_episodes(np.flatnonzero(self._ended), options=None)
        self._ended = terminated | truncated
        observations, info = self.task.observe()
        return observations, rewards, terminated, truncated, _batch_info(info, self._all_rows)

    def action_masks(self) -> np.ndarray:
        """Mask of legal actions, a row for each episode."""
        return self.task.running().action_masks()

    def render(self) -> tuple[Picture, ...] | None:
        """Draw each episode."""
        mode = self.render_mode
        if mode is None:
            return None
        return tuple(self.task.draw(row, mode) for row in range(self.num_envs))

    def _start_episodes(self, rows: np.ndarray, options: Options | None) -> None:
        """Start new episodes in some rows (indices), each from its generator."""
        self.task.reset(rows, [self._generators[row] for row in rows.tolist()], options)


def _check_render_mode(render_mode: str | None) -> str | None:
    """The render mode. Raises ValueError for an unknown one."""
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(
            f"render_mode must be None or one of {', '.join(RENDER_MODES)}, got {render_mode!r}"
        )
    return render_mode


def _first_info(info: Info) -> Info:
    """Info of the first of n episodes.

    info: an array (n, ...) for each key, or a dictionary of such arrays. An array (n,) gives a
    number of Python, others their first row."""
    first: Info = {}
    for key, value in info.items():
        if isinstance(value, dict):
            first[key] = _first_info(value)
        else:
            first[key] = value.item(0) if value.ndim == 1 else value[0]
    return first


def _batch_info(info: Info, has_value: np.ndarray) -> Info:
    """Info in the form of Gymnasium's vector environments.

    Each key is followed by the same key with a leading underscore, for `has_value`. The same holds
    for the keys of dictionaries in the info.

    has_value: mask of rows that have a value."""
    batched: Info = {}
    for key, value in info.items():
        batched[key] = _batch_info(value, has_value) if isinstance(value, dict) else value
        batched[f"_{key}"] = has_value.copy()
    return batched


def bird_view(objective: Objective, members: list[int]) -> Shaped[np.ndarray, "height width 3"]:
    """Draw the area from above (RGB, uint8), a square of the same size for every site.

    Shows lanes, solids and the detection area, vehicles coloured by the points on them (darker is
    more, pale grey none), possible places of sensors, and the chosen sensors with their fields of
    view. members: indices of the chosen candidates.
    """
    sensors = objective.candidates.sensors
    site = objective.site
    spots = np.array([sensor.position[:2] for sensor in sensors]).reshape(-1, 2)
    area = find_area(objective)
    shown_points = np.concatenate([[area[:2], area[2:]], spots])
    map_inches = _SIDE_INCHES - _HEAD_INCHES - _FOOT_INCHES  # height of the map
    low = shown_points.min(axis=0) - PICTURE_MARGIN_M
    high = shown_points.max(axis=0) + PICTURE_MARGIN_M
    middle_x, middle_y = (low + high) / 2
    # half extents of the map (m): it is wider than high
    reach_x, reach_y = (high - low).max() / 2 * np.array([_SIDE_INCHES / map_inches, 1.0])
    scale = map_inches / (2 * reach_y)  # inches a metre
    with canvas.house_style():
        figure = canvas.blank_figure(_SIDE_INCHES, _SIDE_INCHES)
        axes = figure.add_axes((0, _FOOT_INCHES / _SIDE_INCHES, 1, map_inches / _SIDE_INCHES))
        axes.set(
            xlim=(middle_x - reach_x, middle_x + reach_x),
            ylim=(middle_y - reach_y, middle_y + reach_y),
        )
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        if site is not None:
            ground_map.draw_ground(axes, site)
        map_sheet.draw_area(axes, area)
        vehicles = _draw_vehicles(axes, objective, members)
        pole_marks.draw_poles(axes, np.unique(spots, axis=0), size=3.5)
        chosen_sensors = [sensors[member] for member in members]
        sensor_marks.draw_wedges(axes, chosen_sensors, () if site is None else site.solids)
        sensor_marks.draw_sensors(axes, chosen_sensors, 72 * scale)
        north_direction = np.array([0.0, 1.0]) if site is None else north_arrow.north(site)
        north_arrow.draw_north(
            _draw_strips(figure, scale), (1.85, _FOOT_INCHES / 2), north_direction
        )
        title = (
            f"{canvas.shorten(_site_name(objective), 30)}: {len(members)} "
            f"sensor{'s' * (len(members) != 1)}"
        )
        figure.text(
            0.02, 1 - 0.16 / _SIDE_INCHES, title, fontsize=10, fontweight="bold", va="center"
        )
        figure.text(
            0.02,
            1 - 0.36 / _SIDE_INCHES,
            f"{vehicles}; by {objective.fidelity}",
            fontsize=8,
            va="center",
        )
        return canvas.render_pixels(figure)


def _site_name(objective: Objective) -> str:
    """Name of the site, or words for an unknown one."""
    return "a site" if objective.site is None else objective.site.name


def _draw_vehicles(axes: "Axes", objective: Objective, members: list[int]) -> str:
    """Draw some objects of the classes that count, coloured by the points of sensors on them.

    members: indices of the chosen sensors, whose points are added up. Returns a caption with the
    number of objects.
    """
    from matplotlib.collections import PolyCollection

    names = objective.classes.names
    noun = "vehicles" if names == VEHICLES.names else " and ".join(names)
    if objective.visibility is None or not len(objective.visibility.boxes):
        return f"no {noun}"
    boxes = objective.visibility.boxes
    drawn_count = min(len(boxes), MAX_DRAWN_VEHICLES)
    # evenly spread over all vehicles
    rows = np.linspace(0, len(boxes) - 1, drawn_count).round().astype(np.int64)
    points = objective.visibility.points[members][:, rows].astype(np.float64).sum(axis=0)
    polygons = PolyCollection(
        list(footprints(boxes[rows])),
        facecolor=palette.point_colours(points),
        edgecolor=palette.INK,
        linewidth=0.3,
        zorder=2.1,
    )
    axes.add_collection(polygons, autolim=False)
    remark = f", {len(rows)} drawn" if len(rows) < len(boxes) else ""
    return f"N = {len(boxes)} {noun} in {objective.visibility.frames} frames{remark}"


def _draw_strips(figure: "Figure", scale: float) -> "Axes":
    """Axes of the strip below the map, with a scale bar and a legend of the points on a vehicle.

    Positions in the strip are in inches from its lower left corner.

    scale: inches of the map for one metre.
    """
    strip = figure.add_axes((0, 0, 1, _FOOT_INCHES / _SIDE_INCHES))
    strip.set(xlim=(0, _SIDE_INCHES), ylim=(0, _FOOT_INCHES))
    strip.set_axis_off()
    length_m = map_sheet.scale_length(1.2 / scale)  # a round length of at most 1.2 inches
    bar_left = 0.13
    # a dark half and a white one
    for half, colour in ((0.0, palette.INK), (0.5, palette.PAPER_WHITE)):
        left = bar_left + half * length_m * scale
        right = bar_left + (half + 0.5) * length_m * scale
        strip.fill(
            [left, right, right, left],
            [0.24, 0.24, 0.31, 0.31],
            facecolor=colour,
            edgecolor=palette.INK,
            linewidth=0.8,
        )
    strip.text(bar_left, 0.18, f"{length_m:g} m", fontsize=7.5, va="top")
    strip.text(2.35, 0.27, "points on\na vehicle", fontsize=7, va="center")
    colours, _ = palette.point_scale()
    field_width = 0.42  # width of a colour in the legend
    for step, name in enumerate(palette.point_names()):
        left = 3.0 + field_width * step
        right = left + field_width
        strip.fill(
            [left, right, right, left],
            [0.22, 0.22, 0.36, 0.36],
            facecolor=colours(step),
            edgecolor=palette.INK,
            linewidth=0.3,
        )
        strip.text(left + field_width / 2, 0.18, name, fontsize=6.5, ha="center", va="top")
    return strip


def summary(objective: Objective, members: list[int]) -> str:
    """Describe site, scheme, chosen sensors and their score.

    members: indices of the chosen candidates."""
    score = objective.score(members)
    names = ", ".join(objective.names[member] for member in members) or "no sensors"
    site_name = _site_name(objective)
    return (
        f"{site_name}, {objective.scheme.name} fusion, by {score.fidelity}\n{names}\nAP "
        f"{score.ap:.3f}, recall {score.recall:.3f}, {score.kbit_per_sensor:.1f} kbit per sensor, "
        f"{score.kbit:.1f} kbit, price {score.price:g}: reward {score.reward:.3f}\n"
    )
