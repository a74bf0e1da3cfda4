"""A stress test as text, JSON and SVG, and failures looked up in tables."""

import json

import numpy as np
import pytest

from examples.studies.stress import outputs
from examples.studies.stress.noticing import FalseAlarms, Noticed
from examples.studies.stress.stressing import StressRow
from placement_env.fidelity.table import load_table
from placement_env.report.content import Judgement

JUDGED = Judgement(0.875, 0.8, 0.9123, 0.9, None, 40, 10)
ROWS = [
    StressRow("delay", "0.3 s", "early", "2 cm", JUDGED, 6.125, 0.3, "vehicle", 0.7),
    StressRow("loss", "10%", "late", "paper", JUDGED, 0.25, np.nan, "vehicle", 0.7),
]
NOTICED = Noticed("frozen", "foreground", 6, 5, 0.2, np.inf)


def test_rows_are_a_table_of_text(tmp_path):
    assert outputs.format_stress_rows(ROWS).splitlines() == [
        "stress  level  scheme  sent as  IoU    AP  95 % interval  kbit/sensor     age",
        "delay   0.3 s  early   2 cm     0.7  0.88   0.80 to 0.91         6.12  0.30 s",
        "loss    10%    late    paper    0.7  0.88   0.80 to 0.91         0.25   nan s",
    ]


def test_files_have_rows_crossings_and_times(tmp_path):
    crossed = outputs.Crossing("pose", 0.7, "early", "late", 0.254, 0.2, np.inf, 0.97)
    outputs.write_stress(
        outputs.StressResults(tuple(ROWS), (crossed,), noticed=(NOTICED,)),
        {"site": "plain"},
        tmp_path / "out",
    )
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        outputs.STRESS_FILES
    )
    content = json.loads((tmp_path / "out" / "stress.json").read_text())
    assert content["provenance"] == {"site": "plain"}
    assert content["rows"][1]["age"] is None
    assert content["rows"][0]["judged"]["ap"] == 0.875
    assert content["noticed"][0]["worst"] is None
    assert (content["crossings"][0]["high"], content["crossings"][0]["level"]) == (None, 0.254)
    assert "tally" not in content["rows"][0]
    assert "exact" not in content
    assert "<svg" in (tmp_path / "out" / "stress.svg").read_text()


def test_rows_so_far_are_written_again_and_again(tmp_path):
    outputs.write_rows(ROWS[:1], {"site": "plain"}, tmp_path / "new")
    outputs.write_rows(ROWS, {"site": "plain"}, tmp_path / "new")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["stress.json"]
    assert len(json.loads((tmp_path / "new" / "stress.json").read_text())["rows"]) == 2


def test_crossings_faults_and_failures_as_text():
    crossed = [outputs.Crossing("pose", 0.7, "early", "late", 0.254, 0.2, np.inf, 0.97)]
    rows = [
        StressRow(
            "pose",
            "",
            name,
            "2 cm",
            Judgement(ap, ap, ap, 1.0, 1.0, 1, 1),
            1.0,
            0.0,
            "vehicle",
            0.7,
            level,
        )
        for name, aps in (("early", (0.9, 0.1)), ("late", (0.5, 0.5)))
        for level, ap in zip((0.0, 0.4), aps, strict=True)
    ]
    assert outputs.format_crossings(rows, crossed).splitlines() == [
        *("highest AP  IoU  scheme  from    to", "pose        0.7  early   0.00  0.20"),
        *("pose        0.7  late    0.20  0.40", ""),
        "overtaken  IoU  scheme  by    from level  95 % interval  of draws",
        "pose       0.7  early   late        0.25    0.20 to inf       97%",
    ]
    assert outputs.format_crossings(ROWS, []) == ""
    assert outputs.format_noticed(
        [NOTICED], [FalseAlarms("loss 10%", "foreground", 3, 12.54)]
    ).splitlines() == [
        *(
            "fault   sent as     cases  noticed  median  worst",
            "frozen  foreground      6        5   0.2 s  inf s",
            "",
        ),
        "false alarms: link  sent as     alarms  sensor-minutes",
        "loss 10%            foreground       3            12.5",
    ]
    left = [outputs.ExactFailure("early", 0.7, 2, 0.98, 0.9, 0.8125, ("d0", "d3"), 640)]
    assert outputs.format_exact(left).splitlines()[1].split() == [
        *("N-2", "early", "0.7", "0.980", "0.900", "0.812", "d0,", "d3")
    ]


def test_tables_say_what_is_left_or_lack_values():
    table = load_table("tjunction")
    found = {
        (each.scheme, each.iou, each.failing): each
        for each in outputs.exact_failures(table, ious=(0.7, 0.9))
    }
    assert len(found) == 3 * 2 * 2
    early = table.ap[:, 0, 0]
    one = found["early", 0.7, 1]
    left = [early[0b111111 ^ (1 << k)] for k in range(6)]
    assert one.intact == early[-1]
    assert one.worst == min(left)
    assert one.mean == pytest.approx(np.mean(left))
    assert one.without == (table.origin.sensors[int(np.argmin(left))],)
    two = found["late", 0.9, 2]
    pairs = [table.ap[0b111111 ^ (1 << a) ^ (1 << b), 1, 2] for a in range(6) for b in range(a)]
    assert two.worst == min(pairs)
    assert len(two.without) == 2
    assert two.failing == 2
    table = load_table("tjunction")
    assert {each.iou for each in outputs.exact_failures(table, ious=(0.5, 0.8))} == {0.8}
    with pytest.raises(ValueError, match=r"holds AP at IoU 0\.7, 0\.8, 0\.9, not at 0\.5"):
        outputs.exact_failures(table, ious=(0.5,))
    with pytest.raises(ValueError, match=r"holds AP at IoU 0\.5, not at 0\.7"):
        outputs.exact_failures(table, label="cyclist", ious=(0.7,))
    with pytest.raises(ValueError, match="holds vehicle, cyclist, pedestrian, heavy, not tram"):
        outputs.exact_failures(table, label="tram")
