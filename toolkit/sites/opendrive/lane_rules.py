"""Traffic rules of an OpenDRIVE road: who may use its lanes, and how fast.

ASAM OpenDRIVE 1.4 to 1.8 lists the types of lanes (`e_laneType`); a lane of another type is closed.
<access> of a lane allows some users and closes it to all others, or denies some (11.10). A lane's
own limit counts first (11.9), then the road's <type> there (10.4), then the header's for roads of
its type. Users are in SUMO's words."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree

from toolkit.sites.network import FOOT, MOTOR
from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.lane_sections import LaneSection, SectionLane

USUAL_SPEED_MPS = 13.89  # on a road without a limit in the map
NO_LIMIT_MPS = 36.11  # 130 km/h, on roads whose map says "no limit"
MAX_LIKELY_SPEED_MPS = 45.0  # 160 km/h; a limit above it is noted
WALKING_SPEED_MPS = 2.78
BICYCLE_SPEED_MPS = 5.56
UNITS_MPS = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704}

_RAMPS = ("entry", "exit", "onRamp", "offRamp", "connectingRamp", "slipLane", "mwyEntry", "mwyExit")
_CAR_POOL = "bus coach taxi motorcycle emergency"  # how many sit in a private car is in no map
_CLOSED = (
    "none",
    "parking",
    "shoulder",
    "border",
    "curb",
    "median",
    "restricted",
    "stop",
    "roadWorks",
)
# type of a lane: its usual users in SUMO's words, "" for none
USERS: dict[str, str] = {
    "driving": MOTOR,
    **dict.fromkeys(_RAMPS, MOTOR),
    "bidirectional": MOTOR,
    "shared": f"{MOTOR} {FOOT}",
    "sidewalk": FOOT,
    "walking": FOOT,
    "biking": "bicycle",
    "bus": "bus coach",
    "taxi": "taxi",
    "HOV": _CAR_POOL,
    "tram": "tram",
    "rail": "rail rail_urban rail_electric rail_fast",
    **dict.fromkeys(_CLOSED, ""),
}
# who uses all lanes of a road of each type
_ROADS = {"pedestrian": (FOOT,), "bicycle": ("bicycle",)}
_NOTED = ("restricted", "stop", "roadWorks")  # closed types on which a reader may expect traffic
# value of restriction of <access>: SUMO's users
_RESTRICTED = {
    "passengerCar": "passenger",
    "bus": "bus coach",
    "delivery": "delivery",
    "emergency": "emergency",
    "taxi": "taxi",
    "truck": "truck",
    "trucks": "truck",
    "bicycle": "bicycle",
    "motorcycle": "motorcycle moped",
    "pedestrian": FOOT,
}

Side = Literal["left", "right"]


@dataclass(frozen=True)
class LaneUse:
    """Users of a lane, in SUMO's words, and its limit (m/s), None if the map gives none."""

    users: tuple[str, ...]
    limit: float | None


def find_cuts(road: ElementTree.Element, sections: Sequence[LaneSection]) -> set[float]:
    """Find the places along s (m) at which a limit or an access rule of a <road> changes."""
    cuts = {read_number(element, "s", 0.0) for element in road.findall("type")}
    for section in sections:
        for lane in section.lanes:
            rules = [*lane.element.findall("speed"), *lane.element.findall("access")]
            # A section may be a later part of a <laneSection>: it begins `lane.offset` m after the
            # start of that <laneSection>, from which sOffset of the rules counts.
            description_start = section.start - lane.offset
            cuts |= {description_start + read_number(rule, "sOffset", 0.0) for rule in rules}
    return cuts


def find_use(
    road: ElementTree.Element,
    section: LaneSection,
    lane: SectionLane,
    defaults: dict[str, float],
    problems: Counter[str],
) -> LaneUse:
    """Find the users and the limit of a lane at its section's start.

    Differences from the map are counted in `problems`, by the words of their note.

    road: the <road>; section: the lane's; defaults: limits (m/s) that the header sets, by type of
    road."""
    users = _find_users(section, lane, problems)
    for type_element in _list_active(road.findall("type"), section.start, key="s"):
        road_type = type_element.get("type", "")
        allowed_users = _ROADS.get(road_type)  # None for a road that is open to all
        if allowed_users is not None and set(users) - set(allowed_users) - {FOOT}:
            problems[f"lanes of roads of type {road_type!r} are closed to other traffic"] += 1
            users = tuple(user for user in users if user in allowed_users) or allowed_users
    has_motor_traffic = bool(set(users) & set(MOTOR.split()))
    if not has_motor_traffic or lane.kind == "biking":
        return LaneUse(users, limit=None)
    return LaneUse(users, limit=_find_limit(road, section, lane, defaults, problems))


def read_defaults(root: ElementTree.Element, problems: Counter[str]) -> dict[str, float]:
    """Read the limits (m/s) that the header sets by type of road (1.8, <defaultRegulations>).

    Limits that are no speeds are counted in `problems`."""
    limits = {}
    for regulation in root.findall("header/defaultRegulations/roadRegulations"):
        for speed in regulation.findall("semantics/speed"):
            limit = _parse_limit(speed.get("value"), speed.get("unit"), problems)
            if speed.get("type") == "maximum" and limit is not None:
                limits[regulation.get("type", "")] = limit
    return limits


