import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

from toolkit.boxes import footprints, iou_3d, iou_bev
from toolkit.detection import metrics
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections, Objects

AT = [0.3, 0.5, 0.7]
CAR = np.array([[0.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]])
BUS = np.array([[20.0, 0.0, 1.5, 12.0, 2.5, 3.0, 0.0]])


def moved(box, x=0.0, y=0.0, z=0.0):
    return box + np.array([x, y, z, 0, 0, 0, 0])


def random_cars(rng, n):
    columns = [rng.uniform(-40, 40, n), rng.uniform(-20, 20, n), rng.uniform(0.6, 1.0, n)]
    sizes = [rng.uniform(low, high, n) for low, high in ((3.5, 5.6), (1.6, 2.1), (1.4, 2.0))]
    return np.column_stack([*columns, *sizes, rng.uniform(-np.pi, np.pi, n)])


def random_frames(seed, frames=6, most=8, noise=0.15):
    """Truths of all labels, some frames without any; detections near some of them, and false
    alarms."""
    rng = np.random.default_rng(seed)
    truths, detections = [], []
    for number in range(frames):
        there = random_cars(rng, 0 if number == 2 else int(rng.integers(1, most)))
        near = there[rng.integers(0, len(there), 2 * len(there))] if len(there) else there
        near = near + rng.normal(0, noise, near.shape)
        boxes = np.concatenate([near, random_cars(rng, 3)])
        truths.append(Objects(there, rng.choice(4, len(there), p=[0.7, 0.1, 0.1, 0.1])))
        labels = rng.choice(3, len(boxes), p=[0.9, 0.05, 0.05])
        detections.append(Detections(boxes, rng.permutation(len(boxes)) + rng.random(), labels))
    return detections, truths


def shapely_iou(a, b, metric):
    (p,), (q,) = shapely.polygons(footprints(a[None])), shapely.polygons(footprints(b[None]))
    overlap, size_a, size_b = p.intersection(q).area, p.area, q.area
    if metric == "3d":
        top, bottom = min(a[2] + a[5] / 2, b[2] + b[5] / 2), max(a[2] - a[5] / 2, b[2] - b[5] / 2)
        overlap, size_a, size_b = overlap * max(0, top - bottom), size_a * a[5], size_b * b[5]
    return overlap / (size_a + size_b - overlap)


def brute_force_ap(detections, truths, threshold, metric):
    """The definition, one box at a time, with GEOS polygons; vehicles only."""
    pool = [
        (score, frame, box)
        for frame, found in enumerate(detections)
        for box, score, label in zip(found.boxes, found.scores, found.labels, strict=True)
        if label == 0
    ]
    cars = [t.boxes[t.labels == 0] for t in truths]
    heavy = [t.boxes[t.labels == 3] for t in truths]
    claimed, hits = set(), []
    for _, frame, box in sorted(pool, key=lambda entry: -entry[0]):
        best, taken = threshold, None
        for row, truth in enumerate(cars[frame]):
            iou = shapely_iou(box, truth, metric)
            if (frame, row) not in claimed and iou >= best:
                best, taken = iou, (frame, row)
        if taken:
            claimed.add(taken)
            hits.append(True)
            continue
        (footprint,) = shapely.polygons(footprints(box[None]))
        large = shapely.polygons(footprints(heavy[frame]))
        on_heavy = any(footprint.intersection(p).area > 0.5 * footprint.area for p in large)
        if not on_heavy and not any(shapely_iou(box, h, metric) >= threshold for h in heavy[frame]):
            hits.append(False)
    n = sum(map(len, cars))
    precision = [sum(hits[: k + 1]) / (k + 1) for k in range(len(hits))]
    recall = [0.0] + [sum(hits[: k + 1]) / n for k in range(len(hits))]
    return sum((recall[k + 1] - recall[k]) * max(precision[k:]) for k in range(len(hits)))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("metric", ["3d", "bev"])
def test_exact_agrees_with_brute_force(seed, metric):
    detections, truths = random_frames(seed)
    results = metrics.evaluate(detections, truths, iou_thresholds=AT, metric=metric)
    for threshold in AT:
        expected = brute_force_ap(detections, truths, threshold, metric)
        assert results[threshold].ap == pytest.approx(expected, abs=1e-12)


