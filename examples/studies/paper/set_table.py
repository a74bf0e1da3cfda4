"""Table 2: all sensor sets, and the best three of each size.

The table is compared with an exact table of every sensor set (`placement_env.fidelity.table`)."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import spearmanr

from examples.studies.paper.charts import draw_agreement
from examples.studies.paper.comparison import Compared, Experiment, RowEvidence, explain_difference
from examples.studies.paper.detections import StoredDetections, visible_share
from examples.studies.paper.paper_rows import Listed, set_name
from examples.studies.paper.paper_tables import PLACE_NAMES, sensor_sets
from placement_env.fidelity.table import Table, TableFidelity, best_sets

SET_SCHEMES = ("early", "late")


def set_experiment(table: Table, seen: StoredDetections, site: str) -> Experiment:
    """Compare table 2: all sensor sets, and the best three of each size.

    table: our AP of every sensor set; seen: stored frames whose points on vehicles give reasons for
    differences; site: one of the paper's sites."""
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
    """List our best sets of each size, with a note on those in the paper's list.

    paper_names: names of the sets that the paper lists."""
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


def places_of_best(table: Table, listed: Listed, scheme: str) -> dict[int, int]:
    """Return the rank, from 1, of the paper's best set of each size among all our sets.

    scheme: "early" or "late"."""
    ours = best_sets(table, scheme, top=1 << len(table.origin.sensors))
    ranks = {}
    for sensors in listed.best[scheme]:
        size = len(sensors)
        our_order = [sensor_set.sensors for sensor_set in ours[size]]
        ranks[size] = our_order.index(sensors) + 1
    return ranks
