"""Bad input through tracks, counts and conflicts: a sound answer or a clear error.

Two cars cross, one goes the other way and a cyclist follows; frames are lost, seldom, or a sensor
blinks."""

import numpy as np
import pytest

from toolkit.counting.arms import find_arms
from toolkit.counting.conflicts import find_conflicts
from toolkit.counting.counts import MovementKey, count_street
from toolkit.counting.fragments import join_fragments
from toolkit.counting.resampling import refine_trajectories
from toolkit.counting.trajectories import collect_trajectories
from toolkit.objects import CYCLIST, VEHICLE, Detections, Objects
from toolkit.sites.site import Site
from toolkit.tracking.smoothing import smooth_tracks
from toolkit.tracking.tracker import track_live

AREA = np.array([-40.0, -40, 40, 40])
SITE = Site("crossing", AREA)
ARMS = find_arms(SITE)
CAR = (4.4, 1.8, 1.5)
BICYCLE = (1.8, 0.6, 1.7)
# label, size, place at 0 s, velocity (m/s)
USERS = (
    (VEHICLE, CAR, (-46.0, -2.0), (8.0, 0.0)),
    (VEHICLE, CAR, (2.0, -58.0), (0.0, 8.0)),  # 1 s after the first one
    (VEHICLE, CAR, (90.0, 3.0), (-7.0, 0.0)),
    (CYCLIST, BICYCLE, (-60.0, -2.0), (5.0, 0.0)),
)
SECONDS = 24.0
MOVEMENTS = {
    ("vehicle", "west", "east"): 1,
    ("vehicle", "south", "north"): 1,
    ("vehicle", "east", "west"): 1,
    ("cyclist", "west", "east"): 1,
}
PET_S = 1.0 - (4.4 + 1.8) / 8  # from the first car's rear to the second one's front


def place(time):
    """Boxes and classes of those within the area at a time."""
    rows = []
    labels = []
    for label, size, start, velocity in USERS:
        x, y = np.array(start) + time * np.array(velocity)
        if max(abs(x), abs(y)) <= 40:
            rows.append([x, y, size[2] / 2, *size, np.arctan2(velocity[1], velocity[0])])
            labels.append(label)
    return np.array(rows).reshape(-1, 7), np.array(labels, np.int64)


def detect(times, seed=0, is_blind=lambda time: False):
    """Detections with errors of centimetres at some times."""
    rng = np.random.default_rng(seed)
    frames = []
    for time in times:
        boxes, labels = place(time)
        if is_blind(time):
            boxes, labels = boxes[:0], labels[:0]
        boxes[:, :2] += rng.normal(0, 0.05, (len(boxes), 2))
        frames.append(Detections(boxes, np.full(len(boxes), 0.9), labels))
    return frames


def observe(frames, times):
    """Road users as `coview count` knows them."""
    tracks = smooth_tracks(frames, times, AREA.tolist())
    return join_fragments(collect_trajectories(tracks, times))


def check(road_users, times):
    """Movements, speeds and the one conflict are the true ones."""
    counts = count_street(road_users, SITE, ARMS, times)
    assert {movement.key: movement.count for movement in counts.movements} == MOVEMENTS
    speeds = {movement.key: movement.speed_km_h for movement in counts.movements}
    assert speeds[MovementKey("vehicle", "west", "east")] == pytest.approx(28.8, abs=0.5)
    assert speeds[MovementKey("vehicle", "east", "west")] == pytest.approx(25.2, abs=0.5)
    assert speeds[MovementKey("cyclist", "west", "east")] == pytest.approx(18.0, abs=0.5)
    conflicts = find_conflicts(road_users, AREA, max_pet=1.5)
    assert [conflict.labels for conflict in conflicts] == [("vehicle", "vehicle")]
    assert conflicts[0].pet_s == pytest.approx(PET_S, abs=0.3)
    assert np.hypot(conflicts[0].x - 2, conflicts[0].y + 2) < 4


EVEN = np.round(np.arange(0, SECONDS, 0.1), 6)
LOSSES = np.random.default_rng(5).random(len(EVEN))


