"""Traffic rules of OpenStreetMap's roads: who may drive which way, and how fast.

Access is read from the general to the particular: access, vehicle, motor_vehicle and then the kind
of vehicle; the last tag present holds, and for one direction its key before all. A road that a user
may not take is closed to that user; emergency vehicles may take every road. Rules that a network
cannot hold (hours, lanes for some users, local traffic only) are counted in notes.
https://wiki.openstreetmap.org/wiki/Key:access https://wiki.openstreetmap.org/wiki/Key:maxspeed"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from toolkit.runtime.text_values import read_own_table
from toolkit.sites import network as nets
from toolkit.sites.osm.road_class import RoadClass

Tags = Mapping[str, str]
Users = frozenset[str]

ROADS = {  # by the value of highway
    "motorway": RoadClass(lanes=2, speed=36.1, priority=14, has_footways=False),
    "trunk": RoadClass(lanes=2, speed=27.8, priority=13, has_footways=False),
    "primary": RoadClass(lanes=1, speed=13.9, priority=12, has_footways=True),
    "secondary": RoadClass(lanes=1, speed=13.9, priority=11, has_footways=True),
    "tertiary": RoadClass(lanes=1, speed=13.9, priority=10, has_footways=True),
    "unclassified": RoadClass(lanes=1, speed=13.9, priority=8, has_footways=True),
    "residential": RoadClass(lanes=1, speed=8.3, priority=7, has_footways=True),
    "living_street": RoadClass(lanes=1, speed=2.8, priority=6, has_footways=True),
    "busway": RoadClass(lanes=1, speed=8.3, priority=5, has_footways=False),
    "service": RoadClass(lanes=1, speed=5.6, priority=4, has_footways=False),
    "cycleway": RoadClass(lanes=1, speed=5.6, priority=2, has_footways=False),
    "motorway_link": RoadClass(lanes=2, speed=36.1, priority=14, has_footways=False),
    "trunk_link": RoadClass(lanes=2, speed=27.8, priority=13, has_footways=False),
    "primary_link": RoadClass(lanes=1, speed=13.9, priority=12, has_footways=True),
    "secondary_link": RoadClass(lanes=1, speed=13.9, priority=11, has_footways=True),
    "tertiary_link": RoadClass(lanes=1, speed=13.9, priority=10, has_footways=True),
}

MPH_M_S = 0.44704
KNOT_M_S = 1852 / 3600
KMH_M_S = 1 / 3.6
UNITS_M_S = dict.fromkeys(("", "km/h", "kmh", "kph", "kmph", "km/hr"), KMH_M_S)
UNITS_M_S |= {"mph": MPH_M_S, "mi/h": MPH_M_S, "knots": KNOT_M_S, "knot": KNOT_M_S, "kn": KNOT_M_S}
INCH_M = 0.0254
# t or m of a unit of weight or size; other values are in t or m
_SIZE_UNITS = {"kg": 0.001, "lbs": 0.000454, "st": 0.907, "'": 0.3048, "ft": 0.3048}
MIN_SPEED_M_S = 0.5
MAX_SPEED_M_S = 100.0

_MOTOR = frozenset(nets.MOTOR.split())
_ALWAYS = "emergency"  # may take every road
_LONG = frozenset({"truck", "bus", "coach"})
_WHEELS = "access vehicle"
_ENGINES = f"{_WHEELS} motor_vehicle"
# SUMO's vehicle class: keys of its access; the last one present holds
_KEY_TEXTS = {
    "passenger": f"{_ENGINES} motorcar",
    "taxi": f"{_ENGINES} motorcar psv taxi",
    "bus": f"{_ENGINES} psv bus",
    "coach": f"{_ENGINES} tourist_bus coach",
    "delivery": f"{_ENGINES} goods",
    "truck": f"{_ENGINES} hgv",
    "motorcycle": f"{_ENGINES} motorcycle",
    "moped": f"{_ENGINES} moped",
    "bicycle": f"{_WHEELS} bicycle",
}
_KEYS = {user: tuple(keys.split()) for user, keys in _KEY_TEXTS.items()}
ACCESS_KEYS = frozenset(key for keys in _KEYS.values() for key in keys)
# values of access by their effect: open, open to local traffic, closed
_OPEN = {
    "yes",
    "permissive",
    "designated",
    "official",
    "public",
    "discouraged",
    "true",
    "1",
    "allowed",
    "mandatory",
}
_LOCAL = {
    "destination",
    "customers",
    "residents",
    "residential",
    "permit",
    "employees",
    "visitors",
    "members",
    "tenants",
    "guests",
}
_CLOSED = {
    "no",
    "private",
    "restricted",
    "false",
    "0",
    "none",
    "agricultural",
    "forestry",
    "military",
    "emergency",
    "use_sidepath",
    "dismount",
    "construction",
    "prohibited",
}
_DELIVERS = {"delivery", "loading", "hgv", "goods"}
_PUBLIC = {"bus", "psv", "taxi", "public_transport"}
# values of oneway: along the line of the road, against it, both ways
_FORWARD = {"yes", "true", "1"}
_BACKWARD = {"-1", "reverse"}
_BOTH_WAYS = {"no", "false", "0"}
# values of busway; any other is a lane on the road
_NO_BUS_LANES = {"", "no", "none", "separate", "opposite"}
_HALF_THE_TIME = {"reversible", "alternating"}
_PASSABLE = {  # barriers on a road that cars drive through unless their tags close them
    "gate",
    "lift_gate",
    "swing_gate",
    "cattle_grid",
    "toll_booth",
    "border_control",
    "entrance",
    "no",
    "kerb",
    "height_restrictor",
    "sally_port",
    "arch",
    "checkpoint",
    "rising_bollard",
    "hampshire_gate",
}

# kinds of rules, each followed by a colon and the number of roads
LOCAL_NOTE = "roads for local traffic only (destination, customers), driven through here"
HOURS_NOTE = "roads with rules for some hours or vehicles only (:conditional), not used"
OWN_LANES_NOTE = (
    "roads with lanes for some users only (bus:lanes, busway, cycleway=lane, hov), open to all here"
)
ARROWS_NOTE = "roads with arrows on their lanes (turn:lanes, change:lanes), not used"
DIRECTION_NOTE = (
    "roads with a oneway that is not understood, one-way only if that is usual for their class"
)
CONTRAFLOW_NOTE = (
    "one-way streets open both ways to some (oneway:bicycle, cycleway=opposite), who ride one "
    "way here"
)
SOME_AGAINST_NOTE = (
    "roads that run one way for some users, against the others (oneway:bus=-1), who do not drive "
    "there here"
)
LANES_AGAINST_NOTE = (
    "one-way streets with lanes against their traffic (lanes:backward), which are left out"
)
EITHER_NOTE = (
    "roads that run one way at a time (oneway=reversible, alternating), open both ways here"
)
UNREAD_NOTE = "roads with access that is not understood, open as is usual for their class"
UNREAD_SPEED_NOTE = (
    "roads with a speed limit that is not understood, driven as is usual for their class"
)
VARIABLE_NOTE = (
    "roads with a speed limit that signs set (maxspeed=signals, variable), driven as is usual "
    "for their class"
)
SPEEDS_NOTE = (
    "roads with speed limits for some lanes or vehicles (maxspeed:hgv, maxspeed:lanes), not used"
)
LANES_NOTE = "roads with a number of lanes that is not understood"
SUM_NOTE = "roads with more or fewer lanes than lanes:forward and lanes:backward have, which count"
MIDDLE_NOTE = "roads with a middle lane for both directions (lanes:both_ways), not used"
SINGLE_NOTE = "roads with one lane for both directions (lanes=1), drawn with one each way"
WIDTHS_UNUSED_NOTE = "roads with a width of their own (width, width:lanes), drawn with usual lanes"
PLACEMENT_NOTE = (
    "roads drawn along one of their lanes (placement), whose line is taken as their middle"
)
SLOPES_NOTE = "roads that rise (incline), level here"
SIZES_NOTE = "roads with limits of weight or size, closed to trucks and buses"
CYCLE_ROAD_NOTE = (
    "roads for bicycles first (bicycle_road, cyclestreet), open to motor traffic as their access "
    "says"
)
BARRIER_HOURS_NOTE = "barriers with rules for some hours or vehicles only (:conditional), not used"
BARRIER_UNREAD_NOTE = (
    "barriers with access that is not understood, open or shut as is usual for their kind"
)
CLOSED_NOTE = "roads closed to cars, as the map says"
# tag: limit (t or m) up to which the road is closed to trucks and buses
_SIZE_LIMITS = {
    "maxweight": 7.5,
    "maxheight": 3.5,
    "maxlength": 10.0,
    "maxwidth": 2.5,
    "maxaxleload": 4.0,
    "maxweightrating": 7.5,
    "maxheight:physical": 3.5,
    "maxwidth:physical": 2.5,
}
_TRUCK_LIMITS = {f"{key}:hgv": limit for key, limit in _SIZE_LIMITS.items()}


@dataclass(frozen=True)
class RoadRules:
    """Rules of a piece of road: who may drive on it each way, and how fast.

    Attributes:
        kind: class of road, a key of `ROADS`.
        users: SUMO's vehicle classes that may drive along its line, and against it.
        speeds: limits (m/s) along its line, and against it.
        number: number of the piece if its two directions differ, else None."""

    kind: str
    users: tuple[Users, Users]
    speeds: tuple[float, float]
    number: int | None = None

    @property
    def sides_differ(self) -> bool:
        """True if the two directions have different rules."""
        return self.users[0] != self.users[1] or self.speeds[0] != self.speeds[1]


@dataclass(frozen=True)
class RoadReading:
    """Rules that the tags of a road give.

    Attributes:
        rules: rules along the line of the road and against it; for a one-way road, the rules of
            its traffic in both places.
        oneway: "yes", "no", or "-1" for one way against the line of the road.
        notes: texts of kinds of rules that are not used, each once."""

    rules: RoadRules
    oneway: str
    notes: tuple[str, ...]


def usual_users(kind: str) -> Users:
    """SUMO's vehicle classes that may take a road without tags of access.

    kind: class of the road, its value of highway."""
    if kind == "cycleway":
        return frozenset({"bicycle"})
    if kind == "busway":
        return frozenset({"bus", _ALWAYS})
    return _MOTOR - {"bicycle", "moped"} if kind.startswith("motorway") else _MOTOR


def usual_rules(kind: str) -> RoadRules:
    """Rules of a road without further tags, by its class (a key of `ROADS`)."""
    users = usual_users(kind)
    speed = ROADS[kind].speed
    return RoadRules(kind, (users, users), (speed, speed))


def read_rules(tags: Tags) -> RoadReading:
    """Read the rules of a road by its tags. Its class (highway) must be a key of `ROADS`."""
    tags = _read_older_keys(
        {key.strip().lower(): value.strip().lower() for key, value in tags.items()}
    )
    if tags.get("service") == "emergency_access" and not ACCESS_KEYS & tags.keys():
        tags["access"] = "no"
    if any(
        tags.get(key) == "yes"
        for key in ("abandoned", "disused", "construction", "proposed", "razed")
    ):
        tags = {
            key: value for key, value in tags.items() if key.partition(":")[0] not in ACCESS_KEYS
        }
        tags["access"] = "no"
    notes = _list_unused(tags)
    oneway = _read_oneway(tags, notes)
    # users along the line of the road, and against it; speeds below are in the same order
    sides = [_read_users(tags, side, notes) for side in ("forward", "backward")]
    _close_one_way(tags, oneway, sides, notes)
    contraflow_users = _list_contraflow(tags)
    if oneway == "yes" and contraflow_users and number_lanes(tags).get("lanes:backward"):
        # they have a separate lane
        oneway = "no"
        sides[1] = sides[1] & (contraflow_users | {_ALWAYS})
    elif oneway != "no" and contraflow_users:
        notes.append(CONTRAFLOW_NOTE)
    if oneway != "no" and number_lanes(tags).get(_name_sides(oneway)[1]):
        notes.append(LANES_AGAINST_NOTE)
    speeds = [_read_speed(tags, side, notes) for side in ("forward", "backward")]
    driven = sides
    if oneway != "no":
        driven = [sides[1] if oneway == "-1" else sides[0]]
    has_cars = any("passenger" in users for users in driven)
    if tags["highway"] not in ("cycleway", "busway") and not has_cars:
        notes.append(CLOSED_NOTE)
    # the line of such a road is turned round for netconvert
    if oneway == "-1":
        sides = sides[::-1]
        speeds = speeds[::-1]
    if oneway != "no":
        sides = [sides[0]] * 2
        speeds = [speeds[0]] * 2
    rules = RoadRules(tags["highway"], (sides[0], sides[1]), (speeds[0], speeds[1]))
    return RoadReading(rules, oneway, tuple(dict.fromkeys(notes)))


def _read_older_keys(tags: Tags) -> dict[str, str]:
    """Return tags with the keys of today: access:bus as bus, maxspeed:both as maxspeed.

    A tag with today's key counts before one with the older key."""
    older = {f"access:{key}": key for key in ACCESS_KEYS} | {"maxspeed:both": "maxspeed"}
    return {older[key]: value for key, value in tags.items() if key in older} | dict(tags)


