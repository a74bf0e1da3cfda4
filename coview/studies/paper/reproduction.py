"""`run_reproduction`: the paper's experiments at one of its sites, from recording to page.

Everything that takes long is kept in the folder, so that an interrupted run resumes: the recording
(`recording_1000.hdf5` and its blocks), detections (`detections.sqlite`), and a table of all sensor
sets if the shipped one does not fit (`table_….npz`). The figures are computed from these files each
time, without a detector.

Table 2 is compared with an exact table of every sensor set (`placement_env.fidelity.table`). In a
region of table 3, both sensors of a pair have a vehicle's centre in their field of view, occluded
or not.

IoU against density is binned and fitted as in the paper. Every scored vehicle counts once for each
of the best sensor sets (early fusion): its point density in the fused cloud, and the IoU of the
detection that overlaps it most, 0 without any. Densities from 0 to the maximum are cut into 200
bins of equal width; the IoU of a bin is the mean over its vehicles. The fit is IoU = a + b
ln(points) by least squares over the bins, weighted by their vehicles, at the mean density of each
bin; vehicles without a point are in neither bins nor fit. A log curve keeps rising after IoU has
stopped, so the density for a target IoU is given twice: by the fit, and by the measured mean IoU,
made monotone in the density (isotonic regression)."""

import json
from collections.abc import Callable, Mapping, Sequence
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
    DEPTH_NOISE_M,
    GIVEN_DETECTOR,
    GOOD_POINTS,
    IOU_BINS,
    LARGE_AP_DIFFERENCE,
    PAPER_SITES,
    PLACE_NAMES,
    POOR_POINTS,
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
from toolkit.runtime.run import Processes, Run
from toolkit.runtime.text_tables import align_columns
from toolkit.runtime.text_values import replace_infinite
from toolkit.runtime.writing import write_text, writing_together

SET_SCHEMES = ("early", "late")
RECALL_STEP = 0.001  # recall between the points of a curve in its file
FEW_POINTS = 300  # the paper's threshold in its text
CURVE_POINTS = (
    *(0, 1, 2, 5, 10, 20, 50, 70, 100, 150, 200, 250, 300, 400, 500, 750),
    *range(1000, 4001, 250),
)
TARGET_IOUS = (0.5, 0.6, 0.7, 0.8, 0.9)
SEEDS = {"tjunction": 2001, "roundabout": 2002}  # of the test recordings, as in docs/figures.md
NOISE_SEED = 0
PAGE = "index.html"
FIGURES = "reproduction.json"


def scheme_runs(sensors: int) -> list[SchemeRun]:
    """List the runs that table 1 needs."""
    return [SchemeRun(scheme, tuple(range(sensors))) for scheme in ("late", "hybrid", "early")]


def scheme_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 1: late, hybrid and early fusion of all sensors."""
    rows = []
    for run in scheme_runs(len(stored.sensors)):
        paper = comparison.SCHEME_TABLE[site][run.scheme]
        for iou, paper_ap in zip(IOUS, paper.ap, strict=True):
            rows.append(compare_run(stored, run, (run.scheme, f"AP@{iou:g}"), paper_ap, iou=iou))
        kbit = kbit_per_sensor(stored, run)
        reason = _explain_kbit(stored, run, paper.kbit)
        rows.append(
            Compared((run.scheme, "sent by a sensor"), "kbit", kbit, paper.kbit, reason=reason)
        )
        ms = ms_per_frame(stored, run)
        reason = "this machine; the paper's is a Quadro M4000"
        rows.append(Compared((run.scheme, "time"), "ms", ms, paper.ms, reason=reason))
    ap_rows = [row for row in rows if row.unit == "AP"]
    title = f"Fusion schemes, {PLACE_NAMES[site]}, all sensors, {stored.frames} frames"
    names = ["\n".join(row.labels) for row in ap_rows]
    return Experiment(
        "schemes",
        "Comparison of fusion schemes",
        "table 1, section IV-B",
        ("scheme", "figure"),
        tuple(rows),
        basis,
        _describe_order(ap_rows) + _describe_far_points(stored),
        partial(draw_pairs, names, ap_rows, title=title),
    )


def _describe_order(rows: Sequence[Compared]) -> str:
    """Describe whether the schemes have the paper's order at every IoU."""
    ours = {row.labels: row.ours or 0.0 for row in rows}
    for iou in IOUS:
        figure = f"AP@{iou:g}"
        if not ours["early", figure] >= ours["hybrid", figure] >= ours["late", figure]:
            return (
                "The paper's order, early over hybrid over late fusion, does not hold at every IoU "
                "here."
            )
    return (
        "As in the paper, early fusion is best at every IoU, then hybrid, then late, and costs "
        "follow the same order."
    )


