import json

import numpy as np
import pytest

from toolkit.boxes import count_points
from toolkit.detection.evaluation import evaluate_dataset, format_table, save_evaluation
from toolkit.detection.fusion import late
from toolkit.detection.metrics import evaluate
from toolkit.detection.survey import survey
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import HEAVY, VEHICLE, Detections, Objects
from toolkit.points import centred_in
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
SENSORS = tuple(
    Sensor(f"s{k}", DepthCamera(width=80, height=60, stride=1), look((x, 0.0, 5.2), heading, tilt=0.2))
    for k, (x, heading) in enumerate([(-30.0, 0.0), (30.0, np.pi), (0.0, 1.5)])
)


class Recording:
    """Cars in a row, one of them outside the area; every sensor sees ground, and has its own depth for each frame."""

    site = Site("somewhere", AREA)
    sensors = SENSORS

    def __len__(self):
        return 5

    def __getitem__(self, k):
        x = np.array([-45.0, -20, -10, 0, 10, 20]) + k
        boxes = np.column_stack([x, 0 * x, 0 * x + 0.75, 0 * x + 4, 0 * x + 2, 0 * x + 1.5, 0 * x])
        rng = np.random.default_rng(k)
        depths = tuple(rng.uniform(1, 40, s.model.shape).astype(np.float32) for s in SENSORS)
        labels = np.array([VEHICLE] * 5 + [HEAVY])
        return Frame(SENSORS, depths, Objects(boxes, labels), index=k)


class Oracle:
    """Knows the truth of the frame that was read last; finds cars on which there are more points than `needed`."""

    def __init__(self, needed=0):
        self.needed, self.calls, self.current = needed, 0, 0

    def __call__(self, points):
        self.calls += 1
        boxes = Recording()[self.current].objects.boxes
        counts = count_points(points, boxes)
        return Detections(boxes[counts > self.needed], counts[counts > self.needed] / 1000)


class Watched(Recording):
    """Tells the oracle which frame is read."""

    def __init__(self, oracle):
        self.oracle = oracle

    def __getitem__(self, k):
        self.oracle.current = k
        return super().__getitem__(k)


def run(oracle=None, **options):
    oracle = oracle or Oracle()
    return evaluate_dataset(Watched(oracle), oracle, **options)


def test_an_oracle_is_perfect_though_it_reports_what_is_not_scored():
    rows = run(Oracle(needed=-1), sensor_sets=[None, [1]])
    assert len(rows) == 3 * 2 * 3
    assert all(row.ap == row.recall == row.precision == 1 for row in rows)
    assert [row.scheme for row in rows[::6]] == ["early", "late", "hybrid"]
    assert [row.sensors for row in rows[:6:3]] == [(0, 1, 2), (1,)]
    assert [row.iou for row in rows[:3]] == [0.7, 0.8, 0.9]


def test_rows_are_what_fusion_and_metrics_give():
    oracle = Oracle(needed=2)
    (row,) = run(oracle, schemes=["late"], sensor_sets=[["s0", 2]], iou_thresholds=[0.7], noise_seed=None)
    fused, truths, counted = [], [], []
    for k in range(5):
        oracle.current, scene = k, Recording()[k]
        fused.append(late(scene, oracle, [0, 2], site=AREA))
        truths.append(scene.objects)
        counted.append(centred_in(scene.objects.boxes, AREA))
    expected = evaluate([f.detections for f in fused], truths, iou_thresholds=[0.7], counted=counted)[0.7]
    assert (row.ap, row.recall, row.precision) == (expected.ap, expected.recall, expected.precision)
    assert 0 < row.recall < 1
    assert row.kbit_per_sensor == pytest.approx(np.mean([f.bits for f in fused]) / 1000)
    np.testing.assert_array_equal(row.curve.recall, expected.curve.recall)


def test_sensor_sets_share_what_each_sensor_detects():
    oracle = Oracle()
    run(oracle, schemes=["late"], sensor_sets=[[0], [1], [0, 1], [0, 1, 2], [2, 1]])
    assert oracle.calls == 5 * 3
    oracle = Oracle()
    run(oracle, schemes=["late", "hybrid"], sensor_sets=[[0, 1], [1, 0]])
    assert oracle.calls == 5 * (2 + 2)


