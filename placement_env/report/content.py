"""What a plan says: plain figures, names and sentences, from which plan.json, the pages and the drawings are made.

Everything here but `Ground` and `Moment`, which are arrays for maps and the scene, goes to plan.json as it is
(`Plan.as_dict`). Nothing here depends on the clock, so the same question has the same plan, byte for byte. kbit are of
a frame, 1 kbit = 1000 bit; prices in the plan's currency; AP and recall at the plan's IoU unless a field says
otherwise, always by the detector on traffic that no search saw. Where a figure is undefined it is None.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from placement_env.cases import IoUs
from toolkit.arrays import Bool, Float32, Float64
from toolkit.objects import Detections, Objects

RATE = 10.0  # frames a second that a link carries
CONFIDENCE = 0.95  # of every interval


@dataclass(frozen=True)
class Judgement:
    """What the detector makes of one sensor set in traffic that no search saw. low, high: interval of the AP from a
    bootstrap over blocks of frames; vehicles: how many were to be detected, in so many frames; kind: what they are, a
    vehicle, or an object where other classes count: ap and recall are those of the classes combined then."""

    ap: float
    low: float
    high: float
    recall: float
    precision: float | None
    vehicles: int
    frames: int
    kind: str = "vehicle"


def overlap(one: Judgement, other: Judgement) -> bool:
    """Whether the intervals of two AP overlap, so that the data do not tell them apart."""
    return one.low <= other.high and other.low <= one.high


@dataclass(frozen=True)
class PlannedSensor:
    """One sensor of the chosen set, as whoever mounts it needs it.

    x, y, z: where it hangs (m, site frame); longitude, latitude: degrees, None where the site does not say where on
    earth it is; height: above the foot of its pole (m); bearing_deg: compass bearing of its optical axis, clockwise
    from north (+y of the site's map); tilt_deg: below the horizon; kbit, peak_kbit: mean and greatest of a frame;
    capacity_kbit: of its link.
    """

    name: str
    pole: str
    x: float
    y: float
    z: float
    longitude: float | None
    latitude: float | None
    height: float
    bearing_deg: float
    tilt_deg: float
    model: str
    model_price: float
    pole_price: float
    kbit: float
    peak_kbit: float
    capacity_kbit: float


@dataclass(frozen=True)
class PlanOption:
    """A sensor set that was considered: names of candidates, price, what is sent, the AP that the searches' fidelity
    predicts and what the detector says (None: not judged). searches: those that answered with it; mean_ap: at IoU 0.7,
    0.8 and 0.9, in the traffic it was judged on; over_levels: what the detector says of it over levels of traffic, the
    worst of them or their mean, None where the plan asks for none; left: what it says of what is left of it when
    sensors fail, over the levels where there are such, None where the plan asks for no failures; over_errors: what it
    says of it over error profiles, the worst of them or their mean, with failures and levels where there are such, None
    where the plan asks for one profile. The other figures are at the first profile."""

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

    @property
    def counted(self) -> Judgement | None:
        """By which sets are compared: what is left where failures are asked for, else the intact set, over levels of
        traffic and error profiles where such are asked for."""
        if self.over_errors is not None:
            return self.over_errors
        intact = self.judged if self.over_levels is None else self.over_levels
        return intact if self.left is None else self.left


@dataclass(frozen=True)
class BreakdownRow:
    """One zone, range, approach, level of traffic or error profile: its figures with the chosen set; `judged` is None
    without any vehicle."""

    name: str
    judged: Judgement | None
    mean_points: float | None = None


@dataclass(frozen=True)
class ClassSeen:
    """Road users of one class in the judged traffic, detected or not: how many, and the share of them on which the
    chosen set has at least `least_points` points. This is a share of coverage and no AP."""

    label: str
    objects: int
    least_points: int
    share: float | None


@dataclass(frozen=True)
class ClassAP:
    """One class that counts: its weight in the mean, the IoU at which a detection of it counts, and what the detector
    makes of the chosen set for it alone."""

    label: str
    weight: float
    iou: IoUs
    judged: Judgement


@dataclass(frozen=True)
class SchemeFigures:
    """The chosen set under one fusion scheme at one IoU, or in the mean over several."""

    scheme: str
    iou: IoUs
    judged: Judgement
    kbit_per_sensor: float


@dataclass(frozen=True)
class SensorWorth:
    """Shapley value of one sensor of the chosen set in AP, and its interaction with each of the others (by name)."""

    sensor: str
    shapley: float
    synergy: dict[str, float]


@dataclass(frozen=True)
class FailureCase:
    """What is left when these sensors fail."""

    failed: tuple[str, ...]
    judged: Judgement


@dataclass(frozen=True)
class LinkLoad:
    """The link of one pole at `RATE` frames a second: Mbit/s in the mean and the greatest frame, and its capacity."""

    pole: str
    mbit_s: float
    peak_mbit_s: float
    capacity_mbit_s: float
    share: float
    fits: bool


@dataclass(frozen=True)
class MaterialItem:
    """One line of the bill of materials."""

    item: str
    count: int
    unit_price: float
    price: float


@dataclass(frozen=True)
class BuildStep:
    """Which sensor to build next, what is spent then, and what those built so far detect."""

    sensor: str
    price: float
    judged: Judgement


@dataclass(frozen=True)
class GroundShares:
    """Shares of the area's open ground (no building or other solid on it): seen by at least 1, 2, 3 sensors, seen by
    none, of the lanes alone seen by none; m² that each sensor sees, by name; m² of open ground and of blind spots."""

    seen_by: tuple[float, float, float]
    blind: float
    blind_lanes: float
    sensor_m2: dict[str, float]
    open_m2: float
    blind_m2: float


@dataclass(frozen=True)
class Verdict:
    """The answer in one sentence. met: whether the requirement is, None where none was stated; reasons: where it is
    not, what excludes what, a sentence each."""

    met: bool | None
    sentence: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """A deployment plan. question: what was asked, every option in words or numbers; site: name; detector: name in
    words; iou: at which a detection counts, several for their mean; scheme: of the fusion; currency: of all prices, ""
    for units of one ordinary pole; chosen: None where no set may be built; near_optimal: sets whose interval overlaps
    the chosen one's; front: no other set is better in AP, kbit per sensor and price at once, by price; poles_unused:
    names; assumptions, unknown: sentences; provenance: digests of all inputs, seeds, versions.
    """

    question: dict[str, Any]
    site: str
    detector: str
    iou: IoUs
    scheme: str
    currency: str
    verdict: Verdict
    chosen: PlanOption | None
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
    by_class: tuple[ClassSeen, ...] = ()
    class_ap: tuple[ClassAP, ...] = ()
    worth: tuple[SensorWorth, ...] = ()
    failures: tuple[FailureCase, ...] = ()
    links: tuple[LinkLoad, ...] = ()
    materials: tuple[MaterialItem, ...] = ()
    order: tuple[BuildStep, ...] = ()
    ground: GroundShares | None = None
    poles_unused: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """For plan.json."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Ground:
    """What each sensor sees of the area's ground, on a grid of square cells, by casting its rays at the empty site.

    x, y: middles of columns and rows (m, site frame, ascending); seen: whether the middle of a cell of open ground is
    in view with nothing in between; density: points that a frame puts on the cell's open ground, per m²; open_ground:
    no solid stands there and no pond lies there; lanes, footways: what the cell is.
    """

    x: Float64[np.ndarray, " nx"]
    y: Float64[np.ndarray, " ny"]
    seen: Bool[np.ndarray, "sensors ny nx"]
    density: Float32[np.ndarray, "sensors ny nx"]
    open_ground: Bool[np.ndarray, "ny nx"]
    lanes: Bool[np.ndarray, "ny nx"]
    footways: Bool[np.ndarray, "ny nx"]

    @property
    def cell(self) -> float:
        """Side of a cell (m)."""
        return float(self.x[1] - self.x[0]) if len(self.x) > 1 else float(self.y[1] - self.y[0])


@dataclass(frozen=True, eq=False)
class Moment:
    """One frame for pictures: the points of each sensor, what is there, what was detected, and which of both hit
    (`truth_hit` over truth, `detection_hit` over detections) or do not count (`truth_ignored`, `detection_ignored`)."""

    clouds: tuple[Float32[np.ndarray, "_ 3"], ...]
    truth: Objects
    detections: Detections
    truth_hit: Bool[np.ndarray, " n"]
    truth_ignored: Bool[np.ndarray, " n"]
    detection_hit: Bool[np.ndarray, " m"]
    detection_ignored: Bool[np.ndarray, " m"]
