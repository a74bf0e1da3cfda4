"""Lanes that lead to a junction, by the names of where they come from."""

import numpy as np
import pytest
import shapely

from placement_env.analysis.approaches import Approaches, compass, find_approaches, find_streets
from toolkit.geometry import pose
from toolkit.sites.files import load_site
from toolkit.sites.site import Site


def at(places, x, y):
    box = np.array([[x, y, 0.7, 4.0, 2.0, 1.5, 0.0]])
    return places.names[places.locate(box)[0]]


def test_the_t_junction_has_three_approaches():
    places = find_approaches(load_site("tjunction"))
    assert places.names == (
        "from the east",
        "from the north",
        "from the south",
        "leaving the junction",
        "inside the junction",
        "parked",
    )
    # +y of the site lies west on its map, and -x south. Footways lie at y = 7.3 and 19.9.
    for name, x, y in (
        *(("from the south", -30.0, 11.6), ("from the north", 30.0, 15.6)),
        *(("from the east", 1.2, -15.0), ("leaving the junction", -30.0, 15.6)),
    ):
        assert at(places, x, y) == name
        assert places.lanes[places.names.index(name)].distance(shapely.Point(x, y)) < 0.5
    assert at(places, -30.0, 7.3) == "from the south"
    assert at(places, 0.0, 13.0) == "inside the junction"
    x, y, _ = load_site("tjunction").parking[0]
    assert at(places, x + 0.5, y) == "parked"


def test_a_roundabout_has_four_approaches():
    places = find_approaches(load_site("roundabout"))
    names = [name for name in places.names if name.startswith("from")]
    assert names == ["from the east", "from the north", "from the south", "from the west"]
    assert at(places, 35.0, 11.5) == "from the east"
    assert at(places, 60.0, 11.5) == "from the east"  # before the crossing
    assert at(places, 35.0, -11.5) == "leaving the junction"
    assert at(places, 24.0, 0.0) == "inside the junction"


def test_a_site_without_a_network_is_all_junction():
    places = find_approaches(Site("bare", np.array([-10.0, -10.0, 10.0, 10.0])))
    assert places.names == ("inside the junction", "parked")
    assert places.locate(np.zeros((2, 7))).tolist() == [0, 0]
    assert places.locate(np.zeros((0, 7))).tolist() == []


def test_compass_points_follow_the_map():
    turned = Site("a", np.array([-1.0, -1, 1, 1]), map_SE3_site=pose(yaw=np.pi / 2))
    assert compass(turned, np.array([0.0, 1.0])) == "west"
    assert compass(turned, np.array([1.0, 0.0])) == "north"


@pytest.mark.parametrize(
    ("offset", "name"),
    [((0, 1), "north"), ((1, 0), "east"), ((1, -1), "south-east"), ((-1, 0.1), "west")],
)
def test_compass_of_a_site_that_lies_as_its_map(offset, name):
    assert compass(Site("a", np.array([-1.0, -1, 1, 1])), np.array(offset, float)) == name


def network(*edges, area=(-90.0, -90.0, 90.0, 90.0), more="", **nodes):
    """A site whose edges, named by their ends, run through nodes, straight from each to the next.
    more: of the file."""
    rows = []
    for path in edges:
        shape = " ".join(f"{nodes[node][0]},{nodes[node][1]}" for node in path)
        rows.append(
            f'<edge id="{path}" from="{path[0]}" to="{path[-1]}"><lane id="{path}_0" '
            f'shape="{shape}"/></edge>'
        )
    return Site("drawn", np.array(area), network=f"<net>{''.join(rows)}{more}</net>")


def test_streets_that_only_lead_away_make_a_junction_too():
    places = find_approaches(network("AJ", "JB", "JC", A=(-50, 0), J=(0, 0), B=(50, 0), C=(0, 50)))
    assert places.names == ("from the west", "leaving the junction", "parked")
    assert Approaches(("parked",), (), np.zeros((0, 3))).locate(np.zeros((2, 7))).tolist() == [0, 0]


