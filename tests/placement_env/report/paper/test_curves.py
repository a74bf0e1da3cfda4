import numpy as np
import pytest

from placement_env.report.paper.curves import curve_experiment, curve_runs, greatest_recall, precision_from, steps
from placement_env.report.paper.scoring import pr_curve, score_run, visible_share
from toolkit.detection.metrics import Curve

CURVE = Curve(np.array([1.0, 0.9, 0.95]), np.array([0.2, 0.5, 0.96]), np.array([0.9, 0.5, 0.1]))
NOTHING = Curve(np.zeros(0), np.zeros(0), np.zeros(0))


def test_precision_and_recall():
    assert (greatest_recall(CURVE), greatest_recall(NOTHING)) == (0.96, 0.0)
    assert [precision_from(CURVE, at) for at in (0.0, 0.5, 0.95, 0.97)] == [1.0, 0.95, 0.95, 0.0]


def test_points_that_are_written_down():
    curve = Curve(np.ones(4), np.array([0.0001, 0.0002, 0.5, 0.5002]), np.ones(4))
    assert steps(curve).tolist() == [False, True, False, True]
    assert steps(NOTHING).tolist() == []


def test_rows(stored):
    made = curve_experiment(stored, "tjunction", "12 frames")
    rows = {row.labels: row for row in made.rows}
    for run, paper in zip(curve_runs("tjunction"), (0.9870, 0.9441, 0.8653, 0.7123, 0.5365, 0.2862), strict=True):
        row, ours = rows["AP@0.7", ",".join(map(str, run.sensors))], score_run(stored, run)
        assert (row.ours, row.interval, row.paper) == (ours.ap, ours.interval, paper)
        assert bool(row.reason) == row.large
    one = rows["greatest recall", "4"]
    assert one.ours == pytest.approx(score_run(stored, curve_runs("tjunction")[-1]).recall)
    assert (one.paper, one.relation) == (0.30, "is")
    everyone = rows["precision at recall 0.95", "0,1,2,3,4,5"]
    assert (everyone.relation, everyone.paper) == ("more than", 0.95)
    assert everyone.ours == precision_from(pr_curve(stored, curve_runs("tjunction")[0]), 0.95)
    assert visible_share(stored, (4,)) > 0.3
    assert one.reason == ""


def test_curves_are_written(stored):
    ((name, rows),) = curve_experiment(stored, "tjunction", "").curves
    assert name == "pr_curves_points"
    assert rows[0] == ("sensors", "score", "precision", "recall")
    curve = pr_curve(stored, curve_runs("tjunction")[-1])
    last = [row[1:] for row in rows if row[0] == "4"][-1]
    assert last == pytest.approx((curve.score[-1], curve.precision[-1], curve.recall[-1]), abs=1e-6)


def test_picture_of_the_roundabout(stored_roundabout, tmp_path):
    curve_experiment(stored_roundabout, "roundabout", "").draw(tmp_path / "curves.svg")
    assert (tmp_path / "curves.svg").stat().st_size > 5000