def is_barred(tags: Tags) -> bool:
    """True for the tags of a node of a road that no car can pass.

    Such nodes are bollards and locked gates, for example; crossings never bar the road."""
    tags = _read_older_keys(
        {key.strip().lower(): value.strip().lower() for key, value in tags.items()}
    )
    barrier = tags.get("barrier")
    if barrier is None and not ACCESS_KEYS & tags.keys():
        return False
    is_open: bool | None = None if barrier is None else barrier in _PASSABLE  # None: unknown
    if barrier == "bollard":
        is_open = tags.get("bollard") == "rising"
    for key in _KEYS["passenger"]:  # from the general to the particular, which counts
        value = tags.get(key, "")
        if value in _OPEN | _LOCAL | _DELIVERS:
            is_open = True
        elif value in _CLOSED:
            is_open = False
    if tags.get("locked") == "yes":
        is_open = False
    return is_open is False and tags.get("highway") != "crossing"


def describe_barrier(tags: Tags) -> list[str]:
    """Return notes on the rules in the tags of a node of a road that are not used."""
    tags = {key.strip().lower(): value.strip().lower() for key, value in tags.items()}
    notes = []
    access_tags = {
        key: value for key, value in tags.items() if key.partition(":")[0] in ACCESS_KEYS
    }
    if any(key.endswith(":conditional") for key in access_tags):
        notes.append(BARRIER_HOURS_NOTE)
    known_values = _OPEN | _LOCAL | _CLOSED | _DELIVERS | _PUBLIC
    # "no", a known value, for a key that is not there
    if any(access_tags.get(key, "no") not in known_values for key in _KEYS["passenger"]):
        notes.append(BARRIER_UNREAD_NOTE)
    return notes


