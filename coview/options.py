"""Groups of options that commands share.

Each dataclass is a group in their --help, with the fields' texts. `placement_env.cases.Cases`,
`placement_env.setting.Weights` and `toolkit.runtime.run.Run` are groups of options too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from coview.arguments import Combine, Label
from placement_env.cases import USUAL_CASES, Cases
from placement_env.setting import AP_ONLY, Weights

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates
    from placement_env.classes import Classes
    from placement_env.setting import Setting
    from toolkit.objects import Detector
    from toolkit.runtime.run import Run
    from toolkit.sites.site import Site


@dataclass(frozen=True, kw_only=True)
class Output:
    """Results: where they are written, how they are printed."""

    out: Path | None = None
    """Folder for the answer; killed and asked again, the command goes on."""
    overwrite: bool = False
    """Replace files that are there."""
    json: bool = False
    """Print as JSON."""


@dataclass(frozen=True, kw_only=True)
class ClassOptions:
    """Road users that count."""

    classes: tuple[Label, ...] = ("vehicle",)
    """Classes whose AP counts."""
    class_weights: tuple[float, ...] | None = None
    """Weight of each class in their mean; equal when left out."""
    combine: Combine = "mean"
    """AP of several classes: their mean, or that of the worst, so that none is bought at another's expense."""
    small_iou: float = 0.5
    """IoU from which cyclists and pedestrians count, in place of --iou."""

    def build(self) -> Classes:
        """Return the classes that the options mean. Raises ValueError where these do not fit."""
        from placement_env.classes import SMALL, SMALL_IOU, Classes

        names, weights = self.classes, self.class_weights
        if not 0 < self.small_iou <= 1:
            raise ValueError(f"--small-iou must lie above 0 and at most at 1, got {self.small_iou:g}")
        if weights is not None and len(weights) != len(names):
            raise ValueError(f"--class-weights needs a weight for each of {', '.join(names)}, got {len(weights)}")
        own = None if self.small_iou == SMALL_IOU else self.small_iou
        ious = tuple(own if name in SMALL else None for name in names)
        return Classes(names, weights or (), self.combine, ious)


@dataclass(frozen=True, kw_only=True)
class CandidateOptions:
    """Sensors that may be mounted."""

    candidates: str = "pool"
    """pool, paper for the site's own sensors, or a GeoJSON file of poles."""
    model: tuple[str, ...] = ()
    """Sensor models, by name, that may be mounted; the paper's camera when left out."""
    sensors: Path | None = None
    """Catalogue of sensor models and their prices instead, TOML, as for coview plan."""
    money: float | None = None
    """Most that a set may cost, in the catalogue's currency, or in ordinary poles."""

    def __post_init__(self) -> None:
        if self.money is not None and not 0 <= self.money < math.inf:
            raise ValueError(f"--money must be at least 0, got {self.money:g}: leave it out for any")

    @property
    def most_price(self) -> float:
        """Most that a set may cost."""
        return math.inf if self.money is None else self.money

    def build(self, site: Site) -> tuple[Candidates, str]:
        """Return the candidates at a site, and their currency.

        It is the currency of their prices ("" for prices in poles of the ordinary kind). Raises ValueError where the
        options do not fit, and what the files raise.
        """
        from placement_env.candidates.pool import choose_candidates, with_terms
        from placement_env.candidates.sensor_catalogue import load_sensor_catalogue

        if self.candidates == "paper" and not site.sensors:
            raise ValueError(f"site {site.name!r} has no sensors of its own: say --candidates pool")
        for option, given in (("--model", self.model), ("--sensors", self.sensors)):
            if self.candidates == "paper" and given:
                raise ValueError(
                    f"{option} is for --candidates pool or a file of poles: the site's own sensors have theirs"
                )
        if self.model and self.sensors is not None:
            raise ValueError("--model and --sensors both say what may be mounted: leave one of them out")
        if self.sensors is None:
            from toolkit.sensors.models import find_model

            return choose_candidates(site, self.candidates, [find_model(name) for name in self.model]), ""
        catalogue = load_sensor_catalogue(self.sensors)
        models, prices = [each.model for each in catalogue.models], [each.price for each in catalogue.models]
        found = choose_candidates(site, self.candidates, models, prices=prices)
        pole_price = 1.0 if catalogue.pole_price is None else catalogue.pole_price
        return with_terms(found, pole_price, None), catalogue.currency


@dataclass(frozen=True, kw_only=True)
class SettingOptions:
    """Scoring of a set."""

    candidates: CandidateOptions = CandidateOptions()
    classes: ClassOptions = ClassOptions()
    cases: Cases = USUAL_CASES
    weights: Weights = AP_ONLY
    scheme: str = "early"
    """Fusion of measurements: early, late, hybrid or foreground."""
    codec: str = "paper"
    """Coding of what is sent: paper counts 96 bits a point and 256 a box, range-images sends bytes in steps of 2 cm."""
    fidelity: Literal["coverage", "surrogate", "detector", "table"] = "surrogate"
    """Score of a set while searching; table knows the built-in sites' own sensors only."""
    detector: str | None = None
    """Detector, as in coview evaluate, but for cluster; a shipped one when left out."""
    surrogate: Path | None = None
    """File of coview surrogate, for fidelity surrogate in place of the shipped ones."""
    table: Path | None = None
    """File of coview table, for fidelity table in place of the shipped ones."""

    def build(self, site: Site, run: Run) -> tuple[Setting, str]:
        """Return the setting at a site, and its currency.

        It is the currency of the site's prices. Raises ValueError where the options do not fit.
        """
        from placement_env.setting import Setting
        from toolkit.detection.link.range_images import find_codec

        if self.fidelity == "table" and self.candidates.candidates != "paper":
            raise ValueError("--fidelity table knows the built-in sites' own sensors only: say --candidates paper")
        detector = load_own_detector(self.detector, site, run)
        pool, currency = self.candidates.build(site)
        setting = Setting(
            site,
            candidates=pool,
            scheme=self.scheme,
            codec=find_codec(self.codec),
            classes=self.classes.build(),
            cases=self.cases,
            fidelity=self.fidelity,
            detector=detector,
            surrogate=self.surrogate,
            table=self.table,
            weights=self.weights,
            most_price=self.candidates.most_price,
        )
        return setting, currency


def load_own_detector(name: str | None, site: Site, run: Run) -> Detector | None:
    """Load the detector that --detector names at a site.

    None for the shipped one. Raises ValueError where its detections are to be kept and it does not say what they depend
    on.
    """
    from coview.detectors import check_digest, site_detector

    if name is None:
        return None
    detector = site_detector(name, site)
    if run.cache is not None:
        check_digest(name, detector, ": add one, or say --cache None")
    return detector
