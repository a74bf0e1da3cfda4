"""Files of a search's answer: the site with the chosen sensors, schedule, map and picture, or a
curve."""

import csv
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from placement_env.fidelity.coverage import sent_per_frame
from placement_env.fidelity.seeing import see
from placement_env.handover.exchange import EXCHANGE_FILES, safe_cell, write_exchange
from placement_env.handover.ground import visible_ground
from placement_env.handover.mounted import format_sensors, mounted_site, set_names, unused_mounts
from placement_env.objective import Objective
from placement_env.search.answer_summary import Answer
from placement_env.search.cmaes import as_candidates
from placement_env.search.order import SearchOrder
from placement_env.search.portfolio.curve import MAX_AMOUNTS, CurvePoint
from toolkit.arrays import Float64
from toolkit.plots import canvas
from toolkit.plots.palette import BAR, INK
from toolkit.plots.plan_view import draw_site
from toolkit.runtime.writing import write_text, writing_together
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import save_site
from toolkit.sites.georeference import longitude_latitude
from toolkit.sites.site import Site

ANSWER_JSON = "search.json"
ANSWER_PICTURE = "site.png"
ANSWER_FILES = (*EXCHANGE_FILES, ANSWER_PICTURE, ANSWER_JSON)
CURVE_JSON = "curve.json"
CURVE_TABLE = "curve.csv"
CURVE_PICTURE = "curve.png"
CURVE_TABLES = (CURVE_JSON, CURVE_TABLE, CURVE_PICTURE)
CURVE_HEIGHT_INCHES = 4.0  # the whole picture
CURVE_HEAD_INCHES = 0.7  # above the axes
CURVE_COLUMNS = (
    "sensors",
    "money",
    "price",
    "price_unit",
    "ap",
    "low",
    "high",
    "predicted",
    "confidence",
    "kbit_per_frame",
    "pays",
    "searches",
    "set",
    "site",
)


def check_georeference(site: Site) -> None:
    """Raise the errors of `longitude_latitude` for a site with an unusable georeference.

    An answer is written in longitude and latitude, so this is checked before hours of search."""
    longitude_latitude(site, np.zeros((1, 2)))


def answer_files(order: SearchOrder) -> tuple[str, ...]:
    """Names of the files that the answer to an order may have.

    A curve has one site per set: per number of sensors, or per amount if money is limited."""
    if not order.curve:
        return ANSWER_FILES
    max_sites = order.budget if math.isinf(order.setting.most_price) else MAX_AMOUNTS
    return CURVE_TABLES + tuple(_site_file(n) for n in range(max_sites))


def write_answer(folder: str | Path, order: SearchOrder, answer: Answer) -> str:
    """Write all of an answer's files into a folder, or none. Return a line that names them.

    order: the order that is answered, which decides between a curve and one set. Raises ValueError
    if no sensor is to be built, or the objective has no site.
    """
    if not answer.met or answer.objective.site is None:
        raise ValueError(
            "only a set of sensors at a site can be handed over, and this is an empty set or has "
            "no site"
        )
    objective = answer.objective
    members = answer.chosen
    base_site = objective.setting.place
    candidates = objective.candidates
    summary = json.dumps(answer.summary, indent=1, allow_nan=False, ensure_ascii=False)
    if order.curve:
        with writing_together(Path(folder)) as unfinished:
            write_text(unfinished / CURVE_JSON, summary + "\n")
            write_text(
                unfinished / CURVE_TABLE, curve_csv(objective, answer.points, order.currency)
            )
            draw_curve(
                answer.points,
                unfinished / CURVE_PICTURE,
                judge=order.judge,
                currency=order.currency,
            )
            for n, point in enumerate(answer.points):
                save_site(
                    mounted_site(base_site, candidates, point.subset), unfinished / _site_file(n)
                )
        return f"written to {folder}: {', '.join(CURVE_TABLES)}, and the site with each set"
    # sensors that the search moved to other poses, in place of the candidates; empty if they stay
    moved_sensors = () if answer.result is None else answer.result.sensors
    site = mounted_site(base_site, candidates, chosen=members, moved=moved_sensors)
    kbit = kbit_per_frame(objective, members, moved_sensors)
    schedule = format_sensors(base_site, candidates, chosen=members, moved=moved_sensors, kbit=kbit)
    ground = visible_ground(site, site.sensors)
    free_mounts = unused_mounts(candidates, members, moved_sensors)
    with writing_together(Path(folder)) as unfinished:
        write_exchange(unfinished, site, sensors=schedule, ground=ground, unused=free_mounts)
        draw_site(site, unfinished / ANSWER_PICTURE)
        write_text(unfinished / ANSWER_JSON, summary + "\n")
    return f"written to {folder}: {', '.join(ANSWER_FILES)}"


