"""Scenarios, objectives as agents observe them, and episodes drawn from them.

A scenario pads its candidates to a number of slots, so that one policy can be used at sites with
different numbers of them. The view of a candidate is taken at up to `MAX_PLACES` places: vehicles
of the traffic if known, otherwise spots of the area.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from placement_env.candidates.candidates import Candidates, aims
from placement_env.checks import check_range
from placement_env.envs.config import EnvConfig, SelectConfig, SubsetConfig
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.arrays import Bool, Float64, Rng, Shaped
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, find_scheme
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

MAX_PLACES = 512
STATIC = (
    "x",
    "y",
    "z",
    "cos heading",
    "sin heading",
    "tilt",
    "field of view",
    "lidar",
    "price",
    "kbit",
    "seen",
)
VIEW_RANGE_M = 30.0  # within which a sensor sees the spots in its field of view without traffic
Options = Mapping[str, Any]  # of `reset`
Key = TypeVar("Key")
Made = TypeVar("Made")
OPTIONS = ("site", "scheme", "budget", "failed")
FIRST_TRAFFIC_PART = 10  # part of the run for the second traffic; searches race on earlier parts
OTHER_TRAFFICS = 1 << 20  # to draw from if every episode has different traffic
MAX_KEPT_SCENARIOS = 64  # in memory if episodes draw their traffic


class Scenario:
    """Objective with its C candidates in `slots` slots.

    Attributes:
        objective: Objective.
        slots: Number of slots.
        width: Number of candidates.
        usable: True for slots with a candidate whose link carries its data.
        seen: Places that each candidate sees, 64 in a word, a bit each.
        places: Number of places.
        static: `STATIC` of each candidate, in -1..1; 0 in the empty slots. x and y are relative to
            the area, whose sides are at ±0.5; z is in units of 20 m, tilt of a right angle, the
            field of view of a full turn; price and kbit are x / (x + 1) of the price, and of the
            data in Mbit; seen is a share of the places.
        constants: Last global features: weights of a Mbit and of a mount, as x / (x + 1), and
            scheme.
    """

    def __init__(self, objective: Objective, slots: int) -> None:
        self.objective = objective
        self.slots = slots
        self.width = len(objective.candidates)
        if self.width > slots:
            problem = (
                f"the environment has slots for {slots} candidates, this site has {self.width}"
            )
            raise ValueError(f"{problem}: make it with slots={self.width}")
        self.usable = np.pad(objective.linked, (0, slots - self.width))
        seen = places_seen(objective)
        slot_places = np.zeros((slots, MAX_PLACES), np.bool_)
        self.places = seen.shape[1]
        slot_places[: len(seen), : self.places] = seen
        self.seen: Shaped[np.ndarray, "words slots"] = np.ascontiguousarray(
            np.packbits(slot_places, axis=1).view(np.uint64).T
        )
        self.static = np.zeros((len(STATIC), slots), np.float32)
        seen_share = seen.sum(axis=1) / max(1, self.places)
        self.static[:, : self.width] = np.clip(self._features(seen_share), -1, 1)
        weights = np.array([1000 * objective.weights.comm, objective.weights.price])
        scheme = [objective.scheme.name == name for name in PAPER_SCHEMES]
        self.constants = np.concatenate([weights / (weights + 1), scheme]).astype(np.float32)

    def _features(self, seen: Float64[np.ndarray, " C"]) -> Float64[np.ndarray, "features C"]:
        """`STATIC` features of the candidates. seen: share of the places that each one sees."""
        sensor_poses = poses(self.objective.candidates)
        position = sensor_poses.position
        area = find_area(self.objective)
        middle = (area[:2] + area[2:]) / 2
        x, y = ((position[:, :2] - middle) / (area[2:] - area[:2])).T
        price = self.objective.candidates.prices
        megabit = self.objective.sent / 1000
        return np.stack(
            [
                x,
                y,
                position[:, 2] / 20,
                np.cos(sensor_poses.heading),
                np.sin(sensor_poses.heading),
                sensor_poses.tilt / (np.pi / 2),
                sensor_poses.fov / (2 * np.pi),
                sensor_poses.is_lidar,
                price / (price + 1),
                megabit / (megabit + 1),
                seen,
            ]
        )


def places_seen(objective: Objective) -> Bool[np.ndarray, "C places"]:
    """Mask of the places that each candidate sees: vehicles with enough points, or, without
    traffic, spots of the area in the field of view."""
    if objective.visibility is not None:
        points = objective.visibility.points  # candidates x vehicles
        columns = np.linspace(0, points.shape[1] - 1, MAX_PLACES).round().astype(np.int64)
        columns = np.unique(columns)[: points.shape[1]]
        return np.asarray(points[:, columns] >= LEAST)
    xmin, ymin, xmax, ymax = find_area(objective)
    # 22² = 484 spots, fewer than `MAX_PLACES`
    x, y = np.meshgrid(np.linspace(xmin, xmax, 22), np.linspace(ymin, ymax, 22))
    sensor_poses = poses(objective.candidates)
    dx = x.ravel() - sensor_poses.position[:, :1]
    dy = y.ravel() - sensor_poses.position[:, 1:2]
    turn = np.arctan2(dy, dx) - sensor_poses.heading[:, None]
    off_axis = np.angle(np.exp(1j * turn))  # in -π..π
    is_in_view = np.abs(off_axis) <= sensor_poses.fov[:, None] / 2
    return np.asarray(is_in_view & (np.hypot(dx, dy) <= VIEW_RANGE_M))


def find_area(objective: Objective) -> Float64[np.ndarray, "4"]:
    """xmin ymin xmax ymax of the detection area; around all mounts if the site is unknown."""
    if objective.site is not None:
        return objective.site.area
    feet = np.array([mount.position[:2] for mount in objective.candidates.mounts])
    return np.concatenate([feet.min(axis=0) - 1, feet.max(axis=0) + 1])


class SensorPoses(NamedTuple):
    """Poses of C candidates.

    Attributes:
        position: Positions (C, 3).
        heading: Headings (rad).
        tilt: Tilts below the horizon (rad).
        fov: Horizontal fields of view (rad).
        is_lidar: Whether each candidate is a lidar.
    """

    position: np.ndarray
    heading: np.ndarray
    tilt: np.ndarray
    fov: np.ndarray
    is_lidar: np.ndarray


def poses(candidates: Candidates) -> SensorPoses:
    """Poses and fields of view of the candidates."""
    sensors = candidates.sensors
    heading, tilt = aims(sensors)
    return SensorPoses(
        position=np.array([sensor.position for sensor in sensors]),
        heading=heading,
        tilt=tilt,
        fov=np.array([sensor.model.horizontal_fov for sensor in sensors]),
        is_lidar=np.array([sensor.model.measures == "range" for sensor in sensors], np.bool_),
    )


@dataclass(frozen=True, eq=False)
class Episode:
    """Start of an episode.

    Attributes:
        scenario: Scenario.
        budget: Largest number of sensors.
        failed: True for slots of failed candidates.
        chosen: True for slots of sensors that exist from the start, None for no sensors.
    """

    scenario: Scenario
    budget: int
    failed: Bool[np.ndarray, " slots"]
    chosen: Bool[np.ndarray, " slots"] | None = None


class Conditions(NamedTuple):
    """Conditions of an episode, drawn or given by options.

    Attributes:
        site: Number of the site.
        scheme: Fusion scheme.
        budget: Largest number of sensors.
        failed: Failed candidates, by index or name.
        traffic: Number of the traffic among the parts of the run.
    """

    site: int
    scheme: Scheme
    budget: int
    failed: Iterable[int | str]
    traffic: int = 0

    @property
    def key(self) -> tuple[int, str, int]:
        """Key of the scenario among the kept ones."""
        return self.site, self.scheme.digest, self.traffic


class EpisodeSource:
    """Sites of an environment, and the episodes drawn from them.

    config: configuration of the environment. candidates: at every site, None for the setting's.

    Attributes:
        sites: Sites; the first `drawn` are from the config, options of `reset` add others.
        slots: Number of slots in every scenario.
    """

    slots: int

    def __init__(self, config: EnvConfig, candidates: Candidates | None = None) -> None:
        self.config = config
        self._given = list(config.sites)
        self._of_all = candidates
        self.sites = [_load(site) for site in self._given]
        self.drawn = len(self.sites)
        self._candidates: dict[int, Candidates] = {}

    def draw(self, rng: Rng, options: Options | None) -> Episode:
        """Draw an episode with these options. Raises ValueError for an unknown or unsuitable
        option."""
        raise NotImplementedError

    def index(self, site: Site | str | None, rng: np.random.Generator) -> int:
        """Number of a site, which is loaded if it is new; None for one of the config's, drawn.

        Nothing is drawn from a single one.
        """
        if site is None:
            return int(rng.integers(self.drawn)) if self.drawn > 1 else 0
        for index, (name, loaded) in enumerate(zip(self._given, self.sites, strict=True)):
            if loaded is site or (isinstance(site, str) and site in (name, loaded.name)):
                return index
        self.sites.append(_load(site))
        self._given.append(site)
        return len(self.sites) - 1

    def candidates(self, index: int) -> Candidates:
        """Candidates at a site."""
        if self._of_all is not None:
            return self._of_all
        if index not in self._candidates:
            self._candidates[index] = replace(self.config.setting, site=self.sites[index]).pool
        return self._candidates[index]

    def setting(self, index: int, scheme: Scheme) -> Setting:
        """Setting at a site with one scheme."""
        return replace(
            self.config.setting,
            site=self.sites[index],
            candidates=self.candidates(index),
            scheme=scheme,
        )

    def check_scorable(self) -> None:
        """Raise ValueError if the candidates of some site cannot be scored."""
        for index in range(len(self.sites)):
            for scheme in self.config.schemes:
                Preparation(self.setting(index, scheme)).check()

    def draw_conditions(self, rng: Rng, options: Options | None) -> Conditions:
        """Take site, scheme, budget and failed candidates from the options, or draw them in this
        order.

        What the config does not leave open takes nothing from the generator. Raises ValueError for
        an unknown or unsuitable option.
        """
        options = _check_options(options)
        config = self.config
        site = self.index(options.get("site"), rng)
        schemes = config.schemes
        if "scheme" in options:
            scheme = options["scheme"]
        else:
            scheme = schemes[_within((0, len(schemes) - 1), rng)]
        budget = options["budget"] if "budget" in options else _within(config.budgets, rng)
        failed = options.get("failed", [])
        if "failed" not in options and config.failure_counts[1]:
            candidate_count = len(self.candidates(site))
            failure_count = min(_within(config.failure_counts, rng), candidate_count)
            failed = sorted(rng.choice(candidate_count, failure_count, replace=False).tolist())
        traffic_count = OTHER_TRAFFICS if config.traffics is None else config.traffics
        traffic = _within((0, traffic_count - 1), rng)
        return Conditions(
            site=site,
            scheme=find_scheme(scheme),
            budget=int(budget),
            failed=failed,
            traffic=FIRST_TRAFFIC_PART + traffic if traffic else 0,
        )


class Scenarios(EpisodeSource):
    """Scenarios to choose among candidates, each made when first drawn; all are checked before."""

    def __init__(self, config: SubsetConfig) -> None:
        objective = self._objective = config.objective
        super().__init__(config, None if objective is None else objective.candidates)
        self.factored = isinstance(config, SelectConfig) and config.actions == "factored"
        pools = [self.candidates(index) for index in range(len(self.sites))]
        max_candidates = max(map(len, pools))
        self.slots = max_candidates if config.slots is None else config.slots
        self.shape = tuple(np.max([pool.shape for pool in pools], axis=0).tolist())
        if max_candidates > self.slots:
            raise ValueError(f"slots must hold all {max_candidates} candidates, got {self.slots}")
        if config.budgets[1] > max_candidates:
            raise ValueError(_describe_budget(config.budgets[1], max_candidates))
        if objective is None:
            self.check_scorable()
        self._made: dict[tuple[int, str, int], Scenario] = {}
        # if nothing is drawn, all episodes without options start with the same one
        self._always: Episode | None = None

    def draw(self, rng: Rng, options: Options | None) -> Episode:
        """Draw an episode with these options."""
        if not options and self._always is not None:
            return self._always
        objective = self._objective
        options = options or {}
        changes_scheme = (
            "scheme" in options and objective and find_scheme(options["scheme"]) != objective.scheme
        )
        if objective and ("site" in options or changes_scheme):
            raise ValueError(
                "an environment made from an objective keeps its site and scheme: make it from a "
                "site"
            )
        conditions = self.draw_conditions(rng, options)
        if "budget" in options and conditions.budget > len(self.candidates(conditions.site)):
            raise ValueError(
                _describe_budget(conditions.budget, len(self.candidates(conditions.site)))
            )
        if conditions.key not in self._made:
            run = self.config.run.part(conditions.traffic)
            new_objective = objective or Objective(
                self.setting(conditions.site, conditions.scheme), run
            )
            keep_few(self._made, conditions.key, Scenario(new_objective, self.slots))
        scenario = self._made[conditions.key]
        shape = scenario.objective.candidates.shape
        if self.factored and any(
            size > max_size for size, max_size in zip(shape, self.shape, strict=True)
        ):
            rule = (
                f"factored actions are for {self.shape} mounts, heights, headings, tilts and models"
            )
            raise ValueError(
                f"{rule}, this site has {shape}: make the environment with all its sites"
            )
        failed = np.pad(scenario.objective.row(conditions.failed), (0, self.slots - scenario.width))
        episode = Episode(scenario=scenario, budget=conditions.budget, failed=failed)
        if not options and not self.config.leaves_open and self.drawn == 1:
            self._always = episode
        return episode


def _describe_budget(budget: int, count: int) -> str:
    """Error for a budget above the number of candidates."""
    return (
        f"budget must be at most the number of candidates, {count}, got {budget}: lower it, or "
        "add candidates"
    )


def keep_few(kept_values: dict[Key, Made], key: Key, value: Made) -> None:
    """Keep a value, and forget the oldest of more than `MAX_KEPT_SCENARIOS`."""
    kept_values[key] = value
    if len(kept_values) > MAX_KEPT_SCENARIOS:
        del kept_values[next(iter(kept_values))]


def _load(site: Site | str) -> Site:
    """Site itself, or by its name or file. Raises ValueError for anything else."""
    if isinstance(site, Site):
        return site
    if not isinstance(site, str):
        raise ValueError(f"a site must be a Site, or the name or file of one, got {site!r}")
    return load_site(site)


def _within(bounds: tuple[int, int], rng: np.random.Generator) -> int:
    """Random whole number from the lowest to the highest; equal bounds draw nothing."""
    low, high = bounds
    return low if low == high else int(rng.integers(low, high + 1))


def _check_options(options: Options | None) -> Options:
    """Options of `reset`. Raises ValueError for an unknown or unsuitable one."""
    options = options or {}
    if unknown := set(options) - set(OPTIONS):
        raise ValueError(
            f"options are {', '.join(OPTIONS)}, got {', '.join(map(repr, sorted(unknown)))}"
        )
    budget = options.get("budget", 1)
    failed = options.get("failed", ())
    if isinstance(budget, list | tuple):
        raise ValueError(f"budget of an episode must be a whole number, got {budget!r}")
    check_range("budget", budget, least=1, unit="sensor")
    if isinstance(failed, str) or not isinstance(failed, Iterable):
        raise ValueError(f"failed must be a list of candidates, by index or name, got {failed!r}")
    return options
