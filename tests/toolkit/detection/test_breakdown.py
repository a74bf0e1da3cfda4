from dataclasses import replace

import numpy as np
import pytest

from toolkit.detection import breakdown, metrics
from toolkit.frame import Frame, Rectangle, SensorCloud
from toolkit.objects import Detections, Objects


def curve(hits, truths):
    return metrics.precision_recall(
        np.linspace(0.9, 0.1, len(hits)), np.array(hits, bool), truths=truths
    )


def test_ap_of_kitti_at_forty_recalls():
    """Hit, miss, hit of 4: precision 1 up to recall 1/4, then 2/3 up to 1/2, nothing beyond."""
    assert breakdown.kitti_ap(curve([1, 0, 1], 4)) == pytest.approx((10 * 1 + 10 * 2 / 3) / 40)
    assert breakdown.kitti_ap(curve([1], 1)) == 1
    assert breakdown.kitti_ap(curve([0], 1)) == 0
    assert breakdown.kitti_ap(curve([], 3)) == 0
    assert np.isnan(breakdown.kitti_ap(curve([0], 0)))


def test_ap_of_nuscenes_begins_at_a_tenth():
    # Precision 1 to recall 1/2, nothing beyond: recalls 0.11 to 0.50 of 0.11 to 1.00.
    assert breakdown.nuscenes_ap(curve([1, 1], 4)) == pytest.approx(40 * 0.9 / 90 / 0.9)
    assert breakdown.nuscenes_ap(curve([1, 1], 2)) == pytest.approx(1)
    assert breakdown.nuscenes_ap(curve([], 2)) == 0
    assert np.isnan(breakdown.nuscenes_ap(curve([0], 0)))


def test_truths_outside_the_area_do_not_count():
    found = Detections(boxes((70.0,)), np.array([0.9]))
    each = breakdown.select_truth(frame(), np.array([58.0, -10.0, 78.0, 10.0])).judge(found)
    assert each.counted.tolist() == [False, False, False, False, True]
    assert each.truth_range[-1] == 2
    assert len(each.detections) == 1


def test_rows_are_formatted_by_class_and_protocol():
    three = [judged(frame(), (5.0, 25.0, 45.0), (0.9, 0.8, 0.7))]
    text = breakdown.format_rows(
        [*breakdown.group_rows(three, "vehicle"), *breakdown.group_rows(three, "cyclist")]
    )
    assert text.startswith("vehicle, ours\nobjects              to find  BEV 0.3")
    assert "all                        3     1.00" in text
    assert "cyclist, nuScenes" in text
    assert "-" in text.splitlines()[-1]


def found_at(places, scores=None, labels=None):
    boxes = np.array([[x, 0, 0, 4, 2, 1.5, 0] for x in places], np.float64).reshape(-1, 7)
    kinds = np.zeros(len(places), np.int64) if labels is None else labels
    return Objects(boxes, kinds) if scores is None else Detections(boxes, np.array(scores), kinds)


def match_centres(found, truths, counted, within, label=0):
    """Matches of one frame without an edge."""
    ranges = np.zeros(len(truths)), np.zeros(len(found))
    points = np.ones(len(truths), np.int64)
    outside = np.zeros(len(found), bool)
    one = breakdown.Judged(found, truths, np.array(counted, bool), points, *ranges, outside)
    return breakdown.by_centre([one], within, label)


def test_centres_are_matched_within_a_distance():
    found, truths = found_at([0.9, 0.2, 9.0], [0.9, 0.8, 0.7]), found_at([0.0, 20.0])
    matched = match_centres(found, truths, [True, True], 1.0)
    assert matched.hits.tolist() == [
        True,
        False,
        False,
    ]  # the surer one takes it, though the other is nearer
    assert matched.truths == 2
    assert match_centres(found, truths, [True, True], 0.5).hits.tolist() == [False, True, False]
    matched = match_centres(
        found_at([0.1, 20.1], [0.9, 0.8]), found_at([0.0, 20.0]), [True, False], 1.0
    )
    assert (matched.hits.tolist(), matched.truths) == ([True], 1)
    found, truths = (
        found_at([0.0, 0.0], [0.9, 0.8], np.array([0, 1])),
        found_at([0.0], labels=np.array([1])),
    )
    matched = match_centres(found, truths, [True], 1.0, 1)
    assert (matched.scores.tolist(), matched.hits.tolist(), matched.truths) == ([0.8], [True], 1)
    empty = match_centres(Detections.empty(), Objects.empty(), [], 1.0)
    assert (len(empty.scores), empty.truths) == (0, 0)
    alarm = match_centres(found_at([0.0], [0.5]), Objects.empty(), [], 1.0)
    assert alarm.hits.tolist() == [False]


