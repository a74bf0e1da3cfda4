from dataclasses import replace

import numpy as np
import pytest

from toolkit.calibration.place import Place
from toolkit.detection.detect import detect_frames
from toolkit.frame import Frame, Rectangle, SensorCloud
from toolkit.objects import HEAVY, VEHICLE, Detections, Objects
from toolkit.plots.palette import sensor_colour
from toolkit.viewing.colouring import UNKNOWN_SHADE, Scales, colour_points, list_colourings
from toolkit.viewing.drawing import Drawing
from toolkit.viewing.drawn import DrawnCloud, DrawnSample, find_newest, limit_points
from toolkit.viewing.outcomes import MARKED, sort_outcomes

BOXES = np.array([[x, 0.0, 1.0, 4.0, 2.0, 2.0, 0.0] for x in (0.0, 10.0, 20.0, 30.0, 80.0)])


def detected(boxes, labels=None, complete=None, objects=None):
    """A sample of five objects, the third of them without points, in which these boxes are
    found."""
    points = np.array([[box[0], 0, 1] for k, box in enumerate(BOXES) if k != 2] * 3, np.float32)
    objects = Objects(BOXES, np.array([0, 0, 0, 2, 0])) if objects is None else objects
    area = {} if complete is None else {"complete": complete}
    sample = Frame.of_clouds("0", (SensorCloud("s", points, np.eye(4)),), objects, **area)
    labels = np.zeros(len(boxes), np.int64) if labels is None else labels
    found = Detections(boxes, np.linspace(0.9, 0.5, len(boxes)), labels)
    (each,) = detect_frames(
        [sample], lambda points: found, Place("none", area=(-50.0, -50.0, 50.0, 50.0))
    )
    return each


def by_x(outcomes):
    return {
        name: {kind: rows.boxes[:, 0].tolist() for kind, rows in by.items()}
        for name, by in outcomes.items()
    }


def test_hits_misses_and_false_alarms_of_each_class_by_iou_or_neither():
    found = BOXES[[0, 0, 3, 1]] + np.array(
        [[0.2, 0, 0, 0, 0, 0, 0], [0.9, 0, 0, 0, 0, 0, 0]] + [[0.0] * 7] * 2
    )
    outcomes = sort_outcomes(detected(found, np.array([0, 0, 2, 2])))
    assert by_x(outcomes) == {
        "hits": {"vehicle": [0.2], "pedestrian": [30.0]},
        "missed": {"vehicle": [10.0]},
        "false alarms": {"vehicle": [0.9], "pedestrian": [10.0]},
        "ignored": {},
    }
    assert outcomes["hits"]["vehicle"].scores.tolist() == [0.9]
    lifted = BOXES[[0, 3]] + np.array([0, 0, 0.9, 0, 0, 0, 0])  # IoU 1.1 / 2.9 = 0.38
    outcomes = sort_outcomes(detected(lifted, np.array([0, 2])))
    assert by_x(outcomes)["hits"] == {"pedestrian": [30.0]}
    assert by_x(outcomes)["false alarms"] == {"vehicle": [0.0]}
    # A label without points, one beyond the area, and what lies where labels are not complete.
    outcomes = sort_outcomes(detected(BOXES[[2, 4]]))
    missed = {"vehicle": [0.0, 10.0], "pedestrian": [30.0]}
    assert by_x(outcomes) == {
        "hits": {},
        "missed": missed,
        "false alarms": {},
        "ignored": {"vehicle": [20.0, 80.0]},
    }
    near = sort_outcomes(detected(BOXES[[1]] + 5.0, complete=Rectangle((-5.0, -5.0, 5.0, 5.0))))
    missed = {"vehicle": [0.0]}
    assert by_x(near) == {
        "hits": {},
        "missed": missed,
        "false alarms": {},
        "ignored": {"vehicle": [15.0]},
    }
    assert sort_outcomes(detected(BOXES, objects=Objects.empty())) == {}
    assert list(MARKED) == ["hits", "missed", "false alarms", "ignored"]


