import json

import numpy as np
import pytest

from toolkit.datasets.records import detections_in, read_entries
from toolkit.datasets.sample import Sample
from toolkit.detection.detect import Detected
from toolkit.detection.results import described, file_name, summary, write_detections
from toolkit.objects import Detections, Objects

BOX = np.array([[10.0, 2, 1, 4, 2, 1.5, 0.5]])


@pytest.fixture
def found():
    detections = Detections(BOX, np.array([0.75]))
    problems = ({"doubled labels": 2}, {"doubled labels": 1})
    return [
        Detected(
            Sample(f"a/{k}", (), Objects.empty(), problems=each), detections, None, np.zeros(2), 10.0 + k, 20.0 + k
        )
        for k, each in enumerate(problems)
    ]


def test_boxes_in_one_file(found, tmp_path):
    assert list(write_detections(iter(found), tmp_path / "b.json", weights="general")) == found
    entries = read_entries(tmp_path / "b.json")
    assert list(entries) == ["a/0", "a/1"]
    np.testing.assert_allclose(detections_in("b.json", entries["a/0"]).boxes, BOX, atol=1e-12)
    assert json.loads((tmp_path / "b.json").read_text())["weights"] == "general"


def test_a_file_for_each_sample(found, tmp_path):
    list(write_detections(iter(found), tmp_path / "o", "openlabel"))
    list(write_detections(iter(found), tmp_path / "k", "kitti"))
    assert sorted(file.name for file in (tmp_path / "o").iterdir()) == ["a_0.json", "a_1.json"]
    words = (tmp_path / "k/a_0.txt").read_text().split()
    assert words[0] == "Car"
    assert len(words) == 16
    assert float(words[-1]) == 0.75


def test_a_summary(found):
    figures = summary(found)
    assert figures == {
        "samples": 2,
        "detections": 2,
        "problems": {"doubled labels": 3},
        "level_ms": 10.5,
        "detect_ms": 20.5,
    }
    assert described(figures) == "2 detections in 2 clouds; 10 ms to level, 20 ms to detect; 3 doubled labels"
    assert described(summary([])) == "0 detections in 0 clouds"


def test_names_of_files():
    assert file_name("106-105/seq-1/00000 b") == "106-105_seq-1_00000_b"
