import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

from toolkit import boxes as bx

CAR = [0.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]


def a_box(reach=6.0):
    number = lambda low, high: st.floats(low, high, allow_nan=False, width=64)  # noqa: E731
    sizes = (number(0.05, 12.0),) * 3
    return st.tuples(*(number(-reach, reach),) * 2, number(-2, 2), *sizes, number(-10, 10)).map(
        list
    )


some_boxes = st.lists(a_box(), min_size=1, max_size=6).map(np.array)


def random_boxes(rng, n, area=(80.0, 40.0)):
    columns = [rng.uniform(-s / 2, s / 2, n) for s in area]
    sizes = [rng.uniform(low, high, n) for low, high in ((3.5, 5.6), (1.6, 2.1), (1.4, 2.0))]
    return np.column_stack(
        [*columns, rng.uniform(0.5, 1, n), *sizes, rng.uniform(-np.pi, np.pi, n)]
    )


def shapely_iou(a, b, metric):
    """The oracle: GEOS polygons, pair by pair."""
    p, q = shapely.polygons(bx.footprints(a))[:, None], shapely.polygons(bx.footprints(b))[None]
    overlap, size_a, size_b = (
        shapely.area(shapely.intersection(p, q)),
        shapely.area(p),
        shapely.area(q),
    )
    if metric == "3d":
        (low_a, top_a), (low_b, top_b) = (
            (c[:, 2] - c[:, 5] / 2, c[:, 2] + c[:, 5] / 2) for c in (a, b)
        )
        height = np.minimum(top_a[:, None], top_b[None]) - np.maximum(low_a[:, None], low_b[None])
        overlap, size_a, size_b = overlap * height.clip(0), size_a * a[:, 5:6], size_b * b[:, 5]
    return overlap / (size_a + size_b - overlap)


@pytest.mark.parametrize(
    ("other", "bev", "volume"),
    [
        *(
            (CAR, 1.0, 1.0),
            ([0, 0, 0.75, 4, 2, 1.5, np.pi], 1.0, 1.0),
            ([0, 0, 0.75, 2, 4, 1.5, np.pi / 2], 1.0, 1.0),
        ),
        *(([2, 0, 0.75, 4, 2, 1.5, 0], 1 / 3, 1 / 3), ([0, 0, 1.5, 4, 2, 1.5, 0], 1.0, 1 / 3)),
        *(([0, 0, 2.25, 4, 2, 1.5, 0], 1.0, 0.0), ([4, 0, 0.75, 4, 2, 1.5, 0], 0.0, 0.0)),
        *(
            ([4, 2, 0.75, 4, 2, 1.5, 0], 0.0, 0.0),
            ([0, 0, 0.75, 4, 2, 1.5, np.pi / 2], 4 / 12, 4 / 12),
        ),
        ([0, 0, 0.75, 1, 1, 1.5, 0.3], 1 / 8, 1 / 8),
        ([0, 0, 0.75, np.sqrt(2), np.sqrt(2), 1.5, np.pi / 4], 2 / 8, 2 / 8),
        ([90, 0, 0.75, 4, 2, 1.5, 0], 0.0, 0.0),
    ],
)
def test_iou_of_cases_worked_by_hand(other, bev, volume):
    assert bx.iou_bev([CAR], [other])[0, 0] == pytest.approx(bev, abs=1e-12)
    assert bx.iou_3d([CAR], [other])[0, 0] == pytest.approx(volume, abs=1e-12)


@given(some_boxes, some_boxes)
@settings(max_examples=200, deadline=None)
def test_iou_agrees_with_shapely(a, b):
    np.testing.assert_allclose(bx.iou_bev(a, b), shapely_iou(a, b, "bev"), atol=1e-9)
    np.testing.assert_allclose(bx.iou_3d(a, b), shapely_iou(a, b, "3d"), atol=1e-9)


@given(some_boxes, st.floats(-3, 3), st.floats(-1e-9, 1e-9))
@settings(deadline=None)
def test_iou_stays_exact_where_edges_almost_coincide(a, yaw, nudge):
    b = a + np.array([nudge, -nudge, 0, 0, 0, 0, nudge])
    assert np.diag(bx.iou_3d(a, b)) == pytest.approx(1.0, abs=1e-6)
    assert (bx.iou_3d(a, b) <= 1).all()


@given(some_boxes, some_boxes, st.floats(-4, 4), st.floats(-1e6, 1e6))
@settings(deadline=None)
def test_iou_is_symmetric_and_moves_with_the_world(a, b, yaw, offset):
    iou = bx.iou_3d(a, b)
    np.testing.assert_allclose(iou, bx.iou_3d(b, a).T, atol=1e-10)
    cos, sin = np.cos(yaw), np.sin(yaw)
    moved = [
        np.column_stack([c[:, :2] @ [[cos, sin], [-sin, cos]] + offset, c[:, 2:6], c[:, 6] + yaw])
        for c in (a, b)
    ]
    np.testing.assert_allclose(bx.iou_3d(*moved), iou, atol=1e-5)