@pytest.mark.parametrize(
    ("times", "is_blind"),
    [
        pytest.param(EVEN, lambda time: False, id="10 Hz"),
        pytest.param(EVEN[::5], lambda time: False, id="2 Hz"),
        pytest.param(EVEN[LOSSES > 0.3], lambda time: False, id="a third of the frames lost"),
        pytest.param(EVEN[(EVEN < 4) | (EVEN > 5.2)], lambda time: False, id="a second lost"),
        pytest.param(EVEN, lambda time: time % 1 > 0.55, id="a sensor that blinks"),
        pytest.param(EVEN, lambda time: time % 3 > 2, id="a sensor that blinks slowly"),
    ],
)
def test_the_street_is_counted_as_it_is(times, is_blind):
    times = times.tolist()
    check(observe(detect(times, is_blind=is_blind), times), times)


def test_the_truth_of_few_frames_is_counted_as_it_is():
    for times in (EVEN[::5].tolist(), EVEN[LOSSES > 0.5].tolist()):
        truths = []
        for time in times:
            boxes, labels = place(time)
            truths.append(Objects(boxes, labels, list_ids(boxes)))
        check(collect_trajectories(truths, times), times)


def list_ids(boxes):
    """Number of each road user, by its heading and size."""
    return np.round(boxes[:, 6] * 10 + boxes[:, 3] * 100).astype(np.int64)


def test_times_that_go_back_are_refused():
    times = [0.0, 0.1, 0.3, 0.2, 0.4]
    frames = detect(times)
    for follow in (smooth_tracks, track_live):
        with pytest.raises(ValueError, match=r"order of time, got 0\.2 s after 0\.3"):
            follow(frames, times, AREA.tolist())
    with pytest.raises(ValueError, match=r"got 0\.2 s after 0\.3 s at frame 3"):
        collect_trajectories([Objects.empty()] * 5, times)
    with pytest.raises(ValueError, match=r"got 0\.1 s after 0\.1 s at frame 1"):
        collect_trajectories([Objects.empty()] * 2, [0.1, 0.1])


def test_new_rows_are_between_known_ones_and_even_steps_stay():
    times = EVEN[::5].tolist()
    truths = []
    for time in times:
        boxes, labels = place(time)
        truths.append(Objects(boxes, labels, list_ids(boxes)))
    coarse = collect_trajectories(truths, times)
    fine = refine_trajectories(coarse)
    for before, after in zip(coarse, fine, strict=True):
        assert np.diff(after.times).max() == pytest.approx(0.1)
        assert np.isin(before.times, after.times).all()
        start, velocity = after.boxes[0, :2], np.diff(after.boxes[:2, :2], axis=0) / 0.1
        expected = start + (after.times - after.times[0])[:, None] * velocity
        np.testing.assert_allclose(after.boxes[:, :2], expected, atol=1e-6)
    again = refine_trajectories(fine)
    assert all(before is after for before, after in zip(fine, again, strict=True))
    assert refine_trajectories([]) == []


def test_five_hundred_road_users_are_followed_and_counted():
    """They come in from the west, side by side in lanes of 4 m, and leave in the east."""
    lanes, rows = 100, 5
    area = np.array([-50.0, 0, 50, 4.0 * lanes])
    site = Site("wide", area)
    rng = np.random.default_rng(1)
    y = np.repeat(4.0 * np.arange(lanes) + 2, rows)
    first = np.tile(-60.0 - 15 * np.arange(rows), lanes)
    times = np.round(np.arange(0, 9, 0.1), 6).tolist()
    frames = []
    for time in times:
        boxes = np.zeros((lanes * rows, 7))
        boxes[:, 0] = first + 20 * time
        boxes[:, 1] = y
        boxes[:, 2:6] = (0.75, *CAR)
        boxes = boxes[np.abs(boxes[:, 0]) <= 50]
        boxes[:, :2] += rng.normal(0, 0.05, (len(boxes), 2))
        seen = np.flatnonzero(rng.random(len(boxes)) < 0.95)
        frames.append(Detections(boxes[seen], np.full(len(seen), 0.9)))
    assert max(map(len, frames)) > 450
    tracks = smooth_tracks(frames, times, area.tolist())
    road_users = join_fragments(collect_trajectories(tracks, times))
    counts = count_street(road_users, site, find_arms(site), times)
    assert counts.total("vehicle") == lanes * rows
    assert find_conflicts(road_users, area) == []
