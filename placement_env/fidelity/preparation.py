"""A fidelity by its name: traffic, what each candidate sees of it, renders and detector, prepared when first needed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from placement_env.checks import check_iou
from placement_env.classes import VEHICLES, Classes
from placement_env.fidelity.combined.error_profiles import Errors, over_profiles, profiles_in, several
from placement_env.protocol import Fidelity, check_fidelity
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.scheme import Scheme, surrogate_name
from toolkit.detection.schemes import SCHEMES, find_scheme
from toolkit.objects import Detector, check_known
from toolkit.sensors.error_profiles import PAPER_ERRORS, only_own_noise
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates
    from placement_env.fidelity.hits.hit_model import HitModel
    from placement_env.fidelity.panorama.live import LiveView
    from placement_env.fidelity.traffic import Traffic
    from placement_env.fidelity.visibility import Visibility
    from placement_env.setting import Rendering
    from toolkit.runtime.cache import Cache


GENERAL = "general"  # the network that no site has trained
KEPT_DETECTORS = 4  # sites whose shipped detector is held in memory
KEPT_WITH = ("traffic", "disk_cache", "visibility", "network")  # whatever the IoU threshold and the errors


def site_candidates(
    site: Site, candidates: Candidates | Literal["pool"] | Callable[[Site], Candidates] | None
) -> Candidates:
    """The candidates themselves, the site's pool, what a function makes of the site, or for None its own sensors."""
    from placement_env.candidates.pool import paper_candidates, pool

    if candidates is None:
        return paper_candidates(site)
    if isinstance(candidates, str):
        if candidates != "pool":
            raise ValueError(f"candidates must be 'pool', None for the site's own, or Candidates, got {candidates!r}")
        return pool(site)
    return candidates(site) if callable(candidates) else candidates