def number_lanes(tags: Tags) -> dict[str, str]:
    """Numbers of lanes of a road by key: lanes, lanes:forward and lanes:backward.

    Keys without a whole number from 1 to 8 are left out. If both directions have their number,
    `lanes` is the sum, whatever its tag is."""
    numbers: dict[str, str] = {}
    for key in ("lanes", "lanes:forward", "lanes:backward"):
        value = tags.get(key, "").strip()
        if re.fullmatch("[1-8]", value):
            numbers[key] = value
    if "lanes:forward" in numbers and "lanes:backward" in numbers:
        numbers["lanes"] = str(int(numbers["lanes:forward"]) + int(numbers["lanes:backward"]))
    return numbers


def number_one_way_lanes(tags: Tags, oneway: str) -> dict[str, str]:
    """Tag `lanes` of a one-way street: its number of lanes, without lanes against its traffic.

    oneway: "yes" or "-1". Empty if the number is unknown."""
    numbers = number_lanes(tags)
    driven_key, against_key = _name_sides(oneway)
    lanes_driven = numbers.get(driven_key)
    lanes_against = numbers.get(against_key)
    lanes = lanes_driven or numbers.get("lanes")
    if lanes_driven is None and lanes_against is not None:
        # all lanes less those against the traffic
        remaining = int(numbers.get("lanes", lanes_against)) - int(lanes_against)
        lanes = str(remaining) if remaining > 0 else None
    return {} if lanes is None else {"lanes": lanes}


