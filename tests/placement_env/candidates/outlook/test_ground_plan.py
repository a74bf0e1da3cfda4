import numpy as np
import pytest

from placement_env.candidates.outlook.ground_plan import (
    CHANNELS,
    RASTER_CELLS,
    TRAFFIC,
    WAITING,
    covers,
    ground_plan,
    lane_points,
)
from toolkit.sites.files import load_site
from toolkit.sites.site import Site, Solid

AREA = np.array([0.0, 0.0, 48.0, 24.0])  # cells of 2 m by 1 m
NETWORK = """<net>
<edge id="in"><lane id="in_0" allow="passenger" shape="0.0,0.5 20.0,0.5"/><lane id="in_1" allow="pedestrian" shape="0,9 20,9"/></edge>
<edge id=":c_0" function="internal"><lane id=":c_0_0" allow="passenger" shape="20.0,0.5 24.0,4.5"/></edge>
<edge id=":c_w0" function="walkingarea"><lane id=":c_w0_0" shape="0,20 5,20 5,22"/></edge>
</net>"""  # noqa: E501


def site(**more) -> Site:
    return Site("cells", AREA, **({"network": NETWORK} | more))


def test_points_stand_along_lanes_that_cars_use():
    points = lane_points(NETWORK)
    assert points.metres.sum() == pytest.approx(20 + 4 * 2**0.5)
    assert points.metres[points.inside].sum() == pytest.approx(4 * 2**0.5)
    assert points.xy[0].tolist() == [0.5, 0.5]
    assert points.rest[:2].tolist() == [19.5, 18.5]
    assert np.unique(points.heading.round(6)).tolist() == [0.0, round(np.pi / 4, 6)]


def test_cells_hold_the_metres_of_their_lanes():
    plan = ground_plan(site(parking=np.array([[10.5, 20.5, np.pi / 2]])))
    first, last = plan.metres[0], plan.metres[9]  # x from 0 to 2 and from 18 to 20
    assert first[0] == last[0] == 2.0
    assert last[1] == pytest.approx(np.exp(-0.5 / WAITING) + np.exp(-1.5 / WAITING))
    assert first[1] == pytest.approx(np.exp(-18.5 / WAITING) + np.exp(-19.5 / WAITING))
    assert plan.metres[:, 2].sum() == pytest.approx(4 * 2**0.5)
    bay = 20 * RASTER_CELLS + 5
    assert np.flatnonzero(plan.metres[:, 3]).tolist() == [bay]
    assert plan.traffic[bay] == TRAFFIC[3]
    assert plan.traffic[0] == pytest.approx(first @ np.array(TRAFFIC))
    assert bay in plan.used
    assert len(plan.used) == 1 + int((plan.metres[:, :3].sum(axis=1) > 0).sum())


def test_courses_are_those_of_lanes_and_bays():
    plan = ground_plan(site(parking=np.array([[10.5, 20.5, np.pi / 2]])))
    assert plan.course[0] == pytest.approx([1, 0, 0])
    assert plan.course[20 * RASTER_CELLS + 5] == pytest.approx([-1, 0, 0], abs=1e-9)
    diagonal = RASTER_CELLS * 2 + 11  # on the way from (20, 0.5) to (24, 4.5)
    assert plan.course[diagonal] == pytest.approx([0, 1, 1], abs=1e-9)
    assert not plan.course[-1].any()


def test_shares_of_what_covers_the_ground():
    house = Solid(np.array([[0.0, 22.0], [48.0, 22.0], [48.0, 24.0], [0.0, 24.0]]), 0, 5)
    crown = Solid(np.array([[0.0, 10.0], [48.0, 10.0], [48.0, 12.0], [0.0, 12.0]]), 3, 5, "tree")
    plan = ground_plan(site(lanes=(np.array([[0.0, 0.0], [48.0, 0], [48, 1], [0, 1]]),), solids=(house, crown)))
    lanes, footways, solids = plan.shares.T.reshape(3, RASTER_CELLS, RASTER_CELLS)
    assert lanes[0].tolist() == [1.0] * RASTER_CELLS
    assert not lanes[1:].any()
    assert not footways.any()
    assert solids[22:].all()
    assert not solids[:22].any()


def test_without_a_network_the_polygons_are_the_lanes():
    plan = ground_plan(site(network="", lanes=(np.array([[0.0, 0.0], [48.0, 0], [48, 1], [0, 1]]),)))
    assert plan.metres[:RASTER_CELLS, 0].tolist() == pytest.approx([2 / 3.5] * RASTER_CELLS)
    assert len(plan.used) == RASTER_CELLS


def test_places_outside_are_in_no_cell():
    plan = ground_plan(site())
    places = np.array([[0.0, 0.0], [47.9, 23.9], [48.0, 5.0], [-0.1, 5.0], [5.0, 24.0]])
    assert plan.cells_at(places).tolist() == [0, RASTER_CELLS**2 - 1, -1, -1, -1]


def test_channels_of_a_real_site_are_shares():
    plan = ground_plan(load_site("tjunction"))
    channels = dict(zip(CHANNELS, plan.channels.T, strict=True))
    assert plan.channels.dtype == np.float32
    assert 0 <= plan.channels.min() <= plan.channels.max() <= 1
    assert channels["traffic"] == pytest.approx(plan.traffic / (plan.traffic + 1), rel=1e-6)
    assert channels["waiting"].max() > 0.3
    assert channels["inside"].max() > 0
    assert 3 < plan.traffic.sum() < 15


def test_cover_of_nothing():
    assert covers([], np.zeros(3), np.zeros(3)).tolist() == [False] * 3
