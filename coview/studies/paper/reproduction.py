"""`run_reproduction`: the paper's experiments at one of its sites, from simulating the test
recording to the page.

Everything that takes long is kept in the folder, so that an interrupted run resumes: the recording
(`recording_1000.hdf5`, its blocks beside it), detections (`detections.sqlite`), and a table of all
sensor sets if the shipped one does not fit (`table_….npz`). The figures are computed from these
each time, without a detector.

Tables and figures of the paper, from our detections.

Table 2 is compared with an exact table of every sensor set (`placement_env.fidelity.table`). A
region of table 3 is where both sensors of a pair have a vehicle's centre in their field of view,
occluded or not.

IoU against density is binned and fitted as in the paper. Every scored vehicle counts once for each
of the best sensor sets (early fusion): its point density in the fused cloud, and the IoU of the
detection that overlaps it most, 0 without any. Densities from 0 to the maximum are cut into 200
bins of equal width; the IoU of a bin is the mean over its vehicles. The fit is IoU = a + b
ln(points) by least squares over the bins, weighted by their vehicles, at the mean density of each;
vehicles without a point take no part in bins and fit. A log curve keeps rising where IoU no longer
does, so the density that a wanted IoU needs is given twice: by the fit, and by the measured mean
IoU, made monotone in the density (isotonic regression)."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression
from scipy.stats import spearmanr

from coview.studies.paper import comparison
from coview.studies.paper.comparison import (
    CAUSES,
    DEPTH_NOISE,
    GIVEN,
    GOOD_ABOVE,
    IOU_BINS,
    LARGE,
    PAPER_SITES,
    PLACE_NAMES,
    POOR_BELOW,
    TEST_FRAMES,
    Compared,
    Experiment,
    RowEvidence,
    TableRow,
    draw_agreement,
    draw_log_fit,
    draw_pairs,
    explain_difference,
    paper_page,
    percent,
    sensor_sets,
    set_name,
    to_csv,
)
from coview.studies.paper.detections import (
    SchemeRun,
    StoredDetections,
    compare_run,
    detect_runs,
    kbit_per_sensor,
    ms_per_frame,
    score_run,
    visible_share,
)
from placement_env.analysis.intervals import ratio_interval
from placement_env.checks import check_whole
from placement_env.fidelity.detector import IOUS
from placement_env.fidelity.renders import Recorded
from placement_env.fidelity.table import (
    Table,
    TableFidelity,
    best_sets,
    hash_site,
    load_table,
    make_table,
)
from toolkit.arrays import Bool, Float64, Int64
from toolkit.bodies.fleet import fleet_named
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import simulate_dataset
from toolkit.detection.metrics import Curve
from toolkit.detection.provenance import coview_version
from toolkit.objects import Detector
from toolkit.plots.curves import draw_density_cdf, draw_pr_curves
from toolkit.runtime.cache import Cache
from toolkit.runtime.files import replace_infinite, write_text, writing_together
from toolkit.runtime.run import Processes, Run
from toolkit.runtime.text_tables import align_columns

SET_SCHEMES = ("early", "late")


def scheme_runs(sensors: int) -> list[SchemeRun]:
    """Runs that table 1 needs."""
    return [SchemeRun(scheme, tuple(range(sensors))) for scheme in ("late", "hybrid", "early")]


def scheme_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 1: late, hybrid and early fusion of all sensors."""
    rows = []
    for run in scheme_runs(len(stored.sensors)):
        paper = comparison.SCHEME_TABLE[site][run.scheme]
        for iou, theirs in zip(IOUS, paper.ap, strict=True):
            rows.append(compare_run(stored, run, (run.scheme, f"AP@{iou:g}"), theirs, iou=iou))
        kbit = kbit_per_sensor(stored, run)
        why = _explain_kbit(stored, run, paper.kbit)
        rows.append(
            Compared((run.scheme, "sent by a sensor"), "kbit", kbit, paper.kbit, reason=why)
        )
        ms = ms_per_frame(stored, run)
        why = "this machine; the paper's is a Quadro M4000"
        rows.append(Compared((run.scheme, "time"), "ms", ms, paper.ms, reason=why))
    ap = [row for row in rows if row.unit == "AP"]
    ours = {row.labels: row.ours or 0.0 for row in ap}
    ordered = all(
        ours["early", at] >= ours["hybrid", at] >= ours["late", at]
        for at in (f"AP@{iou:g}" for iou in IOUS)
    )
    order = (
        "The paper's order, early over hybrid over late fusion, does not hold at every IoU here."
    )
    if ordered:
        best = "As in the paper, early fusion is best at every IoU, then hybrid, then late"
        order = f"{best}, and costs follow the same order."
    far, sent = (sum(int(truth.sent[row].sum()) for truth in stored.truths) for row in (1, 0))
    beyond = (
        f" {100 * far / sent:.0f} % of the points lie beyond the hybrid radius." if sent else ""
    )
    title = f"Fusion schemes, {PLACE_NAMES[site]}, all sensors, {stored.frames} frames"
    draw = partial(draw_pairs, ["\n".join(row.labels) for row in ap], ap, title=title)
    about = (
        "schemes",
        "Comparison of fusion schemes",
        "table 1, section IV-B",
        ("scheme", "figure"),
    )
    return Experiment(*about, tuple(rows), basis, order + beyond, draw)