def test_precision_recall_and_ap_are_those_by_hand():
    """Scores 9 hit, 8 miss, 7 hit, 6 second hit of a truth already taken; 3 truths in two
    frames."""
    detections = [
        Detections(np.concatenate([CAR, moved(CAR, 30)]), np.array([9.0, 8.0])),
        Detections(np.concatenate([CAR, moved(CAR, 0.1)]), np.array([7.0, 6.0])),
    ]
    truths = [Objects(CAR), Objects(np.concatenate([CAR, moved(CAR, -20)]))]
    result = metrics.evaluate(detections, truths, iou_thresholds=[0.5])[0.5]
    assert (result.tp, result.fp, result.truths) == (2, 2, 3)
    assert result.precision == 0.5
    assert result.recall == pytest.approx(2 / 3)
    assert result.curve.precision == pytest.approx([1, 1 / 2, 2 / 3, 2 / 4])
    assert result.curve.recall == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])
    assert result.curve.score.tolist() == [9, 8, 7, 6]
    assert result.ap == pytest.approx(1 / 3 * 1 + 1 / 3 * 2 / 3)


def test_the_published_protocol_leaves_out_frames_without_truths():
    detections = [Detections(CAR, np.array([0.9])), Detections(CAR, np.array([0.8]))]
    truths = [Objects.empty(), Objects(CAR)]
    assert metrics.evaluate(detections, truths, iou_thresholds=[0.5])[0.5].ap == 0.5
    assert (
        metrics.evaluate(detections, truths, iou_thresholds=[0.5], protocol="published")[0.5].ap
        == 1.0
    )


def test_the_published_protocol_asks_for_the_greatest_overlap():
    # Of two overlapping truths the published protocol asks for the greater overlap.
    assert metrics.claim_then_test(
        np.array([[0.8, 0.1], [0.6, 0.3], [0.1, 0.7]]), 0.5
    ).tolist() == [0, -1, 1]
    assert metrics.claim_then_test(np.array([[0.5, 0.0]]), 0.5).tolist() == [
        -1
    ]  # it must exceed the threshold


def test_a_stray_box_claims_a_truth_in_the_published_protocol():
    # The stray box overlaps nothing, its arg-max is truth 0, and it claims that.
    detections = [Detections(np.concatenate([moved(CAR, 99), CAR]), np.array([0.9, 0.8]))]
    assert metrics.evaluate(detections, [Objects(CAR)], iou_thresholds=[0.5])[0.5].ap == 0.5
    assert (
        metrics.evaluate(detections, [Objects(CAR)], iou_thresholds=[0.5], protocol="published")[
            0.5
        ].ap
        == 0.0
    )


def test_a_threshold_is_met_by_equality():
    detections, truths = [Detections(moved(CAR, z=0.5), np.ones(1))], [Objects(CAR)]
    third = float(iou_3d(detections[0].boxes, CAR)[0, 0])
    assert metrics.evaluate(detections, truths, iou_thresholds=[third])[third].tp == 1
    assert metrics.evaluate(detections, truths, iou_thresholds=[0.9])[0.9].tp == 0
    assert metrics.evaluate([Detections(CAR, np.ones(1))], truths, iou_thresholds=[1])[1.0].tp == 1
    assert metrics.evaluate(detections, truths, iou_thresholds=[0.9], metric="bev")[0.9].tp == 1


def test_detections_of_objects_that_do_not_count_are_ignored():
    boxes = np.concatenate([CAR, moved(CAR, 10)])
    detections, truths = [Detections(boxes, np.ones(2))], [Objects(boxes)]
    result = metrics.evaluate(detections, truths, iou_thresholds=[0.5], counted=[[True, False]])[
        0.5
    ]
    assert (result.tp, result.fp, result.truths) == (1, 0, 1)
    found = match_one(detections[0], truths[0], 0.5, counted=[True, False])
    assert found.ignored.tolist() == [False, True]
    assert found.scored.tolist() == [True, False]


def test_frames_without_objects_or_detections_have_figures():
    detected, there = Detections(CAR, np.ones(1)), Objects(CAR)
    no_truths = metrics.evaluate([detected], [Objects.empty()], iou_thresholds=[0.5])[0.5]
    assert np.isnan([no_truths.ap, no_truths.recall]).all()
    assert (no_truths.tp, no_truths.fp, no_truths.precision) == (0, 1, 0.0)
    no_detections = metrics.evaluate([Detections.empty()], [there], iou_thresholds=[0.5])[0.5]
    assert (no_detections.ap, no_detections.recall) == (0, 0)
    assert np.isnan(no_detections.precision)
    for protocol in ("exact", "published"):
        nothing = metrics.evaluate([], [], iou_thresholds=[0.5], protocol=protocol)[0.5]
        assert np.isnan(nothing.ap)
        assert len(nothing.curve.score) == 0