def _name_sides(oneway: str) -> tuple[str, str]:
    """Keys of the number of lanes along the traffic of a one-way street, and against it.

    oneway: "yes", or "-1" for traffic against the line of the road."""
    if oneway == "-1":
        return "lanes:backward", "lanes:forward"
    return "lanes:forward", "lanes:backward"


def name_types(rules: Iterable[RoadRules]) -> dict[RoadRules, str]:
    """Name SUMO's edge type for each of the rules, in their order.

    The name is the class of road for its usual rules, and the class with a number for others."""
    names: dict[RoadRules, str] = {}
    for rule in rules:
        if rule not in names:
            is_usual = rule == usual_rules(rule.kind)
            names[rule] = rule.kind if is_usual else f"{rule.kind}.{len(names)}"
    return names


def format_types(names: Mapping[RoadRules, str]) -> str:
    """Text of SUMO's type file for edge types, and for the usual rules of all classes of road.

    names: names of the types by their rules.

    Roads whose directions differ have a unique speed, so that netconvert does not join them to
    others; `restrict_edges` gives them their real speed."""
    elements = []
    usual_names = {usual_rules(kind): kind for kind in ROADS}
    for rule, name in {**usual_names, **names}.items():
        road_class = ROADS[rule.kind]
        # both directions are alike unless there is a number
        users, _ = rule.users
        speed, _ = rule.speeds
        if rule.number is not None:
            speed = 50.0 + 0.01 * rule.number  # m/s: unique, faster than any road, replaced later
        attributes: dict[str, Any] = {
            "id": f"highway.{name}",
            "numLanes": road_class.lanes,
            "speed": f"{speed:.3f}".rstrip("0"),
            "priority": road_class.priority,
            "oneway": "false",
            "width": 1.8 if rule.kind == "cycleway" else 3.25,  # a lane's (m)
            "allow": _format_users(users),
        }
        elements.append(nets.format_element("type", attributes))
    return nets.format_xml("types", elements)