def test_same_seed_same_rows_and_other_seeds_other_noise():
    options = {"schemes": ["early"], "iou_thresholds": [0.7]}
    sent = [run(noise_seed=seed, **options)[0].kbit_per_sensor for seed in (1, 1, 2, 3, 4)]
    assert sent[0] == sent[1]
    assert len(set(sent)) > 1


def test_frames_and_progress():
    told = []
    run(schemes=["early"], frames=3, progress=told.append)
    assert told == [1, 2, 3]
    run(schemes=["early"], frames=99, progress=told.append)
    assert told[-1] == 5


def test_published_protocol_knows_only_what_is_in_the_area():
    rows = run(Oracle(-1), schemes=["early"], iou_thresholds=[0.7], protocol="published")
    assert rows[0].precision < 1  # the car outside is a false alarm


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"schemes": ["middle"]}, "early"),
        ({"sensor_sets": [[9]]}, "no sensor 9"),
        ({"frames": 0}, "a frame to evaluate"),
        ({"frames": 1.5}, "1.5"),
        ({"sensor_sets": [[0, "s0"]]}, r"chosen once only, got \[0, 's0'\]"),
        ({"radius": -1.0}, "hybrid_radius must be finite and at least 0 m"),
        ({"codec": "paper"}, "codec"),
        ({"sensor_sets": []}, "a sensor set"),
        ({"iou_thresholds": [7.0]}, "7"),
    ],
)
def test_bad_requests_are_refused(options, message):
    with pytest.raises((ValueError, TypeError), match=message):  # TypeError: the literal, where shapes are checked
        run(**options)


def test_table_and_files(tmp_path):
    rows = run(schemes=["early", "late"], sensor_sets=[[0, 2], None], iou_thresholds=[0.5, 0.7])
    lines = format_table(rows).splitlines()
    assert lines[0].split() == ["scheme", "sensors", "AP@0.5", "AP@0.7", "recall@0.5", "kbit/sensor", "ms/frame"]
    assert [line.split()[:2] for line in lines[1:]] == [
        ["early", "0,2"], ["early", "0,1,2"], ["late", "0,2"], ["late", "0,1,2"],
    ]  # fmt: skip
    save_evaluation(rows, tmp_path / "out")
    written = json.loads((tmp_path / "out" / "table.json").read_text())
    assert written["rows"] == json.loads(json.dumps([row.as_dict() for row in rows]))
    assert {"scheme", "sensors", "iou", "ap", "recall", "kbit_per_sensor", "ms_per_frame"} <= written["rows"][0].keys()
    source = written["provenance"]
    assert (source["dataset"], source["detector"], source["frames"], source["noise_seed"]) == (
        "Watched",
        "Oracle",
        5,
        0,
    )
    assert (source["site"], source["hybrid_radius"], source["iou"]) == ("somewhere", 20.0, [0.5, 0.7])
    assert source["schemes"].keys() == {"early", "late"}
    assert {"dataset_sha256", "detector_digest", "codec", "coview", "protocol", "metric", "label"} <= source.keys()
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"pr_0.5.png", "pr_0.7.png", "table.json"}


def test_without_any_truth_ap_is_null_in_json():
    row = run(schemes=["late"], iou_thresholds=[0.7], label="pedestrian")[0]
    assert row.as_dict()["ap"] is None
    assert "nan" in format_table([row])


def test_survey_counts_what_stands_in_the_area():
    found = survey(Recording(), noise_seed=3)
    assert found.frames == 5
    assert found.objects_per_frame == {"vehicle": 4, "cyclist": 0, "pedestrian": 0, "heavy": 1}
    assert found.counts.shape == (20, 3)
    assert found.unseen([]) == 1
    assert found.unseen([0, 1, 2]) <= found.unseen([0])
    rows = run(schemes=["early"], iou_thresholds=[0.7], noise_seed=3)
    assert found.kbit_per_sensor.mean() == pytest.approx(rows[0].kbit_per_sensor)
    assert found.as_dict([[0, 2]])["unseen"].keys() == {"0,2"}
    json.dumps(found.as_dict([[0]]))
    assert {"dataset", "frames", "noise_seed", "codec", "coview", "site"} <= found.as_dict([[0]])["provenance"].keys()
