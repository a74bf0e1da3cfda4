"""Configurations of environments, checked before anything is rendered."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import cached_property
from typing import Any, Literal, TypeVar, get_args

import numpy as np

from placement_env.checks import check_choice, check_range, check_whole
from placement_env.defaults import VEHICLES
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.runtime.run import Run
from toolkit.sites.site import Site

Actions = Literal["flat", "factored"]
Config = TypeVar("Config", bound="EnvConfig")
DEFAULT_SITE = "tjunction"
SETTING_FIELDS = {field.name for field in fields(Setting)} - {"site", "scheme"}
RUN_FIELDS = {field.name for field in fields(Run)}


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvConfig:
    """Configuration that all environments share. Raises ValueError if a field does not fit.

    Attributes:
        setting: Question that sets are scored by.
        run: Frames, seed, cache and processes.
        site: One or several sites, None for the setting's.
        scheme: One or several schemes, None for the setting's.
        budget: Sensors to place.
        failures: Number of failed candidates.
        traffics: Number of independent simulations of the traffic, None to simulate for every
            episode, so that nothing is learnt of single vehicles.

    Episodes draw one of several sites, schemes and traffics, a number from (lowest, highest), and
    the failed candidates, by the environment's generator; options of `reset` come first.
    """

    setting: Setting = Setting()
    run: Run = Run()
    site: Site | str | Sequence[Site | str] | None = None
    scheme: Scheme | str | Sequence[Scheme | str] | None = None
    budget: int | Sequence[int] = 4
    failures: int | Sequence[int] = 0
    traffics: int | None = 1

    def __post_init__(self) -> None:
        """Raise ValueError if a field does not fit."""
        check_whole("traffics", 1 if self.traffics is None else self.traffics, least=1)
        if self.traffics != 1 and self.setting.fidelity == "table":
            raise ValueError(
                "a table is of its own traffic: leave traffics out, or take another fidelity"
            )
        check_range("budget", self.budget, least=1, unit="sensor")
        check_range("failures", self.failures, least=0, unit="candidates")
        if not self.sites:
            raise ValueError("site must be one or several sites, got none")
        if not self.schemes:
            raise ValueError("scheme must be one or several schemes, got none")

    @property
    def sites(self) -> tuple[Site | str, ...]:
        """Sites from which an episode draws one."""
        if self.site is None:
            return (DEFAULT_SITE if self.setting.site is None else self.setting.site,)
        if isinstance(self.site, Sequence) and not isinstance(self.site, str):
            return tuple(self.site)
        return (self.site,)

    @cached_property
    def schemes(self) -> tuple[Scheme, ...]:
        """Schemes from which an episode draws one."""
        if self.scheme is None:
            return (self.setting.fusion,)
        several = self.scheme if isinstance(self.scheme, list | tuple) else (self.scheme,)
        return tuple(find_scheme(scheme) for scheme in several)

    @cached_property
    def budgets(self) -> tuple[int, int]:
        """Lowest and highest budget of an episode."""
        return _bounds(self.budget)

    @cached_property
    def failure_counts(self) -> tuple[int, int]:
        """Lowest and highest number of failed candidates."""
        return _bounds(self.failures)

    @property
    def leaves_open(self) -> bool:
        """True if an episode draws its scheme, budget, failed candidates or traffic."""
        min_budget, max_budget = self.budgets
        _, max_failures = self.failure_counts
        draws_traffic_or_scheme = self.traffics != 1 or len(self.schemes) > 1
        return draws_traffic_or_scheme or min_budget != max_budget or max_failures > 0


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetConfig(EnvConfig):
    """Configuration of `coview/SensorSubset-v0`.

    slots: for candidates, None for as many as the largest site needs; objective: in place of
    setting, run, site and scheme.
    """

    slots: int | None = None
    objective: Objective | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if a field does not fit, or differs from the objective's."""
        super().__post_init__()
        check_whole("slots", 1 if self.slots is None else self.slots, least=1)
        if self.objective is None:
            return
        if not isinstance(self.objective, Objective):
            raise ValueError(f"objective must be an Objective, got {self.objective!r}")
        # a list or tuple: several sites or schemes, from which each episode draws one
        if isinstance(self.site, list | tuple) or isinstance(self.scheme, list | tuple):
            raise ValueError(
                "an environment made from an objective keeps its site and scheme: make it from a "
                "site"
            )
        # `VEHICLES` is the default of a setting, so nobody asked for other classes
        if self.setting.counted not in (VEHICLES, self.objective.classes):
            raise ValueError(
                "an environment made from an objective keeps its classes: give them to the "
                "objective"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectConfig(SubsetConfig):
    """Configuration of `coview/SensorSelect-v0`. actions: flat or factored."""

    actions: Actions = "flat"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("actions", self.actions, get_args(Actions))


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseConfig(EnvConfig):
    """Configuration of `coview/SensorPose-v0`. moves: steps of an episode."""

    moves: int = 20

    def __post_init__(self) -> None:
        """Raise ValueError if a field does not fit."""
        if self.setting.fidelity == "table":
            raise ValueError(
                "a table knows no poses but the site's own: take fidelity surrogate, coverage or "
                "detector"
            )
        super().__post_init__()
        check_whole("moves", self.moves, least=1)


def build_config(
    kind: type[Config], config: Config | None, options: Mapping[str, object]
) -> Config:
    """Configuration from another one and fields by name, also fields of `Setting`, `Run`, and
    `iou`.

    Args:
        kind: Class of the configuration.
        config: Configuration whose other fields stay, None for the usual ones.
        options: Fields by name; "iou" is the threshold of the setting's cases.

    Raises TypeError for an unknown name and for a configuration of another kind.
    """
    config = kind() if config is None else config
    if type(config) is not kind:
        raise TypeError(
            f"config must be a {kind.__name__}, got {config!r}: give single settings by name, as "
            "site=..."
        )
    config_names = {field.name for field in fields(kind)}
    known_names = config_names | SETTING_FIELDS | RUN_FIELDS | {"iou"}
    for name in options:
        if name not in known_names:
            raise TypeError(_describe_unknown(name, known_names, kind))
    config_fields: dict[str, Any] = dict(options)
    setting_fields = {name: config_fields.pop(name) for name in options if name in SETTING_FIELDS}
    run_fields = {name: config_fields.pop(name) for name in options if name in RUN_FIELDS}
    if "iou" in config_fields:
        setting_fields["cases"] = replace(
            setting_fields.get("cases", config.setting.cases), iou=config_fields.pop("iou")
        )
    if setting_fields:
        config_fields["setting"] = replace(
            config_fields.get("setting", config.setting), **setting_fields
        )
    if run_fields:
        config_fields["run"] = replace(config_fields.get("run", config.run), **run_fields)
    return replace(config, **config_fields)


def _describe_unknown(name: str, known: Collection[str], kind: type[EnvConfig]) -> str:
    """Sentence on an unknown keyword, with the nearest known one, or all if no other is similar."""
    suggestions = get_close_matches(name, sorted(known), n=1, cutoff=0.5)
    remedy = f"take one of {', '.join(sorted(known))}"
    if suggestions:
        remedy = f"did you mean {suggestions[0]!r}?"
    return f"{kind.__name__} has no {name!r}: {remedy}"


def _bounds(number: int | Sequence[int]) -> tuple[int, int]:
    """Lowest and highest of a range, which may be a single number."""
    low, high = (number, number) if isinstance(number, int | np.integer) else number
    return int(low), int(high)
