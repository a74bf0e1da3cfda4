"""The budget curve as files: everything as JSON, a table, a picture, and the site with the sensors of each set."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from placement_env.handover.exchange import safe_cell
from placement_env.handover.mounted import mounted_site
from placement_env.objective import Objective
from placement_env.search.portfolio.curve import AMOUNTS, CurvePoint
from placement_env.search.portfolio.curve_chart import draw_curve
from toolkit.runtime.files import write_text, writing_together
from toolkit.sites.files import save_site

CURVE_ORIGIN, CURVE_TABLE, CURVE_PICTURE = "curve.json", "curve.csv", "curve.png"
CURVE_TABLES = (CURVE_ORIGIN, CURVE_TABLE, CURVE_PICTURE)
CURVE_COLUMNS = (
    *("sensors", "money", "price", "price_unit", "ap", "low", "high", "predicted", "confidence", "kbit_per_frame"),
    *("pays", "searches", "set", "site"),
)


def curve_files(most: int, *, by_money: bool = False) -> tuple[str, ...]:
    """The files of a curve of at most so many sensors, or over money, that may be written; of sites one for each set
    there is."""
    return *CURVE_TABLES, *(_site_file(n) for n in range(AMOUNTS if by_money else most))


def write_curve(
    folder: str | Path,
    objective: Objective,
    points: Sequence[CurvePoint],
    summary: Mapping[str, Any],
    *,
    judge: str,
    currency: str = "",
) -> None:
    """Write the files into a folder: all of them, or none where anything fails. summary: for curve.json; judge:
    fidelity that the AP are by. Raises ValueError for an empty curve or an objective without a site."""
    if not points or objective.site is None:
        raise ValueError("only sets of sensors at a site can be handed over, and this curve has none, or no site")
    with writing_together(folder) as unfinished:
        write_text(unfinished / CURVE_ORIGIN, json.dumps(summary, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
        write_text(unfinished / CURVE_TABLE, curve_csv(objective, points, currency))
        draw_curve(points, unfinished / CURVE_PICTURE, judge=judge, currency=currency)
        for n, point in enumerate(points):
            save_site(mounted_site(objective.site, objective.candidates, point.subset), unfinished / _site_file(n))


def curve_csv(objective: Objective, points: Sequence[CurvePoint], currency: str = "") -> str:
    """A line per set: kbit are of a whole set and a frame, `money` is empty where numbers of sensors were asked for.
    After these columns AP, low and high at each error profile, where there are several: `ap_typical` and so on."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    profiles = [each.name for each in points[0].by_errors] if points else []
    own = (safe_cell(f"{figure}_{name}") for name in profiles for figure in ("ap", "low", "high"))
    writer.writerow([*CURVE_COLUMNS, *own])
    for n, point in enumerate(points):
        figures = (point.ap, point.low, point.high, point.predicted, point.confidence)
        writer.writerow([
            point.sensors,
            "" if math.isinf(point.money) else f"{point.money:.10g}",
            f"{point.price:.10g}",
            safe_cell(currency or "ordinary poles"),
            *(f"{figure:.6f}" for figure in figures),
            f"{point.kbit:.1f}",
            "yes" if point.pays else "no",
            " and ".join(point.searches),
            safe_cell(" ".join(objective.names[c] for c in point.subset)),
            _site_file(n),
            *(f"{figure:.6f}" for each in point.by_errors for figure in (each.ap, each.low, each.high)),
        ])  # fmt: skip
    return text.getvalue()


def _site_file(n: int) -> str:
    """Of the n-th set, from 0 on."""
    return f"site_{n + 1}.json"
