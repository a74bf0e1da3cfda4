"""Table 2 of the paper: the AP of all sensor sets, the best three of each size, with early and late fusion.

Ours comes from an exact table (`placement_env.fidelity.table`): the shipped one, where it was measured at this site
with this detector, or one made anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from placement_env.fidelity.table import Table, TableFidelity, best_sets
from placement_env.report.paper.charts import draw_agreement
from placement_env.report.paper.comparison import Compared, Experiment
from placement_env.report.paper.published import (
    PLACE_NAMES,
    TABLE_2,
    Listed,
    SensorSet,
    SetRow,
    sensor_sets,
    set_name,
)
from placement_env.report.paper.reasons import RowEvidence, reason_of
from placement_env.report.paper.scoring import visible_share
from placement_env.report.paper.stored import StoredDetections
from toolkit.arrays import Float64

SET_SCHEMES = ("early", "late")


def set_experiment(table: Table, seen: StoredDetections, site: str) -> Experiment:
    """Ours beside the paper's. seen: the table's frames, of whose points the reasons speak; no run is needed."""
    listed, origin = sensor_sets(site), table.origin
    rows = [row for scheme in SET_SCHEMES for row in _listed_rows(table, seen, listed, scheme)]
    paper = {row.sensors for row in listed.rows}
    for scheme in SET_SCHEMES:
        for size, best in best_sets(table, scheme).items():
            for rank, each in enumerate(best, 1):
                known = ", in the paper's list" if each.sensors in paper else ""
                labels = (f"our best of {size}, number {rank}{known}", scheme, set_name(each.sensors))
                rows.append(Compared(labels, "AP", each.ap, None))
    correlations = {scheme: _correlation(table, listed, scheme) for scheme in SET_SCHEMES}
    for scheme, value in correlations.items():
        labels = (f"order of the {len(listed.rows)} sets listed", scheme, "all listed")
        rows.append(Compared(labels, "rank correlation", value, None))
    basis = (
        f"{origin.frames} frames, {origin.objects} vehicles, all {len(table.subsets) - 1} sets, exact table; it keeps "
        "no single frames, so there are no intervals (the PR curves have those of the best sets)"
    )

    def draw(out: Path) -> None:
        groups = {
            s: [(set_name(r.sensors), _figure(r, s), _ap(table, s, r.sensors)) for r in listed.rows]
            for s in SET_SCHEMES
        }
        draw_agreement(groups, out, title=f"Sensor sets of table 2, {PLACE_NAMES[site]}, {origin.frames} frames")

    return Experiment(
        "sensor_sets", "All sensor sets, and the best three of each size", f"{TABLE_2}, section IV-C",
        ("row", "scheme", "sensors"), tuple(rows), basis, _conclusion(table, listed, correlations), draw,
    )  # fmt: skip


def rank_correlation(a: ArrayLike, b: ArrayLike) -> float:
    """Spearman's: the correlation of the ranks, equal values sharing theirs; NaN where one side is constant.

    >>> round(rank_correlation([1, 2, 3, 4], [10, 30, 20, 40]), 3)
    0.8
    """
    ranks = _ranks(np.asarray(a, np.float64)), _ranks(np.asarray(b, np.float64))
    if any(np.ptp(each) == 0 for each in ranks):
        return float("nan")
    return float(np.corrcoef(*ranks)[0, 1])


def places_of_best(table: Table, listed: Listed, scheme: str) -> dict[int, int]:
    """For each number of sensors the place, among all our sets of that size, of the paper's best."""
    ours = best_sets(table, scheme, top=1 << len(table.origin.sensors))
    best = {"early": listed.best_early, "late": listed.best_late}[scheme]
    return {len(each): [mine.sensors for mine in ours[len(each)]].index(each) + 1 for each in best}


def _listed_rows(table: Table, seen: StoredDetections, listed: Listed, scheme: str) -> list[Compared]:
    bold = {"early": listed.best_early, "late": listed.best_late}[scheme]
    rows = []
    for row in listed.rows:
        ours, recall, paper = _ap(table, scheme, row.sensors), _recall(table, scheme, row.sensors), _figure(row, scheme)
        reason = reason_of(ours, paper, RowEvidence(visible_share(seen, row.sensors), recall))
        kind = "paper's best of its size" if row.sensors in bold else "paper's list"
        rows.append(Compared((kind, scheme, set_name(row.sensors)), "AP", ours, paper, reason=reason))
    return rows


def _conclusion(table: Table, listed: Listed, correlations: dict[str, float]) -> str:
    words = []
    for scheme in SET_SCHEMES:
        places = places_of_best(table, listed, scheme)
        agree = sum(place == 1 for place in places.values())
        three = sum(place <= 3 for place in places.values())
        words.append(
            f"{scheme} fusion: rank correlation {correlations[scheme]:.3f} over {len(listed.rows)} sets; of the "
            f"paper's best sets of {len(places)} sizes {agree} are the best here and {three} among the best three"
        )
    return "; ".join(words).capitalize() + "."


def _correlation(table: Table, listed: Listed, scheme: str) -> float:
    ours = [_ap(table, scheme, row.sensors) for row in listed.rows]
    return rank_correlation([_figure(row, scheme) for row in listed.rows], ours)


def _figure(row: SetRow, scheme: str) -> float:
    return {"early": row.early, "late": row.late}[scheme]


def _ap(table: Table, scheme: str, sensors: SensorSet) -> float:
    return float(TableFidelity(table, scheme)(_row(table, sensors)).ap[0])


def _recall(table: Table, scheme: str, sensors: SensorSet) -> float:
    return float(TableFidelity(table, scheme)(_row(table, sensors)).recall[0])


def _row(table: Table, sensors: Sequence[int]) -> np.ndarray:
    return np.isin(np.arange(len(table.origin.sensors)), sensors)[None]


def _ranks(values: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    _, of, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts).astype(np.float64)
    return (last - (counts - 1) / 2)[of]
