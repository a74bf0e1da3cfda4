"""`Question`: what a plan is asked for, checked before any work begins."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import shapely

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.pool import choose_candidates, with_terms
from placement_env.candidates.sensor_catalogue import SensorCatalogue
from placement_env.cases import USUAL_CASES, Cases, IoUs
from placement_env.checks import check_whole
from placement_env.classes import VEHICLES, find_classes
from toolkit.detection.codec import PAPER, Codec, check_codec
from toolkit.detection.provenance import detector_origin
from toolkit.detection.schemes import find_scheme
from toolkit.objects import Detector
from toolkit.sites.site import Site

SEARCH_FRAMES, JUDGE_FRAMES, FINAL_FRAMES = 60, 60, 120


@dataclass(frozen=True, eq=False, kw_only=True)
class Question:
    """What is asked.

    site: the junction; sensors: most of them, None for as many as `money` buys; money: most that may be spent, in the
    catalogue's currency, else in prices of one ordinary pole, None for any sum; min_ap: AP to be reached, None for
    the best set within the budget, else the cheapest set that reaches it is the answer; max_kbit: most that one
    sensor may send in the mean frame; capacity_kbit: of the link of every mount, None for each mount's own;
    classes: of road users that count (names, or `placement_env.classes.Classes`), of the others a plan says what
    share is seen; scheme: of fusion; codec: of what is sent; cases: IoU thresholds, failures, levels of traffic and
    errors of the sensors that decide when sets are compared and the answer is judged (searches know the sensors'
    own noise only, and what else the plan says is at the first error profile); candidates: "pool", "paper" for the
    site's own sensors, or a GeoJSON file of poles; catalogue: sensor models and prices, None for the paper's camera
    at no price; keep_out: areas where no sensor may stand; detector: None for a shipped network; frames: of the
    traffic that searches see, of that by which sets are compared, and of that by which the answer is judged; seed:
    of all three; confidence: at which a comparison ends, that no set of as many sensors is better by more than
    0.01.

    Raises ValueError in one line where a field does not fit.
    """

    site: Site
    sensors: int | None = 4
    money: float | None = None
    min_ap: float | None = None
    max_kbit: float | None = None
    capacity_kbit: float | None = None
    classes: Any = VEHICLES
    scheme: str = "early"
    codec: Codec = PAPER
    cases: Cases = USUAL_CASES
    candidates: str | Path = "pool"
    catalogue: SensorCatalogue | None = None
    keep_out: tuple[shapely.Geometry, ...] = ()
    detector: Detector | None = None
    search_frames: int = SEARCH_FRAMES
    judge_frames: int = JUDGE_FRAMES
    final_frames: int = FINAL_FRAMES
    seed: int = 0
    confidence: float = 0.95

    def __post_init__(self) -> None:
        if self.sensors is None and self.money is None:
            raise ValueError("a plan needs a budget: a number of sensors, a sum of money, or both")
        if self.sensors is not None:
            check_whole("budget of sensors", self.sensors, least=0)
        for name in ("money", "max_kbit", "capacity_kbit"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < math.inf:
                raise ValueError(f"{name} must be a finite number from 0 up, got {value}: leave it out for any")
        if self.capacity_kbit == 0:
            raise ValueError("capacity_kbit must be above 0: leave it out for each mount's own")
        if self.min_ap is not None and not 0 < self.min_ap <= 1:
            raise ValueError(f"min_ap must lie above 0 and up to 1, got {self.min_ap}: AP 0.9 is 0.9")
        object.__setattr__(self, "classes", find_classes(self.classes))
        check_codec(self.codec)
        find_scheme(self.scheme)
        if self.sensors is not None and 0 < self.sensors <= self.cases.failing:
            raise ValueError(
                f"of {self.sensors} sensors nothing is left when {self.cases.failing} fail: allow more sensors, "
                "or let fewer fail"
            )
        for name in ("search_frames", "judge_frames", "final_frames"):
            check_whole(name, getattr(self, name), least=1)
        check_whole("seed", self.seed, least=0)
        if not 0 < self.confidence < 1:
            raise ValueError(f"confidence must lie between 0 and 1, got {self.confidence}: 0.95 is usual")
        if self.candidates == "paper" and self.catalogue is not None:
            raise ValueError(
                "the site's own sensors have their models: give a catalogue with a pool or a file of poles"
            )

    @property
    def iou(self) -> IoUs:
        """IoU threshold, or thresholds, from which a detection counts."""
        return self.cases.threshold

    @property
    def most_price(self) -> float:
        """That a set may cost."""
        return math.inf if self.money is None else float(self.money)

    @property
    def currency(self) -> str:
        """Of all prices; "" for prices of one ordinary pole."""
        return "" if self.catalogue is None else self.catalogue.currency

    @cached_property
    def pool(self) -> Candidates:
        """The candidates, with prices in the currency and the links asked for.

        Raises `placement_env.candidates.pool.NoCandidates` where no pole or pose is left, ValueError and OSError for a
        damaged file.
        """
        catalogue = self.catalogue
        models = () if catalogue is None else tuple(each.model for each in catalogue.models)
        prices = () if catalogue is None else tuple(each.price for each in catalogue.models)
        found = choose_candidates(self.site, self.candidates, models, prices=prices, keep_out=self.keep_out)
        return with_terms(found, self.pole_price, self.capacity_kbit)

    @property
    def pole_price(self) -> float:
        """Of one ordinary mount."""
        given = None if self.catalogue is None else self.catalogue.pole_price
        return 1.0 if given is None else given

    @property
    def in_words(self) -> dict[str, Any]:
        """Every option, for plan.json."""
        detector = "shipped" if self.detector is None else detector_origin(self.detector)["detector"]
        named = self.candidates in ("pool", "paper")
        return {
            "site": self.site.name,
            "sensors": self.sensors,
            "money": self.money,
            "currency": self.currency,
            "min_ap": self.min_ap,
            "max_kbit": self.max_kbit,
            "capacity_kbit": self.capacity_kbit,
            "classes": list(self.classes.names),
            "class_weights": list(self.classes.weights),
            "combine": self.classes.combine,
            "class_ious": [self.cases.class_ious(self.classes, name) for name in self.classes.names],
            "scheme": self.scheme,
            "codec": self.codec.digest,
            "iou": self.iou if isinstance(self.iou, float) else list(self.iou),
            "failing": self.cases.failing,
            "failures": self.cases.failures,
            "levels": self.cases.levels,
            "levels_by": self.cases.levels_by,
            "errors": list(self.cases.names),
            "errors_by": self.cases.errors_by,
            "candidates": str(self.candidates) if named else Path(self.candidates).name,
            "catalogue": None if self.catalogue is None else [each.name for each in self.catalogue.models],
            "keep_out_areas": len(self.keep_out),
            "detector": detector,
            "frames": [self.search_frames, self.judge_frames, self.final_frames],
            "seed": self.seed,
            "confidence": self.confidence,
        }

    @property
    def poles_digest(self) -> str | None:
        """SHA-256 of the file of poles, None where there is none."""
        if self.candidates in ("pool", "paper"):
            return None
        return sha256(Path(self.candidates).read_bytes()).hexdigest()
