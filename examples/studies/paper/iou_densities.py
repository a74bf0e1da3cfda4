"""IoU against point density, binned and fitted as in the paper.

Every scored vehicle counts once for each of the best sensor sets (early fusion): its point density
in the fused cloud, and the IoU of the detection that overlaps it most, 0 without any. Densities
from 0 to the maximum are cut into 200 bins of equal width; the IoU of a bin is the mean over its
vehicles. The fit is IoU = a + b ln(points) by least squares over the bins, weighted by their
vehicles, at the mean density of each bin; vehicles without a point are in neither bins nor fit. A
log curve keeps rising after IoU has stopped, so the density for a target IoU is given twice: by the
fit, and by the measured mean IoU, made monotone in the density (isotonic regression)."""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.optimize import isotonic_regression

from examples.studies.paper.charts import draw_log_fit
from examples.studies.paper.comparison import Compared, Experiment, TableRow
from examples.studies.paper.detections import StoredDetections
from examples.studies.paper.paper_tables import GOOD_POINTS, IOU_BINS, PLACE_NAMES, POOR_POINTS
from examples.studies.paper.pr_curves import curve_runs
from placement_env.analysis.intervals import ratio_interval
from toolkit.arrays import Float64, Int64

TARGET_IOUS = (0.5, 0.6, 0.7, 0.8, 0.9)


class BinnedIou(NamedTuple):
    """Bins of point density that have vehicles, ascending.

    Attributes:
        density: Mean number of points on a vehicle of each bin.
        iou: Mean IoU of the vehicles of each bin.
        vehicles: Number of vehicles of each bin.
    """

    density: Float64[np.ndarray, " bins"]
    iou: Float64[np.ndarray, " bins"]
    vehicles: Int64[np.ndarray, " bins"]


class LogFit(NamedTuple):
    """Fit of IoU = intercept + slope · ln(points)."""

    intercept: float
    slope: float

    def density_needed(self, iou: float) -> float:
        """Return the number of points from which the fit reaches an IoU.

        It is infinite if the fit never does, NaN without a fit."""
        if np.isnan(self.slope):
            return float("nan")
        if self.slope <= 0:
            return float("inf")
        return float(np.exp((iou - self.intercept) / self.slope))


