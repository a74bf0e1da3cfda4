"""What a block of sensors sees is what the renderer hits, and what is sent is the mean over the
noise."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity.occlusion import look_at
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import build_renderer, scored
from toolkit.boxes import count_points
from toolkit.frame import unproject
from toolkit.points import is_beyond, is_inside
from toolkit.rendering.renderer import Renderer
from toolkit.sensors.sensor import Sensor


@pytest.fixture(scope="module")
def rendered(small_traffic):
    """Per frame and sensor the points in the crop, and the row of the object that each lies on."""
    site, found = small_traffic.site, []
    renderer = Renderer(site, small_traffic.bodies, site.sensors)
    for snapshot in small_traffic.snapshots:
        frame = []
        for sensor, depth, hits in zip(site.sensors, *renderer.render(snapshot), strict=True):
            points, valid = unproject(sensor, depth)
            keep = valid & is_inside(points.T, site.area, site.height)
            frame.append((points.T[keep], hits.ravel()[keep]))
        found.append(frame)
    return found


def test_points_are_those_rendered_and_in_boxes(small_traffic, seen, rendered):
    for k, snapshot in enumerate(small_traffic.snapshots):
        rows = np.flatnonzero(scored(snapshot.objects, small_traffic.site))
        expected = [[(hits == row).sum() for row in rows] for _, hits in rendered[k]]
        found = seen.points[:, seen.frame == k]
        assert (
            np.abs(found - np.array(expected).reshape(found.shape)).max(initial=0) <= 1
        )  # rounding at an edge
        assert np.array_equal(seen.boxes[seen.frame == k], snapshot.objects.boxes[rows])
    assert (seen.points > 0).any(axis=1).all()
    assert seen.points.max() > 50
    for k in range(seen.frames):
        found, boxes = seen.points[:, seen.frame == k], seen.boxes[seen.frame == k]
        on_objects = np.array(
            [count_points(points[hits >= 0], boxes) for points, hits in rendered[k]]
        )
        assert (
            np.abs(on_objects - found) <= 0.02 * found + 8
        ).all()  # rounding on the faces of a box


def test_sent_is_counted_or_the_mean_over_noise_as_visibility_keeps(
    small_traffic, small_candidates, seen
):
    renders = [Renders(small_traffic, small_candidates, noise_seed=seed) for seed in range(4)]
    radius = small_traffic.site.hybrid_radius

    def far(r, k, c):
        points = r.clouds(k, c)
        return points[is_beyond(points, r.sensors[c], radius)]

    for measured, expected in ((Renders.clouds, seen.sent), (far, seen.far)):
        sent = [[[len(measured(r, k, c)) for k in range(5)] for c in range(4)] for r in renders]
        assert np.abs(np.mean(sent, axis=0) - expected).max() < 12 + 0.02 * expected.max()
    exact = tuple(
        Sensor(s.name, replace(s.model, sigma=0.0), s.pose) for s in small_candidates.sensors
    )
    found = see(small_traffic, replace(small_candidates, sensors=exact))
    renderer = Renderer(small_traffic.site, small_traffic.bodies, exact)
    for k, snapshot in enumerate(small_traffic.snapshots):
        for c, (sensor, depth) in enumerate(
            zip(exact, renderer.render(snapshot).measurements, strict=True)
        ):
            points, valid = unproject(sensor, depth)
            points = points.T[
                valid & is_inside(points.T, small_traffic.site.area, small_traffic.site.height)
            ]
            assert abs(found.sent[c, k] - len(points)) < 2
            far = is_beyond(points, sensor, small_traffic.site.hybrid_radius).sum()
            assert abs(found.far[c, k] - far) < 2
    looked = look_at(small_traffic, build_renderer(small_traffic), small_candidates.sensors[1:3])
    assert np.array_equal(looked.points, seen.points[1:3])
    assert np.array_equal(looked.sent, seen.sent[1:3])
    assert np.array_equal(looked.far, seen.far[1:3])
