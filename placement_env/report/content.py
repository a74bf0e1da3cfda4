"""Contents of a plan: plain figures, names and sentences, from which plan.json, pages and drawings
are made.

Nothing in it depends on the clock, so the same question has the same plan, byte for byte. kbit are
per frame, 1 kbit = 1000 bit; prices are in the plan's currency. AP and recall are at the plan's IoU
unless a field says otherwise, always by the detector on traffic that no search saw. An undefined
figure is None."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import Any

import numpy as np

from placement_env.analysis.intervals import describe_interval
from placement_env.candidates.candidates import Candidates
from placement_env.cases import IoUs
from placement_env.handover.ground import Ground, GroundShares
from placement_env.handover.mounted import LinkLoad, MaterialItem, PlannedSensor
from placement_env.links import LINK_SHARE
from toolkit.arrays import Bool, Float32, Mask
from toolkit.display import Card, Displayed, Table, figure_digits, format_share
from toolkit.objects import Detections, Objects
from toolkit.runtime.files import read_own_table
from toolkit.sites.site import Site

PLAN_VERSION = 1  # in plan.json
CONFIDENCE = 0.95  # of every interval
TEXTS: dict[str, Any] = read_own_table(__file__, "texts.toml")


@dataclass(frozen=True)
class Judgement:
    """The detector's result for one sensor set.

    low, high: interval of the AP from a bootstrap over blocks of frames, NaN for few of them;
    vehicles, frames: to be detected, in how many frames; kind: of the objects, "vehicle", or
    "object" if several classes count, whose AP and recall are combined."""

    ap: float
    low: float
    high: float
    recall: float
    precision: float | None
    vehicles: int
    frames: int
    kind: str = "vehicle"

    @property
    def digits(self) -> int:
        """Number of decimals that so many objects support."""
        return figure_digits(self.vehicles)

    @property
    def known(self) -> bool:
        """True if there are frames enough for an interval, so that this AP may be compared with
        others."""
        return not math.isnan(self.low)

    def format_ap(self) -> str:
        """AP with as many decimals as its objects support."""
        return format_share(self.ap, self.vehicles)

    def describe_interval(self) -> str:
        """Words for its interval, with as many decimals as its objects support."""
        return describe_interval(self.low, self.high, self.digits)


def overlap(one: Judgement, other: Judgement) -> bool:
    """Return whether the intervals of two AP overlap. Both must be `known`: without an interval
    nothing is compared."""
    return not (one.low > other.high or other.low > one.high)


@dataclass(frozen=True)
class PlanOption:
    """A sensor set that was considered.

    sensors: names of candidates; poles: their mounts; predicted: AP by the fidelity of the
    searches; judged: intact, None if not judged; searches: those that found it; mean_ap: over IoU
    0.7, 0.8 and 0.9. Three results are None unless the plan asks for them: left: with failed
    sensors, over the levels of traffic if there are several; over_levels: intact, over the levels;
    over_errors: over the error profiles, with failures and levels. All other figures are at the
    first profile. fits_links: whether the links carry what is sent in the frames that it was judged
    on."""

    sensors: tuple[str, ...]
    price: float
    kbit_per_sensor: float
    kbit: float
    predicted: float
    judged: Judgement | None
    searches: tuple[str, ...] = ()
    mean_ap: float | None = None
    left: Judgement | None = None
    over_levels: Judgement | None = None
    over_errors: Judgement | None = None
    poles: tuple[str, ...] = ()
    fits_links: bool = True

    @property
    def counted(self) -> Judgement | None:
        """Result by which sets are compared, over all requested cases."""
        return self.over_errors or self.left or self.over_levels or self.judged


@dataclass(frozen=True)
class BreakdownRow:
    """The chosen set in one group: zone, range, approach, level or error profile. judged: None
    without vehicles."""

    name: str
    judged: Judgement | None
    mean_points: float | None = None


@dataclass(frozen=True)
class DrawingResult:
    """Result at one drawing of what no map knows. judged: the chosen set; poles: of the set chosen
    at it alone."""

    judged: Judgement
    poles: tuple[str, ...]


@dataclass(frozen=True)
class ClassSeen:
    """Coverage of one class."""

    label: str
    objects: int
    least_points: int
    share: float | None


@dataclass(frozen=True)
class ClassAP:
    """Result of the chosen set for one class. weight: 0 if it does not count; iou: at which a
    detection counts."""

    label: str
    weight: float
    iou: IoUs
    judged: Judgement


@dataclass(frozen=True)
class SchemeFigures:
    """The chosen set under one fusion scheme. as_good: it cannot be told from the plan's own
    scheme."""

    scheme: str
    iou: IoUs
    judged: Judgement
    kbit_per_sensor: float
    as_good: bool = False


@dataclass(frozen=True)
class DrawnErrors:
    """AP of the chosen set at one error profile whose errors are drawn several times, each for all
    frames. aps: of each draw; mean: of these; tenth: AP below which one draw in ten falls; frames:
    of each draw."""

    profile: str
    aps: tuple[float, ...]
    mean: float
    tenth: float
    frames: int


@dataclass(frozen=True)
class SensorWorth:
    """Shapley value of one sensor, in AP, and its interaction with each other one."""

    sensor: str
    shapley: float
    synergy: dict[str, float]


@dataclass(frozen=True)
class FailureCase:
    """Result after these sensors fail."""

    failed: tuple[str, ...]
    judged: Judgement


@dataclass(frozen=True)
class BuildStep:
    """Next sensor to build, with the money spent and the result so far."""

    sensor: str
    price: float
    judged: Judgement


@dataclass(frozen=True)
class Verdict:
    """The answer in one sentence. met: the requirement, None without one; reasons: sentences on why
    not."""

    met: bool | None
    sentence: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan(Displayed):
    """A deployment plan.

    question: every option, in words or numbers; detector: in words; iou: at which a detection
    counts, several for their mean; currency: of all prices, "" for units of one ordinary pole;
    chosen: None if no set may be built; best: the set that is best where price does not count;
    near_optimal: other sets that cannot be told from it on the same frames, cheap ones first;
    confidence: with which the race of its size ended; front: sets that no other beats in AP, kbit
    per sensor and price at once, by price; by_draw: at each error profile with errors; by_drawing:
    at each of several drawings of the site, on the traffic of the comparison; running: what the
    catalogue's rates add to the price; poles_unused: names; origins: number of things at the site
    by origin ("mapped", "surveyed", "drawn") and kind; head: title, client, date and author, those
    that the catalogue gives; blind_streets: m² of lanes that no sensor sees, by street; stock:
    poles, models and prices that sets were chosen from, as `format_stock` gives them; assumptions,
    unknown: sentences; provenance: digests of all inputs, seeds, versions."""

    question: dict[str, object]
    site: str
    detector: str
    iou: IoUs
    scheme: str
    currency: str
    verdict: Verdict
    chosen: PlanOption | None
    best: PlanOption | None = None
    confidence: float | None = None
    why: tuple[str, ...] = ()
    sensors: tuple[PlannedSensor, ...] = ()
    considered: tuple[PlanOption, ...] = ()
    near_optimal: tuple[PlanOption, ...] = ()
    front: tuple[PlanOption, ...] = ()
    schemes: tuple[SchemeFigures, ...] = ()
    by_zone: tuple[BreakdownRow, ...] = ()
    by_range: tuple[BreakdownRow, ...] = ()
    by_approach: tuple[BreakdownRow, ...] = ()
    by_level: tuple[BreakdownRow, ...] = ()
    by_errors: tuple[BreakdownRow, ...] = ()
    by_draw: tuple[DrawnErrors, ...] = ()
    by_drawing: tuple[DrawingResult, ...] = ()
    by_class: tuple[ClassSeen, ...] = ()
    class_ap: tuple[ClassAP, ...] = ()
    worth: tuple[SensorWorth, ...] = ()
    failures: tuple[FailureCase, ...] = ()
    links: tuple[LinkLoad, ...] = ()
    materials: tuple[MaterialItem, ...] = ()
    running: tuple[MaterialItem, ...] = ()
    order: tuple[BuildStep, ...] = ()
    ground: GroundShares | None = None
    blind_streets: dict[str, float] = field(default_factory=dict)
    poles_unused: tuple[str, ...] = ()
    origins: dict[str, dict[str, int]] = field(default_factory=dict)
    head: dict[str, str] = field(default_factory=dict)
    stock: dict[str, object] = field(default_factory=dict)
    assumptions: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    provenance: dict[str, object] = field(default_factory=dict)

    @property
    def link_share(self) -> float:
        """Share of the frames in which links must carry what is sent."""
        share = self.question.get("link_share", LINK_SHARE)
        return share if isinstance(share, float) else LINK_SHARE

    def format_drawn_ap(self, ap: float, drawn: DrawnErrors) -> str:
        """AP over draws of errors, with as many decimals as the objects of a draw support."""
        judged = self.chosen.counted if self.chosen else None
        objects = judged.vehicles * drawn.frames // judged.frames if judged and judged.frames else 0
        return format_share(ap, objects)

    def _card(self) -> Card:
        tables = {"sensors": self._list_sensors, "considered": self._list_options}
        return Card(f"Plan for {self.site}", (self.verdict.sentence,), tables)

    def _list_sensors(self) -> Table:
        names = ("pole", "model", "x", "y", "height", "bearing_deg", "tilt_deg", "kbit")
        prices = [sensor.model_price + sensor.pole_price for sensor in self.sensors]
        return {name: [getattr(sensor, name) for sensor in self.sensors] for name in names} | {
            "price": prices
        }

    def _list_options(self) -> Table:
        plain = ("poles", "price", "kbit", "predicted")
        judged = [option.counted for option in self.considered]
        table = {name: [getattr(option, name) for option in self.considered] for name in plain}
        figures = {
            name: [getattr(each, name, None) for each in judged]
            for name in ("ap", "low", "high", "recall")
        }
        return table | figures | {"sensors": [option.sensors for option in self.considered]}

    def as_dict(self) -> dict[str, object]:
        """Return the values for plan.json."""
        head = {key: text for key, text in self.head.items() if key != "logo"}
        return {"coview_plan": PLAN_VERSION, **asdict(self), "head": head}


@dataclass(frozen=True, eq=False)
class Moment:
    """One frame for pictures. clouds: points of each sensor; *_hit, *_ignored: truths and
    detections that hit, and those that do not count."""

    clouds: tuple[Float32[np.ndarray, "_ 3"], ...]
    truth: Objects
    detections: Detections
    truth_hit: Mask
    truth_ignored: Mask
    detection_hit: Bool[np.ndarray, " m"]
    detection_ignored: Bool[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class Planned(Displayed):
    """A plan with the inputs of its pages and maps. site: with the chosen sensors mounted;
    candidates: None without any; ground, moments: None and empty if no set may be built."""

    plan: Plan
    site: Site
    candidates: Candidates | None = None
    ground: Ground | None = None
    moments: tuple[Moment, ...] = ()

    def _card(self) -> Card:
        drawn = self.plan.chosen is not None
        return replace(
            self.plan._card(), drawing="placement_env.report.maps:draw_planned" if drawn else ""
        )


def replace_texts(value: Any, change: Callable[[str], str]) -> Any:
    """Return a value with all its texts changed, except drawings."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {
            replace_texts(key, change): replace_texts(each, change) for key, each in value.items()
        }
    if isinstance(value, tuple | list):
        changed_rows = (replace_texts(each, change) for each in value)
        return list(changed_rows) if isinstance(value, list) else tuple(changed_rows)
    if is_dataclass(value) and not isinstance(value, type):
        changed = {
            each.name: replace_texts(getattr(value, each.name), change) for each in fields(value)
        }
        return replace(value, **changed)
    return value


def rename(plan: Plan, names: Mapping[str, str]) -> Plan:
    """Return a plan with sensors renamed in all its texts. names: new ones by old ones, which are
    whole words there."""
    if not names:
        return plan
    longest_first = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    words = re.compile(rf"(?<![\w-])(?:{longest_first})(?!\w)")
    renamed: Plan = replace_texts(
        plan, lambda text: names.get(text) or words.sub(lambda word: names[word[0]], text)
    )
    return renamed
