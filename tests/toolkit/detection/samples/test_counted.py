import numpy as np
import pytest

from toolkit.datasets.sample import OtherObjects, Sample, SensorCloud
from toolkit.detection.samples.counted import survey_samples, survey_text
from toolkit.objects import Objects


def sample(counts):
    boxes = np.array([[x, 0.0, 0, 2, 2, 2, 0] for x in (0.0, 10.0, 20.0)])
    points = np.array([[0, 0, 0], [0.5, 0, 0], [10, 0, 0], [99, 0, 0]], np.float32)
    cloud = SensorCloud("s", points, np.eye(4))
    others = OtherObjects(boxes[:1], ("cone",), np.array([2]))
    return Sample(
        "0", (cloud,), Objects(boxes, np.array([0, 0, 2])), (), counts, others, problems={"doubled labels": 1}
    )


def test_what_is_counted():
    figures = survey_samples([sample(np.array([2, 1, 0])), sample(np.array([2, 0, 0]))], classes=["vehicle"])
    assert figures["samples"] == 2
    assert figures["points_per_cloud"] == {"s": 4}
    assert figures["objects_per_sample"] == {"vehicle": 2, "cyclist": 0, "pedestrian": 1, "heavy": 0}
    assert figures["classes"] == {"vehicle": {"objects": 4, "mean_points": 1.5, "median_points": 1.5, "unseen": 0}}
    assert figures["counts_that_agree"] == [7, 8]
    assert figures["problems"] == {"doubled labels": 2}
    text = survey_text(figures)
    assert "7 of 8 labelled cuboids hold as many points as the set says" in text
    assert "vehicle: 0.0% of 4 without a point, mean 1.5, median 1.5 points" in text


def test_sets_without_counts_and_classes_without_objects():
    figures = survey_samples([sample(None)], classes=["cyclist"])
    assert figures["counts_that_agree"] == [1, 1]  # of the cone
    assert figures["classes"]["cyclist"] == {"objects": 0, "mean_points": None, "median_points": None, "unseen": None}
    assert "cyclist:" not in survey_text(figures)
    with pytest.raises(ValueError, match="no sample to survey"):
        survey_samples([])
