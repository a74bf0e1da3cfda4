"""Contents of a plan: figures, names and sentences for plan.json, pages and drawings.

Nothing in it depends on the clock, so the same question has the same plan, byte for byte. kbit are
per frame, 1 kbit = 1000 bit. Prices are in the plan's currency. AP and recall are at the plan's IoU
unless a field names another, and always by the detector on traffic that no search saw. An undefined
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
from placement_env.handover.ground import GroundGrid, GroundShares
from placement_env.handover.mounted import MaterialItem, PlannedSensor, PoleLoad
from placement_env.links import LINK_SHARE
from placement_env.report.motion_content import MotionFigures
from toolkit.arrays import Bool, Float32, Mask
from toolkit.display import Card, Displayed, Table, figure_digits, format_share
from toolkit.objects import Detections, Objects
from toolkit.runtime.text_values import read_own_table
from toolkit.sites.site import Site

PLAN_VERSION = 1  # in plan.json
CONFIDENCE = 0.95  # level of every interval
TEXTS: dict[str, Any] = read_own_table(__file__, "texts.toml")


@dataclass(frozen=True)
class Judgement:
    """The detector's result for one sensor set, on some frames and in some cases.

    Attributes:
        ap: Average precision, combined over the classes that count.
        low: Lower end of the AP's interval, a bootstrap over blocks of frames; NaN for few blocks.
        high: Upper end of the interval, NaN like `low`.
        recall: Share of the vehicles that are detected, combined like the AP.
        precision: Share of the detections that hit; None without detections or objects.
        vehicles: Number of objects to detect; one that stays counts in every frame.
        frames: Number of frames they are in.
        kind: "vehicle", or "object" if several classes count."""

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
        """Number of decimals that this many objects support."""
        return figure_digits(self.vehicles)

    @property
    def known(self) -> bool:
        """Return True if there are enough frames for an interval, so that AP can be compared."""
        return not math.isnan(self.low)

    def format_ap(self) -> str:
        """Format the AP with as many decimals as its objects support."""
        return format_share(self.ap, self.vehicles)

    def describe_interval(self) -> str:
        """Describe its interval, with as many decimals as its objects support."""
        return describe_interval(self.low, self.high, self.digits)


def overlap(first: Judgement, second: Judgement) -> bool:
    """Return True if the intervals of two AP overlap. Both must be `known`."""
    return not (first.low > second.high or second.low > first.high)


@dataclass(frozen=True)
class PlanOption:
    """A sensor set that was considered.

    `left`, `over_levels` and `over_errors` are None unless the plan asks for them. All figures but
    `over_errors` are at the first error profile.

    Attributes:
        sensors: Names of its candidates.
        price: Total price, in the plan's currency.
        kbit_per_sensor: Mean kbit per sensor and frame.
        kbit: Mean kbit of the set per frame.
        predicted: AP by the fidelity of the searches.
        judged: Result of the intact set; None if it was not judged.
        searches: Names of the searches that found it.
        mean_ap: Mean AP over IoU 0.7, 0.8 and 0.9.
        left: Result after failures, over the levels of traffic if there are several.
        over_levels: Result of the intact set over the levels of traffic.
        over_errors: Result over the error profiles, with failures and levels.
        poles: Names of the sensors' mounts.
        fits_links: Whether the links carry what is sent in the judged frames."""

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
    """Result of the chosen set for one zone, range, approach, level or error profile.

    name: name of the part or condition; judged: None without vehicles; mean_points: mean number
    of the set's points on a vehicle, None without vehicles."""

    name: str
    judged: Judgement | None
    mean_points: float | None = None


@dataclass(frozen=True)
class DrawingResult:
    """Result at one drawing of what no map knows.

    judged: result of the chosen set; poles: poles of the set that would be chosen at this drawing
    only."""

    judged: Judgement
    poles: tuple[str, ...]


@dataclass(frozen=True)
class ClassSeen:
    """Coverage of one class.

    Attributes:
        label: Name of the class.
        objects: Number of its road users; one that stays counts in every frame.
        least_points: Points from which a road user counts as covered.
        share: Share of the road users that are covered, None without any."""

    label: str
    objects: int
    least_points: int
    share: float | None


@dataclass(frozen=True)
class ClassAP:
    """Result of the chosen set for one class.

    weight: 0 if the class does not count; iou: IoU from which a detection counts."""

    label: str
    weight: float
    iou: IoUs
    judged: Judgement