def _find_users(section: LaneSection, lane: SectionLane, problems: Counter[str]) -> tuple[str, ...]:
    """Users of a lane by its type and access rules, in SUMO's words; empty for a closed lane.

    problems: differences from the map are counted there, by the words of their note."""
    kind = lane.kind
    if kind not in USERS:
        problems[f"lanes of type {kind[:30]!r} are closed, as the type is unknown"] += 1
        return ()
    if kind in _NOTED:
        problems[f"lanes of type {kind!r} are closed to traffic"] += 1
    if kind == "HOV":
        problems["HOV lanes are open to buses, taxis and motorcycles only"] += 1
    if lane.element.get("roadWorks") in ("true", "1"):
        problems["lanes with roadWorks are closed to traffic"] += 1
        return ()
    for key in ("dynamicLaneType", "dynamicLaneDirection"):
        if lane.element.get(key) in ("true", "1"):
            problems[f"lanes with {key} stay as the map describes them"] += 1
    access_rules = _list_active(lane.element.findall("access"), lane.offset)
    return _apply_access(USERS[kind].split(), access_rules, problems)


def _apply_access(
    users: Sequence[str], rules: Iterable[ElementTree.Element], problems: Counter[str]
) -> tuple[str, ...]:
    """Users who may use a lane by the access rules of one place, in SUMO's words.

    users: usual for the lane; rules: <access> elements; problems: differences from the map are
    counted there. A rule that allows some users closes the lane to all others, even if traffic does
    not have them."""
    allowed_users: set[str] = set()
    denied_users: set[str] = set()
    is_exclusive = False  # a rule allows some users
    for rule in rules:
        names = [rule.get("restriction")]  # groups of users in the map's words
        names += [element.get("type") for element in rule.findall("restriction")]
        names = [name for name in names if name not in (None, "none")]
        allows = rule.get("rule") == "allow"
        if rule.get("rule") not in ("allow", "deny") and names:
            problems["<access> rules without allow or deny count as deny"] += 1
        for name in names:
            is_exclusive = is_exclusive or allows
            if name not in _RESTRICTED:
                problems[f"<access> rules are for {str(name)[:30]!r}, which is not simulated"] += 1
                continue
            named_users = allowed_users if allows else denied_users
            named_users.update(_RESTRICTED[str(name)].split())  # in SUMO's words
    open_users = list(users)
    if is_exclusive:
        open_users = [user for user in users if user in allowed_users]
        # a rule may also allow users who are not usual, as bicycles on a driving lane
        open_users += sorted(allowed_users - set(users))
    return tuple(user for user in open_users if user not in denied_users)


def _find_limit(
    road: ElementTree.Element,
    section: LaneSection,
    lane: SectionLane,
    defaults: dict[str, float],
    problems: Counter[str],
) -> float | None:
    """Limit (m/s) of a lane at its section's start: the lane's, the road's there, or the header's
    for the road's type (`defaults`); None without any."""
    for speed in _list_active(lane.element.findall("speed"), lane.offset):
        limit = _parse_limit(speed.get("max"), speed.get("unit"), problems)
        if limit is not None:
            return limit
    for type_element in _list_active(road.findall("type"), section.start, key="s"):
        for speed in type_element.findall("speed"):
            limit = _parse_limit(speed.get("max"), speed.get("unit"), problems)
            if limit is not None:
                return limit
        road_type = type_element.get("type", "")
        if road_type in defaults:
            return defaults[road_type]
    return None


def _parse_limit(text: str | None, unit: str | None, problems: Counter[str]) -> float | None:
    """Speed limit (m/s) of an attribute's text; None if the text gives no speed.

    unit: one of `UNITS_MPS`, m/s if None; problems: odd limits are counted there."""
    text = (text or "").strip()
    if text == "no limit":
        problems[f"limits of 'no limit' count as {NO_LIMIT_MPS * 3.6:.0f} km/h"] += 1
        return NO_LIMIT_MPS
    if text in ("", "undefined"):
        return None
    try:
        value = float(text) * UNITS_MPS[unit or "m/s"]
    except (ValueError, KeyError):
        value = 0.0
    if not 0.0 < value < 1000.0:  # m/s; also for a text that is no number
        problems[
            f"limits of {text[:20]!r} in {(unit or 'm/s')[:10]!r} are no speeds and were left out"
        ] += 1
        return None
    if value > MAX_LIKELY_SPEED_MPS:
        problems[
            f"limits of {text[:20]} {unit or 'm/s (no unit is given)'} are {value * 3.6:.0f} km/h"
        ] += 1
    return value


def _list_active(
    rules: list[ElementTree.Element], place: float, key: str = "sOffset"
) -> list[ElementTree.Element]:
    """Elements of rules that hold at a place: each rule holds until others start.

    place: m along the road, counted as the rules' starts are; key: attribute of a rule's start
    (m)."""
    started_rules = [rule for rule in rules if read_number(rule, key, 0.0) <= place + 1e-6]
    last_start = max((read_number(rule, key, 0.0) for rule in started_rules), default=0.0)
    return [rule for rule in started_rules if read_number(rule, key, 0.0) == last_start]
