"""IoU against point density, as the paper bins and fits it, and the density that a wanted IoU needs.

Every scored vehicle counts once for each of the best sensor sets (early fusion): its point density in the fused cloud,
and the IoU of the detection that overlaps it most, 0 where none does. The densities from 0 to the greatest are cut
into 200 bins of equal width; a bin's IoU is the mean of its vehicles. The fit is IoU = a + b ln(points) by least
squares over the bins, each weighing what it holds, at the mean density of its vehicles; vehicles without a point take
no part in bins and fit. A log curve rises on where IoU no longer does, so that the density a wanted IoU needs is given
twice: by the fit, and by the measured mean IoU, made monotone in the density (isotonic regression).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import ratio_interval
from placement_env.report.paper.charts import draw_log_fit
from placement_env.report.paper.comparison import Compared, Experiment
from placement_env.report.paper.published import (
    FIGURE_IOU,
    GOOD_ABOVE,
    IOU_BINS,
    PLACE_NAMES,
    POOR_BELOW,
    sensor_sets,
)
from placement_env.report.paper.stored import SchemeRun, StoredDetections
from toolkit.arrays import Float64, Int64

WANTED_IOU = (0.5, 0.6, 0.7, 0.8, 0.9)


class BinnedIou(NamedTuple):
    """Bins that hold a vehicle: mean density, mean IoU and number of their vehicles."""

    density: Float64[np.ndarray, " bins"]
    iou: Float64[np.ndarray, " bins"]
    vehicles: Int64[np.ndarray, " bins"]


class LogFit(NamedTuple):
    """IoU = intercept + slope · ln(points); NaN without two bins."""

    intercept: float
    slope: float

    def density_for(self, iou: float) -> float:
        """Points from which on the fit reaches an IoU; infinite where it never does.

        >>> round(LogFit(0.2, 0.1).density_for(0.7), 1)
        148.4
        """
        if not self.slope > 0:
            return float("nan") if self.slope != self.slope else float("inf")
        return float(np.exp((iou - self.intercept) / self.slope))


def iou_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Ours beside the paper's, which states no coefficients: below 70 points poor, much better above 100."""
    density, iou = densities_and_ious(stored, site)
    bins = binned(density[density > 0], iou[density > 0])
    fit = log_fit(bins)
    greatest = float(density.max(initial=0))
    rows = []
    for name, low, high in (
        (f"mean, below {POOR_BELOW} points", 0.0, float(POOR_BELOW)),
        (f"mean, {POOR_BELOW} to {GOOD_ABOVE} points", float(POOR_BELOW), GOOD_ABOVE + 1.0),
        (f"mean, above {GOOD_ABOVE} points", GOOD_ABOVE + 1.0, float("inf")),
    ):
        rows.append(_mean_row(stored, site, name, low, high))
    for wanted in WANTED_IOU:
        needed = fit.density_for(wanted)
        ours = max(needed, 1.0) if needed <= greatest else None
        rows.append(Compared((f"density for IoU {wanted:g}, by the fit",), "points", ours, None))
        rows.append(
            Compared((f"density for IoU {wanted:g}, measured",), "points", needed_density(density, iou, wanted), None)
        )
    poor, good = rows[0].ours, rows[2].ours

    def draw(out: Path) -> None:
        title = f"IoU and point density, {PLACE_NAMES[site]}, {stored.frames} frames"
        draw_log_fit(bins.density, bins.iou, (fit.intercept, fit.slope), out, title=title)

    heads = ("points, mean of the bin", "IoU, mean of the bin", "vehicles")
    columns = zip(bins.density.round(3).tolist(), bins.iou.round(6).tolist(), bins.vehicles.tolist(), strict=True)
    return Experiment(
        "iou_density", "IoU against point density", f"{FIGURE_IOU}, section IV-E", ("figure",), tuple(rows),
        f"{basis}, each with every one of the best sets: {len(density)} in {IOU_BINS} bins up to {greatest:.0f} points",
        f"IoU = {fit.intercept:.3f} + {fit.slope:.3f} ln(points). Below {POOR_BELOW} points boxes fit with a mean IoU "
        f"of {_number(poor)}, above {GOOD_ABOVE} with {_number(good)}: as the paper says, the density tells how well a "
        "vehicle can be measured." + ("" if site == "tjunction" else " The paper shows this for the T-junction alone."),
        draw, (("iou_density_bins", (heads, *columns)),),
    )  # fmt: skip


def densities_and_ious(
    stored: StoredDetections, site: str
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Point density and IoU of every vehicle with each of the best sets."""
    density, iou = [np.zeros(0)], [np.zeros(0)]
    for sensors in sensor_sets(site).best_early:
        density.append(stored.points(sensors).astype(np.float64))
        iou += [found.best for found in stored.runs[SchemeRun("early", sensors)]]
    return np.concatenate(density), np.concatenate(iou)


def binned(density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], bins: int = IOU_BINS) -> BinnedIou:
    """Means over bins of equal width from 0 to the greatest density.

    >>> binned(np.array([0.0, 1.0, 9.0, 10.0]), np.array([0.0, 0.2, 0.8, 1.0]), bins=2).iou
    array([0.1, 0.9])
    """
    width = float(density.max(initial=0)) / bins
    number = np.minimum((density / width).astype(np.int64), bins - 1) if width else np.zeros(len(density), np.int64)
    count = np.bincount(number, minlength=bins)
    held = count > 0
    means = [np.bincount(number, values, minlength=bins)[held] / count[held] for values in (density, iou)]
    return BinnedIou(means[0], means[1], count[held])


def log_fit(bins: BinnedIou) -> LogFit:
    """Weighted least squares over the bins whose density is above 0."""
    above = bins.density > 0
    if above.sum() < 2:
        return LogFit(float("nan"), float("nan"))
    slope, intercept = np.polyfit(np.log(bins.density[above]), bins.iou[above], 1, w=np.sqrt(bins.vehicles[above]))
    return LogFit(float(intercept), float(slope))


def needed_density(density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], wanted: float) -> float | None:
    """The least density from which on the mean IoU, made monotone, is at least the wanted one; None where it never is.

    >>> needed_density(np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.1, 0.6, 0.4, 0.9]), 0.5)
    2.0
    """
    at, group, counts = np.unique(density, return_inverse=True, return_counts=True)
    pooled: list[list[float]] = []  # first density, mean IoU, vehicles
    for first, mean, count in zip(at, np.bincount(group, iou) / counts if len(at) else (), counts, strict=True):
        pooled.append([float(first), float(mean), float(count)])
        while len(pooled) > 1 and pooled[-2][1] >= pooled[-1][1]:
            (low, a, m), (_, b, n) = pooled[-2:]
            pooled[-2:] = [[low, (a * m + b * n) / (m + n), m + n]]
    return next((first for first, mean, _ in pooled if mean >= wanted - 1e-12), None)


def _mean_row(stored: StoredDetections, site: str, name: str, low: float, high: float) -> Compared:
    """Mean IoU of the vehicles with so many points, `high` excluded."""
    sums, counts = np.zeros(stored.frames), np.zeros(stored.frames)
    for sensors in sensor_sets(site).best_early:
        for k, (truth, found) in enumerate(zip(stored.truths, stored.runs[SchemeRun("early", sensors)], strict=True)):
            points = truth.points[:, list(sensors)].sum(axis=1)
            within = (points >= low) & (points < high)
            sums[k] += found.best[within].sum()
            counts[k] += within.sum()
    mean = float(sums.sum() / counts.sum()) if counts.sum() else None
    return Compared((name,), "IoU", mean, None, None if mean is None else ratio_interval(sums, counts))


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
