import json

import numpy as np
import pytest

from toolkit.frame import (
    Everywhere,
    Frame,
    ImageWedge,
    Rectangle,
    Region,
    SensorCloud,
    parse_region,
)
from toolkit.geometry import pose
from toolkit.objects import Objects

POINTS = np.array([[1.0, 0, 0], [2, 0, 0]], np.float32)


def test_points_and_objects_in_the_world_to_the_millimetre():
    clouds = (
        SensorCloud("a", POINTS, pose(10.0, yaw=np.pi / 2)),
        SensorCloud("b", POINTS, pose(99.0), "world"),
    )
    sample = Frame.of_clouds("0", clouds, Objects.empty())
    np.testing.assert_allclose(
        sample.points(), [[10, 1, 0], [10, 2, 0], [1, 0, 0], [2, 0, 0]], atol=1e-9
    )
    assert sample.seen_by(["b"]).points().tolist() == [[1, 0, 0], [2, 0, 0]]
    assert sample.seen_by([]).points().shape == (0, 3)
    with pytest.raises(ValueError, match=r"no sensor 'c': choose among 0\.\.1 or a, b"):
        sample.seen_by(["c"])
    assert sample.points().dtype == np.float64
    cloud = SensorCloud("a", np.array([[0.001, 0, 0]], np.float32), pose(5e6))
    assert cloud.in_world()[0, 0] - 5e6 == pytest.approx(0.001, abs=1e-8)
    boxes = np.tile([0, 0, 0, 1, 1, 1, 0.0], (3, 1))
    sample = Frame.of_clouds(
        "0", (), Objects(boxes, np.array([0, 1, 2])), ("a", "b", "c"), np.array([5, 6, 7])
    )
    some = sample.select_objects(np.array([True, False, True]))
    assert some.objects.labels.tolist() == [0, 2]
    assert some.categories == ("a", "c")
    assert some.counts.tolist() == [5, 7]


@pytest.mark.parametrize(
    ("made", "names"),
    [
        (
            lambda: SensorCloud("a", POINTS, np.diag([1.0, 1, -1, 1])),
            "pose of 'a' must be a rotation",
        ),
        (
            lambda: SensorCloud("a", POINTS, np.eye(4), time=np.zeros(3)),
            "time of 'a' must be of 2 points",
        ),
        (
            lambda: Frame.of_clouds(
                "0", (SensorCloud("a", POINTS, np.eye(4)),) * 2, Objects.empty()
            ),
            "different names",
        ),
        (lambda: Frame.of_clouds("0", (), Objects.empty(), ("a",)), "0 objects but 1 categories"),
        (
            lambda: Frame.of_clouds("0", (), Objects.empty(), (), np.array([1])),
            "0 objects but 1 counts",
        ),
    ],
)
def test_what_does_not_fit_is_refused(made, names):
    with pytest.raises((ValueError, TypeError), match=f"{names}|Type-check"):
        made()


def test_regions_hold_places():
    boxes = np.array([[0, 0, 0, 1, 1, 1, 0], [5, 0, 0, 1, 1, 1, 0.0]])
    assert Everywhere().covers(boxes).tolist() == [True, True]
    assert Rectangle((-1.0, -1.0, 4.0, 1.0)).covers(boxes).tolist() == [True, False]
    assert isinstance(Rectangle((0.0, 0.0, 1.0, 1.0)), Region)


def test_boxes_have_rectangles_in_an_image():
    # A camera at the origin that looks along z: a box of 2 m at 10 m is 200 pixels wide at its
    # nearer face.
    wedge = ImageWedge(np.array([[900.0, 0, 500, 0], [0, 900, 400, 0], [0, 0, 1, 0]]), 1000, 800)
    boxes = np.array([[0, 0, 10, 2, 2, 2, 0], [0, 0, -10, 2, 2, 2, 0.0], [9.0, 0, 10, 20, 2, 2, 0]])
    left, top, right, bottom = wedge.rectangles(boxes)[0]
    assert (left, top, right, bottom) == (400, 300, 600, 500)
    assert wedge.rectangles(boxes)[1].tolist() == [0, 0, 0, 0]
    assert wedge.rectangles(boxes)[2].tolist() == [400, 300, 999, 500]
    assert wedge.rectangles(np.zeros((0, 7))).shape == (0, 4)
    assert wedge.covers(boxes).tolist() == [True, False, False]
    half = ImageWedge(wedge.projection, 1000, 800, ((300.0, 200.0, 499.0, 600.0),))
    assert half.covers(boxes[:1]).tolist() == [True]
    most = ImageWedge(wedge.projection, 1000, 800, ((300.0, 200.0, 501.0, 600.0),))
    assert most.covers(boxes[:1]).tolist() == [False]


@pytest.mark.parametrize(
    "region",
    [
        *(Everywhere(), Rectangle((-1.5, 0.0, 2.0, 3.25))),
        ImageWedge(np.arange(12.0).reshape(3, 4) / 3, 1242, 375, ((0.0, 1.5, 2.0, 3.0),)),
    ],
)
def test_a_region_comes_back_from_what_files_say_of_it(region):
    again = parse_region(json.loads(json.dumps(region.record())))
    assert type(again) is type(region)
    assert again.record() == region.record()


@pytest.mark.parametrize(
    ("record", "says"),
    [
        *(
            ({"kind": "circle"}, "everywhere, rectangle, image, got {'kind': 'circle'}"),
            ([], "complete in one of"),
        ),
        ({"kind": ["image"]}, "complete in one of"),
        ({"kind": "rectangle", "area": [1, 2, 3]}, "numbers of a region rectangle are damaged"),
        (
            {"kind": "image", "projection": "x", "width": 1, "height": 1, "ignored": []},
            "region image are damaged",
        ),
        (
            {
                "kind": "image",
                "projection": [[0.0] * 4] * 2,
                "width": 1,
                "height": 1,
                "ignored": [],
            },
            "must be 3 by 4",
        ),
    ],
)
def test_damaged_regions_are_refused_in_one_line(record, says):
    with pytest.raises(ValueError, match=says):
        parse_region(record)
