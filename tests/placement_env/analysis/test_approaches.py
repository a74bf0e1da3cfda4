"""Lanes that lead to a junction, by the names of where they come from."""

import numpy as np
import pytest
import shapely

from placement_env.analysis.approaches import Approaches, compass, find_approaches
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


def network(*edges, **nodes):
    """A site whose edges, named by their ends, run straight between nodes."""
    rows = []
    for start, end in edges:
        shape = " ".join(f"{x},{y}" for x, y in (nodes[start], nodes[end]))
        rows.append(
            f'<edge id="{start}{end}" from="{start}" to="{end}"><lane id="{start}{end}_0" shape="{shape}"/></edge>'
        )
    return Site("drawn", np.array([-90.0, -90.0, 90.0, 90.0]), network=f"<net>{''.join(rows)}</net>")


def test_streets_that_only_lead_away_make_a_junction_too():
    places = find_approaches(network("AJ", "JB", "JC", A=(-50, 0), J=(0, 0), B=(50, 0), C=(0, 50)))
    assert places.names == ("from the west", "leaving", "parked")
    assert Approaches(("parked",), (), np.zeros((0, 3))).locate(np.zeros((2, 7))).tolist() == [0, 0]


def test_an_approach_reaches_back_to_the_junction_before_and_no_further():
    far = {"X": (-40, 60), "K": (-40, 0), "M": (-20, 0), "J": (0, 0), "Y": (-60, 0), "P": (20, 0), "Q": (0, 20)}
    places = find_approaches(network("XK", "KM", "MJ", "KY", "JP", "JQ", **far))
    assert at(places, -30.0, 0.0) == at(places, -10.0, 0.0) == "from the west to junction 1"
    assert at(places, -40.0, 30.0) == "from the north to junction 2"