def _explain_kbit(stored: StoredDetections, run: SchemeRun, paper: float) -> str:
    if run.scheme == "late":
        boxes = kbit_per_sensor(stored, run) / 0.256
        return f"{boxes:.1f} boxes of 256 bit a sensor here, {paper / 0.256:.1f} in the paper"
    if run.scheme == "hybrid":
        everyone = max(stored.frames, 1) * len(stored.sensors)
        far = sum(int(truth.sent[2].sum()) for truth in stored.truths) / everyone * 96 / 1000
        return (
            "the measure of the radius is not the cause: as the published code has it, points "
            f"make {far:.0f} kbit"
        )
    return ""


def set_experiment(table: Table, seen: StoredDetections, site: str) -> Experiment:
    """Compare table 2: all sensor sets, the best three of each size. seen: points in its frames,
    for reasons."""
    listed = sensor_sets(site)
    origin = table.origin
    names = [set_name(row.sensors) for row in listed.rows]
    count = len(listed.rows)
    sets = np.array([np.isin(np.arange(len(origin.sensors)), row.sensors) for row in listed.rows])
    ours = {scheme: TableFidelity(table, scheme)(sets) for scheme in SET_SCHEMES}
    paper = {scheme: [getattr(row, scheme) for row in listed.rows] for scheme in SET_SCHEMES}
    rows = []
    for scheme, found in ours.items():
        for row, name, theirs, ap, recall in zip(
            listed.rows, names, paper[scheme], found.ap.tolist(), found.recall.tolist(), strict=True
        ):
            reason = explain_difference(
                ap, theirs, RowEvidence(visible_share(seen, row.sensors), recall)
            )
            kind = (
                "paper's best of its size" if row.sensors in listed.best[scheme] else "paper's list"
            )
            rows.append(Compared((kind, scheme, name), "AP", ap, theirs, reason=reason))
    for scheme in SET_SCHEMES:
        for size, best in best_sets(table, scheme).items():
            for rank, each in enumerate(best, 1):
                known = ", in the paper's list" if set_name(each.sensors) in names else ""
                labels = (
                    f"our best of {size}, number {rank}{known}",
                    scheme,
                    set_name(each.sensors),
                )
                rows.append(Compared(labels, "AP", each.ap, None))
    words = []
    for scheme, found in ours.items():
        value = rank_correlation(paper[scheme], found.ap)
        places = places_of_best(table, listed, scheme).values()
        labels = (f"order of the {count} sets listed", scheme, "all listed")
        rows.append(Compared(labels, "rank correlation", value, None))
        words.append(
            f"{scheme} fusion: rank correlation {value:.3f} over {count} sets; of the paper's "
            f"best sets of {len(places)} sizes {sum(place == 1 for place in places)} are the best "
            f"here and {sum(place <= 3 for place in places)} among the best three"
        )
    basis = (
        f"{origin.frames} frames, {origin.objects} vehicles, all {len(table.subsets) - 1} sets, "
        "exact table; it keeps no single frames, so there are no intervals (the PR curves have "
        "those of the best sets)"
    )
    groups = {
        each: list(zip(names, paper[each], found.ap.tolist(), strict=True))
        for each, found in ours.items()
    }
    title = f"Sensor sets of table 2, {PLACE_NAMES[site]}, {origin.frames} frames"
    name = "All sensor sets, and the best three of each size"
    heads = ("row", "scheme", "sensors")
    conclusion = "; ".join(words).capitalize() + "."
    draw = partial(draw_agreement, groups, title=title)
    return Experiment(
        "sensor_sets", name, "table 2, section IV-C", heads, tuple(rows), basis, conclusion, draw
    )


