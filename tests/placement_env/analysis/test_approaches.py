"""Lanes that lead to a junction, by the names of where they come from."""

import numpy as np
import pytest
import shapely

from placement_env.analysis.approaches import compass, find_approaches
from toolkit.geometry import pose
from toolkit.sites.files import load_site
from toolkit.sites.site import Site


def at(places, x, y):
    box = np.array([[x, y, 0.7, 4.0, 2.0, 1.5, 0.0]])
    return places.names[places.locate(box)[0]]


def test_approaches_of_junctions_with_or_without_a_network():
    places = find_approaches(load_site("tjunction"))
    assert places.names == ("from the east", "from the north", "from the south", "leaving", "junction", "parked")
    # +y of the site lies west on its map, and -x south. Footways lie at y = 7.3 and 19.9.
    for name, x, y in (
        *(("from the south", -30.0, 11.6), ("from the north", 30.0, 15.6)),
        *(("from the east", 1.2, -15.0), ("leaving", -30.0, 15.6)),
    ):
        assert at(places, x, y) == name
        assert places.lanes[places.names.index(name)].distance(shapely.Point(x, y)) < 0.5
    assert at(places, -30.0, 7.3) == "from the south"
    assert at(places, 0.0, 13.0) == "junction"
    x, y, _ = load_site("tjunction").parking[0]
    assert at(places, x + 0.5, y) == "parked"
    places = find_approaches(load_site("roundabout"))
    names = [name for name in places.names if name.startswith("from")]
    assert names == ["from the east", "from the north", "from the south", "from the west"]
    assert at(places, 35.0, 11.5) == "from the east"
    assert at(places, 60.0, 11.5) == "from the east"  # before the crossing
    assert at(places, 35.0, -11.5) == "leaving"
    assert at(places, 24.0, 0.0) == "junction"
    places = find_approaches(Site("bare", np.array([-10.0, -10.0, 10.0, 10.0])))
    assert places.names == ("junction", "parked")
    assert places.locate(np.zeros((2, 7))).tolist() == [0, 0]
    assert places.locate(np.zeros((0, 7))).tolist() == []
    turned = Site("a", np.array([-1.0, -1, 1, 1]), map_SE3_site=pose(yaw=np.pi / 2))
    assert compass(turned, np.array([0.0, 1.0])) == "west"
    assert compass(turned, np.array([1.0, 0.0])) == "north"


@pytest.mark.parametrize(
    ("offset", "name"), [((0, 1), "north"), ((1, 0), "east"), ((1, -1), "south-east"), ((-1, 0.1), "west")]
)
def test_compass_of_a_site_that_lies_as_its_map(offset, name):
    assert compass(Site("a", np.array([-1.0, -1, 1, 1])), np.array(offset, float)) == name
