"""Episodes: the scenario of each, its budget, and which candidates have failed; drawn, or as options say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.checks import check_range
from placement_env.envs.config import ChoosingConfig, EnvConfig
from placement_env.envs.scenario import Scenario
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.arrays import Bool
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

OPTIONS = ("site", "scheme", "budget", "failed")


@dataclass(frozen=True, eq=False)
class Episode:
    """How an episode starts. budget: sensors to place; failed, chosen: over the slots, chosen those that stand from the
    start."""

    scenario: Scenario
    budget: int
    failed: Bool[np.ndarray, " slots"]
    chosen: Bool[np.ndarray, " slots"] | None = None


@dataclass(frozen=True, eq=False)
class Conditions:
    """What is drawn, or given by options, for an episode. site: its number; failed: what options give as candidates,
    by index or name."""

    site: int
    scheme: Scheme
    budget: int
    failed: Iterable[Any]


class Sites:
    """The sites of an environment and their candidates: one or several of these and their names, of
    which one is drawn for each episode, and those that options name later."""

    def __init__(self, site: Any, candidates: Candidates | Setting) -> None:
        several = isinstance(site, Sequence) and not isinstance(site, str)
        self._given: list[Any] = list(site) if several else [site]
        self._known = [_loaded(each) for each in self._given]
        self.drawn = len(self._known)
        if not self.drawn:
            raise ValueError("an environment needs a site, got none")
        self._asked = candidates
        self._candidates: dict[int, Candidates] = {}

    def __len__(self) -> int:
        return len(self._known)

    def __getitem__(self, index: int) -> Site:
        return self._known[index]

    def index(self, site: Site | str | None, rng: np.random.Generator) -> int:
        """Place of a site given by itself or name, of one drawn for None; a new one joins the others."""
        if site is None:
            return int(rng.integers(self.drawn)) if self.drawn > 1 else 0
        for index, (given, known) in enumerate(zip(self._given, self._known, strict=True)):
            if known is site or (isinstance(site, str) and site in (given, known.name)):
                return index
        self._known.append(_loaded(site))
        self._given.append(site)
        return len(self._known) - 1

    def candidates(self, index: int) -> Candidates:
        """Those of a site."""
        if index not in self._candidates:
            asked = self._asked
            known = asked if isinstance(asked, Candidates) else replace(asked, site=self[index]).pool
            self._candidates[index] = known
        return self._candidates[index]


def _loaded(site: Any) -> Site:
    if isinstance(site, Site):
        return site
    if not isinstance(site, str):
        raise ValueError(f"a site is a Site, or the name or file of one, got {site!r}")
    return load_site(site)


class Scenarios:
    """The scenarios of an environment that chooses among candidates, each made when it is first drawn.

    Raises ValueError where the sets of a site cannot be scored as asked, before anything is rendered.
    """

    def __init__(self, config: ChoosingConfig) -> None:
        self.config, objective = config, config.objective
        self.sites = Sites(config.site, objective.candidates if objective else config.setting)
        whole = [self.sites.candidates(index) for index in range(len(self.sites))]
        self.slots = max(map(len, whole)) if config.slots is None else config.slots
        self.shape = tuple(int(size) for size in np.max([each.shape for each in whole], axis=0))
        if max(map(len, whole)) > self.slots:
            raise ValueError(f"slots must hold all {max(map(len, whole))} candidates, got {self.slots}")
        if objective is None:
            check_scored(config, self.sites)
        self._made: dict[tuple[int, str], Scenario] = {}
        self._always: Episode | None = None  # where nothing is drawn, all episodes without options start alike

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any] | None) -> Episode:
        """An episode with these options. Raises ValueError for an option that there is not or does not fit."""
        if options:
            return self._drawn(rng, options)
        episode = self._always or self._drawn(rng, {})
        if not self.config.leaves_open and self.sites.drawn == 1:
            self._always = episode
        return episode

    def _drawn(self, rng: np.random.Generator, options: Mapping[str, Any]) -> Episode:
        objective, options = self.config.objective, check_options(options)
        other = "scheme" in options and objective and find_scheme(options["scheme"]) != objective.scheme
        if objective and ("site" in options or other):
            raise ValueError("an environment made from an objective keeps its site and scheme: make it from a site")
        conditions = draw_conditions(self.config, self.sites, rng, options)
        scenario = self._scenario(conditions)
        return Episode(scenario, conditions.budget, scenario.failed_row(conditions.failed))

    def _scenario(self, conditions: Conditions) -> Scenario:
        key = conditions.site, conditions.scheme.digest
        if key not in self._made:
            self._made[key] = Scenario(self.config.objective or self._objective(conditions), self.slots)
        return self._made[key]

    def _objective(self, conditions: Conditions) -> Objective:
        site, candidates = self.sites[conditions.site], self.sites.candidates(conditions.site)
        return Objective(self.config.setting_at(site, candidates, conditions.scheme), self.config.run)


def check_scored(config: EnvConfig, sites: Sites) -> None:
    """Raise ValueError where no table, surrogate or detector scores the candidates of a site as asked."""
    for index in range(len(sites)):
        for scheme in config.schemes:
            Preparation(config.setting_at(sites[index], sites.candidates(index), scheme)).check()


def draw_conditions(
    config: EnvConfig, sites: Sites, rng: np.random.Generator, options: Mapping[str, Any]
) -> Conditions:
    """Site, scheme, budget and failed candidates of an episode: as the options say, else drawn, in this order. What the
    config leaves open nothing of takes nothing from the generator."""
    site = sites.index(options.get("site"), rng)
    schemes = config.schemes
    scheme = options["scheme"] if "scheme" in options else schemes[_within((0, len(schemes) - 1), rng)]
    scheme = find_scheme(scheme)
    budget = options["budget"] if "budget" in options else _within(config.budgets, rng)
    failed = options["failed"] if "failed" in options else _failures(config, sites, site, rng)
    return Conditions(site, scheme, int(budget), failed)


def _failures(config: EnvConfig, sites: Sites, site: int, rng: np.random.Generator) -> list[int]:
    if not config.failure_counts[1]:
        return []
    count = len(sites.candidates(site))
    number = min(_within(config.failure_counts, rng), count)
    return sorted(rng.choice(count, number, replace=False).tolist())


def _within(ends: tuple[int, int], rng: np.random.Generator) -> int:
    return ends[0] if ends[0] == ends[1] else int(rng.integers(ends[0], ends[1] + 1))


def check_options(options: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Options of `reset`, or ValueError for one that there is not or that is of no use."""
    options = options or {}
    if unknown := set(options) - set(OPTIONS):
        raise ValueError(f"options are {', '.join(OPTIONS)}, got {', '.join(map(repr, sorted(unknown)))}")
    budget, failed = options.get("budget", 1), options.get("failed", ())
    if isinstance(budget, list | tuple):
        raise ValueError(f"budget of an episode must be a whole number, got {budget!r}")
    check_range("budget", budget, least=1, unit="sensor")
    if isinstance(failed, str) or not isinstance(failed, Iterable):
        raise ValueError(f"failed must be a list of candidates, by index or name, got {failed!r}")
    return options
