"""Configurations of environments: a frozen dataclass each, checked whole before anything is rendered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.checks import check_range, check_whole
from placement_env.classes import VEHICLES
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.runtime.run import Run
from toolkit.sites.site import Site

Actions = Literal["flat", "factored"]
ACTIONS = ("flat", "factored")
Config = TypeVar("Config", bound="EnvConfig")
OF_SETTING = {field.name for field in fields(Setting)} - {"site", "scheme"}
OF_RUN = {field.name for field in fields(Run)}


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvConfig:
    """Configuration that all environments have.

    site: a site, its name or file, or several of these; budget: sensors to place; scheme: of fusion, or several;
    failures: number of candidates that have failed. Of several sites and schemes each episode draws one, of a budget or
    failures given as (lowest, highest) it draws the number, and then which candidates have failed, all by the
    environment's own generator; options of `reset` go before. setting: all else that is asked, at every site and
    scheme; run: how sets are scored.

    Raises ValueError for a field that does not fit.
    """

    site: Any = "tjunction"
    budget: int | Sequence[int] = 4
    scheme: Scheme | str | Sequence[Scheme | str] = "early"
    failures: int | Sequence[int] = 0
    setting: Setting = Setting()
    run: Run = Run()

    def __post_init__(self) -> None:
        check_range("budget", self.budget, least=1, unit="sensor")
        check_range("failures", self.failures, least=0, unit="candidates")
        if not self.schemes:
            raise ValueError("scheme must be one or several schemes, got none")

    def setting_at(self, site: Site, candidates: Candidates, scheme: Scheme) -> Setting:
        """Setting of an episode at one site."""
        return replace(self.setting, site=site, candidates=candidates, scheme=scheme)

    @cached_property
    def schemes(self) -> tuple[Scheme, ...]:
        """Schemes of which an episode draws one."""
        several = self.scheme if isinstance(self.scheme, list | tuple) else (self.scheme,)
        return tuple(find_scheme(scheme) for scheme in several)

    @cached_property
    def budgets(self) -> tuple[int, int]:
        """Lowest and highest budget of an episode."""
        return _bounds(self.budget)

    @cached_property
    def failure_counts(self) -> tuple[int, int]:
        """Least and greatest number of candidates that have failed."""
        return _bounds(self.failures)

    @property
    def leaves_open(self) -> bool:
        """True where an episode draws its scheme, budget or failed candidates."""
        return len(self.schemes) > 1 or len({*self.budgets}) > 1 or self.failure_counts[1] > 0


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetConfig(EnvConfig):
    """Configuration of `coview/SensorSubset-v0`.

    slots: for candidates, None for what the largest of the sites needs; objective: in place of site, setting and run.
    """

    slots: int | None = None
    objective: Objective | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_whole("slots", 1 if self.slots is None else self.slots, least=1)
        if self.objective is None:
            return
        if not isinstance(self.objective, Objective):
            raise ValueError(f"objective must be an Objective, got {self.objective!r}")
        if isinstance(self.site, list | tuple) or isinstance(self.scheme, list | tuple):
            raise ValueError("an environment made from an objective keeps its site and scheme: make it from a site")
        if self.setting.counted not in (VEHICLES, self.objective.classes):
            raise ValueError("an environment made from an objective keeps its classes: give them to the objective")


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectConfig(SubsetConfig):
    """Configuration of `coview/SensorSelect-v0`. actions: flat or factored."""

    actions: Actions = "flat"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.actions not in ACTIONS:
            raise ValueError(f"actions must be flat or factored, got {self.actions!r}")


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseConfig(EnvConfig):
    """Configuration of `coview/SensorPose-v0`. moves: steps of an episode."""

    moves: int = 20

    def __post_init__(self) -> None:
        if self.setting.fidelity == "table":
            raise ValueError("a table knows no poses but the site's own: take fidelity surrogate, coverage or detector")
        super().__post_init__()
        check_whole("moves", self.moves, least=1)


ChoosingConfig = SelectConfig | SubsetConfig


def build_config(kind: type[Config], config: Config | None, settings: Mapping[str, Any]) -> Config:
    """Configuration of some kind with single settings given by name, as Gymnasium's `make` gives them.

    Fields of `Setting` and `Run` are given by their own names, and `iou` of `Cases`. Raises TypeError for an unknown
    name and for a configuration of another kind.
    """
    config = kind() if config is None else config
    if type(config) is not kind:
        raise TypeError(f"config must be a {kind.__name__}, got {config!r}: give single settings by name, as site=...")
    asked = {name: value for name, value in settings.items() if name in OF_SETTING}
    if "iou" in settings:
        asked["cases"] = replace(asked.get("cases", config.setting.cases), iou=settings["iou"])
    computed = {name: value for name, value in settings.items() if name in OF_RUN}
    own = {name: value for name, value in settings.items() if name not in {*asked, *computed, "iou"}}
    setting, run = replace(config.setting, **asked), replace(config.run, **computed)
    return replace(config, **{"setting": setting, "run": run, **own})


def _bounds(number: int | Sequence[int]) -> tuple[int, int]:
    low, high = (number, number) if isinstance(number, int | np.integer) else number
    return int(low), int(high)
