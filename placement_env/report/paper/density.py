"""Point density of the paper: how many points the best sensor sets have on a vehicle, as cumulative shares."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from placement_env.analysis.intervals import Interval, ratio_interval
from placement_env.report.paper.comparison import Compared, Experiment
from placement_env.report.paper.published import (
    DENSITY_STATEMENTS,
    FIGURE_DENSITY,
    PLACE_NAMES,
    SensorSet,
    sensor_sets,
    set_name,
)
from placement_env.report.paper.stored import StoredDetections

FEW = 300  # points that the paper speaks of
AT = (0, 1, 2, 5, 10, 20, 50, 70, 100, 150, 200, 250, 300, 400, 500, 750, *range(1000, 4001, 250))


def density_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Ours beside the paper's."""
    sets = sensor_sets(site).best_early
    paper = {(says.of, says.sensors): says for says in DENSITY_STATEMENTS[site]}
    rows = []
    for of, below in (("no points", 1), (f"below {FEW} points", FEW)):
        for sensors in sets:
            share, interval = _share_below(stored, sensors, below)
            says = next((each for (what, chosen), each in paper.items() if (what, chosen) == (of, sensors)), None)
            relation = "is" if says is None else says.relation
            value = None if says is None else says.value
            rows.append(Compared((of, set_name(sensors)), "share", share, value, interval, relation=relation))
    for sensors in sets:
        points = stored.points(sensors)
        median = float(np.median(points)) if len(points) else float("nan")
        rows.append(Compared(("median of the points", set_name(sensors)), "points", median, None))
    everyone, fewest = rows[0].ours, rows[len(sets) - 1].ours

    def draw(out: Path) -> None:
        from toolkit.plots.curves import draw_density_cdf

        draw_density_cdf({set_name(sensors): stored.points(sensors) for sensors in sets}, out)

    return Experiment(
        "point_density", "Points on a vehicle with the best sets", f"{FIGURE_DENSITY}, section IV-E",
        ("share of vehicles with", "sensors"), tuple(rows), basis,
        f"{_percent(fewest)} of the vehicles have no point from sensor {set_name(sets[-1])} alone, "
        f"{_percent(everyone)} none from all sensors."
        + ("" if DENSITY_STATEMENTS[site] else f" The paper shows this for the {PLACE_NAMES['tjunction']} alone."),
        draw, (("point_density_curves", tuple(_curves(stored, sets))),),
    )  # fmt: skip


def _share_below(stored: StoredDetections, sensors: SensorSet, below: int) -> tuple[float, Interval]:
    """Share of the vehicles with fewer points than `below`, and its interval."""
    few = [int((truth.points[:, list(sensors)].sum(axis=1) < below).sum()) for truth in stored.truths]
    share = sum(few) / stored.vehicles if stored.vehicles else float("nan")
    return share, ratio_interval(few, list(stored.to_find))


def _curves(stored: StoredDetections, sets: tuple[SensorSet, ...]) -> list[tuple[Any, ...]]:
    points = [stored.points(sensors) for sensors in sets]
    rows: list[tuple[Any, ...]] = [("points, at most", *map(set_name, sets))]
    rows += [(at, *(round(float((each <= at).mean()), 6) if len(each) else "" for each in points)) for at in AT]
    return rows


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f} %"
