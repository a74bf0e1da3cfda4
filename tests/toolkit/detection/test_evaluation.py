"""`evaluate_recording`: rows, tables and files; with the clustering detector it says what it always
said."""

import json
from dataclasses import replace

import numpy as np
import pytest

from examples.differences.scheme import ForegroundDifferences
from toolkit.bodies.body import include_mirrors
from toolkit.bodies.fleet import catalogue
from toolkit.boxes import count_points
from toolkit.calibration.empty_scene import learn_empty_scenes
from toolkit.calibration.recording_scenes import Scenes
from toolkit.datasets.recording_views import ReadRecording, Reads, read_frame
from toolkit.detection.cluster import ClusterDetector
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.evaluation_files import save_evaluation
from toolkit.detection.evaluation_tables import format_table
from toolkit.detection.link.range_images import RangeImages
from toolkit.detection.metrics import evaluate
from toolkit.detection.schemes import fuse_frame
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import HEAVY, VEHICLE, Detections, Objects
from toolkit.points import frame_points, has_centre_inside
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.run import Processes
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_profiles import TYPICAL
from toolkit.sensors.error_terms import Calibration
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

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


class Oracle:
    """Knows the truth of the frame that was read last; finds cars on which there are more points
    than `needed`."""

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
    reads = Reads(
        **{
            name: options.pop(name)
            for name in ("errors", "noise_seed", "frames")
            if name in options
        }
    )
    more = {name: options.pop(name) for name in ("run",) if name in options}
    return evaluate_recording(Watched(oracle), oracle, Comparison(**options), reads=reads, **more)


def test_oracles_are_perfect_and_detect_once_per_sensor():
    rows = run(Oracle(needed=-1), sensor_sets=[None, [1]])
    assert len(rows) == 3 * 2 * 3
    assert all(row.ap == row.recall == row.precision == 1 for row in rows)
    assert [row.scheme for row in rows[::6]] == ["early", "late", "hybrid"]
    assert [row.sensors for row in rows[:6:3]] == [(0, 1, 2), (1,)]
    assert [row.iou for row in rows[:3]] == [0.7, 0.8, 0.9]
    oracle = Oracle()
    run(oracle, schemes=["late"], sensor_sets=[[0], [1], [0, 1], [0, 1, 2], [2, 1]])
    assert oracle.calls == 5 * 3
    oracle = Oracle()
    run(oracle, schemes=["late", "hybrid"], sensor_sets=[[0, 1], [1, 0]])
    assert oracle.calls == 5 * (2 + 2)
    row = run(schemes=["late"], iou_thresholds=[0.7], classes=["pedestrian"])[0]
    assert row.as_dict()["ap"] is None
    assert "nan" in format_table([row])


class Twice(Oracle):
    """Reports every object, and the truck as a vehicle too."""

    def __call__(self, points):
        objects = Recording()[self.current].objects
        boxes = np.concatenate([objects.boxes, objects.boxes[-1:]])
        return Detections(
            boxes, np.linspace(0.9, 0.5, len(boxes)), np.append(objects.labels, VEHICLE)
        )


def test_the_second_label_of_a_truck_is_a_false_alarm_at_the_threshold_but_not_in_ap():
    evaluation = run(Twice(), schemes=["early"], classes=["vehicle", "heavy"])
    assert {row.ap for row in evaluation} == {1.0}
    assert {row.false_alarms_per_frame for row in evaluation} == {0.0}
    vehicle, heavy = evaluation.classes
    assert (vehicle.recall, vehicle.false_alarms_per_frame, vehicle.detections) == (1.0, 1.0, 25)
    assert vehicle.precision == pytest.approx(4 / 5)
    assert vehicle.reliability.count.sum() == 25
    assert (heavy.recall, heavy.precision, heavy.false_alarms_per_frame) == (1.0, 1.0, 0.0)


