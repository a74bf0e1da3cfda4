"""Scenes: what an episode of an environment is played at, an objective with what of it an agent may observe.

A scene pads its candidates to a number of slots, so that one policy meets sites with different numbers of them. What a
candidate sees is taken at up to `PLACES` places: vehicles of the traffic where it is known, else spots of the area.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np

from placement_env.candidates.aim import aims
from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.coverage import LEAST
from placement_env.fidelity.preparation import site_candidates
from placement_env.objective import Objective, check_fidelity
from toolkit.arrays import Bool, Float32, Float64, Int64, Shaped
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, scheme_of
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

PLACES = 512
STATIC = ("x", "y", "z", "cos heading", "sin heading", "tilt", "field of view", "lidar", "price", "kbit", "seen")
REACH = 30.0  # m within which a sensor is taken to see the spots in its field of view, where no traffic is known
OPTIONS = ("site", "scheme", "budget", "failed")


@dataclass(frozen=True, eq=False)
class Scene:
    """An objective, its C candidates in `slots` slots."""

    objective: Objective
    slots: int

    def __post_init__(self) -> None:
        if len(self.objective.candidates) > self.slots:
            raise ValueError(
                f"the environment has slots for {self.slots} candidates, this site has "
                f"{len(self.objective.candidates)}: make it with slots={len(self.objective.candidates)}"
            )

    @cached_property
    def mount(self) -> Int64[np.ndarray, " slots"]:
        """Mount of each candidate; the empty slots share one that there is not."""
        return padded(self.objective.candidates.mount, self.slots, fill=len(self.objective.candidates.mounts))

    @cached_property
    def _mounts(self) -> int:
        return int(self.mount.max()) + 1

    def taken(self, chosen: Bool[np.ndarray, "n slots"]) -> Bool[np.ndarray, "n slots"]:
        """Which candidates hang on a mount of which a candidate is chosen."""
        taken = np.zeros((len(chosen), self._mounts), np.bool_)
        board, slot = chosen.nonzero()
        taken[board, self.mount[slot]] = True
        return taken.take(self.mount, axis=1)

    @cached_property
    def usable(self) -> Bool[np.ndarray, " slots"]:
        """Which slots hold a candidate whose link carries what it sends."""
        return padded(self.objective.linked, self.slots)

    @cached_property
    def seen(self) -> Shaped[np.ndarray, "words slots"]:
        """Which places each candidate sees, a bit each."""
        seen = self._places_seen
        whole = np.zeros((self.slots, PLACES), np.bool_)
        whole[: len(seen), : seen.shape[1]] = seen
        return np.ascontiguousarray(np.packbits(whole, axis=1).view(np.uint64).T)

    @cached_property
    def places(self) -> int:
        """How many places there are."""
        return self._places_seen.shape[1]

    @cached_property
    def _places_seen(self) -> Bool[np.ndarray, "C places"]:
        return places_seen(self.objective)

    @cached_property
    def static(self) -> Float32[np.ndarray, "features slots"]:
        """`STATIC` of each candidate, in -1..1; 0 in the empty slots. x and y are relative to the area, whose sides lie
        at ±0.5; z is in units of 20 m, tilt of a right angle, the field of view of a full turn; price and kbit are
        x / (x + 1) of the price, and of what is sent in Mbit; seen is a share of the places."""
        features = np.zeros((len(STATIC), self.slots), np.float32)
        own = np.bitwise_count(self.seen).sum(axis=0) / max(1, self.places)
        described = candidate_features(self.objective, own[: len(self.objective.candidates)])
        features[:, : described.shape[1]] = np.clip(described, -1, 1)
        return features

    @cached_property
    def constants(self) -> Float32[np.ndarray, "5"]:
        """The last of what is observed of the whole: weights, of a kbit in Mbit, as x / (x + 1), and the scheme."""
        weights = np.array([1000 * self.objective.weights.comm, self.objective.weights.price])
        scheme = [self.objective.scheme.name == name for name in PAPER_SCHEMES]
        return np.concatenate([weights / (weights + 1), scheme]).astype(np.float32)

    def failed_row(self, failed: Sequence[int | str]) -> Bool[np.ndarray, " slots"]:
        """Candidates, given by index or name, as a row over the slots."""
        return padded(self.objective.row(failed), self.slots)


@dataclass(frozen=True, eq=False)
class Start:
    """How an episode starts: at which scene, with how many sensors to place, and which candidates out of order."""

    scene: Scene
    budget: int
    failed: Bool[np.ndarray, " slots"]


class Sites:
    """The sites that an environment is played at: one or several of these and their names, of which one is drawn for
    each episode, and those that options name later."""

    def __init__(self, site: Any) -> None:
        several = isinstance(site, Sequence) and not isinstance(site, str)
        self._given: list[Any] = list(site) if several else [site]
        self._known = [_loaded(each) for each in self._given]
        self._drawn = len(self._known)
        if not self._drawn:
            raise ValueError("an environment needs a site, got none")

    def __len__(self) -> int:
        return len(self._known)

    def __getitem__(self, index: int) -> Site:
        return self._known[index]

    def index(self, site: Site | str | None, rng: np.random.Generator) -> int:
        """Place of a site given by itself or name, of one drawn for None; a new one joins the others."""
        if site is None:
            return int(rng.integers(self._drawn)) if self._drawn > 1 else 0
        for index, (given, known) in enumerate(zip(self._given, self._known, strict=True)):
            if known is site or (isinstance(site, str) and site in (given, known.name)):
                return index
        self._known.append(_loaded(site))
        self._given.append(site)
        return len(self._known) - 1


def _loaded(site: Any) -> Site:
    if isinstance(site, Site):
        return site
    if not isinstance(site, str):
        raise ValueError(f"a site is a Site, or the name or file of one, got {site!r}")
    return load_site(site)


class Scenes:
    """The scenes of an environment, made when first played at.

    site: as of `Sites`; objective: in place of sites;
    arguments: further ones of `Objective`. slots: None for what the largest of the sites needs. Raises TypeError for an
    argument that there is not.
    """

    def __init__(
        self,
        site: Any,
        budget: int,
        scheme: Scheme | str,
        slots: int | None,
        objective: Objective | None,
        arguments: Mapping[str, Any],
    ) -> None:
        self.sites = Sites(site)
        self.budget, self.scheme, self.objective = check_budget(budget), scheme_of(scheme), objective
        signature(Objective).bind_partial(**arguments)
        check_fidelity(arguments.get("fidelity", "surrogate"))
        self._arguments = dict(arguments)
        self._made: dict[tuple[int, Scheme], Scene] = {}
        self._candidates: dict[int, Candidates] = {}
        whole = [objective.candidates] if objective else [self._candidates_of(i) for i in range(len(self.sites))]
        self.slots = max(map(len, whole)) if slots is None else slots
        self.shape = tuple(int(size) for size in np.max([each.shape for each in whole], axis=0))

    def start(self, rng: np.random.Generator, options: Mapping[str, Any] | None) -> Start:
        """Of an episode with these options. Raises ValueError for an option that there is not or does not fit."""
        options = checked(options)
        budget = options.get("budget", self.budget)
        scene = self._scene(options, rng)
        return Start(scene, int(budget), scene.failed_row(options.get("failed", ())))

    def _scene(self, options: Mapping[str, Any], rng: np.random.Generator) -> Scene:
        scheme = scheme_of(options.get("scheme", self.objective.scheme if self.objective else self.scheme))
        if self.objective is not None:
            if "site" in options or scheme != self.objective.scheme:
                raise ValueError("an environment made from an objective keeps its site and scheme: make it from a site")
            return self._made.setdefault((-1, scheme), Scene(self.objective, self.slots))
        index = self.sites.index(options.get("site"), rng)
        if (index, scheme) not in self._made:
            arguments = {**self._arguments, "candidates": self._candidates_of(index)}
            self._made[index, scheme] = Scene(Objective(self.sites[index], scheme=scheme, **arguments), self.slots)
        return self._made[index, scheme]

    def _candidates_of(self, index: int) -> Candidates:
        if index not in self._candidates:
            given = self._arguments.get("candidates")
            self._candidates[index] = site_candidates(self.sites[index], given)
        return self._candidates[index]


def checked(options: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Options of `reset`, or ValueError for one that there is not or that is of no use."""
    options = options or {}
    if unknown := set(options) - set(OPTIONS):
        raise ValueError(f"options are {', '.join(OPTIONS)}, got {', '.join(map(repr, sorted(unknown)))}")
    check_budget(options.get("budget", 1))
    failed = options.get("failed", ())
    if isinstance(failed, str) or not isinstance(failed, Iterable):
        raise ValueError(f"failed must be a list of candidates, by index or name, got {failed!r}")
    return options