def kbit_per_frame(
    objective: Objective, members: Sequence[int], moved_sensors: Sequence[Sensor] = ()
) -> Float64[np.ndarray, "sensors frames"]:
    """Data (kbit) that each sensor of a set sends in each frame of the objective's traffic.

    If the scheme sends boxes, a sensor is assumed to send one for each object that it sees with
    `LEAST` points. Raises ValueError for an objective without a site.

    members: indices of the candidates; moved_sensors: the set's sensors if a search moved them to
    other poses, empty if they stay.
    """
    preparation = objective.preparation
    if preparation is None:
        raise ValueError(
            "kbit of each frame are known of an objective made from a site: Objective(site)"
        )
    if moved_sensors:
        visibility = see(
            preparation.traffic,
            as_candidates(moved_sensors, objective.candidates),
            labels=preparation.setting.counted.labels,
        )
    else:
        base = preparation.visibility if objective.visibility is None else objective.visibility
        visibility = base.select(members)
    return sent_per_frame(visibility, objective.scheme, objective.codec)


def curve_csv(objective: Objective, points: Sequence[CurvePoint], currency: str = "") -> str:
    """Table of a budget curve as text of a CSV file, with one line per set.

    Columns are `CURVE_COLUMNS`; if there are several error profiles, AP, low and high of each
    follow. `money` is empty if the curve is over numbers of sensors.

    points: one for each line; currency: unit of prices, "" for prices of one ordinary pole."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    header = list(CURVE_COLUMNS)
    for profile in points[0].by_errors if points else ():
        header += [safe_cell(f"{figure}_{profile.name}") for figure in ("ap", "low", "high")]
    writer.writerow(header)
    for n, point in enumerate(points):
        row: list[object] = [  # in the order of `CURVE_COLUMNS`
            point.sensors,
            "" if math.isinf(point.money) else f"{point.money:.10g}",
            f"{point.price:.10g}",
            safe_cell(currency or "ordinary poles"),
        ]
        figures = (point.ap, point.low, point.high, point.predicted, point.confidence)
        row += [_figure_cell(figure) for figure in figures]
        row += [
            f"{point.kbit:.1f}",
            "yes" if point.pays else "no",
            " and ".join(point.searches),
            safe_cell(", ".join(set_names(objective.candidates, point.subset))),
            _site_file(n),
        ]
        for profile in point.by_errors:
            row += [_figure_cell(figure) for figure in (profile.ap, profile.low, profile.high)]
        writer.writerow(row)
    return text.getvalue()


def _figure_cell(figure: float) -> str:
    """Text of a figure; empty for NaN, such as an interval on too few frames."""
    return "" if math.isnan(figure) else f"{figure:.6f}"


def _site_file(n: int) -> str:
    """Name of the file of the site with the n-th set of a curve, n from 0."""
    return f"site_{n + 1}.json"


def draw_curve(
    points: Sequence[CurvePoint], out: Path | str, *, judge: str, currency: str = ""
) -> None:
    """Write the picture of a budget curve as PNG or SVG, by suffix.

    AP is over the price, or over the number of sensors if no point has an amount of money. The line
    goes through the sets that pay; other sets are hollow, and crosses show predictions.

    judge: name of the fidelity that measured the AP; currency: "" for ordinary poles.
    """
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    with canvas.house_style():
        figure = canvas.blank_figure(canvas.CHART_INCHES, CURVE_HEIGHT_INCHES)
        subtitle = f"AP by the {judge} on traffic of its own; lines: 95% intervals"
        canvas.draw_heading(figure, "What a budget buys", subtitle)
        # left, bottom, width and height, as shares of the picture
        axes = figure.add_axes(
            (0.09, 0.22, 0.88, 1 - CURVE_HEAD_INCHES / CURVE_HEIGHT_INCHES - 0.22)
        )
        by_money = any(math.isfinite(point.money) for point in points)
        budgets = [point.price if by_money else float(point.sensors) for point in points]
        pays = sorted((x, point.ap) for x, point in zip(budgets, points, strict=True) if point.pays)
        axes.step([x for x, _ in pays], [ap for _, ap in pays], where="post", color=BAR, zorder=2)
        for x, point in zip(budgets, points, strict=True):
            canvas.draw_interval(axes, x, point.low, point.high)
            axes.plot(x, point.predicted, "x", color=INK, markersize=5, zorder=3.5)
            face = BAR if point.pays else "white"
            axes.plot(
                x, point.ap, "o", markerfacecolor=face, markeredgecolor=INK, markersize=7, zorder=4
            )
        axes.grid()
        if not by_money:
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        label = (
            f"price ({canvas.shorten(currency, 12) or 'ordinary poles'})" if by_money else "sensors"
        )
        axes.set(xlim=canvas.pad_limits(budgets), ylim=(0, 1.03), xlabel=label, ylabel="AP")
        marks = [
            Line2D([], [], color=INK, marker=marker, markerfacecolor=face, linestyle="none")
            for marker, face in [("o", BAR), ("o", "white"), ("x", INK)]
        ]
        names = ["best of its budget", "no more than a cheaper one", "predicted by the search"]
        figure.legend(marks, names, loc="lower left", ncols=3, bbox_to_anchor=(0.07, 0.0))
        canvas.write_figure(figure, out)
