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
    walked_side = "both"
    if junction in ("roundabout", "circular"):
        road_tags["junction"] = junction
        walked_side = "left" if lefthand else "right"
    if not _is_walked(tags):
        walked_side = "no"
    sidewalk = _read_sidewalk(tags, walked_side)
    if reading.oneway == "-1" and sidewalk in _OPPOSITE:  # the road's line is turned round
        sidewalk = _OPPOSITE[sidewalk]
    road_tags["sidewalk"] = sidewalk or walked_side
    name = " ".join(tags.get("name", "").split())
    if name:
        road_tags["name"] = name[:MAX_NAME_CHARACTERS]
    return road_tags


def _is_walked(tags: Tags) -> bool:
    """True for the tags of a road of a class with footways, which people may walk along."""
    has_footways = ROADS[tags["highway"]][3]
    is_barred = tags.get("foot") in ("no", "use_sidepath") or tags.get("motorroad") == "yes"
    return has_footways and not is_barred


def _read_sidewalk(tags: Tags, usual_side: str) -> str | None:
    """Sides of a road with footways by its tags: both, left, right or no; None if unknown.

    Sides are as the line runs in the map. usual_side: footways along roads of its class."""
    plain = tags.get("sidewalk", "")
    if plain in _PLAIN_SIDEWALKS:
        return _PLAIN_SIDEWALKS[plain]
    values = {side: tags.get(f"sidewalk:{side}") for side in _FOOTWAY_SIDES}
    present = [side for side, value in values.items() if value in ("yes", "separate")]
    if present:
        return "both" if "both" in present or len(present) == 2 else present[0]
    missing = {side for side, value in values.items() if value in ("no", "none")}
    if "both" in missing or {"left", "right"} <= missing:
        return "no"
    return _OPPOSITE[missing.pop()] if missing and usual_side == "both" else None
