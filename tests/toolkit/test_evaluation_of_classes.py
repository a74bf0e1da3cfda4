"""`evaluate_recording` class by class: a detector that knows three of them, counted by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest

from toolkit.detection import comparison, evaluation, evaluation_files, evaluation_tables
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

SENSORS = tuple(
    Sensor(f"s{k}", DepthCamera(width=40, height=30, stride=1), look((x, 0.0, 5.2), 0.0, tilt=0.2))
    for k, x in enumerate([-30.0, 0.0, 30.0])
)


class Mixed:
    """In each of 4 frames a car, two cyclists and a pedestrian; the last frame has no
    pedestrian."""

    site = Site("somewhere", np.array([-40.0, -20.0, 40.0, 20.0]))
    sensors = SENSORS
    KINDS = ("vehicle", "cyclist", "cyclist", "pedestrian")
    SIZES = np.array([[4, 2, 1.5], [1.8, 0.6, 1.7], [1.8, 0.6, 1.7], [0.6, 0.6, 1.8]])

    def __len__(self):
        return 4

    def __getitem__(self, k):
        x = np.array([-20.0, -10, 0, 10]) + k
        boxes = np.column_stack([x, 0 * x, self.SIZES[:, 2] / 2, self.SIZES, 0 * x])
        kept = slice(None) if k < 3 else slice(0, 3)
        depths = tuple(np.full(s.model.shape, 5.0, np.float32) for s in SENSORS)
        return Frame(SENSORS, depths, Objects(boxes[kept], np.array(self.KINDS[kept])), index=k)


class Knows:
    """Finds every car, one cyclist of the two, and calls the other one a pedestrian in two of the
    frames."""

    labels = ("pedestrian", "vehicle", "cyclist")

    def __init__(self):
        self.frame = -1

    def __call__(self, points):
        self.frame += 1
        there = Mixed()[self.frame].objects
        kinds = ["vehicle", "cyclist", "pedestrian" if self.frame < 2 else "cyclist"]
        return Detections(there.boxes[:3], np.array([0.9, 0.8, 0.7]), np.array(kinds))


def mixed(classes, **options):
    return evaluation.evaluate_recording(
        Mixed(), Knows(), comparison.Comparison(schemes=["early"], classes=classes, **options)
    )


def test_classes_have_rows_at_their_thresholds():
    rows = mixed(["vehicle", "cyclist", "pedestrian"])
    assert [(row.label, row.iou) for row in rows] == [
        *(("vehicle", iou) for iou in (0.7, 0.8, 0.9)),
        *(("cyclist", iou) for iou in (0.25, 0.5, 0.7)),
        *(("pedestrian", iou) for iou in (0.25, 0.5, 0.7)),
    ]
    assert [row.truths for row in rows[::3]] == [4, 8, 3]
    assert [row.recall for row in rows[::3]] == [1.0, 0.75, 0.0]
    assert [row.false_alarms_per_frame for row in rows[::3]] == [0.0, 0.0, 0.5]
    assert [row.ap for row in rows[::3]] == [1.0, 0.75, 0.0]
    assert rows.provenance["classes"]["pedestrian"] == (0.25, 0.5, 0.7)


def test_thresholds_are_given_for_a_class():
    given = mixed(["cyclist"], iou_thresholds=[0.6])
    assert [(row.label, row.iou) for row in given] == [("cyclist", 0.6)]
    assert (given.provenance["label"], given.provenance["iou"]) == ("cyclist", [0.6])


def test_a_class_scores_the_same_in_any_company():
    alone = {
        label: mixed([label], iou_thresholds=[0.5])[0]
        for label in ("vehicle", "cyclist", "pedestrian")
    }
    for row in mixed([2, "cyclist", "vehicle", "cyclist"], iou_thresholds=[0.5]):
        twin = alone[row.label]
        assert (row.ap, row.recall, row.precision) == pytest.approx(
            (twin.ap, twin.recall, twin.precision), nan_ok=True
        )


def test_tables_have_a_part_for_each_class():
    rows = mixed(["vehicle", "pedestrian"])
    first, second = evaluation_tables.format_table(rows).split("\n\n")
    assert first.splitlines()[0] == "vehicle, 4 to find"
    assert second.splitlines()[0] == "pedestrian, 3 to find"
    assert "AP@0.9" in first
    assert "AP@0.25" in second
    assert first.split("\n", 1)[1] == evaluation_tables.format_table(rows[:3])
    lines = evaluation_tables.format_class_table(rows.classes).splitlines()
    assert lines[0].split()[:3] == ["class", "scheme", "sensors"]
    assert lines[2].split() == [
        "pedestrian",
        "early",
        "0,1,2",
        "3",
        "0.00",
        "0.000",
        "0.500",
        "0.700",
        "0.25",
    ]


def test_figures_have_as_many_digits_as_there_are_truths():
    rows = mixed(["vehicle", "pedestrian"])
    few, many = (
        replace(rows[0], ap=0.123456, recall=0.654321, truths=count) for count in (12, 1200)
    )
    assert [evaluation_tables.format_table([each]).split()[7:10] for each in (few, many)] == [
        ["0,1,2", "0.12", "0.65"],
        ["0,1,2", "0.123", "0.654"],
    ]
    assert few.as_dict()["ap"] == 0.123456
    assert evaluation_tables.format_table([]) == ""


def test_classes_that_the_detector_lacks_are_refused():
    with pytest.raises(
        ValueError, match="knows vehicle, cyclist, pedestrian only, not heavy: take one"
    ):
        mixed(["vehicle", "heavy"])
    with pytest.raises(ValueError, match="label must be one of"):
        mixed(["tram"])
    with pytest.raises(ValueError, match="a class and an IoU threshold"):
        mixed([])


def test_classes_have_figures_at_the_detectors_threshold():
    vehicle, cyclist, pedestrian = mixed(["vehicle", "cyclist", "pedestrian"]).classes
    assert [
        (c.label, c.iou, c.frames, c.truths, c.detections) for c in (vehicle, cyclist, pedestrian)
    ] == [("vehicle", 0.5, 4, 4, 4), ("cyclist", 0.5, 4, 8, 6), ("pedestrian", 0.25, 4, 3, 2)]
    assert (vehicle.recall, vehicle.precision, vehicle.false_alarms_per_frame) == (1, 1, 0)
    assert (cyclist.recall, cyclist.precision, cyclist.false_alarms_per_frame) == (0.75, 1, 0)
    assert (pedestrian.recall, pedestrian.precision, pedestrian.false_alarms_per_frame) == (
        0,
        0,
        0.5,
    )
    assert vehicle.reliability.error == pytest.approx(0.1)
    written = pedestrian.as_dict()
    assert written["calibration_error"] == pytest.approx(0.7)
    assert sum(written["reliability"]["count"]) == 2
    assert written["reliability"]["true"][0] is None
    json.dumps(written, allow_nan=False)


def test_files_of_curves_are_named_by_class(tmp_path):
    evaluation_files.save_evaluation(
        mixed(["vehicle", "pedestrian"], iou_thresholds=[0.5]), tmp_path
    )
    assert {path.name for path in tmp_path.iterdir()} == {
        "table.json",
        *evaluation_files.curve_files(["vehicle", "pedestrian"], [0.5]),
    }
    assert list(evaluation_files.curve_files(["vehicle", "cyclist"])) == [
        *(
            "pr_0.7.png",
            "pr_0.8.png",
            "pr_0.9.png",
            "pr_cyclist_0.25.png",
            "pr_cyclist_0.5.png",
            "pr_cyclist_0.7.png",
        )
    ]
    assert json.loads((tmp_path / "table.json").read_text())["classes"][1]["label"] == "pedestrian"