def rank_correlation(a: ArrayLike, b: ArrayLike) -> float:
    """Spearman's rank correlation. Ties share their rank; NaN if one side is constant."""
    if np.ptp(np.asarray(a, np.float64)) == 0 or np.ptp(np.asarray(b, np.float64)) == 0:
        return float("nan")
    return float(spearmanr(a, b).statistic)


def places_of_best(table: Table, listed: comparison.Listed, scheme: str) -> dict[int, int]:
    """Rank of the paper's best set of each size."""
    ours = best_sets(table, scheme, top=1 << len(table.origin.sensors))
    return {
        len(each): [mine.sensors for mine in ours[len(each)]].index(each) + 1
        for each in listed.best[scheme]
    }


def region_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 3: gain from spatial diversity."""
    rows = []
    ap = {}
    for row in comparison.REGION_TABLE[site]:
        labels = (f"in view of {set_name(row.region)}, {{}} vehicles", set_name(row.sensors))
        rows.append(
            compare_run(stored, SchemeRun("early", row.sensors), labels, row.ap, region=row.region)
        )
        ap[row.region, row.sensors] = rows[-1].ours or 0.0, row.ap
    gains = []
    better = []
    for pair in dict.fromkeys(row.region for row in comparison.REGION_TABLE[site]):
        ours, paper = (
            both - max(one, other)
            for one, other, both in zip(
                *(ap[pair, s] for s in (pair[:1], pair[1:], pair)), strict=True
            )
        )
        better.append(ours > 0)
        gains.append(
            f"{set_name(pair)} together {ours:+.3f} over the better of the two (paper {paper:+.3f})"
        )
    helps = "Not every pair is better than the better of its two sensors."
    if all(better):
        helps = "A second view of the same place helps at both pairs, as in the paper."
    title = f"Shared regions, {PLACE_NAMES[site]}, early fusion, IoU 0.7, {stored.frames} frames"
    names = [
        f"{set_name(row.sensors)}\nin {set_name(row.region)}"
        for row in comparison.REGION_TABLE[site]
    ]
    about = (
        "shared_regions",
        "Spatial diversity in shared regions",
        "table 3, section IV-D",
        ("region", "sensors"),
    )
    basis = f"{basis}; vehicles whose centre both sensors of the pair have in their field of view"
    conclusion = f"{helps} In AP, {'; '.join(gains)}."
    return Experiment(
        *about, tuple(rows), basis, conclusion, partial(draw_pairs, names, rows, title=title)
    )


def benchmark_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 4: the paper's figures for other methods, its own, and ours for the same
    pair."""
    pair = comparison.BENCHMARK_PAIR[site]
    paper = {row.sensors: row.ap for row in comparison.REGION_TABLE[site] if row.region == pair}
    rows = []
    for each in comparison.BENCHMARK_TABLE:
        rows += [
            Compared((each.method, "one sensor"), "AP", None, figure) for figure in each.single
        ]
        if each.two is not None:
            rows.append(Compared((each.method, "two sensors"), "AP", None, each.two))
    for sensors, count in ((pair[:1], "one sensor"), (pair, "two sensors")):
        labels = (f"ours, early fusion, {set_name(sensors)} in view of {set_name(pair)}", count)
        rows.append(
            compare_run(stored, SchemeRun("early", sensors), labels, paper[sensors], region=pair)
        )
    gain = (rows[-1].ours or 0.0) - (rows[-2].ours or 0.0)
    seen = score_run(stored, SchemeRun("early", pair[:1]), region=pair[:1])
    labels = (f"ours, sensor {pair[0]}, vehicles in its field of view", "one sensor")
    rows.append(Compared(labels, "AP", seen.ap, None, seen.interval))
    title = f"Reported figures and ours, {PLACE_NAMES[site]}, {stored.frames} frames"
    names = [f"{row.labels[0].split(',')[0]}\n{row.labels[1]}" for row in rows]
    about = (
        "benchmarks",
        "Comparison with existing benchmarks",
        "table 4, section IV-F",
        ("method", "sensors"),
    )
    basis = f"{basis}; rows without ours are from other authors and data, as the paper reports them"
    conclusion = (
        "Other data, other sensors: only the gain from a second sensor can be compared. "
        f"It is {gain:+.2f} here, {paper[pair] - paper[pair[:1]]:+.2f} in the paper and +0.53 for "
        "Cooper and F-Cooper."
        + (" The paper's table 4 covers the T-junction alone." if site != "tjunction" else "")
    )
    return Experiment(
        *about, tuple(rows), basis, conclusion, partial(draw_pairs, names, rows, title=title)
    )


