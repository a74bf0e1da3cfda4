import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration.scenes import SampleScenes, learn_sample_scenes
from toolkit.datasets.sample import Sample, SensorCloud
from toolkit.detection.detect import detect_samples
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.sample_evaluation import evaluate_samples
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES
from toolkit.geometry import pose
from toolkit.objects import Detections, Objects
from toolkit.sensors.models import RowLidar

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


def test_the_link_is_said_at_a_rate():
    made = evaluate_samples(samples, Everything(), schemes=[SCHEMES["early"]], levelling="none", rate=10.0)
    load = made.schemes["early"]["load"]
    assert load["mbit_per_s"] == pytest.approx(2 * 8 * 96 * 10 / 1e6)
    assert "0.77 kbit per sensor, 96 bytes; at 10 Hz 0.015 Mbit/s together" in made.text()
    assert "load" not in evaluate_samples(samples, Everything(), levelling="none", rate=10.0).schemes["all clouds"]


def still(count=6):
    """A lidar above flat ground, before which a car stands in the last of the samples."""
    model = RowLidar(tuple(np.deg2rad(np.linspace(-5, -40, 20))), columns=180)
    ground = (2.95 / -model.rays()[..., 2].astype(np.float64)).astype(np.float32)
    for k in range(count):
        image = ground.copy()
        if k == count - 1:
            image[6:11, 88:92] -= 1.0
        points = (model.rays() * image[..., None]).reshape(-1, 3)
        points = np.concatenate([points, 1.2 * points[:4]])
        yield Sample(str(k), (SensorCloud("a", points, pose(z=3.0)),), Objects(CAR))


def test_schemes_that_send_images_learn_the_empty_scene():
    schemes = [SCHEMES["early"], SCHEMES["foreground"], SCHEMES["late"]]
    made = evaluate_samples(still, Everything(), schemes=schemes, levelling="none")
    figures = made.schemes["foreground"]
    assert figures["images"] == {"a": {"points": 6 * 3604, "points in a cell with a nearer one": 24}}
    assert 0 < figures["kbit_per_sensor"] < 1 < 100 < made.schemes["early"]["kbit_per_sensor"]
    assert "images" not in made.schemes["early"]
    assert "a: of 21624 points its images leave out 24 points in a cell with a nearer one" in made.text()
    coded = evaluate_samples(still, Everything(), schemes=schemes[::2], levelling="none", codec=RangeImages())
    assert figures["kbit_per_sensor"] < coded.schemes["early"]["kbit_per_sensor"] < 20
    assert "images" in coded.schemes["early"]
    assert "images" not in coded.schemes["late"]


def test_differences_are_to_the_sample_before_of_the_same_sensors():
    """Somebody stands still in the last samples: what the first of them brings costs nothing in the next."""

    def parked(count=9, silent=()):
        last = list(still())[-1]
        for k in range(count):
            sample = last if k >= 6 else next(iter(still()))
            yield replace(sample, clouds=()) if k in silent else sample

    def bits(silent=()):
        scenes = SampleScenes(lambda: still(6))
        scheme = SCHEMES["differences"]
        found = detect_samples(parked(silent=silent), Everything(), levelling="none", scheme=scheme, scenes=scenes)
        return [each.bits for each in found]

    ((first,), (second,), (third,)) = bits()[6:]
    assert second == third < first
    after = bits(silent=[7])
    assert after[7] == ()
    assert after[8] > (second,)


def test_scenes_may_be_given():
    learnt = learn_sample_scenes(still(5))["a"].scene
    scenes = SampleScenes(lambda: iter(()), [learnt])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = evaluate_samples(
            lambda: [list(still())[-1]], Everything(), schemes=[SCHEMES["foreground"]], levelling="none", scenes=scenes
        )
    assert made.schemes["foreground"]["kbit_per_sensor"] > 0.3


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
