"""Our exact tables beside the paper's table of sensor sets: AP at IoU 0.7 of each set it lists,
rank correlation with its figures, and where the paper's best sets stand among all of ours. `coview
reproduce` puts them on a page.

python tests/benchmarks/placement_env/compare_with_paper.py [tjunction roundabout | TABLE.npz ...]
"""

import sys

import numpy as np

from examples.studies.paper.paper_rows import set_name
from examples.studies.paper.paper_tables import PAPER_SITES, sensor_sets
from examples.studies.paper.set_table import rank_correlation
from placement_env.fidelity.table import Table, TableFidelity, best_sets, load_table
from tests.benchmarks.figures import record

WANTED = {"early": 0.95, "late": 0.90}


def compare(table: Table) -> None:
    """Print the sets, the correlations, and the best sets of each size."""
    rows, sensors = sensor_sets(table.origin.site).rows, len(table.origin.sensors)
    subsets = np.array([[c in chosen for c in range(sensors)] for chosen, _, _ in rows])
    ours = {scheme: TableFidelity(table, scheme)(subsets).ap for scheme in WANTED}
    print(
        f"\n{table.origin.site}: {table.origin.frames} frames, {table.origin.objects} objects, AP "
        "at IoU 0.7"
    )
    print(f"{'sensors':18}{'early: paper':>14}{'ours':>8}{'late: paper':>14}{'ours':>8}")
    for (chosen, early, late), mine_early, mine_late in zip(
        rows, ours["early"], ours["late"], strict=True
    ):
        print(f"{set_name(chosen):18}{early:14.4f}{mine_early:8.4f}{late:14.4f}{mine_late:8.4f}")
    ranks: list[str] = []
    agreements: list[str] = []
    for column, (scheme, wanted) in enumerate(WANTED.items(), 1):
        rank = rank_correlation([row[column] for row in rows], ours[scheme])
        print(f"{scheme}: Spearman {rank:.3f} over {len(rows)} sets, at least {wanted:.2f} wanted")
        ranks.append(f"{rank:.3f}")
        agreements.append(best_of_paper(table, scheme, column))
    page_name = {"tjunction": "T-junction"}.get(table.origin.site, table.origin.site)
    record("paper-ranks", page_name, [f"{len(rows)}", *ranks, *agreements], "`site`")


def best_of_paper(table: Table, scheme: str, column: int) -> str:
    """Print the best set of the paper's list and of all ours by size; return how many agree."""
    best, rows = (
        best_sets(table, scheme, top=1 << len(table.origin.sensors)),
        sensor_sets(table.origin.site).rows,
    )
    same: list[str] = []
    for size, sets in best.items():
        theirs = max((row for row in rows if len(row[0]) == size), key=lambda row: row[column])[0]
        place = [each.sensors for each in sets].index(theirs) + 1
        if place == 1:
            same.append(set_name(theirs))
        print(
            f"  best of {size}: paper {set_name(theirs):16} ours {set_name(sets[0].sensors):16} "
            f"the paper's is number {place} of {len(sets)} here"
        )
    print(f"  {len(same)} of {len(best)} best sets agree")
    return f"{len(same)} of {len(best)} ({'; '.join(same)})"


if __name__ == "__main__":
    for name in sys.argv[1:] or PAPER_SITES:
        compare(load_table(name))
