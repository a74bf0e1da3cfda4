"""Pictures of a set of sensors: the area from above with what they see of the traffic, and a few lines of text."""

from __future__ import annotations

import numpy as np

from placement_env.envs.scenario import area_of, poses
from placement_env.objective import Objective
from toolkit.arrays import Shaped
from toolkit.boxes import footprints
from toolkit.plots import GROUND, SOLID

MOST_VEHICLES = 300  # that are drawn
WEDGE = 25.0  # m of a field of view that are drawn
MARGIN = 6.0  # m round area and sensors
WELL_SEEN = 1000.0  # points on a vehicle in the brightest colour
INCHES, DPI = 6.4, 100


def bird_view(objective: Objective, members: list[int]) -> Shaped[np.ndarray, "height width 3"]:
    """Lanes, solids and the detection area from above, vehicles coloured by the points on them (logarithmic, grey
    without any), the chosen sensors with their fields of view. RGB, uint8; a square of the same size for every site."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Wedge

    position, heading, _, width, _ = poses(objective.candidates)
    area = area_of(objective)
    feet = np.concatenate([[area[:2], area[2:]], position[:, :2]])
    middle, reach = (feet.min(axis=0) + feet.max(axis=0)) / 2, float(np.ptp(feet, axis=0).max()) / 2 + MARGIN
    low, high = middle - reach, middle + reach
    figure = Figure((INCHES, INCHES), DPI)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    if objective.site is not None:
        axes.add_collection(PolyCollection(list(objective.site.lanes), facecolor=GROUND["lanes"]))
        axes.add_collection(PolyCollection(list(objective.site.footways), facecolor=GROUND["footways"]))
        solids = [solid for solid in objective.site.solids if solid.kind in SOLID]
        colours = [SOLID[solid.kind] for solid in solids]
        axes.add_collection(PolyCollection([solid.footprint for solid in solids], facecolor=colours))
    axes.plot(area[[0, 2, 2, 0, 0]], area[[1, 1, 3, 3, 1]], color="black", linewidth=0.8)
    if objective.visibility is not None and len(objective.visibility.boxes):
        boxes = objective.visibility.boxes
        some = np.linspace(0, len(boxes) - 1, min(len(boxes), MOST_VEHICLES)).round().astype(np.int64)
        points = objective.visibility.points[members][:, some].astype(np.float64).sum(axis=0)
        axes.add_collection(PolyCollection(list(footprints(boxes[some])), facecolor=point_colours(points), alpha=0.6))
    axes.scatter(position[:, 0], position[:, 1], s=6, color="#9a9a9a", zorder=3)
    for member in members:
        start, half = np.rad2deg(heading[member]), np.rad2deg(width[member]) / 2
        x, y, _ = position[member].tolist()
        axes.add_patch(Wedge((x, y), WEDGE, start - half, start + half, color="#d62728", alpha=0.15))
        axes.scatter(x, y, s=40, color="#d62728", zorder=4)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]


def point_colours(points: Shaped[np.ndarray, " n"]) -> Shaped[np.ndarray, "n 4"]:
    """RGBA by how many points are on each vehicle; grey for none."""
    from matplotlib import colormaps

    share = np.log1p(points) / np.log1p(WELL_SEEN)
    colours = np.asarray(colormaps["viridis"](np.clip(share, 0, 1)))
    colours[points == 0] = (0.6, 0.6, 0.6, 1.0)
    return colours


def summary(objective: Objective, members: list[int]) -> str:
    """Site, scheme, chosen sensors and their score in a few lines."""
    score = objective.score(members)
    names = ", ".join(objective.names[member] for member in members) or "no sensors"
    where = objective.site.name if objective.site is not None else "a site"
    return (
        f"{where}, {objective.scheme.name} fusion, by {score.fidelity}\n{names}\n"
        f"AP {score.ap:.3f}, recall {score.recall:.3f}, {score.kbit_per_sensor:.1f} kbit per sensor, "
        f"{score.kbit:.1f} kbit, price {score.price:g}: reward {score.reward:.3f}\n"
    )
