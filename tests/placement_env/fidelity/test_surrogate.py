from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from placement_env.fidelity.hit_model import shipped_model
from placement_env.fidelity.surrogate import Surrogate, compute_expected_ap
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit.detection.metrics import average_precision, precision_recall
from toolkit.runtime.run import Run

SETS = np.random.default_rng(1).random((60, 12)) < 0.35


@pytest.fixture(scope="module")
def visibility(made_visibility):
    return made_visibility()


def test_hits_and_ap_against_plain_python_of_one_scheme(visibility, hit_model):
    surrogate = Surrogate(visibility, "early", hit_model)
    chosen = np.flatnonzero(SETS[7])
    p = []
    for o in range(visibility.points.shape[1]):
        turned = np.exp(-hit_model.oblique * abs(np.sin(2 * visibility.boxes[o, 6])))
        n = [
            visibility.points[c, o] * (visibility.distance[c, o] / 20) ** hit_model.reach * turned
            for c in chosen
        ]
        total = sum(float(each) ** hit_model.norm for each in n)
        z = hit_model.intercept + hit_model.density * np.log1p(total) / hit_model.norm
        p.append(hit_model.ceiling / (1 + np.exp(-z)) if total else 0.0)
    p.sort(reverse=True)
    hits, area = 0.0, 0.0
    for i, each in enumerate(p, 1):
        hits += each
        area += each * (hits / (hits + hit_model.false_alarms * (i - hits)) if hits else 0.0)
    estimate = surrogate(SETS[7:8])
    assert estimate.ap[0] == pytest.approx(area / len(p), rel=1e-4)
    assert estimate.recall[0] == pytest.approx(sum(p) / len(p), rel=1e-4)
    with pytest.raises(ValueError, match="early fusion, not for late"):
        Surrogate(visibility, "late", hit_model)


def test_expected_ap_is_that_of_many_draws():
    """Certain and impossible objects, each of which a false alarm outranks: the AP of that very
    list."""
    hit = np.array([1, 1, 0, 1, 0, 0, 1, 0], np.float32)
    ap, recall = compute_expected_ap(hit[None], 1.0)
    exact = precision_recall(np.arange(8, 0, -1.0), hit > 0, 8)
    raw = sum(exact.precision[i] / 8 for i in np.flatnonzero(hit))
    assert ap[0] == pytest.approx(raw)
    assert recall[0] == 0.5
    assert ap[0] <= average_precision(exact) + 1e-9


def test_late_early_and_hybrid_go_by_their_views(made_visibility, hit_models):
    points = np.array([[40, 40], [40, 0]], np.float32)
    seen = replace(made_visibility(2, 2), points=points, distance=np.full((2, 2), 20, np.float32))
    one, both = np.array([[True, False]]), np.array([[True, True]])
    gain = {
        s: (
            Surrogate(seen, s, hit_models[s])(both).recall
            - Surrogate(seen, s, hit_models[s])(one).recall
        )[0]
        for s in ("early", "late", "hybrid")
    }
    assert gain["early"] > 3 * gain["late"] > 0
    # Two sensors with 40 points each on four vehicles, one of them 16 m off: within 20 m, beyond 12
    # m.
    seen = replace(
        made_visibility(2, 4),
        points=np.full((2, 4), 40, np.float32),
        distance=np.full((2, 4), 16, np.float32),
    )
    both, model = np.ones((1, 2), bool), replace(hit_models["hybrid"], reach=0.0, oblique=0.0)
    recall = {
        radius: Surrogate(seen, "hybrid", model, radius=radius)(both).recall[0]
        for radius in (12.0, 20.0)
    }
    near, far = 2 * 40.0**model.norm, 2 * 40.0**model.norm + 80.0**model.norm
    assert recall[20.0] == pytest.approx(model.probability(np.array([near]))[0], rel=1e-5)
    assert recall[12.0] == pytest.approx(model.probability(np.array([far]))[0], rel=1e-5)
    assert recall[12.0] > recall[20.0] + 0.01


