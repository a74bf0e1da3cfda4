import hashlib
import pickle
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from placement_env.fidelity.detector import FALSE_ALARM, IOUS, Detected, Measured, detect_in_frames
from placement_env.fidelity.renders import Renders
from placement_env.protocol import Fidelity
from toolkit.boxes import count_points
from toolkit.datasets.recording_views import Reads, with_errors
from toolkit.detection.background import Background, KnownBackground
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.link.range_images import RangeImages
from toolkit.frame import Frame
from toolkit.geometry import look, pose
from toolkit.objects import HEAVY, VEHICLE, Detections, Objects
from toolkit.points import frame_points
from toolkit.runtime.cache import Cache
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = np.array([-40.0, -20.0, 40.0, 20.0])
SENSORS = tuple(
    Sensor(
        f"s{k}", DepthCamera(width=40, height=30, stride=1), look((x, 0.0, 5.2), heading, tilt=0.2)
    )
    for k, (x, heading) in enumerate([(-30.0, 0.0), (30.0, np.pi), (0.0, 1.5), (0.0, -1.5)])
)
PLACES = np.array([-45.0, -20, -10, 0, 10, 20, 30, 14])
SETS = np.array([[row >> c & 1 for c in range(4)] for row in range(16)], bool)
SCHEMES = ("early", "late", "hybrid")


def cars(x):
    one = np.ones_like(x)
    return np.column_stack([x, 0 * x, 0.75 * one, 4 * one, 2 * one, 1.5 * one, 0 * x])


class Recording:
    """Cars near the first places; every camera has depths of its own in each frame; s3 sees the sky
    alone."""

    site = Site("somewhere", AREA)

    def __init__(self, sensors=SENSORS, frames=3, seed=0):
        self.sensors, self.frames, self.seed = sensors, frames, seed

    def __len__(self):
        return self.frames

    def __getitem__(self, k):
        rng = np.random.default_rng([self.seed, k])
        x = PLACES[:6] + rng.uniform(-0.8, 0.8, 6)
        boxes = cars(x)
        depths = [
            np.zeros(s.model.shape, np.float32)
            if s.name.startswith("s3")
            else np.random.default_rng([self.seed, k, *s.name.encode()])
            .uniform(1, 40, s.model.shape)
            .astype(np.float32)
            for s in self.sensors
        ]
        labels = np.array([VEHICLE] * 5 + [HEAVY])
        return Frame(self.sensors, tuple(depths), Objects(boxes, labels), index=k)


class Seen:
    def __init__(self, recording, noise_seed=0):
        self.recording, self.site, self.sensors = recording, recording.site, recording.sensors
        self.frames, self.noise_seed = len(recording), noise_seed
        self.clouds = lru_cache(maxsize=None)(self._clouds)
        self.digest = hashlib.sha256(repr((recording.seed, noise_seed)).encode()).hexdigest()

    def __reduce__(self):
        return Seen, (self.recording, self.noise_seed)

    def _clouds(self, k, c):
        return frame_points(
            with_errors(self.recording[k], "paper", self.noise_seed), [c], area=self.site
        )[0]

    def objects(self, k):
        return self.recording[k].objects


class Guess:
    """A car at each place with enough points, whatever stands where exactly; it counts its
    calls."""

    def __init__(self, digest="guess", needed=0):
        self.digest, self.needed, self.calls = digest, needed, 0

    def __call__(self, points):
        self.calls += 1
        boxes = cars(PLACES)
        counts = count_points(points, boxes * [1, 1, 1, 2, 8, 2, 1])
        return Detections(boxes, np.round(counts / 20, 1))[counts > self.needed]