def test_the_second_label_of_a_truck_is_a_false_alarm():
    trucks = Objects(BOXES[:2], np.array([HEAVY, HEAVY]))
    outcomes = sort_outcomes(
        detected(BOXES[[0, 0, 1]], np.array([HEAVY, VEHICLE, VEHICLE]), objects=trucks)
    )
    assert by_x(outcomes) == {
        "hits": {"heavy": [0.0]},
        "missed": {"heavy": [10.0]},
        "false alarms": {"vehicle": [0.0]},
        "ignored": {"vehicle": [10.0]},
    }


@pytest.mark.parametrize("seed", range(8))
def test_every_detection_has_one_outcome_and_no_label_two(seed):
    rng = np.random.default_rng(seed)
    boxes = BOXES[rng.integers(0, 5, 12)] + rng.normal(0, [2, 1, 0.2, 0, 0, 0, 0.1], (12, 7))
    each = detected(boxes, rng.integers(0, 4, 12), Rectangle((-5.0, -5.0, 40.0, 5.0)))
    by_outcome = {name: sum(map(len, by.values())) for name, by in sort_outcomes(each).items()}
    assert by_outcome["hits"] + by_outcome["false alarms"] + by_outcome["ignored"] == len(boxes)
    assert (
        by_outcome["hits"] + by_outcome["missed"] == 3
    )  # of five labels one has no point, one is too far away


def test_tags_say_class_score_and_outcome_above_the_box(touched, finds_the_car):
    (drawn,) = Drawing(finds_the_car).draw_all([touched])
    assert [tag.text for tag in drawn.tags] == ["vehicle 0.90", "pedestrian missed"]
    x, y, z = drawn.tags[0].place
    assert (x, y) == tuple(drawn.detections["vehicle"][0, :2])
    assert z == drawn.detections["vehicle"][0, 2] + drawn.detections["vehicle"][0, 5] / 2
    (drawn,) = Drawing(finds_the_car).draw_all([replace(touched, objects=Objects.empty())])
    assert [(tag.text, tag.outcome) for tag in drawn.tags] == [("vehicle 0.90", "detection")]


def moved(sample, shift):
    motion = np.eye(4)
    motion[:3, 3] = shift
    clouds = tuple(
        replace(cloud, world_SE3_sensor=motion @ cloud.world_SE3_sensor) for cloud in sample.clouds
    )
    boxes, others = sample.objects.boxes.copy(), sample.others.boxes.copy()
    boxes[:, :3] += shift
    others[:, :3] += shift
    objects = Objects(boxes, sample.objects.labels)
    return replace(
        sample.with_clouds(clouds), objects=objects, others=replace(sample.others, boxes=others)
    )


def test_points_and_boxes_are_drawn(samples, finds_the_car):
    first, second = Drawing(finds_the_car).draw_all(samples)
    np.testing.assert_allclose(first.clouds[0].points, samples[0].clouds[0].in_world(), atol=1e-5)
    np.testing.assert_allclose(second.clouds[1].place, [20, 10, 5])
    np.testing.assert_array_equal(first.truth["pedestrian"], samples[0].objects.boxes[1:])
    np.testing.assert_array_equal(first.truth["others"], samples[0].others.boxes)
    assert list(first.truth) == ["vehicle", "pedestrian", "others"]
    np.testing.assert_allclose(first.detections["vehicle"][0, :6], samples[0].objects.boxes[0, :6])
    assert first.detections["vehicle"][0, 6] == pytest.approx(0.2)
    assert first.describe() == (
        "first: 400 points, 3 labelled (0 hit, 0 missed, 3 not counted), 1 detected (0 hits, 0 "
        "false alarms, 1 ignored)"
    )
    assert second.describe() == (
        "second: 500 points, 2 labelled (0 hit, 0 missed, 2 not counted), 1 detected (0 hits, 1 "
        "false alarm, 0 ignored)"
    )


