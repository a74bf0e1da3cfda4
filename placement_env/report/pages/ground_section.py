"""Section of the report on the ground that the sensors see."""

import numpy as np

from placement_env.classes import join_names
from placement_env.handover.ground import GroundGrid
from placement_env.report import content
from placement_env.report.maps import blind_map, coverage_map, density_map
from placement_env.report.pages.columns import text_columns
from placement_env.report.pages.document import (
    Column,
    Content,
    PageDrawing,
    SceneView,
    build_content,
    build_table,
)
from placement_env.report.pages.figure_texts import number_text, percent
from toolkit.sites.site import Site

SPARSE_POINTS_M2 = 1.0  # points per m² below which a place is practically unseen


def ground_section(plan: content.Plan, site: Site, ground: GroundGrid | None) -> Content:
    """Describe the visible ground, the density of points and the blind spots, with maps.

    site: site with the chosen sensors; ground: grid of the ground that they see, None if
    unknown."""
    if plan.ground is None or ground is None:
        why = "" if plan.chosen else ", because no set of sensors was chosen"
        return build_content(f"The visible ground was not computed{why}.")
    shares = plan.ground
    seen_twice = percent(plan.ground.seen_by[1])
    conclusion = (
        f"At least one sensor sees {percent(shares.seen_by[0])} of the open ground, and two or "
        f"more see {seen_twice}; no sensor sees {number_text(shares.blind_m2, 0)} m², or "
        f"{percent(shares.blind_lanes)} of the lanes."
    )
    names = join_names([sensor.name for sensor in plan.sensors])
    coverage = PageDrawing(
        coverage_map(site, ground, site.sensors),
        (
            f"Where two or more sensors look, on {seen_twice} of the open ground, one may fail and "
            "the place is still seen."
        ),
        f"Map of how many of the sensors {names} see each place of the ground",
    )
    density = PageDrawing(
        density_map(site, ground, site.sensors),
        _describe_density(ground),
        "Map of the points per square metre that all sensors together put on the ground in a frame",
    )
    blind = PageDrawing(
        blind_map(site, ground, site.sensors),
        f"{number_text(shares.blind_m2, 0)} m², {percent(shares.blind)} of the open ground, are "
        "hidden from every sensor or lie outside their fields of view.",
        "Map of the ground that no sensor sees: lanes, footways and the rest",
    )
    rows = [
        (name, area, area / shares.open_m2 if shares.open_m2 else None)
        for name, area in shares.sensor_m2.items()
    ]
    columns = (*text_columns("Sensor"), Column("sees", "m²", 0), Column("of the open ground", "%"))
    caption = "Ground that each sensor sees; ground that two sensors see counts for both"
    scene = SceneView(
        "Drag to turn the junction, scroll to zoom; hide sensors and boxes with the switches.",
        (
            "The junction in 3D, with points, vehicles and detections of some frames, is in "
            "report.html beside this file."
        ),
    )
    return build_content(
        conclusion, coverage, density, blind, *build_table(caption, columns, rows), scene
    )


def _describe_density(ground: GroundGrid) -> str:
    """Describe the density of points on the lanes, of all sensors in a frame.

    The sentence states the share of lanes with too few points, and the median of the others."""
    is_lane = ground.lanes & ground.open_ground
    if not is_lane.any():
        return "No lane lies in the area; the density is that of all open ground."
    # points per m² of each cell of the lanes, over all sensors
    density = ground.density.sum(axis=0, dtype=np.float64)[is_lane]
    is_sparse = density < SPARSE_POINTS_M2
    sparse_share = percent(float(is_sparse.mean()))
    other_cells = density[density >= SPARSE_POINTS_M2]
    median = float(np.median(other_cells)) if len(other_cells) else None
    return (
        f"{sparse_share} of the lanes' ground gets "
        f"fewer than {SPARSE_POINTS_M2:g} point per m² in a frame, too few to tell what is "
        f"there; the other lanes get {number_text(median, 0)} per m² in the middle case."
    )