def test_ap_is_broken_down_by_range():
    # Two of three cars found, surest first, then a false alarm at 12 m, then nothing.
    rows = breakdown.group_rows([judged(frame(), (5.0, 25.1, 12.0), (0.9, 0.8, 0.85))], "vehicle")
    assert row(rows, "ours", "BEV 0.5").truths == 3
    assert row(rows, "ours", "BEV 0.5").ap == pytest.approx(1 / 3 + 2 / 3 / 3)
    assert row(rows, "ours", "BEV 0.5", "0-20 m").ap == 1  # the surest is the hit
    assert row(rows, "ours", "BEV 0.5", "20-35 m").ap == 1
    assert row(rows, "ours", "BEV 0.5", "35-50 m").ap == 0
    assert np.isnan(row(rows, "ours", "BEV 0.5", "50 and more m").ap)


def test_ap_is_broken_down_by_points_and_protocol():
    rows = breakdown.group_rows([judged(frame(), (5.0, 25.1, 12.0), (0.9, 0.8, 0.85))], "vehicle")
    assert row(rows, "ours", "BEV 0.5", "1-4 points").ap == 1
    assert row(rows, "ours", "BEV 0.5", "5-19 points").ap == pytest.approx(
        1 / 2
    )  # the false alarm counts in all
    assert row(rows, "ours", "3D 0.5", "100 and more points").truths == 1
    assert row(rows, "KITTI R40", "BEV 0.7").ap == pytest.approx((13 + 13 * 2 / 3) / 40)
    assert row(rows, "nuScenes", "centre 0.5 m").truths == 3
    means = [row(rows, "nuScenes", f"centre {d:g} m").ap for d in (0.5, 1, 2, 4)]
    assert row(rows, "nuScenes", "centre, mean").ap == pytest.approx(np.mean(means))


# x of cars, and how many points lie in each: the last is out of the area, the fourth has none
AREA = np.array([-50.0, -50.0, 50.0, 50.0])
PLACES, POINTS = (5.0, 25.0, 45.0, 30.0, 70.0), (3, 10, 200, 0, 50)


def boxes(places):
    return np.array([[x, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0] for x in places]).reshape(-1, 7)


def frame(places=PLACES, complete=None):
    points = np.concatenate(
        [np.tile([x, 0, 0.75], (n, 1)) for x, n in zip(PLACES, POINTS, strict=True)]
    )
    cloud = SensorCloud("s", points.astype(np.float32), np.eye(4))
    more = {} if complete is None else {"complete": complete}
    return Frame.of_clouds("0", (cloud,), Objects(boxes(places)), **more)


def judged(seen, found_at, scores):
    return breakdown.select_truth(seen, AREA).judge(Detections(boxes(found_at), np.array(scores)))


def row(rows, protocol, measure, among="all"):
    (one,) = [r for r in rows if (r.protocol, r.measure, r.among) == (protocol, measure, among)]
    return one


def test_truths_without_points_or_outside_do_not_count():
    each = judged(frame(), PLACES, [0.9] * 5)
    assert each.counted.tolist() == [True, True, True, False, False]
    assert each.point_counts.tolist() == list(POINTS)
    assert len(each.detections) == 4  # that out of the area is left out


def test_overlapping_labels_count_once():
    # As in a real log: the same car, the second box some millimetres shorter; a cyclist in it is
    # somebody else.
    again = boxes((5.002, 25.0))
    again[0, 3] -= 0.003
    objects = Objects(np.concatenate([boxes((5.0, 25.0)), again]), np.array([0, 0, 0, 2]))
    assert breakdown.mark_repeated(objects).tolist() == [False, False, True, False]
    each = judged(replace(frame(), objects=objects), (5.0,), [0.9])
    assert each.counted.tolist() == [True, True, False, True]
    assert row(breakdown.group_rows([each], "vehicle"), "ours", "BEV 0.5").truths == 2
    near = boxes((5.0, 5.25))  # IoU 0.88: two labels that differ by more than an annotator's hand
    assert not breakdown.mark_repeated(Objects(near)).any()
    assert breakdown.mark_repeated(Objects(np.zeros((0, 7)))).shape == (0,)


def test_ranges_are_of_the_matched_truth():
    # Found 1.2 m short of a car at 20.5 m, which lies in the next ring.
    sample = Frame.of_clouds(
        "0", (SensorCloud("s", np.float32([[20.5, 0, 0.75]]), np.eye(4)),), Objects(boxes([20.5]))
    )
    rows = breakdown.group_rows([judged(sample, [19.3], [0.9])], "vehicle", [0.3])
    assert row(rows, "ours", "BEV 0.3", "20-35 m").ap == 1
    assert np.isnan(row(rows, "ours", "BEV 0.3", "0-20 m").ap)


def test_rows_count_where_labels_are_complete():
    seen = frame(complete=Rectangle((0.0, -5.0, 8.0, 5.0)))
    rows = breakdown.group_rows([judged(seen, (5.0, 12.0), (0.8, 0.9))], "vehicle")
    assert row(rows, "ours", "BEV 0.5").truths == 1
    assert (
        row(rows, "ours", "BEV 0.5").ap == 1
    )  # the false alarm at 12 m lies where nobody labelled
