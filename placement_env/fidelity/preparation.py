"""`Preparation`: traffic, views, renders and detectors that the fidelities of one setting share,
made when needed. `CasesFidelity` combines those of single cases into one, see
`placement_env.cases`."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeVar, cast

import numpy as np

from models.config import SHIPPED
from placement_env.candidates.candidates import Candidates
from placement_env.cases import LEVEL_NAMES, Cases
from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.hit_model import HitModel, find_hit_model, load_models, shipped_model
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.table import Table, TableFidelity, hash_site, load_table
from placement_env.fidelity.traffic import FRAMES, Traffic, scored, simulate_traffic
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.protocol import (
    ByClass,
    ByFrames,
    ClassEstimates,
    Estimate,
    Fidelity,
    FidelityName,
)
from placement_env.setting import Rendering, Setting
from placement_env.subsets import Sets
from toolkit.arrays import Bool, Int64
from toolkit.detection.background import add_background
from toolkit.detection.scheme import surrogate_name
from toolkit.detection.schemes import SCHEMES
from toolkit.frozen import set_cached
from toolkit.objects import LABELS, Detector, check_known, quick_detector
from toolkit.runtime.run import Run
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from placement_env.fidelity.panorama import TrafficView

_Estimated = TypeVar("_Estimated", Estimate, ClassEstimates)


@dataclass(frozen=True)
class ProfileFidelities:
    """Scorers of sets with sensor errors of one profile."""

    whole: Fidelity  # in all frames, at the first IoU threshold
    levels: tuple[tuple[Fidelity, ...], ...]  # for each level of traffic, one for each threshold


class CasesFidelity:
    """Score sets over all cases: error profiles, IoU thresholds, levels of traffic and failures.

    kbit are for the intact set in all traffic: at the error profile with the least AP, or
    means over the profiles, as the cases combine them.

    Args:
        profiles: Scorers at each error profile, in the order of `cases.profiles`.
        cases: Cases, and how they are combined."""

    def __init__(self, profiles: Sequence[ProfileFidelities], cases: Cases) -> None:
        self._profiles = tuple(profiles)
        self.cases = cases
        self._first = profiles[0].whole
        self.detector = getattr(self._first, "detector", None)

    @property
    def name(self) -> str:
        """Name of the fidelity that all cases are scored by."""
        return self._first.name

    @property
    def classes(self) -> Classes:
        """Classes of the objects that count, and how they are combined."""
        return cast(ByClass, self._first).classes

    def __call__(self, subsets: Sets, /) -> Estimate:
        """AP, recall and kbit of each set over all cases."""
        return self._reduce(subsets, lambda fidelity, rows: fidelity(rows))

    def by_class(self, subsets: Sets, /) -> ClassEstimates:
        """AP and recall of each set for each class over all cases, and kbit of the set.

        Each class has its worst failure and level; the worst error profile is the one of all
        classes together."""
        by_profile = self._at_profiles(
            subsets, lambda fidelity, rows: cast(ByClass, fidelity).by_class(rows)
        )
        return ClassEstimates(
            *self._over_profiles(
                by_profile, [estimates.combined(self.classes).ap for estimates in by_profile]
            )
        )

    def at_each(self, subsets: Sets) -> dict[str, Estimate]:
        """AP, recall and kbit of each set over the other cases, by name of the error profile."""
        by_profile = self._at_profiles(subsets, lambda fidelity, rows: fidelity(rows))
        return dict(zip(self.cases.names, by_profile, strict=True))

    def _reduce(
        self, subsets: Sets, score: Callable[[Fidelity, Bool[np.ndarray, "m C"]], Estimate]
    ) -> Estimate:
        # figures of each set over all cases. score: returns a scorer's figures of rows of booleans
        by_profile = self._at_profiles(subsets, score)
        return Estimate(*self._over_profiles(by_profile, [estimate.ap for estimate in by_profile]))

    def _over_profiles(
        self, by_profile: list[_Estimated], ap: list[np.ndarray]
    ) -> list[np.ndarray]:
        """Each figure (AP, recall, kbit) of n sets over the error profiles.

        Args:
            by_profile: Figures at each profile.
            ap: AP (n,) at each profile, which chooses the worst profile of each set."""
        shares = self.cases.shares(np.stack(ap))  # (profile, set)
        figures = [np.stack(figure) for figure in zip(*by_profile, strict=True)]
        # weights get an axis of length 1 for each further axis of a figure, such as classes
        return [
            (shares.reshape(*shares.shape, *[1] * (figure.ndim - 2)) * figure).sum(axis=0)
            for figure in figures
        ]

    def _at_profiles(
        self, subsets: Sets, score: Callable[[Fidelity, Bool[np.ndarray, "m C"]], _Estimated]
    ) -> list[_Estimated]:
        # figures of each set at each error profile, over thresholds, levels and failures. Rows are
        # the sets, then what remains after each failure
        rows, owners = self.cases.expand(subsets)
        by_profile = []
        for profile in self._profiles:
            scored = []
            for level in profile.levels:
                scored.append([score(fidelity, rows) for fidelity in level])
            ap = self._combine(scored, "ap", owners)
            recall = self._combine(scored, "recall", owners)
            is_plain = profile.whole is profile.levels[0][0]
            intact = scored[0][0] if is_plain else score(profile.whole, subsets)
            by_profile.append(type(intact)(ap, recall, intact.kbit[: len(subsets)]))
        return by_profile

    def _combine(
        self,
        scored: list[list[_Estimated]],
        figure: Literal["ap", "recall"],
        owners: Int64[np.ndarray, " m"],
    ) -> np.ndarray:
        """One figure of each set over levels, IoU thresholds and failures.

        Args:
            scored: Figures of m rows for each level (outer list) and threshold (inner list).
            figure: Name of the figure.
            owners: Index of the set that each row belongs to."""
        by_level = []
        for level in scored:
            by_level.append([getattr(estimate, figure) for estimate in level])
        return np.asarray(self.cases.at_profiles(np.array([by_level]), owners)[0])


class CasesByFrames(CasesFidelity):
    """`CasesFidelity` that can also score sets on only some of the frames."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return cast(ByFrames, self._first).frames

    def partial(self, subsets: Sets, frames: Sequence[int]) -> Estimate:
        """AP, recall and kbit of each set over all cases, in these frames (indices)."""
        return self._reduce(
            subsets, lambda fidelity, rows: cast(ByFrames, fidelity).partial(rows, frames)
        )


