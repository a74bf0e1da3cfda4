"""Maps of what is seen how often, against segments that are cut by boxes by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from placement_env.fidelity.traffic import Traffic
from placement_env.live.seen_map import CELL_M, MAP_FRAMES, SeenMaps
from toolkit.bodies.body import make_body
from toolkit.geometry import invert, look, pose, transform
from toolkit.mesh import box
from toolkit.objects import Objects
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site, Solid
from toolkit.traffic.snapshots import Snapshot

LIDAR = SpinningLidar(channels=33, fov_up=0.3, fov_down=-1.5, azimuth_step=float(np.deg2rad(0.5)))
HIGH = Sensor("high", LIDAR, pose(-7.03, 0.11, 5.0))
LOW = Sensor("low", DepthCamera(), look((6.03, -5.07, 4.0), float(np.deg2rad(120)), 0.3))
WALL = np.array([[0.0, -3.0], [0.4, -3.0], [0.4, 3.0], [0.0, 3.0]])
CAR = np.array([4.4, 1.8, 1.6])
# of the car, one for each frame; the last far off
PLACES = ((-3.0, 3.0), (-3.0, -3.0), (5.0, 2.0), (90.0, 90.0))
HEIGHT = 1.0
SITE = Site(
    "field",
    np.array([-10.0, -8.0, 10.0, 8.0]),
    solids=(
        Solid(WALL, 0.0, 2.5, "wall"),
        Solid(np.array([[6.0, 5.0], [9.0, 5.0], [9.0, 8.0], [6.0, 8.0]]), 0.0, 9.0, "building"),
    ),
)


def prepare(places=PLACES):
    mesh = box(CAR)
    body = make_body("car", 0, mesh.vertices, mesh.triangles)
    boxes = [np.array([[x, y, 0.8, *CAR, 0.0]]) for x, y in places]
    snapshots = tuple(
        Snapshot(Objects(row, np.zeros(1, np.int64)), np.zeros(1, np.int64)) for row in boxes
    )
    traffic = Traffic(SITE, (body,), snapshots)
    return SimpleNamespace(
        setting=SimpleNamespace(place=SITE), frames=len(places), live=None, traffic=traffic
    )


def is_cut(start, ends, low, high):
    """True for segments from a point that pass through a box (Kay and Kajiya's slabs)."""
    ways = ends - start
    with np.errstate(divide="ignore"):
        near, far = (low - start) / ways, (high - start) / ways
    enters = np.minimum(near, far).max(axis=1)
    leaves = np.maximum(near, far).min(axis=1)
    return (enters < leaves) & (leaves > 0) & (enters < 1)


def expect(sensor, seen, places=PLACES):
    """Share of the frames in which each open cell is in view and free, by hand."""
    x, y = np.meshgrid(seen.x, seen.y)
    cells = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, HEIGHT)])
    inside = sensor.model.in_view(transform(invert(sensor.pose), cells))
    still = np.zeros(len(cells), bool)
    for solid in SITE.solids:
        low, high = (
            (*solid.footprint.min(axis=0), solid.base),
            (*solid.footprint.max(axis=0), solid.top),
        )
        still |= is_cut(sensor.position, cells, np.array(low), np.array(high))
    frames = []
    for x, y in places:
        middle = np.array([x, y, 0.8])
        frames.append(
            inside & ~still & ~is_cut(sensor.position, cells, middle - CAR / 2, middle + CAR / 2)
        )
    return np.array(frames).reshape(len(places), *seen.share.shape)


@pytest.mark.parametrize("sensor", [HIGH, LOW], ids=["lidar", "camera"])
def test_a_cell_is_seen_in_the_frames_in_which_its_way_is_free(sensor):
    seen = SeenMaps(prepare(), HEIGHT).draw([sensor])
    expected = expect(sensor, seen).mean(axis=0)
    there = ~np.isnan(seen.share)
    assert np.mean(np.abs(seen.share - expected)[there] < 1e-6) > 0.985  # but for cells at edges
    assert 0.2 < np.mean(seen.share[there] < 1) < 0.995
    assert {0.0, 0.75, 1.0} <= set(np.round(seen.share[there], 6).tolist())


def test_the_grid_has_half_metres_and_leaves_buildings_out():
    maps = SeenMaps(prepare(), HEIGHT)
    seen = maps.draw([])
    assert (seen.x[0], seen.x[-1], seen.y[0], seen.y[-1]) == (-9.75, 9.75, -7.75, 7.75)
    assert np.diff(seen.x) == pytest.approx(CELL_M)
    assert (seen.height, seen.frames) == (HEIGHT, len(PLACES))
    x, y = np.meshgrid(seen.x, seen.y)
    inside = (x > 6) & (x < 9) & (y > 5)
    assert np.isnan(seen.share[inside]).all()
    assert (seen.share[~np.isnan(seen.share)] == 0).all()
    assert np.isnan(seen.share).sum() >= inside.sum()


def test_several_sensors_see_what_any_of_them_sees():
    maps = SeenMaps(prepare(), HEIGHT)
    both, each = maps.draw([HIGH, LOW]), [maps.draw([sensor]) for sensor in (HIGH, LOW)]
    frames = expect(HIGH, both) | expect(LOW, both)
    there = ~np.isnan(both.share)
    assert (both.share >= np.fmax(each[0].share, each[1].share))[there].all()
    assert np.mean(np.abs(both.share - frames.mean(axis=0))[there] < 1e-6) > 0.98


def test_what_is_in_sight_of_a_place_is_worked_out_once(fail):
    maps = SeenMaps(prepare(), HEIGHT)
    first = maps.draw([HIGH]).share
    fail("placement_env.live.seen_map", "build_moment")
    turned = Sensor("turned", DepthCamera(), look(HIGH.position, 0.0, 0.3))
    again = maps.draw([HIGH, turned]).share
    np.testing.assert_array_equal(maps.draw([HIGH]).share, first)
    np.testing.assert_array_equal(again, first)


def test_long_traffic_is_looked_at_in_frames_evenly_chosen(spy):
    count = 3 * MAP_FRAMES
    calls = spy("placement_env.live.seen_map", "build_moment")
    maps = SeenMaps(prepare(((90.0, 90.0),) * (count - 1) + (PLACES[0],)), HEIGHT)
    seen = maps.draw([HIGH])
    frames = [call.args[1] for call in calls]
    assert (len(frames), frames[0], frames[-1]) == (MAP_FRAMES, 0, count - 1)
    assert set(np.diff(frames).tolist()) == {3, 4} or np.ptp(np.diff(frames)) <= 1
    behind = seen.share[(~np.isnan(seen.share)) & (seen.share < 1) & (seen.share > 0)]
    assert behind == pytest.approx(
        1 - 1 / MAP_FRAMES
    )  # hidden in the last frame, whose bit is the highest
