"""Tracks of road users whose motion is known."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from toolkit.boxes import iou_3d
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Detections
from toolkit.tracking.smoothing import smooth_tracks
from toolkit.tracking.tracker import Tracker
from toolkit.tracking.tracks import Tracks

CAR = np.array([4.6, 1.9, 1.5])
SURE = np.full(5, 0.02)


def drive(steps, speed=8.0, yaw=0.3, start=(0.0, 0.0)):
    """Boxes of a car that drives straight on, 0.1 s apart."""
    way = np.arange(steps) * 0.1 * speed
    boxes = np.zeros((steps, 7))
    boxes[:, 0] = start[0] + way * np.cos(yaw)
    boxes[:, 1] = start[1] + way * np.sin(yaw)
    boxes[:, 2] = 0.75
    boxes[:, 3:6] = CAR
    boxes[:, 6] = yaw
    return boxes


def seen(*boxes, label=VEHICLE, score=0.9, doubts=SURE):
    rows = np.array(boxes).reshape(-1, 7)
    return Detections(
        rows, np.full(len(rows), score), np.full(len(rows), label), np.tile(doubts, (len(rows), 1))
    )


def follow(frames, tracker=None):
    tracker = tracker or Tracker()
    return [tracker.update(frame, 0.1 * k) for k, frame in enumerate(frames)]


def test_a_car_keeps_its_number_and_has_its_velocity():
    way = drive(30)
    noise = np.random.default_rng(0).normal(0, 0.02, (30, 2))
    noisy = way.copy()
    noisy[:, :2] += noise
    tracks = follow([seen(box) for box in noisy])
    assert all(np.array_equal(found.ids, [0]) for found in tracks)
    last = tracks[-1]
    assert last.velocities[0] == pytest.approx([8 * np.cos(0.3), 8 * np.sin(0.3), 0], abs=0.3)
    assert last.ages[0] == pytest.approx(2.9)
    assert last.unseen[0] == 0
    error = np.linalg.norm([found.boxes[0, :2] for found in tracks[10:]] - way[10:, :2], axis=1)
    assert error.mean() < np.linalg.norm(noise[10:], axis=1).mean()


def test_a_front_that_is_not_seen_follows_from_the_size():
    way = drive(40)
    detections = []
    for step, box in enumerate(way):
        doubts = SURE.copy()
        cut = box.copy()
        if step >= 15:  # the front third is hidden from here on
            cut[3] -= 1.2
            cut[:2] -= 0.6 * np.array([np.cos(0.3), np.sin(0.3)])
            doubts[0] = 0.6
        detections.append(seen(cut, doubts=doubts))
    tracks = follow(detections)
    for step in (20, 39):
        assert iou_3d(detections[step].boxes, way[[step]])[0, 0] < 0.8
        assert iou_3d(tracks[step].boxes, way[[step]])[0, 0] > 0.95
        assert tracks[step].doubts[0, 0] < 0.1


def test_a_wrong_size_at_the_border_is_forgotten():
    way = drive(33)
    cut = way.copy()
    cut[:3, 3] -= 1.6  # as sure as all others
    last = follow([seen(box) for box in cut])[-1]
    assert last.boxes[0, 3] == pytest.approx(CAR[0], abs=0.05)


def test_a_half_turn_in_a_detection_is_no_turn_of_the_car():
    way = drive(20)
    way[7, 6] += np.pi
    tracks = follow([seen(box) for box in way])
    assert [float(np.cos(found.boxes[0, 6] - 0.3)) for found in tracks] == pytest.approx([1.0] * 20)
    backwards = drive(20)
    backwards[:, 6] += np.pi  # the detector is wrong in every frame, and the motion is right
    turned = follow([seen(box) for box in backwards])[-1]
    assert np.cos(turned.boxes[0, 6] - 0.3) == pytest.approx(1.0)


def test_a_car_that_is_hidden_for_a_moment_returns_as_itself():
    way = drive(30)
    frames = [seen(box) if not 12 <= k < 16 else Detections.empty() for k, box in enumerate(way)]
    tracks = follow(frames)
    assert [found.ids.tolist() for found in tracks] == [[0]] * 30
    assert tracks[15].unseen[0] == pytest.approx(0.4)
    assert tracks[15].scores[0] < tracks[11].scores[0]
    assert np.linalg.norm(tracks[15].boxes[0, :2] - way[15, :2]) < 0.3


def test_a_standing_car_lives_on_behind_what_hides_it_and_a_flicker_does_not():
    standing = drive(1, speed=0.0)[0]
    frames = [seen(standing) for _ in range(10)] + [Detections.empty()] * 20
    tracks = follow(frames)
    assert len(tracks[-1]) == 1
    flicker = [seen(standing), *[Detections.empty()] * 5]
    assert [len(found) for found in follow(flicker)] == [1, 0, 0, 0, 0, 0]


def test_unsure_detections_are_reported_once_others_confirm_them():
    box = drive(1, speed=0.0)[0]
    faint = follow([seen(box, score=0.3) for _ in range(10)])
    assert [len(found) for found in faint] == [0] * 6 + [1] * 4
    assert faint[-1].ages[0] == pytest.approx(0.9)  # since the first detection
    scarcely = follow([seen(box, score=0.05) for _ in range(12)])
    assert [len(found) for found in scarcely] == [0] * 9 + [1] * 3
    places = [drive(1, start=(5.0 * k, 0.0))[0] for k in range(10)]
    flickers = [seen(place, score=0.7) for place in places]
    assert sum(map(len, follow(flickers))) == 0


def test_doubts_of_tracks_hold_what_no_mean_removes():
    frames = [seen(box) for box in drive(30)]
    plain = follow(frames)[-1].doubts
    assert (plain >= SURE * 0.6).all()  # thirty detections are not thirty independent ones
    off = follow(frames, Tracker(place_error=0.1))[-1].doubts
    assert off == pytest.approx(np.hypot(plain, 0.1))
    hidden = follow([*frames, *[Detections.empty()] * 3])[-1].doubts
    assert (hidden[:, :4] > 2 * plain[:, :4]).all()


def doubts_at(tracker, time):
    """Doubts of the faces of the only track."""
    tracks = tracker.at(time)
    assert tracks.doubts is not None
    assert len(tracks) == 1
    return tracks.doubts[0]


def test_doubts_of_a_hidden_car_hold_how_far_it_may_have_come():
    """By the variance of the place, in the mean of all directions, which a turn does not change."""
    unsure_ends = np.array([0.3, 0.3, 0.02, 0.02, 0.02])
    doubts = []
    variances = []
    for yaw in (0.0, np.pi / 2, 0.7):
        tracker = Tracker()
        follow([seen(box, doubts=unsure_ends) for box in drive(10, yaw=yaw)], tracker)
        seen_doubts = doubts_at(tracker, 0.9)
        hidden_doubts = doubts_at(tracker, 1.3)
        doubts.append(hidden_doubts)
        variances.append(np.square(hidden_doubts) - np.square(seen_doubts))
    assert doubts[1] == pytest.approx(doubts[0])
    assert doubts[2] == pytest.approx(doubts[0])
    assert variances[0] == pytest.approx([variances[0][0]] * 5)


def test_the_place_of_a_car_seen_once_is_as_unsure_as_its_speed():
    tracker = Tracker()
    tracker.update(seen(drive(1)[0]), 0.0)
    before = doubts_at(tracker, 0.0)
    after = doubts_at(tracker, 0.1)
    speed = 9.0  # m/s, standard deviation of a new car's speed along each axis
    acceleration = 3.0  # m/s²
    variance = SURE[0] ** 2 / 2 + (speed * 0.1) ** 2 + (acceleration * 0.1**2 / 2) ** 2
    assert after == pytest.approx(np.sqrt(before**2 + variance))


def test_a_track_ends_at_the_border():
    way = drive(30, yaw=0.0)
    frames = [seen(box) if box[0] <= 10 else Detections.empty() for box in way]
    tracks = follow(frames, Tracker((-10, -10, 10, 10)))
    assert len(tracks[12]) == 1
    assert all(len(found) == 0 for found in tracks[14:])


def test_classes_are_settled_by_votes_and_unlike_ones_stay_apart():
    box = drive(1, speed=0.0)[0]
    frames = [seen(box, label=VEHICLE if k % 3 else HEAVY) for k in range(9)]
    assert follow(frames)[-1].labels.tolist() == [VEHICLE]
    near = box + np.array([0.5, 0, 0, 0, 0, 0, 0])
    frames = [
        Detections.merge([seen(box), seen(near, label=PEDESTRIAN)]),
        Detections.merge([seen(near, label=PEDESTRIAN), seen(box)]),
    ]
    first, second = follow(frames)
    labels = dict(zip(first.ids.tolist(), first.labels.tolist(), strict=True))
    assert labels == dict(zip(second.ids.tolist(), second.labels.tolist(), strict=True))


@settings(deadline=None, max_examples=20)
@given(st.permutations(range(6)), st.floats(-3, 3))
def test_neither_order_nor_the_frame_of_reference_matter(order, turn):
    rng = np.random.default_rng(0)
    cars = [
        drive(8, speed, yaw, rng.uniform(-40, 40, 2)) for speed, yaw in rng.uniform(1, 6, (6, 2))
    ]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    plain = follow([seen(*(car[k] for car in cars)) for k in range(8)])[-1]
    turned_cars = []
    for car in (cars[number] for number in order):
        turned = car.copy()
        turned[:, :2] = car[:, :2] @ rotation.T
        turned[:, 6] += turn
        turned_cars.append(turned)
    turned_tracks = follow([seen(*(car[k] for car in turned_cars)) for k in range(8)])[-1]
    assert len(plain) == len(turned_tracks) == 6
    rows = np.argsort(order)
    np.testing.assert_allclose(
        turned_tracks.boxes[rows, :2], plain.boxes[:, :2] @ rotation.T, atol=1e-6
    )
    np.testing.assert_allclose(
        turned_tracks.velocities[rows, :2], plain.velocities[:, :2] @ rotation.T, atol=1e-6
    )


def test_tracks_are_asked_for_between_frames():
    tracker = Tracker()
    assert len(tracker.at(3.0)) == 0
    for k, box in enumerate(drive(20)):
        tracker.update(seen(box), 0.1 * k)
    later = tracker.at(2.4)
    assert later.boxes[0, :2] == pytest.approx(drive(25)[24, :2], abs=0.1)
    assert later.unseen[0] == pytest.approx(0.5)
    with pytest.raises(ValueError, match=r"known from 1\.9 s on"):
        tracker.at(1.0)


@pytest.mark.parametrize(
    ("time", "message"), [(0.0, "in the order of time"), (np.nan, "must be a number of seconds")]
)
def test_times_that_do_not_go_on_are_refused(time, message):
    tracker = Tracker()
    tracker.update(Detections.empty(), 0.0)
    with pytest.raises(ValueError, match=message):
        tracker.update(Detections.empty(), time)


def test_boxes_that_are_no_numbers_are_left_out_and_a_thousand_are_followed():
    box = drive(1)[0]
    broken = box.copy()
    broken[0] = np.inf
    assert len(Tracker().update(seen(broken, box), 0.0)) == 1
    crowd = np.tile(box, (1000, 1))
    crowd[:, 0] = np.arange(1000) % 40 * 8
    crowd[:, 1] = np.arange(1000) // 40 * 5
    tracks = follow([seen(*crowd) for _ in range(3)])
    assert np.array_equal(tracks[0].ids, tracks[2].ids)


def test_detections_without_doubts_are_followed_too():
    frames = [Detections(box[None], np.array([0.5]), np.array([CYCLIST])) for box in drive(6, 3.0)]
    last = follow(frames)[-1]
    assert last.ids.tolist() == [0]
    assert np.isfinite(last.doubts).all()


@pytest.mark.parametrize(
    ("name", "value"), [("velocities", np.zeros((1, 2))), ("ages", [1.0, 2.0]), ("ids", [[1]])]
)
def test_columns_of_tracks_must_fit(name, value):
    message = f"{name} must have shape|parameter '{name}'"  # the latter of shape checks
    with pytest.raises((ValueError, TypeError), match=message):
        Tracks(drive(1), np.ones(1), **{name: value})
    assert len(Tracks.empty()) == 0


def test_a_standing_track_does_not_reach_for_what_appears_far_away():
    """What stands is expected where it stood, however long it is hidden."""
    person = drive(1, speed=0.0)[0]
    person[3:6] = (0.6, 0.6, 1.7)
    stranger = person + np.array([6.0, 0, 0, 0, 0, 0, 0])
    frames = [seen(person, label=PEDESTRIAN)] * 8 + [Detections.empty()] * 30
    tracks = follow([*frames, *[seen(stranger, label=PEDESTRIAN)] * 8])
    assert tracks[37].boxes[0, :2] == pytest.approx(person[:2], abs=0.1)
    assert tracks[-1].ids.tolist() == [0, 1]
    back = follow([*frames, seen(person, label=PEDESTRIAN)])
    assert back[-1].ids.tolist() == [0]
    assert back[-1].unseen[0] == 0


def stand(steps, x, *, size=(0.6, 0.6, 1.7)):
    """Boxes of somebody who stands."""
    box = np.array([x, 0, size[2] / 2, *size, 0])
    return np.tile(box, (steps, 1))


def test_flickers_on_a_post_are_not_reported_and_who_waits_or_walks_is():
    post = stand(60, x=0.0)
    person = stand(60, x=5.0)
    walker = drive(60, speed=1.4, yaw=0.0, start=(10.0, 0.0))
    walker[:, 3:6] = person[0, 3:6]
    frames = []
    for k in range(60):
        boxes = [person[k]]
        if k % 2 == 0:
            boxes += [post[k], walker[k]]
        frames.append(seen(*boxes, label=PEDESTRIAN))
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(60))):
        x = np.sort(tracks[50].boxes[:, 0])
        assert x == pytest.approx([5.0, 17.0], abs=0.3)


def test_of_two_tracks_of_one_person_the_stronger_is_reported():
    person = drive(30, speed=1.4, yaw=0.0)
    person[:, 3:6] = (0.6, 0.6, 1.7)
    wide = person + np.array([0.2, 0, 0, 1.0, 0.2, 0, 0])
    frames = []
    for box, wide_box in zip(person, wide, strict=True):
        walker = seen(box, label=PEDESTRIAN, score=0.9)
        frames.append(Detections.merge([walker, seen(wide_box, label=CYCLIST, score=0.5)]))
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(30))):
        assert tracks[20].labels.tolist() == [PEDESTRIAN]
    apart = [frame[:1] for frame in frames]
    other = person + np.array([0, 0.7, 0, 0, 0, 0, 0])
    pairs = [
        Detections.merge([frame, seen(box, label=PEDESTRIAN)])
        for frame, box in zip(apart, other, strict=True)
    ]
    assert len(follow(pairs)[20]) == 2


def test_the_size_of_another_class_is_forgotten():
    car = drive(1, speed=0.0)[0]
    truck = car.copy()
    truck[2:6] = (1.5, 6.0, 2.3, 3.0)
    very_sure = np.full(5, 0.005)
    frames = [seen(truck, label=HEAVY, score=0.5, doubts=very_sure) for _ in range(6)]
    frames += [seen(car) for _ in range(10)]
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(16))):
        assert tracks[15].ids.tolist() == [0]
        assert tracks[15].labels.tolist() == [VEHICLE]
        assert iou_3d(tracks[15].boxes, car[None])[0, 0] > 0.95


@pytest.mark.parametrize(("speed", "label"), [(1.4, PEDESTRIAN), (4.0, CYCLIST)])
def test_who_is_too_fast_to_walk_is_no_pedestrian(speed, label):
    rider = drive(30, speed=speed, yaw=0.0)
    rider[:, 3:6] = (1.6, 0.6, 1.6)
    walker = rider.copy()
    walker[:, 3:6] = (0.6, 0.6, 1.6)
    frames = []
    for box, short_box in zip(rider, walker, strict=True):
        both = [seen(box, label=CYCLIST, score=0.5), seen(short_box, label=PEDESTRIAN, score=0.6)]
        frames.append(Detections.merge(both))
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(30))):
        assert tracks[20].labels.tolist() == [label]


@pytest.mark.parametrize(("speed", "label"), [(3.0, PEDESTRIAN), (5.0, CYCLIST)])
def test_a_pedestrian_who_is_faster_than_people_run_is_a_cyclist(speed, label):
    walker = drive(30, speed=speed, yaw=0.0)
    walker[:, 3:6] = (0.6, 0.6, 1.7)
    frames = [seen(box, label=PEDESTRIAN, doubts=np.full(5, 0.1)) for box in walker]
    tracks = follow(frames)
    assert tracks[4].labels.tolist() == [PEDESTRIAN]  # on a metre or two nobody can tell
    first = next(k for k, frame in enumerate(tracks) if frame.labels[0] == label)
    assert first == (0 if label == PEDESTRIAN else 7)  # after more than 3 m
    assert tracks[29].labels.tolist() == [label]
    assert tracks[29].ids.tolist() == tracks[4].ids.tolist()
    # a bicycle's length before a box of a cyclist was seen
    assert tracks[first].boxes[0, 3] == pytest.approx(0.6 if label == PEDESTRIAN else 1.75)
    offline = smooth_tracks(frames, 0.1 * np.arange(30))
    assert {frame.labels[0] for frame in offline} == {label}


def test_people_face_where_they_walk_however_they_are_detected():
    walker = drive(40, speed=1.2, yaw=0.4)
    walker[:, 3:6] = (0.6, 0.6, 1.7)
    walker[:, 6] += np.pi - 0.1
    frames = [seen(box, label=PEDESTRIAN, doubts=np.full(5, 0.1)) for box in walker]
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(40))):
        assert tracks[30].boxes[0, 6] == pytest.approx(0.4, abs=0.15)


def test_a_child_in_the_place_of_a_hidden_adult_keeps_its_track():
    adult = stand(1, x=0.0, size=(0.6, 0.6, 2.0))[0]
    child = stand(1, x=0.5, size=(0.4, 0.4, 1.2))[0]
    nearer = stand(1, x=0.2, size=(0.4, 0.4, 1.2))[0]
    both = [seen(adult, child, label=PEDESTRIAN)] * 10
    tracks = follow([*both, seen(nearer, label=PEDESTRIAN)])[-1]
    assert tracks.ids[tracks.unseen == 0].tolist() == [1]
    assert tracks.boxes[tracks.ids == 1, 5] == pytest.approx([1.2])


def test_the_length_of_a_truck_at_the_border_counts_once_it_is_inside():
    """A detector guesses what is outside the area, however sure it is."""
    way = drive(60, speed=4.0, yaw=0.0, start=(-48.0, 0.0))
    way[:, 3:6] = (10.0, 2.5, 3.5)
    way[:, 2] = 1.75
    way[:20, 0] = way[20, 0] - 0.4  # it waits first, with its middle outside
    frames = []
    for box in way:
        rear = max(box[0] - 5.0, -42.0)
        cut = box.copy()
        cut[3] = box[0] + 5.0 - rear
        cut[0] = rear + cut[3] / 2
        frames.append(seen(cut, label=HEAVY, doubts=np.array([0.09, 0.09, 0.03, 0.03, 0.03])))
    area = (-40.0, -20.0, 40.0, 20.0)
    tracks = smooth_tracks(frames, 0.1 * np.arange(60), area)
    assert tracks[10].boxes[0, 0] == pytest.approx(way[10, 0], abs=0.15)
    live = follow(frames, Tracker(area))
    assert live[-1].boxes[0, 3] == pytest.approx(10.0, abs=0.2)


def come_in(length, guessed_m):
    """Detections of a truck that comes in over the border, and the x of its front in each frame.

    guessed_m: from what is outside of it (m), how far out (m) a detector puts its rear."""
    way = drive(24, speed=5.0, yaw=0.0, start=(-40.0 - length / 2, 0.0))
    way[:, 2:6] = (1.75, length, 2.5, 3.5)
    fronts = way[:, 0] + length / 2
    frames = []
    for box, front in zip(way, fronts.tolist(), strict=True):
        guess = box.copy()
        guess[3] = front + 40.0 + guessed_m(max(length - 40.0 - front, 0.0))
        guess[0] = front - guess[3] / 2
        frames.append(seen(guess, label=HEAVY))
    return frames, fronts


BORDERS = (-40.0, -20.0, 40.0, 20.0)


def test_a_truck_that_comes_in_is_as_long_as_its_last_guess():
    frames, fronts = come_in(24.0, lambda outside: 4.0)
    lengths = [tracks.boxes[0, 3] for tracks in follow(frames, Tracker(BORDERS))]
    # as far again as the guess
    assert np.array(lengths) == pytest.approx(fronts + 40.0 + 4.0 + 4.0, abs=0.3)


def test_of_a_truck_more_is_outside_than_guessed():
    frames, fronts = come_in(16.0, lambda outside: outside / 2)
    for tracks in (
        follow(frames, Tracker(BORDERS)),
        smooth_tracks(frames, 0.1 * np.arange(24), BORDERS),
    ):
        lengths = np.array([found.boxes[0, 3] for found in tracks])
        assert lengths == pytest.approx(np.full(24, 16.0), abs=0.2)
        assert tracks[0].boxes[0, 0] == pytest.approx(fronts[0] - 8.0, abs=0.2)


def test_a_truck_is_not_as_low_as_a_first_part_of_it():
    box = drive(1, speed=0.0)[0]
    box[2:6] = (2.0, 10.0, 2.5, 4.0)
    low = box.copy()
    low[[2, 5]] = (1.5, 3.0)
    frames = [seen(low, label=HEAVY)] * 3 + [seen(box, label=HEAVY)] * 3
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(6))):
        assert tracks[-1].boxes[0, 5] > 3.7


@pytest.mark.parametrize(("top_doubt", "height"), [(0.02, 1.7), (0.08, 1.88)])
def test_a_van_whose_top_is_hidden_is_as_high_as_its_high_detections(top_doubt, height):
    van = drive(1, speed=0.0)[0]
    frames = []
    for k in range(40):
        box = van.copy()
        box[5] = 1.5 if k % 2 else 1.9
        box[2] = box[5] / 2
        frames.append(seen(box, doubts=np.array([0.02, 0.02, 0.02, 0.02, top_doubt])))
    for tracks in (follow(frames), smooth_tracks(frames, 0.1 * np.arange(40))):
        assert tracks[-1].boxes[0, 5] == pytest.approx(height, abs=0.05)


def test_flickers_that_nothing_confirms_do_not_wait_for_others():
    place = drive(1, speed=0.0)[0]
    faint = [seen(place, score=0.4)] * 3
    frames = [*faint, *[Detections.empty()] * 20, *faint]
    assert sum(map(len, follow(frames))) == 0


def test_a_truck_seen_in_parts_stays_one_track_that_is_not_too_sure():
    """Now the front is seen, now the rear, and each detection takes its length for sure."""
    truth = drive(60, speed=3.0, yaw=0.0)
    truth[:, 2:6] = (1.75, 16.0, 2.5, 3.5)
    rng = np.random.default_rng(4)
    parts = truth.copy()
    hidden = rng.uniform(0.0, 5.0, 60)
    is_front = np.arange(60) // 5 % 2 == 0
    parts[:, 3] -= hidden
    parts[:, 0] += np.where(is_front, hidden, -hidden) / 2
    tracks = follow([seen(box, label=HEAVY, doubts=np.full(5, 0.09)) for box in parts])
    assert {tuple(found.ids) for found in tracks} == {(0,)}
    last = tracks[-1]
    assert last.boxes[0, 3] > parts[:, 3].mean() + 0.5
    assert 0.5 < last.doubts[0, 0] < 3.0
    sure = follow([seen(box, label=HEAVY, doubts=np.full(5, 0.09)) for box in truth])[-1]
    assert sure.doubts[0, 0] < 0.3
