"""PR curves, point density, and IoU against density."""

import numpy as np
import pytest
from scipy.optimize import isotonic_regression

from examples.studies.paper import detections
from examples.studies.paper.iou_densities import (
    BinnedIou,
    LogFit,
    bin_iou,
    densities_and_ious,
    density_needed,
    fit_log,
    iou_experiment,
)
from examples.studies.paper.point_densities import density_experiment
from examples.studies.paper.pr_curves import (
    curve_experiment,
    curve_runs,
    interpolate_precision,
    max_recall,
    steps,
)
from placement_env.analysis.intervals import ratio_interval
from toolkit.detection.metrics import Curve

CURVE = Curve(np.array([1.0, 0.9, 0.95]), np.array([0.2, 0.5, 0.96]), np.array([0.9, 0.5, 0.1]))
NOTHING = Curve(np.zeros(0), np.zeros(0), np.zeros(0))


def test_precision_recall_and_needed_density_by_their_points():
    assert (max_recall(CURVE), max_recall(NOTHING)) == (0.96, 0.0)
    assert [interpolate_precision(CURVE, at) for at in (0.0, 0.5, 0.95, 0.97)] == [
        1.0,
        0.95,
        0.95,
        0.0,
    ]
    curve = Curve(np.ones(4), np.array([0.0001, 0.0002, 0.5, 0.5002]), np.ones(4))
    assert steps(curve).tolist() == [False, True, False, True]
    assert steps(NOTHING).tolist() == []
    rng = np.random.default_rng(0)
    density = rng.integers(0, 60, 400).astype(float)
    iou = np.clip(density / 60 + rng.normal(0, 0.2, 400), 0, 1)
    at = np.unique(density)
    means = np.array([iou[density == each].mean() for each in at])
    fit = isotonic_regression(means, weights=np.array([(density == each).sum() for each in at])).x
    for wanted in (0.0, 0.2, 0.5, 0.8):
        assert density_needed(density, iou, wanted) == at[(fit >= wanted).argmax()]
    assert density_needed(density, iou, 1.01) is None
    assert density_needed(np.zeros(0), np.zeros(0), 0.5) is None


def test_curves_have_their_rows(stored):
    made = curve_experiment(stored, "tjunction", "12 frames")
    rows = {row.labels: row for row in made.rows}
    for run, paper in zip(
        curve_runs("tjunction"), (0.9870, 0.9441, 0.8653, 0.7123, 0.5365, 0.2862), strict=True
    ):
        row, ours = (
            rows["AP@0.7", ",".join(map(str, run.sensors))],
            detections.score_run(stored, run),
        )
        assert (row.ours, row.interval, row.paper) == (ours.ap, ours.interval, paper)
        assert bool(row.reason) == row.large
    one = rows["greatest recall", "4"]
    assert one.ours == pytest.approx(
        detections.score_run(stored, curve_runs("tjunction")[-1]).recall
    )
    assert (one.paper, one.relation) == (0.30, "is")
    everyone = rows["precision at recall 0.95", "0,1,2,3,4,5"]
    assert (everyone.relation, everyone.paper) == ("more than", 0.95)
    assert everyone.ours == interpolate_precision(
        detections.score_run(stored, curve_runs("tjunction")[0]).curve, 0.95
    )
    assert detections.visible_share(stored, (4,)) > 0.3
    assert one.reason == ""


def test_curves_have_a_file_of_points(stored):
    ((name, lines),) = curve_experiment(stored, "tjunction", "").curves
    assert name == "pr_curves_points"
    assert lines[0] == ("sensors", "score", "precision", "recall")
    curve = detections.score_run(stored, curve_runs("tjunction")[-1]).curve
    last = [row[1:] for row in lines if row[0] == "4"][-1]
    assert last == pytest.approx((curve.score[-1], curve.precision[-1], curve.recall[-1]), abs=1e-6)


def test_pictures_of_the_roundabout_and_their_bins(stored_roundabout, tmp_path):
    curve_experiment(stored_roundabout, "roundabout", "").draw(tmp_path / "curves.svg")
    assert (tmp_path / "curves.svg").stat().st_size > 5000
    made = density_experiment(stored_roundabout, "roundabout", "")
    assert {row.paper for row in made.rows} == {None}
    assert made.conclusion.endswith("The paper shows this for the T-junction alone.")
    made.draw(tmp_path / "density.svg")
    assert (tmp_path / "density.svg").stat().st_size > 5000
    made = iou_experiment(stored_roundabout, "roundabout", "")
    ((name, rows),) = made.curves
    assert (name, rows[0][2]) == ("iou_density_bins", "vehicles")
    density, _ = densities_and_ious(stored_roundabout, "roundabout")
    assert sum(float(row[2]) for row in rows[1:]) == (density > 0).sum()
    made.draw(tmp_path / "iou.svg")
    assert (tmp_path / "iou.svg").stat().st_size > 5000
    assert made.conclusion.endswith("T-junction alone.")


