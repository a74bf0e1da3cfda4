"""A stress test as text, JSON and SVG."""

import json

import numpy as np

from placement_env.report.content import Judgement
from placement_env.report.stress.files import STRESS_FILES, format_stress, write_stress
from placement_env.report.stress.outcomes import StressRow

JUDGED = Judgement(0.875, 0.8, 0.9123, 0.9, None, 40, 10)
ROWS = [
    StressRow("delay", "0.3 s", "early", "2 cm", JUDGED, 6.125, 0.3, "vehicle", 0.7),
    StressRow("loss", "10%", "late", "paper", JUDGED, 0.25, np.nan, "vehicle", 0.7),
]


def test_as_text():
    assert format_stress(ROWS).splitlines() == [
        "stress  level  scheme  sent as  IoU     AP   95 % interval  kbit/sensor     age",
        "delay   0.3 s  early   2 cm     0.7  0.875  0.800 to 0.912         6.12  0.30 s",
        "loss    10%    late    paper    0.7  0.875  0.800 to 0.912         0.25   nan s",
    ]


def test_as_files(tmp_path):
    write_stress(ROWS, {"site": "plain"}, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(STRESS_FILES)
    content = json.loads((tmp_path / "out" / "stress.json").read_text())
    assert content["provenance"] == {"site": "plain"}
    assert content["rows"][1]["age"] is None
    assert content["rows"][0]["judged"]["ap"] == 0.875
    assert "<svg" in (tmp_path / "out" / "stress.svg").read_text()
