"""Precision and recall of the best sensor set of each size."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from examples.studies.paper.comparison import Compared, Experiment, TableRow, percent
from examples.studies.paper.detections import (
    SchemeRun,
    StoredDetections,
    compare_run,
    score_run,
    visible_share,
)
from examples.studies.paper.paper_rows import set_name
from examples.studies.paper.paper_tables import CURVE_STATEMENTS, PLACE_NAMES, sensor_sets
from toolkit.arrays import Bool
from toolkit.detection.metrics import Curve
from toolkit.plots.curves import draw_pr_curves

RECALL_STEP = 0.001  # recall between the points of a curve in its file


def curve_runs(site: str) -> list[SchemeRun]:
    """List early fusion of the paper's best set of each size, most sensors first."""
    return [SchemeRun("early", sensors) for sensors in sensor_sets(site).best["early"]]


def _round_values(values: Sequence[float]) -> list[float]:
    return [round(value, 6) for value in values]


def curve_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare PR curves of early fusion at IoU 0.7.

    site: one of the paper's sites; basis: words for the data behind our figures."""
    curves = {run.sensors: score_run(stored, run).curve for run in curve_runs(site)}
    paper = {row.sensors: row.early for row in sensor_sets(site).rows}
    rows = []
    drawn_curves = {}
    points: list[TableRow] = [("sensors", "score", "precision", "recall")]
    for sensors, curve in curves.items():
        name = set_name(sensors)
        row = compare_run(stored, SchemeRun("early", sensors), ("AP@0.7", name), paper[sensors])
        rows.append(row)
        caption = f"{name}: AP {row.ours:.3f} (paper {row.paper:.3f})"
        drawn_curves[caption] = (curve.recall, curve.precision)
        is_step = steps(curve)
        figures = np.stack([curve.score, curve.precision, curve.recall], axis=1)[is_step]
        points += [(name, *_round_values(values)) for values in figures.tolist()]
    for statement in CURVE_STATEMENTS[site]:
        curve = curves[statement.sensors]
        seen = visible_share(stored, statement.sensors)
        if statement.of == "greatest recall":
            ours = max_recall(curve)
        else:
            ours = interpolate_precision(curve, 0.95)
        reason = ""
        if seen < statement.value:
            reason = f"{percent(seen)} of the vehicles have a point here"
        labels = (statement.of, set_name(statement.sensors))
        relation = statement.relation
        rows.append(
            Compared(labels, "share", ours, statement.value, relation=relation, reason=reason)
        )
    sensor_lists = list(curves)
    one_sensor = sensor_lists[-1]
    recall = max_recall(curves[sensor_lists[0]])
    one_recall = max_recall(curves[one_sensor])
    title = f"Early fusion, {PLACE_NAMES[site]}, IoU 0.7, {stored.frames} frames"
    return Experiment(
        "pr_curves",
        "Precision and recall of the best set of each size",
        "figure of PR curves, section IV-C",
        ("figure", "sensors"),
        tuple(rows),
        basis,
        f"All sensors find {percent(recall)} of the vehicles, sensor {set_name(one_sensor)} alone "
        f"{percent(one_recall)}: more sensors raise the maximum recall, as in the paper.",
        partial(draw_pr_curves, drawn_curves, title=title),
        (("pr_curves_points", tuple(points)),),
    )


def max_recall(curve: Curve) -> float:
    """Return the recall of all detections, 0 without any."""
    return float(curve.recall[-1]) if len(curve.recall) else 0.0


def interpolate_precision(curve: Curve, recall: float) -> float:
    """Return the best precision at this recall or above, 0 if it is not reached."""
    return float(curve.precision[curve.recall >= recall].max(initial=0.0))


def steps(curve: Curve) -> Bool[np.ndarray, " k"]:
    """Mask of a curve's points: the last one in each step of recall (`RECALL_STEP`)."""
    number = np.floor(curve.recall / RECALL_STEP)
    return np.append(number[1:] != number[:-1], True)[: len(number)]