def test_the_second_label_of_a_heavy_vehicle_is_a_false_alarm_of_vehicles():
    """A truck found as heavy and, on half its length, as vehicle; one found as vehicle alone; a car
    next to them."""
    trucks = np.array([[0, 0, 1.5, 8, 2.5, 3, 0], [20, 0, 1.5, 8, 2.5, 3, 0]])
    car = np.array([[40, 0, 0.8, 4, 2, 1.6, 0]])
    parts = trucks + np.array([-2, 0, -0.5, -4, -0.5, -1, 0])
    truths = Objects(np.concatenate([trucks, car]), np.array(["heavy", "heavy", "vehicle"]))
    labels = np.array(["heavy", "vehicle", "vehicle", "vehicle"])
    found = Detections(
        np.concatenate([trucks[:1], parts, car]), np.array([0.9, 0.5, 0.5, 0.9]), labels
    )
    assert metrics.second_labels(found, truths).tolist() == [False, True, False, False]
    assert metrics.second_labels(found, truths, outside=[False, True, False, False]).sum() == 0
    assert metrics.second_labels(found[1:], truths).sum() == 0
    assert metrics.evaluate([found], [truths], iou_thresholds=[0.5])[0.5].fp == 0


def test_labels_are_scored_alone_and_heavy_ones_excuse():
    boxes = np.concatenate([CAR, moved(CAR, 10)])
    detections, truths = (
        [Detections(boxes, np.ones(2), np.array([0, 1]))],
        [Objects(boxes, np.array([0, 0]))],
    )
    vehicles = metrics.evaluate(detections, truths, iou_thresholds=[0.5])[0.5]
    assert (vehicles.tp, vehicles.fp, vehicles.truths) == (1, 0, 2)
    cyclists = metrics.evaluate(detections, truths, iou_thresholds=[0.5], label="cyclist")[0.5]
    assert (cyclists.tp, cyclists.fp, cyclists.truths) == (0, 1, 0)
    partly = moved(CAR, 25.5)  # a car seen at the back of the bus, 2.5 of its 4 m on it
    beside = moved(CAR, 20, 2.0)
    detections = [
        Detections(np.concatenate([CAR, BUS, partly, beside]), np.array([0.9, 0.8, 0.7, 0.6]))
    ]
    truths = [Objects(np.concatenate([CAR, BUS]), np.array([0, 3]))]
    for protocol in ("exact", "published"):
        result = metrics.evaluate(detections, truths, iou_thresholds=[0.5], protocol=protocol)[0.5]
        assert (result.tp, result.fp, result.truths) == (1, 1, 1)
    heavy = metrics.evaluate(detections, truths, iou_thresholds=[0.5], label="heavy")[0.5]
    assert (heavy.tp, heavy.fp, heavy.truths) == (0, 0, 1)
    inside = moved(CAR, 20)
    truths = [Objects(np.concatenate([inside, BUS]), np.array([0, 3]))]
    assert (
        metrics.evaluate([Detections(inside, np.ones(1))], truths, iou_thresholds=[0.5])[0.5].tp
        == 1
    )


@given(st.integers(0, 2**32 - 1), st.sampled_from(["exact", "published"]))
@settings(max_examples=25, deadline=None)
def test_the_order_of_frames_and_detections_changes_nothing(seed, protocol):
    detections, truths = random_frames(seed % 50)
    rng = np.random.default_rng(seed)
    ap = metrics.evaluate(detections, truths, iou_thresholds=AT, protocol=protocol)
    frames = rng.permutation(len(truths))
    shuffled = [detections[f][rng.permutation(len(detections[f]))] for f in frames]
    again = metrics.evaluate(
        shuffled, [truths[f] for f in frames], iou_thresholds=AT, protocol=protocol
    )
    assert [again[t].ap for t in AT] == pytest.approx([ap[t].ap for t in AT])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_order_of_truths_and_of_equal_scores_changes_nothing(seed):
    detections, truths = random_frames(seed % 50)
    coarse = [Detections(d.boxes, np.floor(d.scores / 4), d.labels) for d in detections]
    rng = np.random.default_rng(seed)
    ap = metrics.evaluate(coarse, truths, iou_thresholds=AT)
    shuffled = [d[rng.permutation(len(d))] for d in coarse]
    again = metrics.evaluate(
        shuffled, [t[rng.permutation(len(t))] for t in truths], iou_thresholds=AT
    )
    assert [again[t].ap for t in AT] == pytest.approx([ap[t].ap for t in AT])