def _describe_far_points(stored: StoredDetections) -> str:
    points = sum(int(truth.sent[0].sum()) for truth in stored.truths)
    if not points:
        return ""
    far_points = sum(int(truth.sent[1].sum()) for truth in stored.truths)
    return f" {100 * far_points / points:.0f} % of the points lie beyond the hybrid radius."


def _explain_kbit(stored: StoredDetections, run: SchemeRun, paper: float) -> str:
    if run.scheme == "late":
        boxes = kbit_per_sensor(stored, run) / 0.256
        return f"{boxes:.1f} boxes of 256 bit a sensor here, {paper / 0.256:.1f} in the paper"
    if run.scheme == "hybrid":
        messages = max(stored.frames, 1) * len(stored.sensors)
        far_points = sum(int(truth.sent[2].sum()) for truth in stored.truths)
        far_kbit = far_points / messages * 96 / 1000
        return (
            "the measure of the radius is not the cause: as the published code has it, points "
            f"make {far_kbit:.0f} kbit"
        )
    return ""


def set_experiment(table: Table, seen: StoredDetections, site: str) -> Experiment:
    """Compare table 2: all sensor sets, and the best three of each size.

    seen: detections whose points give the reasons."""
    paper_list = sensor_sets(site)
    origin = table.origin
    names = [set_name(row.sensors) for row in paper_list.rows]
    sensor_numbers = np.arange(len(origin.sensors))
    sets = np.array([np.isin(sensor_numbers, row.sensors) for row in paper_list.rows])
    rows: list[Compared] = []
    correlation_rows: list[Compared] = []
    words = []
    groups = {}
    for scheme in SET_SCHEMES:
        scores = TableFidelity(table, scheme)(sets)
        paper_aps = [getattr(row, scheme) for row in paper_list.rows]
        for k, row in enumerate(paper_list.rows):
            ap = float(scores.ap[k])
            evidence = RowEvidence(visible_share(seen, row.sensors), float(scores.recall[k]))
            reason = explain_difference(ap, paper_aps[k], evidence)
            is_best = row.sensors in paper_list.best[scheme]
            kind = "paper's best of its size" if is_best else "paper's list"
            labels = (kind, scheme, names[k])
            rows.append(Compared(labels, "AP", ap, paper_aps[k], reason=reason))
        correlation = rank_correlation(paper_aps, scores.ap)
        labels = (f"order of the {len(names)} sets listed", scheme, "all listed")
        correlation_rows.append(Compared(labels, "rank correlation", correlation, None))
        ranks = places_of_best(table, paper_list, scheme).values()
        words.append(
            f"{scheme} fusion: rank correlation {correlation:.3f} over {len(names)} sets; of the "
            f"paper's best sets of {len(ranks)} sizes {sum(rank == 1 for rank in ranks)} are the "
            f"best here and {sum(rank <= 3 for rank in ranks)} among the best three"
        )
        groups[scheme] = list(zip(names, paper_aps, scores.ap.tolist(), strict=True))
    for scheme in SET_SCHEMES:
        rows += _list_our_best(table, scheme, names)
    basis = (
        f"{origin.frames} frames, {origin.objects} vehicles, all {len(table.subsets) - 1} sets, "
        "exact table; it keeps no single frames, so there are no intervals (the PR curves have "
        "those of the best sets)"
    )
    title = f"Sensor sets of table 2, {PLACE_NAMES[site]}, {origin.frames} frames"
    return Experiment(
        "sensor_sets",
        "All sensor sets, and the best three of each size",
        "table 2, section IV-C",
        ("row", "scheme", "sensors"),
        (*rows, *correlation_rows),
        basis,
        "; ".join(words).capitalize() + ".",
        partial(draw_agreement, groups, title=title),
    )


