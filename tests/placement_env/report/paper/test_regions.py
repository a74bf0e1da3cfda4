import pytest

from placement_env.report.paper.published import REGION_TABLE
from placement_env.report.paper.regions import benchmark_experiment, region_experiment, region_runs
from placement_env.report.paper.scoring import score_run
from placement_env.report.paper.stored import SchemeRun


@pytest.mark.parametrize("site", ["tjunction", "roundabout"])
def test_rows_of_table_3(site, stored, stored_roundabout):
    each = {"tjunction": stored, "roundabout": stored_roundabout}[site]
    made = region_experiment(each, site, "basis")
    assert len(made.rows) == 6
    for row, paper in zip(made.rows, REGION_TABLE[site], strict=True):
        ours = score_run(each, SchemeRun("early", paper.sensors), region=paper.region)
        assert row.labels[0].endswith(f"{','.join(map(str, paper.region))}, {ours.vehicles} vehicles")
        assert (row.ours, row.interval, row.paper) == (ours.ap, ours.interval, paper.ap)
        assert bool(row.reason) == row.large
    assert set(region_runs(site)) == {SchemeRun("early", row.sensors) for row in REGION_TABLE[site]}


def test_conclusion_has_the_gains(stored):
    made = region_experiment(stored, "tjunction", "")
    ap = [row.ours or 0.0 for row in made.rows]
    assert f"1,5 together {ap[2] - max(ap[:2]):+.3f} over the better of the two (paper +0.400)" in made.conclusion
    assert f"2,4 together {ap[5] - max(ap[3:5]):+.3f} over the better of the two (paper +0.162)" in made.conclusion
    helps = ap[2] > max(ap[:2]) and ap[5] > max(ap[3:5])
    assert made.conclusion.startswith("A second view" if helps else "Not every pair")


def test_rows_of_table_4(stored):
    made = benchmark_experiment(stored, "tjunction", "")
    theirs = [row for row in made.rows if row.ours is None]
    assert [row.paper for row in theirs] == [0.8197, 0.6546, 0.6285, 0.1960, 0.7237, 0.1960, 0.7237, 0.4717, 0.8722]
    one, two, seen = [row for row in made.rows if row.ours is not None]
    regions = region_experiment(stored, "tjunction", "").rows
    assert (one.ours, one.paper, two.ours, two.paper) == (regions[0].ours, 0.4717, regions[2].ours, 0.8722)
    assert (one.labels[1], two.labels[1]) == ("one sensor", "two sensors")
    assert seen.ours == score_run(stored, SchemeRun("early", (1,)), region=(1,)).ap
    assert seen.paper is None
    assert f"{(two.ours or 0.0) - (one.ours or 0.0):+.2f} here, +0.40 in the paper" in made.conclusion
    assert "T-junction alone" not in made.conclusion


def test_table_4_of_the_roundabout_is_said_not_to_be_the_papers(stored_roundabout, tmp_path):
    made = benchmark_experiment(stored_roundabout, "roundabout", "")
    assert made.conclusion.endswith("The paper's table 4 is of the T-junction alone.")
    assert [row.paper for row in made.rows if row.ours is not None] == [0.1474, 0.8925, None]
    made.draw(tmp_path / "benchmarks.svg")
    region_experiment(stored_roundabout, "roundabout", "").draw(tmp_path / "regions.svg")
    assert all(path.stat().st_size > 5000 for path in tmp_path.iterdir())
