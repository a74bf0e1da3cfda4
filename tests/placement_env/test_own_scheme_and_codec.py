"""A fusion scheme and a codec written here run through evaluation, objective and search; no other
file knows them."""

import zlib
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from placement_env.candidates.candidates import paper_candidates
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.hit_fit import fit_detected
from placement_env.fidelity.hit_model import load_models, save_models
from placement_env.fidelity.perception_entropy import PerceptionEntropy
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.seeing import see
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.table import TableFidelity, load_table
from placement_env.objective import Objective
from placement_env.search import cmaes, greedy
from placement_env.setting import Setting
from placement_env.subsets import all_subsets
from toolkit.boxes import count_points
from toolkit.detection.codec import PAPER, Codec
from toolkit.detection.comparison import Comparison
from toolkit.detection.evaluation import evaluate_recording
from toolkit.detection.messages import Message
from toolkit.detection.paper_schemes import Hybrid
from toolkit.detection.scheme import Fused, Scheme
from toolkit.detection.schemes import fuse_frame
from toolkit.detection.survey import survey
from toolkit.frame import Frame
from toolkit.objects import Detections
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.run import Run


@dataclass(frozen=True)
class Thinned:
    """Early fusion of every n-th point."""

    every: int = 4
    name: str = "thinned"
    sends_points: bool = True
    sends_boxes: bool = False

    @property
    def digest(self):
        return repr(self)

    def fuse(self, view, sensors, /):
        def keep(points, sensor):
            return np.arange(len(points)) % self.every == 0

        sent = [
            view.send_points(view.part(view.cloud(s), f"every {self.every}th", keep))
            for s in sensors
        ]
        boxes = view.suppress([view.detect([each.arrived for each in sent])])
        return Fused(boxes.detections, np.array([each.bits for each in sent]), boxes.ms)

    def sent_points(self, counts, /):
        return counts.sent / np.float32(self.every)

    def mask_pooled(self, distance, radius, /):
        return None


@dataclass(frozen=True)
class Centimetres:
    """Points and boxes rounded to `step` metres, as compressed integers."""

    step: float = 0.01

    @property
    def digest(self):
        return repr(self)

    def encode_points(self, points, /):
        return self._packed(points)

    def decode_points(self, message, /):
        return self._unpacked(message, 3).astype(np.float32)

    def encode_boxes(self, detections, origin, /):
        return self._packed(np.column_stack([detections.boxes, detections.scores]))

    def decode_boxes(self, message, sensor, /):
        rows = self._unpacked(message, 8)
        return Detections(rows[:, :7], rows[:, 7])

    def bits(self, *, points=0, boxes=0, messages=1):
        return 64.0 * messages + 40.0 * np.asarray(points) + 100.0 * np.asarray(boxes)

    def _packed(self, rows):
        data = zlib.compress(np.round(rows / self.step).astype(np.int32).tobytes())
        return Message(data, 8 * len(data))

    def _unpacked(self, message, columns):
        return (
            np.frombuffer(zlib.decompress(message.content), np.int32).reshape(-1, columns)
            * self.step
        )


class Places:
    """A car wherever one may stand, with enough points on it; the more, the surer."""

    digest = "places"

    def __init__(self, boxes):
        self.boxes, self.calls = boxes, 0

    def __call__(self, points):
        self.calls += 1
        counts = count_points(points, self.boxes)
        seen = counts > 5
        return Detections(self.boxes[seen], counts[seen] / (counts[seen] + 50.0))


class Recording:
    def __init__(self, traffic, candidates):
        self.site, self.sensors = traffic.site, candidates.sensors
        renderer = Renderer(traffic.site, traffic.bodies, self.sensors, threads=1)
        self.frames = [
            Frame(self.sensors, renderer.render(snapshot).measurements, snapshot.objects, index=k)
            for k, snapshot in enumerate(traffic.snapshots)
        ]

    def __len__(self):
        return len(self.frames)

    def __getitem__(self, k):
        return self.frames[k]


@pytest.fixture(scope="module")
def candidates(small_traffic):
    return paper_candidates(small_traffic.site)


@pytest.fixture(scope="module")
def detector(small_traffic):
    return Places(np.concatenate([snapshot.objects.boxes for snapshot in small_traffic.snapshots]))


recording = pytest.fixture(scope="module")(
    lambda small_traffic, candidates: Recording(small_traffic, candidates)
)
renders = pytest.fixture(scope="module")(
    lambda small_traffic, candidates: Renders(small_traffic, candidates)
)
seen = pytest.fixture(scope="module")(
    lambda small_traffic, candidates: see(small_traffic, candidates)
)


