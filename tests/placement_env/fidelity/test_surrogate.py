import json
from dataclasses import asdict, replace
from importlib.util import find_spec

import numpy as np
import pytest

from placement_env.fidelity.hit_fit import fit
from placement_env.fidelity.hit_model import FOLDER, HitModel, load_models, save_models, shipped_model
from placement_env.fidelity.protocol import Fidelity
from placement_env.fidelity.published_surrogates import InformationGain, PerceptionEntropy
from placement_env.fidelity.surrogate import Surrogate, expected_ap
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from toolkit.detection.metrics import average_precision, precision_recall

MODEL = HitModel("early", 0.7, -4.0, 1.8, 0.98, 0.7, 0.3, "made up", 0.3, 0.6)
MODELS = {
    "early": MODEL,
    "late": replace(MODEL, scheme="late", norm=6.0),
    "hybrid": replace(MODEL, scheme="hybrid", norm=4.0),
}
SCHEMES = tuple(MODELS)


def random_visibility(candidates=12, objects=300, frames=20, seed=0):
    rng = np.random.default_rng(seed)
    shape = (candidates, objects)
    points = np.where(rng.random(shape) < 0.3, np.rint(rng.lognormal(4, 1.5, shape)), 0).astype(np.float32)
    boxes = np.column_stack(
        [rng.uniform(-30, 30, (objects, 2)), np.tile([0.7, 4.4, 1.8, 1.5], (objects, 1)), rng.uniform(-3, 3, objects)]
    )
    sent, far = (rng.integers(100, 5000, (candidates, frames)).astype(np.float32) for _ in range(2))
    distance = rng.uniform(5, 60, shape).astype(np.float32)
    return Visibility(points, distance, np.sort(rng.integers(0, frames, objects)), boxes, sent, far)


VISIBILITY = random_visibility()
SETS = np.random.default_rng(1).random((60, 12)) < 0.35


def fidelities():
    for scheme in SCHEMES:
        yield Surrogate(VISIBILITY, scheme, MODELS[scheme])
        yield PerceptionEntropy(VISIBILITY, scheme)
    yield InformationGain(VISIBILITY)


@pytest.mark.parametrize("fidelity", list(fidelities()), ids=lambda each: each.name)
def test_every_one_is_a_monotone_fidelity_that_ignores_what_is_beside_a_set(fidelity):
    assert isinstance(fidelity, Fidelity)
    estimate = fidelity(SETS)
    for column in estimate:
        assert column.dtype == np.float64
        assert column.shape == (len(SETS),)
    assert ((estimate.ap >= 0) & (estimate.ap <= 1) & (estimate.recall <= 1)).all()
    shuffled = np.random.default_rng(2).permutation(len(SETS))
    for column, again in zip(estimate, fidelity(SETS[shuffled]), strict=True):
        np.testing.assert_array_equal(column[shuffled], again)
    empty = fidelity(np.zeros((1, 12), bool))
    assert [column[0] for column in empty] == [0, 0, 0]
    more = fidelity(SETS | (np.arange(12) == 5))
    assert (more.recall >= estimate.recall - 1e-6).all()


def test_hits_and_ap_against_plain_python():
    surrogate = Surrogate(VISIBILITY, "early", MODEL)
    chosen = np.flatnonzero(SETS[7])
    p = []
    for o in range(VISIBILITY.points.shape[1]):
        turned = np.exp(-MODEL.oblique * abs(np.sin(2 * VISIBILITY.boxes[o, 6])))
        n = [VISIBILITY.points[c, o] * (VISIBILITY.distance[c, o] / 20) ** MODEL.reach * turned for c in chosen]
        total = sum(float(each) ** MODEL.norm for each in n)
        z = MODEL.intercept + MODEL.density * np.log1p(total) / MODEL.norm
        p.append(MODEL.ceiling / (1 + np.exp(-z)) if total else 0.0)
    p.sort(reverse=True)
    hits, area = 0.0, 0.0
    for i, each in enumerate(p, 1):
        hits += each
        area += each * (hits / (hits + MODEL.false_alarms * (i - hits)) if hits else 0.0)
    estimate = surrogate(SETS[7:8])
    assert estimate.ap[0] == pytest.approx(area / len(p), rel=1e-4)
    assert estimate.recall[0] == pytest.approx(sum(p) / len(p), rel=1e-4)