def test_an_approach_reaches_back_to_the_junction_before_and_no_further():
    far = {
        "X": (-40, 60),
        "K": (-40, 0),
        "M": (-20, 0),
        "J": (0, 0),
        "Y": (-60, 0),
        "P": (20, 0),
        "Q": (0, 20),
    }
    places = find_approaches(network("XK", "KM", "MJ", "KY", "JP", "JQ", **far))
    assert at(places, -30.0, 0.0) == at(places, -10.0, 0.0) == "from the west to junction 1"
    assert at(places, -40.0, 30.0) == "from the north to junction 2"


def test_headings_are_from_the_far_end_of_bent_approaches_of_several_edges():
    """From B the road runs east, then north to the junction: B lies to its south-west, the bend to
    its south."""
    nodes = {
        "A": (-60, -60),
        "B": (-60, -40),
        "C": (-20, -40),
        "D": (0, -40),
        "J": (0, 0),
        "P": (20, 0),
        "Q": (0, 20),
    }
    places = find_approaches(network("AB", "BC", "CDJ", "JP", "JQ", **nodes))
    assert places.names == ("from the south-west", "leaving the junction", "parked")
    assert at(places, -60.0, -50.0) == at(places, 0.0, -20.0) == "from the south-west"


def test_an_approach_ends_where_several_edges_come_from_before_and_never_turns_back():
    nodes = {"K": (-40, 0), "L": (-40, 5), "M": (-20, 0), "J": (0, 0), "P": (20, 0), "Q": (0, 20)}
    twice = '<edge id="again" from="K" to="M"><lane id="again_0" shape="-40,9 -20,9"/></edge>'
    places = find_approaches(network("KM", "MJ", "JP", "JQ", more=twice, **nodes))
    assert at(places, -10.0, 0.0) == "from the west"
    assert at(places, -30.0, 0.0) == at(places, -30.0, 9.0) == "leaving the junction"
    both_ways = find_approaches(network("LM", "ML", "MJ", "JM", "JP", "PJ", "JQ", **nodes))
    assert both_ways.names == ("from the east", "from the west", "leaving the junction", "parked")
    assert at(both_ways, -30.0, 2.5) == "from the west"


def test_places_are_named_after_their_streets_and_lanes_of_one_point_are_none():
    roads = (
        '<edge id="1" from="A" to="J" name="Elm Road"><lane id="1_0" shape="-50,0 0,0"/></edge>'
        '<edge id="2" from="B" to="J"><lane id="2_0" shape="0,50"/></edge>'
        '<edge id="3" from="C" to="J"><lane id="3_0" shape="50,0 0,0" allow="pedestrian"/></edge>'
        '<edge id="4" from="J" to="D"><lane id="4_0" shape="0,0 0,-50"/></edge>'
        '<edge id="5" from="J" to="E"><lane id="5_0" shape="0,0 40,-40"/></edge>'
        '<edge id=":J" function="internal"><lane id=":J_0" shape="0,0 1,1"/></edge>'
    )
    places = find_approaches(network(more=roads))
    assert places.names == (
        "Elm Road, from the west",
        "leaving the junction",
        "inside the junction",
        "parked",
    )
    assert at(places, 1.0, 1.0) == "inside the junction"