RECALL_STEP = 0.001  # recall between the points of a curve in its file
FEW = 300  # points; the paper's threshold in its text
AT = (0, 1, 2, 5, 10, 20, 50, 70, 100, 150, 200, 250, 300, 400, 500, 750, *range(1000, 4001, 250))
WANTED_IOU = (0.5, 0.6, 0.7, 0.8, 0.9)


def curve_runs(site: str) -> list[SchemeRun]:
    """Runs that the figures need."""
    return [SchemeRun("early", sensors) for sensors in sensor_sets(site).best["early"]]


def curve_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare PR curves of early fusion at IoU 0.7."""
    curves = {run.sensors: score_run(stored, run).curve for run in curve_runs(site)}
    paper = {row.sensors: row.early for row in sensor_sets(site).rows}
    rows = [
        compare_run(stored, SchemeRun("early", each), ("AP@0.7", set_name(each)), paper[each])
        for each in curves
    ]
    captions = [f"{row.labels[1]}: AP {row.ours:.3f} (paper {row.paper:.3f})" for row in rows]
    for says in comparison.CURVE_STATEMENTS[site]:
        curve = curves[says.sensors]
        seen = visible_share(stored, says.sensors)
        ours = (
            max_recall(curve)
            if says.of == "greatest recall"
            else interpolate_precision(curve, 0.95)
        )
        reason = f"{percent(seen)} of the vehicles have a point here" if seen < says.value else ""
        labels = says.of, set_name(says.sensors)
        rows.append(
            Compared(labels, "share", ours, says.value, relation=says.relation, reason=reason)
        )
    everyone, *_, fewest = curves
    points: list[TableRow] = [("sensors", "score", "precision", "recall")]
    for sensors, curve in curves.items():
        kept = steps(curve)
        figures = zip(curve.score[kept], curve.precision[kept], curve.recall[kept], strict=True)
        points += [(set_name(sensors), *(round(float(each), 6) for each in row)) for row in figures]
    drawn = dict(
        zip(captions, ((curve.recall, curve.precision) for curve in curves.values()), strict=True)
    )
    title = f"Early fusion, {PLACE_NAMES[site]}, IoU 0.7, {stored.frames} frames"
    name = "Precision and recall of the best set of each size"
    heads = ("figure", "sensors")
    conclusion = (
        f"All sensors find {percent(max_recall(curves[everyone]))} of the vehicles, sensor "
        f"{set_name(fewest)} alone {percent(max_recall(curves[fewest]))}: more sensors raise the "
        "maximum recall, as in the paper."
    )
    draw = partial(draw_pr_curves, drawn, title=title)
    files = (("pr_curves_points", tuple(points)),)
    about = ("pr_curves", name, "figure of PR curves, section IV-C", heads)
    return Experiment(*about, tuple(rows), basis, conclusion, draw, files)


def max_recall(curve: Curve) -> float:
    """Recall of all detections, 0 without any."""
    return float(curve.recall[-1]) if len(curve.recall) else 0.0


def interpolate_precision(curve: Curve, recall: float) -> float:
    """Best precision at this recall or above, 0 if it is not reached."""
    return float(curve.precision[curve.recall >= recall].max(initial=0.0))


def steps(curve: Curve) -> Bool[np.ndarray, " k"]:
    """Select a curve's last point in each recall step."""
    number = np.floor(curve.recall / RECALL_STEP)
    return np.append(number[1:] != number[:-1], True)[: len(number)]