def test_density_rows_are_shares_beside_the_papers(stored):
    rows = {row.labels: row for row in density_experiment(stored, "tjunction", "").rows}
    points = np.concatenate([truth.points for truth in stored.truths])
    none = [(truth.points[:, [3, 4]].sum(axis=1) == 0).sum() for truth in stored.truths]
    row = rows["no points", "3,4"]
    assert row.ours == pytest.approx((points[:, [3, 4]].sum(axis=1) == 0).mean())
    assert (row.paper, row.relation, row.interval) == (
        0.30,
        "more than",
        ratio_interval(none, list(stored.to_find)),
    )
    few = rows["below 300 points", "0,2,5"]
    assert few.ours == pytest.approx((points[:, [0, 2, 5]].sum(axis=1) < 300).mean())
    assert (few.paper, few.relation) == (0.90, "is")
    assert rows["no points", "4"].paper == 0.60
    assert rows["no points", "0,2,5"].paper == 0.0
    assert rows["no points", "1,3,4,5"].paper is None
    assert rows["median of the points", "4"].ours == np.median(points[:, 4])
    assert len(rows) == 18


def test_density_curves_are_cumulative_shares(stored):
    points = np.concatenate([truth.points for truth in stored.truths])
    ((_, lines),) = density_experiment(stored, "tjunction", "").curves
    assert lines[0] == (
        "points, at most",
        "0,1,2,3,4,5",
        "0,1,3,4,5",
        "1,3,4,5",
        "0,2,5",
        "3,4",
        "4",
    )
    table = np.array(lines[1:], float)
    assert table[0, 0] == 0
    assert table[0, 6] == pytest.approx((points[:, 4] == 0).mean(), abs=1e-6)
    at_100 = table[table[:, 0] == 100][0]
    assert at_100[5] == pytest.approx((points[:, [3, 4]].sum(axis=1) <= 100).mean(), abs=1e-6)
    assert (np.diff(table, axis=0) >= 0).all()
    assert (table[-1, 1:] == 1).all()


def test_log_curves_are_fitted_by_the_weight_of_bins():
    density, iou = np.array([0.0, 10, 20, 20, 400]), np.array([0.0, 0.2, 0.3, 0.5, 0.9])
    bins = bin_iou(density, iou, bins=20)
    assert bins.density.tolist() == [5, 20, 400]
    assert bins.iou == pytest.approx([0.1, 0.4, 0.9])
    assert bins.vehicles.tolist() == [2, 2, 1]
    density = np.array([0.0, 10, 50, 200, 1000])
    fit = fit_log(
        BinnedIou(density, 0.2 + 0.1 * np.log(np.maximum(density, 1)), np.array([5, 1, 4, 2, 9]))
    )
    assert fit == pytest.approx((0.2, 0.1))
    assert fit.density_needed(0.7) == pytest.approx(np.exp(5))
    assert LogFit(0.2, -0.1).density_needed(0.7) == np.inf
    assert np.isnan(
        fit_log(BinnedIou(np.array([0.0, 3]), np.ones(2), np.ones(2, int))).density_needed(0.7)
    )
    density, iou = np.array([10.0, 100.0, 1000.0]), np.array([0.4, 0.7, 0.8])
    alone = fit_log(BinnedIou(density[:2], iou[:2], np.array([1, 1])))
    heavy = fit_log(BinnedIou(density, iou, np.array([10**9, 10**9, 1])))
    assert heavy == pytest.approx(alone, abs=1e-6)


def test_every_vehicle_falls_into_a_bin_of_blocks_of_frames(stored):
    density, iou = densities_and_ious(stored, "tjunction")
    assert len(density) == len(iou) == 6 * stored.vehicles
    bins = bin_iou(density, iou)
    assert bins.vehicles.sum() == len(density)
    assert bins.iou @ bins.vehicles == pytest.approx(iou.sum())
    assert len(bin_iou(np.zeros(3), np.ones(3)).iou) == 1
    assert len(bin_iou(np.zeros(0), np.zeros(0)).iou) == 0
    row = iou_experiment(stored, "tjunction", "").rows[0]
    sums, counts = np.zeros(stored.frames), np.zeros(stored.frames)
    for run, found in stored.runs.items():
        sets = ((0, 1, 2, 3, 4, 5), (0, 1, 3, 4, 5), (1, 3, 4, 5), (0, 2, 5), (3, 4), (4,))
        if run.scheme == "early" and run.sensors in sets:
            for k, (truth, each) in enumerate(zip(stored.truths, found, strict=True)):
                few = truth.points[:, list(run.sensors)].sum(axis=1) < 70
                sums[k] += each.best[few].sum()
                counts[k] += few.sum()
    assert row.interval == pytest.approx(ratio_interval(sums, counts))


def test_iou_rows(stored):
    made = iou_experiment(stored, "tjunction", "basis")
    density, iou = densities_and_ious(stored, "tjunction")
    rows = {row.labels[0]: row for row in made.rows}
    assert rows["mean, below 70 points"].ours == pytest.approx(iou[density < 70].mean())
    assert rows["mean, 70 to 100 points"].ours == pytest.approx(
        iou[(density >= 70) & (density <= 100)].mean()
    )
    assert rows["mean, above 100 points"].ours == pytest.approx(iou[density > 100].mean())
    fit = fit_log(bin_iou(density[density > 0], iou[density > 0]))
    for wanted in (0.5, 0.6, 0.7, 0.8, 0.9):
        needed = fit.density_needed(wanted)
        assert rows[f"density for IoU {wanted:g}, measured"].ours == density_needed(
            density, iou, wanted
        )
        assert rows[f"density for IoU {wanted:g}, by the fit"].ours == (
            max(needed, 1.0) if needed <= density.max() else None
        )
    assert f"IoU = {fit.intercept:.3f} + {fit.slope:.3f} ln(points)" in made.conclusion
    assert f"200 bins up to {density.max():.0f} points" in made.basis
    low, high = rows["mean, above 100 points"].interval or (1.0, 0.0)
    assert low < iou[density > 100].mean() < high