def test_they_fit_the_protocols_and_a_site_takes_both_by_name():
    assert isinstance(Thinned(), Scheme)
    assert isinstance(Centimetres(), Codec)
    for scheme in (Thinned, None, "middle"):
        with pytest.raises((ValueError, TypeError), match="of"):
            evaluate_recording(None, None, Comparison(schemes=[scheme]))  # type: ignore[list-item]
    objective = Objective(
        Setting("tjunction", scheme=Thinned(), fidelity="coverage", codec=Centimetres()),
        Run(frames=2),
    )
    paper = Objective(Setting("tjunction", fidelity="coverage"), Run(frames=2))
    assert greedy.search(objective, 2).best.kbit < greedy.search(paper, 2).best.kbit
    assert objective.preparation is not None
    (moved,) = cmaes.build_pose_scorer(objective.preparation)([objective.candidates.sensors[:1]])
    assert moved.kbit == objective.score([0]).kbit
    capacity = 1.5 * float(objective.sent[0])  # the paper's codec takes 2.4 times as much
    mounts = tuple(replace(mount, capacity=capacity) for mount in objective.candidates.mounts)
    made = objective.preparation
    narrow = replace(
        made, setting=replace(made.setting, candidates=replace(objective.candidates, mounts=mounts))
    )
    assert cmaes.build_pose_scorer(narrow)([objective.candidates.sensors[:1]]) != [None]
    costly = replace(narrow, setting=replace(narrow.setting, codec=PAPER))
    assert cmaes.build_pose_scorer(costly)([objective.candidates.sensors[:1]]) == [None]
    by_detector = Objective(
        Setting(
            "tjunction",
            scheme=Thinned(),
            fidelity="detector",
            codec=Centimetres(),
            detector=Places(np.zeros((0, 7))),
        ),
        Run(frames=2),
    )
    assert by_detector.score([0]).kbit > 0
    with pytest.raises(ValueError, match="no surrogate of tjunction for thinned"):
        Objective(Setting("tjunction", scheme=Thinned()), Run(frames=2))


def test_evaluation_takes_both_and_what_arrives_is_let_through(recording, detector):
    schemes, codec = [Thinned(), "early", Hybrid(radius=9.0, name="hybrid 9")], Centimetres()
    rows = evaluate_recording(
        recording, detector, Comparison(schemes=schemes, codec=codec, iou_thresholds=[0.7])
    )
    plain = evaluate_recording(
        recording, detector, Comparison(schemes=["early"], iou_thresholds=[0.7])
    )
    assert [row.scheme for row in rows] == ["thinned", "early", "hybrid 9"]
    assert 0 < rows[0].recall <= rows[1].recall
    assert 0 < rows[0].kbit_per_sensor < rows[1].kbit_per_sensor < plain[0].kbit_per_sensor
    assert rows.provenance["codec"] == codec.digest
    assert dict(rows.provenance["schemes"])["thinned"] == Thinned().digest
    with pytest.raises(ValueError, match="two schemes are called 'hybrid'"):
        evaluate_recording(recording, detector, Comparison(schemes=["hybrid", Hybrid(radius=9.0)]))
    assert survey(recording, codec=codec).kbit_per_sensor.mean() == pytest.approx(
        rows[1].kbit_per_sensor
    )
    coarse = fuse_frame(
        "late", recording[0], detector, site=recording.site, codec=Centimetres(step=0.5)
    )
    assert len(coarse.detections)
    np.testing.assert_allclose(coarse.detections.boxes, np.round(coarse.detections.boxes * 2) / 2)


def test_the_detector_fidelity_scores_what_evaluation_scores(recording, renders, detector):
    """To the scores alone: noise is drawn otherwise for candidates than for a recording's
    sensors."""
    detected = Detected(renders, detector, Thinned(), codec=Centimetres())
    rows = evaluate_recording(
        recording, detector, Comparison([Thinned()], codec=Centimetres(), iou_thresholds=[0.7])
    )
    estimate = detected(np.ones((1, len(renders.sensors)), bool))
    assert estimate.ap[0] == pytest.approx(rows[0].ap, abs=0.1)
    assert estimate.kbit[0] / len(renders.sensors) == pytest.approx(
        rows[0].kbit_per_sensor, rel=0.02
    )


@pytest.mark.parametrize(
    ("scheme", "codec"),
    [
        *(
            (Thinned(2), Centimetres()),
            (Thinned(4), Centimetres(0.2)),
            ("early", Centimetres()),
            ("early", PAPER),
        ),
        *(("late", Centimetres(0.2)), (Hybrid(radius=5.0), PAPER)),
    ],
)
def test_what_is_kept_is_of_this_scheme_and_codec(renders, detector, tmp_path, scheme, codec):
    sets = all_subsets(4)[[1, 7, 12]]
    for other in (Thinned(4), "late", "hybrid"):
        Detected(renders, detector, other, codec=Centimetres(), memo=tmp_path / "memo")(sets)
    kept = Detected(renders, detector, scheme, codec=codec, memo=tmp_path / "memo")(sets)
    np.testing.assert_array_equal(kept, Detected(renders, detector, scheme, codec=codec)(sets))