def density_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare point densities of the best sensor sets."""
    sets = sensor_sets(site).best["early"]
    stated = comparison.DENSITY_STATEMENTS[site]
    paper = {(str(each.of), each.sensors): each for each in stated}
    rows = []
    for of, below in (("no points", 1), (f"below {FEW} points", FEW)):
        for sensors in sets:
            few = [
                int((truth.points[:, list(sensors)].sum(axis=1) < below).sum())
                for truth in stored.truths
            ]
            share = sum(few) / stored.vehicles if stored.vehicles else float("nan")
            figure = (of, set_name(sensors))
            interval = ratio_interval(few, list(stored.to_find))
            says = paper.get((of, sensors))
            row = Compared(figure, "share", share, None, interval)
            rows.append(
                row if says is None else replace(row, paper=says.value, relation=says.relation)
            )
    for sensors in sets:
        median = float(np.median(stored.points(sensors))) if stored.vehicles else float("nan")
        rows.append(Compared(("median of the points", set_name(sensors)), "points", median, None))
    everyone = rows[0].ours
    fewest = rows[len(sets) - 1].ours
    points = [stored.points(sensors) for sensors in sets]
    shares = [
        (at, *(round(float((each <= at).mean()), 6) if len(each) else "" for each in points))
        for at in AT
    ]
    names = [set_name(sensors) for sensors in sets]
    conclusion = (
        f"{percent(fewest)} of the vehicles have no point from sensor {names[-1]} alone, "
        f"{percent(everyone)} none from all sensors."
        + ("" if stated else f" The paper shows this for the {PLACE_NAMES['tjunction']} alone.")
    )
    name = "Points on a vehicle with the best sets"
    source = "figure of point density (a), section IV-E"
    about = ("point_density", name, source, ("share of vehicles with", "sensors"))
    draw = partial(draw_density_cdf, dict(zip(names, points, strict=True)))
    files = (("point_density_curves", (("points, at most", *names), *shares)),)
    return Experiment(*about, tuple(rows), basis, conclusion, draw, files)


class BinnedIou(NamedTuple):
    """Bins with vehicles: mean density, mean IoU and vehicle count."""

    density: Float64[np.ndarray, " bins"]
    iou: Float64[np.ndarray, " bins"]
    vehicles: Int64[np.ndarray, " bins"]


class LogFit(NamedTuple):
    """Fit of IoU = intercept + slope · ln(points)."""

    intercept: float
    slope: float

    def density_needed(self, iou: float) -> float:
        """Points from which the fit reaches an IoU, infinite if it never does."""
        if not self.slope > 0:
            return float("nan") if self.slope != self.slope else float("inf")
        return float(np.exp((iou - self.intercept) / self.slope))


def iou_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare IoU against density. The paper gives no coefficients: poor below 70 points, much
    better above 100."""
    density, iou = densities_and_ious(stored, site)
    bins = bin_iou(density[density > 0], iou[density > 0])
    fit = fit_log(bins)
    most = float(density.max(initial=0))
    rows = []
    for name, low, high in (
        (f"mean, below {POOR_BELOW} points", 0, POOR_BELOW),
        (f"mean, {POOR_BELOW} to {GOOD_ABOVE} points", POOR_BELOW, GOOD_ABOVE + 1),
        (f"mean, above {GOOD_ABOVE} points", GOOD_ABOVE + 1, np.inf),
    ):
        sums = np.zeros(stored.frames)
        counts = np.zeros(stored.frames)
        for run in curve_runs(site):
            for k, (truth, found) in enumerate(zip(stored.truths, stored.runs[run], strict=True)):
                points = truth.points[:, list(run.sensors)].sum(axis=1)
                within = (points >= low) & (points < high)
                sums[k] += found.best[within].sum()
                counts[k] += within.sum()
        mean = float(sums.sum() / counts.sum()) if counts.sum() else None
        rows.append(
            Compared(
                (name,), "IoU", mean, None, None if mean is None else ratio_interval(sums, counts)
            )
        )
    for wanted in WANTED_IOU:
        by_fit = fit.density_needed(wanted)
        ours = max(by_fit, 1.0) if by_fit <= most else None
        for how, needed in (
            ("by the fit", ours),
            ("measured", density_needed(density, iou, wanted)),
        ):
            rows.append(Compared((f"density for IoU {wanted:g}, {how}",), "points", needed, None))
    poor, good = ("–" if row.ours is None else f"{row.ours:.2f}" for row in (rows[0], rows[2]))
    title = f"IoU and point density, {PLACE_NAMES[site]}, {stored.frames} frames"
    draw = partial(draw_log_fit, bins.density, bins.iou, (fit.intercept, fit.slope), title=title)
    heads = ("points, mean of the bin", "IoU, mean of the bin", "vehicles")
    columns = zip(
        bins.density.round(3).tolist(),
        bins.iou.round(6).tolist(),
        bins.vehicles.tolist(),
        strict=True,
    )
    basis = (
        f"{basis}, each with every one of the best sets: {len(density)} in {IOU_BINS} bins up to "
        f"{most:.0f} points"
    )
    conclusion = (
        f"IoU = {fit.intercept:.3f} + {fit.slope:.3f} ln(points). Boxes on fewer than "
        f"{POOR_BELOW} points have a mean IoU of {poor}, boxes on more than {GOOD_ABOVE} of "
        f"{good}: as the paper says, the density tells how well a vehicle can be measured."
        + ("" if site == "tjunction" else " The paper shows this for the T-junction alone.")
    )
    about = (
        "iou_density",
        "IoU against point density",
        "figure of point density (b), section IV-E",
        ("figure",),
    )
    return Experiment(
        *about, tuple(rows), basis, conclusion, draw, (("iou_density_bins", (heads, *columns)),)
    )


