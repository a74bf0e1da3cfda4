"""Directions as people type them: compass bearings, or headings by name, and tilts below the
horizon, in degrees.

Schedules and pages print tenths of a degree and centimetres. A number that is typed as it was
printed means the present one in full, so a row of the schedule changes nothing."""

import math

from placement_env.live.variant import TILT_SPAN_RAD, LiveSensor
from toolkit.sites.georeference import bearing_deg, heading_from_bearing
from toolkit.sites.site import Mount, Site

MAX_TURN_DEG = 360.0  # greatest bearing or heading, either way
# steps of the last digit that schedules and pages print
PRINTED_ANGLE_DEG = 0.1
PRINTED_HEIGHT_M = 0.01
HEADING_PREFIX = "heading="  # before a number that is no bearing
SLACK = 1e-6  # rounding that is forgiven, in degrees or m


def parse_heading(site: Site, text: str, present: float | None = None) -> float:
    """Return the heading (rad, counter-clockwise from the site's +x) of a direction in degrees.

    text: "315" is a compass bearing, "heading=135" a heading; present: heading (rad) that is
    returned in full if it is printed like the text, None for no such heading. Raises ValueError for
    another text, and beyond a full turn.

    >>> from toolkit.sites.files import load_site
    >>> site = load_site("roundabout")
    >>> parse_heading(site, "90"), parse_heading(site, "heading=0")
    (0.0, 0.0)
    >>> parse_heading(site, "90.0", present=0.0001)
    0.0001
    """
    is_heading = text.startswith(HEADING_PREFIX)
    degrees = _parse_degrees(text.removeprefix(HEADING_PREFIX))
    if degrees is None or abs(degrees) > MAX_TURN_DEG:
        rule = "a bearing must be degrees clockwise from north, from 0 to 360, such as 315"
        raise ValueError(
            f"{rule}, got {text!r:.40}: a heading from +x is written {HEADING_PREFIX}135"
        )
    heading = math.radians(degrees) if is_heading else heading_from_bearing(site, degrees)
    if present is not None and abs(_turn_between(heading, present)) <= _max_rounding(
        PRINTED_ANGLE_DEG
    ):
        return present
    return heading


def parse_tilt(degrees: float, present: float | None = None) -> float:
    """Return the tilt (rad below the horizon) of a typed number of degrees.

    present: tilt (rad) that is returned in full if it is printed like the number, None for no such
    tilt. Raises ValueError for a tilt beyond `TILT_SPAN_RAD`."""
    low, high = (math.degrees(limit) for limit in TILT_SPAN_RAD)
    if present is not None and abs(degrees - math.degrees(present)) <= _max_rounding(
        PRINTED_ANGLE_DEG
    ):
        return present
    if not low - SLACK <= degrees <= high + SLACK:
        raise ValueError(
            f"a tilt must be {low:.0f} to {high:.0f} degrees below the horizon, got {degrees:g}"
        )
    return math.radians(degrees)


def parse_height(mount: Mount, height: float, present: float | None = None) -> float:
    """Return the height above the foot of a pole (m) of a typed number.

    height: typed number (m); present: height (m) that is returned in full if it is printed like the
    number, None for no such height. Raises ValueError beyond the heights of the pole."""
    if present is not None and abs(height - present) <= _max_rounding(PRINTED_HEIGHT_M):
        return present
    if not mount.min_height - SLACK <= height <= mount.max_height + SLACK:
        span = f"{mount.min_height:g} to {mount.max_height:g} m"
        raise ValueError(f"{mount.name} takes sensors at {span} above its foot, got {height:g}")
    return height


def show_bearing(site: Site, sensor: LiveSensor) -> float:
    """Return the compass bearing of a sensor as it is printed: degrees, to a tenth, below 360."""
    return round(bearing_deg(site, sensor.heading), 1) % MAX_TURN_DEG


def _max_rounding(step: float) -> float:
    """Greatest difference of a number and its printed form, in steps of this size."""
    return step / 2 + SLACK


def _turn_between(first: float, second: float) -> float:
    """Turn from the second heading to the first (rad) in degrees, -180 to 180."""
    return math.degrees(math.remainder(first - second, math.tau))


def _parse_degrees(text: str) -> float | None:
    """Finite number of a text, None for any other text."""
    try:
        degrees = float(text)
    except ValueError:
        return None
    return degrees if math.isfinite(degrees) else None
