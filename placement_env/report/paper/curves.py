"""The paper's PR curves: early fusion with its best set of each size, at IoU 0.7."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from placement_env.report.paper.comparison import Compared, Experiment
from placement_env.report.paper.published import (
    CURVE_STATEMENTS,
    FIGURE_PR,
    PLACE_NAMES,
    SensorSet,
    Statement,
    sensor_sets,
    set_name,
)
from placement_env.report.paper.reasons import RowEvidence, reason_of
from placement_env.report.paper.scoring import pr_curve, published_ap, score_run, visible_share
from placement_env.report.paper.stored import SchemeRun, StoredDetections
from toolkit.arrays import Bool
from toolkit.detection.metrics import Curve

RECALL_STEP = 0.001  # of recall, between the points of a curve that are written down


def curve_runs(site: str) -> list[SchemeRun]:
    """What must be detected for it."""
    return [SchemeRun("early", sensors) for sensors in sensor_sets(site).best_early]


def curve_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Ours beside the paper's."""
    curves = {run.sensors: pr_curve(stored, run) for run in curve_runs(site)}
    rows = [_ap_row(stored, site, sensors) for sensors in curves]
    rows += [_statement_row(stored, each, curves[each.sensors]) for each in CURVE_STATEMENTS[site]]
    everyone = next(iter(curves.values()))
    fewest = list(curves)[-1]

    def draw(out: Path) -> None:
        from toolkit.plots.curves import draw_pr_curves

        named = {
            f"{set_name(sensors)}: AP {row.ours:.3f} (paper {row.paper:.3f})": (curve.recall, curve.precision)
            for (sensors, curve), row in zip(curves.items(), rows, strict=False)
        }
        draw_pr_curves(named, out, title=f"Early fusion, {PLACE_NAMES[site]}, IoU 0.7, {stored.frames} frames")

    return Experiment(
        "pr_curves", "Precision and recall of the best set of each size", f"{FIGURE_PR}, section IV-C",
        ("figure", "sensors"), tuple(rows), basis,
        f"All sensors find {_percent(greatest_recall(everyone))} of the vehicles, sensor {set_name(fewest)} alone "
        f"{_percent(greatest_recall(curves[fewest]))}: more sensors raise the greatest recall, as in the paper.",
        draw, (("pr_curves_points", tuple(_points(curves))),),
    )  # fmt: skip


def greatest_recall(curve: Curve) -> float:
    """Recall of all detections, 0 without any."""
    return float(curve.recall[-1]) if len(curve.recall) else 0.0


def precision_from(curve: Curve, recall: float) -> float:
    """Best precision at this recall or a greater one, 0 where it is not reached.

    >>> precision_from(Curve(np.array([1.0, 0.5]), np.array([0.5, 0.9]), np.array([0.9, 0.1])), 0.8)
    0.5
    """
    reached = curve.recall >= recall
    return float(curve.precision[reached].max(initial=0.0))


def steps(curve: Curve) -> Bool[np.ndarray, " k"]:
    """Which points of a curve are written down: the last one in each step of recall."""
    number = np.floor(curve.recall / RECALL_STEP)
    return np.append(number[1:] != number[:-1], True)[: len(number)]


def _ap_row(stored: StoredDetections, site: str, sensors: SensorSet) -> Compared:
    paper = {row.sensors: row.early for row in sensor_sets(site).rows}[sensors]
    run = SchemeRun("early", sensors)
    ours = score_run(stored, run)
    reason = reason_of(
        ours.ap, paper, RowEvidence(visible_share(stored, sensors), ours.recall, published=published_ap(stored, run))
    )
    return Compared(("AP@0.7", set_name(sensors)), "AP", ours.ap, paper, ours.interval, reason=reason)


def _statement_row(stored: StoredDetections, says: Statement, curve: Curve) -> Compared:
    ours = greatest_recall(curve) if says.of == "greatest recall" else precision_from(curve, 0.95)
    seen = visible_share(stored, says.sensors)
    reason = f"{_percent(seen)} of the vehicles have a point here" if seen < says.value else ""
    labels = says.of, set_name(says.sensors)
    return Compared(labels, "share", ours, says.value, relation=says.relation, reason=reason)


def _points(curves: dict[SensorSet, Curve]) -> list[tuple[str | float, ...]]:
    rows: list[tuple[str | float, ...]] = [("sensors", "score", "precision", "recall")]
    for sensors, curve in curves.items():
        kept = steps(curve)
        figures = zip(curve.score[kept], curve.precision[kept], curve.recall[kept], strict=True)
        rows += [(set_name(sensors), *(round(float(each), 6) for each in row)) for row in figures]
    return rows


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