def _list_our_best(table: Table, scheme: str, paper_names: Sequence[str]) -> list[Compared]:
    """List our best sets of each size, and whether they are in the paper's list."""
    rows = []
    for size, best in best_sets(table, scheme).items():
        for rank, sensor_set in enumerate(best, 1):
            name = set_name(sensor_set.sensors)
            list_note = ", in the paper's list" if name in paper_names else ""
            labels = (f"our best of {size}, number {rank}{list_note}", scheme, name)
            rows.append(Compared(labels, "AP", sensor_set.ap, None))
    return rows


def rank_correlation(a: ArrayLike, b: ArrayLike) -> float:
    """Return Spearman's rank correlation, NaN if one side is constant. Ties share their rank."""
    if np.ptp(np.asarray(a, np.float64)) == 0 or np.ptp(np.asarray(b, np.float64)) == 0:
        return float("nan")
    return float(spearmanr(a, b).statistic)


def places_of_best(table: Table, listed: comparison.Listed, scheme: str) -> dict[int, int]:
    """Return the rank of the paper's best set of each size in our order."""
    ours = best_sets(table, scheme, top=1 << len(table.origin.sensors))
    ranks = {}
    for sensors in listed.best[scheme]:
        size = len(sensors)
        our_order = [sensor_set.sensors for sensor_set in ours[size]]
        ranks[size] = our_order.index(sensors) + 1
    return ranks


def region_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 3: gain from spatial diversity."""
    rows = []
    names = []
    our_ap: dict[tuple[comparison.SensorSet, comparison.SensorSet], float] = {}
    paper_ap: dict[tuple[comparison.SensorSet, comparison.SensorSet], float] = {}
    for row in comparison.REGION_TABLE[site]:
        labels = (f"in view of {set_name(row.region)}, {{}} vehicles", set_name(row.sensors))
        run = SchemeRun("early", row.sensors)
        compared = compare_run(stored, run, labels, row.ap, region=row.region)
        rows.append(compared)
        names.append(f"{set_name(row.sensors)}\nin {set_name(row.region)}")
        our_ap[row.region, row.sensors] = compared.ours or 0.0
        paper_ap[row.region, row.sensors] = row.ap
    gain_texts = []
    gains = []
    for pair in dict.fromkeys(row.region for row in comparison.REGION_TABLE[site]):
        gain = _find_gain(our_ap, pair)
        gains.append(gain)
        gain_texts.append(
            f"{set_name(pair)} together {gain:+.3f} over the better of the two (paper "
            f"{_find_gain(paper_ap, pair):+.3f})"
        )
    gain_note = "Not every pair is better than the better of its two sensors."
    if all(gain > 0 for gain in gains):
        gain_note = "A second view of the same place helps at both pairs, as in the paper."
    title = f"Shared regions, {PLACE_NAMES[site]}, early fusion, IoU 0.7, {stored.frames} frames"
    return Experiment(
        "shared_regions",
        "Spatial diversity in shared regions",
        "table 3, section IV-D",
        ("region", "sensors"),
        tuple(rows),
        f"{basis}; vehicles whose centre both sensors of the pair have in their field of view",
        f"{gain_note} In AP, {'; '.join(gain_texts)}.",
        partial(draw_pairs, names, rows, title=title),
    )


def _find_gain(
    ap: Mapping[tuple[comparison.SensorSet, comparison.SensorSet], float],
    pair: comparison.SensorSet,
) -> float:
    """Return what a pair adds to the better of its two sensors. ap: by region and sensors."""
    return ap[pair, pair] - max(ap[pair, pair[:1]], ap[pair, pair[1:]])


def benchmark_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare table 4: the paper's figures, other methods', and ours for the same pair."""
    pair = comparison.BENCHMARK_PAIR[site]
    paper = {row.sensors: row.ap for row in comparison.REGION_TABLE[site] if row.region == pair}
    rows = []
    for method in comparison.BENCHMARK_TABLE:
        rows += [Compared((method.method, "one sensor"), "AP", None, ap) for ap in method.single]
        if method.two is not None:
            rows.append(Compared((method.method, "two sensors"), "AP", None, method.two))
    for sensors, count in ((pair[:1], "one sensor"), (pair, "two sensors")):
        labels = (f"ours, early fusion, {set_name(sensors)} in view of {set_name(pair)}", count)
        run = SchemeRun("early", sensors)
        rows.append(compare_run(stored, run, labels, paper[sensors], region=pair))
    gain = (rows[-1].ours or 0.0) - (rows[-2].ours or 0.0)
    paper_gain = paper[pair] - paper[pair[:1]]
    one_sensor = score_run(stored, SchemeRun("early", pair[:1]), region=pair[:1])
    labels = (f"ours, sensor {pair[0]}, vehicles in its field of view", "one sensor")
    rows.append(Compared(labels, "AP", one_sensor.ap, None, one_sensor.interval))
    title = f"Reported figures and ours, {PLACE_NAMES[site]}, {stored.frames} frames"
    names = [f"{row.labels[0].split(',')[0]}\n{row.labels[1]}" for row in rows]
    conclusion = (
        "Other data, other sensors: only the gain from a second sensor can be compared. "
        f"It is {gain:+.2f} here, {paper_gain:+.2f} in the paper and +0.53 for Cooper and F-Cooper."
    )
    if site != "tjunction":
        conclusion += " The paper's table 4 covers the T-junction alone."
    return Experiment(
        "benchmarks",
        "Comparison with existing benchmarks",
        "table 4, section IV-F",
        ("method", "sensors"),
        tuple(rows),
        f"{basis}; rows without ours are from other authors and data, as the paper reports them",
        conclusion,
        partial(draw_pairs, names, rows, title=title),
    )