def iou_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare IoU against density.

    The paper gives no coefficients, but calls the accuracy below 70 points poor and above 100
    points much better."""
    density, iou = densities_and_ious(stored, site)
    bins = bin_iou(density[density > 0], iou[density > 0])
    fit = fit_log(bins)
    max_density = float(density.max(initial=0))
    rows = [
        _average_iou(stored, site, f"mean, below {POOR_POINTS} points", (0, POOR_POINTS)),
        _average_iou(
            stored,
            site,
            f"mean, {POOR_POINTS} to {GOOD_POINTS} points",
            (POOR_POINTS, GOOD_POINTS + 1),
        ),
        _average_iou(stored, site, f"mean, above {GOOD_POINTS} points", (GOOD_POINTS + 1, np.inf)),
    ]
    poor_iou = rows[0].ours
    good_iou = rows[2].ours
    for target_iou in TARGET_IOUS:
        fitted_density = fit.density_needed(target_iou)
        by_fit = max(fitted_density, 1.0) if fitted_density <= max_density else None
        measured = density_needed(density, iou, target_iou)
        for source, points in (("by the fit", by_fit), ("measured", measured)):
            labels = (f"density for IoU {target_iou:g}, {source}",)
            rows.append(Compared(labels, "points", points, None))
    title = f"IoU and point density, {PLACE_NAMES[site]}, {stored.frames} frames"
    table: list[TableRow] = [("points, mean of the bin", "IoU, mean of the bin", "vehicles")]
    table += zip(
        bins.density.round(3).tolist(),
        bins.iou.round(6).tolist(),
        bins.vehicles.tolist(),
        strict=True,
    )
    basis = (
        f"{basis}, each with every one of the best sets: {len(density)} in {IOU_BINS} bins up to "
        f"{max_density:.0f} points"
    )
    poor_text = "–" if poor_iou is None else f"{poor_iou:.2f}"
    good_text = "–" if good_iou is None else f"{good_iou:.2f}"
    conclusion = (
        f"IoU = {fit.intercept:.3f} + {fit.slope:.3f} ln(points). Boxes on fewer than "
        f"{POOR_POINTS} points have a mean IoU of {poor_text}, boxes on more than {GOOD_POINTS} of "
        f"{good_text}: as the paper says, the density tells how well a vehicle can be measured."
    )
    if site != "tjunction":
        conclusion += " The paper shows this for the T-junction alone."
    return Experiment(
        "iou_density",
        "IoU against point density",
        "figure of point density (b), section IV-E",
        ("figure",),
        tuple(rows),
        basis,
        conclusion,
        partial(draw_log_fit, bins.density, bins.iou, (fit.intercept, fit.slope), title=title),
        (("iou_density_bins", tuple(table)),),
    )


def _average_iou(
    stored: StoredDetections, site: str, name: str, points_range: tuple[float, float]
) -> Compared:
    """Average the IoU of vehicles with points in a range, over the best sets.

    name: label of the row; points_range: least number of points, and the number from which they are
    too many."""
    low, high = points_range
    sums = np.zeros(stored.frames)
    counts = np.zeros(stored.frames)
    for run in curve_runs(site):
        for k, truth in enumerate(stored.truths):
            points = truth.points[:, list(run.sensors)].sum(axis=1)
            is_within = (points >= low) & (points < high)
            sums[k] += stored.runs[run][k].best[is_within].sum()
            counts[k] += is_within.sum()
    if not counts.sum():
        return Compared((name,), "IoU", None, None)
    mean = float(sums.sum() / counts.sum())
    return Compared((name,), "IoU", mean, None, ratio_interval(sums, counts))


def densities_and_ious(
    stored: StoredDetections, site: str
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Return the number of points on every vehicle, and its IoU, for one best set after another.

    The IoU is with the detection that overlaps the vehicle most, 0 without any."""
    density = [np.zeros(0)]
    iou = [np.zeros(0)]
    for run in curve_runs(site):
        density.append(stored.points(run.sensors).astype(np.float64))
        iou += [frame_run.best for frame_run in stored.runs[run]]
    return np.concatenate(density), np.concatenate(iou)


def bin_iou(
    density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], bins: int = IOU_BINS
) -> BinnedIou:
    """Average IoU over bins of equal width from 0 to the maximum density.

    density: number of points on each vehicle; iou: IoU of each; bins: number of bins; empty ones
    are left out."""
    width = float(density.max(initial=0)) / bins
    number = np.zeros(len(density), np.int64)
    if width:
        number = np.minimum((density / width).astype(np.int64), bins - 1)
    count = np.bincount(number, minlength=bins)
    is_filled = count > 0
    density_sums = np.bincount(number, density, minlength=bins)[is_filled]
    iou_sums = np.bincount(number, iou, minlength=bins)[is_filled]
    count = count[is_filled]
    return BinnedIou(density_sums / count, iou_sums / count, count)


def fit_log(bins: BinnedIou) -> LogFit:
    """Fit IoU to log density by weighted least squares over the bins whose density is above 0.

    Bins weigh as much as they have vehicles. The fit is NaN with fewer than two bins."""
    is_used = bins.density > 0
    if is_used.sum() < 2:
        return LogFit(float("nan"), float("nan"))
    log_density = np.log(bins.density[is_used])
    weights = np.sqrt(bins.vehicles[is_used])  # polyfit squares them
    slope, intercept = np.polyfit(log_density, bins.iou[is_used], 1, w=weights)
    return LogFit(float(intercept), float(slope))


def density_needed(
    density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], target_iou: float
) -> float | None:
    """Return the lowest density at which the mean IoU, made monotone, reaches a target.

    density: number of points on each vehicle; iou: IoU of each. Returns None if it never
    does."""
    densities, group, counts = np.unique(density, return_inverse=True, return_counts=True)
    if not len(densities):
        return None
    rising = isotonic_regression(np.bincount(group, iou) / counts, weights=counts).x
    reaching = np.flatnonzero(rising >= target_iou - 1e-12)
    return float(densities[reaching[0]]) if len(reaching) else None