def _format_users(users: Users) -> str:
    # Text of users in SUMO's order of vehicle classes.
    return " ".join(user for user in nets.MOTOR.split() if user in users)


def restrict_edges(edges: Iterable[Any], names: Mapping[RoadRules, str]) -> None:
    """Give plain edges (XML elements) the users and the speed of their direction, in place.

    Only roads whose directions differ are changed. names: names of edge types by their rules."""
    rules_by_type = {
        f"highway.{name}": rule for rule, name in names.items() if rule.number is not None
    }
    for edge in edges:
        rule = rules_by_type.get(edge.get("type", ""))
        if rule is None:
            continue
        # edges whose id begins with - run against the line of the road
        is_against = str(edge.get("id")).startswith("-")
        users = rule.users[1 if is_against else 0]
        speed = f"{rule.speeds[1 if is_against else 0]:.3f}"
        for element in [edge, *edge.findall("lane")]:
            if element.get("speed") is not None:
                element.set("speed", speed)
            # footways stay as they are
            if element.get("allow") and set(element.get("allow").split()) - {"pedestrian"}:
                element.set("allow", _format_users(users))
        edge.set("speed", speed)


def count_notes(notes: Iterable[str]) -> list[str]:
    """Return each note once, followed by the number of times it is there."""
    return [f"{note}: {count}" for note, count in Counter(notes).items()]


def _read_users(tags: Tags, side: str, notes: list[str]) -> Users:
    """SUMO's vehicle classes that may drive in a direction of a road, by its tags.

    side: "forward" or "backward", as the line of the road runs; notes: kinds of rules that are
    not used are added to it."""
    kind = tags["highway"]
    users_without_tags = usual_users(kind)
    if tags.get("motorroad") == "yes":
        users_without_tags -= {"bicycle", "moped"}
    users = set[str]()
    for user, keys in _KEYS.items():
        is_usual = user in users_without_tags
        if _is_open(tags, user, keys, side, usual=is_usual, notes=notes):
            users.add(user)
    if any(_is_limit_below(tags, key, limit) for key, limit in _SIZE_LIMITS.items()):
        users -= _LONG
        notes.append(SIZES_NOTE)
    elif any(_is_limit_below(tags, key, limit) for key, limit in _TRUCK_LIMITS.items()):
        users -= {"truck"}
        notes.append(SIZES_NOTE)
    if kind == "cycleway" and users == {"bicycle"}:
        return frozenset(users)
    return frozenset(users | {_ALWAYS})


