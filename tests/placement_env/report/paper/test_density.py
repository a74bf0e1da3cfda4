import numpy as np
import pytest

from placement_env.analysis.intervals import ratio_interval
from placement_env.report.paper.density import density_experiment


def test_rows(stored):
    rows = {row.labels: row for row in density_experiment(stored, "tjunction", "").rows}
    points = np.concatenate([truth.points for truth in stored.truths])
    none = [(truth.points[:, [3, 4]].sum(axis=1) == 0).sum() for truth in stored.truths]
    row = rows["no points", "3,4"]
    assert row.ours == pytest.approx((points[:, [3, 4]].sum(axis=1) == 0).mean())
    assert (row.paper, row.relation, row.interval) == (0.30, "more than", ratio_interval(none, list(stored.to_find)))
    few = rows["below 300 points", "0,2,5"]
    assert few.ours == pytest.approx((points[:, [0, 2, 5]].sum(axis=1) < 300).mean())
    assert (few.paper, few.relation) == (0.90, "is")
    assert rows["no points", "4"].paper == 0.60
    assert rows["no points", "0,2,5"].paper == 0.0
    assert rows["no points", "1,3,4,5"].paper is None
    assert rows["median of the points", "4"].ours == np.median(points[:, 4])
    assert len(rows) == 18


def test_curves_are_cumulative_shares(stored):
    ((_, rows),) = density_experiment(stored, "tjunction", "").curves
    assert rows[0] == ("points, at most", "0,1,2,3,4,5", "0,1,3,4,5", "1,3,4,5", "0,2,5", "3,4", "4")
    table = np.array(rows[1:], float)
    points = np.concatenate([truth.points for truth in stored.truths])
    assert table[0, 0] == 0
    assert table[0, 6] == pytest.approx((points[:, 4] == 0).mean(), abs=1e-6)
    at_100 = table[table[:, 0] == 100][0]
    assert at_100[5] == pytest.approx((points[:, [3, 4]].sum(axis=1) <= 100).mean(), abs=1e-6)
    assert (np.diff(table, axis=0) >= 0).all()
    assert (table[-1, 1:] == 1).all()


def test_the_roundabout_has_no_figures_of_the_paper(stored_roundabout, tmp_path):
    made = density_experiment(stored_roundabout, "roundabout", "")
    assert {row.paper for row in made.rows} == {None}
    assert made.conclusion.endswith("The paper shows this for the T-junction alone.")
    made.draw(tmp_path / "density.svg")
    assert (tmp_path / "density.svg").stat().st_size > 5000
