from dataclasses import replace

import numpy as np
import pytest

from placement_env.analysis.intervals import ap_interval
from placement_env.fidelity.detector import IGNORED, IOUS
from placement_env.report.paper.scoring import (
    believed,
    in_view_of_all,
    kbit_per_sensor,
    ms_per_frame,
    pr_curve,
    published_ap,
    score_run,
    visible_share,
)
from placement_env.report.paper.stored import SchemeRun, StoredDetections
from toolkit.detection.metrics import average_precision, precision_recall

ALL = SchemeRun("early", (0, 1, 2, 3, 4, 5))


def by_hand(stored, run, iou, region):
    """Object by object: score, and whether it is a hit, of all that counts; and how many there are to find."""
    scores, hits, to_find = [], [], 0
    sensors = [stored.sensors[c] for c in region]
    for truth, found in zip(stored.truths, stored.runs[run], strict=True):
        there = [bool(in_view_of_all(sensors, box[None])[0]) for box in truth.boxes]
        to_find += sum(there)
        for box, score, what in zip(found.boxes, found.scores, found.truth[IOUS.index(iou)], strict=True):
            counts = there[what] if what >= 0 else what != IGNORED and in_view_of_all(sensors, box[None])[0]
            if counts:
                scores.append(score)
                hits.append(what >= 0)
    return np.array(scores), np.array(hits, bool), to_find


@pytest.mark.parametrize("region", [(), (1, 5), (2,)])
@pytest.mark.parametrize("iou", IOUS)
def test_score_is_that_of_each_object_by_hand(stored, region, iou):
    scores, hits, to_find = by_hand(stored, ALL, iou, region)
    ours = score_run(stored, ALL, iou, region)
    assert ours.vehicles == to_find
    assert ours.ap == pytest.approx(average_precision(precision_recall(scores, hits, to_find)))
    assert ours.recall == pytest.approx(hits.sum() / to_find)
    what = believed(stored, ALL, iou, region)
    assert ours.interval == ap_interval(what.scores, what.hits, what.to_find)
    assert ours.interval.low <= ours.ap <= ours.interval.high


def test_pinned(stored):
    ours, one = score_run(stored, ALL), score_run(stored, SchemeRun("early", (4,)))
    assert (ours.ap, ours.recall, ours.hit_iou) == pytest.approx((0.942694, 1.0, 0.875427), abs=1e-6)
    assert (one.ap, one.recall, *one.interval) == pytest.approx((0.324744, 0.446809, 0.199134, 0.472934), abs=1e-6)
    assert published_ap(stored, ALL) == pytest.approx(0.949172, abs=1e-6)
    assert score_run(stored, ALL, 0.9).ap == pytest.approx(0.187133, abs=1e-6)


def test_region_is_the_shared_field_of_view(stored):
    near, side, behind = np.zeros((3, 7))
    position, forward = stored.sensors[1].position, stored.sensors[1].world_SE3_body[:2, 0]
    near[:2] = position[:2] + 15 * forward
    behind[:2] = position[:2] - 15 * forward
    side[:2] = position[:2] + 15 * np.array([-forward[1], forward[0]])
    boxes = np.stack([near, side, behind])
    assert in_view_of_all([stored.sensors[1]], boxes).tolist() == [True, False, False]
    assert in_view_of_all([], boxes).tolist() == [True] * 3
    assert not in_view_of_all([stored.sensors[1], stored.sensors[0]], boxes)[2]


def test_ignored_detections_change_nothing(stored):
    def without(found):
        keep = found.truth[0] != IGNORED
        return found._replace(
            boxes=found.boxes[keep],
            scores=found.scores[keep],
            truth=found.truth[:, keep],
            published=found.published[:, keep],
        )

    fewer = replace(stored, runs={ALL: tuple(map(without, stored.runs[ALL]))})
    assert score_run(fewer, ALL) == score_run(stored, ALL)


def test_frames_without_vehicles_count_their_false_alarms_but_not_as_published(stored):
    empty = next(k for k, count in enumerate(stored.to_find) if not count)
    found = stored.runs[ALL][empty]
    alarm = found._replace(
        boxes=np.zeros((1, 7)), scores=np.ones(1), truth=np.full((3, 1), -1), published=np.full((3, 1), -1)
    )
    runs = (*stored.runs[ALL][:empty], alarm, *stored.runs[ALL][empty + 1 :])
    worse = replace(stored, runs={ALL: runs})
    assert score_run(worse, ALL).ap < score_run(stored, ALL).ap
    assert published_ap(worse, ALL) == published_ap(stored, ALL)


def test_costs(stored):
    frames = stored.runs[ALL]
    assert kbit_per_sensor(stored, ALL) == pytest.approx(np.mean([f.bits for f in frames]) / 1000)
    assert ms_per_frame(stored, ALL) == pytest.approx(np.median([f.ms for f in frames]))


def test_visible_share(stored):
    points = np.concatenate([truth.points for truth in stored.truths])
    assert visible_share(stored, (4,)) == pytest.approx((points[:, 4] > 0).mean())
    assert visible_share(stored, (3, 4)) == pytest.approx((points[:, [3, 4]] > 0).any(axis=1).mean())
    there = in_view_of_all([stored.sensors[4]], np.concatenate([truth.boxes for truth in stored.truths]))
    assert visible_share(stored, (4,), (4,)) == pytest.approx((points[there, 4] > 0).mean())


def test_curve_ends_at_the_recall(stored):
    curve = pr_curve(stored, ALL)
    assert curve.recall[-1] == pytest.approx(score_run(stored, ALL).recall)


def test_without_vehicles_figures_are_undefined(stored):
    empty = next(k for k, count in enumerate(stored.to_find) if not count)
    runs = {ALL: (stored.runs[ALL][empty],)}
    nothing = StoredDetections(stored.site, stored.sensors, (stored.truths[empty],), runs, "", "")
    ours = score_run(nothing, ALL)
    assert np.isnan([ours.ap, ours.recall, *ours.interval, ours.hit_iou, published_ap(nothing, ALL)]).all()
    assert np.isnan(visible_share(nothing, (0,)))
