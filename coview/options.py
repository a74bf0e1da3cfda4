"""Groups of options that commands share.

Each dataclass is a group in --help, with the texts of its fields.

`placement_env.cases.Cases`, `placement_env.setting.Weights` and `toolkit.runtime.run.Run` are
groups of options too."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from coview.arguments import Combine, Label
from coview.detector_spec import DetectorSpec
from coview.detectors import check_digest, open_detector
from coview.outputs import Writing
from placement_env.candidates.candidates import Candidates, choose_candidates
from placement_env.candidates.poles import load_keep_out
from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
from placement_env.cases import Cases
from placement_env.classes import SMALL_CLASSES, SMALL_IOU, Classes
from placement_env.defaults import USUAL_CASES
from placement_env.links import LINK_SHARE
from placement_env.report.planning.question import Stock
from placement_env.setting import Setting, Weights
from toolkit.detection.link.range_images import find_codec
from toolkit.objects import Detector
from toolkit.runtime.run import Run
from toolkit.sensors.models import find_model
from toolkit.sites.site import Site


@dataclass(frozen=True, kw_only=True)
class Output(Writing):
    """Results."""

    out: Path | None = None
    """Folder for the results; an interrupted command resumes there."""


@dataclass(frozen=True, kw_only=True)
class ClassOptions:
    """Road users to detect."""

    classes: tuple[Label, ...] = ("vehicle",)
    """Classes that count."""
    class_weights: tuple[float, ...] | None = None
    """Weight of each class in the mean AP; equal when left out."""
    combine: Combine = "mean"
    """Score the mean AP over classes, or the AP of the worst class."""
    small_iou: float = 0.5
    """IoU at which cyclists and pedestrians count, in place of --iou."""

    def build(self) -> Classes:
        """Return the classes. Raises ValueError for options that do not fit."""
        names = self.classes
        weights = self.class_weights
        if not 0 < self.small_iou <= 1:
            raise ValueError(
                f"--small-iou must lie above 0 and at most at 1, got {self.small_iou:g}"
            )
        if weights is not None and len(weights) != len(names):
            raise ValueError(
                f"--class-weights needs a weight for each of {', '.join(names)}, got {len(weights)}"
            )
        # None for the usual threshold of a class
        small_iou = None if self.small_iou == SMALL_IOU else self.small_iou
        iou_by_class = tuple(small_iou if name in SMALL_CLASSES else None for name in names)
        return Classes(names, weights=weights or (), combine=self.combine, ious=iou_by_class)


@dataclass(frozen=True, kw_only=True)
class CandidateOptions:
    """Poles and sensors to choose from."""

    candidates: str = "pool"
    """Sensors to choose from: pool, paper for the site's own, or a GeoJSON file of poles."""
    keep_out: Path | None = None
    """GeoJSON file of areas where no sensor may stand."""
    model: tuple[str, ...] = ()
    """Names of the sensor models; the paper's camera when left out."""
    sensors: Path | None = None
    """Catalogue of sensor models with prices (TOML), in place of --model."""
    money: float | None = None
    """Maximum price of a set, in the catalogue's currency or in ordinary poles."""
    keep: tuple[str, ...] = ()
    """Names of poles that must carry a sensor."""

    def __post_init__(self) -> None:
        if self.money is not None and not 0 <= self.money < math.inf:
            raise ValueError(
                f"--money must be at least 0, got {self.money:g}: leave it out for any"
            )

    def build(self, site: Site) -> tuple[Candidates, str]:
        """Return the candidates at a site, and the currency of their prices.

        The currency is "" for prices in ordinary poles. Raises ValueError for options that do not
        fit, and what the files raise."""
        if self.candidates == "paper" and not site.sensors:
            raise ValueError(f"site {site.name!r} has no sensors: pass --candidates pool")
        for option, value in (("--model", self.model), ("--sensors", self.sensors)):
            if self.candidates == "paper" and value:
                raise ValueError(
                    f"{option} is for --candidates pool or a file of poles: a site's sensors have "
                    "theirs"
                )
        if self.model and self.sensors is not None:
            raise ValueError("--model and --sensors both name what may be mounted: leave one out")
        keep_out = () if self.keep_out is None else load_keep_out(self.keep_out, site)
        if self.sensors is None:
            models = [find_model(name) for name in self.model]
            return choose_candidates(site, self.candidates, models, keep_out=keep_out), ""
        stock = Stock(
            candidates=self.candidates,
            catalogue=load_sensor_catalogue(self.sensors),
            keep_out=keep_out,
        )
        return stock(site), stock.currency


@dataclass(frozen=True, kw_only=True)
class SettingOptions:
    """Fusion, and how sets are scored."""

    candidates: CandidateOptions = CandidateOptions()
    classes: ClassOptions = ClassOptions()
    cases: Cases = USUAL_CASES
    weights: Weights = Weights()
    scheme: str = "early"
    """Fusion scheme: early, late, hybrid or foreground."""
    codec: str = "paper"
    """Coding: paper counts 96 bits a point and 256 a box, range-images sends bytes in steps of
    2 cm."""
    link_share: float = LINK_SHARE
    """Share of the frames in which every link must carry what is sent."""
    fidelity: Literal["coverage", "surrogate", "detector", "table"] = "surrogate"
    """How sets are scored during the search; table is for the built-in sites' own sensors."""
    detector: str | None = None
    """Detector, as in coview evaluate except cluster; a shipped one when left out."""
    surrogate: Path | None = None
    """File of coview surrogate for --fidelity surrogate, in place of the shipped ones."""
    table: Path | None = None
    """File of coview table for --fidelity table, in place of the shipped ones."""

    def build(self, site: Site, run: Run) -> tuple[Setting, str]:
        """Return the setting at a site, and its currency.

        Raises ValueError for options that do not fit."""
        if self.fidelity == "table" and self.candidates.candidates != "paper":
            raise ValueError(
                "--fidelity table knows only the sensors of built-in sites: pass --candidates paper"
            )
        pool, currency = self.candidates.build(site)
        setting = Setting(
            site,
            candidates=pool,
            scheme=self.scheme,
            codec=find_codec(self.codec),
            classes=self.classes.build(),
            cases=self.cases,
            fidelity=self.fidelity,
            detector=load_own_detector(self.detector, site, run),
            surrogate=self.surrogate,
            table=self.table,
            weights=self.weights,
            most_price=math.inf if self.candidates.money is None else self.candidates.money,
            keep=self.candidates.keep,
            link_share=self.link_share,
        )
        return setting, currency


def load_own_detector(name: str | None, site: Site, run: Run) -> Detector | None:
    """Load the detector that --detector names at a site, None for the shipped one.

    Raises ValueError for a detector without digest if its detections are kept in a cache."""
    if name is None:
        return None
    detector = open_detector(DetectorSpec.from_name(name), site)
    if run.cache is not None:
        check_digest(name, detector, ": add one, or pass --cache None")
    return detector