def test_classes_sensors_and_scores_are_selected(samples, finds_the_car):
    assert Drawing().draw_all(samples)[0].describe() == "first: 400 points, 3 labelled, 0 detected"
    (_, second) = Drawing(finds_the_car, classes=["pedestrian"], sensors=["south"]).draw_all(
        samples[1:] * 2
    )
    assert ([cloud.name for cloud in second.clouds], second.truth, second.detections) == (
        ["south"],
        {},
        {},
    )
    (first,) = Drawing(finds_the_car, classes=["pedestrian"]).draw_all(samples[:1])
    assert (list(first.truth), first.detections) == (["pedestrian"], {})
    assert Drawing(finds_the_car, least_score=0.95).draw_all(samples)[0].detections == {}
    assert len(Drawing(finds_the_car, least_score=0.9).draw_all(samples)[0].detections) == 1
    with pytest.raises(ValueError, match="no sensor 'west'"):
        Drawing(sensors=["west"]).draw_all(samples)


def test_drawings_count_from_the_middle_of_the_area(samples, finds_the_car):
    # The detector is shown points counted from the middle, and its boxes are brought back.
    drawing = Drawing(finds_the_car, Place("none", area=(-40.0, -52.0, 60.0, 48.0)))
    assert drawing.find_origin(samples[0]).tolist() == [10, -2, 0]
    (drawn,) = drawing.draw_all(samples[:1])
    np.testing.assert_allclose(drawn.detections["vehicle"][0, :3], [12, 3, 0.75])
    np.testing.assert_allclose(drawn.truth["vehicle"][0, :3], [2, 5, 0.75])


def test_labels_detections_and_outcomes_stand_on_level_ground(touched, finds_the_car):
    (drawn,) = Drawing(finds_the_car).draw_all([touched])
    np.testing.assert_array_equal(drawn.outcomes["hits"]["vehicle"], drawn.detections["vehicle"])
    np.testing.assert_array_equal(drawn.outcomes["missed"]["pedestrian"], drawn.truth["pedestrian"])
    assert drawn.outcomes["false alarms"] == {}
    assert drawn.describe() == (
        "first: 408 points, 3 labelled (1 hit, 1 missed, 1 not counted), 1 detected (1 hit, 0 "
        "false alarms, 0 ignored)"
    )
    (far,) = Drawing(finds_the_car, Place("none", area=(95.0, -5.0, 105.0, 5.0))).draw_all(
        [touched]
    )
    assert {name: list(by) for name, by in far.outcomes.items()} == {
        "hits": [],
        "missed": [],
        "false alarms": [],
        "ignored": ["vehicle"],
    }
    (drawn,) = Drawing(finds_the_car, Place("plane")).draw_all([moved(touched, [3.0, 0.0, -7.3])])
    assert drawn.outcomes["hits"]["vehicle"][0, 2] == pytest.approx(0.75, abs=0.05)


def test_samples_are_coloured_and_counted_from_an_origin_near_by(samples):
    far = moved(samples[0], [600_000.0, 5_500_000.0, 130.0])
    drawing = Drawing()
    assert drawing.find_origin(far).tolist() == [600_000, 5_500_000, 130]
    (here,), (there,) = drawing.draw_all(samples[:1]), drawing.draw_all([far])
    np.testing.assert_allclose(there.clouds[0].points, here.clouds[0].points, atol=1e-4)
    np.testing.assert_allclose(there.truth["others"], here.truth["others"], atol=1e-6)
    np.testing.assert_allclose(there.clouds[0].place, here.clouds[0].place, atol=1e-6)
    (cloud,) = Drawing().draw_all(samples[:1])[0].clouds
    few = limit_points(cloud, 4)
    assert few.intensity.tolist() == [0, 100, 200, 300]
    np.testing.assert_array_equal(few.points, cloud.points[::100])
    np.testing.assert_array_equal(few.time, np.asarray(cloud.time)[::100])
    assert limit_points(cloud, 400) is cloud
    first, second = Drawing().draw_all(samples)
    assert list_colourings([first]) == ("sensor", "height", "intensity", "age")
    bare = replace(second, clouds=second.clouds[1:])
    assert list_colourings([bare]) == ("sensor", "height")
    assert list_colourings([bare, first])[2:] == ("intensity", "age")
    seen = []
    Drawing().draw_all(samples, progress=seen.append)
    assert seen == [1, 2]