@pytest.mark.parametrize("seed", range(5))
def test_a_false_alarm_that_touches_nothing_never_raises_ap(seed):
    detections, truths = random_frames(seed)
    before = metrics.evaluate(detections, truths, iou_thresholds=AT)
    for score in (-1.0, 3.5, 1e9):
        stray = Detections(moved(CAR, 500), np.array([score]))
        after = metrics.evaluate(
            [Detections.merge([d, stray]) for d in detections], truths, iou_thresholds=AT
        )
        assert all(after[t].ap <= before[t].ap for t in AT)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_sampled_iou_is_near_the_footprints_iou_times_the_heights_overlap(seed):
    rng = np.random.default_rng(seed)
    a = random_cars(rng, 4) * [0.05, 0.05, 1, 1, 1, 1, 1]
    b = random_cars(rng, 3) * [0.05, 0.05, 1, 1, 1, 1, 1]
    off = (
        2 * 2 / 49
        # one of 49 steps in either direction, and IoU moves up to twice as much as the share that
        # is in
    )
    np.testing.assert_allclose(metrics.sample_iou(a, b, "bev"), iou_bev(a, b), atol=off)
    top = np.minimum((a[:, 2] + a[:, 5] / 2)[:, None], b[:, 2] + b[:, 5] / 2)
    bottom = np.maximum((a[:, 2] - a[:, 5] / 2)[:, None], b[:, 2] - b[:, 5] / 2)
    factor = (top - bottom).clip(0) / np.maximum(a[:, 5:6], b[:, 5])
    np.testing.assert_allclose(
        metrics.sample_iou(a, b, "3d"), metrics.sample_iou(a, b, "bev") * factor
    )


def test_sampled_iou_and_matches_name_their_truth():
    a, b = np.array([1.0, 0.5, 1, 4, 2, 1.5, 0.4]), np.array([0.0, 0, 1, 4.4, 1.8, 1.5, -0.3])
    held = 0
    for u in np.linspace(-2.2, 2.2, 50):
        for v in np.linspace(-0.9, 0.9, 50):
            x, y = (
                u * np.cos(-0.3) - v * np.sin(-0.3) - 1,
                u * np.sin(-0.3) + v * np.cos(-0.3) - 0.5,
            )
            held += (
                abs(x * np.cos(0.4) + y * np.sin(0.4)) <= 2
                and abs(y * np.cos(0.4) - x * np.sin(0.4)) <= 1
            )
    overlap = held / 2500 * 4.4 * 1.8
    assert metrics.sample_iou(a[None], b[None], "bev")[0, 0] == pytest.approx(
        overlap / (8 + 4.4 * 1.8 - overlap)
    )
    assert metrics.sample_iou(b[None], b[None])[0, 0] == 1
    boxes = np.concatenate([moved(CAR, 10.1), CAR, moved(CAR, 0.2), moved(CAR, 60), BUS])
    found = match_one(
        Detections(boxes, np.array([0.1, 0.8, 0.9, 0.5, 0.4]), np.array([0, 0, 0, 1, 0])),
        Objects(
            np.concatenate([BUS, CAR, moved(CAR, 10), moved(CAR, -10)]), np.array([3, 0, 0, 0])
        ),
        0.5,
    )
    assert found.truth.tolist() == [2, -1, 1, -1, -1]
    assert found.ignored.tolist() == [False, False, False, True, True]
    assert found.hit.tolist() == [False, True, True, False]
    assert found.scored.tolist() == [False, True, True, True]
    assert found.iou.tolist() == pytest.approx([3.9 / 4.1, 0.0, 3.8 / 4.2, 0.0, 0.0])


