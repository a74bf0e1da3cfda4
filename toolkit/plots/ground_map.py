"""Ground of a site from above: lanes, footways, solids, and names of streets."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.plots import palette
from toolkit.plots.canvas import replace_unprintable, shorten
from toolkit.plots.line_style import Entry, PlotStyle
from toolkit.plots.palette import GROUND, INK, PAPER_WHITE, SOLID
from toolkit.sites.site import Site, Solid
from toolkit.sites.streets import find_lane_arrows, find_street_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LANE_ARROW_M = 4.0  # length
LANE_ARROW_INK = "#6b6b70"
LONGEST_STREET_NAME = 40  # letters on a map
_Place = Float64[np.ndarray, "2"]  # x and y (m)


def draw_ground(axes: "Axes", site: Site) -> None:
    """Draw lanes, footways and solids, and hatch the solids that no map holds.

    `order` decides what is drawn above."""
    for kind, colour in GROUND.items():
        fill_polygons(
            axes, [shapely.Polygon(polygon) for polygon in getattr(site, kind)], colour, order=1.0
        )
    shapes_by_kind: dict[str, list[shapely.Polygon]] = {kind: [] for kind in ("other", *SOLID)}
    for solid in site.solids:
        kind = solid.kind if solid.kind in SOLID else "other"
        shapes_by_kind[kind].append(shapely.Polygon(solid.footprint))
    for rank, (kind, shapes) in enumerate(shapes_by_kind.items()):
        # kinds are sorted by height, so later ones are drawn above
        fill_polygons(axes, shapes, SOLID.get(kind, palette.OTHER_SOLID), order=1.5 + 0.01 * rank)
    hatched_solids = _list_hatched_solids(site)
    hatched_ground = shapely.union_all(
        [shapely.Polygon(solid.footprint) for solid in hatched_solids]
    )
    hatching: PlotStyle = {"hatch": palette.DRAWN_HATCH, "edgecolor": palette.DRAWN_INK}
    for part in shapely.get_parts(hatched_ground):
        outline = shapely.get_coordinates(part.exterior)
        axes.fill(*outline.T, zorder=1.6, facecolor="none", linewidth=0.0, **hatching)


def draw_streets(axes: "Axes", site: Site, low: _Place, high: _Place) -> None:
    """Draw the names of streets, and arrows in the directions of lanes.

    low, high: corners of the map (m), the lower left and the upper right."""
    from matplotlib.patheffects import withStroke

    head: PlotStyle = {"color": LANE_ARROW_INK, "linewidth": 0.7, "zorder": 1.3}
    for x, y, angle in find_lane_arrows(site, low, high).tolist():
        along = np.array([np.cos(angle), np.sin(angle)])
        aside = np.array([-np.sin(angle), np.cos(angle)])
        tip = np.array([x, y]) + LANE_ARROW_M / 2 * along
        # both ends of the arrow's head, left and right of the shaft
        corners = [
            tip - 0.4 * LANE_ARROW_M * along + side * 0.2 * LANE_ARROW_M * aside for side in (1, -1)
        ]
        axes.plot(*np.stack([tip - LANE_ARROW_M * along, tip]).T, **head)
        axes.plot(*np.stack([corners[0], tip, corners[1]]).T, **head)
    halo = [withStroke(linewidth=2.2, foreground=PAPER_WHITE)]
    for street in find_street_names(site, low, high):
        text: PlotStyle = {
            "fontsize": 7.0,
            "ha": "center",
            "va": "center",
            "rotation_mode": "anchor",
            "zorder": 4.5,
        }
        rotation = float(np.rad2deg(street.angle))
        name = replace_unprintable(shorten(street.name, LONGEST_STREET_NAME))
        axes.text(
            street.x,
            street.y,
            name,
            rotation=rotation,
            color=INK,
            path_effects=halo,
            clip_on=True,
            **text,
        )


def _list_hatched_solids(site: Site) -> list[Solid]:
    """List the solids that coview drew at random, none if the whole site is drawn.

    Trunks are left out, as they are below the crowns."""
    if site.road_origin == "drawn":
        return []
    return [solid for solid in site.solids if solid.origin == "drawn" and solid.kind != "trunk"]


def fill_polygons(
    axes: "Axes",
    shapes: Sequence[shapely.Geometry],
    colour: str,
    *,
    order: float,
    alpha: float = 1.0,
    edge: float = 0.4,
) -> None:
    """Fill the union of polygons in one colour; its holes stay empty.

    shapes: polygons (m), merged before they are filled; colour: #rrggbb; order: greater is drawn
    above; alpha: opacity of the fill, 0 to 1; edge: width of the outline in points."""
    from matplotlib.colors import to_rgba
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    merged_parts = shapely.get_parts(shapely.union_all(list(shapes)))
    polygons = [part for part in merged_parts if part.geom_type == "Polygon"]
    # exteriors run counter-clockwise and holes clockwise, so that matplotlib leaves holes empty
    oriented_polygons = [shapely.geometry.polygon.orient(polygon) for polygon in polygons]
    rings = [
        ring for polygon in oriented_polygons for ring in (polygon.exterior, *polygon.interiors)
    ]
    if not rings:
        return
    outlines = [Outline(shapely.get_coordinates(ring), closed=True) for ring in rings]
    patch = PathPatch(
        Outline.make_compound_path(*outlines),
        facecolor=to_rgba(colour, alpha),
        edgecolor=colour,
        linewidth=edge,
        zorder=order,
    )
    axes.add_patch(patch)


def ground_entries(site: Site) -> list[Entry]:
    """Legend entries of the area's outline and of the kinds of ground that the site has."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    solid_kinds = {solid.kind for solid in site.solids}
    # name, colour, and whether the site has any
    grounds = (
        ("lane", GROUND["lanes"], bool(site.lanes)),
        ("footway", GROUND["footways"], bool(site.footways)),
        ("building", SOLID["building"], "building" in solid_kinds),
        ("pond", SOLID["pond"], "pond" in solid_kinds),
        ("trees, hedges", SOLID["tree"], bool(solid_kinds & {"tree", "hedge"})),
    )
    area_line = Line2D([], [], color=INK, linewidth=1.1, dashes=(8, 2, 2, 2))
    entries: list[Entry] = [(area_line, "detection area")]
    edge: PlotStyle = {"edgecolor": "#b0b0b0", "linewidth": 0.5}
    for name, colour, is_present in grounds:
        if is_present:
            entries.append((Patch(facecolor=colour, **edge), name))
    if _list_hatched_solids(site):
        hatching: PlotStyle = {
            "hatch": palette.DRAWN_HATCH,
            "edgecolor": palette.DRAWN_INK,
            "linewidth": 0.5,
        }
        entries.append((Patch(facecolor="white", **hatching), "drawn, in no map"))
    return entries