def test_ground_far_below_is_put_on_zero_or_warned_of(samples, finds_the_car):
    low = moved(samples[0], [3.0, 0.0, -7.3])
    drawing = Drawing(finds_the_car, Place("plane"))
    assert drawing.find_origin(low).tolist() == [3, 0, 0]
    (drawn,) = drawing.draw_all([low])
    assert np.abs(drawn.clouds[0].points[:, 2]).max() < 0.1
    assert drawn.clouds[0].place[2] == pytest.approx(5.0, abs=0.05)
    np.testing.assert_allclose(drawn.truth["vehicle"], samples[0].objects.boxes[:1], atol=0.05)
    assert drawn.warning is None
    (found,) = drawn.detections["vehicle"]
    np.testing.assert_allclose(found[:3], [12, 3, 0.75], atol=0.05)
    (drawn,) = Drawing().draw_all([moved(samples[0], [0.0, 0.0, -7.3])])
    assert "level the points first" in str(drawn.warning)


def test_empty_samples_are_drawn():
    empty = Frame.of_clouds("nothing", (), Objects.empty())
    for levelling in ("none", "map"):
        (drawn,) = Drawing(place=Place(levelling)).draw_all([empty])
        assert (drawn.clouds, drawn.truth, drawn.detections) == ((), {}, {})


def test_points_are_coloured_by_each_colouring():
    assert {
        bytes(row).hex()
        for row in colour_points(CLOUD, "sensor", SCALES, sensor_index=2, newest_time=0.1)
    } == {sensor_colour(2)[1:]}
    height = brightness(CLOUD, "height")
    assert height[0] < height[1] < height[2] == height[3]  # beyond the scale
    assert (np.diff(brightness(CLOUD, "intensity")) < 0).all()
    assert np.argsort(brightness(CLOUD, "age")).tolist() == [1, 2, 3, 0]
    assert colour_points(CLOUD, "height", SCALES, sensor_index=0, newest_time=0.0)[0].tolist() == [
        68,
        1,
        84,
    ]


def test_scales_span_most_points():
    sample = DrawnSample("s", 0.0, (CLOUD, BARE), {}, {})
    assert find_newest(sample) == 0.1
    scales = Scales.from_sample(sample)
    assert scales.height == pytest.approx(tuple(np.percentile([0, 1, 2, 9] * 2, (2, 98))))
    assert scales.intensity == pytest.approx((1.06, 3.94))
    assert scales.age == pytest.approx(tuple(np.percentile([0.1, 0, 0.05, 0.08], (2, 98))))
    assert Scales.from_sample(DrawnSample("none", 0.0, (), {}, {})) == Scales()
    assert find_newest(DrawnSample("bare", 0.0, (BARE,), {}, {})) == 0.0


def test_scales_describe_their_range():
    flat = Scales(height=(1.0, 1.0))
    assert colour_points(CLOUD, "height", flat, sensor_index=0, newest_time=0.0).shape == (4, 3)
    said = [SCALES.describe(colouring) for colouring in ("sensor", "height", "intensity", "age")]
    assert said == ["sensor", "height, 0 to 2 m", "intensity, 1 to 4", "age, 0 to 0.1 s"]


POINTS = np.array([[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 9]], np.float32)
CLOUD = DrawnCloud(
    "a", POINTS, np.zeros(3), np.array([0.0, 0.1, 0.05, 0.02]), np.array([4, 3, 2, 1], np.float32)
)
BARE = DrawnCloud("b", POINTS, np.zeros(3))
SCALES = Scales(height=(0.0, 2.0), intensity=(1.0, 4.0), age=(0.0, 0.1))


def brightness(cloud, colouring):
    return (
        colour_points(cloud, colouring, SCALES, sensor_index=2, newest_time=0.1)
        .astype(int)
        .sum(axis=1)
    )


@pytest.mark.parametrize("colouring", ["intensity", "age"])
def test_points_without_what_is_asked_are_grey(colouring):
    assert (
        colour_points(BARE, colouring, SCALES, sensor_index=0, newest_time=0.0).tolist()
        == [list(UNKNOWN_SHADE)] * 4
    )