def curve_runs(site: str) -> list[SchemeRun]:
    """List the runs that the figures need."""
    return [SchemeRun("early", sensors) for sensors in sensor_sets(site).best["early"]]


def _round_values(values: Sequence[float]) -> list[float]:
    return [round(value, 6) for value in values]


def curve_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare PR curves of early fusion at IoU 0.7."""
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
    for statement in comparison.CURVE_STATEMENTS[site]:
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
    """Select a curve's last point in each recall step."""
    number = np.floor(curve.recall / RECALL_STEP)
    return np.append(number[1:] != number[:-1], True)[: len(number)]


def density_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Compare point densities of the best sensor sets."""
    sets = sensor_sets(site).best["early"]
    stated = comparison.DENSITY_STATEMENTS[site]
    paper = {(str(statement.of), statement.sensors): statement for statement in stated}
    rows = []
    for figure_name, limit in (("no points", 1), (f"below {FEW_POINTS} points", FEW_POINTS)):
        for sensors in sets:
            counts = []  # vehicles of each frame with fewer points
            for truth in stored.truths:
                points = truth.points[:, list(sensors)].sum(axis=1)
                counts.append(int((points < limit).sum()))
            share = sum(counts) / stored.vehicles if stored.vehicles else float("nan")
            labels = (figure_name, set_name(sensors))
            interval = ratio_interval(counts, list(stored.to_find))
            row = Compared(labels, "share", share, None, interval)
            statement = paper.get((figure_name, sensors))
            if statement is not None:
                row = replace(row, paper=statement.value, relation=statement.relation)
            rows.append(row)
    for sensors in sets:
        median = float(np.median(stored.points(sensors))) if stored.vehicles else float("nan")
        rows.append(Compared(("median of the points", set_name(sensors)), "points", median, None))
    share_all = rows[0].ours
    share_one = rows[len(sets) - 1].ours
    points_by_set = {set_name(sensors): stored.points(sensors) for sensors in sets}
    names = tuple(points_by_set)
    shares: list[TableRow] = [("points, at most", *names)]
    for max_points in CURVE_POINTS:
        values = [_format_share(points <= max_points) for points in points_by_set.values()]
        shares.append((max_points, *values))
    conclusion = (
        f"{percent(share_one)} of the vehicles have no point from sensor {names[-1]} alone, "
        f"{percent(share_all)} none from all sensors."
    )
    if not stated:
        conclusion += f" The paper shows this for the {PLACE_NAMES['tjunction']} alone."
    return Experiment(
        "point_density",
        "Points on a vehicle with the best sets",
        "figure of point density (a), section IV-E",
        ("share of vehicles with", "sensors"),
        tuple(rows),
        basis,
        conclusion,
        partial(draw_density_cdf, points_by_set),
        (("point_density_curves", tuple(shares)),),
    )


def _format_share(is_counted: Bool[np.ndarray, " n"]) -> float | str:
    return round(float(is_counted.mean()), 6) if len(is_counted) else ""


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
        """Return the points from which the fit reaches an IoU, infinite if it never does."""
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
    """Average the IoU of vehicles with points in a half-open range, over the best sets."""
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
    """Return the point density and IoU of every vehicle, for each best set."""
    density = [np.zeros(0)]
    iou = [np.zeros(0)]
    for run in curve_runs(site):
        density.append(stored.points(run.sensors).astype(np.float64))
        iou += [frame_run.best for frame_run in stored.runs[run]]
    return np.concatenate(density), np.concatenate(iou)


def bin_iou(
    density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], bins: int = IOU_BINS
) -> BinnedIou:
    """Average IoU over bins of equal width from 0 to the maximum density."""
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
    """Fit IoU to log density by weighted least squares over the bins whose density is above 0."""
    is_used = bins.density > 0
    if is_used.sum() < 2:
        return LogFit(float("nan"), float("nan"))
    log_density = np.log(bins.density[is_used])
    weights = np.sqrt(bins.vehicles[is_used])
    slope, intercept = np.polyfit(log_density, bins.iou[is_used], 1, w=weights)
    return LogFit(float(intercept), float(slope))


def density_needed(
    density: Float64[np.ndarray, " n"], iou: Float64[np.ndarray, " n"], target_iou: float
) -> float | None:
    """Return the lowest density at which the mean IoU, made monotone, reaches a target.

    Returns None if it never does."""
    densities, group, counts = np.unique(density, return_inverse=True, return_counts=True)
    if not len(densities):
        return None
    rising = isotonic_regression(np.bincount(group, iou) / counts, weights=counts).x
    reaching = np.flatnonzero(rising >= target_iou - 1e-12)
    return float(densities[reaching[0]]) if len(reaching) else None


def all_runs(site: str, sensors: int) -> list[SchemeRun]:
    """List the runs that the experiments need."""
    region_runs = [SchemeRun("early", row.sensors) for row in comparison.REGION_TABLE[site]]
    return scheme_runs(sensors) + curve_runs(site) + region_runs


def all_experiments(
    stored: StoredDetections, seen: StoredDetections, table: Table, site: str
) -> tuple[Experiment, ...]:
    """Run every experiment, in the paper's order."""
    basis = f"{stored.frames} frames, {stored.vehicles} vehicles"
    return (
        scheme_experiment(stored, site, basis),
        set_experiment(table, seen, site),
        curve_experiment(stored, site, basis),
        region_experiment(stored, site, basis),
        density_experiment(stored, site, basis),
        iou_experiment(stored, site, basis),
        benchmark_experiment(stored, site, basis),
    )


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
        """Table of the AP differences from the paper."""
        large = f"beyond {LARGE_AP_DIFFERENCE:g}"
        table = [["experiment", "AP compared", large, "mean difference", "greatest"]]
        for experiment in self.experiments:
            rows = [row for row in experiment.rows if row.unit == "AP"]
            differences = [row.difference for row in rows if row.difference is not None]
            if differences:
                large_count = sum(abs(value) > LARGE_AP_DIFFERENCE for value in differences)
                mean = f"{sum(differences) / len(differences):+.4f}"
                greatest = f"{max(differences, key=abs):+.4f}"
                counts = [str(len(differences)), str(large_count)]
                table.append([experiment.name, *counts, mean, greatest])
        head = f"{self.site}: {self.frames} frames, {self.vehicles} vehicles"
        return f"{head}\n{align_columns(table, texts=1)}"

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        about = {"site": self.site, "frames": self.frames, "vehicles": self.vehicles}
        return about | {"experiments": [experiment.as_dict() for experiment in self.experiments]}


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

    frames: number of frames to evaluate; detector: function that makes one for the recording, None
    for the site's shipped network; table: file of `coview table` with the AP of all sensor sets,
    None for the shipped table, or for a new one if that was not measured at this site with this
    detector; recorded: number of frames of the recording, at least `frames`. Raises ValueError for
    a site that the paper has no figures for, and for arguments that do not fit."""
    check_paper_site(site)
    check_whole("frames", frames, least=1)
    check_whole("recorded", recorded, least=1)
    given_table = None if table is None else load_table(table)
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
        site_digest = hash_site(recording.site, recording.sensors)
        set_table = shipped if given_table is None else given_table
        if given_table is not None and given_table.origin.place != site_digest:
            raise ValueError(
                f"the table is of {given_table.origin.site!r} with other sensors: make one with "
                "coview table"
            )
        if given_table is not None and given_table.origin.detector != digest:
            raise ValueError(
                "the table was measured with another detector: make one with coview table"
            )
        renders = Recorded(recording, NOISE_SEED)
        memo = Cache(out / "detections.sqlite")
        detect_in = partial(detect_runs, renders, detect, memo=memo, processes=processes)
        stored = detect_in(all_runs(site, len(recording.sensors)), frames=frames)
        if (set_table.origin.place, set_table.origin.detector) != (site_digest, digest):
            path = out / f"table_{frames}_{str(digest)[:12]}_{renders.digest[:12]}.npz"
            try:
                set_table = load_table(path)
            except (ValueError, FileNotFoundError):  # damaged, or not made yet
                set_table = make_table(
                    renders, detect, path, frames=frames, seed=NOISE_SEED, processes=processes
                )
        table_frames = min(set_table.origin.frames, renders.frames)
        table_detections = detect_in((), frames=table_frames, stage="frames looked at")
    experiments = all_experiments(stored, table_detections, set_table, site)
    causes = CAUSES
    if detector is not None and stored.detector != shipped.origin.detector:
        causes = CAUSES | {"!": GIVEN_DETECTOR}
    conditions = _conditions(stored, set_table, site)
    write_experiments(out, experiments, site=site, conditions=conditions, causes=causes)
    return Reproduction(site, stored.frames, stored.vehicles, experiments, out / PAGE)


def check_paper_site(site: str) -> None:
    """Raise ValueError for a site that the paper has no figures for."""
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
        for experiment in experiments:
            experiment.draw(folder / f"{experiment.name}.svg")
            pictures[experiment.name] = (folder / f"{experiment.name}.svg").read_bytes()
            write_text(folder / f"{experiment.name}.csv", experiment.csv)
            for name, rows in experiment.curves:
                write_text(folder / f"{name}.csv", to_csv(rows))
        figures = {
            "site": site,
            "conditions": conditions,
            "experiments": [experiment.as_dict() for experiment in experiments],
        }
        text = json.dumps(replace_infinite(figures), indent=1, allow_nan=False)
        write_text(folder / FIGURES, text)
        title = (
            f"The paper's experiments at the {PLACE_NAMES[site]}, our figures beside the paper's"
        )
        page = paper_page(title, experiments, pictures, conditions=conditions, causes=causes)
        write_text(folder / PAGE, page)


def _conditions(stored: StoredDetections, table: Table, site: str) -> dict[str, str]:
    origin = table.origin
    return {
        "test recording": (
            f"{stored.frames} frames, seed {SEEDS[site]}, {stored.vehicles} vehicles (no heavy "
            f"ones) centred in the area; the paper's has {TEST_FRAMES} frames"
        ),
        "sensors": (
            f"{len(stored.sensors)}, exact poses; noise of {DEPTH_NOISE_M * 100:g} cm at every "
            "depth"
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
