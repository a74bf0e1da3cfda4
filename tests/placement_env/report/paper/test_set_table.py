import numpy as np
import pytest
from scipy.stats import spearmanr

from placement_env.fidelity.table import best_sets
from placement_env.report.paper.published import sensor_sets
from placement_env.report.paper.set_table import places_of_best, rank_correlation, set_experiment


@pytest.mark.parametrize("seed", range(5))
def test_rank_correlation_is_spearmans_with_ties(seed):
    a, b = np.random.default_rng(seed).integers(0, 6, (2, 20))
    assert rank_correlation(a, b) == pytest.approx(spearmanr(a, b).statistic)


def test_rank_correlation_of_a_constant_is_undefined():
    assert np.isnan(rank_correlation([1, 1, 1], [1, 2, 3]))


def test_rows(stored, exact_table, shares):
    made = set_experiment(exact_table, stored, "tjunction")
    listed = [row for row in made.rows if "paper" in row.labels[0] and "our best" not in row.labels[0]]
    assert len(listed) == 2 * 16
    assert [row.paper for row in listed[:2]] == [0.9870, 0.9441]
    of = {row.labels[1:]: row for row in listed}
    ap = 0.9 * shares[[0, 2, 5]].sum()
    assert of["early", "0,2,5"].ours == pytest.approx(ap)
    assert of["late", "0,2,5"].ours == pytest.approx(0.9 * ap)
    assert (of["late", "0,2,5"].paper, of["early", "0,2,5"].labels[0]) == (0.4039, "paper's best of its size")
    assert of["late", "0,2,5"].labels[0] == "paper's list"
    assert all(bool(row.reason) == row.large for row in listed)
    assert all(row.interval is None for row in made.rows)


def test_our_best_three_of_each_size(stored, exact_table):
    rows = [r for r in set_experiment(exact_table, stored, "tjunction").rows if r.labels[0].startswith("our best")]
    assert len(rows) == 2 * (1 + 3 * 5)
    assert rows[1].labels == ("our best of 5, number 1, in the paper's list", "early", "1,2,3,4,5")
    best = best_sets(exact_table, "early")
    assert [row.ours for row in rows[:16]] == [each.ap for size in best.values() for each in size]
    assert {row.paper for row in rows} == {None}
    assert {"in the paper's list" in row.labels[0] for row in rows} == {True, False}


def test_order_and_places(stored, exact_table):
    made, listed = set_experiment(exact_table, stored, "tjunction"), sensor_sets("tjunction")
    correlations = {row.labels[1]: row.ours for row in made.rows if row.unit == "rank correlation"}
    ours = [r.ours for r in made.rows if r.labels[0].startswith("paper") and r.labels[1] == "late"]
    assert correlations["late"] == pytest.approx(spearmanr([row.late for row in listed.rows], ours).statistic)
    places = places_of_best(exact_table, listed, "early")
    assert places == {6: 1, 5: 3, 4: 2, 3: 9, 2: 6, 1: 2}
    assert f"rank correlation {correlations['early']:.3f} over 16 sets" in made.conclusion
    assert "of the paper's best sets of 6 sizes 1 are the best here and 4 among the best three" in made.conclusion
    assert "12 frames, 50 vehicles, all 63 sets" in made.basis


def test_picture(stored, exact_table, tmp_path):
    set_experiment(exact_table, stored, "tjunction").draw(tmp_path / "sets.svg")
    assert (tmp_path / "sets.svg").stat().st_size > 5000
