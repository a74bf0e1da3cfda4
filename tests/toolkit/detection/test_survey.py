"""What a recording holds, counted by hand."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from toolkit.datasets.recording_views import Reads
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.survey import survey
from toolkit.frame import Frame, OtherObjects, SensorCloud
from toolkit.geometry import look
from toolkit.objects import HEAVY, VEHICLE, Detections, Objects
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
SENSORS = tuple(
    Sensor(
        f"s{k}", DepthCamera(width=80, height=60, stride=1), look((x, 0.0, 5.2), heading, tilt=0.2)
    )
    for k, (x, heading) in enumerate([(-30.0, 0.0), (30.0, np.pi), (0.0, 1.5)])
)


class Recording:
    """Cars in a row, one of them outside the area; every sensor sees ground, and has its own depth
    for each frame."""

    site = Site("somewhere", AREA)
    sensors = SENSORS

    def __len__(self):
        return 5

    def __getitem__(self, k):
        x = np.array([-45.0, -20, -10, 0, 10, 20]) + k
        boxes = np.column_stack([x, 0 * x, 0 * x + 0.75, 0 * x + 4, 0 * x + 2, 0 * x + 1.5, 0 * x])
        rng = np.random.default_rng(k)
        depths = tuple(rng.uniform(1, 40, s.model.shape).astype(np.float32) for s in SENSORS)
        return Frame(SENSORS, depths, Objects(boxes, np.array([VEHICLE] * 5 + [HEAVY])), index=k)


def test_surveys_count_objects_points_and_bits():
    found = survey(Recording(), reads=Reads(noise_seed=3))
    assert found.frames == 5
    assert found.objects_per_frame == {"vehicle": 4, "cyclist": 0, "pedestrian": 0, "heavy": 1}
    assert found.counts.shape == (20, 3)
    assert found.unseen([]) == 1
    assert found.unseen([0, 1, 2]) <= found.unseen([0])
    compared = Comparison(schemes=["early"], iou_thresholds=[0.7])
    rows = evaluate_recording(
        Recording(), lambda points: Detections.empty(), compared, reads=Reads(noise_seed=3)
    )
    assert found.kbit_per_sensor.mean() == pytest.approx(rows[0].kbit_per_sensor)
    assert found.as_dict([[0, 2]])["unseen"].keys() == {"0,2"}
    json.dumps(found.as_dict([[0]]))
    assert {"dataset", "frames", "noise_seed", "codec", "coview", "site"} <= found.as_dict([[0]])[
        "provenance"
    ].keys()


def test_surveys_without_vehicles_are_undefined():
    empty = survey(Recording(), reads=Reads(frames=1))
    nobody = replace(empty, counts=empty.counts[:0])
    assert np.isnan(nobody.unseen([0]))
    assert len(nobody.points_on_vehicles([0, 1])) == 0


def test_surveys_have_the_errors_of_a_profile():
    clean, rough = survey(Recording()), survey(Recording(), reads=Reads(errors="poor"))
    assert rough.kbit_per_sensor.sum() < clean.kbit_per_sensor.sum()
    for each, profile in ((rough, "poor"), (clean, "paper")):
        errors: Any = each.provenance["errors"]
        assert errors["profile"] == profile
    with pytest.raises(ValueError, match="unknown error profile 'x'"):
        survey(Recording(), reads=Reads(errors="x"))


@pytest.mark.parametrize(
    ("options", "message"),
    [({"reads": Reads(frames=0)}, "need one frame"), ({"codec": "paper"}, "codec")],
)
def test_bad_requests_are_refused(options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        survey(Recording(), **options)


def test_points_are_counted_by_class():
    found = survey(Recording(), reads=Reads(noise_seed=3))
    assert list(found.by_class) == ["vehicle", "cyclist", "pedestrian", "heavy"]
    assert [len(found.by_class[label]) for label in found.by_class] == [20, 0, 0, 5]
    np.testing.assert_array_equal(found.by_class["vehicle"], found.counts)
    np.testing.assert_array_equal(
        found.points_on_objects("heavy", [0, 2]), found.by_class["heavy"][:, [0, 2]].sum(axis=1)
    )
    written = found.as_dict([[0, 2], [1]])["classes"]
    assert written["heavy"]["objects"] == 5
    points = found.points_on_objects("heavy", [0, 2])
    assert written["heavy"]["sets"]["0,2"] == {
        "mean_points": points.mean(),
        "median_points": np.median(points),
        "unseen": (points == 0).mean(),
    }
    assert written["cyclist"]["sets"]["1"] == {
        "mean_points": None,
        "median_points": None,
        "unseen": None,
    }
    assert np.isnan(found.unseen([0], "pedestrian"))
    assert found.unseen([0], "vehicle") == found.unseen([0])


def test_only_some_classes_are_counted():
    found = survey(Recording(), reads=Reads(frames=2), classes=["heavy"])
    assert list(found.by_class) == ["heavy"]
    assert found.counts.shape == (8, 3)
    with pytest.raises(ValueError, match="counted were heavy, not 'vehicle'"):
        found.points_on_objects("vehicle", [0])
    with pytest.raises(ValueError, match="label must be one of"):
        survey(Recording(), classes=["tram"])


def test_points_are_counted_without_a_site():
    found = survey(
        Labelled([sample(np.array([2, 1, 0])), sample(np.array([2, 0, 0]))]), classes=["vehicle"]
    )
    figures = found.as_dict([[0]])
    assert figures["frames"] == 2
    assert figures["points_per_cloud"] == {"s": 4}
    assert figures["objects_per_frame"] == {"vehicle": 2, "cyclist": 0, "pedestrian": 1, "heavy": 0}
    assert figures["classes"]["vehicle"]["objects"] == 4
    assert figures["classes"]["vehicle"]["sets"]["0"] == {
        "mean_points": 1.5,
        "median_points": 1.5,
        "unseen": 0,
    }
    assert figures["counts_that_agree"] == [7, 8]
    assert figures["problems"] == {"doubled labels": 2}
    text = found.text([[0]])
    assert "7 of 8 labelled cuboids hold as many points as the set says" in text
    assert "vehicle from 0: 0.0% of 4 without a point, mean 1.5, median 1.5 points" in text


def test_a_class_without_counts_is_left_out_and_no_frame_refused():
    found = survey(Labelled([sample(None)]), classes=["cyclist"])
    assert found.agreement == (1, 1)  # of the cone
    assert "cyclist from" not in found.text([[0]])
    with pytest.raises(ValueError, match="need one frame"):
        survey(Labelled())


def test_points_and_bits_of_a_sensor_are_means_over_the_frames_that_have_it():
    clouds = [
        SensorCloud("s", np.array([[3.0, 0, 0]] * (k + 2), np.float32), np.eye(4)) for k in range(3)
    ]
    late = SensorCloud("late", np.array([[5.0, 0, 0]] * 8, np.float32), np.eye(4))
    nothing = Objects(np.zeros((0, 7)), np.zeros(0, int))
    frames = [Frame.of_clouds("0", (clouds[0],), nothing)]
    frames += [Frame.of_clouds(str(k), (clouds[k], late), nothing) for k in (1, 2)]
    found = survey(Labelled(frames))
    assert found.points_per_cloud == {"s": 3, "late": 8}
    # alike with a recording of these frames only, which begins when the sensor does
    alone = survey(Labelled([Frame.of_clouds("1", (late,), nothing)]))
    assert found.kbit_per_sensor[1] == alone.kbit_per_sensor[0] > 0


def sample(counts):
    boxes = np.array([[x, 0.0, 0, 2, 2, 2, 0] for x in (0.0, 10.0, 20.0)])
    points = np.array([[0, 0, 0], [0.5, 0, 0], [10, 0, 0], [99, 0, 0]], np.float32)
    cloud = SensorCloud("s", points, np.eye(4))
    others = OtherObjects(boxes[:1], ("cone",), np.array([2]))
    return Frame.of_clouds(
        "0",
        (cloud,),
        Objects(boxes, np.array([0, 0, 2])),
        (),
        counts,
        others,
        problems={"doubled labels": 1},
    )


class Labelled(list):
    site = None