@dataclass(frozen=True, eq=False, kw_only=True)
class Preparation:
    """What the fidelities of one objective are made from; its arguments are those of `Objective`."""

    site: Site
    candidates: Candidates
    frames: int
    scheme: Scheme
    iou: float = 0.7
    seed: int = 0
    codec: Codec = PAPER
    cache: str | Path | None = None
    workers: int = 1
    ray: str | None = None
    detector: Detector | None = None
    errors: Errors = PAPER_ERRORS
    classes: Classes = VEHICLES
    surrogate: str | Path | None = None
    table: str | Path | None = None
    rendering: Rendering = "auto"

    @cached_property
    def traffic(self) -> Traffic:
        """The frames."""
        from placement_env.fidelity.traffic import simulate_traffic

        return simulate_traffic(self.site, self.frames, self.seed)

    @cached_property
    def disk_cache(self) -> Cache | None:
        """What was seen, rendered and detected before: one file in the folder `cache`."""
        from toolkit.runtime.cache import Cache

        return None if self.cache is None else Cache(Path(self.cache) / "cache.sqlite")

    @property
    def visibility(self) -> Visibility:
        """What each candidate sees."""
        return self.look()

    def look(self, progress: Callable[[str, int, int | None], None] | None = None) -> Visibility:
        """What each candidate sees, rendered the first time; progress: called with "poses rendered", done, total."""
        from placement_env.fidelity.visibility import see

        if "visibility" not in vars(self):
            total = len(self.candidates)
            report = None if progress is None else lambda done: progress("poses rendered", done, total)
            seen = see(
                self.traffic,
                self.candidates,
                labels=self.classes.labels,
                workers=self.workers,
                ray=self.ray,
                cache=self.disk_cache,
                progress=report,
                rendering=self.rendering,
            )
            vars(self)["visibility"] = seen
        return vars(self)["visibility"]

    @cached_property
    def live(self) -> LiveView | None:
        """What sensors on the candidates' mounts see as they move, None where that is rendered in full: as
        `rendering` says, and where the range of a candidate ends within the site."""
        from placement_env.fidelity.panorama.live import LiveView
        from placement_env.fidelity.panorama.panoramas import far_sighted, worthwhile

        sensors = self.candidates.sensors
        quick = self.rendering == "panorama" or (self.rendering == "auto" and worthwhile(sensors))
        if not (quick and far_sighted(sensors, self.traffic).all()):
            return None
        return LiveView(self.traffic, self.classes.labels, self.disk_cache)

    @cached_property
    def network(self) -> str:
        """Which shipped network, or surrogate of it, scores the candidates."""
        return network_for(self.site, self.candidates.sensors)

    @cached_property
    def _hit_models(self) -> list[HitModel]:
        """Those of the surrogate, one of each class, once they have been asked for."""
        return []

    @property
    def hit_models(self) -> list[HitModel]:
        """Those of the surrogate, one of each class, read once for all preparations made by `at`."""
        if not self._hit_models:
            settings: dict[str, Any] = {"classes": self.classes, "path": self.surrogate}
            self._hit_models.extend(surrogate_models(self.scheme, self.iou, self.network, **settings))
        return self._hit_models

    def at(self, candidates: Candidates, visibility: Visibility) -> Preparation:
        """The same traffic and network for other candidates, of which it is known what they see: scores of sensors that
        were moved compare with those of where they were."""
        there = replace(self, candidates=candidates)
        vars(there).update(
            traffic=self.traffic, network=self.network, visibility=visibility, _hit_models=self._hit_models
        )
        return there

    def changed(self, **settings: Any) -> Preparation:
        """The same with another IoU threshold, or other errors; what was seen is seen once."""
        other = replace(self, **settings)
        vars(other).update({name: vars(self)[name] for name in KEPT_WITH if name in vars(self)})
        return other

    @property
    def at_profiles(self) -> tuple[Preparation, ...]:
        """The same at each error profile by itself, by one detector; itself where there is one profile."""
        if several(self.errors) is None:
            return (self,)
        kept = (self.traffic, self.disk_cache, self.network)  # made now, for all of them
        detector = shipped_detector(kept[-1], self.site) if self.detector is None else self.detector
        return tuple(self.changed(errors=each, detector=detector) for each in profiles_in(self.errors))

    def check(self, name: str) -> None:
        """Raises ValueError where the fidelity of that name cannot score these candidates so; renders nothing."""
        check_fidelity_for(
            self.site, self.candidates, self.scheme, name, iou=self.iou, classes=self.classes,
            surrogate=self.surrogate, table=self.table, detector=self.detector,
        )  # fmt: skip

    def fidelity(self, name: str) -> Fidelity:
        """The fidelity of that name, over the error profiles where there are several. Raises ValueError for errors that
        it does not know."""
        check_fidelity(name)
        check_errors_for(self.errors, name)
        over = several(self.errors)
        if over is not None:
            return over_profiles([each.fidelity(name) for each in self.at_profiles], over)
        made = {
            "coverage": self._coverage, "surrogate": self._surrogate, "detector": self._detected, "table": self._table
        }  # fmt: skip
        return made[name]()

    def _coverage(self) -> Fidelity:
        from placement_env.fidelity.coverage import Coverage

        return Coverage(self.visibility, self.scheme, codec=self.codec, classes=self.classes)

    def _surrogate(self) -> Fidelity:
        from placement_env.fidelity.surrogate import Surrogate

        settings: dict[str, Any] = {"radius": self.site.hybrid_radius, "codec": self.codec, "classes": self.classes}
        return Surrogate(self.visibility, self.scheme, self.hit_models, **settings)

    def _detected(self) -> Fidelity:
        from placement_env.fidelity.detector import Detected
        from placement_env.fidelity.renders import Renders

        (errors,) = profiles_in(self.errors)
        renders = Renders(self.traffic, self.candidates, self.disk_cache, errors=errors)
        detector = self.detector
        if detector is None:
            detector = shipped_detector(self.network, self.site)
        return Detected(
            renders, detector, self.scheme, codec=self.codec, iou=self.iou, memo=self.disk_cache,
            workers=self.workers, ray=self.ray, classes=self.classes,
        )  # fmt: skip

    def _table(self) -> Fidelity:
        from placement_env.fidelity.table import TableFidelity, digest_of, load_table

        table = load_table(self.site.name if self.table is None else self.table)
        site, origin = self.site, table.origin
        if (origin.place, origin.hybrid_radius) != (digest_of(site, self.candidates.sensors), site.hybrid_radius):
            raise ValueError(
                f"the table of {self.site.name!r} is of its own {len(table.origin.sensors)} sensors where they hang, "
                "not of these candidates or this version of the site: say another --fidelity, or run coview table"
            )
        return TableFidelity(table, self.scheme, self.iou, self.codec, classes=self.classes)


