"""`evaluate_recording` on clouds of an unknown place."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

from examples.differences.scheme import ForegroundDifferences
from toolkit.calibration.place import Place, Stand
from toolkit.calibration.recording_scenes import Scenes, learn_sample_scenes
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.evaluation_files import save_evaluation
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES
from toolkit.detection.view import LinkMemory, stand_view
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Detections, Objects
from toolkit.runtime.run import Processes
from toolkit.sensors.models import RowLidar

CAR = np.array([[10.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]])


def samples():
    for k in range(2):
        clouds = tuple(
            SensorCloud(
                name, np.tile([10.0 - x, 0.0, -2.0], (8, 1)).astype(np.float32), pose(x, 0.0, 3.0)
            )
            for name, x in (("a", -1.0), ("b", 1.0))
        )
        yield Frame.of_clouds(str(k), clouds, Objects(CAR), problems={"doubled labels": 1})


class Recorded(list):
    """Frames of a place that nobody knows."""

    site = None


def evaluate(frames, *schemes, scenes=None, **options):
    asked = Comparison(
        schemes=[None if name is None else SCHEMES[name] for name in schemes], **options
    )
    return evaluate_recording(
        Recorded(frames), Everything(), asked, place=Place("none"), scenes=scenes
    )


class Everything:
    """Says that there is a car, as sure as it has points."""

    labels = ("vehicle",)

    def __call__(self, points):
        return Detections(CAR, np.array([len(points) / 20]))


def test_schemes_on_clouds(tmp_path):
    made = evaluate(samples(), *PAPER_SCHEMES)
    assert list(made.schemes) == ["early", "late", "hybrid"]
    np.testing.assert_allclose([row.ap for row in made.breakdown if row.truths], 1.0)
    assert [(row.ap, row.truths) for row in made.rows] == [(1.0, 2)] * 9
    assert made.provenance["protocol"] == "measured"
    assert made.schemes["early"]["kbit_per_sensor"] == pytest.approx(8 * 96 / 1000)
    assert made.schemes["late"]["kbit_per_sensor"] == pytest.approx(0.256)
    assert made.schemes["late"]["problems"] == {"doubled labels": 2}
    save_evaluation(made, tmp_path)
    content = json.loads((tmp_path / "table.json").read_text())
    assert len(content["breakdown"]) == len(made.breakdown)
    assert {row["scheme"] for row in content["breakdown"]} == {"early", "late", "hybrid"}
    assert "kbit/sensor" in made.text()


@pytest.mark.slow
def test_loads_and_given_scenes_are_in_the_results():
    made = evaluate(samples(), "early", rate=10.0)
    assert made.schemes["early"]["load"]["mbit_per_s"] == pytest.approx(2 * 8 * 96 * 10 / 1e6)
    assert "on a link at 10 Hz" in made.text()
    assert "load" not in evaluate(samples(), None, rate=10.0).schemes["all clouds"]
    learnt = learn_sample_scenes(still(5))["a"].scene
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = evaluate([list(still())[-1]], "foreground", scenes=Scenes([], [learnt]))
    assert made.schemes["foreground"]["kbit_per_sensor"] > 0.3


@pytest.mark.slow
def test_sensor_sets_are_named_by_their_rows():
    made = evaluate(samples(), None, sensor_sets=[["b"]])
    assert list(made.schemes) == ["all clouds"]
    assert made.schemes["all clouds"]["kbit_per_sensor"] is None
    assert made.rows[0].sensors == (1,)
    made = evaluate(samples(), "early", sensor_sets=[["b"], None])
    assert list(made.schemes) == ["early 1", "early 0,1"]


@pytest.mark.slow
def test_the_number_of_workers_changes_nothing_and_no_breakdown_is_made():
    asked = Comparison(schemes=["early"], breakdown=False)
    one, two = (
        evaluate_recording(
            Recorded(samples()),
            Everything(),
            asked,
            place=Place("none"),
            run=Processes(workers=count),
        )
        for count in (1, 2)
    )
    assert one.rows[0].ap == two.rows[0].ap == 1
    assert two.breakdown == ()


@pytest.mark.slow
def test_what_cannot_be_evaluated_is_refused():
    with pytest.raises(ValueError, match="need one frame"):
        evaluate([], None)
    with pytest.raises(ValueError, match="knows vehicle only, not cyclist"):
        evaluate(samples(), None, classes=["cyclist"])
    with pytest.raises(ValueError, match="no sensor 'c'"):
        evaluate(samples(), None, sensor_sets=[["c"]])


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
        yield Frame.of_clouds(str(k), (SensorCloud("a", points, pose(z=3.0)),), Objects(CAR))


def test_schemes_of_images_learn_scenes_and_refer_to_frames_before():
    made = evaluate(still(), "early", "foreground", "late")
    figures = made.schemes["foreground"]
    assert figures["images"] == {
        "a": {"points": 6 * 3604, "points in a cell with a nearer one": 24}
    }
    assert 0 < figures["kbit_per_sensor"] < 1 < 100 < made.schemes["early"]["kbit_per_sensor"]
    assert "images" not in made.schemes["early"]
    assert (
        "a: of 21624 points its images leave out 24 points in a cell with a nearer one"
        in made.text()
    )
    coded = evaluate(still(), "early", "late", codec=RangeImages())
    assert figures["kbit_per_sensor"] < coded.schemes["early"]["kbit_per_sensor"] < 20
    assert "images" in coded.schemes["early"]
    assert "images" not in coded.schemes["late"]
    # Somebody stands still in the last frames: what the first of them brings costs nothing in the
    # next.
    last, before = list(still())[-1], next(iter(still()))
    scenes, memory, bits = Scenes(list(still(6))), LinkMemory(), []
    for k in range(9):
        frame = replace(last if k >= 6 else before, index=k)
        stand = Stand(np.array([-50.0, -50, 50, 50]), np.zeros(2))
        view = stand_view(frame, Everything(), stand, scenes=scenes, memory=memory)
        bits.append(ForegroundDifferences().fuse(view, [0]).bits.item())
    assert bits[7] == bits[8] < bits[6]
