"""The built-in schemes on a view, and by name."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from toolkit.detection.link.foreground import Foreground
from toolkit.detection.paper_schemes import Early, Hybrid, Late
from toolkit.detection.scheme import Scheme
from toolkit.detection.schemes import PAPER_SCHEMES, SCHEMES, find_scheme, schemes_in_steps
from toolkit.detection.view import View, together
from toolkit.geometry import look
from toolkit.objects import Detections
from toolkit.points import is_beyond
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site
from toolkit.sites.site import Site

AREA = (-40.0, -20.0, 40.0, 20.0)
TEN, FOUR = (np.full((2, 3), number, np.float32) for number in (10, 4))
COUNTS = SimpleNamespace(sent=TEN, on_objects=FOUR, far=FOUR)
SENSORS = tuple(
    Sensor(name, DepthCamera(), look((x, 0.0, 5.0), 0.0)) for name, x in (("a", -10.0), ("b", 10.0))
)
POINTS = [np.array([[x, y, 1.0] for y in (0.0, 3.0, 15.0)], np.float32) for x in (-9.0, 9.0)]


def one_box(clouds):
    """A box at the mean of all points, the surer the more there are; none without points."""
    points = together(clouds)
    boxes = (
        np.array([[*points.mean(axis=0), 4, 2, 1.5, 0]], np.float64)
        if len(points)
        else np.zeros((0, 7))
    )
    return Detections(boxes, np.full(len(boxes), len(points) / 10))


def view():
    return View(AREA, SENSORS, measure=lambda sensor: POINTS[sensor], run=one_box)


def test_hybrid_sends_boxes_and_far_points_by_the_radius_of_the_site():
    """The points at y = 15 alone are farther than 10 m from their sensor."""
    fused = Hybrid(10.0).fuse(view(), [0, 1])
    assert fused.bits.tolist() == [256 + 96, 256 + 96]
    found = fused.detections.boxes[np.argsort(fused.detections.boxes[:, 0]), :2]
    np.testing.assert_allclose(found, [[-9.0, 6.0], [0.0, 15.0], [9.0, 6.0]], atol=1e-6)
    np.testing.assert_array_equal(Hybrid().sent_points(COUNTS), COUNTS.far)
    for own in (Hybrid(5.0), Hybrid(metric="published")):
        with pytest.raises(ValueError, match="hybrid_radius"):
            own.sent_points(COUNTS)
    distance = np.array([[5.0, 20.0, 20.5]], np.float32)
    assert Hybrid().mask_pooled(distance, 20.0).tolist() == [[False, False, True]]
    assert Hybrid(4.0).mask_pooled(distance, 20.0).all()


@pytest.mark.parametrize("radius", [0.0, 2.0, 10.0, 1e6])
def test_what_is_sent_is_what_lies_beyond(radius):
    bits = Hybrid(radius).fuse(view(), [0, 1]).bits
    far = [
        int(is_beyond(points, sensor, radius).sum())
        for points, sensor in zip(POINTS, SENSORS, strict=True)
    ]
    assert bits.tolist() == [256 + 96 * count for count in far]


@pytest.mark.parametrize("radius", [-1.0, np.nan])
def test_nonsense_radii_are_refused(radius):
    with pytest.raises(ValueError, match="radius must be at least 0"):
        Hybrid(radius)


@pytest.mark.parametrize(("name", "radius"), [("tjunction", 20.0), ("roundabout", 12.0)])
def test_hybrid_radius_is_the_papers_and_stays_with_a_renamed_site(name, radius):
    site = load_site(name)
    assert (
        Hybrid().find_radius(site) == Hybrid().find_radius(replace(site, name="renamed")) == radius
    )
    assert Hybrid(5.0).find_radius(site) == 5.0
    assert (
        Hybrid().find_radius(AREA)
        == Hybrid().find_radius(Site("any", np.array(AREA, float)))
        == 20.0
    )


def test_early_fusion_sends_points():
    fused = Early().fuse(view(), [0, 1])
    np.testing.assert_allclose(fused.detections.boxes[:, :3], [[0.0, 6.0, 1.0]])
    assert fused.detections.scores.tolist() == [0.6]
    assert fused.bits.tolist() == [3 * 96, 3 * 96]
    fused = Early().fuse(view(), [])
    assert len(fused.detections) == len(fused.bits) == 0
    assert Early().sent_points(COUNTS) is COUNTS.sent
    assert (Early().sends_points, Early().sends_boxes) == (True, False)
    scheme: Scheme = Early()
    assert scheme.mask_pooled(np.zeros((2, 3), np.float32), 20.0) is None


def test_late_fusion_sends_boxes():
    fused = Late().fuse(view(), [0, 1])
    np.testing.assert_allclose(np.sort(fused.detections.boxes[:, 0]), [-9.0, 9.0])
    assert fused.bits.tolist() == [256, 256]
    same = View(AREA, SENSORS, measure=lambda sensor: POINTS[0], run=one_box)
    fused = Late().fuse(same, [0, 1])
    assert len(fused.detections) == 1
    assert fused.bits.tolist() == [256, 256]
    assert not Late().sent_points(COUNTS).any()
    assert (Late().sends_points, Late().sends_boxes) == (False, True)
    late: Scheme = Late()
    assert late.mask_pooled(np.zeros((2, 3), np.float32), 20.0) is None


def test_schemes_go_by_name_and_in_steps():
    assert schemes_in_steps(0.08)["foreground"] == Foreground(0.08)
    assert PAPER_SCHEMES == tuple(SCHEMES)[:3] == ("early", "late", "hybrid")
    assert (
        len(
            {Hybrid().digest, Hybrid(5.0).digest, Hybrid(metric="published").digest, Early().digest}
        )
        == 4
    )


@pytest.mark.parametrize("name", SCHEMES)
def test_each_goes_by_its_name(name):
    scheme = find_scheme(name)
    assert isinstance(scheme, Scheme)
    assert scheme.name == name
    assert find_scheme(scheme) is scheme
    assert scheme.sends_points or scheme.sends_boxes


@pytest.mark.parametrize("scheme", ["middle", "", None, 3, Early])
def test_what_is_none_is_refused(scheme):
    with pytest.raises((ValueError, TypeError), match="scheme"):
        find_scheme(scheme)
