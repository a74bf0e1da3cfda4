"""`Preparation`: traffic, views, renders and detectors that the fidelities of one setting share,
made when needed."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.cases import LEVEL_NAMES, Cases
from placement_env.defaults import VEHICLES
from placement_env.fidelity.cases_fidelity import ProfileFidelities, over_cases
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.hit_model import HitModel
from placement_env.fidelity.shipped import find_network, load_shipped_detector, surrogate_models
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.table import Table, TableFidelity, hash_site, load_table
from placement_env.fidelity.traffic import FRAMES, Traffic, scored, simulate_traffic
from placement_env.fidelity.visibility import Visibility, of_frames
from placement_env.protocol import Fidelity, FidelityName
from placement_env.setting import Rendering, Setting
from toolkit.arrays import Int64
from toolkit.frozen import set_cached
from toolkit.objects import LABELS, Detector, check_known, quick_detector
from toolkit.runtime.run import Run
from toolkit.sensors.error_profile import ErrorProfile

if TYPE_CHECKING:
    from placement_env.fidelity.panorama import TrafficView

BY_LEVELS = ("coverage", "surrogate")  # fidelities that can score levels of traffic separately


@dataclass(frozen=True, eq=False)
class Preparation:
    """Traffic, visibility, detector and models of a setting, each made when first needed.

    Fidelities (scorers of sets) of the setting are built from these and share them.

    Attributes:
        setting: Site, candidates, fusion scheme, fidelity and cases.
        run: Number of frames, seed, cache and processes.
        stride: Step between the simulated frames that count.
        compares_sets: True if sets are only compared, for which the detector is replaced by its
            `quick_detector`."""

    setting: Setting
    run: Run = Run()
    stride: int = 1
    compares_sets: bool = False

    @property
    def frames(self) -> int:
        """Number of frames that count."""
        # -(-a // b) rounds a / b up
        return -(-self.run.frames_or(FRAMES) // self.stride)

    @cached_property
    def traffic(self) -> Traffic:
        """Simulated frames that count."""
        simulated = simulate_traffic(self.setting.place, self.run.frames_or(FRAMES), self.run.seed)
        return simulated.every(self.stride)

    def split(self, levels: int) -> tuple[Int64[np.ndarray, " _"], ...]:
        """Indices of the frames of each level of traffic, thin traffic first.

        Frames are ranked by the number of road users of any class in the site's area, and split
        into nearly equal parts.

        levels: Number of levels."""
        all_classes = range(len(LABELS))
        counts = []  # road users in each frame
        for snapshot in self.traffic.snapshots:
            is_in_area = scored(snapshot.objects, self.setting.place, all_classes)
            counts.append(is_in_area.sum())
        # only the number of levels of these cases matters
        return Cases(levels=levels).split(np.array(counts, np.int64))

    @cached_property
    def levels(self) -> tuple[Int64[np.ndarray, " _"], ...]:
        """Indices of the frames of each level of the setting's cases; empty without levels."""
        count = self.setting.cases.levels
        return self.split(count) if count > 1 else ()

    @property
    def intact_preparation(self) -> "Preparation":
        """New preparation for intact sets in undivided traffic; nothing made here is shared."""
        cases = replace(self.setting.cases, failing=0, levels=1)
        return replace(self, setting=replace(self.setting, cases=cases))

    def count_at_levels(self) -> dict[str, int]:
        """Number of objects that count at each level of traffic, by name of the level."""
        names = LEVEL_NAMES[self.setting.cases.levels]
        frame_of_object = self.visibility.frame
        # `strict` is off as levels without a frame are left out
        return {
            name: int(np.isin(frame_of_object, frames_at_level).sum())
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
        """View of the traffic for sensors that move on the mounts, from depth panoramas.

        None if rays must be cast: if the setting's `rendering` is "full", or the range of a
        candidate ends within the site."""
        from placement_env.fidelity.panorama import TrafficView
        from placement_env.fidelity.seeing import choose_quick

        requested = self.setting.rendering
        # a panorama pays for moving sensors however few there are, as they come back to a place
        rendering: Rendering = "panorama" if requested == "auto" else requested
        can_use_panorama = choose_quick(self.setting.pool.sensors, self.traffic, rendering)
        if not can_use_panorama.all():
            return None
        return TrafficView(self.traffic, self.setting.counted.labels, self.run.memo)

    @cached_property
    def network(self) -> str:
        """Name of the shipped network: the site's own if all candidates are its sensors, else the
        general one."""
        return find_network(self.setting.place, self.setting.pool.sensors)

    @cached_property
    def detector(self) -> Detector:
        """The setting's detector, or the shipped one; its `quick_detector` if sets are compared."""
        detector = self.setting.detector or load_shipped_detector(self.network, self.setting.place)
        return quick_detector(detector) if self.compares_sets else detector

    @cached_property
    def _hit_models(self) -> dict[float, tuple[HitModel, ...]]:
        # hit models of all classes by IoU threshold, filled by `at_thresholds` and shared by copies
        return {}

    def with_candidates(self, candidates: Candidates, visibility: Visibility) -> "Preparation":
        """Preparation for other candidates in the same traffic.

        The network and the hit models stay too, whatever the candidates.

        visibility: Points of the new candidates on the objects."""
        return self._share(self.setting.with_candidates(candidates), visibility)

    def at_cases(self, cases: Cases) -> "Preparation":
        """Preparation for other cases, with the same traffic, network and visibility."""
        return self._share(replace(self.setting, cases=cases), self.visibility)

    def _share(self, setting: Setting, visibility: Visibility) -> "Preparation":
        """Preparation for another setting, with this one's traffic, network and hit models.

        visibility: Points of the other setting's candidates on the objects."""
        preparation = replace(self, setting=setting)
        # values of cached properties, which the new preparation then need not make
        shared = {name: getattr(self, name) for name in ("traffic", "network", "_hit_models")}
        set_cached(preparation, **shared, visibility=visibility)
        return preparation

    def with_traffic(self, traffic: Traffic, *, detector: Detector | None = None) -> "Preparation":
        """Copy with given traffic of this site; everything else is made again when needed.

        detector: Detector to use if it is open already, None to open the setting's when needed."""
        preparation = replace(self)  # without this one's cached properties
        set_cached(preparation, traffic=traffic)
        if detector is not None:
            set_cached(preparation, detector=detector)
        return preparation

    def share_traffic(self, preparation: "Preparation") -> "Preparation":
        """Copy with the traffic of another preparation at this site.

        It shares the other's view for moving sensors if the same classes count."""
        shared = self.with_traffic(preparation.traffic)
        if self.setting.counted.labels == preparation.setting.counted.labels:
            set_cached(shared, live=preparation.live)
        return shared

    def build_fidelity(self, candidates: Candidates, visibility: Visibility) -> Fidelity:
        """Scorer of sets of other candidates, with the setting's fidelity and cases.

        visibility: Points of the new candidates on the objects of the same traffic."""
        if self._empty_surrogate is not None:
            return self._empty_surrogate.over(visibility)  # quick copy
        return self.with_candidates(candidates, visibility).fidelity()

    @cached_property
    def _empty_surrogate(self) -> Surrogate | None:
        """Surrogate without candidates, which is copied quickly with some candidates.

        None unless the setting's fidelity is "surrogate" and it has only one case."""
        setting = self.setting
        if setting.fidelity != "surrogate" or not setting.cases.is_one_case:
            return None
        fidelity = self._share(setting, self.unseen).fidelity()
        return fidelity if isinstance(fidelity, Surrogate) else None

    def check(self) -> None:
        """Raise ValueError unless the setting's fidelity can score its candidates and cases.

        Nothing is rendered."""
        check_scorable(self.setting)
        _check_levels(self.setting, _find_fidelity_name(self.setting, name=None))

    def fidelity(self, name: FidelityName | None = None) -> Fidelity:
        """Scorer of sets of the candidates over the setting's cases.

        Cases are error profiles, failures of sensors and levels of traffic (thin to dense frames).

        name: Kind of fidelity, None for the setting's. Raises ValueError for cases that it cannot
        score."""
        name = _find_fidelity_name(self.setting, name)
        cases = self.setting.cases
        _check_levels(self.setting, name)
        profiles = []
        for errors in cases.profiles:
            fidelities = self.at_thresholds(name, errors)  # in all frames, one for each IoU
            by_level: tuple[tuple[Fidelity, ...], ...] = (fidelities,)
            if cases.levels > 1:
                preparations = [
                    self.with_candidates(
                        self.setting.pool, of_frames(self.visibility, level_frames)
                    )
                    for level_frames in self.levels
                ]
                by_level = tuple(
                    preparation.at_thresholds(name, errors) for preparation in preparations
                )
            profiles.append(ProfileFidelities(whole=fidelities[0], levels=by_level))
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
            # it depends on no threshold, so the same scorer is there for each
            return (Coverage(self.visibility, scheme, codec=codec, classes=classes),) * len(ious)
        if name == "table":
            return tuple(
                TableFidelity(
                    table=self._table, scheme=scheme, iou=iou, codec=codec, classes=classes
                )
                for iou in ious
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
        measured = Renders(self.traffic, setting.pool, run.memo, errors=errors)
        return Detected(
            renders=measured,
            detector=self.detector,
            scheme=setting.fusion,
            codec=setting.codec,
            iou=setting.cases.ious[0],
            memo=run.memo,
            processes=run,
            classes=setting.counted,
        )

    @cached_property
    def _table(self) -> Table:
        """Table of scored sets from the setting's file, or the one shipped for the site.

        Raises ValueError if it was measured with other sensors or another version of the site."""
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
    name = _find_fidelity_name(setting, fidelity)
    # file in the setting, the fidelity that reads it, and words for the file
    for path, reader, file_text in (
        (setting.surrogate, "surrogate", "file of surrogates"),
        (setting.table, "table", "table"),
    ):
        if path is not None and name != reader:
            raise ValueError(
                f"a {file_text} is for fidelity {reader}, got {name!r}: leave one of them out"
            )
    sensors = setting.pool.sensors
    classes = setting.counted
    if name == "surrogate":
        for iou in setting.cases.ious:
            # raises ValueError for a missing model
            surrogate_models(setting, iou, find_network(setting.place, sensors))
    if name == "table":
        Preparation(setting).fidelity(name)  # raises ValueError if the table does not fit
    if name == "detector" and setting.detector is not None:
        check_known(setting.detector, classes.names)
    elif name == "detector" and classes.names != VEHICLES.names:
        from models.detector_loading import load_detector

        check_known(
            load_detector(find_network(setting.place, sensors), area=setting.place.area),
            classes.names,
        )


def _find_fidelity_name(setting: Setting, name: FidelityName | None) -> FidelityName:
    """Return the kind of fidelity, checked to be one that can score the setting's sensor errors.

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
    """Raise ValueError for levels of traffic that this kind of fidelity cannot score separately."""
    if setting.cases.levels > 1 and name not in BY_LEVELS:
        raise ValueError(
            f"levels of traffic are known to fidelity {' and '.join(BY_LEVELS)}, got {name!r}"
        )