@pytest.mark.parametrize("protocol", ["exact", "published"])
def test_match_and_evaluate_agree(protocol):
    detections, truths = random_frames(3, frames=8)
    result = metrics.evaluate(detections, truths, iou_thresholds=[0.5], protocol=protocol)[0.5]
    pairs = [
        p
        for p in zip(detections, truths, strict=True)
        if protocol == "exact" or (p[1].labels == 0).any()
    ]
    found = [match_one(d, t, 0.5, protocol=protocol) for d, t in pairs]
    assert sum(int(m.hit.sum()) for m in found) == result.tp
    assert sum(int((~m.ignored & (m.truth < 0)).sum()) for m in found) == result.fp
    for pair, alone in zip(pairs, found, strict=True):
        np.testing.assert_equal(
            vars(list(metrics.matches(*pair, AT, protocol=protocol))[AT.index(0.5)]), vars(alone)
        )


def test_equal_scores_are_one_point_of_a_curve():
    curve = metrics.precision_recall(
        np.array([0.5, 0.9, 0.5, 0.5]), np.array([True, False, False, True]), truths=2
    )
    assert curve.score.tolist() == [0.9, 0.5]
    assert curve.recall.tolist() == [0, 1]
    assert metrics.average_precision(curve) == 0.5
    two = [scored([CAR, moved(CAR, 50)], [0.9, 0.4]), scored([CAR], [0.7])]
    at = metrics.evaluate(two, [Objects(CAR), Objects(CAR)], iou_thresholds=[0.5])[0.5]
    assert sorted(zip(at.scores.tolist(), at.hits.tolist(), strict=True)) == [
        (0.4, False),
        (0.7, True),
        (0.9, True),
    ]


def test_reliability_is_by_bins_of_scores():
    diagram = metrics.reliability(
        np.array([0.0, 0.05, 0.5, 1.0]), np.array([False, True, True, True])
    )
    assert diagram.count.tolist() == [2, 0, 0, 0, 0, 1, 0, 0, 0, 1]
    np.testing.assert_allclose(diagram.true[[0, 5, 9]], [0.5, 1, 1])
    np.testing.assert_allclose(diagram.score[[0, 5, 9]], [0.025, 0.5, 1])
    assert diagram.error == pytest.approx((2 * 0.475 + 0.5 + 0) / 4)
    assert metrics.reliability(
        np.array([-0.5, 1.5]), np.array([False, True]), bins=2
    ).count.tolist() == [1, 1]
    assert metrics.reliability(np.zeros(0), np.zeros(0, bool)).error == 0


def test_usual_thresholds_are_of_the_size_of_a_class():
    assert metrics.TRUE_IOU == {VEHICLE: 0.5, CYCLIST: 0.5, PEDESTRIAN: 0.25, HEAVY: 0.5}
    assert metrics.USUAL_IOUS[VEHICLE] == metrics.USUAL_IOUS[HEAVY] == (0.7, 0.8, 0.9)
    assert metrics.USUAL_IOUS[CYCLIST] == metrics.USUAL_IOUS[PEDESTRIAN] == (0.25, 0.5, 0.7)


def test_options_that_are_unusable_are_refused():
    frame = [Detections(CAR, np.ones(1))], [Objects(CAR)]
    for thresholds in ([0.0], [1.1], [np.nan]):
        with pytest.raises(ValueError, match=r"must lie in \(0, 1\]"):
            metrics.evaluate(*frame, iou_thresholds=thresholds)
    with pytest.raises(ValueError, match="label must be one of"):
        metrics.evaluate(*frame, iou_thresholds=[0.5], label="tram")
    with pytest.raises(ValueError, match="one entry for each of 1 truths"):
        metrics.evaluate(*frame, iou_thresholds=[0.5], counted=[[True, False]])
    with pytest.raises(ValueError, match="one ended after 0"):
        metrics.evaluate(*frame, iou_thresholds=[0.5], counted=[])
    for masks in ({"counted": [[True]] * 2}, {"outside": [[False]] * 2}):
        with pytest.raises(ValueError, match="counted and outside must have as many frames"):
            metrics.evaluate(*frame, iou_thresholds=[0.5], **masks)
    with pytest.raises((ValueError, TypeError)):
        metrics.evaluate(*frame, iou_thresholds=[0.5], protocol="exakt")
    for hits, truths in (([True], -1), ([True], 0), ([True, False], 3), ([True], 1.5)):
        with pytest.raises((ValueError, TypeError), match="truths"):
            metrics.precision_recall(np.array([0.9]), np.array(hits), truths)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([Detections(CAR, np.array([np.nan]))], [Objects(CAR)]), "row 0 of frame 0 is NaN"),
        (([Detections(CAR * 0, np.ones(1))], [Objects(CAR)]), "detections of frame 0 row 0"),
        (([Detections(CAR, np.ones(1))], [Objects(CAR * np.nan)]), "truths of frame 0 row 0"),
        (([Detections(CAR, np.ones(1))] * 2, [Objects(CAR)]), "one ended after 1"),
    ],
)
def test_unusable_input_is_refused_with_its_place(arguments, message):
    with pytest.raises(ValueError, match=message):
        metrics.evaluate(*arguments, iou_thresholds=[0.5])


