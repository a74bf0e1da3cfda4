"""`Question` and `Stock`, the inputs of a plan, checked before any work begins."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path

import numpy as np
import shapely

from placement_env.candidates.candidates import Candidates, choose_candidates, with_terms
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.cases import Cases
from placement_env.checks import check_whole
from placement_env.fidelity.preparation import check_scorable
from placement_env.setting import Setting
from toolkit.detection.provenance import detector_origin
from toolkit.frozen import set_fields
from toolkit.runtime.run import Run
from toolkit.sites.maps.furnishing import redraw
from toolkit.sites.site import Site

PART_FRAMES = {"search": 60, "comparison": 120, "judgement": 120}  # default frames of each part
DEFAULT_SENSORS = 4
DRAWING_SEED = 7000  # the other drawings have the seeds after it


@dataclass(frozen=True, eq=False, kw_only=True)
class Stock:
    """Sensors and prices. Call it with a site to get the candidates.

    Raises ValueError if a field does not fit.

    Attributes:
        candidates: "pool", "paper" for the site's sensors, a GeoJSON file of poles, or candidates
            with their prices and links.
        catalogue: Sensor models and prices, None for the paper's camera at no price.
        keep_out: Areas without sensors.
        capacity_kbit: Capacity of every mount's link, None for the capacity in the map.
        only: Names of the candidates to use, empty for all."""

    candidates: str | Path | Candidates = "pool"
    catalogue: SensorCatalogue | None = None
    keep_out: tuple[shapely.Geometry, ...] = ()
    capacity_kbit: float | None = None
    only: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise ValueError for a wrong capacity, and for a catalogue without use."""
        _check_amount("capacity_kbit", self.capacity_kbit)
        if self.capacity_kbit == 0:
            raise ValueError("capacity_kbit must be above 0: leave it out for each mount's own")
        if self.candidates == "paper" and self.catalogue is not None:
            raise ValueError(
                "the site's own sensors have their models: give a catalogue with a pool or poles"
            )

    def __call__(self, site: Site) -> Candidates:
        """Return the candidates at a site, with their prices and links.

        Given `Candidates` come back unchanged. Prices of poles are multiplied by the catalogue's
        `pole_price`.

        Raises `NoCandidates` if no pole or pose is left, ValueError and OSError for a damaged
        file."""
        if isinstance(self.candidates, Candidates):
            return self.candidates
        pool = choose_candidates(
            site, self.candidates, catalogue=self.catalogue, keep_out=self.keep_out
        )
        if self.only:  # names of the candidates to use, empty for all
            names = set(self.only)
            pool = pool.select(np.flatnonzero([sensor.name in names for sensor in pool.sensors]))
        pole_price = None if self.catalogue is None else self.catalogue.pole_price
        if pole_price is None:
            pole_price = 1.0  # poles keep their prices, in units of one ordinary pole
        return with_terms(pool, pole_price, self.capacity_kbit)

    @property
    def currency(self) -> str:
        """Currency of all prices, "" for prices of one ordinary pole."""
        return "" if self.catalogue is None else self.catalogue.currency

    @property
    def head(self) -> dict[str, str]:
        """Title, client, author and date that the catalogue gives to the report."""
        return {} if self.catalogue is None else self.catalogue.report

    @property
    def is_product(self) -> bool:
        """True if the candidates are all poses on some poles, not sensors in single poses."""
        return not isinstance(self.candidates, Candidates) and self.candidates != "paper"

    @property
    def name(self) -> str:
        """Name of the candidates: pool, paper, a file, or "given" for `Candidates`."""
        if isinstance(self.candidates, Candidates):
            return "given"
        if self.candidates in ("pool", "paper"):
            return str(self.candidates)
        return Path(self.candidates).name

    @property
    def poles_digest(self) -> str | None:
        """SHA-256 of the file of poles, None without one."""
        if isinstance(self.candidates, Candidates) or self.candidates in ("pool", "paper"):
            return None
        return sha256(Path(self.candidates).read_bytes()).hexdigest()


