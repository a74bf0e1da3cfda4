"""`VoxelNetDetector` and `load_detector`: maps become detections, files become detectors or
one-line errors."""

import dataclasses

import numpy as np
import pytest
import torch

from models.config import VoxelNetConfig, road_users
from models.detector import VoxelNetDetector
from models.detector_loading import load_detector
from models.network.candidates import MIN_RIVAL_SCORE, apply_rivals
from models.network.grid import collate, voxelise
from models.network.voxelnet import VoxelNet
from models.weight_files import WeightsHeader, load_weights, save_weights
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Detector, UnionDetector

CONFIG = VoxelNetConfig.light((-8, -8, 8, 8))


def network(config=CONFIG, seed=0, logit=-1.0):
    torch.manual_seed(seed)
    made = VoxelNet(config).eval()
    torch.nn.init.normal_(made.head.classes.bias, logit, 0.1)
    return made


def points(n=2000, seed=0):
    return np.random.default_rng(seed).uniform((-9, -9, -1), (9, 9, 4), (n, 3)).astype(np.float32)


def test_shifted_grids_pool_what_each_of_them_finds():
    detector, cloud = VoxelNetDetector(network()), points()
    phased = detector.shift_grids(3)
    assert (detector.phases, phased.phases) == (1, 3)
    assert phased.digest != detector.digest == detector.shift_grids(1).digest
    assert not len(phased(cloud[:0]))
    # cells of the map are 0.4 m
    shifts = np.outer(np.arange(3), [0.7548776662466927, 0.5698402909980532]) % 1 * 0.4
    parts = []
    for shift in shifts:
        found = detector(cloud + np.float32([*shift, 0]))
        parts.append(found.boxes[:, :2] - shift)
    found, best = phased(cloud), detector(cloud)
    each = np.concatenate(parts)
    away = np.linalg.norm(found.boxes[:, None, :2] - each, axis=2).min(axis=1)
    assert len(found)
    assert np.median(away) < 0.5  # boxes are means of those that overlap
    moved = []

    def note(clouds):
        moved.append(clouds[0] - cloud)
        return [best]

    noting = detector.shift_grids(3)
    vars(noting)["batch"] = note
    noting(cloud)
    np.testing.assert_allclose([each[0, :2] for each in moved], shifts, atol=1e-5)
    assert found.scores.max() >= best.scores.max() - 1e-6
    halves = [cloud[:900], cloud[900:]]
    (union,) = phased.unions(halves, np.ones((1, 2), bool))
    np.testing.assert_array_equal(union.boxes, found.boxes)


def test_grids_are_shifted_by_parts_of_a_cell_along_each_axis():
    # cells of the map are 0.5 m along x and 0.3 m along y, and the area ends within a cell
    config = dataclasses.replace(
        CONFIG, area=(-8.0, -8.0, 8.3, 7.9), voxel_size=(0.25, 0.15, CONFIG.voxel_size[2])
    )
    detector = VoxelNetDetector(network(config)).shift_grids(8)
    shifts = []

    def note(clouds):
        shifts.append(clouds[0][0])
        return [Detections.empty()]

    vars(detector)["batch"] = note
    detector(np.zeros((1, 3), np.float32))
    steps = np.array([0.7548776662466927, 0.5698402909980532])
    cells = np.outer(np.arange(8), steps) % 1
    np.testing.assert_allclose(
        shifts, np.column_stack([cells * [0.5, 0.3], np.zeros(8)]), atol=1e-6
    )


def test_digests_change_and_what_is_outside_is_ignored():
    detector: Detector = VoxelNetDetector(network())
    inside = points()
    inside = inside[(np.abs(inside) < 8).all(1)]
    far = np.float32([[100, 0, 1], [0, 0, 30], [np.nan, 0, 1]])
    found, same = detector(inside), detector(np.concatenate((inside, far)))
    assert len(found)
    np.testing.assert_array_equal(found.boxes, same.boxes)
    assert np.all(found.scores > 0.1)
    assert np.all(np.abs(found.boxes[:, :2]) <= 8)
    detector = VoxelNetDetector(network())
    clouds = [points(seed=1), points(300, seed=2)]
    for together, alone in zip(detector.batch(clouds), map(detector, clouds), strict=True):
        np.testing.assert_allclose(together.boxes, alone.boxes, atol=1e-4)
        np.testing.assert_allclose(together.scores, alone.scores, atol=1e-5)

    def changed():
        other = network()
        next(other.parameters()).data[0] += 1e-6
        return other

    digests = [
        *(VoxelNetDetector(network()).digest, VoxelNetDetector(changed()).digest),
        VoxelNetDetector(network(), score_threshold=0.2).digest,
        VoxelNetDetector(network(), nms_threshold=0.2).digest,
    ]
    assert len(set(digests)) == len(digests)
    assert VoxelNetDetector(network()).digest == digests[0]