def _is_open(
    tags: Tags, user: str, keys: Collection[str], side: str, *, usual: bool, notes: list[str]
) -> bool:
    """Return True if a user (SUMO's vehicle class) may drive in a direction.

    keys: access keys of the user, from the general to the particular; side: "forward" or
    "backward"; usual: True if roads of this class are open to the user; notes: notes on rules that
    are not understood are added."""
    is_open = usual
    for key in keys:
        for name in (key, f"{key}:{side}"):
            if name in tags:
                answer = _read_access(tags[name], user, notes)
                if key == "access" and tags[name] == "designated":  # for an unknown user
                    notes.append(UNREAD_NOTE)
                # nobody cycles on a motorway because of access=yes
                is_too_general = key in _WHEELS.split() and answer and not usual
                if answer is not None and not is_too_general:
                    is_open = answer
    return is_open


def _read_access(value: str, user: str, notes: list[str]) -> bool | None:
    """True if a value of access is open to a user (SUMO's class), None if it is not understood.

    value: one or several words with semicolons between them; notes: notes on local traffic and on
    values that are not understood are added."""
    values = {word.strip() for word in value.split(";")} - {""}
    known_values = _OPEN | _LOCAL | _CLOSED | _DELIVERS | _PUBLIC
    if not values or not values <= known_values or (values & _OPEN and values & _CLOSED):
        notes.append(UNREAD_NOTE)
        return None
    if values & _OPEN:
        return True
    if values & _LOCAL:
        notes.append(LOCAL_NOTE)
        return True
    if values & _DELIVERS and user in ("delivery", "truck"):
        return True
    return bool(values & _PUBLIC and user in ("bus", "taxi"))


def _is_limit_below(tags: Tags, key: str, limit: float) -> bool:
    """Return True if the value of a tag of weight or size is at most `limit` (t or m).

    The value is a number, its unit, and inches after feet, as in 7'6"."""
    match = re.match(r"(\d+(?:[.,]\d+)?)\s*(t|m|kg|lbs|st|'|ft)?\s*(\d+)?", tags.get(key, ""))
    if match is None:
        return False
    number, unit = match[1], match[2]
    further_number = match[3]
    scale = _SIZE_UNITS.get(unit or "", 1.0)
    inches = float(further_number) if further_number and unit in ("'", "ft") else 0.0
    return float(number.replace(",", ".")) * scale + inches * INCH_M < limit + 1e-9


def _read_oneway(tags: Tags, notes: list[str]) -> str:
    """Direction of a road's traffic: "yes" along its line, "-1" against it, "no" for both.

    notes: kinds of rules that are not used are added to it."""
    value = tags.get("oneway", "")
    # the tags of vehicles count unless oneway gives a direction
    for key in ("oneway:vehicle", "oneway:motor_vehicle", "oneway:motorcar"):
        if value not in _FORWARD | _BACKWARD:
            value = tags.get(key, value)
    if value in _HALF_THE_TIME:
        notes.append(EITHER_NOTE)
        return "no"
    is_ring = tags.get("junction") in ("roundabout", "circular")
    oneway = "yes" if is_ring or tags["highway"] == "motorway" else "no"  # without a tag
    if value in _FORWARD:
        oneway = "yes"
    elif value in _BACKWARD:
        oneway = "-1"
    elif value in _BOTH_WAYS:
        oneway = "no"
    if value and value not in _FORWARD | _BACKWARD | _BOTH_WAYS:
        notes.append(DIRECTION_NOTE)
    is_for_all = tags.get("oneway", "") in _FORWARD | _BACKWARD or "oneway:vehicle" in tags
    if value in _FORWARD | _BACKWARD and not is_for_all:
        notes.append(CONTRAFLOW_NOTE)
    return oneway


