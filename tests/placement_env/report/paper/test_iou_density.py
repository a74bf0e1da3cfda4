import numpy as np
import pytest
from scipy.optimize import isotonic_regression

from placement_env.analysis.intervals import ratio_interval
from placement_env.report.paper.iou_density import (
    BinnedIou,
    LogFit,
    binned,
    densities_and_ious,
    iou_experiment,
    log_fit,
    needed_density,
)


def test_bins_are_of_equal_width_and_hold_means():
    density, iou = np.array([0.0, 10, 20, 20, 400]), np.array([0.0, 0.2, 0.3, 0.5, 0.9])
    bins = binned(density, iou, bins=20)
    assert bins.density.tolist() == [5, 20, 400]
    assert bins.iou == pytest.approx([0.1, 0.4, 0.9])
    assert bins.vehicles.tolist() == [2, 2, 1]


def test_every_vehicle_is_in_a_bin(stored):
    density, iou = densities_and_ious(stored, "tjunction")
    assert len(density) == len(iou) == 6 * stored.vehicles
    bins = binned(density, iou)
    assert bins.vehicles.sum() == len(density)
    assert bins.iou @ bins.vehicles == pytest.approx(iou.sum())
    assert len(binned(np.zeros(3), np.ones(3)).iou) == 1
    assert len(binned(np.zeros(0), np.zeros(0)).iou) == 0


def test_a_log_curve_is_fitted_exactly_and_solved():
    density = np.array([0.0, 10, 50, 200, 1000])
    fit = log_fit(BinnedIou(density, 0.2 + 0.1 * np.log(np.maximum(density, 1)), np.array([5, 1, 4, 2, 9])))
    assert fit == pytest.approx((0.2, 0.1))
    assert fit.density_for(0.7) == pytest.approx(np.exp(5))
    assert LogFit(0.2, -0.1).density_for(0.7) == np.inf
    assert np.isnan(log_fit(BinnedIou(np.array([0.0, 3]), np.ones(2), np.ones(2, np.int64))).density_for(0.7))


def test_fit_weighs_what_a_bin_holds():
    density, iou = np.array([10.0, 100.0, 1000.0]), np.array([0.4, 0.7, 0.8])
    alone = log_fit(BinnedIou(density[:2], iou[:2], np.array([1, 1])))
    heavy = log_fit(BinnedIou(density, iou, np.array([10**9, 10**9, 1])))
    assert heavy == pytest.approx(alone, abs=1e-6)


def test_needed_density_is_that_of_isotonic_regression():
    rng = np.random.default_rng(0)
    density = rng.integers(0, 60, 400).astype(float)
    iou = np.clip(density / 60 + rng.normal(0, 0.2, 400), 0, 1)
    at = np.unique(density)
    means = np.array([iou[density == each].mean() for each in at])
    fit = isotonic_regression(means, weights=np.array([(density == each).sum() for each in at])).x
    for wanted in (0.0, 0.2, 0.5, 0.8):
        assert needed_density(density, iou, wanted) == at[(fit >= wanted).argmax()]
    assert needed_density(density, iou, 1.01) is None
    assert needed_density(np.zeros(0), np.zeros(0), 0.5) is None


def test_rows(stored):
    made = iou_experiment(stored, "tjunction", "basis")
    density, iou = densities_and_ious(stored, "tjunction")
    rows = {row.labels[0]: row for row in made.rows}
    assert rows["mean, below 70 points"].ours == pytest.approx(iou[density < 70].mean())
    assert rows["mean, 70 to 100 points"].ours == pytest.approx(iou[(density >= 70) & (density <= 100)].mean())
    assert rows["mean, above 100 points"].ours == pytest.approx(iou[density > 100].mean())
    fit = log_fit(binned(density[density > 0], iou[density > 0]))
    for wanted in (0.5, 0.6, 0.7, 0.8, 0.9):
        needed = fit.density_for(wanted)
        assert rows[f"density for IoU {wanted:g}, measured"].ours == needed_density(density, iou, wanted)
        assert rows[f"density for IoU {wanted:g}, by the fit"].ours == (
            max(needed, 1.0) if needed <= density.max() else None
        )
    assert f"IoU = {fit.intercept:.3f} + {fit.slope:.3f} ln(points)" in made.conclusion
    assert f"200 bins up to {density.max():.0f} points" in made.basis
    low, high = rows["mean, above 100 points"].interval or (1.0, 0.0)
    assert low < iou[density > 100].mean() < high


def test_interval_is_over_blocks_of_frames(stored):
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


def test_bins_are_written_and_drawn(stored_roundabout, tmp_path):
    made = iou_experiment(stored_roundabout, "roundabout", "")
    ((name, rows),) = made.curves
    assert (name, rows[0][2]) == ("iou_density_bins", "vehicles")
    density, _ = densities_and_ious(stored_roundabout, "roundabout")
    assert sum(row[2] for row in rows[1:]) == (density > 0).sum()
    made.draw(tmp_path / "iou.svg")
    assert (tmp_path / "iou.svg").stat().st_size > 5000
    assert made.conclusion.endswith("T-junction alone.")
