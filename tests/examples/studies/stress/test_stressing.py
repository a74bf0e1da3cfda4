"""Schemes under stress, on flat ground with a moving block."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from examples.differences.scheme import ForegroundDifferences
from examples.studies.stress.conditions import Condition, StressQuestion, make_systems
from examples.studies.stress.stressing import KeptDetections, Trial, choose_kinds, run_stress
from toolkit.datasets.recording_views import Reads
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.paper_schemes import Early
from toolkit.frame import Frame
from toolkit.objects import Detections, Objects
from toolkit.runtime.cache import Cache
from toolkit.runtime.run import Run
from toolkit.sites.site import Site


def ask(recording, detector, *, schemes, kinds):
    return run_stress(
        recording, detector, StressQuestion(schemes=tuple(schemes), kinds=tuple(kinds))
    )


def by(rows, **wanted):
    return [
        row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())
    ]


@pytest.fixture(scope="module")
def rows(driving, tops):
    both = ask(
        driving(), tops(), schemes=["early", "foreground"], kinds=("bytes", "silent", "frozen")
    )
    return both + ask(driving(), tops(), schemes=["foreground"], kinds=("delay", "rate"))


@pytest.mark.slow
def test_bytes_are_those_of_an_evaluation_after_the_first_second(rows, driving, tops):
    class Later:
        site, sensors = driving.site, driving.sensors

        def __len__(self):
            return 20

        def __getitem__(self, k):
            return replace(driving()[k + 10], index=k + 10)

    found = {(row.scheme, row.codec): row for row in by(rows, kind="bytes")}
    steps = ["2 cm", "4 cm", "8 cm"]
    assert list(found) == [
        ("early", "paper"),
        *(("early", s) for s in steps),
        *(("foreground", s) for s in steps),
    ]
    exact = evaluate_recording(
        Later(),
        tops(),
        Comparison(schemes=["early"], iou_thresholds=[0.7]),
        reads=Reads(noise_seed=None),
    )[0]
    assert found["early", "paper"].judged.ap == pytest.approx(exact.ap, abs=0.02)
    assert found["early", "paper"].kbit_per_sensor == pytest.approx(exact.kbit_per_sensor, rel=0.02)
    early = [found["early", step].kbit_per_sensor for step in steps]
    assert exact.kbit_per_sensor > early[0] > early[1] > early[2]
    kbit = [found["foreground", step].kbit_per_sensor for step in steps]
    assert kbit[0] > kbit[1] > kbit[2] > 0.3
    judged = found["foreground", "2 cm"].judged
    assert 0.5 < judged.low <= judged.ap <= judged.high <= 1
    assert judged.ap > 0.85
    assert (judged.vehicles, judged.frames, judged.kind) == (20, 20, "vehicle")


def test_delays_rates_and_silent_sensors_cost_what_drives(rows):
    late = {row.level: row for row in by(rows, kind="delay")}
    assert late["0.3 s"].judged.ap == 0
    assert late["0.3 s"].age == pytest.approx(0.35, abs=0.06)
    assert (
        late["0.3 s, tracks"].judged.ap > 0.3
    )  # sensors of different ages smear the car, which no track can mend
    assert late["0.3 s, tracks"].kbit_per_sensor == late["0.3 s"].kbit_per_sensor
    rate = by(rows, kind="rate", level="every 5 frames")[0]
    assert rate.age == pytest.approx(0.2, abs=0.01)
    assert rate.judged.ap < by(rows, kind="rate", level="every 5 frames, tracks")[0].judged.ap
    assert [row.level for row in by(rows, kind="silent", scheme="early")] == [
        *("a", "a, tracks", "b", "b, tracks")
    ]
    assert all(row.judged.ap > 0.5 for row in by(rows, kind="silent"))
    assert all(row.judged.ap < 0.5 for row in by(rows, kind="frozen", scheme="early"))


@pytest.mark.slow
def test_differences_show_what_foreground_does_in_fewer_bytes_unless_messages_are_lost(
    monkeypatch, driving, tops
):
    """Where the block stands still; with losses the centre waits for whole images, less so where
    all refer to these."""
    monkeypatch.setattr("examples.studies.stress.conditions.LOSSES", ((0.3, None),))

    standing = driving()
    here, away = standing.box(0), np.array([[40.0, 0, 0, 0, 0, 0, 0]])
    vars(standing)["box"] = lambda k: here + (k < 8) * away
    key = ForegroundDifferences(refers_to="key", name="to key")
    rows = ask(
        standing,
        tops(),
        schemes=["foreground", ForegroundDifferences(), key],
        kinds=("bytes", "loss"),
    )
    found = {(row.kind, row.level, row.scheme): row for row in rows if row.codec == "2 cm"}
    nothing = "nothing goes wrong"
    whole, previous, to_key = (
        found["bytes", nothing, name] for name in ("foreground", "differences", "to key")
    )
    assert previous.judged.ap == to_key.judged.ap == whole.judged.ap
    assert previous.kbit_per_sensor < 0.95 * whole.kbit_per_sensor
    assert to_key.kbit_per_sensor < 0.95 * whole.kbit_per_sensor
    lossy = [found["loss", "30%", name] for name in ("foreground", "differences", "to key")]
    ages = [row.age for row in lossy]
    assert 0 < ages[0] <= ages[2] < ages[1]
    assert lossy[1].kbit_per_sensor == pytest.approx(previous.kbit_per_sensor)
    assert lossy[2].kbit_per_sensor == pytest.approx(to_key.kbit_per_sensor)
    assert {row.codec for row in rows if row.kind == "bytes"} == {"2 cm", "4 cm", "8 cm"}


def test_kinds_that_a_recording_can_show(driving):
    assert "delay" in choose_kinds(driving())
    assert choose_kinds(driving(apart=5.0)) == (
        "bytes",
        "pose",
        "mounting",
        "silent",
        "pairs",
        "blinded",
        "frozen",
    )
    assert choose_kinds(driving(), ["loss"]) == ("loss",)
    with pytest.raises(
        ValueError, match=r"'delay' needs frames at most 0\.5 s apart, these are 5 s"
    ):
        choose_kinds(driving(apart=5.0), ["delay"])
    with pytest.raises(ValueError, match="choose among bytes"):
        choose_kinds(driving(), ["storm"])


def test_pose_errors_and_blinded_sensors_far_apart_and_progress(driving, tops):
    done = []
    question = StressQuestion(schemes=("foreground",), kinds=("pose", "blinded"))
    run = Run(frames=3, progress=lambda *counts: done.append(counts))
    rows = run_stress(driving(4, 5.0), tops(), question, run)
    assert [row.level for row in rows[:6]] == [
        f"{x} m, {x}°" for x in ("0", "0.1", "0.2", "0.4", "0.6", "1")
    ]
    assert [row.level for row in rows[6:]] == ["a", "b"]
    assert [row.amount for row in rows] == [0, 0.1, 0.2, 0.4, 0.6, 1, None, None]
    assert done[0] == ("frames under stress", 1, 24)
    assert done[-1] == ("frames under stress", 24, 24)
    assert {row.judged.frames for row in rows} == {3}
    assert len({row.judged.ap for row in rows[:3]} | {row.kbit_per_sensor for row in rows}) > 2


def test_frames_of_the_first_second_alone_are_too_few(driving, tops):
    question = StressQuestion(schemes=("early",), kinds=("bytes",))
    assert driving()[1].time - driving()[0].time == pytest.approx(0.1)
    said = "10 frames leave no frame to score, because the first 1 s after traffic starts is never"
    with pytest.raises(ValueError, match=said):
        run_stress(driving(), tops(), question, Run(frames=10))
    rows = run_stress(driving(), tops(), question, Run(frames=12))
    assert {row.judged.frames for row in rows} <= {1, 2}


def without_interval(row):
    # NaN in a process of its own
    return replace(row, judged=replace(row.judged, low=0.0, high=1.0))


def test_bad_questions_and_the_same_rows_in_processes(driving, tops):
    for wrong, said in (
        ({"schemes": ()}, "name at least one IoU and one scheme"),
        *(
            ({"iou": ()}, "name at least one IoU and one scheme"),
            ({"schemes": ("middle",)}, "choose among early"),
        ),
        ({"label": "ox"}, "ox"),
    ):
        with pytest.raises(ValueError, match=said):
            StressQuestion(**wrong)
    question, finished = StressQuestion(schemes=("early",), kinds=("silent",)), []
    alone = run_stress(driving(4, 5.0), tops(), question)
    shared = run_stress(driving(4, 5.0), tops(), question, Run(workers=2), finished=finished.append)
    plain, *others = (
        [without_interval(row) for row in rows]
        for rows in (alone, shared, itertools.chain(*finished))
    )
    assert others == [plain, plain]


SITE = Site("plain", np.array([-20.0, -20.0, 20.0, 20.0]))
TRUTH = np.array([[0.0, 0, 1, 4, 2, 2, 0], [10, 0, 1, 4, 2, 2, 0], [30, 0, 1, 4, 2, 2, 0]])


def trial(ious=(0.7,)):
    return Trial(make_systems([Early()], "pose")[0], "vehicle", ious, SITE.area)


def frame(time=0.0):
    return Frame((), (), Objects(TRUTH, np.zeros(3, int), np.arange(3)), time, 0)


def test_figures_are_at_each_iou():
    counted = trial((0.5, 0.9))
    shifted = TRUTH[:2] + np.array([0.4, 0, 0, 0, 0, 0, 0])  # IoU 0.82
    for boxes, scores in ((shifted, [0.9, 0.8]), (TRUTH[:1], [0.7])):
        counted.add(
            frame(), SITE, Detections(boxes, np.array(scores)), 2.0 * len(boxes), 0.1 * len(boxes)
        )
    loose, strict = counted.rows(Condition("pose", "some", amount=0.2), 0)
    assert (loose.iou, strict.iou, loose.kind, loose.level, loose.amount) == (
        0.5,
        0.9,
        "pose",
        "some",
        0.2,
    )
    assert (loose.judged.ap, loose.judged.recall, loose.judged.precision) == (0.75, 0.75, 1)
    assert strict.judged.ap == pytest.approx(
        1 / 12
    )  # the third best of three is true, of four to find
    assert (loose.judged.vehicles, loose.judged.frames) == (
        4,
        2,
    )  # what stands outside the area does not count
    assert (loose.kbit_per_sensor, loose.age) == (3, pytest.approx(0.15))
    assert (loose.judged.low, loose.judged.high) == loose.tally.interval(seed=0)
    assert loose.tally.truths.tolist() == [2, 2]


def test_tracks_go_on_and_restart():
    counted, here = trial(), Detections(TRUTH[:1], np.array([0.9]))
    for k in range(10):
        moved = Detections(TRUTH[:1] + np.array([1.0 * k, 0, 0, 0, 0, 0, 0]), np.array([0.9]))
        last = counted.track(moved, 0.1 * k + 0.2, 0.2, begins=k == 0)
    assert last.boxes[0, 0] == pytest.approx(9 + 2, abs=0.3)
    # nothing new has arrived: the track goes on, and what is no newer is no second measurement
    for age in (np.nan, 0.3):
        onward = counted.track(here, 1.2, age, begins=False)
        assert len(onward) == 1
        assert onward.boxes[0, 0] == pytest.approx(9 + 3, abs=0.4)
    assert counted.track(here, 0.2, 0.2, begins=True).boxes[0, 0] == 0
    assert len(counted.track(here, 0.3, np.nan, begins=True)) == 0


class Counting:
    digest = "counting"
    labels: tuple[str, ...] | None = None

    def __init__(self, at=0.0):
        self.calls, self.at = 0, at

    def __call__(self, points):
        self.calls += 1
        box = np.array([[points[:, 0].sum() + self.at, 0, 1, 4, 2, 1.5, 0.25]])
        return Detections(box, np.array([0.75]), np.array([3]))


POINTS = np.array([[1, 2, 3], [4, 5, 6]], np.float32)


def same(one, other):
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("boxes", "scores", "labels")
    )


def test_the_same_points_are_detected_once_with_their_labels():
    detector = Counting()
    kept = KeptDetections(detector)
    first, again = kept(POINTS), kept(POINTS.copy())
    assert same(first, again)
    assert same(first, Counting()(POINTS))
    assert (detector.calls, kept.asked) == (1, 1)
    for other in (
        *(
            POINTS[::-1],
            POINTS[:1],
            POINTS + np.float32(0.01),
            POINTS.reshape(-1)[:3].reshape(1, 3),
            POINTS[:0],
        ),
    ):
        kept(other)
    assert detector.calls == 5  # the first point alone comes twice
    detector = Counting()
    detector.labels = ("cyclist", "vehicle")
    kept = KeptDetections(detector)
    assert kept.labels == ("vehicle", "cyclist")
    assert KeptDetections(Counting()).labels is None
    assert KeptDetections.from_detector(kept) is kept
    assert same(KeptDetections.from_detector(detector)(POINTS), kept(POINTS))


def test_detections_on_disk_belong_to_a_detector_with_a_digest(tmp_path):
    first = KeptDetections(Counting(), Cache(tmp_path / "kept"))(POINTS)
    later = Counting(at=99.0)
    assert same(KeptDetections(later, Cache(tmp_path / "kept"))(POINTS), first)
    assert later.calls == 0
    other = Counting()
    other.digest = "another"
    KeptDetections(other, Cache(tmp_path / "kept"))(POINTS)
    assert other.calls == 1

    def detect(points):
        return Detections.empty()

    assert len(KeptDetections(detect)(POINTS)) == 0
    with pytest.raises(ValueError, match="needs an attribute digest"):
        KeptDetections(detect, Cache(tmp_path / "kept"))
