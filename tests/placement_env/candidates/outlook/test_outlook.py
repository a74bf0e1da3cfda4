import numpy as np
import pytest

from placement_env.candidates.candidates import Candidates
from placement_env.candidates.outlook.outlook import (
    CANDIDATE_FEATURES,
    FACE,
    MOST_RAYS,
    REACH_ASIDE,
    VIEW,
    lifted,
    outlook,
    rays_at,
)
from placement_env.candidates.outlook.ray_density import ray_density
from placement_env.candidates.pool import pool
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.spinning_lidar import SpinningLidar
from toolkit.sites.site import Mount, Relief, Site

AREA = np.array([-24.0, -24.0, 24.0, 24.0])
ROAD = np.array([[-24.0, -2.0], [24.0, -2.0], [24.0, 2.0], [-24.0, 2.0]])
SITE = Site("road", AREA, lanes=(ROAD,), mounts=(Mount("west", np.array([-26.0, 0.0, 0.0])),))


def candidates(site: Site = SITE, **more) -> Candidates:
    return pool(site, **({"heights": (6.0,), "headings": 4, "tilts": (0.2,), "blind": True} | more))


def view(name: str, known) -> np.ndarray:
    return known.view[..., VIEW.index(name)]


def test_rays_fall_where_a_sensor_is_headed():
    known = outlook(SITE, candidates())
    rays = view("rays", known)
    assert known.view.shape == (4, len(known.plan.used), 5)
    assert rays[0].max() > 0.4  # headed east, along the road
    assert not rays[2].any()  # headed west, away from it
    x = known.plan.centres[known.plan.used, 0]
    assert rays[0, x > 10].max() < rays[0, (x > -10) & (x < 0)].max()  # fewer, the farther off
    assert view("distance", known)[0] == pytest.approx(
        np.linalg.norm([x + 26, known.plan.centres[known.plan.used, 1], np.full(len(x), 0.75 - 6)], axis=0) / 150
    )
    assert (known.view >= 0).all()
    assert (known.view <= 1).all()


def test_how_many_rays():
    camera, away = DepthCamera(), np.float32([[[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.5, 0.0, 0.0]]])
    rays, distance = rays_at(camera, away, np.eye(3)[None])
    table = ray_density(camera)
    beside = np.rad2deg(REACH_ASIDE / 10) / 2
    mean = np.mean([table[int(np.floor(90 + k * beside)), 45] for k in (-1, 0, 1)])
    assert rays[0, 0] == pytest.approx(mean / 100, rel=1e-4)
    assert rays[0, 1] == 0
    assert distance.tolist() == [[10.0, 10.0, 0.5]]
    assert not rays_at(DepthCamera(max_range=9.0), away, np.eye(3)[None])[0][0, 0]
    known = outlook(SITE, candidates())
    expected = np.log1p(min(FACE * float(rays_at(camera, *_first(known))[0][0, 0]), MOST_RAYS)) / np.log1p(MOST_RAYS)
    assert view("rays", known)[0, 5] == pytest.approx(expected, rel=1e-5)


def _first(known) -> tuple[np.ndarray, np.ndarray]:
    cell = known.plan.used[5]
    sensor = candidates().sensors[0]
    offset = np.append(known.plan.centres[cell], 0.75) - sensor.position
    turned = sensor.pose[:3, :3] @ sensor.model.body_SE3_sensor[:3, :3].T
    return offset[None, None].astype(np.float32), turned[None]


def test_turning_everything_changes_nothing():
    """A site turned by 90°, and a sensor with it, has the same outlook in other cells."""
    turned_road = ROAD[:, ::-1] * [-1, 1]
    south = Site("turned", AREA, lanes=(turned_road,), mounts=(Mount("south", np.array([0.0, -26.0, 0.0])),))
    east, north = (outlook(site, candidates(site)) for site in (SITE, south))
    order = np.lexsort(east.plan.centres[east.plan.used].T[::-1])
    other = north.plan.centres[north.plan.used][:, ::-1] * [1, -1]
    matching = np.lexsort(other.T[::-1])
    assert east.view[0, order] == pytest.approx(north.view[1, matching], abs=0.02)
    names = ("height", "tilt", "field of view", "rays", "ground rays")
    columns = [CANDIDATE_FEATURES.index(name) for name in names]
    assert east.features[0, columns] == pytest.approx(north.features[1, columns], abs=0.01)


def test_candidates_alone_have_the_outlook_they_have_among_others():
    some = candidates(models=(DepthCamera(), SpinningLidar()), tilts=(0.1, 0.4), heights=(4.0, 8.0))
    whole = outlook(SITE, some)
    for chosen in ([0], [len(some) - 1, 3]):
        part = outlook(SITE, some.select(chosen))
        assert part.view == pytest.approx(whole.view[chosen], abs=1e-5)
        assert part.features == pytest.approx(whole.features[chosen], abs=1e-5)


def test_what_stands_higher_than_the_street_is_sent():
    relief = Relief(0.2, 3)
    plan = outlook(Site("waves", AREA, lanes=(ROAD,), mounts=SITE.mounts, relief=relief), candidates()).plan
    site = Site("waves", AREA, relief=relief)
    raised = lifted(site, plan)
    assert (raised[plan.ground > 0.05] == 1).all()
    assert (raised[plan.ground < -0.05] == 0).all()
    assert lifted(SITE, plan) == pytest.approx(np.clip(0.5 + plan.ground / 0.06, 0, 1))
