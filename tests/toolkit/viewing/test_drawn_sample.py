from dataclasses import replace

import numpy as np
import pytest

from toolkit.datasets.sample import Sample
from toolkit.objects import Objects
from toolkit.viewing.drawn_sample import Drawing, colourings_of, thinned


def moved(sample, shift):
    """The sample elsewhere on the map."""
    motion = np.eye(4)
    motion[:3, 3] = shift
    clouds = tuple(replace(cloud, world_SE3_sensor=motion @ cloud.world_SE3_sensor) for cloud in sample.clouds)
    boxes, others = sample.objects.boxes.copy(), sample.others.boxes.copy()
    boxes[:, :3] += shift
    others[:, :3] += shift
    objects = Objects(boxes, sample.objects.labels)
    return replace(sample, clouds=clouds, objects=objects, others=replace(sample.others, boxes=others))


def test_points_boxes_and_places_are_where_they_were(samples, finds_the_car):
    first, second = Drawing(finds_the_car).all_of(samples)
    np.testing.assert_allclose(first.clouds[0].points, samples[0].clouds[0].in_world(), atol=1e-5)
    np.testing.assert_allclose(second.clouds[1].place, [20, 10, 5])
    np.testing.assert_array_equal(first.truth["pedestrian"], samples[0].objects.boxes[1:])
    np.testing.assert_array_equal(first.truth["others"], samples[0].others.boxes)
    assert list(first.truth) == ["vehicle", "pedestrian", "others"]
    np.testing.assert_allclose(first.detections["vehicle"][0, :6], samples[0].objects.boxes[0, :6])
    assert first.detections["vehicle"][0, 6] == pytest.approx(0.2)
    assert first.described() == "first: 400 points, 3 labelled, 1 detected, 0 hits, 0 missed, 0 false alarms"
    assert second.described() == "second: 500 points, 2 labelled, 1 detected, 0 hits, 0 missed, 1 false alarm"
    assert Drawing().all_of(samples)[0].described() == "first: 400 points, 3 labelled, 0 detected"


def test_what_became_of_labels_and_detections(touched, finds_the_car):
    (drawn,) = Drawing(finds_the_car).all_of([touched])
    np.testing.assert_array_equal(drawn.outcomes["hits"]["vehicle"], drawn.detections["vehicle"])
    np.testing.assert_array_equal(drawn.outcomes["missed"]["pedestrian"], drawn.truth["pedestrian"])
    assert drawn.outcomes["false alarms"] == {}
    assert drawn.described() == "first: 408 points, 3 labelled, 1 detected, 1 hit, 1 missed, 0 false alarms"
    (far,) = Drawing(finds_the_car, half=(5.0, 5.0), middle=(100.0, 0.0)).all_of([touched])
    assert far.outcomes == {"hits": {}, "missed": {}, "false alarms": {}}


def test_some_classes_scores_and_sensors_are_drawn(samples, finds_the_car):
    (_, second) = Drawing(finds_the_car, classes=["pedestrian"], sensors=["south"]).all_of(samples[1:] * 2)
    assert ([cloud.name for cloud in second.clouds], second.truth, second.detections) == (["south"], {}, {})
    (first,) = Drawing(finds_the_car, classes=["pedestrian"]).all_of(samples[:1])
    assert (list(first.truth), first.detections) == (["pedestrian"], {})
    assert Drawing(finds_the_car, least_score=0.95).all_of(samples)[0].detections == {}
    assert len(Drawing(finds_the_car, least_score=0.9).all_of(samples)[0].detections) == 1
    with pytest.raises(ValueError, match="has no sensor 'west'"):
        Drawing(sensors=["west"]).all_of(samples)


def test_outcomes_are_put_on_level_ground_with_all_else(touched, finds_the_car):
    drawing = Drawing(finds_the_car, levelling="plane")
    (drawn,) = drawing.all_of([moved(touched, [3.0, 0.0, -7.3])])
    assert drawn.outcomes["hits"]["vehicle"][0, 2] == pytest.approx(0.75, abs=0.05)