@dataclass(frozen=True)
class SchemeFigures:
    """Result of the chosen set under one fusion scheme.

    as_good: whether its AP cannot be distinguished from the AP of the plan's scheme."""

    scheme: str
    iou: IoUs
    judged: Judgement
    kbit_per_sensor: float
    as_good: bool = False


@dataclass(frozen=True)
class DrawnErrors:
    """AP of the chosen set over several draws of one error profile.

    Attributes:
        profile: Name of the error profile.
        aps: AP of each draw, whose errors are the same in all frames.
        mean: Mean of `aps`.
        tenth: AP below which one draw in ten falls.
        frames: Number of frames of each draw."""

    profile: str
    aps: tuple[float, ...]
    mean: float
    tenth: float
    frames: int


@dataclass(frozen=True)
class SensorWorth:
    """Shapley value of one sensor, in AP, and its interaction with each other sensor.

    sensor: its name; synergy: AP that the pair adds together beyond the sum of both, by the other
    sensor's name; negative if they see the same."""

    sensor: str
    shapley: float
    synergy: dict[str, float]


@dataclass(frozen=True)
class FailureCase:
    """Result of the remaining sensors after some fail. failed: names of the failed ones."""

    failed: tuple[str, ...]
    judged: Judgement


@dataclass(frozen=True)
class BuildStep:
    """Next sensor to build, with the price and the result of all sensors built so far."""

    sensor: str
    price: float
    judged: Judgement


@dataclass(frozen=True)
class Verdict:
    """The answer in one sentence.

    met: whether the required AP is reached, None without a requirement; reasons: sentences that
    explain why it is not."""

    met: bool | None
    sentence: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan(Displayed):
    """A deployment plan.

    Attributes:
        question: Every option, as words or numbers.
        site: Name of the site.
        detector: The detector in words.
        iou: IoU from which a detection counts; several for their mean.
        scheme: Name of the fusion scheme.
        currency: Currency of all prices, "" for units of one ordinary pole.
        verdict: The answer in one sentence.
        chosen: The set to build, None if no set may be built.
        best: The best set if price does not count.
        confidence: Confidence with which the race of sets of its size ended.
        why: Sentences that explain the choice.
        sensors: Planned sensors, in the order of the chosen set.
        considered: Every set that reached the comparison, best first.
        near_optimal: Other sets that are as good as the best on the same frames, cheap ones first.
        front: Sets that no other beats in AP, kbit per sensor and price together, by price.
        schemes: Results under every fusion scheme.
        by_zone: Results by zone of the area.
        by_range: Results by distance from the nearest sensor.
        by_approach: Results by lane approach.
        by_level: Results by level of traffic.
        by_errors: Results by error profile.
        by_draw: Results over draws of each profile with errors.
        by_drawing: Results at several drawings of the site, on the traffic of the comparison.
        by_class: Coverage of each class.
        class_ap: AP of each class.
        motion: The chosen set on continuous traffic, None without a set.
        worth: Shapley value of each sensor.
        failures: Results after one or two failures.
        links: Load of each link.
        materials: Items to order.
        running: What the catalogue's rates add to the price.
        order: Order in which to build the sensors.
        ground: Shares of the ground that sensors see.
        blind_streets: Area of lanes (m²) that no sensor sees, by street.
        poles_unused: Names of poles without a sensor.
        origins: Number of things at the site by origin ("mapped", "surveyed", "drawn") and kind.
        head: Title, client, date and author, as far as the catalogue gives them.
        stock: Poles, models and prices that sets were chosen from, as by `format_stock`.
        assumptions: Sentences on what the figures assume.
        unknown: Sentences on what the plan does not know.
        provenance: Digests of all inputs, seeds and versions."""

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
    motion: MotionFigures | None = None
    worth: tuple[SensorWorth, ...] = ()
    failures: tuple[FailureCase, ...] = ()
    links: tuple[PoleLoad, ...] = ()
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

    def describe_judged(self, noun: str) -> str:
        """Describe the number of considered sets that were judged on all frames, and on fewer.

        noun: words after the first number. At least one set must have been judged."""
        frames = [option.judged.frames for option in self.considered if option.judged]
        whole_count = frames.count(max(frames))
        sampled_count = len(frames) - whole_count
        text = f"{whole_count} {noun}"
        return f"{text}, {sampled_count} in {min(frames)} frames of it" if sampled_count else text

    def format_drawn_ap(self, ap: float, drawn: DrawnErrors) -> str:
        """Format an AP over draws of errors, with as many decimals as a draw's objects support.

        A draw has only some of the frames, so its number of objects is estimated from all frames.

        ap: AP to format, such as `drawn.mean`; drawn: results over the draws."""
        judgement = self.chosen.counted if self.chosen else None
        draw_objects = 0
        if judgement and judgement.frames:
            draw_objects = judgement.vehicles * drawn.frames // judgement.frames
        return format_share(ap, draw_objects)

    def _card(self) -> Card:
        tables = {"sensors": self._list_sensors, "considered": self._list_options}
        return Card(f"Plan for {self.site}", (self.verdict.sentence,), tables)

    def _list_sensors(self) -> Table:
        """Return a table of the planned sensors: columns by name, a row for each.

        Lengths are in m, angles in degrees; the price is the model's plus the pole's."""
        table: dict[str, list[Any]] = {}
        for name in ("pole", "model", "x", "y", "height", "bearing_deg", "tilt_deg", "kbit"):
            table[name] = [getattr(sensor, name) for sensor in self.sensors]
        table["price"] = [sensor.model_price + sensor.pole_price for sensor in self.sensors]
        return table

    def _list_options(self) -> Table:
        """Return a table of the compared sets: columns by name, a row for each set.

        AP, interval and recall of sets that are not judged are None."""
        table: dict[str, list[Any]] = {}
        for name in ("poles", "price", "kbit", "predicted"):
            table[name] = [getattr(option, name) for option in self.considered]
        judgements = [option.counted for option in self.considered]
        for name in ("ap", "low", "high", "recall"):
            table[name] = [getattr(judgement, name, None) for judgement in judgements]
        table["sensors"] = [option.sensors for option in self.considered]
        return table

    def as_dict(self) -> dict[str, object]:
        """Return the values for plan.json, without the logo; numbers may still be infinite."""
        head = {key: text for key, text in self.head.items() if key != "logo"}
        return {"coview_plan": PLAN_VERSION, **asdict(self), "head": head}