def _close_one_way(tags: Tags, oneway: str, sides: list[Users], notes: list[str]) -> None:
    """Close the direction against the tag oneway:USER to its users.

    sides: users along the line of the road, and against it, changed in place; oneway: direction of
    the road, "yes", "-1" (against the line) or "no"; notes: notes on what is not used are added."""
    known_values = _FORWARD | _BACKWARD | _BOTH_WAYS
    for user, keys in _KEYS.items():
        values = [tags[f"oneway:{key}"] for key in keys if f"oneway:{key}" in tags]
        if not values:
            continue
        value = values[-1]  # the most particular key counts
        if value not in known_values:
            notes.append(EITHER_NOTE if value in _HALF_THE_TIME else DIRECTION_NOTE)
        if value in _FORWARD | _BACKWARD:
            closed_side = 1 if value in _FORWARD else 0
            sides[closed_side] -= {user}
            # the road's traffic runs in the direction that is closed to this user
            if oneway == ("-1" if value in _FORWARD else "yes"):
                notes.append(SOME_AGAINST_NOTE)


def _list_contraflow(tags: Tags) -> Users:
    """Users (SUMO's vehicle classes) who may drive a one-way street both ways, by its tags."""
    exempt_keys = {  # access keys such as bicycle
        key.removeprefix("oneway:")
        for key in tags
        if key.startswith("oneway:") and tags[key] in _BOTH_WAYS
    }
    for key, value in tags.items():
        if key.startswith("cycleway") and value.startswith("opposite"):
            exempt_keys.add("bicycle")
        if key.startswith("busway") and value.startswith("opposite"):
            exempt_keys.add("bus")
    return frozenset(user for user, keys in _KEYS.items() if exempt_keys & set(keys))


def _read_speed(tags: Tags, side: str, notes: list[str]) -> float:
    """Speed limit (m/s) of a direction, the usual one without a tag.

    side: "forward" or "backward"; notes: limits that are not used are added to it."""
    usual_speed = ROADS[tags["highway"]].speed
    for key in (  # the first with a speed counts
        f"maxspeed:{side}",
        "maxspeed",
        "maxspeed:type",
        "source:maxspeed",
        "zone:maxspeed",
        "zone:traffic",
    ):
        value = tags.get(key, "")
        states_limit = key == "maxspeed" or key.endswith(side)
        # the other keys state sources of the limit: only a country's zone, as de:urban, has a speed
        if not value or (not states_limit and ":" not in value):
            continue
        if value in ("signals", "variable"):
            notes.append(VARIABLE_NOTE)
            return usual_speed
        speed = parse_speed(value)
        if speed is not None:
            return speed
        if key.startswith("maxspeed"):
            notes.append(UNREAD_SPEED_NOTE)
            return usual_speed
    return usual_speed


def parse_speed(value: str) -> float | None:
    """Parse a speed limit (m/s) as mappers write it, the least of several.

    value: numbers with or without unit, or names of a country's zones such as de:urban, with
    semicolons between them. Returns None if one is not understood or is no likely speed."""
    speeds = []
    for speed_text in value.split(";"):
        if speed_text.strip():
            speed = _parse_one_speed(speed_text.strip().lower())
            if speed is None or not MIN_SPEED_M_S < speed <= MAX_SPEED_M_S:
                return None
            speeds.append(speed)
    return min(speeds, default=None)


def _parse_one_speed(text: str) -> float | None:
    """Limit (m/s) of one number with its unit, or of one zone; None if it is not understood.

    text: lower case, such as "50", "30 mph" or "de:urban"; a number without a unit is km/h."""
    number_match = re.fullmatch(r"(\d+(?:[.,]\d+)?)\s*([a-z/]*)", text)
    if number_match is not None:
        number, unit_name = number_match.groups()
        unit = UNITS_M_S.get(unit_name)
        return None if unit is None else float(number.replace(",", ".")) * unit
    zones = _speed_zones()
    if text in zones["everywhere"]:
        return float(zones["everywhere"][text]) * KMH_M_S
    # such as de:urban, de-by:rural, de:zone:30 and de:30_zone
    zone_match = re.fullmatch(
        r"([a-z]{2})(?:-[a-z]+)?:(?:zone[:_]?)?([a-z_]+|\d+)(?:[:_]zone)?", text
    )
    if zone_match is None:
        return None
    country, zone = zone_match.groups()
    unit = MPH_M_S if country in zones["miles"] else KMH_M_S
    if zone.isdigit():
        return float(zone) * unit
    limit = zones["limits"].get(zone, {}).get(country)
    return None if limit is None else float(limit) * unit