def test_map_coordinates_are_counted_from_an_origin_near_by(samples):
    far = moved(samples[0], [600_000.0, 5_500_000.0, 130.0])
    drawing = Drawing()
    assert drawing.origin(far).tolist() == [600_000, 5_500_000, 130]
    (here,), (there,) = drawing.all_of(samples[:1]), drawing.all_of([far])
    np.testing.assert_allclose(there.clouds[0].points, here.clouds[0].points, atol=1e-4)
    np.testing.assert_allclose(there.truth["others"], here.truth["others"], atol=1e-6)
    np.testing.assert_allclose(there.clouds[0].place, here.clouds[0].place, atol=1e-6)


def test_ground_far_below_is_put_on_zero_and_boxes_with_it(samples, finds_the_car):
    low = moved(samples[0], [3.0, 0.0, -7.3])
    drawing = Drawing(finds_the_car, levelling="plane")
    assert drawing.origin(low).tolist() == [3, 0, 0]
    (drawn,) = drawing.all_of([low])
    assert np.abs(drawn.clouds[0].points[:, 2]).max() < 0.1
    assert drawn.clouds[0].place[2] == pytest.approx(5.0, abs=0.05)
    np.testing.assert_allclose(drawn.truth["vehicle"], samples[0].objects.boxes[:1], atol=0.05)
    assert drawn.warning is None
    (found,) = drawn.detections["vehicle"]
    np.testing.assert_allclose(found[:3], [12, 3, 0.75], atol=0.05)


def test_ground_that_stays_where_it_is_is_warned_of(samples):
    (drawn,) = Drawing().all_of([moved(samples[0], [0.0, 0.0, -7.3])])
    assert "level the points first" in str(drawn.warning)


def test_detections_are_of_the_area_that_is_asked_for(samples, finds_the_car):
    """The detector is shown points counted from the middle, and its boxes are brought back."""
    drawing = Drawing(finds_the_car, middle=(10.0, -2.0))
    assert drawing.origin(samples[0]).tolist() == [10, -2, 0]
    (drawn,) = drawing.all_of(samples[:1])
    np.testing.assert_allclose(drawn.detections["vehicle"][0, :3], [12, 3, 0.75])
    np.testing.assert_allclose(drawn.truth["vehicle"][0, :3], [2, 5, 0.75])


def test_an_empty_sample_can_be_drawn():
    empty = Sample("nothing", (), Objects.empty())
    for levelling in ("none", "map"):
        (drawn,) = Drawing(levelling=levelling).all_of([empty])
        assert (drawn.clouds, drawn.truth, drawn.detections) == ((), {}, {})


def test_a_levelling_that_there_is_not_is_refused(samples):
    with pytest.raises((ValueError, TypeError), match="levelling"):
        Drawing(levelling="flat").all_of(samples)


def test_thinning_keeps_columns_beside_their_points(samples):
    (cloud,) = Drawing().all_of(samples[:1])[0].clouds
    few = thinned(cloud, 4)
    assert few.intensity.tolist() == [0, 100, 200, 300]
    np.testing.assert_array_equal(few.points, cloud.points[::100])
    np.testing.assert_array_equal(few.time, np.asarray(cloud.time)[::100])
    assert thinned(cloud, 400) is cloud


def test_colourings_are_those_that_something_is_known_for(samples):
    first, second = Drawing().all_of(samples)
    assert colourings_of([first]) == ("sensor", "height", "intensity", "age")
    bare = replace(second, clouds=second.clouds[1:])
    assert colourings_of([bare]) == ("sensor", "height")
    assert colourings_of([bare, first])[2:] == ("intensity", "age")


def test_progress_counts_samples(samples):
    seen = []
    Drawing().all_of(samples, progress=seen.append)
    assert seen == [1, 2]