def test_a_codec_without_loss_shares_what_was_detected(renders, tmp_path, detector):
    Detected(renders, detector, "early", memo=tmp_path / "memo")(all_subsets(4))
    calls = detector.calls
    Detected(renders, detector, "late", memo=tmp_path / "memo")(all_subsets(4))
    assert detector.calls == calls


@pytest.mark.parametrize("fidelity", [Coverage, PerceptionEntropy])
def test_fidelities_that_count_take_both(seen, candidates, fidelity):
    codec, sets = Centimetres(), all_subsets(4)
    estimate = fidelity(seen, Thinned(), codec=codec)(sets)
    points = seen.sent.sum(axis=1, dtype=np.float64) / 4
    expected = np.rint(64.0 * seen.frames + 40.0 * points) / 1000 / seen.frames
    np.testing.assert_allclose(estimate.kbit, sets @ expected)
    np.testing.assert_array_equal(estimate.ap, fidelity(seen, "early")(sets).ap)


@pytest.mark.parametrize("fidelity", ["coverage", "detector"])
def test_objective_and_search_take_both(seen, renders, candidates, detector, fidelity):
    scheme, codec = Thinned(), Centimetres()
    scored_by = {
        "coverage": lambda: Coverage(seen, scheme, codec=codec),
        "detector": lambda: Detected(renders, detector, scheme, codec=codec),
    }[fidelity]()
    objective = Objective(
        Setting(candidates=candidates, fidelity=scored_by, scheme=scheme, codec=codec),
        visibility=seen,
    )
    np.testing.assert_allclose(
        objective.sent, 64.0 / 1000 + 40.0 * seen.sent.mean(axis=1) / 4 / 1000, rtol=1e-6
    )
    assert objective.linked.all()
    found = greedy.search(objective, 2)
    assert found.best.reward == objective.scores(all_subsets(4)[[3, 5, 6, 9, 10, 12]]).reward.max()
    assert objective.provenance["scheme"] == scheme.digest


def test_a_surrogate_may_be_fitted_to_them(seen, renders, detector, tmp_path):
    sets = all_subsets(4)[1:]
    detected = Detected(renders, detector, Thinned())
    models = tuple(each.model for each in fit_detected([(seen, detected, sets)], source="places"))
    save_models(models, tmp_path / "own.json")
    assert load_models(tmp_path / "own.json", schemes=["thinned"]) == models
    estimate = Surrogate(seen, Thinned(), models[0])(sets)
    assert np.corrcoef(estimate.ap, detected.estimates(sets)[0.7].ap)[0, 1] > 0.8


def test_where_nothing_fits_them_the_remedy_is_named(seen):
    for make, said in (
        (
            lambda: Surrogate(seen, Thinned()),
            r"no surrogate of general for thinned .* fidelity detector or coverage",
        ),
        (lambda: TableFidelity(load_table("tjunction"), Thinned()), "say --fidelity detector"),
        (
            lambda: TableFidelity(load_table("tjunction"), Hybrid(radius=5.0)),
            "say --fidelity detector",
        ),
        (lambda: TableFidelity(load_table("tjunction"), codec=Centimetres()), "paper's codec"),
        (lambda: Coverage(seen, Hybrid(radius=5.0)), "hybrid_radius"),
    ):
        with pytest.raises(ValueError, match=said):
            make()


class Unhashable(Thinned):
    """Own schemes need not be keys of a dictionary; environments go by their digest."""

    __hash__ = None  # type: ignore[assignment]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "name", ["coview/SensorSelect-v0", "coview/SensorSubset-v0", "coview/SensorPose-v0"]
)
def test_environments_take_both(name):
    drawn, codec = [Unhashable(2), Unhashable(4)], Centimetres()
    env: Any = gym.make(name, scheme=drawn, codec=codec, fidelity="coverage", frames=1, budget=2)
    sent: dict[int, Any] = {}
    env.reset(seed=0)
    for _ in range(8):
        env.reset()
        legal = (
            0
            if "Select" in name
            else np.eye(1, getattr(env.action_space, "n", 1), dtype=np.int8)[0]
        )
        _, reward, _, _, info = env.step(env.action_space.sample() if "Pose" in name else legal)
        objective = env.unwrapped.placement()[0]
        assert objective.codec == codec
        assert np.isfinite(reward)
        assert info["kbit"] > 0
        sent[objective.scheme.every] = objective.sent if "Pose" not in name else None
    assert sent.keys() == {2, 4}
    if "Pose" not in name:
        assert (sent[4] < sent[2]).all()
    env.reset(options={"scheme": Unhashable(8)})
    assert env.unwrapped.placement()[0].scheme.every == 8
    paper: Any = gym.make(name, fidelity="coverage", frames=1, budget=2)
    paper.reset(seed=0)
    assert paper.unwrapped.placement()[0].codec == PAPER
