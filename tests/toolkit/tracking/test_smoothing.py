"""Offline tracks: one size, one class and one direction, and no gaps."""

import numpy as np
import pytest

from toolkit.boxes import iou_3d
from toolkit.objects import HEAVY, VEHICLE, Detections
from toolkit.tracking.smoothing import smooth_tracks

DOUBTS = np.array([0.05, 0.05, 0.03, 0.03, 0.03])


def straight_drive(steps, speed=6.0):
    boxes = np.tile([0, 0, 0.75, 4.5, 1.9, 1.5, 0.0], (steps, 1))
    boxes[:, 0] = np.arange(steps) * 0.1 * speed
    return boxes


def detected(box, label=VEHICLE, score=0.8, doubts=DOUBTS):
    return Detections(box[None], np.array([score]), np.array([label]), doubts[None])


def times_of(frames):
    return 0.1 * np.arange(len(frames))


@pytest.fixture
def noisy_drive():
    rng = np.random.default_rng(3)
    truth = straight_drive(50)
    noisy = truth + rng.normal(0, [0.06, 0.04, 0.02, 0.1, 0.05, 0.03, 0.02], truth.shape)
    noisy[10, 6] += np.pi
    frames = [detected(box, HEAVY if k % 7 == 0 else VEHICLE) for k, box in enumerate(noisy)]
    return truth, noisy, frames


def test_boxes_are_nearer_to_the_truth_than_detections(noisy_drive):
    truth, noisy, frames = noisy_drive
    tracks = smooth_tracks(frames, times_of(frames))
    before = [iou_3d(noisy[[k]], truth[[k]])[0, 0] for k in range(50)]
    after = [iou_3d(tracks[k].boxes, truth[[k]])[0, 0] for k in range(50)]
    assert np.mean(after) > 0.93 > np.mean(before)
    assert min(after[2:-2]) > 0.9
    velocities = np.array([found.velocities[0] for found in tracks])
    assert velocities == pytest.approx(np.tile([6.0, 0, 0], (50, 1)), abs=1.0)


def test_size_class_and_direction_are_one(noisy_drive):
    _, _, frames = noisy_drive
    tracks = smooth_tracks(frames, times_of(frames))
    sizes = np.array([found.boxes[0, 3:6] for found in tracks])
    assert np.ptp(sizes, axis=0).max() < 1e-9
    assert {int(found.labels[0]) for found in tracks} == {VEHICLE}
    assert all(np.cos(found.boxes[0, 6]) > 0.99 for found in tracks)
    assert [found.ids.tolist() for found in tracks] == [[0]] * 50
    assert tracks[-1].ages[0] == pytest.approx(4.9)


def test_a_gap_is_filled_where_the_car_was(noisy_drive):
    truth, _, frames = noisy_drive
    frames[20:24] = [Detections.empty()] * 4
    tracks = smooth_tracks(frames, times_of(frames))
    assert all(len(found) == 1 for found in tracks)
    assert np.linalg.norm(tracks[22].boxes[0, :2] - truth[22, :2]) < 0.15
    assert tracks[22].scores[0] < tracks[19].scores[0]
    assert tracks[22].unseen[0] == pytest.approx(0.3)


def test_a_direction_follows_the_motion_if_the_detector_is_always_wrong():
    frames = [detected(box + np.array([0, 0, 0, 0, 0, 0, np.pi])) for box in straight_drive(30)]
    assert all(
        np.cos(found.boxes[0, 6]) > 0.99 for found in smooth_tracks(frames, times_of(frames))
    )


def test_who_moves_on_and_waits_for_long_faces_one_way():
    """Most detections face backwards; it covers twice its length, slowly on average."""
    arrival = straight_drive(20, speed=5.0)
    waiting = np.tile(arrival[-1], (400, 1))
    frames = [detected(box) for box in arrival]
    frames += [detected(box + np.array([0, 0, 0, 0, 0, 0, np.pi])) for box in waiting]
    yaws = np.array([found.boxes[0, 6] for found in smooth_tracks(frames, times_of(frames))])
    assert np.abs(yaws).max() < 0.1