def test_rows_are_of_fusion_and_metrics_and_repeat_with_a_seed():
    oracle = Oracle(needed=2)
    (row,) = run(
        oracle, schemes=["late"], sensor_sets=[["s0", 2]], iou_thresholds=[0.7], noise_seed=None
    )
    fused, truths, counted = [], [], []
    for k in range(5):
        oracle.current, scene = k, Recording()[k]
        fused.append(fuse_frame("late", scene, oracle, [0, 2], site=AREA))
        truths.append(scene.objects)
        counted.append(has_centre_inside(scene.objects.boxes, AREA))
    expected = evaluate(
        [f.detections for f in fused], truths, iou_thresholds=[0.7], counted=counted
    )[0.7]
    assert (row.ap, row.recall, row.precision) == (expected.ap, expected.recall, expected.precision)
    assert 0 < row.recall < 1
    assert row.kbit_per_sensor == pytest.approx(np.mean([f.bits for f in fused]) / 1000)
    np.testing.assert_array_equal(row.curve.recall, expected.curve.recall)
    options = {"schemes": ["early"], "iou_thresholds": [0.7]}
    sent = [run(noise_seed=seed, **options)[0].kbit_per_sensor for seed in (1, 1, 2, 3, 4)]
    assert sent[0] == sent[1]
    assert len(set(sent)) > 1
    told = []
    listening = Processes(progress=lambda *stage: told.append(stage))
    run(schemes=["early"], frames=3, run=listening)
    assert told == [("frame", done, 3) for done in (1, 2, 3)]
    run(schemes=["early"], frames=99, run=listening)
    assert told[-1] == ("frame", 5, 5)
    rows = run(Oracle(-1), schemes=["early"], iou_thresholds=[0.7], protocol="published")
    assert rows[0].precision < 1  # the car outside is a false alarm


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(({"schemes": ["middle"]}, "early"), ({"sensor_sets": [[9]]}, "no sensor 9")),
        *(({"frames": 0}, "need one frame"), ({"frames": 1.5}, "1.5")),
        ({"sensor_sets": [[0, "s0"]]}, r"chosen once only, got \[0, 's0'\]"),
        ({"radius": -1.0}, "hybrid_radius must be finite and at least 0 m"),
        *(
            ({"codec": "paper"}, "codec"),
            ({"sensor_sets": []}, "a sensor set"),
            ({"iou_thresholds": [7.0]}, "7"),
        ),
    ],
)
def test_bad_requests_are_refused(options, message):
    with pytest.raises(
        (ValueError, TypeError), match=message
    ):  # TypeError: the literal, where shapes are checked
        run(**options)


def test_table_and_files(tmp_path):
    rows = run(schemes=["early", "late"], sensor_sets=[[0, 2], None], iou_thresholds=[0.5, 0.7])
    lines = format_table(rows).splitlines()
    assert lines[0].split() == [
        "scheme",
        "sensors",
        "AP@0.5",
        "AP@0.7",
        "recall@0.5",
        "kbit/sensor",
        "ms/frame",
    ]
    assert [line.split()[:2] for line in lines[1:]] == [
        *(["early", "0,2"], ["early", "0,1,2"], ["late", "0,2"], ["late", "0,1,2"])
    ]
    save_evaluation(rows, tmp_path / "out")
    written = json.loads((tmp_path / "out" / "table.json").read_text())
    assert written["rows"] == json.loads(json.dumps([row.as_dict() for row in rows]))
    assert {
        "scheme",
        "sensors",
        "iou",
        "ap",
        "recall",
        "kbit_per_sensor",
        "ms_per_frame",
    } <= written["rows"][0].keys()
    source = written["provenance"]
    assert (source["dataset"], source["detector"], source["frames"], source["noise_seed"]) == (
        *("Watched", "Oracle", 5, 0),
    )
    assert (source["site"], source["hybrid_radius"], source["iou"]) == (
        "somewhere",
        20.0,
        [0.5, 0.7],
    )
    assert source["schemes"].keys() == {"early", "late"}
    assert {
        "dataset_sha256",
        "detector_digest",
        "codec",
        "coview",
        "protocol",
        "metric",
        "label",
    } <= source.keys()
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "pr_0.5.png",
        "pr_0.7.png",
        "table.json",
    }