@dataclass(frozen=True, eq=False)
class Question:
    """Question that a plan answers.

    Error profiles apply when sets are compared and the answer is judged; searches know only the
    noise of the sensors. Raises ValueError in one line if a field does not fit.

    Attributes:
        setting: Site, candidates (a `Stock`, or a name for one), scheme, codec, classes, cases,
            detector, and spending limit, in the catalogue's currency or in prices of one ordinary
            pole.
        run: Its seed is for the first of three parts of traffic; its frames are for each part,
            None for `PART_FRAMES`.
        sensors: Largest number of sensors, None for as many as the money buys.
        min_ap: AP that the cheapest set must reach, None for the best set within the budget.
        max_kbit: Most kbit that one sensor may send in the setting's `link_share` of frames.
        confidence: Confidence at which a comparison ends: that no set of as many sensors is better
            by more than 0.01.
        width: Greatest width of the stated AP's interval, for which the last part of the traffic
            gets more frames; None for a fixed number of frames.
        drawings: Number of drawings of what no map knows at the site, over which sets are searched,
            compared and judged."""

    setting: Setting
    run: Run = Run()
    sensors: int | None = DEFAULT_SENSORS
    min_ap: float | None = None
    max_kbit: float | None = None
    confidence: float = 0.95
    width: float | None = None
    drawings: int = 1

    def __post_init__(self) -> None:
        """Raise ValueError if the fields do not fit; make a `Stock` of named candidates."""
        failing = self.cases.failing
        if self.sensors is None and self.money is None:
            raise ValueError("a plan needs a budget: a number of sensors, a sum of money, or both")
        if self.sensors is not None:
            check_whole("budget of sensors", self.sensors, least=0)
            if self.sensors:
                self.setting.check_budget(self.sensors)
            if 0 < self.sensors <= failing:
                count = f"of {self.sensors} sensors nothing is left when {failing} fail"
                raise ValueError(f"{count}: allow more sensors, or let fewer fail")
        _check_amount("max_kbit", self.max_kbit)
        if self.min_ap is not None and not 0 < self.min_ap <= 1:
            raise ValueError(
                f"min_ap must lie above 0 and up to 1, got {self.min_ap}: AP 0.9 is 0.9"
            )
        if not 0 < self.confidence < 1:
            raise ValueError(
                f"confidence must lie between 0 and 1, got {self.confidence}: 0.95 is usual"
            )
        if self.width is not None and not 0 < self.width < 1:
            raise ValueError(
                f"width of the interval must lie between 0 and 1, got {self.width}: 0.02 is narrow"
            )
        check_whole("drawings", self.drawings, least=1)
        if self.drawings > 1 and self.site.furnished == "none":
            raise ValueError(f"nothing was drawn at site {self.site.name!r}: leave --drawings out")
        candidates = self.setting.candidates
        if candidates is None or isinstance(candidates, str | Path):
            stock = Stock(candidates="paper" if candidates is None else candidates)
            set_fields(self, setting=replace(self.setting, candidates=stock))
        elif not isinstance(candidates, Stock):
            raise ValueError(
                f"a plan needs a Stock of candidates, got {candidates!r}: take Stock(...), 'pool' "
                "or 'paper'"
            )

    @property
    def site(self) -> Site:
        """The junction."""
        return self.setting.place

    @property
    def stock(self) -> Stock:
        """Sensors that may be mounted."""
        assert isinstance(self.setting.candidates, Stock)
        return self.setting.candidates

    @property
    def cases(self) -> Cases:
        """Cases by which sets are compared."""
        return self.setting.cases

    @property
    def money(self) -> float | None:
        """Most that may be spent, in `currency`; None for any sum."""
        return None if math.isinf(self.setting.most_price) else self.setting.most_price

    @property
    def currency(self) -> str:
        """Currency of all prices, "" for prices of one ordinary pole."""
        return self.stock.currency

    @cached_property
    def search_setting(self) -> Setting:
        """Setting of the searches, without sensor errors beyond the models' noise.

        Sets are scored by the surrogate, a quick prediction of the shipped detector's AP, or by
        coverage if no surrogate fits the question."""
        cases = replace(self.cases, errors=("paper",))  # profile with the models' noise only
        setting = replace(self.setting, cases=cases, candidates=self.setting.pool, detector=None)
        try:
            check_scorable(setting, "surrogate")
        except ValueError:
            return replace(setting, fidelity="coverage")
        return replace(setting, fidelity="surrogate")

    @cached_property
    def at_drawings(self) -> "tuple[Question, ...]":
        """The question at each drawing of the site; the first drawing is the site itself.

        A drawing fills in at random what no map knows. The other questions have one drawing each,
        from seeds after `DRAWING_SEED`, so that they are the same in every run."""
        questions = [self]
        for number in range(1, self.drawings):
            site = redraw(self.site, DRAWING_SEED + number)
            questions.append(replace(self, setting=replace(self.setting, site=site), drawings=1))
        return tuple(questions)

    def judge_setting(self, candidates: Candidates) -> Setting:
        """Return the setting of the judges, who score by the detector with all cases and errors.

        candidates: sensors of the stock that may be built."""
        return replace(self.setting, candidates=candidates, fidelity="detector")

    def part(self, name: str) -> Run:
        """Return the run of one part of the traffic, with its seed and number of frames.

        name: "search", "comparison" or "judgement"."""
        return self.run.part(list(PART_FRAMES).index(name), self.run.frames_or(PART_FRAMES[name]))

    def as_dict(self) -> dict[str, object]:
        """Return every option as JSON values, for plan.json.

        Files and objects are stated by name or digest; without a detector it is
        "shipped"."""
        setting = self.setting
        cases = self.cases
        stock = self.stock
        counted = self.setting.counted
        models = None
        if stock.catalogue is not None:
            models = [model.name for model in stock.catalogue.models]
        detector = "shipped"
        if setting.detector is not None:
            detector = detector_origin(setting.detector)["detector"]
        return {
            "site": self.site.name,
            "sensors": self.sensors,
            "money": self.money,
            "currency": self.currency,
            "min_ap": self.min_ap,
            "max_kbit": self.max_kbit,
            "keep": list(setting.keep),
            "link_share": setting.link_share,
            "capacity_kbit": stock.capacity_kbit,
            "classes": list(counted.names),
            "class_weights": list(counted.weights),
            "combine": counted.combine,
            "class_ious": [cases.class_ious(counted, name) for name in counted.names],
            "scheme": setting.fusion.name,
            "codec": setting.codec.digest,
            "iou": cases.ious[0] if len(cases.ious) == 1 else list(cases.ious),
            "failing": cases.failing,
            "failures": cases.failures,
            "levels": cases.levels,
            "levels_by": cases.levels_by,
            "errors": list(cases.names),
            "errors_by": cases.errors_by if len(cases.names) > 1 else "worst",
            "candidates": stock.name,
            "catalogue": models,
            "keep_out_areas": len(stock.keep_out),
            "detector": detector,
            "frames": [self.part(name).frames for name in PART_FRAMES],
            "seed": self.run.seed,
            "confidence": self.confidence,
            "width": self.width,
            "drawings": self.drawings,
        }


def _check_amount(name: str, value: float | None) -> None:
    """Raise ValueError for an infinite or negative amount; None is any amount."""
    if value is not None and not 0 <= value < math.inf:
        raise ValueError(
            f"{name} must be a finite number from 0 up, got {value}: leave it out for any"
        )