def densities_and_ious(
    stored: StoredDetections, site: str
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Point density and IoU of every vehicle per best set."""
    density = [np.zeros(0)]
    iou = [np.zeros(0)]
    for run in curve_runs(site):
        density.append(stored.points(run.sensors).astype(np.float64))
        iou += [found.best for found in stored.runs[run]]
    return np.concatenate(density), np.concatenate(iou)


def bin_iou(
    density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], bins: int = IOU_BINS
) -> BinnedIou:
    """Average IoU over bins of equal width from 0 to the maximum density."""
    width = float(density.max(initial=0)) / bins
    number = (
        np.minimum((density / width).astype(np.int64), bins - 1)
        if width
        else np.zeros(len(density), np.int64)
    )
    count = np.bincount(number, minlength=bins)
    held = count > 0
    means = [
        np.bincount(number, values, minlength=bins)[held] / count[held] for values in (density, iou)
    ]
    return BinnedIou(means[0], means[1], count[held])


def fit_log(bins: BinnedIou) -> LogFit:
    """Fit IoU to log density by weighted least squares over the bins whose density is above 0."""
    above = bins.density > 0
    if above.sum() < 2:
        return LogFit(float("nan"), float("nan"))
    slope, intercept = np.polyfit(
        np.log(bins.density[above]), bins.iou[above], 1, w=np.sqrt(bins.vehicles[above])
    )
    return LogFit(float(intercept), float(slope))


def density_needed(
    density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], wanted: float
) -> float | None:
    """Least density for a wanted mean IoU, made monotone. None if it never reaches the wanted
    one."""
    at, group, counts = np.unique(density, return_inverse=True, return_counts=True)
    if not len(at):
        return None
    rising = isotonic_regression(np.bincount(group, iou) / counts, weights=counts).x
    enough = np.flatnonzero(rising >= wanted - 1e-12)
    return float(at[enough[0]]) if len(enough) else None


def all_runs(site: str, sensors: int) -> list[SchemeRun]:
    """Runs that the experiments need."""
    in_regions = (SchemeRun("early", row.sensors) for row in comparison.REGION_TABLE[site])
    return [*scheme_runs(sensors), *curve_runs(site), *in_regions]


def all_experiments(
    stored: StoredDetections, seen: StoredDetections, table: Table, site: str
) -> tuple[Experiment, ...]:
    """Run every experiment, in the paper's order."""
    about = stored, site, f"{stored.frames} frames, {stored.vehicles} vehicles"
    return (
        *(scheme_experiment(*about), set_experiment(table, seen, site), curve_experiment(*about)),
        *(
            region_experiment(*about),
            density_experiment(*about),
            iou_experiment(*about),
            benchmark_experiment(*about),
        ),
    )


SEEDS = {"tjunction": 2001, "roundabout": 2002}  # of the test recordings, as in docs/figures.md
NOISE_SEED = 0
PAGE = "index.html"
FIGURES = "reproduction.json"


@dataclass(frozen=True)
class Reproduction:
    """Experiments at a site, and the path of the page."""

    site: str
    frames: int
    vehicles: int
    experiments: tuple[Experiment, ...]
    page: Path

    @property
    def summary(self) -> str:
        """Table of AP differences from the paper's."""
        table = [["experiment", "AP compared", f"beyond {LARGE:g}", "mean difference", "greatest"]]
        for each in self.experiments:
            differences = [
                row.difference
                for row in each.rows
                if row.unit == "AP" and row.difference is not None
            ]
            if differences:
                far = sum(abs(difference) > LARGE for difference in differences)
                mean = sum(differences) / len(differences)
                greatest = max(differences, key=abs)
                table.append(
                    [each.name, str(len(differences)), str(far), f"{mean:+.4f}", f"{greatest:+.4f}"]
                )
        return (
            f"{self.site}: {self.frames} frames, {self.vehicles} "
            f"vehicles\n{align_columns(table, texts=1)}"
        )

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        about = {"site": self.site, "frames": self.frames, "vehicles": self.vehicles}
        return about | {"experiments": [each.as_dict() for each in self.experiments]}


def run_reproduction(
    site: str,
    out: str | Path,
    *,
    frames: int = TEST_FRAMES,
    detector: Callable[[CoopDataset], Detector] | None = None,
    table: str | Path | None = None,
    recorded: int = TEST_FRAMES,
    processes: Processes = Processes(),
) -> Reproduction:
    """Run the paper's experiments at one of its sites and write them into a folder.

    frames: of the test recording that are evaluated; detector: makes one for the recording, None
    for the site's shipped network; table: file of `coview table` with the AP of all sensor sets,
    None for the shipped table, or for a new one if that was not measured at this site with this
    detector; recorded: frames of the recording, at least `frames`. Raises ValueError for a site
    that the paper has no figures for, and for arguments that do not fit."""
    check_paper_site(site)
    check_whole("frames", frames, least=1)
    check_whole("recorded", recorded, least=1)
    given = None if table is None else load_table(table)
    out = Path(out)
    recorded = max(frames, recorded)
    path = out / f"recording_{recorded}.hdf5"
    run = Run(frames=recorded, seed=SEEDS[site], **vars(processes))
    try:
        simulate_dataset(site, path, run=run, fleet=fleet_named("catalogue"))
    except FileExistsError:
        raise FileExistsError(
            f"{path} is damaged or no test recording: remove it, or give another --out"
        ) from None
    with CoopDataset(path) as recording:
        if detector is None:
            from models.detector import load_site_detector

            detect: Detector = load_site_detector(site, recording.site.area)
        else:
            detect = detector(recording)
        digest = getattr(detect, "digest", None)
        shipped = load_table(site)
        place = hash_site(recording.site, recording.sensors)
        sets = shipped if given is None else given
        if given is not None and given.origin.place != place:
            raise ValueError(
                f"the table is of {given.origin.site!r} with other sensors: make one with coview "
                "table"
            )
        if given is not None and given.origin.detector != digest:
            raise ValueError(
                "the table was measured with another detector: make one with coview table"
            )
        renders = Recorded(recording, NOISE_SEED)
        memo = Cache(out / "detections.sqlite")
        detect_in = partial(detect_runs, renders, detect, memo=memo, processes=processes)
        stored = detect_in(all_runs(site, len(recording.sensors)), frames=frames)
        if (sets.origin.place, sets.origin.detector) != (place, digest):
            path = out / f"table_{frames}_{str(digest)[:12]}_{renders.digest[:12]}.npz"
            try:
                sets = load_table(path)
            except (ValueError, FileNotFoundError):  # damaged, or not made yet
                sets = make_table(
                    renders, detect, path, frames=frames, seed=NOISE_SEED, processes=processes
                )
        seen = detect_in(
            (), frames=min(sets.origin.frames, renders.frames), stage="frames looked at"
        )
    experiments = all_experiments(stored, seen, sets, site)
    causes = (
        CAUSES
        if detector is None or stored.detector == shipped.origin.detector
        else CAUSES | {"!": GIVEN}
    )
    write_experiments(
        out, experiments, site=site, conditions=_conditions(stored, sets, site), causes=causes
    )
    return Reproduction(site, stored.frames, stored.vehicles, experiments, out / PAGE)


def check_paper_site(site: str) -> None:
    """Raise ValueError where the paper has no figures for a site."""
    if site not in PAPER_SITES:
        raise ValueError(
            f"the paper has figures for {' and '.join(PAPER_SITES)}, not for {site!r}: choose one "
            "of them"
        )


def write_experiments(
    out: Path,
    experiments: tuple[Experiment, ...],
    *,
    site: str,
    conditions: dict[str, str],
    causes: dict[str, str],
) -> None:
    """Write the page, all figures as JSON, and CSV and SVG of each experiment."""
    with writing_together(out) as folder:
        pictures = {}
        for each in experiments:
            each.draw(folder / f"{each.name}.svg")
            pictures[each.name] = (folder / f"{each.name}.svg").read_bytes()
            write_text(folder / f"{each.name}.csv", each.csv)
            for name, rows in each.curves:
                write_text(folder / f"{name}.csv", to_csv(rows))
        figures = {
            "site": site,
            "conditions": conditions,
            "experiments": [each.as_dict() for each in experiments],
        }
        write_text(
            folder / FIGURES, json.dumps(replace_infinite(figures), indent=1, allow_nan=False)
        )
        title = (
            f"The paper's experiments at the {PLACE_NAMES[site]}, our figures beside the paper's"
        )
        write_text(
            folder / PAGE,
            paper_page(title, experiments, pictures, conditions=conditions, causes=causes),
        )


def _conditions(stored: StoredDetections, table: Table, site: str) -> dict[str, str]:
    origin = table.origin
    return {
        "test recording": (
            f"{stored.frames} frames, seed {SEEDS[site]}, {stored.vehicles} vehicles (no heavy "
            f"ones) centred in the area; the paper's has {TEST_FRAMES} frames"
        ),
        "sensors": (
            f"{len(stored.sensors)}, exact poses; noise of {DEPTH_NOISE * 100:g} cm at every depth"
        ),
        "detector": f"digest {stored.detector[:12]}",
        "sensor sets": f"exact table of {origin.frames} frames, {origin.objects} vehicles",
        "protocol": (
            "exact (toolkit.detection.metrics): all-point interpolated AP, IoU of volumes, 0.7 "
            "unless stated"
        ),
        "milliseconds": (
            "of this machine under its load at the time; only the order of magnitude can be "
            "compared"
        ),
        "coview": coview_version(),
        "made by": f"coview reproduce {site} --frames {stored.frames}",
    }
