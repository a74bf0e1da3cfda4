import pytest

from placement_env.report.paper.published import SCHEME_TABLE
from placement_env.report.paper.scheme_table import scheme_experiment, scheme_runs
from placement_env.report.paper.scoring import kbit_per_sensor, ms_per_frame, score_run


def test_rows_are_the_papers_table(stored):
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


def test_what_is_sent_is_explained(stored):
    rows = {row.labels: row.reason for row in scheme_experiment(stored, "tjunction", "").rows}
    far = sum(truth.sent[2].sum() for truth in stored.truths) / stored.frames / 6 * 0.096
    kbit = kbit_per_sensor(stored, scheme_runs(6)[0])
    assert rows["late", "sent by a sensor"] == f"{kbit / 0.256:.1f} boxes of 256 bit a sensor here, 2.0 in the paper"
    assert rows["hybrid", "sent by a sensor"].endswith(f"points make {far:.0f} kbit")
    assert rows["early", "sent by a sensor"] == ""


def test_conclusion_says_whether_the_order_holds(stored, stored_roundabout):
    said = {site: scheme_experiment(each, site, "") for site, each in
            (("tjunction", stored), ("roundabout", stored_roundabout))}  # fmt: skip
    for made in said.values():
        ap = {row.labels: row.ours or 0.0 for row in made.rows if row.unit == "AP"}
        ordered = all(ap["early", at] >= ap["hybrid", at] >= ap["late", at] for at in ("AP@0.7", "AP@0.8", "AP@0.9"))
        assert made.conclusion.startswith("As in the paper, early" if ordered else "The paper's order")
    share = sum(t.sent[1].sum() for t in stored.truths) / sum(t.sent[0].sum() for t in stored.truths)
    assert said["tjunction"].conclusion.endswith(f"{100 * share:.0f} % of the points lie beyond the hybrid radius.")


def test_picture(stored, tmp_path):
    out = tmp_path / "schemes.svg"
    scheme_experiment(stored, "tjunction", "").draw(out)
    assert out.read_text().count("<path") > 20
    assert pytest.approx(6) == len(stored.sensors)