CAMERA = DepthCamera(width=200, height=150)
POSTS = (
    Sensor("west", CAMERA, look((-22.0, -16.0, 6.0), 0.7, tilt=0.3)),
    Sensor("east", CAMERA, look((22.0, 16.0, 5.0), -2.4, tilt=0.3)),
    Sensor(
        "lidar",
        SpinningLidar(channels=24, azimuth_step=float(np.deg2rad(1.0))),
        pose(3.0, 9.0, 3.5, yaw=2.0),
    ),
)
SITE = Site("somewhere", np.array([-20.0, -14, 20, 14]), sensors=POSTS)
GOLDEN = {  # AP at IoU 0.7 and 0.5, recall at 0.7, kbit per sensor
    ("early", (0, 1, 2)): (1.0, 1.0, 1.0, 155.616),
    ("early", (0,)): (0.35714285714285715, 0.7142857142857143, 0.35714285714285715, 130.336),
    ("early", (2, 0)): (0.903061224489796, 1.0, 0.9285714285714286, 171.792),
    ("late", (0, 1, 2)): (
        0.69421768707483,
        0.8622448979591839,
        0.7857142857142857,
        1.0808888888888888,
    ),
    ("late", (0,)): (
        0.35714285714285715,
        0.7142857142857143,
        0.35714285714285715,
        0.9386666666666666,
    ),
    ("late", (2, 0)): (0.6650175221603793, 1.0, 0.7142857142857143, 1.1093333333333333),
    ("hybrid", (0, 1, 2)): (
        0.892857142857143,
        0.892857142857143,
        0.9285714285714286,
        78.58488888888888,
    ),
    ("hybrid", (0,)): (
        0.35714285714285715,
        0.7142857142857143,
        0.35714285714285715,
        89.70666666666666,
    ),
    ("hybrid", (2, 0)): (0.8172541743970314, 1.0, 0.8571428571428571, 78.29333333333334),
}


class Rendered:
    site, sensors = SITE, POSTS

    def __init__(self, frames: int = 3) -> None:
        rng, bodies = np.random.default_rng(5), tuple(map(include_mirrors, catalogue()))
        renderer = Renderer(SITE, bodies, POSTS, threads=1)
        self.empty = Frame(POSTS, tuple(renderer.background), Objects.empty())
        self.frames = []
        for k in range(frames):
            chosen, cells = rng.integers(12, size=8), rng.permutation(20)[:8]
            xy = np.column_stack([cells % 5 - 2, cells // 5 - 1.5]) * [11.0, 9.0]
            sizes = np.array([bodies[b].size for b in chosen])
            boxes = np.column_stack([xy, sizes[:, 2] / 2, sizes, rng.uniform(-np.pi, np.pi, 8)])
            objects = Objects(boxes, np.array([bodies[b].label for b in chosen]))
            rendered = renderer.render(Snapshot(objects, chosen, 1.0 * k))
            self.frames.append(Frame(POSTS, rendered.measurements, objects, index=k))

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: int) -> Frame:
        return self.frames[k]


@pytest.fixture(scope="module")
def golden_rows():
    recording = Rendered()
    sweeps = [
        frame_points(recording.empty, area=SITE, rng=np.random.default_rng(seed))
        for seed in range(4)
    ]
    detector = ClusterDetector.learn([cloud for sweep in sweeps for cloud in sweep])
    return evaluate_recording(
        recording,
        detector,
        Comparison(sensor_sets=[None, ["west"], [2, 0]], iou_thresholds=(0.5, 0.7), radius=9.0),
    )


def test_figures_are_the_same_to_the_last_digit(golden_rows):
    found = {
        (row.scheme, row.sensors): (row.ap, low.ap, row.recall, row.kbit_per_sensor)
        for low, row in zip(golden_rows[::2], golden_rows[1::2], strict=True)
    }
    assert found == GOLDEN


class OneCar:
    """A car of which three sensors measure the same points on its roof, in ever the same place."""

    site, sensors = Site("one", AREA), SENSORS

    def __init__(self):
        roof = np.array([[x, y, 1.0] for x in np.linspace(-1.5, 1.5, 9) for y in (-0.5, 0, 0.5)])
        self.images = []
        for c, sensor in enumerate(SENSORS):
            image, way = np.zeros(sensor.model.shape, np.float32), roof - sensor.position
            rays = sensor.world_rays.T / np.linalg.norm(sensor.world_rays, axis=0)[:, None]
            nearest = np.unique(
                (rays @ (way / np.linalg.norm(way, axis=1)[:, None]).T).argmax(axis=0)
            )[: (5, 8, 4)[c]]
            image.ravel()[nearest] = (1.0 - sensor.position[2]) / sensor.world_rays[2, nearest]
            self.images.append(image)

    def __len__(self):
        return 3

    def __getitem__(self, k):
        return Frame(
            SENSORS, tuple(self.images), Objects(np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0]])), index=k
        )


