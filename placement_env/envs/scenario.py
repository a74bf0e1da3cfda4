"""Scenarios, objectives as agents observe them, and episodes drawn from them.

A scenario pads its candidates to a number of slots, so that one policy can be used at sites with
different numbers of candidates. The view of a candidate is taken at up to `MAX_PLACES` places:
vehicles of the traffic if known, otherwise spots of the area.
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
SPOTS_ON_A_SIDE = 22  # along the area without traffic: 22² = 484, fewer than `MAX_PLACES`
HEIGHT_SCALE_M = 20.0  # height that is 1 in the observations
Options = Mapping[str, Any]  # of `reset`
Key = TypeVar("Key")
Made = TypeVar("Made")
OPTIONS = ("site", "scheme", "budget", "failed")
FIRST_TRAFFIC_PART = 10  # part of the run for the second traffic; searches race on earlier parts
OTHER_TRAFFICS = 1 << 20  # to draw from if every episode has different traffic
MAX_KEPT_SCENARIOS = 64  # in memory if episodes draw their traffic


class Scenario:
    """Objective with its candidates in `slots` slots.

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
        """Compute the features of the candidates, which fill the first of the slots.

        Raises ValueError for fewer slots than candidates."""
        self.objective = objective
        self.slots = slots
        self.width = len(objective.candidates)  # slots from here on are empty
        if self.width > slots:
            problem = (
                f"the environment has slots for {slots} candidates, this site has {self.width}"
            )
            raise ValueError(f"{problem}: make it with slots={self.width}")
        # slots with a candidate whose link carries its data
        self.usable = np.pad(objective.linked, (0, slots - self.width))
        # axes: candidate, place
        sees_place = places_seen(objective)
        _, self.places = sees_place.shape
        # places in bits, 64 in a word; places and slots that are missing stay 0
        slot_places = np.zeros((slots, MAX_PLACES), np.bool_)
        slot_places[: len(sees_place), : self.places] = sees_place
        words = np.packbits(slot_places, axis=1).view(np.uint64)
        self.seen: Shaped[np.ndarray, "words slots"] = np.ascontiguousarray(words.T)
        # features that do not change within an episode; axes: feature, slot
        self.static = np.zeros((len(STATIC), slots), np.float32)
        seen_share = sees_place.sum(axis=1) / max(1, self.places)
        self.static[:, : self.width] = np.clip(self._features(seen_share), -1, 1)
        # last global features; 1000: from a weight of a kbit to one of a Mbit
        weights = np.array([1000 * objective.weights.comm, objective.weights.price])
        is_scheme = [objective.scheme.name == name for name in PAPER_SCHEMES]
        self.constants = np.concatenate([weights / (weights + 1), is_scheme]).astype(np.float32)

    def _features(
        self, seen: Float64[np.ndarray, " candidates"]
    ) -> Float64[np.ndarray, "features candidates"]:
        """Features of the candidates, in the order of `STATIC`, before they are clipped to -1..1.

        seen: share of the places that each candidate sees."""
        # x and y are in parts of the area's sides; costs c are c / (c + 1), from 0 to below 1
        sensor_poses = poses(self.objective.candidates)
        position = sensor_poses.position
        area = find_area(self.objective)
        low = area[:2]
        high = area[2:]
        middle = (low + high) / 2
        x, y = ((position[:, :2] - middle) / (high - low)).T
        price = self.objective.candidates.prices
        megabit = self.objective.sent / 1000  # per frame
        return np.stack(
            [
                x,
                y,
                position[:, 2] / HEIGHT_SCALE_M,
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


def places_seen(objective: Objective) -> Bool[np.ndarray, "candidates places"]:
    """Mask of the places that each candidate sees, at most `MAX_PLACES` places.

    Places are vehicles of the traffic, seen with `LEAST` points or more. Without traffic they are
    spots of the area, seen if they are in the field of view and within `VIEW_RANGE_M`."""
    if objective.visibility is not None:
        points = objective.visibility.points  # candidates × vehicles
        _, vehicle_count = points.shape
        # evenly spread over all vehicles; the slice leaves none if there is no vehicle
        columns = np.linspace(0, vehicle_count - 1, MAX_PLACES).round().astype(np.int64)
        columns = np.unique(columns)[:vehicle_count]
        return np.asarray(points[:, columns] >= LEAST)
    xmin, ymin, xmax, ymax = find_area(objective)
    x, y = np.meshgrid(
        np.linspace(xmin, xmax, SPOTS_ON_A_SIDE), np.linspace(ymin, ymax, SPOTS_ON_A_SIDE)
    )
    sensor_poses = poses(objective.candidates)
    # from each sensor (row) to each spot (column)
    dx = x.ravel() - sensor_poses.position[:, :1]
    dy = y.ravel() - sensor_poses.position[:, 1:2]
    turn = np.arctan2(dy, dx) - sensor_poses.heading[:, None]
    off_axis = np.angle(np.exp(1j * turn))  # the turn in -π..π
    is_in_view = np.abs(off_axis) <= sensor_poses.fov[:, None] / 2
    return np.asarray(is_in_view & (np.hypot(dx, dy) <= VIEW_RANGE_M))


def find_area(objective: Objective) -> Float64[np.ndarray, "4"]:
    """Detection area as xmin, ymin, xmax, ymax (m); around all mounts if the site is unknown."""
    if objective.site is not None:
        return objective.site.area
    feet = np.array([mount.position[:2] for mount in objective.candidates.mounts])
    # 1 m more on each side, so that the area has one
    return np.concatenate([feet.min(axis=0) - 1, feet.max(axis=0) + 1])


class SensorPoses(NamedTuple):
    """Poses of candidates.

    Attributes:
        position: Positions (candidates, 3), x, y, z (m).
        heading: Headings from +x (rad).
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
        # lidars measure ranges, cameras depth
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
        """Load the sites; their candidates are made when they are needed."""
        self.config = config
        self._given_sites = list(config.sites)  # sites, or their names or files
        self._shared_candidates = candidates
        self.sites = [_load(site) for site in self._given_sites]
        self.drawn = len(self.sites)
        self._candidates: dict[int, Candidates] = {}  # by the number of the site

    def draw(self, rng: Rng, options: Options | None) -> Episode:
        """Draw an episode with these options. Raises ValueError for an unknown or unsuitable
        option."""
        raise NotImplementedError

    def index(self, site: Site | str | None, rng: np.random.Generator) -> int:
        """Index of a site in `sites`, to which a new one is added.

        site: site, or its name or file; None for one of the config's sites, which is drawn unless
        it is the only one.
        """
        if site is None:
            return int(rng.integers(self.drawn)) if self.drawn > 1 else 0
        for index, (given_site, loaded_site) in enumerate(
            zip(self._given_sites, self.sites, strict=True)
        ):
            if loaded_site is site or (
                isinstance(site, str) and site in (given_site, loaded_site.name)
            ):
                return index
        self.sites.append(_load(site))
        self._given_sites.append(site)
        return len(self.sites) - 1

    def candidates(self, index: int) -> Candidates:
        """Candidates at a site, given by its index in `sites`."""
        if self._shared_candidates is not None:
            return self._shared_candidates
        if index not in self._candidates:
            self._candidates[index] = replace(self.config.setting, site=self.sites[index]).pool
        return self._candidates[index]

    def setting(self, index: int, scheme: Scheme) -> Setting:
        """Setting at a site, given by its index in `sites`, with one scheme."""
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
            scheme = schemes[_draw_within((0, len(schemes) - 1), rng)]
        budget = options["budget"] if "budget" in options else _draw_within(config.budgets, rng)
        failed = options.get("failed", [])
        _, max_failures = config.failure_counts
        if "failed" not in options and max_failures:
            candidate_count = len(self.candidates(site))
            failure_count = min(_draw_within(config.failure_counts, rng), candidate_count)
            failed = sorted(rng.choice(candidate_count, failure_count, replace=False).tolist())
        traffic_count = OTHER_TRAFFICS if config.traffics is None else config.traffics
        traffic = _draw_within((0, traffic_count - 1), rng)
        return Conditions(
            site=site,
            scheme=find_scheme(scheme),
            budget=int(budget),
            failed=failed,
            # the first traffic is part 0 of the run, which searches use too
            traffic=FIRST_TRAFFIC_PART + traffic if traffic else 0,
        )


class Scenarios(EpisodeSource):
    """Scenarios to choose among candidates, each made when first drawn; all are checked before."""

    def __init__(self, config: SubsetConfig) -> None:
        """Find slots for all sites of a configuration.

        Raises ValueError if slots or budget do not fit, or a site cannot be scored."""
        objective = self._objective = config.objective
        super().__init__(config, None if objective is None else objective.candidates)
        self.factored = isinstance(config, SelectConfig) and config.actions == "factored"
        pools = [self.candidates(index) for index in range(len(self.sites))]
        max_candidates = max(map(len, pools))
        self.slots = max_candidates if config.slots is None else config.slots
        # largest number of mounts, heights, headings, tilts and models of any site
        self.shape = tuple(np.max([pool.shape for pool in pools], axis=0).tolist())
        if max_candidates > self.slots:
            raise ValueError(f"slots must hold all {max_candidates} candidates, got {self.slots}")
        _, max_budget = config.budgets
        if max_budget > max_candidates:
            raise ValueError(_describe_budget(max_budget, max_candidates))
        if objective is None:
            self.check_scorable()
        self._scenarios: dict[tuple[int, str, int], Scenario] = {}  # by `Conditions.key`
        # if nothing is drawn, all episodes without options start alike
        self._only_episode: Episode | None = None

    def draw(self, rng: Rng, options: Options | None) -> Episode:
        """Draw an episode with these options of `reset`.

        Raises ValueError for an option that does not fit."""
        if not options and self._only_episode is not None:
            return self._only_episode
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
        if conditions.key not in self._scenarios:
            run = self.config.run.part(conditions.traffic)
            new_objective = objective or Objective(
                self.setting(conditions.site, conditions.scheme), run
            )
            keep_few(self._scenarios, conditions.key, Scenario(new_objective, self.slots))
        scenario = self._scenarios[conditions.key]
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
            self._only_episode = episode
        return episode


def _describe_budget(budget: int, count: int) -> str:
    """Error for a budget above `count`, the number of candidates."""
    return (
        f"budget must be at most the number of candidates, {count}, got {budget}: lower it, or "
        "add candidates"
    )


def keep_few(kept_values: dict[Key, Made], key: Key, value: Made) -> None:
    """Keep a value under its key, and forget the oldest of more than `MAX_KEPT_SCENARIOS`.

    kept_values: values kept so far, changed in place."""
    kept_values[key] = value
    if len(kept_values) > MAX_KEPT_SCENARIOS:
        oldest = next(iter(kept_values))  # dictionaries keep the order of insertion
        del kept_values[oldest]


def _load(site: Site | str) -> Site:
    """Site itself, or by its name or file. Raises ValueError for anything else."""
    if isinstance(site, Site):
        return site
    if not isinstance(site, str):
        raise ValueError(f"a site must be a Site, or the name or file of one, got {site!r}")
    return load_site(site)


def _draw_within(bounds: tuple[int, int], rng: np.random.Generator) -> int:
    """Random whole number from the lowest to the highest; equal bounds draw nothing."""
    low, high = bounds
    return low if low == high else int(rng.integers(low, high + 1))


def _check_options(options: Options | None) -> Options:
    """Options of `reset`, empty for None. Raises ValueError for an unknown or unsuitable one."""
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