def test_junctions_are_named_by_their_places_in_the_area():
    """The nodes of the roundabout lie 20 m from the middle, (100, 0), and the crossing 50 m. Two
    roads make the first a junction, three the second."""
    nodes = {
        "R": (80, 0),
        "S": (120, 0),
        "T": (100, 20),
        "U": (100, -20),
        "J": (150, 0),
        "V": (150, 40),
        "W": (190, 0),
    }
    ring = '<roundabout nodes="R S T U" edges="RT TS"/>' + "".join(
        f'<junction id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in nodes.items()
    )
    roads = "RT", "TS", "JS", "SJ", "VJ", "JW"
    places = find_approaches(network(*roads, area=(50.0, -50.0, 150.0, 50.0), more=ring, **nodes))
    assert places.names == (
        *("from the east to the middle junction", "from the north to the east junction"),
        "from the west to the east junction",
        *("leaving the junction", "inside the junction", "parked"),
    )
    assert at(places, 90.0, 10.0) == "inside the junction"  # in the ring
    assert at(places, 170.0, 0.0) == "leaving the junction"
    # one without a place is taken to lie at 0, 0
    bare = ring.replace('x="150" y="0"', "")
    far = find_approaches(network(*roads, area=(-60.0, -50.0, 60.0, 50.0), more=bare, **nodes))
    assert far.names[:3] == (
        "from the east to the east junction",
        "from the north to the middle junction",
        "from the west to the middle junction",
    )
    near = find_approaches(network(*roads, area=(-50.0, -50.0, 249.0, 50.0), more=bare, **nodes))
    assert near.names[0] == "from the east to the middle junction"


@pytest.mark.parametrize("bare", ['x="0"', 'y="0"', ""])
def test_a_junction_without_a_coordinate_lies_at_nought_there(bare):
    """In the middle of the area, so it is the first of two; at 1 m along any axis it would be the
    second."""
    nodes = {"J": (0, 0), "K": (0.5, 0.5), "A": (-40, 0), "B": (40, 0), "C": (0, -40), "D": (0, 40)}
    more = f'<junction id="J" {bare}/><junction id="K" x="0.5" y="0.5"/>'
    places = find_approaches(network("AJ", "JB", "JC", "DK", "KB", "KC", more=more, **nodes))
    assert places.names[:2] == (
        "from the north to the middle junction 2",
        "from the west to the middle junction 1",
    )


def test_a_vehicle_is_parked_within_a_metre_and_a_half_of_a_bay():
    lane = shapely.LineString([(0, 0), (10, 0)])
    places = Approaches(("lane", "parked"), (lane,), np.array([[5.0, 0.0, 0.3], [5.0, 40.0, 0.0]]))
    assert [at(places, x, y) for x, y in ((6.5, 0), (6.6, 0), (5, 41.5), (5, 30))] == [
        "parked",
        "lane",
    ] * 2


def test_streets_of_the_area_are_named_by_their_side_of_its_middle():
    """The area's middle is (100, 0); what lies outside is left out."""
    roads = (
        '<edge id="1" from="A" to="J" name="Elm Road"><lane id="1_0" shape="20,0 99,0"/></edge>'
        '<edge id="2" from="J" to="A" name="Elm Road"><lane id="2_0" shape="101,0 180,0"/></edge>'
        '<edge id="3" from="J" to="C"><lane id="3_0" shape="100,2 100,90"/></edge>'
        '<edge id="4" from="B" to="J" name="Far Road"><lane id="4_0" shape="0,60 200,60"/></edge>'
        '<edge id=":J" function="internal" name="x"><lane id=":J_0" shape="99,0 101,0"/></edge>'
    )
    places = find_streets(network(more=roads, area=(50.0, -50.0, 150.0, 50.0)))
    assert places.names == (
        *(
            "Elm Road in the east",
            "Elm Road in the west",
            "the junction",
            "the road in the north",
            "parked",
        ),
    )
    assert [at(places, x, y) for x, y in ((140, 1), (60, 1), (100, 0), (101, 30))] == list(
        places.names[:4]
    )
    assert [lane.length for lane in places.lanes] == [49.0, 49.0, 2.0, 48.0]
    assert places.locate(np.zeros((1, 7))).tolist() == [1]
    nothing = find_streets(Site("bare", np.array([-10.0, -10.0, 10.0, 10.0])))
    assert (nothing.names, nothing.lanes[0].area) == (("the junction", "parked"), 400.0)
