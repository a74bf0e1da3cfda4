from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from toolkit.boxes import iou_bev
from toolkit.detection.paper_codec import PaperCodec
from toolkit.detection.paper_schemes import Hybrid
from toolkit.detection.scheme import Fused
from toolkit.detection.schemes import fuse_frame
from toolkit.detection.view import suppress
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Detections, Objects
from toolkit.points import frame_points, is_beyond
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

AREA = (-40, -20, 40, 20)
POSES = [(30.0, 8.0, 2.7), (-7.0, -12.0, 1.1), (-30.0, 5.0, 0.0), (0.0, 18.0, 4.5)]
SENSORS = tuple(
    Sensor(f"s{k}", DepthCamera(width=80, height=60), look((x, y, 5.2), heading, tilt=0.1))
    for k, (x, y, heading) in enumerate(POSES)
)


def grid_detector(points):
    """A box in each 8 m cell with points, at their mean, the surer the more points: depends on all
    of them."""
    cells, place, count = np.unique(
        np.floor(points[:, :2] / 8), axis=0, return_inverse=True, return_counts=True
    )
    sums = np.zeros((len(cells), 2))
    np.add.at(sums, place.ravel(), points[:, :2].astype(np.float64))
    boxes = np.tile([0.0, 0, 1, 4, 2, 1.5, 0], (len(cells), 1))
    boxes[:, :2] = sums / np.maximum(count, 1)[:, None]
    return Detections(boxes, count / 1e4)


def frame(sensors=SENSORS, seed=0):
    rng = np.random.default_rng(seed)
    depths = tuple(rng.uniform(0, 40, sensor.model.shape).astype(np.float32) for sensor in sensors)
    return Frame(sensors, depths, Objects.empty())


def same(a: Fused, b: Fused):
    np.testing.assert_allclose(a.detections.boxes, b.detections.boxes, atol=1e-6)
    np.testing.assert_array_equal(a.detections.scores, b.detections.scores)


early, late = partial(fuse_frame, "early"), partial(fuse_frame, "late")


def hybrid(*given, radius=None, **settings):
    return fuse_frame(Hybrid(radius), *given, **settings)


SCHEMES = [early, late, hybrid]


def test_early_late_and_hybrid_send_and_detect_as_they_should():
    seen = []

    def spy(points):
        seen.append(points)
        return grid_detector(points)

    fused = early(frame(), spy, site=AREA)
    clouds = frame_points(frame(), area=AREA)
    assert len(seen) == 1
    np.testing.assert_array_equal(seen[0], np.concatenate(clouds))
    assert fused.bits.tolist() == [96 * len(points) for points in clouds]
    assert fused.kbit_per_sensor == fused.bits.mean() / 1000
    fused = late(frame(), grid_detector, site=AREA)
    local = [grid_detector(points) for points in frame_points(frame(), area=AREA)]
    assert fused.bits.tolist() == [256 * len(boxes) for boxes in local]
    assert 0 < len(fused.detections) < sum(map(len, local))
    overlap = iou_bev(fused.detections.boxes, fused.detections.boxes) - np.eye(
        len(fused.detections)
    )
    assert overlap.max() <= 0.1
    assert (np.diff(fused.detections.scores) <= 0).all()
    scene, clouds = frame(), frame_points(frame(), area=AREA)
    fused = hybrid(scene, grid_detector, site=AREA, radius=12.0)
    far = [
        points[is_beyond(points, sensor, 12.0)]
        for points, sensor in zip(clouds, SENSORS, strict=True)
    ]
    local = [grid_detector(points) for points in clouds]
    assert fused.bits.tolist() == [
        96 * len(f) + 256 * len(b) for f, b in zip(far, local, strict=True)
    ]
    everything = Detections.merge([*local, suppress(grid_detector(np.concatenate(far)))])
    same(fused, Fused(suppress(everything), fused.bits))
    # Radius 0 sends every point, and the surest boxes come from all of them; an endless radius is
    # late fusion.
    same(
        hybrid(frame(), grid_detector, site=AREA, radius=1e6),
        late(frame(), grid_detector, site=AREA),
    )
    none = hybrid(frame(), grid_detector, site=AREA, radius=0.0)
    best = early(frame(), grid_detector, site=AREA).detections
    assert none.bits.sum() > early(frame(), grid_detector, site=AREA).bits.sum()
    np.testing.assert_allclose(none.detections.boxes[0], best.boxes[0])
    scene = frame()
    twins = (*scene.sensors, replace(scene.sensors[0], name="twin of s0"))
    doubled = Frame(twins, (*scene.measurements, scene.measurements[0]), scene.objects)
    same(
        late(doubled, grid_detector, [0, "twin of s0", 1], site=AREA),
        late(scene, grid_detector, [0, 1], site=AREA),
    )