def over_cases(profiles: Sequence[ProfileFidelities], cases: Cases) -> Fidelity:
    """Scorer of sets over all cases, from the scorers at each error profile.

    If there is only one case, it is that scorer itself. It can score some frames if all can."""
    if cases.plain and len(profiles) == 1:
        return profiles[0].whole
    fidelities = [
        fidelity for profile in profiles for level in profile.levels for fidelity in level
    ]
    kind = (
        CasesByFrames
        if all(isinstance(fidelity, ByFrames) for fidelity in fidelities)
        else CasesFidelity
    )
    return kind(profiles, cases)


GENERAL = "general"  # the network not trained at any site
KEPT_DETECTORS = 4  # sites whose shipped detector is held in memory
BY_LEVELS = ("coverage", "surrogate")  # fidelities that can score levels of traffic separately
_DETECTORS: dict[tuple[str, str], Detector] = {}  # by network and text of the site's file


@dataclass(frozen=True, eq=False)
class Preparation:
    """Traffic, visibility, detector and models of a setting, each made when first needed.

    Fidelities (scorers of sets) of the setting are built from these and share them.

    Attributes:
        setting: Site, candidates, fusion scheme, fidelity and cases.
        run: Number of frames, seed, cache and processes.
        stride: Step between the simulated frames that count.
        compares: True if sets are only compared, for which the detector is replaced by its
            `quick_detector`."""

    setting: Setting
    run: Run = Run()
    stride: int = 1
    compares: bool = False

    @property
    def frames(self) -> int:
        """Number of frames that count."""
        # -(-a // b) rounds a / b up
        return -(-self.run.frames_or(FRAMES) // self.stride)

    @cached_property
    def traffic(self) -> Traffic:
        """Simulated frames that count."""
        return simulate_traffic(
            self.setting.place, self.run.frames_or(FRAMES), self.run.seed
        ).every(self.stride)

    def split(self, levels: int) -> tuple[Int64[np.ndarray, " _"], ...]:
        """Indices of the frames of each level of traffic, thin traffic first.

        Frames are ranked by the number of road users of any class in the site's area, and split in
        nearly equal parts."""
        snapshots = self.traffic.snapshots
        everyone = range(len(LABELS))
        road_users = [
            scored(snapshot.objects, self.setting.place, everyone).sum() for snapshot in snapshots
        ]
        return Cases(levels=levels).split(np.array(road_users, np.int64))

    @cached_property
    def levels(self) -> tuple[Int64[np.ndarray, " _"], ...]:
        """Indices of the frames of each level of the setting's cases; empty without levels."""
        count = self.setting.cases.levels
        return self.split(count) if count > 1 else ()

    @property
    def plain(self) -> "Preparation":
        """New preparation for intact sets in undivided traffic; nothing made here is shared."""
        return replace(
            self,
            setting=replace(self.setting, cases=replace(self.setting.cases, failing=0, levels=1)),
        )

    def count_at_levels(self) -> dict[str, int]:
        """Number of objects that count at each level of traffic, by name of the level."""
        names = LEVEL_NAMES[self.setting.cases.levels]
        frame = self.visibility.frame
        return {
            name: int(np.isin(frame, frames_at_level).sum())
            for name, frames_at_level in zip(names, self.levels, strict=False)
        }

    @cached_property
    def unseen(self) -> Visibility:
        """Visibility without candidates: only the objects that count."""
        return Visibility.unseen(self.traffic, (), self.setting.counted.labels)

    @cached_property
    def visibility(self) -> Visibility:
        """Points of each candidate on the objects that count, rendered once."""
        from placement_env.fidelity.seeing import see

        setting = self.setting
        labels = setting.counted.labels
        return see(
            self.traffic, setting.pool, labels=labels, run=self.run, rendering=setting.rendering
        )

    @cached_property
    def live(self) -> "TrafficView | None":
        """View for sensors that move on the mounts, from panoramas.

        None if rays must be cast: if the setting's `rendering` is "full", or the range of a
        candidate ends within the site."""
        from placement_env.fidelity.panorama import TrafficView
        from placement_env.fidelity.seeing import choose_quick

        requested = self.setting.rendering
        # a panorama pays for moving sensors however few there are, as they come back to a place
        rendering: Rendering = "panorama" if requested == "auto" else requested
        if not choose_quick(self.setting.pool.sensors, self.traffic, rendering).all():
            return None
        return TrafficView(self.traffic, self.setting.counted.labels, self.run.memo)

    @cached_property
    def network(self) -> str:
        """Name of the shipped network for the candidates, see `find_network`."""
        return find_network(self.setting.place, self.setting.pool.sensors)

    @cached_property
    def detector(self) -> Detector:
        """The setting's detector, or the shipped one; its `quick_detector` if sets are compared."""
        detector = self.setting.detector or load_shipped_detector(self.network, self.setting.place)
        return quick_detector(detector) if self.compares else detector

    @cached_property
    def _hit_models(self) -> dict[float, tuple[HitModel, ...]]:
        # hit models of all classes by IoU threshold, filled by `at_thresholds` and shared by copies
        return {}

    def at(self, candidates: Candidates, visibility: Visibility) -> "Preparation":
        """Preparation for other candidates, with their visibility, in the same traffic.

        The network and the hit models stay too, whatever the candidates."""
        return self._share(self.setting.with_candidates(candidates), visibility)

    def at_cases(self, cases: Cases) -> "Preparation":
        """Preparation for other cases, with the same traffic, network and visibility."""
        return self._share(replace(self.setting, cases=cases), self.visibility)

    def _share(self, setting: Setting, visibility: Visibility) -> "Preparation":
        """Preparation of another setting with this one's traffic, network and hit models.

        visibility: Points of the other setting's candidates on the objects."""
        preparation = replace(self, setting=setting)
        shared = {name: getattr(self, name) for name in ("traffic", "network", "_hit_models")}
        set_cached(preparation, **shared, visibility=visibility)
        return preparation

    def with_traffic(self, traffic: Traffic, *, detector: Detector | None = None) -> "Preparation":
        """Copy in given traffic of this site; everything else is made again when needed.

        detector: Detector to use if it is open already, None to open the setting's when needed."""
        preparation = replace(self)
        set_cached(preparation, traffic=traffic)
        if detector is not None:
            set_cached(preparation, detector=detector)
        return preparation

    def share_traffic(self, preparation: "Preparation") -> "Preparation":
        """Copy in the traffic of another preparation at this site.

        It shares the other's view for moving sensors if the same classes count."""
        shared = self.with_traffic(preparation.traffic)
        if self.setting.counted.labels == preparation.setting.counted.labels:
            set_cached(shared, live=preparation.live)
        return shared

    def build_fidelity(self, candidates: Candidates, visibility: Visibility) -> Fidelity:
        """Scorer of sets of other candidates, with the setting's fidelity and cases.

        visibility: Their points on the objects of the same traffic."""
        if self._empty_surrogate is not None:
            return self._empty_surrogate.over(visibility)
        return self.at(candidates, visibility).fidelity()

    @cached_property
    def _empty_surrogate(self) -> Surrogate | None:
        """Surrogate without candidates, from which those with candidates are copied quickly.

        None unless the setting is scored by one surrogate: that fidelity, and one case."""
        setting = self.setting
        if setting.fidelity != "surrogate" or not setting.cases.plain:
            return None
        fidelity = self._share(setting, self.unseen).fidelity()
        return fidelity if isinstance(fidelity, Surrogate) else None

    def check(self) -> None:
        """Raise ValueError unless the setting's fidelity can score its candidates and cases.

        Nothing is rendered."""
        check_scorable(self.setting)
        _check_levels(self.setting, _checked_name(self.setting, None))

    def fidelity(self, name: FidelityName | None = None) -> Fidelity:
        """Scorer of sets of the candidates over the setting's cases.

        name: Kind of fidelity, None for the setting's. Raises ValueError for cases that it cannot
        score."""
        name = _checked_name(self.setting, name)
        cases = self.setting.cases
        _check_levels(self.setting, name)
        profiles = []
        for errors in cases.profiles:
            fidelities = self.at_thresholds(name, errors)
            levels: tuple[tuple[Fidelity, ...], ...] = (fidelities,)
            if cases.levels > 1:
                levels_traffic = [
                    self.at(self.setting.pool, of_frames(self.visibility, numbers))
                    for numbers in self.levels
                ]
                levels = tuple(numbers.at_thresholds(name, errors) for numbers in levels_traffic)
            profiles.append(ProfileFidelities(fidelities[0], levels))
        return over_cases(profiles, cases)

    def at_thresholds(self, name: FidelityName, errors: ErrorProfile) -> tuple[Fidelity, ...]:
        """Scorer of sets at each IoU threshold of the cases, without failures or levels of traffic.

        Args:
            name: Kind of fidelity.
            errors: Error profile of the sensors, which only a detector takes into account."""
        setting = self.setting
        ious = self.setting.cases.ious
        scheme = setting.fusion
        codec = setting.codec
        classes = setting.counted
        if name == "detector":
            detected = self.detected(errors)
            return tuple(detected.at(iou, ious) for iou in ious)
        if name == "coverage":
            return (Coverage(self.visibility, scheme, codec=codec, classes=classes),) * len(ious)
        if name == "table":
            return tuple(
                TableFidelity(self._table, scheme, iou, codec, classes=classes) for iou in ious
            )
        radius = setting.place.hybrid_radius
        surrogates = []
        for iou in ious:
            if iou not in self._hit_models:
                self._hit_models[iou] = surrogate_models(setting, iou, self.network)
            models = self._hit_models[iou]
            surrogates.append(
                Surrogate(
                    self.visibility, scheme, models, radius=radius, codec=codec, classes=classes
                )
            )
        return tuple(surrogates)

    def detected(self, errors: ErrorProfile) -> Detected:
        """Scorer of sets by the detector, with sensor errors of one profile.

        Its IoU threshold is the first one of the cases."""
        from placement_env.fidelity.renders import Renders

        setting = self.setting
        run = self.run
        return Detected(
            Renders(self.traffic, setting.pool, run.memo, errors=errors),
            self.detector,
            setting.fusion,
            codec=setting.codec,
            iou=setting.cases.ious[0],
            memo=run.memo,
            processes=run,
            classes=setting.counted,
        )

    @cached_property
    def _table(self) -> Table:
        # table of the setting or the site; ValueError if it was measured with other sensors
        site = self.setting.place
        path = self.setting.table
        table = load_table(site.name if path is None else path)
        origin = table.origin
        place_hash = hash_site(site, self.setting.pool.sensors)
        if (origin.place, origin.hybrid_radius) != (place_hash, site.hybrid_radius):
            raise ValueError(
                f"the table of {site.name!r} is of its own {len(origin.sensors)} sensors where "
                "they hang, not of these candidates or this version of the site: say another "
                "--fidelity, or run coview table"
            )
        return table


def check_scorable(setting: Setting, fidelity: FidelityName | None = None) -> None:
    """Raise ValueError if the table, surrogate or detector of a setting cannot score its sets.

    Nothing is rendered.

    fidelity: Kind of fidelity to check, None for the setting's."""
    name = _checked_name(setting, fidelity)
    for path, site_names, what in (
        (setting.surrogate, "surrogate", "file of surrogates"),
        (setting.table, "table", "table"),
    ):
        if path is not None and name != site_names:
            raise ValueError(
                f"a {what} is for fidelity {site_names}, got {name!r}: leave one of them out"
            )
    sensors = setting.pool.sensors
    classes = setting.counted
    if name == "surrogate":
        for iou in setting.cases.ious:
            surrogate_models(setting, iou, find_network(setting.place, sensors))
    if name == "table":
        Preparation(setting).fidelity(name)
    if name == "detector" and setting.detector is not None:
        check_known(setting.detector, classes.names)
    elif name == "detector" and classes.names != VEHICLES.names:
        from models.detector import load_detector

        check_known(
            load_detector(find_network(setting.place, sensors), area=setting.place.area),
            classes.names,
        )


def _checked_name(setting: Setting, name: FidelityName | None) -> FidelityName:
    """Return the kind of fidelity, after a check that it can score the setting's sensor errors.

    name: Kind of fidelity, None for the setting's. Raises ValueError if the setting has a scorer
    and no name, or for errors that only a detector can score."""
    if name is None and not isinstance(setting.fidelity, str):
        raise ValueError(
            f"a preparation makes fidelities by name, got {setting.fidelity!r}: give its name"
        )
    name = name or cast(FidelityName, setting.fidelity)
    cases = setting.cases
    if name != "detector" and not cases.noise_only:
        problem = f"errors {cases.errors_text} are known to fidelity detector alone, got {name!r}"
        raise ValueError(f"{problem}: say --fidelity detector")
    return name


def _check_levels(setting: Setting, name: FidelityName) -> None:
    # ValueError if the cases have levels of traffic and this kind of fidelity cannot score them
    if setting.cases.levels > 1 and name not in BY_LEVELS:
        raise ValueError(
            f"levels of traffic are known to fidelity {' and '.join(BY_LEVELS)}, got {name!r}"
        )


def surrogate_models(setting: Setting, iou: float, network: str) -> tuple[HitModel, ...]:
    """Hit model of each class that counts, from the setting's file or the shipped ones.

    Args:
        setting: Fusion scheme, classes and path of a file of hit models.
        iou: IoU threshold of vehicles; `Classes.get_iou` gives the ones for other classes.
        network: Name of the network whose shipped models are taken.

    Raises ValueError for a missing model, FileNotFoundError for a missing file."""
    classes = setting.counted
    scheme = setting.fusion
    path = setting.surrogate
    thresholds = [(name, classes.get_iou(name, iou)) for name in classes.names]
    if path is None:
        return tuple(
            shipped_model(surrogate_name(scheme), at, network, label=name)
            for name, at in thresholds
        )
    models = load_models(path, schemes=(*SCHEMES, scheme.name))
    return tuple(
        find_hit_model(models, surrogate_name(scheme), at, name, source=str(path))
        for name, at in thresholds
    )


def load_shipped_detector(network: str, site: Site) -> Detector:
    """Load a shipped network as the detector at a site, once for all preparations.

    The general network was not trained there and would take a hedge for a vehicle in every frame,
    so it gets the empty site as background. The last `KEPT_DETECTORS` are kept.

    network: Name of the network, from `find_network`."""
    from models.detector import load_detector

    key = network, format_site(site)
    if key not in _DETECTORS:
        detector = load_detector(network, area=site.area)
        _DETECTORS[key] = add_background(detector, site) if network == GENERAL else detector
        if len(_DETECTORS) > KEPT_DETECTORS:
            del _DETECTORS[next(iter(_DETECTORS))]
    return _DETECTORS[key]


def find_network(site: Site, sensors: Iterable[Sensor]) -> str:
    """Name of the shipped network for some sensors at a site.

    It is the site's name, for a network trained there, if the site has all these sensors; else
    `GENERAL`."""
    is_trained_here = (
        set(sensors) <= set(site.sensors) and (SHIPPED / f"{site.name}.safetensors").exists()
    )
    return site.name if is_trained_here else GENERAL
