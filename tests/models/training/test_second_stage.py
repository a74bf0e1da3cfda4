"""Networks that go on as others: what is shared is taken over channel by channel."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from models.config import ROAD_USERS, VoxelNetConfig, road_users, select_anchors
from models.detector import MIN_KNOWN_SCORE, VoxelNetDetector
from models.network.candidates import logit, sigmoid
from models.network.faces import SORTS, FaceNetworks, face_features, face_offsets, measure_faces
from models.network.grid import per_anchor, voxelise
from models.network.voxelnet import VoxelNet
from models.training import second_stage
from models.training.presets import make_config
from models.training.second_stage import (
    MAX_FACE_SHIFT_M,
    MAX_LOST_SHARE,
    MIN_DETECTIONS,
    MIN_PRECISION,
    MIN_THRESHOLD,
    FaceExamples,
    displace_boxes,
    face_examples,
    fit_calibration,
    fit_faces,
    lowest_threshold,
    platt,
    rebuild,
    train_faces,
    widen,
)
from toolkit.boxes import iou_3d
from toolkit.detection.background import Background, KnownBackground
from toolkit.detection.metrics import reliability
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Objects

SMALL_AREA = (-8, -8, 8, 8)
VEHICLES, ALL = VoxelNetConfig.light(SMALL_AREA), VoxelNetConfig.light(SMALL_AREA, **road_users())


def network(config, seed=0):
    torch.manual_seed(seed)
    made = VoxelNet(config).eval()
    torch.nn.init.normal_(made.head.classes.bias, 0.0, 0.5)
    return made


def maps(made):
    points = torch.rand(200, 3, generator=torch.Generator().manual_seed(1)) * 6
    with torch.no_grad():
        answer = made.eval()(voxelise(points, made.config))
    return [per_anchor(each, len(made.config.anchor_labels)) for each in answer]


def test_rebuilt_networks_keep_their_classes_and_anchors():
    old = network(VEHICLES)
    wide = widen(old, ALL)
    assert wide.config.labels == ("vehicle", "heavy", "cyclist", "pedestrian")
    for before, after in zip(maps(old), maps(wide), strict=True):
        torch.testing.assert_close(after[:, :, :, :2], before)
        assert not torch.equal(after[:, :, :, 2:4], before)
    order = select_anchors(["pedestrian", "cyclist", "vehicle"])
    old, fewer = network(ALL), VoxelNetConfig.light(SMALL_AREA, **road_users(order))
    after = maps(widen(old, fewer))
    for before, now in zip(maps(old), after, strict=True):
        torch.testing.assert_close(now, before[:, :, :, [6, 4, 5, 0, 1]])
    kinds = (replace(ROAD_USERS[0], yaws=(0.0,)), *ROAD_USERS[1:])
    before, after = (
        maps(network(ALL)),
        maps(widen(network(ALL), VoxelNetConfig.light(SMALL_AREA, **road_users(kinds[:2])))),
    )
    torch.testing.assert_close(after[0][..., 1:, :], before[0][..., 2:4, :])
    assert not torch.allclose(after[0][..., 0, :], before[0][..., 0, :])
    made = network(ALL)
    assert widen(made, ALL) is made
    staged = widen(rebuild(made, faces=("vehicle",)), ALL)
    assert (staged.config, len(staged.state_dict())) == (ALL, len(made.state_dict()))
    old = network(VEHICLES)
    first, state = widen(old, ALL), torch.get_rng_state()
    torch.rand(5)
    changed = torch.get_rng_state()
    second = widen(old, ALL)
    assert torch.equal(torch.get_rng_state(), changed)
    assert not torch.equal(state, changed)
    for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("training", [True, False])
def test_a_rebuilt_network_has_the_weights_and_the_changes(training):
    made = network(ALL).train(training)
    other = rebuild(made, faces=("heavy",), score_threshold=0.3)
    assert (other.config.faces, other.config.score_threshold, other.training) == (
        ("heavy",),
        0.3,
        training,
    )
    for name, tensor in made.state_dict().items():
        assert torch.equal(other.state_dict()[name], tensor)
    assert made.config.faces == ()


AREA = (-12.8, -12.8, 12.8, 12.8)


def drawn(count=20000, slope=2.0, intercept=-1.0, seed=0):
    rng = np.random.default_rng(seed)
    scores = rng.uniform(0.02, 0.98, count)
    return scores, rng.random(count) < sigmoid(slope * logit(scores) + intercept)


def test_fits_find_what_was_drawn_and_calibrated_scores_are_shares():
    assert platt(*drawn()) == pytest.approx((2.0, -1.0), abs=0.08)
    assert platt(*drawn(slope=0.7, intercept=0.5)) == pytest.approx((0.7, 0.5), abs=0.05)
    scores, hits = drawn()
    slope, intercept = platt(scores, hits)
    assert reliability(scores, hits).error > 0.1
    assert reliability(sigmoid(slope * logit(scores) + intercept), hits).error < 0.015


def test_fits_find_what_rivals_take():
    rng = np.random.default_rng(3)
    scores, rivals = (
        rng.uniform(0.02, 0.98, 20000),
        rng.uniform(0, 1, (20000, 3)) * (rng.random((20000, 3)) < 0.5),
    )
    hits = rng.random(20000) < sigmoid(
        1.5 * logit(scores) + 0.3 - rivals @ np.array([3.0, 0.0, 1.0])
    )
    assert platt(scores, hits, rivals) == pytest.approx((1.5, 0.3, 3.0, 0.0, 1.0), abs=0.15)
    helped = rng.random(20000) < sigmoid(logit(scores) + rivals @ np.array([3.0, 0.0, 1.0]))
    assert platt(scores, helped, rivals)[2:] == (0.0, 0.0, 0.0)


def test_fits_of_nothing_and_of_hits_alone_keep_the_order():
    assert platt(np.zeros(0), np.zeros(0, bool)) == (1.0, 0.0)
    slope, intercept = platt(np.full(100, 0.9), np.ones(100, bool))
    assert 1.0 <= slope < 3
    assert 0 <= intercept < 2
    assert platt(np.linspace(0.05, 0.95, 500), np.arange(500) < 250)[0] == 0.05  # order is kept


@pytest.mark.parametrize("seed", range(4))
def test_above_the_threshold_such_a_share_is_true_and_above_no_lower_one(seed):
    scores, hits = drawn(3000, slope=6.0, intercept=6.0, seed=seed)
    lowest = lowest_threshold(scores, hits, 0.96)
    assert hits[scores > lowest].mean() >= 0.96
    assert 0.2 < lowest < 0.5
    assert all(hits[scores > lower].mean() < 0.96 for lower in scores[scores < lowest])
    assert lowest_threshold(scores, np.ones(3000, bool), 0.95) == 0.0


def test_thresholds_cost_few_and_faces_are_learnt():
    scores, hits = np.linspace(1, 0.01, 100), np.arange(100) < MIN_DETECTIONS - 1
    assert lowest_threshold(scores, hits, 1.0) < scores[MIN_DETECTIONS - 2]
    assert lowest_threshold(scores, np.zeros(100, bool), 1.0) == scores[MIN_DETECTIONS]
    assert lowest_threshold(scores[:5], hits[:5] & False, 0.9) == 0.0
    scores, hits = drawn(4000)
    wanted = lowest_threshold(scores, hits, 0.99)
    assert (scores[hits] > wanted).mean() == pytest.approx(1 - MAX_LOST_SHARE, abs=0.001)
    assert hits[scores > wanted].mean() < 0.9
    torch.manual_seed(3)
    networks = FaceNetworks()
    figures = fit_faces(networks, examples(300), steps=250)
    assert all(figures[f"{sort} after"] < 0.45 * figures[f"{sort} before"] for sort in SORTS)
    np.testing.assert_allclose(
        networks.prior, [figures[f"{sort} before"] for sort in SORTS], rtol=1e-6
    )
    rng = np.random.default_rng(9)
    before, after = [], []
    for _ in range(30):
        points, box, truth = box_scene(rng)
        found = measure_faces(networks, Detections(box, np.array([0.9])), points, ("vehicle",))
        before.append(iou_3d(box, truth)[0, 0])
        after.append(iou_3d(found.boxes, truth)[0, 0])
    assert np.mean(after) > np.mean(before) + 0.06


def fake(found):
    return lambda network, frames, *, count, seed, subsets, errors, known: found


def scene(label, scores, hits):
    """A frame with detections of one class, each on an object or 10 m beside it."""
    size = {VEHICLE: (4.0, 1.8, 1.5), CYCLIST: (1.8, 0.6, 1.7), HEAVY: (9, 2.5, 3)}[label]
    boxes = np.array([[20.0 * k, 0.0, 1.0, *size, 0.0] for k in range(len(scores))])
    there, labels = boxes.copy(), np.full(len(scores), label)
    there[:, 1] += np.where(hits, 0.0, 10.0)
    return (
        Detections(boxes, np.array(scores), labels),
        Objects(there, labels),
        np.ones(len(scores), bool),
    )


@pytest.fixture
def detect_by(monkeypatch):
    """Take detections of recordings from a function in place of a network."""

    def set_function(function):
        monkeypatch.setattr(second_stage, "detect_recording", function)

    return set_function


def test_calibration_and_faces_have_shares_of_their_own(fail, spy, packed):
    readers = ("detect_recording", "read_sample_points")
    for name in readers:
        fail(second_stage, name, InterruptedError())
    detected, read = (spy(second_stage, name) for name in readers)
    network = VoxelNet(make_config(AREA, "fast"))
    for collect in (
        lambda: fit_calibration(network, packed),
        lambda: face_examples(packed, None, ("vehicle",)),
    ):
        with pytest.raises(InterruptedError):
            collect()
    shares = [(call.named["subsets"], call.named["errors"]) for call in (*detected, *read)]
    assert shares == [(0.3, 0.3), (0.5, 0.3)]


def test_every_class_is_calibrated_by_itself_and_has_its_threshold(detect_by, packed):
    rng = np.random.default_rng(0)
    frames = []
    for label, slope, intercept in ((VEHICLE, 3.0, 2.0), (CYCLIST, 1.0, -1.0)):
        scores = rng.uniform(0.05, 0.98, 900)
        hits = rng.random(900) < sigmoid(slope * logit(scores) + intercept)
        frames += [scene(label, scores[k : k + 90], hits[k : k + 90]) for k in range(0, 900, 90)]
    # too few to say anything
    frames += [scene(HEAVY, np.full(MIN_DETECTIONS - 1, 0.5), np.zeros(MIN_DETECTIONS - 1, bool))]
    detect_by(fake(frames))
    torch.manual_seed(0)
    network = VoxelNet(make_config(AREA, "fast", classes=("vehicle", "cyclist", "heavy")))
    result = fit_calibration(network, packed).config
    assert result.calibration[0] == pytest.approx((3.0, 2.0), abs=0.6)
    assert result.calibration[1] == pytest.approx((1.0, -1.0), abs=0.2)
    assert result.calibration[2] == (1.0, 0.0)
    assert result.thresholds[2] == MIN_THRESHOLD
    for number, label in enumerate((VEHICLE, CYCLIST)):
        slope, shift = result.calibration[number]
        sure = [
            (sigmoid(slope * logit(found.scores) + shift), there.boxes[:, 1] == 0)
            for found, there, _ in frames
            if found.labels[0] == label
        ]
        scores, true = (np.concatenate(each) for each in zip(*sure, strict=True))
        assert result.thresholds[number] == round(
            max(MIN_THRESHOLD, lowest_threshold(scores, true, MIN_PRECISION)), 3
        )


def test_scores_are_calibrated_anew_where_the_empty_site_is_known(detect_by, packed):
    """Half of the detections are of the site; those that are left are all true."""
    hits = np.arange(200) % 2 == 0
    every, left = (
        scene(VEHICLE, np.full(200, 0.5), hits),
        scene(VEHICLE, np.full(100, 0.5), hits[::2]),
    )

    def detected(network, frames, *, count, seed, subsets, errors, known):
        return [left if known else every]

    detect_by(detected)
    network = fit_calibration(VoxelNet(make_config(AREA, "fast")), packed)
    at = VoxelNetDetector(network)
    known = KnownBackground(at, Background.learn(np.zeros((1, 3))))
    points = left[0].boxes[:, :3] + [0, 0, 0.3]
    found = known._drop_background(left[0], points, np.ones(len(points), np.bool_))
    assert len(found) == 100
    assert found.scores == pytest.approx(1.0, abs=0.05)
    assert at.score_known(Detections.empty()).scores.size == 0
    bare = VoxelNetDetector(second_stage.rebuild(network, known=()))
    assert bare.score_known(left[0]) is left[0]
    assert bare.at_known_site() is bare


def test_a_box_with_too_small_a_share_of_its_rivals_score_is_dropped():
    """One object is one road user: a cyclist's box of 0.3 where a pedestrian's of 0.8 stands, and
    no box elsewhere."""
    config = VoxelNetConfig.light(
        SMALL_AREA, **road_users(select_anchors(("pedestrian", "cyclist")))
    )
    rows = ((1.0, 0.0, 0.0, 0.0),) * 2
    config = replace(config, rivalry=(), known=rows, thresholds=(0.1, 0.1), rival_shares=(0.0, 0.4))
    at = np.array([0.0, 0.1, 5.0, 9.0, 9.1, 12.0, 12.1])
    boxes = np.column_stack(
        [at, np.zeros(7), np.ones(7), np.full((7, 3), (1.5, 0.6, 1.7)), np.zeros(7)]
    )
    labels = np.array([PEDESTRIAN, CYCLIST, CYCLIST, PEDESTRIAN, CYCLIST, PEDESTRIAN, CYCLIST])
    doubts = np.linspace(0.01, 0.07, 7)[:, None] * np.ones(5)
    found = Detections(boxes, np.array([0.8, 0.3, 0.3, 0.8, 0.33, 0.2, 0.9]), labels, doubts)
    left = VoxelNetDetector(VoxelNet(config)).score_known(found)
    assert left.doubts is not None
    np.testing.assert_array_equal(left.doubts, doubts[[0, 2, 3, 4, 5, 6]])
    assert (
        left.boxes[:, 0].tolist() == at[[0, 2, 3, 4, 5, 6]].tolist()
    )  # pedestrians have a share of 0
    assert len(VoxelNetDetector(VoxelNet(config), score_threshold=0.05).score_known(found)) == 7
    assert VoxelNetDetector(VoxelNet(config)).at_known_site().rival_shares is None
    # neither known nor rivalry: the share holds alone
    bare = VoxelNetDetector(VoxelNet(replace(config, known=())))
    scores = torch.as_tensor([[0.8, 0.0], [0.0, 0.3], [0.0, 0.3]])
    kept = bare.finish_detections(
        torch.as_tensor(boxes[:3]).float(), scores, np.zeros((0, 3), np.float32)
    )
    assert sorted(kept.boxes[:, 0].tolist()) == [0.0, 5.0]
    assert VoxelNetConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    for wrong, said in (((0.5,), "must be one per label"), ((0.5, 1.2), "must be within 0..1")):
        with pytest.raises(ValueError, match=said):
            replace(config, rival_shares=wrong)


LARGE = {
    "a van under a surer truck": ((0.5, 0.7), [False, True]),
    "a truck's box over a far surer car": ((0.9, 0.25), [True, False]),
    "a truck's box that is nearly as sure": ((0.9, 0.4), [True, True]),
}


@pytest.mark.parametrize("case", LARGE)
def test_one_large_object_has_one_label_where_the_header_names_no_shares(case):
    """Weights of a user, whose header has no rival_shares: a van and a heavy vehicle at one place,
    a person next to both, whom no rule of large vehicles drops or counts."""
    scores, kept = LARGE[case]
    labels = ("vehicle", "pedestrian", "heavy")
    config = VoxelNetConfig.light(
        SMALL_AREA, **road_users(select_anchors(labels)), score_threshold=0.1
    )
    boxes = np.array(
        [[0, 0, 1, 4.5, 2, 2, 0], [0.5, 0, 1.5, 7, 2.4, 3, 0], [1.2, 0.9, 1, 0.6, 0.6, 1.7, 0]]
    )
    logits = torch.zeros(3, 3)
    logits[[0, 1, 2], [0, 2, 1]] = torch.tensor([*scores, 0.95])
    detector = VoxelNetDetector(VoxelNet(config))
    found = detector.finish_detections(
        torch.as_tensor(boxes).float(), logits, np.zeros((0, 3), np.float32)
    )
    wanted = [label for label, stays in zip((VEHICLE, HEAVY), kept, strict=True) if stays]
    assert sorted(found.labels.tolist()) == sorted([*wanted, PEDESTRIAN])
    every = VoxelNetDetector(VoxelNet(replace(config, rival_shares=(0.0, 0.0, 0.0))))
    assert (
        len(
            every.finish_detections(
                torch.as_tensor(boxes).float(), logits, np.zeros((0, 3), np.float32)
            )
        )
        == 3
    )
    cars = replace(config, kinds=(), labels=("vehicle",))
    assert VoxelNetDetector(VoxelNet(cars)).rival_shares is None


def test_a_detector_at_a_known_site_reports_what_the_scores_there_decide(monkeypatch):
    """A cyclist where a surer pedestrian stands is dropped by its score there, whatever thresholds
    say elsewhere."""
    rows = ((1.0, 1.0, 0.0, 0.0), (1.0, 0.0, 4.0, 0.0))
    config = VoxelNetConfig.light(
        SMALL_AREA, **road_users(select_anchors(("pedestrian", "cyclist")))
    )
    network = VoxelNet(
        replace(config, rivalry=(), known=rows, thresholds=(0.4, 0.3), known_thresholds=(0.5, 0.45))
    )
    detector = VoxelNetDetector(network)
    unsure = detector.at_known_site()
    assert (unsure.thresholds, detector.thresholds) == ((MIN_KNOWN_SCORE,) * 2, (0.4, 0.3))
    boxes = np.array(
        [
            [0.0, 0, 1, 1, 1, 2, 0],
            [0.1, 0, 1, 1, 1, 2, 0],
            [5.0, 0, 1, 2, 1, 2, 0],
            [9.0, 0, 1, 1, 1, 2, 0],
        ]
    )
    found = Detections(
        boxes, np.array([0.6, 0.7, 0.47, 0.2]), np.array([PEDESTRIAN, CYCLIST, CYCLIST, PEDESTRIAN])
    )
    left = detector.score_known(found)
    assert left.boxes.tolist() == boxes[[0, 2]].tolist()
    odds = 0.6 / 0.4 * np.e  # the intercept of 1 multiplies them by e
    assert left.scores == pytest.approx([odds / (1 + odds), 0.47])
    asked = VoxelNetDetector(network, score_threshold=0.01)
    assert asked.at_known_site().thresholds == (0.01, 0.01)
    assert len(asked.score_known(found)) == 4
    known = KnownBackground(detector, Background.learn(np.full((1, 3), 50.0)))
    seen = []

    def detect(self, points):
        seen.append(self.thresholds)
        return found

    monkeypatch.setattr(VoxelNetDetector, "__call__", detect)
    new = boxes[:, :3].astype(np.float32)
    assert len(known(new)) == 2
    assert [len(each) for each in known.unions([new], np.ones((1, 1), bool))] == [2]
    assert seen[0] == (MIN_KNOWN_SCORE,) * 2


def test_what_stands_in_the_empty_site_is_left_out_at_the_network_s_thresholds(monkeypatch, packed):
    middle = np.array([[0.0, 0.0, 0.0, 4.0, 4.0, 1.0, 0.0]])  # ground, which the empty site has too
    stands = Detections(middle, np.array([0.9]), np.array([VEHICLE]))
    monkeypatch.setattr(
        second_stage, "detector_by_area", lambda *_: lambda area: lambda points: stands
    )
    assert [
        len(found)
        for found, *_ in second_stage.detect_recording(
            VoxelNet(make_config(AREA, "fast")), packed, count=1
        )
    ] == [1]
    assert [
        len(found)
        for found, *_ in second_stage.detect_recording(
            VoxelNet(make_config(AREA, "fast")), packed, count=1, known=True
        )
    ] == [0]
    network = VoxelNet(make_config(AREA, "fast"))
    assert second_stage.detect_recording(network, packed, count=0) == []


def test_a_class_that_shadows_another_takes_from_its_scores(detect_by, packed):
    """Everybody is a heavy vehicle with its cab found as a vehicle, half of the time; else a
    vehicle alone."""
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(12):
        heavy = rng.random(30) < 0.5
        found, there, counted = scene(VEHICLE, rng.uniform(0.4, 0.9, 30), ~heavy)
        trucks, drawn, _ = scene(HEAVY, rng.uniform(0.6, 0.95, 30), np.ones(30, bool))
        labels = np.repeat([VEHICLE, HEAVY], [30 - heavy.sum(), heavy.sum()])
        true = Objects(np.concatenate([there.boxes[~heavy], drawn.boxes[heavy]]), labels)
        frames.append((Detections.merge([found, trucks[heavy]]), true, counted))
    detect_by(fake(frames))
    network = VoxelNet(make_config(AREA, "fast", classes=("vehicle", "heavy")))
    (_, _, own, from_heavy), (_, _, from_vehicle, _) = fit_calibration(
        network, packed
    ).config.rivalry
    assert own == 0
    assert from_heavy > 4
    assert from_vehicle < 0.5


def test_flawless_detectors_stay_and_networks_get_a_second_stage(detect_by, limits, packed):
    flawless = [scene(VEHICLE, np.full(50, 0.6), np.ones(50, bool))]
    detect_by(fake(flawless))
    assert fit_calibration(VoxelNet(make_config(AREA, "fast")), packed).config.thresholds == (
        MIN_THRESHOLD,
    )
    limits(second_stage, FACE_STEPS=1)
    torch.manual_seed(0)
    network = VoxelNet(make_config(AREA, "fast"))
    staged = train_faces(network, packed, ("vehicle",), count=2)
    assert staged.config.faces == ("vehicle",)
    for name, tensor in network.state_dict().items():
        assert torch.equal(staged.state_dict()[name], tensor)
    assert len(staged.state_dict()) == len(network.state_dict()) + 19


def solid(rng, box, count=400):
    """Points all over a box, on its sides and its top."""
    points = rng.uniform(-0.5, 0.5, (count, 3))
    face = rng.integers(0, 5, count)
    for number, (axis, at) in enumerate([(0, 0.5), (0, -0.5), (1, 0.5), (1, -0.5), (2, 0.5)]):
        points[face == number, axis] = at
    points = points * box[3:6] + rng.normal(0, 0.015, (count, 3))
    cos, sin = np.cos(box[6]), np.sin(box[6])
    return points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + box[:3]


def box_scene(rng):
    size = rng.uniform([3.0, 1.45, 1.25], [6.0, 2.2, 2.6])
    truth = np.array([[*rng.normal(0, 3, 2), size[2] / 2, *size, rng.uniform(-4, 4)]])
    return solid(rng, truth[0]), displace_boxes(truth, rng), truth


def examples(count, seed=0):
    rng = np.random.default_rng(seed)
    seen, offsets = {sort: [] for sort in SORTS}, {sort: [] for sort in SORTS}
    for _ in range(count):
        points, box, truth = box_scene(rng)
        features = face_features(points, box, np.array([VEHICLE]))
        for number, (sort, offset) in enumerate(zip(SORTS, face_offsets(box, truth), strict=True)):
            seen[sort].append(features[number])
            offsets[sort].append(offset.astype(np.float32))
    return FaceExamples(
        *({sort: np.concatenate(rows) for sort, rows in each.items()} for each in (seen, offsets))
    )


def test_training_repeats_and_needs_examples_that_are_near():
    rows = examples(20)
    first, second = FaceNetworks(), FaceNetworks()
    for networks in (first, second):
        torch.rand(5)
        state = torch.get_rng_state()
        fit_faces(networks, rows, steps=5)
        assert torch.equal(torch.get_rng_state(), state)
    for a, b in zip(first.state_dict().values(), second.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    rows = examples(20)
    far = FaceExamples(
        rows.features, {sort: np.full_like(each, 5.0) for sort, each in rows.offsets.items()}
    )
    assert fit_faces(FaceNetworks(), far, steps=1)["end before"] == pytest.approx(MAX_FACE_SHIFT_M)
    rows = examples(3)
    with pytest.raises(ValueError, match="no examples of a side"):
        fit_faces(
            FaceNetworks(),
            FaceExamples(rows.features, rows.offsets | {"side": np.zeros(0)}),
            steps=1,
        )
    rng = np.random.default_rng(0)
    boxes = np.tile([[5.0, 2, 0.9, 4.4, 1.8, 1.6, 0.3], [1, 1, 1.0, 0.6, 0.6, 1.8, 2.0]], (400, 1))
    off = displace_boxes(boxes, rng)
    np.testing.assert_allclose(off[:, 2] - off[:, 5] / 2, boxes[:, 2] - boxes[:, 5] / 2)
    deviation = (off - boxes)[::2].std(axis=0)
    np.testing.assert_allclose(
        deviation[[0, 1, 3, 4, 5]], [0.1, 0.1, 0.264, 0.126, 0.08], rtol=0.12
    )
    assert (off - boxes)[1::2, :2].std() == pytest.approx(0.1 / 3, rel=0.12)
    assert (np.cos(off[:, 6] - boxes[:, 6]) < 0).mean() == pytest.approx(0.1, abs=0.03)


def test_examples_are_of_the_objects_asked_for(packed):
    vehicles = face_examples(packed, None, ("vehicle",), count=4)
    assert all(len(vehicles.features[sort]) == len(vehicles.offsets[sort]) > 0 for sort in SORTS)
    assert (vehicles.features["end"][:, -4:] == [1, 0, 0, 0]).all()
    both = face_examples(packed, None, ("vehicle", "heavy"), count=4)
    assert {0, 3} == set(both.features["end"][:, -4:].argmax(axis=1).tolist())
    again = face_examples(packed, None, ("vehicle",), count=4)
    np.testing.assert_array_equal(again.features["side"], vehicles.features["side"])
    assert len(face_examples(packed, None, ("vehicle",), count=2).offsets["end"]) < len(
        vehicles.offsets["end"]
    )