@pytest.mark.parametrize("empty", [np.zeros((0, 3), np.float32), np.float32([[50, 50, 1]])])
def test_no_points_no_detections(empty):
    detector = VoxelNetDetector(network(logit=9.0))
    assert len(detector(empty)) == 0
    assert [len(each) > 0 for each in detector.batch([empty, points()])] == [False, True]


def test_weights_survive_a_file_and_those_of_a_site_stay_there(tmp_path):
    path, header = (
        tmp_path / "here.safetensors",
        WeightsHeader("tjunction", 7, "abc1234", {"0.7": 0.99}),
    )
    save_weights(path, network(), header)
    loaded, read = load_weights(path)
    assert (read, loaded.config) == (header, CONFIG)
    for name, tensor in network().state_dict().items():
        torch.testing.assert_close(loaded.state_dict()[name], tensor)
    assert list(tmp_path.iterdir()) == [path]
    np.testing.assert_array_equal(
        load_detector(path)(points()).boxes, VoxelNetDetector(network())(points()).boxes
    )
    general, site = tmp_path / "general.safetensors", tmp_path / "site.safetensors"
    save_weights(general, network(), WeightsHeader("general"))
    save_weights(site, network(), WeightsHeader("tjunction"))
    there = (100, 50, 133, 61)
    cloud = points() * np.float32([1.5, 0.5, 1]) + np.float32([116, 55, 0])
    found = load_detector(general, area=there)(cloud)
    assert len(found)
    assert np.all((found.boxes[:, :2] >= (100, 50)) & (found.boxes[:, :2] <= (133, 61)))
    assert load_detector(site, area=CONFIG.area, site="tjunction").area == CONFIG.area
    with pytest.raises(ValueError, match=r"area .* of 'tjunction'.*take detector general"):
        load_detector(site, area=there)
    with pytest.raises(ValueError, match="for 'tjunction', not for 'roundabout'"):
        load_detector(site, site="roundabout")


