"""Our exact tables beside the paper's table of sensor sets: AP at IoU 0.7 of each set it lists, rank correlation with
its figures, and whether the best sets of each size agree.

python tests/benchmarks/placement_env/compare_with_paper.py [tjunction roundabout | TABLE.npz ...]
"""

import sys

import numpy as np
from scipy.stats import spearmanr

from placement_env.fidelity.table import Table, TableFidelity, best_sets, load_table

WANTED = {"early": 0.95, "late": 0.90}

# The paper's table "Detection performance for various sensor combinations": sensors, AP early, AP late.
PAPER = {
    "tjunction": """
        012345 0.9870 0.8181
        01345 0.9441 0.7611   01235 0.9348 0.6672   12345 0.9327 0.7914
        1345 0.8653 0.7336    0125 0.8596 0.4765    0134 0.8394 0.6827
        025 0.7123 0.4039     235 0.6938 0.5834     345 0.6837 0.6656
        34 0.5365 0.5361      23 0.4591 0.4530      25 0.4453 0.3309
        4 0.2862 0.2862       3 0.2512 0.2512       2 0.2013 0.2013
    """,
    "roundabout": """
        01234567 0.9670 0.8143
        0123567 0.9385 0.7904   1234567 0.9340 0.7868   0134567 0.9307 0.7834
        123567 0.9050 0.7627    123457 0.9017 0.7627    012357 0.8973 0.7664
        12357 0.8678 0.7385     13567 0.8610 0.7314     13457 0.8576 0.7313
        1357 0.8231 0.7069      1237 0.7356 0.6557      1347 0.7263 0.6482
        137 0.6892 0.6230       357 0.6713 0.5831       135 0.6382 0.5861
        37 0.5016 0.4594        13 0.4995 0.4998        57 0.4664 0.4638
        3 0.2811 0.2811         5 0.2596 0.2596         1 0.2151 0.2151
    """,
}


def paper_rows(site: str) -> list[tuple[tuple[int, ...], float, float]]:
    """Sensors, AP early and AP late of each set the paper lists, in its order."""
    words = PAPER[site].split()
    sets = [tuple(map(int, word)) for word in words[::3]]
    return list(zip(sets, map(float, words[1::3]), map(float, words[2::3]), strict=True))


def compare(table: Table) -> None:
    """Print the sets, the correlations, and the best sets of each size."""
    rows, sensors = paper_rows(table.origin.site), len(table.origin.sensors)
    subsets = np.array([[c in chosen for c in range(sensors)] for chosen, _, _ in rows])
    ours = {scheme: TableFidelity(table, scheme)(subsets).ap for scheme in WANTED}
    print(f"\n{table.origin.site}: {table.origin.frames} frames, {table.origin.objects} vehicles, AP at IoU 0.7")
    print(f"{'sensors':18}{'early: paper':>14}{'ours':>8}{'late: paper':>14}{'ours':>8}")
    for (chosen, early, late), mine_early, mine_late in zip(rows, ours["early"], ours["late"], strict=True):
        print(f"{_named(chosen):18}{early:14.4f}{mine_early:8.4f}{late:14.4f}{mine_late:8.4f}")
    for column, (scheme, wanted) in enumerate(WANTED.items(), 1):
        rank = spearmanr([row[column] for row in rows], ours[scheme]).statistic
        print(f"{scheme}: Spearman {rank:.3f} over {len(rows)} sets, at least {wanted:.2f} wanted")
        best_of_paper(table, scheme, column)


def best_of_paper(table: Table, scheme: str, column: int) -> None:
    """Print per size the best set of the paper's list and ours of all, and where the paper's stands among ours."""
    best, rows = best_sets(table, scheme, top=1 << len(table.origin.sensors)), paper_rows(table.origin.site)
    agree = 0
    for size, sets in best.items():
        theirs = max((row for row in rows if len(row[0]) == size), key=lambda row: row[column])[0]
        place = [each.sensors for each in sets].index(theirs) + 1
        agree += place == 1
        print(f"  best of {size}: paper {_named(theirs):16} ours {_named(sets[0].sensors):16} "
              f"the paper's is number {place} of {len(sets)} here")  # fmt: skip
    print(f"  {agree} of {len(best)} best sets agree")


def _named(sensors: tuple[int, ...]) -> str:
    return ",".join(map(str, sensors))


def main() -> None:
    """Compare the tables named, or all shipped ones."""
    for name in sys.argv[1:] or PAPER:
        compare(load_table(name))


if __name__ == "__main__":
    main()
