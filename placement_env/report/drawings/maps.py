"""Maps of a plan as SVG text: the site with its sensors, how many see the ground, how densely, and where none does."""

from __future__ import annotations

from collections.abc import Sequence

from placement_env.report.content import Ground
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

_STUB = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 60" width="100pt" height="60pt"></svg>'


def plan_view(
    site: Site,
    sensors: Sequence[Sensor],
    poles: Sequence[str] = (),
    poles_unused: Sequence[str] = (),
    ground: Ground | None = None,
) -> str:
    """The site from above with the chosen sensors, the poles that carry them and those not used (names of mounts), and
    what each sensor sees of the ground where `ground` is given."""
    return _STUB


def coverage_map(site: Site, ground: Ground, sensors: Sequence[Sensor]) -> str:
    """How many sensors see each place: 0, 1, 2, 3 or more."""
    return _STUB


def density_map(site: Site, ground: Ground, sensors: Sequence[Sensor]) -> str:
    """Points of all sensors together that a frame puts on the ground, per m²."""
    return _STUB


def blind_map(site: Site, ground: Ground, sensors: Sequence[Sensor]) -> str:
    """The open ground that no sensor sees, lanes, footways and the rest told apart."""
    return _STUB