def test_a_damaged_file_is_one_clear_line(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_weights(path, network(), WeightsHeader("general"))
    data = path.read_bytes()
    flipped = data[:-1000] + bytes([data[-1000] ^ 1]) + data[-999:]
    for damaged in (data[: len(data) // 2], flipped, b"", b"PK" * 99):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="damaged") as error:
            load_detector(path)
        assert "\n" not in str(error.value)


def test_files_of_another_size_or_kind_or_none_are_errors(tmp_path):
    from safetensors.torch import load_file, save_file

    path = tmp_path / "weights.safetensors"
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(ValueError, match="not in the format"):
        load_detector(path)
    wrong = network()
    wrong.config = dataclasses.replace(CONFIG, voxel_width=16)
    save_weights(path, wrong, WeightsHeader())
    with pytest.raises(
        ValueError,
        match=r"features.layers.0.linear.weight must have shape \(16, 6\), got \(32, 6\)",
    ):
        load_detector(path)
    assert "features.layers.0.linear.weight" in load_file(path)
    with pytest.raises(FileNotFoundError, match="no weights named 'nowhere'; shipped: general, "):
        load_detector("nowhere")
    with pytest.raises(FileNotFoundError, match=r"no weights file at /no/x\.safetensors"):
        load_detector("/no/x.safetensors")


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_cuda_detects_the_same():
    here, there = (
        VoxelNetDetector(network())(points()),
        VoxelNetDetector(network(), device="cuda")(points()),
    )
    np.testing.assert_allclose(there.boxes, here.boxes, atol=2e-2)


CLASSES = VoxelNetConfig.light((-8, -8, 8, 8), **road_users())
FIRST_ANCHOR = {VEHICLE: 0, HEAVY: 2, CYCLIST: 4, PEDESTRIAN: 6}


def test_batches_are_their_items_and_thresholds_may_be_replaced(tmp_path):
    detector = VoxelNetDetector(network(CLASSES, logit=0.0))
    clouds = [points(seed=1), points(300, seed=2)]
    for together, alone in zip(detector.batch(clouds), map(detector, clouds), strict=True):
        np.testing.assert_allclose(together.boxes, alone.boxes, atol=1e-4)
        np.testing.assert_array_equal(together.labels, alone.labels)
        assert len(set(alone.labels)) > 1
    path, made = (
        tmp_path / "w.safetensors",
        network(dataclasses.replace(CONFIG, averaging=0.0), logit=0.5),
    )
    scores = VoxelNetDetector(made)(points()).scores
    middle = float(np.median(scores))
    made.config = dataclasses.replace(made.config, score_threshold=middle)
    save_weights(path, made, WeightsHeader("general"))
    own, given = load_detector(path), load_detector(path, score_threshold=0.1)
    assert (own.thresholds, given.thresholds) == ((middle,), (0.1,))
    assert own.digest != given.digest
    np.testing.assert_array_equal(given(points()).scores, scores)
    np.testing.assert_array_equal(own(points()).scores, scores[scores > middle])
    assert 0 < len(own(points())) < len(scores)


def test_every_class_may_have_a_threshold_of_its_own(limits):
    limits("models.network.candidates", MAX_CLOUD_CANDIDATES=10**6)
    small = VoxelNetConfig.light((-3.2, -3.2, 3.2, 3.2), **road_users())
    made = network(dataclasses.replace(small, averaging=0.0), logit=0.5)
    found = VoxelNetDetector(made)(points())
    of_class = [found.scores[found.labels == label] for label in FIRST_ANCHOR]
    least = [float(np.median(scores)) if len(scores) else 0.2 for scores in of_class]
    assert len(set(least)) > 2
    made.config = dataclasses.replace(made.config, thresholds=tuple(least))
    own = VoxelNetDetector(made)
    kept = (
        found.scores > np.array(least)[[list(FIRST_ANCHOR).index(label) for label in found.labels]]
    )
    assert 0 < kept.sum() < len(kept)
    np.testing.assert_array_equal(own(points()).scores, found.scores[kept])
    np.testing.assert_array_equal(own(points()).labels, found.labels[kept])
    np.testing.assert_array_equal(
        VoxelNetDetector(made, score_threshold=0.1)(points()).scores, found.scores
    )


def test_rivals_below_a_class_s_threshold_still_count_and_thresholds_are_of_what_is_left():
    small = dataclasses.replace(
        VoxelNetConfig.light((-3.2, -3.2, 3.2, 3.2), **road_users()), averaging=0.0
    )
    made = network(small, logit=0.5)
    rows = ((1.0, 0.0, 0.0, 1.0, 1.0, 2.0),) * 4
    bare = VoxelNetDetector(made, score_threshold=MIN_RIVAL_SCORE)(points())
    made.config = dataclasses.replace(small, rivalry=rows)
    expected = apply_rivals(bare, made.config)
    assert (expected.scores < bare.scores).any()
    for least in (0.0, 0.15, 0.3, 0.45):
        own = VoxelNetDetector(made, score_threshold=least)(points())
        kept = expected[expected.scores > least]
        if least >= MIN_RIVAL_SCORE:
            np.testing.assert_array_equal(own.scores, kept.scores)
            np.testing.assert_array_equal(own.boxes, kept.boxes)
        else:
            assert set(kept.scores) <= set(own.scores)
            assert (own.scores > least).all()


def test_a_second_stage_and_classes_survive_a_file_or_are_missed(tmp_path):
    config = dataclasses.replace(
        CLASSES, faces=("vehicle", "heavy"), calibration=((1.2, -0.1),) * 4
    )
    made, path = network(config), tmp_path / "w.safetensors"
    made.faces.prior[:] = torch.tensor([0.1, 0.05, 0.02])
    save_weights(path, made, WeightsHeader("general"))
    loaded, _ = load_weights(path)
    assert loaded.config == config
    for name, tensor in made.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor)
    here, there = VoxelNetDetector(made)(points()), load_detector(path)(points())
    np.testing.assert_array_equal(here.boxes, there.boxes)
    assert len(load_detector(path, area=(-8, -8, 8, 6))(points()))
    path, made = tmp_path / "w.safetensors", network()
    made.config = dataclasses.replace(CONFIG, faces=("vehicle",))
    save_weights(path, made, WeightsHeader("general"))
    with pytest.raises(ValueError, match=r"lacks faces\.end\.0\.bias"):
        load_detector(path)


def assert_unions(detector, clouds, unions):
    found = detector.unions(clouds, unions)
    assert len(found) == len(unions)
    for row, each in zip(unions, found, strict=True):
        alone = detector(
            np.concatenate(
                [np.zeros((0, 3), np.float32), *(clouds[c] for c in np.flatnonzero(row))]
            )
        )
        np.testing.assert_array_equal(each.labels, alone.labels)
        np.testing.assert_allclose(each.boxes, alone.boxes, atol=1e-4)
        np.testing.assert_allclose(each.scores, alone.scores, atol=1e-5)
    return found


EIGHT = np.array(list(np.ndindex(2, 2, 2)), bool)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "config",
    [
        *(CONFIG, dataclasses.replace(CLASSES, faces=("vehicle", "heavy"), averaging=0.7)),
        dataclasses.replace(CONFIG, max_points=2),  # voxels of some unions are crowded
        dataclasses.replace(
            VoxelNetConfig.from_paper("tjunction"), area=CONFIG.area, middle_widths=(8, 8, 8)
        ),
    ],
    ids=["light", "classes, faces", "crowded", "published"],
)
@pytest.mark.parametrize("most_own", [0.0, 1.0], ids=["one by one", "at once"])
def test_unions_are_detected_in_as_their_points_are(config, most_own, limits):
    detector = VoxelNetDetector(network(config, logit=0.0))
    assert isinstance(detector, UnionDetector)
    clouds = [points(150, seed=1), points(150, seed=2) * np.float32([0.3, 0.3, 1]), points(0)]
    limits("models.network.tiles", MAX_UNSHARED_SHARE=most_own)
    limits("models.network.tiles", PLAN_COST_UNIONS=0)
    found = assert_unions(detector, clouds, EIGHT)
    assert len(found[6]) > 0
    assert len(found[0]) == len(found[1]) == 0


def test_unions_may_have_many_candidates_or_none(limits):
    detector = VoxelNetDetector(network(logit=1.0))
    clouds = [points(60, seed=1), points(60, seed=2)]
    limits("models.network.candidates", MAX_CLOUD_CANDIDATES=30)
    assert_unions(detector, clouds, EIGHT[:4, 1:])
    detector = VoxelNetDetector(network())
    assert detector.unions([points()], np.zeros((0, 1), bool)) == []
    outside = points() + np.float32([100, 0, 0])
    assert [len(each) for each in detector.unions([outside, points(0)], EIGHT[:4, 1:])] == [0] * 4
    assert [len(each) for each in detector.unions([], np.zeros((2, 0), bool))] == [0, 0]


def test_a_quick_detector_differs_a_little_and_says_so(bfloat16_library):
    detector = VoxelNetDetector(network(), score_threshold=0.0)
    bfloat16_library(None)
    assert detector.quick() is detector
    bfloat16_library("torch")
    quick = detector.quick()
    assert quick.digest != detector.digest
    assert quick.quick() is quick
    exact, coarse = (
        each.network(collate([voxelise(torch.as_tensor(points()), CONFIG)]))
        for each in (detector, quick)
    )
    assert coarse.class_logits.dtype == torch.float32
    assert 0 < float((exact.class_logits - coarse.class_logits).abs().max()) < 0.1
    clouds, unions = [points(seed=1), points(seed=2)], np.array([[True, False], [True, True]])
    assert len(quick.unions(clouds, unions)) == 2
    assert {each.dtype for each in detector.network.state_dict().values()} == {torch.float32}
