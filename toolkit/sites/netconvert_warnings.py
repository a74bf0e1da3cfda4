"""Notes from what netconvert warns of while it reads a map.

netconvert goes on without what it cannot read and warns of each such place in a line. Lines that
only tell how a shape was rounded, or what this computer lacks, are dropped; all others become
notes, one for each kind."""

import re
from collections.abc import Iterable

PREFIX = "Warning: "
MAX_NOTES = 12  # kinds that are written out; more are counted
MAX_CHARACTERS = 160  # from the warning that a note quotes

# beginnings of warnings (regular expressions) that are dropped: the road remains as the map has it
SHAPE_ONLY = (
    r"Environment variable SUMO_HOME",
    r"Network contains very large coordinates",
    r"Speed of .* connection .* reduced",
    r"(Found|Removing) sharp (angle|turn)",
    r"Found angle of",
    r"(Edge|Connection) '.*' has a grade of",
    r"Connection '.*' is only .*m short",
    r"Intersecting left turns at junction",
    r"Lane '.*' is not connected from any incoming edge",
    r"Edge '.*' is not connected to outgoing edges",
    r"Ambiguity in turnarounds computation",
    r"Guessing signalID for link index",
    r"Could not compute (smooth shape|intersection of conflicting|indirect left turn)",
    r"Could not avoid overlapping shape",
    r"Ignoring additional sidewalk lane",
    r"Shape for junction '.*' has distance",
    r"Custom shape has distance",
    r"Almost duplicate s-value",
    r"Replacing loaded roundabout",
    r"Reducing junction cluster",
    r"Ambiguous (node|traffic light) type for node cluster",
    r"The traffic light '.*' (has a high cycle time|does not control any links)",
    r"Discarding invalid crossing",
    r"Edge '.*' overlaps with edge",
    r"Ignoring geoidgrids and vgridshift",
    r"Failed to create transformation",
    r"geoReference format '.*' currently not supported",
    r"Could not set projection",
    r".*as it connects same junctions",
)
_SHAPE_ONLY = re.compile("|".join(SHAPE_ONLY))
# names and numbers, without which warnings of one kind are equal
_VALUES = re.compile(r"'[^']*'|-?\d+(\.\d+)?")


def list_warnings(messages: str) -> list[str]:
    """Return the warnings in the text that netconvert wrote to its standard error.

    They are lines without their prefix; netconvert's counts of warnings are left out."""
    lines = [line.strip() for line in messages.splitlines() if line.startswith(PREFIX)]
    return [line.removeprefix(PREFIX) for line in lines if " total messages of type:" not in line]


def describe_warnings(warnings: Iterable[str]) -> list[str]:
    """Return notes for the user, one for each kind of warning of netconvert.

    A note quotes the first warning of its kind and counts the others. Warnings that match
    `SHAPE_ONLY` get no note; kinds after the first `MAX_NOTES` are counted in a last note."""
    # warnings of one kind, by their text without names and numbers
    warnings_by_kind: dict[str, list[str]] = {}
    for warning in warnings:
        if not _SHAPE_ONLY.match(warning):
            kind = _VALUES.sub("_", warning)
            warnings_by_kind.setdefault(kind, []).append(warning)
    groups = list(warnings_by_kind.values())
    notes = [_describe_kind(group) for group in groups[:MAX_NOTES]]
    if len(groups) > MAX_NOTES:
        notes.append(f"netconvert warned of {len(groups) - MAX_NOTES} kinds of things more")
    return notes


def _describe_kind(warnings: list[str]) -> str:
    """Note for the warnings of one kind, at least one."""
    first = warnings[0].rstrip(".")
    quoted_warning = first if len(first) <= MAX_CHARACTERS else f"{first[:MAX_CHARACTERS]}..."
    more_text = f", and {len(warnings) - 1} more like it" if len(warnings) > 1 else ""
    return f"netconvert warned: {quoted_warning}{more_text}"
