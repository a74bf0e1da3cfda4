"""Every fidelity class by class, on a street where it is known which sensor sees what: what each
says of several classes is what it says of each alone, combined."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

from models.detector_loading import load_detector
from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.fidelity.coverage import Coverage
from placement_env.fidelity.detector import Detected
from placement_env.fidelity.hit_fit import fit_detected
from placement_env.fidelity.hit_model import HitModel, load_models, save_models, shipped_model
from placement_env.fidelity.seeing import see
from placement_env.fidelity.surrogate import Surrogate
from placement_env.fidelity.table import TableFidelity, best_sets, load_table, make_table
from placement_env.fidelity.visibility import Visibility
from placement_env.objective import Objective
from placement_env.protocol import ByClass
from placement_env.search import greedy, swap
from placement_env.search.exact import cpsat, exhaustive
from placement_env.search.exact.cpsat import compute_worth
from placement_env.search.greedy import is_submodular
from placement_env.setting import Setting
from placement_env.subsets import all_subsets
from toolkit.detection.metrics import evaluate
from toolkit.objects import CYCLIST, PEDESTRIAN, VEHICLE, Detections, Objects
from toolkit.points import has_centre_inside
from toolkit.runtime.array_files import read_arrays, write_arrays
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

NAMES = ("vehicle", "cyclist", "pedestrian")
MEAN, WORST = Classes(NAMES, (2.0, 1.0, 1.0)), Classes(NAMES, combine="worst")
SIZES = {VEHICLE: (4.0, 2.0, 1.5), CYCLIST: (1.8, 0.6, 1.7), PEDESTRIAN: (0.6, 0.6, 1.8)}
KINDS = np.array([VEHICLE] * 6 + [PEDESTRIAN] * 4 + [CYCLIST] * 3)
XY = np.column_stack([np.linspace(-18, 18, len(KINDS)), np.tile([-6.0, 6.0], 7)[: len(KINDS)]])
SEES = np.random.default_rng(4).random((4, len(KINDS))) < 0.45
FRAMES = 4
SETS = all_subsets(4)


def boxes_at(places, kinds, shift=0.0):
    sizes = np.array([SIZES[kind] for kind in kinds]).reshape(-1, 3)
    return np.column_stack(
        [places[:, 0] + shift, places[:, 1], sizes[:, 2] / 2, sizes, np.zeros(len(places))]
    )


class Street:
    """Sensor c has three points on what it sees, in all frames but every third one, where it sees
    one object less."""

    site = Site("street", np.array([-20.0, -20.0, 20.0, 20.0]))
    sensors = tuple(Sensor(f"s{c}", DepthCamera(), np.eye(4)) for c in range(4))
    frames, digest = FRAMES, "street"

    def clouds(self, k, c):
        seen = SEES[c] & ((np.arange(len(KINDS)) + k) % 3 != c % 3)
        return np.repeat(np.column_stack([XY[seen], np.full(seen.sum(), 0.5)]), 3, axis=0).astype(
            np.float32
        )

    def objects(self, k):
        return Objects(boxes_at(XY, KINDS), KINDS)


class Reader:
    """A box where there are points, cyclists a little off, and one pedestrian that is taken for a
    cyclist."""

    digest, labels = "reader", ("vehicle", "cyclist", "pedestrian", "heavy")

    def __call__(self, points):
        rows = [
            int(np.abs(XY - point).sum(axis=1).argmin())
            for point in np.unique(points[:, :2], axis=0)
        ]
        kinds = np.array([CYCLIST if row == 7 else KINDS[row] for row in rows], np.int64)
        shift = np.where(kinds == CYCLIST, 0.4, 0.1)
        scores = 0.5 + 0.03 * np.array(rows, float)
        return Detections(boxes_at(XY[rows], kinds, shift), scores, kinds)


def detected(classes=VEHICLES, scheme="early", **options):
    return Detected(Street(), Reader(), scheme, classes=classes, **options)


def seen_by(count=9, objects=90, seed=0):
    rng = np.random.default_rng(seed)
    points = np.where(
        rng.random((count, objects)) < 0.3, rng.integers(1, 300, (count, objects)), 0
    ).astype(np.float32)
    labels = np.repeat([VEHICLE, CYCLIST, PEDESTRIAN], [50, 30, 10])[rng.permutation(objects)]
    points[:, labels == PEDESTRIAN] *= rng.random((count, 10)) < 0.5
    boxes = np.column_stack([rng.uniform(-20, 20, (objects, 2)), np.ones((objects, 5))])
    sent = rng.uniform(100, 900, (count, 5)).astype(np.float32)
    near = rng.uniform(5, 40, points.shape).astype(np.float32)
    return Visibility(
        points, near, np.sort(rng.integers(0, 5, objects)), boxes, sent, sent / 2, labels
    )


def model(label, **numbers):
    return HitModel("early", 0.5, -3.0, 1.5, 0.9, 0.8, 0.2, "made up", label=label, **numbers)


def test_what_is_seen_of_a_class_does_not_depend_on_the_others(small_traffic, small_candidates):
    everything = see(small_traffic, small_candidates, labels=(3, 2, 1, 0))
    assert set(everything.labels.tolist()) == {0, 1, 2}
    for label in range(4):
        alone, part = (
            see(small_traffic, small_candidates, labels=[label]),
            everything.of_classes([label]),
        )
        for name in ("points", "distance", "frame", "boxes", "sent", "far", "labels"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(part, name))
    assert everything.of_classes(range(4)) is everything
    np.testing.assert_array_equal(
        see(small_traffic, small_candidates).points, everything.of_classes([0]).points
    )
    assert everything.select([2, 0]).labels is everything.labels


def test_files_keep_the_class_of_surrogates_and_what_is_seen(tmp_path):
    seen = seen_by()
    seen.save(tmp_path / "new.npz")
    np.testing.assert_array_equal(Visibility.load(tmp_path / "new.npz").labels, seen.labels)
    arrays = read_arrays(tmp_path / "new.npz")
    del arrays["labels"]
    write_arrays(tmp_path / "old.npz", arrays)
    assert (Visibility.load(tmp_path / "old.npz").labels == VEHICLE).all()
    del arrays["far"]
    write_arrays(tmp_path / "damaged.npz", arrays)
    with pytest.raises(ValueError, match="must hold"):
        Visibility.load(tmp_path / "damaged.npz")
    save_models((model("cyclist"), model("vehicle")), tmp_path / "models.json")
    assert [one.label for one in load_models(tmp_path / "models.json")] == ["cyclist", "vehicle"]
    damaged = (tmp_path / "models.json").read_text().replace('"cyclist"', '"tram"')
    (tmp_path / "models.json").write_text(damaged)
    with pytest.raises(ValueError, match="label must be one of vehicle, cyclist"):
        load_models(tmp_path / "models.json")
    (tmp_path / "models.json").write_text(damaged.replace('"tram"', "3"))
    with pytest.raises(ValueError, match="label must be one of"):
        load_models(tmp_path / "models.json")


@pytest.mark.parametrize("views", [1, 2])
def test_coverage_of_classes(views):
    seen, sets = seen_by(), all_subsets(9)[::7]
    several = Coverage(seen, "late", views=views, classes=MEAN)
    each = several.by_class(sets)
    for k, name in enumerate(NAMES):
        alone = Coverage(seen, "late", views=views, classes=Classes((name,)))
        np.testing.assert_array_equal(each.ap[:, k], alone(sets).ap)
        own = seen.labels == Classes((name,)).labels[0]
        expected = ((sets.astype(int) @ (seen.points[:, own] >= 20)) >= views).mean(axis=1)
        np.testing.assert_allclose(alone(sets).ap, expected)
    np.testing.assert_allclose(several(sets).ap, each.ap @ np.array(MEAN.weights))
    np.testing.assert_array_equal(
        Coverage(seen, views=views, classes=WORST)(sets).ap, each.ap.min(axis=1)
    )
    plain = Coverage(seen.of_classes([VEHICLE]), "late", views=views)
    for mine, theirs in zip(Coverage(seen, "late", views=views)(sets), plain(sets), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    boxes_of_all = Coverage(seen, "late", views=views, classes=MEAN)(sets).kbit
    assert (boxes_of_all >= plain(sets).kbit).all()
    assert boxes_of_all.sum() > plain(sets).kbit.sum()


def test_the_surrogate_of_classes_is_that_of_each_class_it_knows():
    seen, sets = seen_by(), all_subsets(9)[::9]
    models = [model("pedestrian", reach=1.0), model("vehicle"), model("cyclist", oblique=0.4)]
    each = Surrogate(seen, "early", models, classes=MEAN).by_class(sets)
    for k, name in enumerate(NAMES):
        (own,) = [one for one in models if one.label == name]
        alone = Surrogate(seen, "early", own, classes=Classes((name,)))(sets)
        np.testing.assert_array_equal(each.ap[:, k], alone.ap)
        np.testing.assert_array_equal(each.recall[:, k], alone.recall)
    np.testing.assert_array_equal(
        Surrogate(seen, "early", models, classes=WORST)(sets).ap, each.ap.min(axis=1)
    )
    with pytest.raises(
        ValueError, match="there is no model of cyclist: pass one fitted to each class"
    ):
        Surrogate(seen, "early", [model("vehicle"), model("pedestrian")], classes=MEAN)
    with pytest.raises(
        ValueError, match=r"of general for early at IoU 0.7 of heavy: .*coview surrogate fits one"
    ):
        shipped_model("early", 0.7, "general", label="heavy")
    seen = seen_by()
    without = replace(seen, labels=np.where(seen.labels == PEDESTRIAN, CYCLIST, seen.labels))
    sets = all_subsets(9)[::50]
    each = Coverage(without, classes=WORST).by_class(sets)
    assert np.isnan(each.ap[:, 2]).all()
    np.testing.assert_array_equal(
        Coverage(without, classes=WORST)(sets).ap, each.ap[:, :2].min(axis=1)
    )
    nobody = replace(seen, labels=np.full(90, 3))
    assert (Coverage(nobody, classes=WORST)(sets).ap == 0).all()
    models = [model(name) for name in NAMES]
    assert (Surrogate(nobody, "early", models, classes=WORST)(sets).recall == 0).all()


def test_sites_have_surrogates_of_classes_and_worth_has_parts():
    known = (("vehicle", 0.7), ("cyclist", 0.5), ("pedestrian", 0.5))
    for site, scheme, (label, iou) in product(
        ("tjunction", "roundabout"), ("early", "late"), known
    ):
        model = shipped_model(scheme, iou, site, label=label)
        assert (model.label, model.scheme) == (label, scheme)
    labels = np.array([0, 0, 0, 2])
    worth, whole = compute_worth(labels, Classes(("vehicle", "pedestrian"), (1.0, 1.0)))
    assert whole == 10**9
    assert worth.tolist() == [[166666667, 166666667, 166666667, 500000000]]
    worst, whole = compute_worth(
        labels, Classes(("vehicle", "cyclist", "pedestrian"), combine="worst")
    )
    assert worst.tolist() == [[333333333] * 3 + [0], [0, 0, 0, 10**9]]
    worth, whole = compute_worth(labels[:3], VEHICLES)
    assert (worth.tolist(), whole) == ([[1, 1, 1]], 3)


@pytest.mark.parametrize("scheme", ["early", "late"])
def test_the_detector_is_scored_class_by_class(scheme):
    found = detected(MEAN, scheme)
    each = found.by_class(SETS)
    for row, chosen in enumerate(SETS):
        members = tuple(np.flatnonzero(chosen).tolist())
        detections = [found.detections(members, k) for k in range(FRAMES)]
        truths = [Street().objects(k) for k in range(FRAMES)]
        counted = [has_centre_inside(there.boxes, Street.site.area) for there in truths]
        for c, name in enumerate(NAMES):
            iou = MEAN.get_iou(name, 0.7)
            (at,) = evaluate(
                detections, truths, iou_thresholds=[iou], label=name, counted=counted
            ).values()
            assert each.ap[row, c] == pytest.approx(at.ap, abs=1e-12)
            assert each.recall[row, c] == pytest.approx(at.recall, abs=1e-12)
    assert isinstance(found, ByClass)
    np.testing.assert_allclose(found(SETS).ap, each.ap @ np.array(MEAN.weights), atol=1e-12)
    np.testing.assert_array_equal(detected(WORST, scheme)(SETS).ap, each.ap.min(axis=1))
    np.testing.assert_array_equal(detected(VEHICLES, scheme)(SETS).ap, each.ap[:, 0])
    assert np.ptp(each.ap, axis=0).min() > 0.1


def test_classes_do_not_mix_in_a_memo_and_a_small_one_has_its_iou(tmp_path):
    fresh = {
        name: detected(some)(SETS).ap
        for name, some in (("mean", MEAN), ("worst", WORST), ("one", VEHICLES))
    }
    for name, classes in (("one", VEHICLES), ("worst", WORST), ("mean", MEAN), ("one", VEHICLES)):
        np.testing.assert_array_equal(
            detected(classes, memo=tmp_path / "memo")(SETS).ap, fresh[name]
        )
    strict = Classes(NAMES, ious=(None, 0.7, None))
    sure, half = detected(strict).by_class(SETS), detected(MEAN).by_class(SETS)
    assert sure.ap[-1, 1] < half.ap[-1, 1]
    np.testing.assert_array_equal(sure.ap[:, [0, 2]], half.ap[:, [0, 2]])
    at = detected(MEAN).class_estimates(SETS)
    np.testing.assert_array_equal(at[0.7].ap[:, 1:], at[0.9].ap[:, 1:])

    class CarReader(Reader):
        labels = ("vehicle",)  # type: ignore[assignment]

    reader, both = CarReader(), ("vehicle", "pedestrian")
    cars = load_detector("vehicles/general", area=load_site("roundabout").area)
    with pytest.raises(ValueError, match="knows vehicle only, not cyclist, pedestrian"):
        Detected(Street(), reader, "early", classes=MEAN)
    with pytest.raises(ValueError, match="knows vehicle only, not pedestrian"):
        Objective(
            Setting(
                "roundabout", fidelity="detector", candidates="pool", classes=both, detector=cars
            ),
            Run(frames=2),
        )


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "street.npz"
    return make_table(Street(), Reader(), path, classes=MEAN), path


@pytest.mark.slow
def test_a_table_holds_every_class(table):
    made, path = table
    kept = load_table(path)
    assert kept.origin == made.origin
    assert kept.origin.classes == NAMES
    assert kept.origin.ious == ((0.7, 0.8, 0.9), (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
    for scheme in ("early", "late", "hybrid"):
        for classes in (MEAN, WORST, VEHICLES, Classes(("pedestrian",))):
            looked_up, measured = (
                TableFidelity(kept, scheme, classes=classes),
                detected(classes, scheme),
            )
            for mine, theirs in zip(looked_up(SETS), measured(SETS), strict=True):
                np.testing.assert_allclose(mine, theirs, atol=1e-12)
            np.testing.assert_allclose(
                looked_up.by_class(SETS).ap, measured.by_class(SETS).ap, atol=1e-12
            )
    top = best_sets(kept, "early", classes=WORST)[2][0]
    pairs = list(combinations(range(4), 2))
    worst = {pair: detected(WORST)(np.isin(np.arange(4), pair)[None]).ap[0] for pair in pairs}
    assert top.ap == pytest.approx(max(worst.values()))


def test_a_table_refuses_what_it_has_not(table, tmp_path):
    made, _ = table
    with pytest.raises(
        ValueError,
        match="holds vehicle, cyclist, pedestrian, not heavy: make one with coview table",
    ):
        TableFidelity(made, classes=Classes(("heavy",)))
    with pytest.raises(
        ValueError,
        match=r"IoU \(0.5,\) of pedestrian, got 'early' and 0.25: say --fidelity detector",
    ):
        TableFidelity(made, classes=Classes(NAMES, ious=(None, None, 0.25)))
    with pytest.raises((ValueError, TypeError), match=r"needs|Type-check"):
        replace(made, more_ap=made.more_ap[:1], more_recall=made.more_recall[:1])
    plain = make_table(Street(), Reader(), tmp_path / "plain.npz")
    assert set(read_arrays(tmp_path / "plain.npz")) == {"ap", "recall", "kbit", "origin"}
    assert plain.origin.classes == ("vehicle",)
    with pytest.raises(ValueError, match="holds vehicle, not cyclist"):
        TableFidelity(plain, classes=MEAN)


def test_searches_find_the_set_of_the_best_worst_class(make):
    """By exhaustive comparison: what each search answers for the worst class, and that it is
    another set."""
    parts, seen = make(9, 1), seen_by(9, seed=3)
    by_classes = {}
    for classes in (VEHICLES, MEAN, WORST):
        objective = Objective(
            Setting(
                candidates=parts.candidates,
                fidelity=Coverage(seen, classes=classes),
                scheme="early",
            ),
            visibility=seen,
        )
        sets = all_subsets(9)
        sets = sets[(sets.sum(axis=1) <= 3) & (sets.sum(axis=1) > 0)]
        each = Coverage(seen, classes=MEAN).by_class(sets).ap
        figures = {
            VEHICLES: each[:, 0],
            MEAN: each @ np.array(MEAN.weights),
            WORST: each.min(axis=1),
        }[classes]
        found = exhaustive.search(objective, 3)
        assert found.best.reward == pytest.approx(figures.max())
        row = int((sets == np.isin(np.arange(9), found.best.subset)).all(axis=1).argmax())
        assert list(found.best.class_ap.values()) == pytest.approx(
            each[row, : len(classes)].tolist()
        )
        for other in (greedy.search(objective, 3), swap.search(objective, 3, seed=0)):
            assert other.best.reward <= found.best.reward + 1e-12
            assert other.best.reward >= 0.6 * found.best.reward
        exact = cpsat.search(objective, 3)
        assert exact.certificate.kind == "optimal"
        assert exact.best.reward == pytest.approx(found.best.reward)
        assert exact.certificate.value == pytest.approx(found.best.reward, abs=1e-6)
        by_classes[classes] = found.best
    assert by_classes[WORST].subset != by_classes[VEHICLES].subset
    vehicles = np.isin(np.arange(len(seen)), by_classes[VEHICLES].subset)
    assert (
        min(by_classes[WORST].class_ap.values())
        > Coverage(seen, classes=WORST)(vehicles[None]).ap[0]
    )
    assert is_submodular(
        Objective(
            Setting(
                candidates=parts.candidates, fidelity=Coverage(seen, classes=MEAN), scheme="early"
            )
        )
    )
    assert not is_submodular(
        Objective(
            Setting(
                candidates=parts.candidates, fidelity=Coverage(seen, classes=WORST), scheme="early"
            )
        )
    )


def test_an_objective_says_what_each_class_gets(make):
    seen, candidates = seen_by(9), make(9, 1).candidates
    several = Objective(
        Setting(candidates=candidates, fidelity=Coverage(seen, classes=WORST), scheme="early"),
        visibility=seen,
    )
    score = several.score([0, 4])
    assert list(score.class_ap) == list(NAMES)
    assert score.ap == score.reward == min(score.class_ap.values())
    assert not score.cache_hit
    assert several.score([4, 0]).cache_hit
    assert several.class_ap(several.row([])[None]).tolist() == [[0.0, 0.0, 0.0]]
    assert several.provenance["classes"] == WORST.origin
    plain = Objective(
        Setting(candidates=candidates, fidelity=Coverage(seen), scheme="early"), visibility=seen
    )
    assert plain.score([0, 4]).class_ap == {"vehicle": plain.score([0, 4]).ap}
    assert (
        several.scores(all_subsets(9)).ap.tolist()
        == Coverage(seen, classes=WORST)(all_subsets(9)).ap.tolist()
    )


def test_a_model_of_each_class_is_fitted_to_the_detector():
    found = detected(MEAN)
    street, counts = Street(), []
    for c in range(4):
        clouds = [street.clouds(k, c) for k in range(FRAMES)]
        counts.append(
            [
                (np.abs(cloud[:, :2] - place).sum(axis=1) < 0.1).sum()
                for cloud in clouds
                for place in XY
            ]
        )
    boxes = np.tile(boxes_at(XY, KINDS), (FRAMES, 1))
    frame, labels = np.repeat(np.arange(FRAMES), len(KINDS)), np.tile(KINDS, FRAMES)
    sent = np.ones((4, FRAMES), np.float32)
    points = np.array(counts, np.float32)
    seen = Visibility(
        points, np.full(points.shape, 20, np.float32), frame, boxes, sent, sent, labels
    )
    models = tuple(each.model for each in fit_detected([(seen, found, SETS[1:])], source="street"))
    assert [(one.label, one.iou) for one in models] == [
        *(
            ("vehicle", 0.7),
            ("vehicle", 0.8),
            ("vehicle", 0.9),
            ("cyclist", 0.5),
            ("pedestrian", 0.5),
        )
    ]
    guess = Surrogate(seen, "early", [models[0], *models[3:]], classes=MEAN).by_class(SETS).recall
    assert np.abs(guess - found.by_class(SETS).recall).mean(axis=0).max() < 0.12