def test_expected_ap_is_that_of_many_draws():
    """Certain and impossible objects, each of which a false alarm outranks: the AP of that very list."""
    hit = np.array([1, 1, 0, 1, 0, 0, 1, 0], np.float32)
    ap, recall = expected_ap(hit[None], 1.0)
    exact = precision_recall(np.arange(8, 0, -1.0), hit > 0, 8)
    raw = sum(exact.precision[i] / 8 for i in np.flatnonzero(hit))
    assert ap[0] == pytest.approx(raw)
    assert recall[0] == 0.5
    assert ap[0] <= average_precision(exact) + 1e-9


def test_late_fusion_goes_by_the_best_view_and_early_by_all():
    points = np.array([[40, 40], [40, 0]], np.float32)
    seen = replace(random_visibility(2, 2), points=points, distance=np.full((2, 2), 20, np.float32))
    one, both = np.array([[True, False]]), np.array([[True, True]])
    gain = {
        s: (Surrogate(seen, s, MODELS[s])(both).recall - Surrogate(seen, s, MODELS[s])(one).recall)[0] for s in SCHEMES
    }
    assert gain["early"] > 3 * gain["late"] > 0


def test_hybrid_fusion_sums_the_points_beyond_its_radius():
    """Two sensors with 40 points each on four vehicles, one of them 16 m off: within 20 m, beyond 12 m."""
    seen = replace(
        random_visibility(2, 4), points=np.full((2, 4), 40, np.float32), distance=np.full((2, 4), 16, np.float32)
    )
    both, model = np.ones((1, 2), bool), replace(MODELS["hybrid"], reach=0.0, oblique=0.0)
    recall = {radius: Surrogate(seen, "hybrid", model, radius=radius)(both).recall[0] for radius in (12.0, 20.0)}
    near, far = 2 * 40.0**model.norm, 2 * 40.0**model.norm + 80.0**model.norm
    assert recall[20.0] == pytest.approx(model.probability(np.array([near]))[0], rel=1e-5)
    assert recall[12.0] == pytest.approx(model.probability(np.array([far]))[0], rel=1e-5)
    assert recall[12.0] > recall[20.0] + 0.01


@pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
def test_an_objective_takes_the_radius_of_its_site():
    objective = Objective("roundabout", frames=3, scheme="hybrid", fidelity="surrogate")
    sets = np.random.default_rng(0).random((20, len(objective.candidates))) < 0.5
    model = shipped_model("hybrid", 0.7, "roundabout")
    assert objective.visibility is not None
    by_radius = {r: Surrogate(objective.visibility, "hybrid", model, radius=r)(sets).ap for r in (12.0, 20.0)}
    np.testing.assert_array_equal(objective.scores(sets).ap, by_radius[12.0])
    assert (by_radius[12.0] != by_radius[20.0]).any()


def test_a_vehicle_at_an_angle_to_the_axes_needs_more_points():
    points, boxes = np.full((1, 4), 30, np.float32), np.tile([0, 0, 0.7, 4.4, 1.8, 1.5, 0.0], (4, 1))
    boxes[:, 6] = np.deg2rad([0, 90, 180, 45])
    seen = replace(random_visibility(1, 4), points=points, distance=np.full((1, 4), 20, np.float32), boxes=boxes)
    along, turned = (
        Surrogate(replace(seen, boxes=boxes[[row] * 4]), "early", MODEL)(np.array([[True]])).recall[0] for row in (0, 3)
    )
    mixed = Surrogate(seen, "early", MODEL)(np.array([[True]])).recall[0]
    assert along > turned + 0.05
    assert mixed == pytest.approx((3 * along + turned) / 4, abs=1e-6)


