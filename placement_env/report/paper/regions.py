"""Tables 3 and 4 of the paper: what spatial diversity gains where two sensors share their field of view, and how that
stands beside the figures of other methods.

A region is where both sensors of a pair have a vehicle's centre in their field of view, whatever stands in between.
"""

from __future__ import annotations

from pathlib import Path

from placement_env.report.paper.charts import draw_pairs
from placement_env.report.paper.comparison import Compared, Experiment
from placement_env.report.paper.published import (
    BENCHMARK_PAIR,
    BENCHMARK_TABLE,
    PLACE_NAMES,
    REGION_TABLE,
    TABLE_3,
    TABLE_4,
    RegionRow,
    set_name,
)
from placement_env.report.paper.reasons import RowEvidence, reason_of
from placement_env.report.paper.scoring import ApScore, score_run, visible_share
from placement_env.report.paper.stored import SchemeRun, StoredDetections


def region_runs(site: str) -> list[SchemeRun]:
    """What must be detected for both."""
    return [SchemeRun("early", row.sensors) for row in REGION_TABLE[site]]


def region_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Table 3, ours beside the paper's."""
    ours = {(row.region, row.sensors): _score(stored, row) for row in REGION_TABLE[site]}
    rows = []
    for row in REGION_TABLE[site]:
        score = ours[row.region, row.sensors]
        labels = (f"in view of {set_name(row.region)}, {score.vehicles} vehicles", set_name(row.sensors))
        evidence = RowEvidence(visible_share(stored, row.sensors, row.region), score.recall)
        reason = reason_of(score.ap, row.ap, evidence)
        rows.append(Compared(labels, "AP", score.ap, row.ap, score.interval, reason=reason))
    gains = []
    for pair in dict.fromkeys(row.region for row in REGION_TABLE[site]):
        paper = {row.sensors: row.ap for row in REGION_TABLE[site] if row.region == pair}
        mine = {sensors: score.ap for (region, sensors), score in ours.items() if region == pair}
        gains.append(
            f"{set_name(pair)} together {_gain(mine, pair)} over the better of the two (paper {_gain(paper, pair)})"
        )

    def draw(out: Path) -> None:
        names = [f"{set_name(row.sensors)}\nin {set_name(row.region)}" for row in REGION_TABLE[site]]
        draw_pairs(
            names, [row.ours for row in rows], [row.paper for row in rows], out,
            title=f"Shared regions, {PLACE_NAMES[site]}, early fusion, IoU 0.7, {stored.frames} frames",
            intervals=[row.interval for row in rows],
        )  # fmt: skip

    return Experiment(
        "shared_regions", "Spatial diversity in shared regions", f"{TABLE_3}, section IV-D", ("region", "sensors"),
        tuple(rows), f"{basis}; vehicles whose centre both sensors of the pair have in their field of view",
        f"{_pairs_help(ours)} In AP, " + "; ".join(gains) + ".", draw,
    )  # fmt: skip


def benchmark_experiment(stored: StoredDetections, site: str, basis: str) -> Experiment:
    """Table 4: the paper's figures of other methods, its own, and ours of the same pair."""
    pair = BENCHMARK_PAIR[site]
    paper = {row.sensors: row.ap for row in REGION_TABLE[site] if row.region == pair}
    rows = []
    for each in BENCHMARK_TABLE:
        rows += [Compared((each.method, "one sensor"), "AP", None, figure) for figure in each.single]
        if each.two is not None:
            rows.append(Compared((each.method, "two sensors"), "AP", None, each.two))
    mine, ours = [], []
    for sensors in (pair[:1], pair):
        score = _score(stored, RegionRow(pair, sensors, paper[sensors]))
        ours.append(score.ap)
        labels = (f"ours, early fusion, {set_name(sensors)} in view of {set_name(pair)}", _count(sensors))
        evidence = RowEvidence(visible_share(stored, sensors, pair), score.recall)
        reason = reason_of(score.ap, paper[sensors], evidence)
        mine.append(Compared(labels, "AP", score.ap, paper[sensors], score.interval, reason=reason))
    seen = score_run(stored, SchemeRun("early", pair[:1]), region=pair[:1])
    labels = (f"ours, sensor {pair[0]}, vehicles in its field of view", "one sensor")
    mine.append(Compared(labels, "AP", seen.ap, None, seen.interval))

    def draw(out: Path) -> None:
        shown = [*rows, *mine]
        names = [f"{row.labels[0].split(',')[0]}\n{row.labels[1]}" for row in shown]
        draw_pairs(
            names, [row.ours for row in shown], [row.paper for row in shown], out,
            title=f"Reported figures and ours, {PLACE_NAMES[site]}, {stored.frames} frames",
            intervals=[row.interval for row in shown],
        )  # fmt: skip

    return Experiment(
        "benchmarks", "Comparison with existing benchmarks", f"{TABLE_4}, section IV-F", ("method", "sensors"),
        (*rows, *mine), f"{basis}; rows without ours are of other authors and data, as the paper reports them",
        "Other data, other sensors: only the gain of a second sensor compares. "
        f"It is {ours[1] - ours[0]:+.2f} here, {paper[pair] - paper[pair[:1]]:+.2f} in the paper and +0.53 for "
        "Cooper and F-Cooper." + (" The paper's table 4 is of the T-junction alone." if site != "tjunction" else ""),
        draw,
    )  # fmt: skip


def _score(stored: StoredDetections, row: RegionRow) -> ApScore:
    return score_run(stored, SchemeRun("early", row.sensors), region=row.region)


def _gain(ap: dict[tuple[int, ...], float], pair: tuple[int, ...]) -> str:
    return f"{ap[pair] - max(ap[(each,)] for each in pair):+.3f}"


def _pairs_help(ours: dict[tuple[tuple[int, ...], tuple[int, ...]], ApScore]) -> str:
    """Whether every pair is better than either of its sensors."""
    better = [ap.ap > ours[pair, (each,)].ap for (pair, chosen), ap in ours.items() if chosen == pair for each in pair]
    if all(better):
        return "A second view of the same place helps at both pairs, as in the paper."
    return "Not every pair is better than the better of its two sensors."


def _count(sensors: tuple[int, ...]) -> str:
    return {1: "one sensor", 2: "two sensors"}[len(sensors)]