def test_ious_of_nothing_of_parts_and_of_many(limits):
    for iou in (bx.iou_bev, bx.iou_3d, bx.footprint_overlap):
        assert iou([], [CAR]).shape == (0, 1)
        assert iou([CAR, CAR], np.zeros((0, 7))).shape == (2, 0)
    rng = np.random.default_rng(0)
    a, b = random_boxes(rng, 60, (10, 10)), random_boxes(rng, 50, (10, 10))
    whole = bx.iou_3d(a, b)
    limits(bx, BATCH_PAIRS=7)
    np.testing.assert_array_equal(bx.iou_3d(a, b), whole)
    assert bx.footprint_overlap([CAR], [[0, 0, 9, 40, 40, 1, 0.5]])[0, 0] == pytest.approx(1)
    assert bx.footprint_overlap([CAR], [[2, 0, 9, 4, 2, 1, 0]])[0, 0] == pytest.approx(0.5)


@given(some_boxes)
def test_corners_are_ordered_as_drawn(boxes):
    corners, footprint = bx.corners(boxes), bx.footprints(boxes)
    np.testing.assert_allclose(corners.mean(axis=1), boxes[:, :3], atol=1e-9)
    np.testing.assert_array_equal(corners[:, :4, :2], footprint)
    np.testing.assert_array_equal(corners[:, 4:, :2], footprint)
    front = footprint[:, 0] - footprint[:, 1]
    np.testing.assert_allclose(np.linalg.norm(front, axis=1), boxes[:, 3], rtol=1e-9)
    ahead = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=-1)
    np.testing.assert_allclose((front * ahead).sum(axis=1), boxes[:, 3], rtol=1e-9)
    assert shapely.is_ccw(shapely.linearrings(footprint)).all()
    assert (corners[:, 4:, 2] > corners[:, :4, 2]).all()


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ([0, 0, 0, 4, 0, 1, 0], "must be positive, but boxes row 1"),
        ([0, 0, 0, 4, 2, -1, 0], "must be positive, but boxes row 1"),
        ([0, np.nan, 0, 4, 2, 1, 0], "finite numbers, but boxes row 1"),
        ([0, 0, 0, np.inf, 2, 1, 0], "finite numbers, but boxes row 1"),
    ],
)
def test_degenerate_boxes_are_refused_with_their_row(row, message):
    with pytest.raises(ValueError, match=message):
        bx.check_boxes([CAR, row])
    for use in (
        bx.corners,
        bx.footprints,
        lambda b: bx.nms(b, [1.0, 2.0], 0.5),
        lambda b: bx.iou_3d(b, b),
    ):
        with pytest.raises(ValueError, match="row 1"):
            use([CAR, row])


def greedy_nms(boxes, scores, threshold, metric):
    """Non-maximum suppression as it is defined, one pair at a time."""
    iou, kept = shapely_iou(boxes, boxes, metric), []
    for row in sorted(range(len(boxes)), key=lambda r: -scores[r]):
        if all(iou[row, k] <= threshold for k in kept):
            kept.append(row)
    return kept


@given(st.lists(a_box(4.0), min_size=1, max_size=12).map(np.array), st.data())
@settings(deadline=None)
def test_nms_agrees_with_its_definition(boxes, data):
    scores = np.array([data.draw(st.integers(0, 4)) for _ in boxes], float)
    threshold = data.draw(st.sampled_from([0.0501, 0.1003, 0.3007, 0.7001]))
    assert bx.nms(boxes, scores, threshold).tolist() == greedy_nms(boxes, scores, threshold, "bev")


def test_the_best_of_overlapping_boxes_is_kept():
    chain = np.array([[x, 0, 0, 4, 2, 1, 0] for x in (0, 1, 2.5)], float)
    assert bx.nms(chain, [3, 2, 1], 0.3).tolist() == [0, 2]
    assert bx.nms(np.array([CAR, CAR]), [1, 1], 0.5).tolist() == [0]
    assert bx.nms(np.array([CAR, CAR]), [1, 1], 1.0).tolist() == [0, 1]
    assert bx.nms([], [], 0.5).shape == (0,)
    above = np.array([CAR, [0, 0, 9, 4, 2, 1.5, 0]])
    assert len(bx.nms(above, [1, 2], 0.1)) == 1


def test_a_row_of_boxes_is_suppressed_above_the_threshold_alone():
    # A row of ten, 1 m apart and 3 m long: neighbours overlap by one half, and no round settles
    # more than one
    # pair.
    row = np.array([[x, 0.0, 1.0, 3.0, 2.0, 1.5, 0.0] for x in range(10)])
    assert bx.iou_bev(row[:1], row[1:2]).item() == 0.5
    assert bx.nms(row, np.linspace(1, 0, 10), 0.5).tolist() == list(range(10))
    assert bx.nms(row, np.linspace(1, 0, 10), np.nextafter(0.5, 0)).tolist() == list(
        range(0, 10, 2)
    )