def test_fit_finds_the_model_that_made_the_hits():
    sets = SETS[:30]
    seen = random_visibility(12, 250, seed=5)
    surrogate = Surrogate(seen, "early", MODEL)
    sums = np.stack([surrogate._sums(row[None])[0] for row in sets])
    hits = np.random.default_rng(6).random(sums.shape) < MODEL.probability(sums)
    found = fit(seen, sets, hits, surrogate(sets).ap, scheme="early", iou=0.7, source="test")
    estimate, truth = Surrogate(seen, "early", found)(sets), surrogate(sets)
    np.testing.assert_allclose(estimate.recall, truth.recall, atol=0.03)
    np.testing.assert_allclose(estimate.ap, truth.ap, atol=0.03)
    assert found.norm == pytest.approx(MODEL.norm, abs=0.4)
    assert found.density == pytest.approx(MODEL.density, rel=0.3)
    assert found.oblique == pytest.approx(MODEL.oblique, abs=0.3)


def test_fit_refuses_other_frames_and_certainty():
    with pytest.raises(ValueError, match="same frames"):
        fit(VISIBILITY, SETS, np.zeros((60, 5), bool), np.zeros(60), scheme="early", iou=0.7)
    with pytest.raises(ValueError, match="hits and misses"):
        fit(VISIBILITY, SETS, np.zeros((60, 300), bool), np.zeros(60), scheme="early", iou=0.7)


def test_models_come_back_from_their_file(tmp_path):
    models = tuple(MODELS.values())
    save_models(models, tmp_path / "m.json")
    assert load_models(tmp_path / "m.json") == models
    assert [path.name for path in tmp_path.iterdir()] == ["m.json"]


@pytest.mark.parametrize(
    "change",
    [
        lambda row: row.pop("norm"),
        lambda row: row.update(more=1),
        lambda row: row.update(norm="1"),
        lambda row: row.update(norm=float("nan")),
        lambda row: row.update(density=-1.0),
        lambda row: row.update(ceiling=True),
        lambda row: row.update(scheme="middle"),
        lambda row: row.update(source=3),
    ],
)
def test_damaged_models_are_refused_in_one_line(tmp_path, change):
    row = asdict(MODEL)
    change(row)
    path = tmp_path / "m.json"
    path.write_text(json.dumps([row]))
    with pytest.raises(ValueError, match=r"m\.json") as caught:
        load_models(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '[{"scheme": "early"'])
def test_what_is_no_file_of_models_is_refused(tmp_path, text):
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ValueError, match=r"m\.json"):
        load_models(tmp_path / "m.json")


def test_shipped_models_load_for_all_schemes_and_thresholds():
    for path in FOLDER.glob("*.json"):
        for scheme in SCHEMES:
            for iou in (0.7, 0.8, 0.9):
                assert shipped_model(scheme, iou, path.stem).scheme == scheme
    with pytest.raises(ValueError, match="choose among"):
        shipped_model("early", 0.35)
    with pytest.raises(ValueError, match="early fusion, not for late"):
        Surrogate(VISIBILITY, "late", MODEL)


def test_information_gain_counts_the_cells_that_are_uncertain():
    """Two places: one always occupied, one in half of the frames; only the second is worth seeing."""
    boxes = np.array([[0, 0, 0.7, 4, 2, 1.5, 0], [30, 0, 0.7, 4, 2, 1.5, 0], [0, 0, 0.7, 4, 2, 1.5, 0]], np.float64)
    seen = Visibility(
        np.array([[9, 0, 9], [0, 9, 0]], np.float32),
        np.full((2, 3), 9, np.float32),
        np.array([0, 0, 1]),
        boxes,
        np.ones((2, 2), np.float32),
        np.ones((2, 2), np.float32),
    )
    np.testing.assert_allclose(InformationGain(seen)(np.eye(2, dtype=bool)).ap, [0, 1])