@pytest.fixture(scope="module")
def rows():
    sets = [np.flatnonzero(row).tolist() for row in SETS[1:]]
    found = evaluate_recording(
        Recording(), Guess(), Comparison(sensor_sets=sets), reads=Reads(frames=2)
    )
    return {(row.scheme, row.sensors, row.iou): row for row in found}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_it_equals_evaluate_recording_to_the_last_digit(rows, scheme):
    detected = Detected(Seen(Recording()), Guess(), scheme, iou=0.8)
    assert isinstance(detected, Fidelity)
    assert isinstance(detected.renders, Measured)
    estimates = detected.estimates(SETS, 2)
    for iou, estimate in estimates.items():
        expected = [rows[scheme, tuple(np.flatnonzero(row).tolist()), iou] for row in SETS[1:]]
        assert estimate.ap[1:].tolist() == [row.ap for row in expected]
        assert estimate.recall[1:].tolist() == [row.recall for row in expected]
        sizes = SETS[1:].sum(axis=1)
        np.testing.assert_allclose(
            estimate.kbit[1:] / sizes, [row.kbit_per_sensor for row in expected], rtol=1e-14
        )
        assert (estimate.ap[0], estimate.recall[0], estimate.kbit[0]) == (0, 0, 0)
    assert 0.1 < estimates[0.7].ap.max() < 1
    for mine, again in zip(detected.partial(SETS, 2), estimates[0.8], strict=True):
        np.testing.assert_array_equal(mine, again)


def test_what_is_shared_travels_or_finds_nothing(tmp_path):
    memo, detector, seen = Cache(), Guess(), Seen(Recording(frames=2))
    for scheme, calls in (("late", 4), ("early", 4), ("hybrid", 7)):
        before = detector.calls
        Detected(seen, detector, scheme, memo=memo)(SETS[1:])
        assert (
            detector.calls - before == 2 * calls
        )  # of three sensors' seven sets and the empty cloud, in two frames
    Detected(Seen(Recording()), Guess(), "late", memo=tmp_path / "memo")(SETS[1:2])
    other, detector = Recording((SENSORS[3], SENSORS[0])), Guess()
    Detected(Seen(other), detector, "late", memo=tmp_path / "memo")(np.array([[False, True]]))
    assert detector.calls == 0
    detected = Detected(Seen(Recording()), Guess(), "hybrid", memo=tmp_path / "memo")
    estimate = detected(SETS[[0, 5]])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(detected))(SETS[[0, 5]]), estimate)
    recording = Recording()
    recording.site = Site("elsewhere", AREA + 1000)
    assert np.isnan(Detected(Seen(recording), Guess(), "early")(SETS).ap).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_kept_set_costs_nothing_and_more_frames_only_what_they_add(tmp_path, scheme):
    detector, seen = Guess(), Seen(Recording())
    part = Detected(seen, detector, scheme, memo=tmp_path / "memo").partial(SETS, 2)
    calls = detector.calls
    other = Guess()
    again = Detected(seen, other, scheme, memo=tmp_path / "memo")
    np.testing.assert_array_equal(again.partial(SETS, 2), part)
    assert other.calls == 0
    np.testing.assert_array_equal(again(SETS), Detected(seen, Guess(), scheme)(SETS))
    assert other.calls == calls / 2
    np.testing.assert_array_equal(again.partial(SETS, [1, 0]), part)


@pytest.mark.parametrize(
    ("seen", "detector"),
    [
        *(
            (Seen(Recording()), Guess("other weights", needed=2)),
            (Seen(Recording(seed=1)), Guess()),
        ),
        (Seen(Recording(), noise_seed=1), Guess()),
        (Seen(Recording(tuple(Sensor(s.name + "b", s.model, s.pose) for s in SENSORS))), Guess()),
        (
            Seen(
                Recording(
                    tuple(
                        Sensor(s.name, DepthCamera(40, 30, 1, sigma=1.0), s.pose) for s in SENSORS
                    )
                )
            ),
            Guess(),
        ),
        (Seen(Recording(SENSORS[1::-1] + SENSORS[2:])), Guess()),
        (Seen(Recording(tuple(replace(s, pose=s.pose @ pose(0.5)) for s in SENSORS))), Guess()),
        (Seen(Recording(tuple(replace(s, pose=s.pose @ pose(yaw=0.2)) for s in SENSORS))), Guess()),
    ],
)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_whatever_a_score_depends_on_it_is_never_an_old_one(tmp_path, scheme, seen, detector):
    sets = SETS[[1, 7]]
    Detected(Seen(Recording()), Guess(), scheme, memo=tmp_path / "memo").partial(sets, 2)
    found = Detected(seen, detector, scheme, memo=tmp_path / "memo").partial(sets, 2)
    np.testing.assert_array_equal(found, Detected(seen, detector, scheme).partial(sets, 2))


