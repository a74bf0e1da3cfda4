"""AP by group on a known street: every vehicle and false alarm is counted once, where it is."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.cases import Cases
from placement_env.classes import Classes
from placement_env.fidelity.detector import Detected
from placement_env.report.planning.breakdowns import (
    by_approach,
    by_class,
    by_errors,
    by_group,
    by_level,
    by_range,
    by_zone,
)
from placement_env.report.planning.judging import Judge
from placement_env.report.planning.moments import pick_moments, thin
from placement_env.report.planning.scored_boxes import fuse_clouds, score_boxes


@pytest.fixture
def scored(street):
    return score_boxes(street.judge, (0, 2))


def test_boxes_have_hits_points_and_frames(scored):
    assert scored.truths.shape == (32, 7)
    assert scored.boxes.shape == (32, 7)  # three cars and the ghost in each frame
    (truth,) = scored.hits
    hit = truth >= 0
    assert hit.sum() == 24
    assert np.array_equal(scored.boxes[hit], scored.truths[truth[hit]])
    assert scored.points.tolist() == [25, 25, 0, 25] * 8
    assert scored.frame.tolist() == np.repeat(np.arange(8), 4).tolist()


def test_groups_of_boxes_share_vehicles_and_false_alarms(scored):
    west, east = by_group(
        scored, ["west", "east"], lambda boxes: (boxes[:, 0] > -6).astype(np.int64), 0
    )
    assert (west.judged.vehicles, west.judged.ap, west.judged.precision) == (
        8,
        0.5,
        0.5,
    )  # with the ghost
    assert (east.judged.vehicles, east.judged.recall, east.judged.precision) == (24, 2 / 3, 1.0)
    assert west.mean_points == 25.0
    assert east.mean_points == pytest.approx(50 / 3)
    row, _ = by_group(scored, ["none", "all"], lambda boxes: np.ones(len(boxes), np.int64), 0)
    assert (row.judged, row.mean_points) == (None, None)


def test_zones_divide_the_area(street, scored):
    rows = by_zone(scored, street.site, 0)
    assert [row.name for row in rows] == [
        *("centre (within 10 m)", "north-east", "north-west", "south-east", "south-west")
    ]
    counts = {row.name: row.judged and row.judged.vehicles for row in rows}
    assert list(counts.values()) == [8, 24 - 8, 8, None, None]
    assert rows[2].judged.precision == 1.0


def test_ranges_go_from_the_nearest_sensor(street, scored):
    rows = by_range(scored, [street.candidates.sensors[0], street.candidates.sensors[2]], 0)
    assert [row.name for row in rows] == [
        "0 to 10 m",
        "10 to 20 m",
        "20 to 30 m",
        "30 to 40 m",
        "beyond 40 m",
    ]
    assert [row.judged and row.judged.vehicles for row in rows] == [None, 24, 8, None, None]
    assert rows[2].judged.recall == 1.0  # the car in the middle, 21 m from both


def test_a_bare_site_has_one_approach(street, scored):
    assert [(row.name, row.judged.vehicles) for row in by_approach(scored, street.site, 0)] == [
        ("inside the junction", 32)
    ]


def test_levels_are_thin_and_dense_traffic(street, scored):
    assert by_level(scored, street.judge, (0, 2)) == ()
    levels = (np.array([1, 3]), np.array([0, 2, 4, 5, 6, 7]))
    thin, dense = by_level(
        scored, Judge((street.detected,), Cases(levels=2), levels=levels), (0, 2)
    )
    assert (thin.name, thin.judged.vehicles, thin.judged.frames) == ("thin traffic", 8, 2)
    assert (dense.name, dense.judged.vehicles, dense.judged.frames) == ("dense traffic", 24, 6)
    assert thin.mean_points == dense.mean_points == 75 / 4
    (whole,) = street.judge.judge(np.array([[1, 0, 1, 0]], bool))
    assert [thin.judged.ap, dense.judged.ap] == pytest.approx([whole.ap] * 2)


def test_classes_are_seen_by_their_share(street):
    vehicle, walker, heavy = by_class(street.judge, (0, 2), ("vehicle", "pedestrian", "heavy"))
    assert (vehicle.label, vehicle.objects, vehicle.least_points, vehicle.share) == (
        "vehicle",
        32,
        20,
        0.75,
    )
    assert (walker.objects, walker.share) == (8, 0.0)
    assert (heavy.objects, heavy.share) == (0, None)


def test_clouds_of_a_set_are_fused(street):
    assert fuse_clouds(street.detected, (), 0).shape == (0, 3)
    assert fuse_clouds(street.detected, (0, 2), 0).shape == (100, 3)


def test_pictures_show_hits_misses_and_ignored_objects(street):
    shots = pick_moments(street.detected, (0, 2), count=3, points=10)
    assert len(shots) == 3
    shot = shots[0]
    assert shot.truth_hit.tolist() == [True, True, False, True, False]
    assert shot.truth_ignored.tolist() == [False, False, False, False, True]  # a walker
    places = shot.detections.boxes[:, :2].tolist()
    assert len(places) == 4
    assert (
        dict(zip(map(tuple, places), shot.detection_hit.tolist(), strict=True))[(-14.0, -14.0)]
        is False
    )
    assert shot.detection_hit.sum() == 3
    assert not shot.detection_ignored.any()
    assert [len(cloud) for cloud in shot.clouds] == [10, 10]
    assert len(pick_moments(street.detected, (0,), count=50)) == 8


def test_groups_of_classes_and_thresholds_are_combined(street):
    old = street.detected
    judge = Judge(
        (Detected(old.renders, old.detector, "early", classes=Classes(("vehicle", "pedestrian"))),)
    )
    scored = score_boxes(judge, (0, 2))
    assert scored.truth_label.tolist() == [0, 0, 0, 0, 2] * 8
    assert scored.label.tolist() == [0] * 32
    rows = by_group(scored, ["walker", "cars"], lambda boxes: (boxes[:, 3] > 1).astype(np.int64), 0)
    assert (rows[0].judged.ap, rows[0].judged.vehicles) == (0.0, 8)
    alone = by_group(
        score_boxes(street.judge, (0, 2)), ["cars"], lambda boxes: np.zeros(len(boxes), np.int64), 0
    )
    assert rows[1].judged.ap == alone[0].judged.ap
    (together,) = by_group(scored, ["all"], lambda boxes: np.zeros(len(boxes), np.int64), 0)
    assert together.judged.ap == alone[0].judged.ap / 2
    # Boxes of the reader are exact in footprint, so both thresholds hit alike; the second is
    # counted by itself.
    cases = Cases(iou=(0.7, 0.9))
    scored = score_boxes(Judge((street.detected.at(0.7, cases.ious),), cases), (0, 2))
    loose, strict = scored.hits
    assert np.array_equal(loose, strict)
    blind = replace(scored, hits=np.stack([loose, np.full_like(strict, -1)]))
    everything = [lambda boxes: np.zeros(len(boxes), np.int64)]
    (whole,) = by_group(replace(scored, hits=loose[None]), ["all"], everything[0], 0)
    (half,) = by_group(blind, ["all"], everything[0], 0)
    assert half.judged.ap == pytest.approx(whole.judged.ap / 2)


def test_error_profiles(street, scored):
    class Thin(type(street.detected.renders)):  # type: ignore[misc]
        def clouds(self, k, c):
            return super().clouds(k, c)[::2][: 0 if k < 4 and c == 2 else None]

    hazy = Thin(street.site, street.detected.renders.sensors)
    hazy.digest = "thin"
    rough = Detected(hazy, street.detected.detector, "early")
    exact, other = by_errors(
        Judge((street.detected, rough), Cases(errors=("paper", "poor"))), (0, 2)
    )
    assert (exact.name, other.name) == ("paper", "poor")
    assert exact.judged == street.judge.judge(np.array([[1, 0, 1, 0]], bool))[0]
    assert other.judged == Judge((rough,)).judge(np.array([[1, 0, 1, 0]], bool))[0]
    assert exact.mean_points == scored.points.mean() == 75 / 4
    assert 0 < (other.mean_points or 0) < 75 / 4
    assert by_errors(street.judge, (0, 2)) == ()


def test_the_busiest_frames_are_taken(street, spy):
    counts = [1, 0, 2, 4, 4, 1, 0, 3]
    vars(street.detected)["scored"] = lambda k: np.arange(5) < counts[k]
    calls = spy("placement_env.report.planning.moments", "build_scene_moment")
    pick_moments(street.detected, (0,), count=2)
    assert [call.args[2] for call in calls] == [3, 4]


def test_thin_clouds_are_the_same_again_and_in_order():
    cloud = np.arange(300, dtype=np.float32).reshape(100, 3)
    few = thin(cloud, 20, [0, 1])
    assert few.shape == (20, 3)
    assert np.array_equal(few, thin(cloud, 20, [0, 1]))
    assert (np.diff(few[:, 0]) > 0).all()
    assert thin(cloud, 100, [0]) is cloud