def test_points_that_are_no_numbers_and_empty_input_are_in_no_box():
    points = np.array(
        [[0, 0, 0.5], [np.nan, 0, 0.5], [0, np.inf, 0.5], [-np.inf, 0, 0], [0, 0, np.nan]]
    )
    assert bx.points_in_boxes(points, [CAR])[:, 0].tolist() == [True, False, False, False, False]
    assert bx.points_in_boxes(np.zeros((0, 3)), [CAR]).shape == (0, 1)
    assert bx.points_in_boxes(np.zeros((5, 3)), []).shape == (5, 0)
    assert bx.count_points(np.zeros((0, 3), np.float32), [CAR, CAR]).tolist() == [0, 0]
    assert bx.count_points(np.zeros((5, 3)), []).shape == (0,)
    assert bx.points_in_boxes([], [[0, 0, 0, 1, 1, 1, 0]]).shape == (0, 1)
    assert bx.count_points([], [[0, 0, 0, 1, 1, 1, 0]]).tolist() == [0]


def test_rows_in_boxes_are_those_of_the_mask():
    rng = np.random.default_rng(5)
    points = rng.uniform(-6, 6, (500, 3))
    points[::50] = np.nan, np.inf, -np.inf
    boxes = np.column_stack(
        [rng.uniform(-5, 5, (9, 3)), rng.uniform(0.5, 6, (9, 3)), rng.uniform(-4, 4, 9)]
    )
    inside = bx.points_in_boxes(points, boxes)
    assert inside.any()
    for box, rows in enumerate(bx.rows_in_boxes(points, boxes)):
        assert sorted(rows) == np.flatnonzero(inside[:, box]).tolist()
    assert bx.rows_in_boxes(points, []) == []


def test_boxes_and_labels_of_wrong_shapes_are_refused():
    with pytest.raises(ValueError, match=r"got \(3, 120\): pass points.T\?"):
        bx.count_points(np.zeros((3, 120)), [CAR])
    with pytest.raises(ValueError, match=r"truths must have shape \(n, 7\).* got \(3, 8\)"):
        bx.check_boxes(np.ones((3, 8)), "truths")
    assert bx.nms([CAR, CAR, CAR], [1, 2, 3], 0.5, labels=["a", "b", "a"]).tolist() == [2, 1]
    with pytest.raises(
        ValueError, match=r"labels must have one entry for each of the 2 boxes, got shape \(1,\)"
    ):
        bx.nms([CAR, CAR], [1, 2], 0.5, labels=[0])


@pytest.mark.parametrize(
    ("scores", "threshold", "message"),
    [
        *(([1.0, np.nan], 0.5, "row 1 is NaN"), ([1.0], 0.5, "one entry for each of the 2 boxes")),
        ([1.0, 2.0], 1.5, "0..1, got 1.5"),
    ],
)
def test_nms_refuses(scores, threshold, message):
    with pytest.raises(ValueError, match=message):
        bx.nms(np.array([CAR, CAR]), scores, threshold)


@given(some_boxes, st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_points_in_boxes_agrees_with_the_definition(boxes, seed):
    points = np.random.default_rng(seed).uniform(-9, 9, (300, 3)).astype(np.float32)
    for column, (x, y, z, length, width, height, yaw) in enumerate(boxes):
        dx, dy, dz = points.astype(float).T - np.array([[x], [y], [z]])
        u, v = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
        expected = (abs(u) <= length / 2) & (abs(v) <= width / 2) & (abs(dz) <= height / 2)
        np.testing.assert_array_equal(bx.points_in_boxes(points, boxes)[:, column], expected)
    np.testing.assert_array_equal(
        bx.count_points(points, boxes), bx.points_in_boxes(points, boxes).sum(axis=0)
    )


@given(some_boxes, st.sampled_from([0.0, 5e5, 5e6]))
@settings(deadline=None)
def test_a_box_holds_its_corners_wherever_it_is(boxes, offset):
    boxes = boxes + np.array([offset, offset, 0, 0, 0, 0, 0])
    corners = bx.corners(boxes)
    for row in range(len(boxes)):
        assert bx.points_in_boxes(corners[row], boxes)[:, row].all()
        outside = boxes[row, :3] + (corners[row] - boxes[row, :3]) * (1 + 1e-4)
        assert not bx.points_in_boxes(outside, boxes[row : row + 1]).any()


@given(st.lists(a_box(4.0), min_size=1, max_size=12).map(np.array), st.data())
@settings(deadline=None)
def test_nms_by_label_is_that_of_each_label_alone(boxes, data):
    scores = np.array([data.draw(st.integers(0, 4)) for _ in boxes], float)
    labels = np.array([data.draw(st.integers(0, 2)) for _ in boxes])
    kept = bx.nms(boxes, scores, 0.1003, labels=labels)
    assert (np.diff(scores[kept]) <= 0).all()
    alone = [
        rows[greedy_nms(boxes[rows], scores[rows], 0.1003, "bev")]
        for rows in (np.flatnonzero(labels == label) for label in range(3))
    ]
    assert sorted(kept.tolist()) == sorted(np.concatenate(alone).tolist())
