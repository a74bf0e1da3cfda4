"""Points on a vehicle with the best sensor sets."""

from dataclasses import replace
from functools import partial

import numpy as np

from examples.studies.paper.comparison import Compared, Experiment, TableRow, percent
from examples.studies.paper.detections import StoredDetections
from examples.studies.paper.paper_rows import set_name
from examples.studies.paper.paper_tables import DENSITY_STATEMENTS, PLACE_NAMES, sensor_sets
from placement_env.analysis.intervals import ratio_interval
from toolkit.arrays import Bool
from toolkit.plots.curves import draw_density_cdf

FEW_POINTS = 300  # the paper's threshold in its text
# numbers of points at which the file of curves has a row
CURVE_POINTS = (
    *(0, 1, 2, 5, 10, 20, 50, 70, 100, 150, 200, 250, 300, 400, 500, 750),
    *range(1000, 4001, 250),
)


def density_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare the numbers of points on vehicles with the best sensor sets.

    site: one of the paper's sites; basis: words for the data behind our figures."""
    sets = sensor_sets(site).best["early"]
    stated = DENSITY_STATEMENTS[site]
    paper = {(str(statement.of), statement.sensors): statement for statement in stated}
    rows = []
    for figure_name, limit in (("no points", 1), (f"below {FEW_POINTS} points", FEW_POINTS)):
        for sensors in sets:
            counts = []  # vehicles of each frame with fewer points
            for truth in stored.truths:
                points = truth.points[:, list(sensors)].sum(axis=1)
                counts.append(int((points < limit).sum()))
            share = sum(counts) / stored.vehicles if stored.vehicles else float("nan")
            labels = (figure_name, set_name(sensors))
            interval = ratio_interval(counts, list(stored.to_find))
            row = Compared(labels, "share", share, None, interval)
            statement = paper.get((figure_name, sensors))
            if statement is not None:
                row = replace(row, paper=statement.value, relation=statement.relation)
            rows.append(row)
    for sensors in sets:
        median = float(np.median(stored.points(sensors))) if stored.vehicles else float("nan")
        rows.append(Compared(("median of the points", set_name(sensors)), "points", median, None))
    share_all = rows[0].ours
    share_one = rows[len(sets) - 1].ours
    points_by_set = {set_name(sensors): stored.points(sensors) for sensors in sets}
    names = tuple(points_by_set)
    shares: list[TableRow] = [("points, at most", *names)]
    for max_points in CURVE_POINTS:
        values = [_format_share(points <= max_points) for points in points_by_set.values()]
        shares.append((max_points, *values))
    conclusion = (
        f"{percent(share_one)} of the vehicles have no point from sensor {names[-1]} alone, "
        f"{percent(share_all)} none from all sensors."
    )
    if not stated:
        conclusion += f" The paper shows this for the {PLACE_NAMES['tjunction']} alone."
    return Experiment(
        "point_density",
        "Points on a vehicle with the best sets",
        "figure of point density (a), section IV-E",
        ("share of vehicles with", "sensors"),
        tuple(rows),
        basis,
        conclusion,
        partial(draw_density_cdf, points_by_set),
        (("point_density_curves", tuple(shares)),),
    )


def _format_share(is_counted: Bool[np.ndarray, " n"]) -> float | str:
    # share of the vehicles that count, "" without vehicles
    return round(float(is_counted.mean()), 6) if len(is_counted) else ""