@pytest.mark.skipif(find_spec("libsumo") is None, reason="traffic needs SUMO")
def test_an_objective_takes_the_radius_of_its_site():
    objective = Objective(
        Setting("roundabout", scheme="hybrid", fidelity="surrogate"), Run(frames=3)
    )
    sets = np.random.default_rng(0).random((20, len(objective.candidates))) < 0.5
    model = shipped_model("hybrid", 0.7, "roundabout")
    assert objective.visibility is not None
    by_radius = {
        r: Surrogate(objective.visibility, "hybrid", model, radius=r)(sets).ap for r in (12.0, 20.0)
    }
    np.testing.assert_array_equal(objective.scores(sets).ap, by_radius[12.0])
    assert (by_radius[12.0] != by_radius[20.0]).any()


def test_a_vehicle_at_an_angle_to_the_axes_needs_more_points(made_visibility, hit_model):
    points, boxes = (
        np.full((1, 4), 30, np.float32),
        np.tile([0, 0, 0.7, 4.4, 1.8, 1.5, 0.0], (4, 1)),
    )
    boxes[:, 6] = np.deg2rad([0, 90, 180, 45])
    seen = replace(
        made_visibility(1, 4), points=points, distance=np.full((1, 4), 20, np.float32), boxes=boxes
    )
    along, turned = (
        Surrogate(replace(seen, boxes=boxes[[row] * 4]), "early", hit_model)(
            np.array([[True]])
        ).recall[0]
        for row in (0, 3)
    )
    mixed = Surrogate(seen, "early", hit_model)(np.array([[True]])).recall[0]
    assert along > turned + 0.05
    assert mixed == pytest.approx((3 * along + turned) / 4, abs=1e-6)


@pytest.mark.parametrize("floor", [0.0, 10.0])
def test_a_van_is_found_less_surely_than_a_car_with_as_many_points(
    made_visibility, hit_model, floor
):
    """Also where it has the most points of all, so that the order of the list changes."""
    points, boxes = (
        np.array([[900, 30]], np.float32),
        np.tile([0, 0, 0.7, 4.4, 1.8, 1.5, 0.0], (2, 1)),
    )
    boxes[0, 3:6] = 8.0, 2.0, 4.0
    model = replace(hit_model, floor=floor, bulk=1.0)
    seen = replace(
        made_visibility(1, 2), points=points, distance=np.full((1, 2), 20, np.float32), boxes=boxes
    )
    van, car = (
        Surrogate(replace(seen, boxes=boxes[[1, 1]], points=points[:, [row] * 2]), "early", model)(
            np.array([[True]])
        ).recall[0]
        for row in (0, 1)
    )
    found = Surrogate(seen, "early", model)(np.array([[True]]))
    assert found.recall[0] == pytest.approx((van / 4 + car) / 2, rel=1e-5)
    assert found.ap == pytest.approx(
        compute_expected_ap(np.array([[car, van / 4]]), model.false_alarms)[0], rel=1e-5
    )
    ((_, of_size, _, _),) = Surrogate(seen, "early", model).evidence()
    assert of_size.tolist() == [0.25, 1.0]


def test_foreground_is_predicted_as_early_and_sends_its_own_bytes(visibility):
    early, foreground = (
        Surrogate(visibility, "early")(SETS),
        Surrogate(visibility, "foreground")(SETS),
    )
    np.testing.assert_array_equal(foreground.ap, early.ap)
    bits = 272 + 5 * visibility.on_objects.astype(float)  # of each message
    sent = np.minimum(bits, 8 * 1398).sum(axis=1)  # in one packet at most
    np.testing.assert_allclose(foreground.kbit, SETS @ np.rint(sent) / (1000 * visibility.frames))
    with pytest.raises(ValueError, match="the model is for late fusion, not for foreground"):
        Surrogate(visibility, "foreground", shipped_model("late"))
