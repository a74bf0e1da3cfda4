"""Tags of OpenStreetMap's roads that netconvert gets: direction, lanes, footways and name.

Streets without tagged footways get them by their class."""

from toolkit.sites.osm.road_rules import (
    ROADS,
    RoadReading,
    Tags,
    number_lanes,
    number_one_way_lanes,
)

MAX_NAME_CHARACTERS = 60

_FOOTWAY_SIDES = ("both", "left", "right")
# value of sidewalk: footways in netconvert's words
_PLAIN_SIDEWALKS = {
    **{side: side for side in (*_FOOTWAY_SIDES, "no")},
    "none": "no",
    "yes": "both",
    "separate": "both",
}
_OPPOSITE = {"left": "right", "right": "left"}


def make_road_tags(tags: Tags, reading: RoadReading, *, lefthand: bool) -> dict[str, str]:
    """Make the tags of a road that netconvert gets: class, direction, lanes, footways and name.

    tags: the map's; reading: rules of the road, whose line is turned round if it is one-way
    against it; lefthand: traffic keeps left."""
    kind = tags["highway"]
    junction = tags.get("junction", "").strip().lower()
    if reading.oneway == "no":
        road_tags = {"highway": kind, "oneway": "no", **number_lanes(tags)}
    else:
        lanes = number_one_way_lanes(tags, reading.oneway)
        road_tags = {"highway": kind, "oneway": "yes", **lanes}
    usual_side = "both"  # side of the footways if no tag states it
    if junction in ("roundabout", "circular"):
        road_tags["junction"] = junction
        usual_side = "left" if lefthand else "right"  # none on the island
    if not _is_walked(tags):
        usual_side = "no"
    sidewalk = _read_sidewalk(tags, usual_side)
    if reading.oneway == "-1" and sidewalk in _OPPOSITE:  # the road's line is turned round
        sidewalk = _OPPOSITE[sidewalk]
    road_tags["sidewalk"] = sidewalk or usual_side
    name = " ".join(tags.get("name", "").split())
    if name:
        road_tags["name"] = name[:MAX_NAME_CHARACTERS]
    return road_tags


def _is_walked(tags: Tags) -> bool:
    """True for the tags of a road of a class with footways, which people may walk along."""
    has_footways = ROADS[tags["highway"]].has_footways
    is_barred = tags.get("foot") in ("no", "use_sidepath") or tags.get("motorroad") == "yes"
    return has_footways and not is_barred


def _read_sidewalk(tags: Tags, usual_side: str) -> str | None:
    """Sides of a road with footways by its tags: both, left, right or no; None if unknown.

    Sides are as the line runs in the map. usual_side: footways along roads of its class."""
    value = tags.get("sidewalk", "")
    if value in _PLAIN_SIDEWALKS:
        return _PLAIN_SIDEWALKS[value]
    value_by_side = {side: tags.get(f"sidewalk:{side}") for side in _FOOTWAY_SIDES}
    sides_with = [side for side, value in value_by_side.items() if value in ("yes", "separate")]
    if sides_with:
        is_both = "both" in sides_with or len(sides_with) == 2
        return "both" if is_both else sides_with[0]
    sides_without = {side for side, value in value_by_side.items() if value in ("no", "none")}
    if "both" in sides_without or {"left", "right"} <= sides_without:
        return "no"
    # one side is without: the usual footways are on the other
    if sides_without and usual_side == "both":
        return _OPPOSITE[sides_without.pop()]
    return None