@pytest.mark.parametrize("scheme", [late, hybrid])
@pytest.mark.parametrize("sensor", range(4))
def test_one_sensor_is_the_same_whatever_the_scheme(scheme, sensor):
    kwargs = {"radius": 1e6} if scheme is hybrid else {}
    same(
        scheme(frame(), grid_detector, [sensor], site=AREA, **kwargs),
        early(frame(), grid_detector, [sensor], site=AREA),
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_order_of_the_sensors_does_not_matter(scheme):
    straight = scheme(frame(), grid_detector, [0, 1, 3], site=AREA)
    shuffled = scheme(frame(), grid_detector, ["s3", 0, "s1"], site=AREA)
    np.testing.assert_array_equal(straight.detections.boxes, shuffled.detections.boxes)
    np.testing.assert_array_equal(straight.bits[[2, 0, 1]], shuffled.bits)
    scene, order = frame(), [2, 0, 3, 1]
    turned = Frame(
        tuple(SENSORS[k] for k in order), tuple(scene.measurements[k] for k in order), scene.objects
    )
    straight, shuffled = (scheme(s, grid_detector, site=AREA) for s in (scene, turned))
    same(straight, shuffled)
    np.testing.assert_array_equal(straight.bits[order], shuffled.bits)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_sensors_unknown_twice_or_that_see_nothing(scheme):
    with pytest.raises(ValueError, match="once only"):
        scheme(frame(), grid_detector, [0, 0], site=AREA)
    fused = scheme(frame(), grid_detector, [], site=AREA)
    assert len(fused.detections) == len(fused.bits) == fused.kbit_per_sensor == 0
    blind = Frame(
        SENSORS, tuple(np.zeros(s.model.shape, np.float32) for s in SENSORS), Objects.empty()
    )
    fused = scheme(blind, grid_detector, site=AREA)
    assert len(fused.detections) == 0
    assert fused.bits.tolist() == [0, 0, 0, 0]
    with pytest.raises(ValueError, match="no sensor 7: choose among"):
        scheme(frame(), grid_detector, [7], site=AREA)


def test_codecs_scores_and_radii_of_sites():
    clouds = frame_points(frame(), area=AREA)
    cost = PaperCodec(bits_per_point=48, bits_per_box=100)
    assert early(frame(), grid_detector, site=AREA, codec=cost).bits.tolist() == [
        48 * len(c) for c in clouds
    ]
    boxes = [grid_detector(points) for points in clouds]
    assert late(frame(), grid_detector, site=AREA, codec=cost).bits.tolist() == [
        100 * len(b) for b in boxes
    ]
    far = [
        points[is_beyond(points, sensor, 12.0)]
        for points, sensor in zip(clouds, SENSORS, strict=True)
    ]
    sent = hybrid(frame(), grid_detector, site=AREA, radius=12.0, codec=cost).bits
    assert sent.tolist() == [48 * len(f) + 100 * len(b) for f, b in zip(far, boxes, strict=True)]
    three = np.array(
        [[0.0, 0, 1, 4, 2, 1.5, 0], [0.5, 0, 1, 4, 2, 1.5, 0], [9, 0, 1, 4, 2, 1.5, 0]]
    )
    forward, backward = (suppress(Detections(b, np.full(3, 0.5))) for b in (three, three[::-1]))
    np.testing.assert_array_equal(forward.boxes, backward.boxes)
    site = Site("here", np.array(AREA, float), hybrid_radius=12.0)
    given = hybrid(frame(), grid_detector, site=AREA, radius=12.0)
    same(hybrid(frame(), grid_detector, site=site), given)
    assert hybrid(frame(), grid_detector, site=site).bits.tolist() == given.bits.tolist()
    assert hybrid(frame(), grid_detector, site=AREA).bits.tolist() != given.bits.tolist()
