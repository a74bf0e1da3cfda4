import json

import numpy as np
import pytest

from toolkit.datasets.records.boxes_file import boxes_record, detections_in, objects_in, read_entries, write_boxes
from toolkit.objects import Detections, Objects

BOX = np.array([[1.0, 2, 3, 4, 2, 1.5, 0.5]])


def test_objects_there_and_back(tmp_path):
    objects = Objects(BOX, np.array([2]), np.array([7]))
    write_boxes(tmp_path / "a.json", [boxes_record("x", 0.5, objects, counts=[9])])
    (each,) = read_entries(tmp_path / "a.json").values()
    assert each["time"] == 0.5
    assert each["objects"][0]["yaw_deg"] == pytest.approx(28.6478898)
    found = objects_in(tmp_path / "a.json", each, {})
    np.testing.assert_allclose(found.objects.boxes, BOX, atol=1e-12)
    assert found.objects.ids.tolist() == [7]
    assert found.counts.tolist() == [9]


def test_detections_there_and_back(tmp_path):
    found = Detections(BOX, np.array([0.75]), np.array([3]))
    write_boxes(tmp_path / "a.json", [boxes_record("x", float("nan"), found)], detector="general")
    content = json.loads((tmp_path / "a.json").read_text())
    assert content["detector"] == "general"
    assert content["samples"][0]["time"] is None
    back = detections_in(tmp_path / "a.json", read_entries(tmp_path / "a.json")["x"])
    np.testing.assert_allclose(back.boxes, BOX, atol=1e-12)
    assert (back.scores.tolist(), back.labels.tolist()) == ([0.75], [3])


@pytest.mark.parametrize(
    ("content", "names"),
    [
        ("{}", "no entry coview"),
        ('{"coview": "boxes", "version": 2, "samples": []}', "version 1"),
        ('{"coview": "boxes", "version": 1, "samples": {}}', "samples must be a list"),
        ('{"coview": "boxes", "version": 1, "samples": [{}]}', "no entry name"),
    ],
)
def test_damage_names_the_file(tmp_path, content, names):
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ValueError, match=f"a.json .*{names}"):
        read_entries(tmp_path / "a.json")


@pytest.mark.parametrize("change", [{"length": 0}, {"score": "NaN"}, {"label": "dog"}, {"x": None}])
def test_detections_that_cannot_be(change):
    row = boxes_record("x", 0.0, Detections(BOX, np.array([0.5])))["objects"][0] | change
    with pytest.raises(ValueError, match=r"a.json is no file of boxes"):
        detections_in("a.json", {"objects": [row]})
