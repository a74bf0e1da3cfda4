"""Tables 1 to 4, our figures beside the paper's."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from examples.studies.paper import reproduction
from examples.studies.paper.detections import SchemeRun, kbit_per_sensor, ms_per_frame, score_run
from examples.studies.paper.paper_tables import REGION_TABLE, SCHEME_TABLE, sensor_sets
from examples.studies.paper.region_tables import benchmark_experiment, region_experiment
from examples.studies.paper.scheme_table import scheme_experiment, scheme_runs
from examples.studies.paper.set_table import places_of_best, rank_correlation, set_experiment
from placement_env.fidelity.table import best_sets


def test_table_1_has_its_rows(stored):
    made = scheme_experiment(stored, "tjunction", "12 frames")
    by_labels = {row.labels: row for row in made.rows}
    assert len(made.rows) == len(by_labels) == 15
    for run in scheme_runs(6):
        paper = SCHEME_TABLE["tjunction"][run.scheme]
        for iou, theirs in zip((0.7, 0.8, 0.9), paper.ap, strict=True):
            row, ours = by_labels[run.scheme, f"AP@{iou:g}"], score_run(stored, run, iou)
            assert (row.ours, row.interval, row.paper) == (ours.ap, ours.interval, theirs)
            assert bool(row.reason) == row.large
        assert by_labels[run.scheme, "sent by a sensor"].ours == kbit_per_sensor(stored, run)
        assert by_labels[run.scheme, "sent by a sensor"].paper == paper.kbit
        assert by_labels[run.scheme, "time"].ours == ms_per_frame(stored, run)
        assert by_labels[run.scheme, "time"].unit == "ms"
    assert made.basis == "12 frames"


def test_table_1_explains_what_is_sent(stored):
    rows = {row.labels: row.reason for row in scheme_experiment(stored, "tjunction", "").rows}
    far = sum(truth.sent[2].sum() for truth in stored.truths) / stored.frames / 6 * 0.096
    kbit = kbit_per_sensor(stored, scheme_runs(6)[0])
    assert (
        rows["late", "sent by a sensor"]
        == f"{kbit / 0.256:.1f} boxes of 256 bit a sensor here, 2.0 in the paper"
    )
    assert rows["hybrid", "sent by a sensor"].endswith(f"points make {far:.0f} kbit")
    assert rows["early", "sent by a sensor"] == ""


def test_conclusion_says_whether_the_order_holds(stored, stored_roundabout):
    each = {"tjunction": stored, "roundabout": stored_roundabout}
    said = {site: scheme_experiment(each[site], site, "") for site in each}
    for made in said.values():
        ap = {row.labels: row.ours or 0.0 for row in made.rows if row.unit == "AP"}
        ordered = all(
            ap["early", at] >= ap["hybrid", at] >= ap["late", at]
            for at in ("AP@0.7", "AP@0.8", "AP@0.9")
        )
        assert made.conclusion.startswith(
            "As in the paper, early" if ordered else "The paper's order"
        )
    share = sum(t.sent[1].sum() for t in stored.truths) / sum(
        t.sent[0].sum() for t in stored.truths
    )
    assert said["tjunction"].conclusion.endswith(
        f"{100 * share:.0f} % of the points lie beyond the hybrid radius."
    )


def test_rank_correlation_shares_ranks_and_is_undefined_for_a_constant():
    assert rank_correlation([1, 1, 2, 3], [1, 2, 3, 4]) == pytest.approx(0.949, abs=1e-3)
    assert np.isnan(rank_correlation([1, 1, 1], [1, 2, 3]))


def test_rows_of_table_2(stored, exact_table, shares):
    made = set_experiment(exact_table, stored, "tjunction")
    listed = [
        row for row in made.rows if "paper" in row.labels[0] and "our best" not in row.labels[0]
    ]
    assert len(listed) == 2 * 16
    assert [row.paper for row in listed[:2]] == [0.9870, 0.9441]
    of = {row.labels[1:]: row for row in listed}
    ap = 0.9 * shares[[0, 2, 5]].sum()
    assert of["early", "0,2,5"].ours == pytest.approx(ap)
    assert of["late", "0,2,5"].ours == pytest.approx(0.9 * ap)
    assert (of["late", "0,2,5"].paper, of["early", "0,2,5"].labels[0]) == (
        0.4039,
        "paper's best of its size",
    )
    assert of["late", "0,2,5"].labels[0] == "paper's list"
    assert all(bool(row.reason) == row.large for row in listed)
    assert all(row.interval is None for row in made.rows)


def test_table_2_has_our_best_three_in_order(stored, exact_table):
    rows = [
        r
        for r in set_experiment(exact_table, stored, "tjunction").rows
        if r.labels[0].startswith("our best")
    ]
    assert len(rows) == 2 * (1 + 3 * 5)
    assert rows[1].labels == ("our best of 5, number 1, in the paper's list", "early", "1,2,3,4,5")
    best = best_sets(exact_table, "early")
    assert [row.ours for row in rows[:16]] == [each.ap for size in best.values() for each in size]
    assert {row.paper for row in rows} == {None}
    assert {"in the paper's list" in row.labels[0] for row in rows} == {True, False}


def test_table_2_compares_the_ranks_of_sets(stored, exact_table):
    made, listed = (set_experiment(exact_table, stored, "tjunction"), sensor_sets("tjunction"))
    correlations = {row.labels[1]: row.ours for row in made.rows if row.unit == "rank correlation"}
    ours = [r.ours for r in made.rows if r.labels[0].startswith("paper") and r.labels[1] == "late"]
    assert correlations["late"] == pytest.approx(
        spearmanr([row.late for row in listed.rows], ours).statistic
    )
    assert places_of_best(exact_table, listed, "early") == {6: 1, 5: 3, 4: 2, 3: 9, 2: 6, 1: 2}
    assert f"rank correlation {correlations['early']:.3f} over 16 sets" in made.conclusion
    assert (
        "of the paper's best sets of 6 sizes 1 are the best here and 4 among the best three"
        in made.conclusion
    )
    assert "12 frames, 50 vehicles, all 63 sets" in made.basis


def test_pictures(stored, exact_table, tmp_path):
    scheme_experiment(stored, "tjunction", "").draw(tmp_path / "schemes.svg")
    assert (tmp_path / "schemes.svg").read_text().count("<path") > 20
    set_experiment(exact_table, stored, "tjunction").draw(tmp_path / "sets.svg")
    assert (tmp_path / "sets.svg").stat().st_size > 5000


@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_rows_of_table_3(site, stored, stored_roundabout):
    each = {"tjunction": stored, "roundabout": stored_roundabout}[site]
    made = region_experiment(each, site, "basis")
    assert len(made.rows) == 6
    for row, paper in zip(made.rows, REGION_TABLE[site], strict=True):
        ours = score_run(each, SchemeRun("early", paper.sensors), region=paper.region)
        assert row.labels[0].endswith(
            f"{','.join(map(str, paper.region))}, {ours.vehicles} vehicles"
        )
        assert (row.ours, row.interval, row.paper) == (ours.ap, ours.interval, paper.ap)
        assert bool(row.reason) == row.large
    runs = reproduction.all_runs(site, len(each.sensors))
    assert set(runs) >= {SchemeRun("early", row.sensors) for row in REGION_TABLE[site]}


def test_table_4_concludes_what_a_second_view_gains(stored):
    made = region_experiment(stored, "tjunction", "")
    ap = [row.ours or 0.0 for row in made.rows]
    assert (
        f"1,5 together {ap[2] - max(ap[:2]):+.3f} over the better of the two (paper +0.400)"
        in made.conclusion
    )
    assert (
        f"2,4 together {ap[5] - max(ap[3:5]):+.3f} over the better of the two (paper +0.162)"
        in made.conclusion
    )
    helps = ap[2] > max(ap[:2]) and ap[5] > max(ap[3:5])
    assert made.conclusion.startswith("A second view" if helps else "Not every pair")


def test_benchmarks_have_the_papers_figures_and_ours(stored):
    made = benchmark_experiment(stored, "tjunction", "")
    theirs = [row for row in made.rows if row.ours is None]
    assert [row.paper for row in theirs] == [
        0.8197,
        0.6546,
        0.6285,
        0.1960,
        0.7237,
        0.1960,
        0.7237,
        0.4717,
        0.8722,
    ]
    one, two, seen = [row for row in made.rows if row.ours is not None]
    regions = region_experiment(stored, "tjunction", "").rows
    assert (one.ours, one.paper, two.ours, two.paper) == (
        regions[0].ours,
        0.4717,
        regions[2].ours,
        0.8722,
    )
    assert (one.labels[1], two.labels[1]) == ("one sensor", "two sensors")
    assert seen.ours == score_run(stored, SchemeRun("early", (1,)), region=(1,)).ap
    assert seen.paper is None
    assert (
        f"{(two.ours or 0.0) - (one.ours or 0.0):+.2f} here, +0.40 in the paper" in made.conclusion
    )
    assert "T-junction alone" not in made.conclusion


def test_conclusion_says_that_table_4_lacks_the_roundabout(stored_roundabout, tmp_path):
    made = benchmark_experiment(stored_roundabout, "roundabout", "")
    assert made.conclusion.endswith("The paper's table 4 covers the T-junction alone.")
    assert [row.paper for row in made.rows if row.ours is not None] == [0.1474, 0.8925, None]
    made.draw(tmp_path / "benchmarks.svg")
    region_experiment(stored_roundabout, "roundabout", "").draw(tmp_path / "regions.svg")
    assert all(path.stat().st_size > 5000 for path in tmp_path.iterdir())