def test_frames_come_one_at_a_time_and_heavy_overlaps_are_ignored():
    detections, truths = random_frames(1)
    streamed = metrics.evaluate(iter(detections), (t for t in truths), iou_thresholds=AT)
    assert [streamed[t].ap for t in AT] == [
        r.ap for r in metrics.evaluate(detections, truths, iou_thresholds=AT).values()
    ]
    car = np.array([[0.0, 0, 1, 4, 2, 1.5, 0]])
    found, there = [Detections(car, np.array([0.9]))], [Objects(car)]
    assert metrics.evaluate(found, there, iou_thresholds=[0.7, 0.5, 0.7]) == metrics.evaluate(
        found, there, iou_thresholds=[0.7, 0.5]
    )
    bus = Objects(BUS, np.array(["heavy"]))
    for forward, ignored in (
        (4.0, True),
        (5.9, True),
        (6.0, False),
        (7.0, False),
    ):  # its front is at 6 m
        match = match_one(scored([moved(CAR, 20 + forward)], [0.9]), bus, 0.5)
        assert match.ignored.tolist() == [ignored], forward
        result = metrics.evaluate(
            [scored([moved(CAR, 20 + forward)], [0.9])], [bus], iou_thresholds=[0.5]
        )[0.5]
        assert result.fp == (not ignored)
    giant = BUS * [1, 1, 1, 1.0, 3.0, 1, 1]  # a third of its footprint on the bus
    assert match_one(scored([giant], [0.9]), bus, 0.3, metric="bev").ignored.tolist() == [True]
    assert match_one(scored([giant], [0.9]), bus, 0.4, metric="bev").ignored.tolist() == [False]
    for label, alarms in (("cyclist", 1), ("vehicle", 0)):  # heavy vehicles excuse vehicles only
        assert (
            metrics.evaluate(
                [scored([BUS], [0.9], label)], [bus], iou_thresholds=[0.5], label=label
            )[0.5].fp
            == alarms
        )


def match_one(detections, truths, threshold, **rules):
    """Match one frame at one threshold."""
    return next(metrics.matches(detections, truths, [threshold], **rules))


def scored(boxes, scores, label="vehicle"):
    return Detections(np.concatenate(boxes), np.array(scores), np.array([label] * len(boxes)))


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_orders_of_equal_scores_and_truths_make_no_difference(order):
    pair = [moved(CAR, 0.1), moved(CAR, 0.5)]
    found = match_one(scored([pair[k] for k in order], [0.9, 0.9]), Objects(CAR), 0.5)
    assert found.truth[order.index(0)] == 0
    assert found.truth[order.index(1)] == -1
    there = Objects(np.concatenate([[moved(CAR, 0.2), moved(CAR, -0.6)][k] for k in order]))
    assert match_one(scored([CAR], [0.9]), there, 0.5).truth.tolist() == [order.index(0)]


def test_what_just_reaches_an_unscored_object_is_ignored():
    overlaps = metrics.Overlaps(
        rows=np.arange(3),
        columns=np.zeros(0, int),
        scores=np.array([0.9, 0.8, 0.7]),
        iou=np.zeros((3, 0)),
        elsewhere=np.array([[0.7, 0.0], [0.6999, 0.0], [0.0, metrics.MAX_UNSCORED_SHARE]]),
        outside=np.zeros(3, bool),
        protocol="exact",
    )
    taken, ignored = overlaps.resolve(0.7)
    assert taken.tolist() == [-1, -1, -1]
    assert ignored.tolist() == [True, False, False]