def test_single_detections_stay_if_they_are_sure():
    box = straight_drive(1)[0]
    (found,) = smooth_tracks([detected(box, score=0.9)], [4.0], place_error=0.1)
    assert found.boxes == pytest.approx(box[None])
    assert found.scores.tolist() == [0.9]
    assert (found.doubts > np.hypot(DOUBTS, 0.1) - 1e-9).all()
    (nothing,) = smooth_tracks([detected(box, score=0.3)], [4.0])
    assert len(nothing) == 0
    assert smooth_tracks([], []) == []
    assert [len(found) for found in smooth_tracks([Detections.empty()] * 3, [0.0, 1.0, 2.0])] == [
        0,
        0,
        0,
    ]


def test_tracks_of_few_unsure_detections_are_left_out():
    boxes = straight_drive(8)
    few = [detected(box, score=0.5) for box in boxes[:3]] + [Detections.empty()] * 5
    assert sum(map(len, smooth_tracks(few, times_of(few)))) == 0
    more = [detected(box, score=0.5) for box in boxes]
    assert [len(found) for found in smooth_tracks(more, times_of(more))] == [1] * 8


def test_times_must_fit_the_frames():
    with pytest.raises(ValueError, match="each frame needs a time, got 2 and 1"):
        smooth_tracks([Detections.empty()] * 2, [0.0])
    with pytest.raises(ValueError, match="in the order of time"):
        smooth_tracks([Detections.empty()] * 2, [1.0, 0.0])


def test_a_corner_that_is_left_at_the_border_does_not_turn_the_body():
    """The last detection of a car that leaves is a small box across its course."""
    truth = straight_drive(20)
    frames = [detected(box) for box in truth]
    corner = truth[-1] + np.array([0.1, 0.5, 0, -1.2, 0, 0, np.radians(80.0)])
    frames[-1] = detected(corner)
    tracks = smooth_tracks(frames, times_of(frames))
    for k in range(15, 19):
        assert abs(tracks[k].boxes[0, 6]) < np.radians(3.0)
        assert iou_3d(tracks[k].boxes, truth[[k]])[0, 0] > 0.85


def test_bodies_that_turn_keep_their_headings():
    """At 2 Hz a car turns by half a radian from frame to frame."""
    angle = 0.5 * np.arange(12)
    truth = np.tile([0, 0, 0.75, 4.5, 1.9, 1.5, 0.0], (12, 1))
    truth[:, 0] = 8 * np.sin(angle)
    truth[:, 1] = 8 * (1 - np.cos(angle))
    truth[:, 6] = np.arctan2(np.sin(angle), np.cos(angle))
    frames = [detected(box) for box in truth]
    tracks = smooth_tracks(frames, 0.5 * np.arange(12))
    errors = [tracks[k].boxes[0, 6] - truth[k, 6] for k in range(12)]
    assert np.abs(np.arctan2(np.sin(errors), np.cos(errors))).max() < np.radians(15.0)


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_detections_across_a_body_do_not_turn_those_after_them(heading):
    """Two detections turn on by 60 degrees each, as if the body made a half turn."""
    truth = turn_boxes(straight_drive(40), heading)
    detections = truth.copy()
    detections[[18, 19], 6] += np.radians([60.0, 120.0])
    detections[::3, 6] += np.pi
    frames = [detected(box) for box in detections]
    tracks = smooth_tracks(frames, times_of(frames))
    turns = np.array([found.boxes[0, 6] for found in tracks]) - heading
    assert np.abs(np.arctan2(np.sin(turns), np.cos(turns))).max() < np.radians(3.0)


def turn_boxes(boxes, angle):
    """Boxes turned about the origin."""
    turned = boxes.copy()
    turned[:, 0] = boxes[:, 0] * np.cos(angle) - boxes[:, 1] * np.sin(angle)
    turned[:, 1] = boxes[:, 0] * np.sin(angle) + boxes[:, 1] * np.cos(angle)
    turned[:, 6] += angle
    return turned


def test_a_long_body_slips_in_a_bend():
    """The middle of a truck goes round by 15 m, its rear axle 6 m behind follows inside."""
    angle = np.linspace(0, 1.5, 60)
    slip = np.arcsin(6.0 / 15.0)
    truth = np.tile([0, 0, 1.75, 16.0, 2.5, 3.5, 0.0], (60, 1))
    truth[:, 0] = 15 * np.sin(angle)
    truth[:, 1] = 15 * (1 - np.cos(angle))
    truth[:, 6] = angle - slip
    frames = [detected(box, HEAVY) for box in truth]
    tracks = smooth_tracks(frames, times_of(frames))
    turns = [tracks[k].boxes[0, 6] - truth[k, 6] for k in range(60)]
    assert np.abs(turns).max() < np.radians(3.0)