def points_of(k=0, **options):
    return frame_points(read_frame(OneCar(), k, **options), area=AREA)


class Mean:
    """A car where the points lie in the mean, against where they lie without error."""

    def __init__(self):
        self.means = [cloud.mean(axis=0) for cloud in points_of(noise_seed=None)]
        self.counts = [len(cloud) for cloud in points_of(noise_seed=None)]
        assert len({*self.counts, sum(self.counts)}) == 4

    def __call__(self, points):
        if not len(points):
            return Detections.empty()
        one = self.counts.index(len(points)) if len(points) in self.counts else None
        true = (
            np.average(self.means, axis=0, weights=self.counts) if one is None else self.means[one]
        )
        box = np.array([[0.0, 0, 0.75, 4, 2, 1.5, 0]])
        box[:, :3] += points.mean(axis=0) - true
        return Detections(box, np.ones(1))


def test_errors_are_said_and_lower_the_ap():
    by_name = run(schemes=["early"], errors="typical")
    assert by_name.provenance["errors"] == {"profile": "typical", "digest": TYPICAL.digest}
    assert run(schemes=["early"]).provenance["errors"]["profile"] == "paper"
    paper, default = run(schemes=["early"], errors="paper"), run(schemes=["early"])
    assert [row.ap for row in paper] == [row.ap for row in default]
    kbit = (
        np.mean([[len(cloud) * 96 for cloud in points_of(k, errors=TYPICAL)] for k in range(3)])
        / 1000
    )
    (row,) = evaluate_recording(
        OneCar(),
        Mean(),
        Comparison(schemes=["early"], iou_thresholds=[0.5]),
        reads=Reads(errors=TYPICAL),
    )
    assert row.kbit_per_sensor == pytest.approx(kbit)
    for wrong, message in (
        ({"errors": "bad"}, "unknown error"),
        ({"errors": "poor", "noise_seed": None}, "a seed"),
    ):
        with pytest.raises(ValueError, match=message):
            run(**wrong)
    # Metamorphic: of the same draws, a larger error never raises AP, and no error at all is none.
    ious = np.arange(0.3, 1.0, 0.02).tolist()
    sums = []
    for scale in (0.0, 0.05, 0.15, 0.4, 1.2):
        errors = ErrorProfile("scaled", (Calibration(0.01 * scale, scale),))
        rows = evaluate_recording(
            OneCar(),
            Mean(),
            Comparison(schemes=["early", "late"], iou_thresholds=ious),
            reads=Reads(errors=errors),
        )
        sums.append(
            [sum(row.ap for row in rows if row.scheme == scheme) for scheme in ("early", "late")]
        )
    assert sums[0] == [len(ious), len(ious)]
    assert (np.diff(sums, axis=0) < 0).all(), sums


