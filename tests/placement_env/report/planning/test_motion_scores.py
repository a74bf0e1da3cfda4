"""Road users that drive through an area, and detections of them that are known."""

import numpy as np
import pytest

from placement_env.report.planning.motion_scores import (
    MovingStreet,
    count_groups,
    follow_classes,
    mask_moving,
)
from toolkit.objects import Detections, Objects
from toolkit.points import has_centre_inside
from toolkit.sites.site import Site
from toolkit.tracking.scores import score_tracks
from toolkit.tracking.tracker import track_live

SITE = Site("street", np.array([-40.0, -30.0, 40.0, 30.0]))
SPEED_M_S = 10.0
GAP_S = 4.0  # between two cars
CARS = 12
PARKED = 99
MISSED = 5  # this car is never detected
LATE = 7  # this one 3 s after it came in
TIMES = np.round(np.arange(0, 62, 0.1), 6)


def drive(time):
    """Cars that come in at x = -40 one after the other and leave at x = 40; one is parked."""
    boxes = [[0.0, 15, 0.75, 4.5, 1.9, 1.5, 0]]
    ids = [PARKED]
    for number in range(CARS):
        x = SPEED_M_S * (time - GAP_S * number) - 50
        if -50 <= x <= 50:
            boxes.append([x, 0, 0.75, 4.5, 1.9, 1.5, 0])
            ids.append(number)
    return Objects(np.array(boxes), ids=np.array(ids))


def detect(objects, time):
    """All cars in the area but one, another one late; the parked one too."""
    is_found = has_centre_inside(objects.boxes, SITE.area) & (objects.ids != MISSED)
    came_in = GAP_S * LATE + 1
    if time < came_in + 3:
        is_found &= objects.ids != LATE
    return Detections(objects.boxes[is_found], np.full(int(is_found.sum()), 0.9))


@pytest.fixture(scope="module")
def street():
    truths = [drive(time) for time in TIMES.tolist()]
    pairs = zip(truths, TIMES.tolist(), strict=True)
    return MovingStreet(SITE, TIMES.tolist(), [detect(*pair) for pair in pairs], truths)


@pytest.fixture(scope="module")
def followed(street):
    (row,) = follow_classes(street, ("vehicle", "pedestrian"))
    return row


def test_ways_are_followed_as_they_were_detected(followed):
    row = followed
    assert (row.label, row.road_users, row.entering) == ("vehicle", CARS, CARS)
    # 8 s in the area: the late one is matched in 5 of them
    assert row.mostly_tracked.value == pytest.approx(10 / 12)
    assert row.mostly_tracked.low == pytest.approx(0.552, abs=5e-4)  # Wilson's, by his formula
    assert row.mostly_tracked.high == pytest.approx(0.953, abs=5e-4)
    assert row.never_detected.value == pytest.approx(1 / 12)
    assert row.first_detection_s.value <= 0.15
    assert row.first_detection_95_s.value == np.inf  # of twelve one is never detected
    assert row.first_detection_s.high < 0.3
    assert row.speed_error_km_h.value < 2
    assert row.speed_error_km_h.low <= row.speed_error_km_h.value <= row.speed_error_km_h.high


def test_shares_are_those_of_the_scores_of_tracks(street, followed):
    moving = [objects[objects.ids != PARKED] for objects in street.truths]
    truths = [objects[has_centre_inside(objects.boxes, SITE.area)] for objects in moving]
    tracks = track_live(street.detections, street.times, SITE.area.tolist())
    tracks = [rows[rows.boxes[:, 1] < 10] for rows in tracks]
    scores = score_tracks(tracks, truths)
    assert followed.mostly_tracked.value == scores.mostly_tracked
    assert followed.road_users == scores.objects


def test_trips_are_counted_next_to_the_true_ones(street):
    counted = count_groups(street, ("vehicle",))
    (vehicles,) = counted.groups
    assert (vehicles.group, vehicles.true_count) == ("vehicles", CARS)
    # the missed car, and the one that is first seen far inside
    assert (vehicles.count, vehicles.error) == (10, -2)
    assert vehicles.found.value == pytest.approx(10 / 12)
    assert vehicles.right.value == 1
    assert abs(vehicles.speed_error_km_h.value) < 0.5
    (movement,) = counted.movements
    assert (movement.entry, movement.exit, movement.count, movement.true_count) == (
        *("west", "east"),
        *(10, 12),
    )


def test_who_stays_does_not_count():
    truths = [drive(time) for time in (10.5, 10.55, 10.7)]
    masks = mask_moving(truths)
    for mask, objects in zip(masks, truths, strict=True):
        assert mask.tolist() == (objects.ids != PARKED).tolist()
    assert [mask.any() for mask in mask_moving(truths[:2])] == [False, False]
    still = MovingStreet(SITE, [0.0, 0.1], [Detections.empty()] * 2, truths[:1] * 2)
    assert follow_classes(still, ("vehicle",)) == ()


def test_a_street_without_detections_has_figures():
    truths = [drive(time) for time in TIMES[:200].tolist()]
    blind = MovingStreet(SITE, TIMES[:200].tolist(), [Detections.empty()] * 200, truths)
    (row,) = follow_classes(blind, ("vehicle",))
    assert row.mostly_tracked.value == 0
    assert row.never_detected.value == 1
    assert row.first_detection_s.value == np.inf
    assert np.isnan(row.speed_error_km_h.value)
    (vehicles,) = count_groups(blind, ("vehicle",)).groups
    assert (vehicles.count, vehicles.found.value) == (0, 0)
    assert np.isnan([vehicles.right.value, vehicles.speed_error_km_h.value]).all()