@dataclass(frozen=True, eq=False)
class SceneMoment:
    """One frame for pictures.

    Attributes:
        clouds: Points of each sensor in the site's frame (m), thinned.
        truth: Road users of the frame.
        detections: Detections of the frame.
        truth_hit: Whether each road user is detected.
        truth_ignored: Whether each road user does not count.
        detection_hit: Whether each detection hits.
        detection_ignored: Whether each detection does not count."""

    clouds: tuple[Float32[np.ndarray, "_ 3"], ...]
    truth: Objects
    detections: Detections
    truth_hit: Mask
    truth_ignored: Mask
    detection_hit: Bool[np.ndarray, " m"]
    detection_ignored: Bool[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class Planned(Displayed):
    """A plan with the inputs of its pages and maps.

    Attributes:
        plan: The plan.
        site: The site with the chosen sensors mounted.
        candidates: Candidate sensors, None without any.
        ground: What the chosen sensors see, None if no set may be built.
        moments: Frames for pictures, empty if no set may be built."""

    plan: Plan
    site: Site
    candidates: Candidates | None = None
    ground: GroundGrid | None = None
    moments: tuple[SceneMoment, ...] = ()

    def _card(self) -> Card:
        has_sensors = self.plan.chosen is not None
        drawing = "placement_env.report.maps:draw_planned" if has_sensors else ""
        return replace(self.plan._card(), drawing=drawing)


def replace_texts(value: Any, change: Callable[[str], str]) -> Any:
    """Return a value with all its texts changed, and keys of mappings too.

    Mappings, tuples, lists and dataclasses are entered and built again; any other value comes back
    as it is.

    change: function that returns the new text for a text."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {
            replace_texts(key, change): replace_texts(item, change) for key, item in value.items()
        }
    if isinstance(value, tuple | list):
        changed_items = [replace_texts(item, change) for item in value]
        return changed_items if isinstance(value, list) else tuple(changed_items)
    if is_dataclass(value) and not isinstance(value, type):
        changed_fields = {}
        for entry in fields(value):
            changed_fields[entry.name] = replace_texts(getattr(value, entry.name), change)
        return replace(value, **changed_fields)
    return value


def rename(plan: Plan, names: Mapping[str, str]) -> Plan:
    """Return a plan with sensors renamed in all its texts.

    names: new names by old names; an old name is replaced only as a whole word."""
    if not names:
        return plan
    # the longest names first, so that none is taken for a part of another; "-" belongs to names
    longest_first = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
    words = re.compile(rf"(?<![\w-])(?:{longest_first})(?!\w)")

    def replace_names(text: str) -> str:
        # a text that is nothing but a name needs no search
        return names.get(text) or words.sub(lambda word: names[word.group()], text)

    renamed_plan: Plan = replace_texts(plan, replace_names)
    return renamed_plan
