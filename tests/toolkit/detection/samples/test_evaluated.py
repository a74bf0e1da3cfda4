import json

import numpy as np
import pytest

from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.samples.evaluated import evaluate_samples
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES
from toolkit.geometry import pose
from toolkit.objects import Detections, Objects

CAR = np.array([[10.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]])


def samples():
    for k in range(2):
        clouds = tuple(
            SensorCloud(name, np.tile([10.0 - x, 0.0, -2.0], (8, 1)).astype(np.float32), pose(x, 0.0, 3.0))
            for name, x in (("a", -1.0), ("b", 1.0))
        )
        yield Sample(str(k), clouds, Objects(CAR), problems={"doubled labels": 1})


class Everything:
    """Says that there is a car, as sure as it has points."""

    labels = ("vehicle",)

    def __call__(self, points):
        return Detections(CAR, np.array([len(points) / 20]))


def test_schemes_on_samples(tmp_path):
    made = evaluate_samples(samples, Everything(), schemes=[SCHEMES[name] for name in PAPER_SCHEMES], levelling="none")
    assert list(made.schemes) == ["early", "late", "hybrid"]
    np.testing.assert_allclose([row.ap for row in made.rows if row.truths], 1.0)
    assert made.schemes["early"]["kbit_per_sensor"] == pytest.approx(8 * 96 / 1000)
    assert made.schemes["late"]["kbit_per_sensor"] == pytest.approx(0.256)
    assert made.schemes["late"]["problems"] == {"doubled labels": 2}
    made.save(tmp_path / "table.json")
    content = json.loads((tmp_path / "table.json").read_text())
    assert len(content["rows"]) == len(made.rows)
    assert {row["scheme"] for row in content["rows"]} == {"early", "late", "hybrid"}
    assert "kbit per sensor" in made.text()


def test_all_clouds_at_once_and_some_sensors():
    seen = []

    def watched(found):
        for each in found:
            seen.append(each)
            yield each

    made = evaluate_samples(samples, Everything(), levelling="none", sensors=["b"], seen=watched)
    assert list(made.schemes) == ["all clouds"]
    assert made.schemes["all clouds"]["kbit_per_sensor"] is None
    assert [[cloud.name for cloud in each.sample.clouds] for each in seen] == [["b"]] * 2


def test_what_is_refused():
    with pytest.raises(ValueError, match="no sample to evaluate"):
        evaluate_samples(list, Everything())
    with pytest.raises(ValueError, match="knows vehicle only, not cyclist"):
        evaluate_samples(samples, Everything(), classes=["cyclist"])
    with pytest.raises(ValueError, match="no sensor 'c'"):
        evaluate_samples(samples, Everything(), sensors=["c"])
