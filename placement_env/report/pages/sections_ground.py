"""Section on the ground: how much of it is seen, by how many sensors, with how many points, and where nobody looks."""

from __future__ import annotations

import numpy as np

from placement_env.report.content import Ground, Plan
from placement_env.report.drawings.maps import blind_map, coverage_map, density_map
from placement_env.report.pages.document import Column, Drawing, ReportBlock, Section, table
from placement_env.report.pages.wording import figure_cell, listed, number, percent, share_cell, text_cell
from toolkit.sites.site import Site

SPARSE = 1.0  # points per m², below which a place is as good as unseen


def ground_section(plan: Plan, site: Site, ground: Ground | None) -> Section:
    """Visible ground, how many sensors see it, density of points and blind spots."""
    key, title = "ground", "What the sensors see of the ground"
    if plan.ground is None or ground is None:
        return Section(key, title, "The visible ground was not worked out, because no set of sensors was chosen.")
    shares = plan.ground
    conclusion = (
        f"{percent(shares.seen_by[0])} of the open ground is seen by at least one sensor and "
        f"{percent(shares.seen_by[1])} by two or more; {number(shares.blind_m2, 0)} m² are seen by none, and of the "
        f"lanes alone {percent(shares.blind_lanes)}."
    )
    rows = [
        (text_cell(name), figure_cell(area, 0), share_cell(area / shares.open_m2 if shares.open_m2 else None))
        for name, area in shares.sensor_m2.items()
    ]
    columns = (Column("Sensor", number=False), Column("sees", "m²"), Column("of the open ground", "%"))
    areas = table("Ground that each sensor sees; what two sensors see counts for both", columns, rows)
    return Section(key, title, conclusion, (*_maps(plan, site, ground), *areas))


def _maps(plan: Plan, site: Site, ground: Ground) -> tuple[ReportBlock, ...]:
    assert plan.ground is not None
    twice, lanes = plan.ground.seen_by[1], ground.lanes & ground.open_ground
    names = listed([sensor.name for sensor in plan.sensors])
    return (
        Drawing(
            coverage_map(site, ground, site.sensors),
            f"Where two or more sensors look, {percent(twice)} of the open ground, one may fail and the place is still "
            "seen.",
            f"Map of how many of the sensors {names} see each place of the ground",
        ),
        Drawing(
            density_map(site, ground, site.sensors),
            _density(ground, lanes),
            "Map of how many points per square metre all sensors together put on the ground in a frame",
        ),
        Drawing(
            blind_map(site, ground, site.sensors),
            f"{number(plan.ground.blind_m2, 0)} m², {percent(plan.ground.blind)} of the open ground, are hidden from "
            "every sensor by what stands in between or lie outside their fields of view.",
            "Map of the ground that no sensor sees: lanes, footways and the rest",
        ),
    )


def _density(ground: Ground, lanes: np.ndarray) -> str:
    """What the density on the lanes comes to."""
    if not lanes.any():
        return "No lane lies in the area; the density is that of all open ground."
    density = ground.density.sum(0, dtype=np.float64)[lanes]
    return (
        f"Half of the lanes' ground gets {number(float(np.median(density)), 1)} points per m² or more in a frame; "
        f"{percent(float((density < SPARSE).mean()))} of it gets fewer than {SPARSE:g}, too few to tell what is there."
    )
