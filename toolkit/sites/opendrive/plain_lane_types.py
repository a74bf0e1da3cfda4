"""Types of lanes that netconvert gets: users and limits."""

from collections import Counter
from collections.abc import Mapping

from toolkit.sites.network import FOOT, MOTOR
from toolkit.sites.opendrive.carriageways import Carriageway, PlainWriter
from toolkit.sites.opendrive.lane_rules import USERS, USUAL_SPEED_MPS, LaneUse, find_use
from toolkit.sites.opendrive.lane_sections import LaneSection, SectionLane

NO_LIMIT_NOTE = f"roads without a limit in the map are driven at {USUAL_SPEED_MPS * 3.6:.0f} km/h"


def find_lane_type(
    writer: PlainWriter,
    road: Carriageway,
    section: LaneSection,
    lane: SectionLane,
    defaults: Mapping[str, float],
    problems: Counter[str],
) -> str:
    """Name of SUMO's type for a lane, by its type in the map and its use at its section's start.

    Lanes of one type and use share a name, which is kept in `writer.uses`; the usual use of a type
    has the type's name. road: the lane's carriageway, whose `closed` lanes nobody uses; defaults:
    limits (m/s) by type of road; problems: differences from the map are counted there."""
    use = find_use(
        road=road.element, section=section, lane=lane, defaults=dict(defaults), problems=problems
    )
    if use.limit is None and "passenger" in use.users and road.junction == "-1":
        problems[NO_LIMIT_NOTE] = 1  # counted once a road, however many lanes it has
    if lane in road.closed:
        use = LaneUse(users=(), limit=None)
    use = _close_turning_lane(section, lane, use, problems)
    kind = lane.kind if lane.kind in USERS else "unknown"
    usual_use = LaneUse(users=tuple(USERS.get(kind, "").split()), limit=None)
    # the number makes a new name; a use that is known keeps its name
    name = kind if use == usual_use else f"{kind}.{len(writer.uses)}"
    return writer.uses.setdefault((kind, use), name)


def _close_turning_lane(
    section: LaneSection, lane: SectionLane, use: LaneUse, problems: Counter[str]
) -> LaneUse:
    """Return the use of a lane, closed if it is for both directions between driven lanes.

    use: the lane's by its type and rules, which comes back for all other lanes; problems: lanes for
    both directions are counted there."""
    is_for_both = lane.kind == "bidirectional" or lane.element.get("direction") == "both"
    has_vehicles = bool(use.users) and set(use.users) != {FOOT}
    if not has_vehicles or not is_for_both:
        return use
    if any(_is_driven(other) for other in section.lanes if other is not lane):
        problems["lanes for both directions (turning lanes) are closed to through traffic"] += 1
        return LaneUse(users=(), limit=None)
    problems["lanes for both directions are driven in the direction of their side only"] += 1
    return use


def _is_driven(lane: SectionLane) -> bool:
    """True for a lane of motor vehicles in the direction of its side."""
    is_standard = lane.element.get("direction", "standard") == "standard"
    return is_standard and lane.kind != "bidirectional" and USERS.get(lane.kind) == MOTOR
