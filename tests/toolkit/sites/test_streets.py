"""Names of streets and arrows on lanes are where maps have them."""

import numpy as np
import pytest

from toolkit.sites.site import Site
from toolkit.sites.streets import find_lane_arrows, find_street_names

NETWORK = """<net>
<edge id="a" name="High Street"><lane id="a_0" shape="-90,2 90,2" allow="passenger"/>
  <lane id="a_1" shape="-90,6 90,6" allow="pedestrian"/></edge>
<edge id="b" name="High Street"><lane id="b_0" shape="90,-2 -90,-2" allow="passenger"/></edge>
<edge id="c" name="Lane"><lane id="c_0" shape="0,-90,1 0,-5,1" allow="passenger"/></edge>
<edge id="d" name="Far Road"><lane id="d_0" shape="300,0 400,0" allow="passenger"/></edge>
<edge id="e"><lane id="e_0" shape="-20,-90 -20,-5" allow="pedestrian"/></edge>
<edge id=":j" function="internal" name="High Street"><lane id=":j_0" shape="0,0 30,30"/></edge>
</net>"""
SITE = Site("s", np.array([-40.0, -30.0, 40.0, 30.0]), network=NETWORK)
LOW, HIGH = SITE.area[:2], SITE.area[2:]


def test_each_street_is_named_once_along_its_longest_lane():
    found = {street.name: street for street in find_street_names(SITE, LOW, HIGH)}
    assert sorted(found) == ["High Street", "Lane"]
    street = found["High Street"]
    assert (street.x, abs(street.y)) == pytest.approx((0.0, 2.0))
    assert street.angle == pytest.approx(0.0)
    assert abs(found["Lane"].angle) == pytest.approx(np.pi / 2)


def test_lanes_of_motor_vehicles_have_arrows_the_way_they_go():
    rows = {
        (round(x), round(y)): angle for x, y, angle in find_lane_arrows(SITE, LOW, HIGH).tolist()
    }
    assert sorted(rows) == [(0, -18), (0, -2), (0, 2)]
    assert rows[0, 2] == pytest.approx(0.0)
    assert abs(rows[0, -2]) == pytest.approx(np.pi)
    assert rows[0, -18] == pytest.approx(np.pi / 2)


def test_a_site_without_a_network_has_none():
    bare = Site("s", SITE.area)
    assert find_street_names(bare, LOW, HIGH) == []
    assert find_lane_arrows(bare, LOW, HIGH).shape == (0, 3)