def check_fidelity_for(
    site: Site,
    candidates: Candidates,
    scheme: Scheme | str,
    fidelity: str,
    *,
    iou: float = 0.7,
    classes: Classes = VEHICLES,
    surrogate: str | Path | None = None,
    table: str | Path | None = None,
    detector: Detector | None = None,
) -> None:
    """Raises ValueError where there is no table, surrogate or detector that scores these candidates so; renders
    nothing. surrogate, table: files, None for what is shipped; detector: None for the shipped one."""
    scheme = find_scheme(scheme)
    check_iou(iou)
    if surrogate is not None and fidelity != "surrogate":
        raise ValueError(f"a file of surrogates is for fidelity surrogate, got {fidelity!r}: leave one of them out")
    if table is not None and fidelity != "table":
        raise ValueError(f"a table is for fidelity table, got {fidelity!r}: leave one of them out")
    if fidelity == "surrogate":
        network = network_for(site, candidates.sensors)
        surrogate_models(scheme, iou, network, classes=classes, path=surrogate)
    if fidelity == "table":
        Preparation(
            site=site, candidates=candidates, frames=1, scheme=scheme, iou=iou, classes=classes, table=table
        ).fidelity("table")
    if fidelity == "detector" and detector is not None:
        check_known(detector, classes.names)
    if fidelity == "detector" and detector is None and classes.names != VEHICLES.names:
        from models.detector import load_detector

        check_known(load_detector(network_for(site, candidates.sensors), area=site.area), classes.names)


def surrogate_models(
    scheme: Scheme, iou: float, network: str, *, classes: Classes = VEHICLES, path: str | Path | None = None
) -> tuple[HitModel, ...]:
    """A model for each class: of a file, None for those that are shipped for a network. Raises ValueError where one is
    missing, FileNotFoundError where the file is."""
    from placement_env.fidelity.hits.hit_model import chosen_model, load_models, shipped_model

    wanted = [(name, classes.iou_of(name, iou)) for name in classes.names]
    if path is None:
        return tuple(shipped_model(surrogate_name(scheme), at, network, label=name) for name, at in wanted)
    models = load_models(path, schemes={*SCHEMES, scheme.name})
    return tuple(chosen_model(models, surrogate_name(scheme), at, name, source=str(path)) for name, at in wanted)


def check_errors_for(errors: Errors, fidelity: str) -> None:
    """Raises ValueError where sensors have errors beyond their own noise and the fidelity scores as if they had not."""
    if fidelity != "detector" and not all(map(only_own_noise, profiles_in(errors))):
        raise ValueError(
            f"errors {errors.name!r} are known to fidelity detector alone, got {fidelity!r}: say --fidelity detector"
        )


def shipped_detector(network: str, site: Site) -> Detector:
    """A shipped network as it detects at a site. The general one was not trained there and would take some hedge for
    somebody in every frame, so it knows the site empty. It is made once, for whatever preparations there are."""
    from toolkit.sites.files import format_site

    return _detector_at(network, _Place(format_site(site), site))


@dataclass(frozen=True)
class _Place:
    """A site as a key: the text of its file."""

    text: str
    site: Site = field(compare=False)


@lru_cache(maxsize=KEPT_DETECTORS)
def _detector_at(network: str, place: _Place) -> Detector:
    from models.detector import load_detector
    from toolkit.detection.site_background import add_background

    detector = load_detector(network, area=place.site.area)
    return add_background(detector, place.site) if network == GENERAL else detector


def network_for(site: Site, sensors: Iterable[Sensor]) -> str:
    """Which shipped network detects what these sensors see: the site's, trained with its own sensors, or `GENERAL`."""
    from models.detector import SHIPPED

    own = set(sensors) <= set(site.sensors) and (SHIPPED / f"{site.name}.safetensors").exists()
    return site.name if own else GENERAL
