"""Refusals of labels.json name the sample, the object, the value and the remedy
(docs/how-to/labels.md)."""

import json
from pathlib import Path

import numpy as np
import pytest

from toolkit.datasets.box_files import parse_objects, read_entries
from toolkit.doctor.labels import compare_fits

CAR = {
    "label": "vehicle",
    "x": 1,
    "y": 2,
    "z": 0.7,
    "length": 4.2,
    "width": 1.8,
    "height": 1.5,
    "yaw_deg": 90,
}
NAMED = r"labels.json .*objects\[1\] of sample '0007': "


def parse(*objects):
    return parse_objects(Path("labels.json"), {"name": "0007", "objects": list(objects)}, {})


def test_objects_are_read():
    assert len(parse(CAR, CAR | {"x": "9.5"}).objects) == 2


@pytest.mark.parametrize(
    ("damaged", "reason"),
    [
        (CAR | {"x": "10,5"}, "x must be a number, got '10,5'"),
        ({key: value for key, value in CAR.items() if key != "yaw_deg"}, "it has no entry yaw_deg"),
        ({key: value for key, value in CAR.items() if key != "label"}, "it has no entry label"),
        (CAR | {"points": "many"}, "points must be a number, got 'many'"),
        ([1.0, 2.0], "it has no entry x"),
    ],
)
def test_a_refusal_names_sample_and_object(damaged, reason):
    with pytest.raises(ValueError, match=NAMED + reason):
        parse(CAR, damaged)


def test_a_sample_without_objects_is_refused_with_the_remedy():
    with pytest.raises(
        ValueError, match=r"sample '0007' has no entry objects: write \"objects\": \[\]"
    ):
        parse_objects(Path("labels.json"), {"name": "0007"}, {})


@pytest.mark.parametrize(
    "content", [[CAR], {"samples": []}, "boxes", {"coview": "boxes", "version": 2}]
)
def test_another_file_is_refused_with_what_it_must_say(tmp_path: Path, content):
    path = tmp_path / "labels.json"
    path.write_text(json.dumps(content))
    with pytest.raises(
        ValueError, match=r"its form must be .*\"coview\": \"boxes\", \"version\": 1"
    ):
        read_entries(path)


@pytest.mark.parametrize(("fit", "is_certain"), [(0.18, False), (0.7, True)])
def test_the_doctor_says_when_its_best_cause_explains_little(fit, is_certain):
    finding = compare_fits("mirrored", np.full(9, 0.02), np.full(9, fit), "negate y")
    assert finding.remedy.startswith("negate y")
    assert ("the cause may be another" not in finding.remedy) == is_certain
