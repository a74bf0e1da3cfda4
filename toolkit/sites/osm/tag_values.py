"""Values of OpenStreetMap's tags: lengths, and ways above or below the ground."""

import re

from toolkit.sites.osm.road_rules import Tags

MAX_LENGTH_M = 1000.0
FOOT_M = 0.3048

_FEET = re.compile(r"(\d+(?:\.\d+)?)\s*(?:'|ft|feet)\s*(?:(\d+(?:\.\d+)?)\s*(?:\"|''|in)?)?")
_METRES = re.compile(r"~?\s*(\d+(?:\.\d+)?)\s*(?:m|metres?|meters?)?")
_LAYER = re.compile(r"\s*([+-]?\d{1,3})\s*")


def metres(text: str | None) -> float | None:
    """Parse a length (m) as mappers write it, in metres or feet; the greatest of several.

    text: value of a tag, several lengths with semicolons between them, or None for a missing tag.
    Returns None if no length between 0 and `MAX_LENGTH_M` is in it."""
    lengths = []
    for length_text in (text or "").lower().replace(",", ".").split(";"):
        imperial_match = _FEET.fullmatch(length_text.strip())
        metric_match = _METRES.fullmatch(length_text.strip())
        if imperial_match:
            feet, inches = imperial_match[1], imperial_match[2] or 0
            lengths.append(round(FOOT_M * (float(feet) + float(inches) / 12), 4))
        elif metric_match:
            lengths.append(float(metric_match[1]))
    return max((length for length in lengths if 0 < length < MAX_LENGTH_M), default=None)


def is_underground(tags: Tags) -> bool:
    """True for the tags of something below the ground or inside a building."""
    if tags.get("location") in ("underground", "indoor"):
        return True
    if tags.get("indoor", "no") not in ("no", "area"):
        return True
    layer = _read_layer(tags)
    is_below = layer is not None and layer < 0 and "tunnel" in tags
    return is_below or tags.get("tunnel", "no") not in ("no", "building_passage")


def is_bridge(tags: Tags) -> bool:
    """True for the tags of a way on a bridge."""
    return tags.get("bridge", "no") != "no"


def is_off_ground(tags: Tags) -> bool:
    """True for the tags of a bridge, and of a road on another layer than the ground's."""
    layer = _read_layer(tags)
    return is_bridge(tags) or (layer is not None and layer != 0)


def _read_layer(tags: Tags) -> int | None:
    """Layer of a way, 0 for the ground's and without a tag; None if it is no number."""
    layer = _LAYER.fullmatch(tags.get("layer", "0"))
    return None if layer is None else int(layer[1])