def check_budget(budget: Any) -> int:
    """The budget, or ValueError where it is no whole number from 1 up."""
    if not isinstance(budget, int | np.integer) or isinstance(budget, bool) or budget < 1:
        raise ValueError(f"budget must be at least 1 sensor, a whole number, got {budget!r}")
    return int(budget)


def places_seen(objective: Objective) -> Bool[np.ndarray, "C places"]:
    """Which of the places each candidate sees: vehicles with enough points on them, or spots of the area in view."""
    if objective.visibility is not None:
        points = objective.visibility.points
        some = np.unique(np.linspace(0, points.shape[1] - 1, PLACES).round().astype(np.int64))[: points.shape[1]]
        return np.asarray(points[:, some] >= LEAST)
    xmin, ymin, xmax, ymax = area_of(objective)
    x, y = np.meshgrid(np.linspace(xmin, xmax, 22), np.linspace(ymin, ymax, 22))
    positions, headings, _, widths, _ = poses(objective.candidates)
    dx, dy = x.ravel() - positions[:, :1], y.ravel() - positions[:, 1:2]
    bearing = np.angle(np.exp(1j * (np.arctan2(dy, dx) - headings[:, None])))
    return np.asarray((np.abs(bearing) <= widths[:, None] / 2) & (np.hypot(dx, dy) <= REACH))


