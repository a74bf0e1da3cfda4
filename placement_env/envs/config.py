"""What an environment is made with: one frozen record per environment, checked whole before anything is rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from placement_env.checks import check_iou, check_range, check_whole
from placement_env.classes import VEHICLES, Classes, classes_of
from placement_env.fidelity.visibility import check_rendering
from placement_env.objective import Objective
from placement_env.protocol import FidelityName, check_fidelity
from placement_env.setting import AP_ONLY, Rendering, Weights
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import find_scheme
from toolkit.objects import Detector

Actions = Literal["flat", "factored"]
ACTIONS = ("flat", "factored")
Config = TypeVar("Config", bound="EnvConfig")


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvConfig:
    """What all environments are made with.

    site: a site, its name or file, or several of these; budget: sensors to place; scheme: of fusion, or several;
    failures: how many candidates have failed. Of several sites and schemes each episode draws one, of a budget or
    failures given as (lowest, highest) it draws the number, and then which candidates have failed, all by the
    environment's own generator; options of `reset` go before. fidelity, frames, weights, candidates, detector, codec,
    iou, seed, classes, surrogate, rendering: of `placement_env.objective.Objective`.

    Raises ValueError for a setting that does not fit.
    """

    site: Any = "tjunction"
    budget: int | Sequence[int] = 4
    scheme: Scheme | str | Sequence[Scheme | str] = "early"
    failures: int | Sequence[int] = 0
    fidelity: FidelityName = "surrogate"
    frames: int = 200
    weights: Weights = AP_ONLY
    candidates: Any = None
    detector: Detector | None = None
    codec: Codec = PAPER
    iou: float = 0.7
    seed: int = 0
    classes: Classes | Iterable[str] = VEHICLES
    surrogate: str | Path | None = None
    rendering: Rendering = "auto"

    def __post_init__(self) -> None:
        object.__setattr__(self, "classes", classes_of(self.classes))
        check_range("budget", self.budget, least=1, unit="sensor")
        check_range("failures", self.failures, least=0, unit="candidates")
        if not self.schemes:
            raise ValueError("scheme must be one or several schemes, got none")
        check_fidelity(self.fidelity)
        check_whole("frames", self.frames, least=1)
        check_whole("seed", self.seed, least=0)
        if not isinstance(self.weights, Weights):
            raise ValueError(f"weights must be Weights, got {self.weights!r}: pass Weights(comm=..., price=...)")
        check_iou(self.iou)
        check_codec(self.codec)
        check_rendering(self.rendering)
        if self.detector is not None and not callable(self.detector):
            raise ValueError(f"detector must be a function of a cloud's points, or None, got {self.detector!r}")

    @cached_property
    def schemes(self) -> tuple[Scheme, ...]:
        """Those of which an episode draws one."""
        several = self.scheme if isinstance(self.scheme, list | tuple) else (self.scheme,)
        return tuple(find_scheme(scheme) for scheme in several)

    @property
    def counted(self) -> Classes:
        """The classes of road users that count."""
        return classes_of(self.classes)

    @cached_property
    def budgets(self) -> tuple[int, int]:
        """Lowest and highest budget of an episode."""
        return _bounds(self.budget)

    @cached_property
    def failure_counts(self) -> tuple[int, int]:
        """How many candidates have failed at least and at most."""
        return _bounds(self.failures)

    @property
    def leaves_open(self) -> bool:
        """Whether an episode draws its scheme, budget or failed candidates."""
        return len(self.schemes) > 1 or len({*self.budgets}) > 1 or self.failure_counts[1] > 0


@dataclass(frozen=True, kw_only=True, eq=False)
class SubsetConfig(EnvConfig):
    """What `coview/SensorSubset-v0` is made with.

    slots: for candidates, None for what the largest of the sites needs; objective: in place of a site and of how its
    sets are scored; table, cache, workers, ray: of `placement_env.objective.Objective`.
    """

    slots: int | None = None
    table: str | Path | None = None
    objective: Objective | None = None
    cache: str | Path | None = None
    workers: int = 1
    ray: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_choosing(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class SelectConfig(SubsetConfig):
    """What `coview/SensorSelect-v0` is made with. actions: flat or factored; the others as of `SubsetConfig`."""

    actions: Actions = "flat"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.actions not in ACTIONS:
            raise ValueError(f"actions must be flat or factored, got {self.actions!r}")


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseConfig(EnvConfig):
    """What `coview/SensorPose-v0` is made with. moves: steps of an episode; cache: folder where panoramas are kept,
    None for nowhere."""

    moves: int = 20
    cache: str | Path | None = None

    def __post_init__(self) -> None:
        if self.fidelity == "table":
            raise ValueError("a table knows no poses but the site's own: take fidelity surrogate, coverage or detector")
        super().__post_init__()
        check_whole("moves", self.moves, least=1)


ChoosingConfig = SelectConfig | SubsetConfig


def gathered(kind: Callable[..., Config], config: Config | None, settings: dict[str, Any]) -> Config:
    """A config of some kind with single settings given by name, as Gymnasium's `make` gives them. Raises TypeError for
    a setting that there is not and for a config of another kind."""
    if config is None:
        return kind(**settings)
    if type(config) is not kind:
        raise TypeError(f"config must be a {kind.__name__}, got {config!r}: give single settings by name, as site=...")
    return replace(config, **settings)


def _bounds(number: int | Sequence[int]) -> tuple[int, int]:
    """Lowest and highest of a number that may be given as a range."""
    low, high = (number, number) if isinstance(number, int | np.integer) else number
    return int(low), int(high)


def _check_choosing(config: ChoosingConfig) -> None:
    check_whole("slots", 1 if config.slots is None else config.slots, least=1)
    check_whole("workers", config.workers, least=1)
    if config.objective is None:
        return
    if not isinstance(config.objective, Objective):
        raise ValueError(f"objective must be an Objective, got {config.objective!r}")
    if isinstance(config.site, list | tuple) or isinstance(config.scheme, list | tuple):
        raise ValueError("an environment made from an objective keeps its site and scheme: make it from a site")
    if config.counted not in (VEHICLES, config.objective.classes):
        raise ValueError("an environment made from an objective keeps its classes: give them to the objective")
