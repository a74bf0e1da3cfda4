"""AP of classes against the plan's, and what halves of the sensors say without labels."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.acceptance.acceptance import track_boxes
from placement_env.acceptance.class_checks import compare_classes, find_blocks
from placement_env.acceptance.consistency import check_consistency, find_ends
from placement_env.acceptance.street_detections import FrameBoxes
from placement_env.report.content import Judgement
from placement_env.report.planning.plan_folder import StatedClass
from toolkit.detection.metrics import evaluate
from toolkit.objects import Detections, Objects
from toolkit.sites.site import Site

SITE = Site("yard", np.array([-40.0, -40.0, 40.0, 40.0]))


def car(x, y=0.0):
    return [x, y, 0.8, 4.5, 1.8, 1.6, 0.0]


def street(found_share, frames=240, step=4.0, seed=0):
    """Frames with some seconds between them, in which one car passes and one waits; a share of both
    is found."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(frames):
        x = -45.0 + 90.0 * (number % 20) / 20
        truth = np.array([car(x), car(5.0, 20.0)])
        is_found = rng.random(2) < found_share
        boxes = truth[is_found] + rng.normal(0, 0.1, (is_found.sum(), 7)) * [1, 1, 0, 0, 0, 0, 0]
        detections = Detections(boxes, rng.uniform(0.6, 1, len(boxes)))
        objects = Objects(truth, ids=np.array([number // 20, 1000]))
        rows.append(FrameBoxes(step * number, detections, (), objects))
    return rows


def promise(ap, low, high, iou=0.5):
    return StatedClass("vehicle", 1.0, iou, Judgement(ap, low, high, ap, 1.0, 500, 120))


def test_ap_is_that_of_evaluate_and_compared_by_intervals():
    frames = street(0.8, frames=120)
    (check,) = compare_classes(frames, [promise(0.99, 0.97, 1.0)], SITE, None)
    counted = [np.abs(frame.objects.boxes[:, 0]) <= 40 for frame in frames]
    score = evaluate(
        [frame.detections for frame in frames],
        [frame.objects for frame in frames],
        iou_thresholds=[0.5],
        counted=counted,
    )[0.5]
    assert check.measured.ap == pytest.approx(score.ap)
    assert check.measured.recall == pytest.approx(score.recall)
    assert check.measured.low < score.ap < check.measured.high
    assert check.falls_short
    shown = replace(promise(0.99, 0.97, 1.0), weight=0.0)
    assert not compare_classes(frames, [shown], SITE, None)[0].falls_short
    (sound,) = compare_classes(frames, [promise(0.8, 0.75, 0.85)], SITE, None)
    assert (sound.is_compared, sound.falls_short, sound.hota) == (True, False, None)


def test_several_thresholds_count_by_their_mean_and_short_recordings_are_not_compared():
    frames = street(0.8, frames=80)
    both, low, high = (
        compare_classes(frames, [promise(0.9, 0.8, 1.0, iou)], SITE, None)[0].measured.ap
        for iou in ((0.3, 0.8), 0.3, 0.8)
    )
    assert both == pytest.approx((low + high) / 2)
    (check,) = compare_classes(frames, [promise(0.99, 0.98, 1.0)], SITE, None)
    assert np.isnan(check.measured.low)
    assert not check.is_compared
    assert not check.falls_short
    (other,) = compare_classes(
        frames, [StatedClass("cyclist", 1.0, 0.5, promise(1, 1, 1).judged)], SITE, None
    )
    assert (other.measured, other.hota) == (None, None)


def test_what_is_found_in_every_frame_has_the_best_hota():
    frames = street(1.0, frames=60, step=0.5)
    tracks = track_boxes(frames, SITE)
    (check,) = compare_classes(frames, [promise(0.99, 0.97, 1.0)], SITE, tracks)
    assert check.hota is not None
    assert 0.6 < check.hota <= 1
    half = street(0.5, frames=60, step=0.5)
    (worse,) = compare_classes(half, [promise(0.99, 0.97, 1.0)], SITE, track_boxes(half, SITE))
    assert worse.hota is not None
    assert worse.hota < check.hota


def test_blocks_are_forty_seconds_or_eight_frames():
    assert find_blocks([0.0, 5.0, 35.0, 40.0, 79.9, 80.0]).tolist() == [0, 0, 0, 1, 1, 2]
    times = 100 + 0.1 * np.arange(1201)
    assert np.bincount(find_blocks(times)).tolist() == [400, 400, 400, 1]
    assert find_blocks([0.0] * 20).tolist() == [0] * 8 + [1] * 8 + [2] * 4
    assert find_blocks([0.0]).tolist() == [0]


def test_halves_estimate_what_both_find():
    rng = np.random.default_rng(1)
    places = np.array([car(-30 + 6 * k, 15 * (k % 3)) for k in range(10)])
    frames = []
    for number in range(600):
        halves = []
        for share in (0.9, 0.6):
            boxes = places[rng.random(10) < share]
            halves.append(Detections(boxes, np.full(len(boxes), 0.9)))
        frames.append(FrameBoxes(float(number), halves[0], tuple(halves), Objects.empty()))
    blocks = find_blocks([frame.time for frame in frames])
    found = check_consistency(frames, blocks, SITE, None)
    assert (found.first_share, found.second_share) == pytest.approx((0.9, 0.6), abs=0.02)
    assert found.recall == pytest.approx(1 - 0.1 * 0.4, abs=0.01)
    assert found.recall_low <= found.recall <= found.recall_high
    assert found.recall_high - found.recall_low < 0.02
    assert (found.tracks, np.isnan(found.vanished_share)) == (0, True)
    nothing = FrameBoxes(0.0, Detections.empty(), (), Objects.empty())
    assert check_consistency([nothing], np.zeros(1, int), SITE, None).detections == 0


def test_tracks_that_vanish_inside_are_told_from_those_that_leave():
    frames = []
    for number in range(200):
        boxes = [car(-38 + 0.8 * number % 80, 3.0)] if number < 95 else []  # leaves in the east
        if number < 60:
            boxes.append(car(0.0, -10.0))  # vanishes in the middle
        boxes.append(car(0.0, 10.0))  # stays to the end
        detections = Detections(np.array(boxes), np.full(len(boxes), 0.9))
        frames.append(FrameBoxes(0.1 * number, detections, (), Objects.empty()))
    tracks = track_boxes(frames, SITE)
    assert find_ends(frames, tracks, SITE).tolist() == [False, True]
    assert track_boxes(frames[:1], SITE) is None
    apart = [
        FrameBoxes(5.0 * k, frame.detections, (), frame.objects) for k, frame in enumerate(frames)
    ]
    assert track_boxes(apart, SITE) is None