def test_code_that_changed_is_run_again(tmp_path, change_code):
    for code, calls in (("before", 4), ("before", 0), ("after", 4)):
        change_code("placement_env.fidelity.detector", code)
        detector = Guess()
        Detected(Seen(Recording(frames=2)), detector, "late", memo=tmp_path / "memo")(SETS[[1, 2]])
        assert detector.calls == calls


def test_the_code_of_a_detector_that_knows_its_background_counts(spy):
    background = Background.learn(np.random.default_rng(0).uniform(-1, 1, (50, 3)))
    calls = spy("placement_env.fidelity.detector", "code_digest")
    Detected(Seen(Recording()), KnownBackground(Guess(), background), "late")(SETS[1:2])
    assert {module for call in calls for module in call.args} > {
        KnownBackground.__module__,
        Guess.__module__,
    }


def test_hits_give_the_ap_again_and_name_objects():
    detected = Detected(Seen(Recording()), Guess(), "early").at(0.7, also=[0.55])
    for subset in SETS[[0, 3, 15]]:
        hits = detected.hits(subset)
        estimates = detected.estimates(subset[None])
        assert hits.shape == (4, sum(detected.scored(k).sum() for k in range(3)))
        for hit, iou in zip(hits, (0.55, *IOUS), strict=True):
            assert hit.mean() == estimates[iou].recall[0]
    boxes = Recording()[0].objects.boxes[detected.scored(0)]
    first = detected.outcomes([(0, 1, 2, 3)], [0])[0, 1, 2, 3][0]
    assert set(first.truth[0]) <= {FALSE_ALARM, -2, *range(len(boxes))}


def test_detections_of_several_frames_are_each_frames():
    detected = Detected(Seen(Recording()), Guess(), "early")
    told: list[int] = []
    together = detect_in_frames(detected, (0, 2), [2, 0], told.append)
    assert told == [1, 2]
    for k, detections in zip([2, 0], together, strict=True):
        expected = Detected(Seen(Recording()), Guess(), "early").detections((0, 2), k)
        np.testing.assert_array_equal(detections.boxes, expected.boxes)
        np.testing.assert_array_equal(detections.scores, expected.scores)
    kept = len(detected.memo)
    assert kept == 2
    detect_in_frames(detected, (0, 2), [0, 2])
    assert len(detected.memo) == kept


class Nameless:
    def __call__(self, points):
        return Detections.empty()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": "middle"}, "early"),
        ({"iou": 1.5}, "iou"),
        ({"detector": Nameless(), "memo": Cache()}, "digest"),
    ],
)
def test_bad_requests_are_refused(options, message):
    arguments = {"renders": Seen(Recording()), "detector": Guess(), "scheme": "early", **options}
    with pytest.raises((ValueError, TypeError), match=message):
        Detected(**arguments)
    with pytest.raises(ValueError, match="a frame"):
        Detected(Seen(Recording()), Guess(), "early").partial(SETS, 0)
    with pytest.raises(ValueError, match="4 candidates"):
        Detected(Seen(Recording()), Nameless(), "early")(np.zeros((2, 5), bool))


def test_foreground_and_range_images_need_images_and_have_them_in_renders(
    small_traffic, small_candidates
):
    with pytest.raises(ValueError, match="points alone, no images"):
        Detected(Seen(Recording()), Guess(), "foreground")(SETS[:2])
    renders, some = Renders(small_traffic, small_candidates), np.array([[True, False, True, False]])
    paper = Detected(renders, Guess(), "early").partial(some, 2)
    foreground = Detected(renders, Guess(), "foreground").partial(some, 2)
    images = Detected(renders, Guess(), "early", codec=RangeImages(0.04)).partial(some, 2)
    late = Detected(renders, Guess(), "late", codec=RangeImages()).partial(some, 2)
    assert 0 < foreground.kbit[0] < images.kbit[0] < paper.kbit[0]
    assert foreground.kbit[0] < 0.1 * paper.kbit[0]
    assert late.kbit[0] * 1000 % 4 == pytest.approx(0, abs=1e-6)