class Still(Recording):
    """Ground, and a block at its own depth in every frame."""

    def __getitem__(self, k):
        frame = super().__getitem__(k)
        down = [sensor.world_rays[2].reshape(sensor.model.shape) for sensor in SENSORS]
        images = [
            np.where(rays < -0.2, (0.1 - 5.2) / np.minimum(rays, -0.2), 0).astype(np.float32)
            for rays in down
        ]
        for image in images:
            image[30:34, 20 + 8 * k : 26 + 8 * k] = 6.0
        return replace(frame, measurements=tuple(images))


def test_foreground_learns_its_scenes():
    rows = evaluate_recording(
        Still(),
        Oracle(),
        Comparison(schemes=["early", "foreground"], iou_thresholds=[0.7], rate=10.0),
    )
    early, foreground = rows
    assert 0 < foreground.kbit_per_sensor < early.kbit_per_sensor / 100
    assert rows.provenance["empty_scenes"] == [
        scene.digest for scene in learn_empty_scenes(ReadRecording(Still()))
    ]
    assert [(load.scheme, load.load.one_packet) for load in rows.loads] == [
        ("early", 0.0),
        ("foreground", 1.0),
    ]
    assert rows.loads[1].load.mbit_per_s == pytest.approx(
        foreground.kbit_per_sensor * 3 * 10 / 1000
    )
    assert len(rows.as_dict()["loads"]) == 2


def test_foreground_takes_the_scenes_that_are_given():
    other = learn_empty_scenes(ReadRecording(Still(), Reads(noise_seed=3)))
    rows = evaluate_recording(
        Still(),
        Oracle(),
        Comparison(schemes=["foreground"], iou_thresholds=[0.7]),
        scenes=Scenes(Still(), other),
    )
    assert rows.provenance["empty_scenes"] == [scene.digest for scene in other]
    rows = evaluate_recording(
        Still(), Oracle(), Comparison(schemes=["early"], iou_thresholds=[0.7])
    )
    assert "empty_scenes" not in rows.provenance
    assert rows.loads == ()
    assert "loads" not in rows.as_dict()


def test_a_codec_sends_less_than_the_paper_counts():
    options = {"iou_thresholds": [0.7], "codec": RangeImages()}
    rows = evaluate_recording(
        Still(), Oracle(), Comparison(schemes=["early", "late", "hybrid"], **options)
    )
    paper = evaluate_recording(
        Still(), Oracle(), Comparison(schemes=["early", "late", "hybrid"], iou_thresholds=[0.7])
    )
    assert all(row.kbit_per_sensor > 0 for row in rows)
    assert rows[0].kbit_per_sensor < paper[0].kbit_per_sensor / 10
    assert rows[1].kbit_per_sensor <= rows[2].kbit_per_sensor < rows[0].kbit_per_sensor
    assert rows.provenance["codec"] == "RangeImages(step=0.02)"


def test_differences_remember_from_frame_to_frame(spy):
    calls = spy("toolkit.detection.view", "frame_view")
    for _ in range(2):
        rows = evaluate_recording(
            Still(),
            Oracle(),
            Comparison(schemes=["foreground", ForegroundDifferences()], iou_thresholds=[0.7]),
        )
        assert rows[1].kbit_per_sensor <= rows[0].kbit_per_sensor
    memories = [call.named["memory"] for call in calls]
    per_run = len(memories) // 2
    assert len({id(memory) for memory in memories[:per_run]}) == 1
    assert memories[0] is not memories[-1]
    assert set(memories[0]) == {(k, ForegroundDifferences().digest) for k in range(3)}
