import numpy as np
import pytest

from toolkit.detection.metrics import precision_recall
from toolkit.detection.samples.protocols import by_centre, kitti_ap, mean_of, nuscenes_ap
from toolkit.objects import Detections, Objects


def curve(hits, truths):
    return precision_recall(np.linspace(0.9, 0.1, len(hits)), np.array(hits, bool), truths=truths)


def test_kitti_takes_forty_recalls():
    """Hit, miss, hit of 4: precision 1 up to recall 1/4, then 2/3 up to 1/2, nothing beyond."""
    assert kitti_ap(curve([1, 0, 1], 4)) == pytest.approx((10 * 1 + 10 * 2 / 3) / 40)
    assert kitti_ap(curve([1], 1)) == 1
    assert kitti_ap(curve([0], 1)) == 0
    assert kitti_ap(curve([], 3)) == 0
    assert np.isnan(kitti_ap(curve([0], 0)))


def test_nuscenes_leaves_the_lowest_tenth_out():
    """Precision 1 to recall 1/2, nothing beyond: recalls 0.11 to 0.50 of 0.11 to 1.00."""
    assert nuscenes_ap(curve([1, 1], 4)) == pytest.approx(40 * 0.9 / 90 / 0.9)
    assert nuscenes_ap(curve([1, 1], 2)) == pytest.approx(1)
    assert nuscenes_ap(curve([], 2)) == 0
    assert np.isnan(nuscenes_ap(curve([0], 0)))


def frame(places, scores=None, labels=None):
    boxes = np.array([[x, 0, 0, 4, 2, 1.5, 0] for x in places], np.float64).reshape(-1, 7)
    kinds = np.zeros(len(places), np.int64) if labels is None else labels
    return Objects(boxes, kinds) if scores is None else Detections(boxes, np.array(scores), kinds)


def test_centres_are_matched_best_first():
    found, truths = frame([0.9, 0.2, 9.0], [0.9, 0.8, 0.7]), frame([0.0, 20.0])
    matched = by_centre([found], [truths], [np.array([True, True])], 1.0, 0)
    assert matched.hits.tolist() == [True, False, False]  # the surer one takes it, though the other is nearer
    assert matched.truths == 2
    assert by_centre([found], [truths], [np.array([True, True])], 0.5, 0).hits.tolist() == [False, True, False]


def test_what_is_not_counted_is_neither_hit_nor_false():
    matched = by_centre([frame([0.1, 20.1], [0.9, 0.8])], [frame([0.0, 20.0])], [np.array([True, False])], 1.0, 0)
    assert (matched.hits.tolist(), matched.truths) == ([True], 1)


def test_other_classes_do_not_take_part():
    found, truths = frame([0.0, 0.0], [0.9, 0.8], np.array([0, 1])), frame([0.0], labels=np.array([1]))
    matched = by_centre([found], [truths], [np.array([True])], 1.0, 1)
    assert (matched.scores.tolist(), matched.hits.tolist(), matched.truths) == ([0.8], [True], 1)


def test_frames_without_anything():
    empty = by_centre([Detections.empty()], [Objects.empty()], [np.zeros(0, bool)], 1.0, 0)
    assert (len(empty.scores), empty.truths) == (0, 0)
    alarm = by_centre([frame([0.0], [0.5])], [Objects.empty()], [np.zeros(0, bool)], 1.0, 0)
    assert alarm.hits.tolist() == [False]
    assert np.isnan(mean_of([]))
    assert mean_of([1.0, 2.0]) == 1.5