def area_of(objective: Objective) -> Float64[np.ndarray, "4"]:
    """xmin ymin xmax ymax of the detection area, or of all mounts where the site is not known."""
    if objective.site is not None:
        return objective.site.area
    feet = np.array([mount.position[:2] for mount in objective.candidates.mounts])
    return np.concatenate([feet.min(axis=0) - 1, feet.max(axis=0) + 1])


def poses(candidates: Candidates) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of each candidate position (C, 3), heading, tilt, horizontal field of view (rad), and whether it measures range,
    as a lidar does."""
    sensors = candidates.sensors
    lidar = np.array([sensor.model.measures == "range" for sensor in sensors], np.bool_)
    width = [sensor.model.horizontal_fov for sensor in sensors]
    return np.array([sensor.position for sensor in sensors]), *aims(sensors), np.array(width), lidar


def candidate_features(objective: Objective, seen: Float64[np.ndarray, " C"]) -> Float64[np.ndarray, "features C"]:
    """`STATIC` of each candidate; `seen`: the share of places that it sees."""
    position, heading, tilt, width, lidar = poses(objective.candidates)
    area = area_of(objective)
    middle, size = (area[:2] + area[2:]) / 2, area[2:] - area[:2]
    x, y = ((position[:, :2] - middle) / size).T
    price, megabit = objective.candidates.prices, objective.sent / 1000
    turned = (np.cos(heading), np.sin(heading), tilt / (np.pi / 2), width / (2 * np.pi))
    return np.stack([x, y, position[:, 2] / 20, *turned, lidar, price / (price + 1), megabit / (megabit + 1), seen])


def padded(row: Shaped[np.ndarray, " C"], slots: int, fill: int = 0) -> Shaped[np.ndarray, " slots"]:
    """A row over the candidates as one over the slots."""
    return np.concatenate([row, np.full(slots - len(row), fill, row.dtype)])