@cache
def _speed_zones() -> dict[str, Any]:
    # limits by zone and country, read once
    return read_own_table(__file__, "speed_zones.toml")


def _list_unused(tags: Tags) -> list[str]:
    """List a note, in words, for each kind of rule in a road's tags that is not used."""
    notes = []
    conditional = [key.removesuffix(":conditional") for key in tags if key.endswith(":conditional")]
    if any(_bears_on_traffic(key) for key in conditional):
        notes.append(HOURS_NOTE)
    if any(_has_reserved_lanes(key, value) for key, value in tags.items()):
        notes.append(OWN_LANES_NOTE)
    if any(key.startswith(("turn:lanes", "change:lanes")) for key in tags):
        notes.append(ARROWS_NOTE)
    if any(
        re.fullmatch(r"maxspeed:(lanes|hgv|bus|psv|goods|motorcycle|trailer|\w+:lanes).*", key)
        for key in tags
    ):
        notes.append(SPEEDS_NOTE)
    # numbers of lanes that cannot be read
    if {"lanes", "lanes:forward", "lanes:backward"} & tags.keys() - number_lanes(tags).keys():
        notes.append(LANES_NOTE)
    used_total = number_lanes(tags).get("lanes")  # the sum of both directions, if they have numbers
    total = tags.get("lanes", "")
    if re.fullmatch("[1-8]", total) and total != used_total and "lanes:both_ways" not in tags:
        notes.append(SUM_NOTE)
    if tags.get("lanes") == "1" and _read_oneway(tags, []) == "no":
        notes.append(SINGLE_NOTE)
    if any(key in tags for key in ("width", "est_width", "width:carriageway", "width:lanes")):
        notes.append(WIDTHS_UNUSED_NOTE)
    if any(key.partition(":")[0] == "placement" for key in tags):
        notes.append(PLACEMENT_NOTE)
    if re.search(r"[1-9]|up|down", tags.get("incline", "")):
        notes.append(SLOPES_NOTE)
    if "lanes:both_ways" in tags:
        notes.append(MIDDLE_NOTE)
    if tags.get("bicycle_road") == "yes" or tags.get("cyclestreet") == "yes":
        notes.append(CYCLE_ROAD_NOTE)
    return notes


def _bears_on_traffic(key: str) -> bool:
    """Return True for the key of a rule of access, speed, direction, lanes or turns."""
    head = key.partition(":")[0]
    other_heads = {"maxspeed", "oneway", "lanes", "turn", "restriction", "hov"}
    return head in ACCESS_KEYS | other_heads


def _has_reserved_lanes(key: str, value: str) -> bool:
    """Return True for a tag that reserves lanes for some users, such as bus:lanes=|designated.

    A value of such a tag has a part for each lane, divided by |."""
    head, _, suffix = key.partition(":")
    parts = suffix.split(":")
    if key.endswith(":conditional"):
        return False
    if "lanes" in parts and head in ACCESS_KEYS | {"hov"}:
        lane_values = set(value.split("|"))
        return lane_values - {"", "yes"} != set()
    if head == "lanes" and parts[0] in ("bus", "psv", "taxi", "hov"):
        return True
    if head == "busway":
        return value not in _NO_BUS_LANES
    if head == "cycleway" and suffix in ("", "left", "right", "both"):
        return value in ("lane", "opposite_lane", "share_busway", "shared_lane")
    return key == "hov" and value in ("designated", "yes", "lane")


def number_pieces(rules: Iterable[RoadRules]) -> list[RoadRules]:
    """Return the rules of pieces of road, numbered by their place if their directions differ."""
    return [replace(rule, number=k) if rule.sides_differ else rule for k, rule in enumerate(rules)]
