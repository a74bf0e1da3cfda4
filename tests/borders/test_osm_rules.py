"""Traffic rules of OpenStreetMap's roads: who drives where, which way, how fast, on which side.

Keys and values as the OpenStreetMap wiki defines them (Key:access, Key:maxspeed, Key:oneway,
Key:barrier, Relation:restriction, Key:driving_side)."""

import re
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from toolkit.bodies.fleet import catalogue
from toolkit.objects import HEAVY, VEHICLE
from toolkit.sites import network as nets
from toolkit.sites.driving_side import find_driving_side
from toolkit.sites.georeference import inverse_project
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.osm import road_rules
from toolkit.sites.osm.road_rules import is_barred, parse_speed, read_rules
from toolkit.traffic.snapshots import simulate

CENTRE = (8.0, 49.5)
LONDON = (-0.1276, 51.5072)
MOTOR = {"passenger", "taxi", "bus", "coach", "delivery", "truck", "motorcycle", "moped"}


def allowed(side: int = 0, highway: str = "residential", **tags: str) -> set[str]:
    named = {key.replace("__", ":"): value for key, value in tags.items()}
    return set(read_rules({"highway": highway, **named}).rules.users[side]) - {"emergency"}


@pytest.mark.parametrize(
    ("tags", "users"),
    [
        ({}, MOTOR | {"bicycle"}),
        ({"motor_vehicle": "no"}, {"bicycle"}),
        ({"access": "no"}, set()),
        ({"access": "private"}, set()),
        ({"access": "no", "bus": "yes"}, {"bus"}),
        ({"access": "no", "psv": "yes"}, {"bus", "taxi"}),
        ({"vehicle": "no"}, set()),
        ({"vehicle": "no", "bicycle": "yes"}, {"bicycle"}),
        ({"motorcar": "no"}, MOTOR - {"passenger", "taxi"} | {"bicycle"}),
        (
            {"motorcar": "no", "motorcycle": "no", "hgv": "no"},
            {"bus", "coach", "delivery", "moped", "bicycle"},
        ),
        ({"hgv": "no"}, MOTOR - {"truck"} | {"bicycle"}),
        ({"bicycle": "use_sidepath"}, MOTOR),
        ({"motor_vehicle": "delivery"}, {"delivery", "truck", "bicycle"}),
        ({"motor_vehicle": "agricultural;forestry"}, {"bicycle"}),
        ({"motor_vehicle": "destination"}, MOTOR | {"bicycle"}),
        ({"access": "no", "motor_vehicle": "destination"}, MOTOR),
        ({"Motor_Vehicle": "No "}, {"bicycle"}),
        ({"construction": "yes", "motor_vehicle": "yes"}, set()),
        ({"access": "yes;no"}, MOTOR | {"bicycle"}),
        ({"highway": "motorway"}, MOTOR - {"moped"}),
        ({"highway": "motorway", "access": "yes"}, MOTOR - {"moped"}),
        ({"highway": "busway"}, {"bus"}),
        ({"highway": "busway", "bicycle": "yes"}, {"bus", "bicycle"}),
        ({"highway": "cycleway"}, {"bicycle"}),
        ({"highway": "cycleway", "motor_vehicle": "yes"}, MOTOR | {"bicycle"}),
        ({"motorroad": "yes", "highway": "trunk"}, MOTOR - {"moped"}),
        ({"maxweight": "3.5"}, MOTOR - {"truck", "bus", "coach"} | {"bicycle"}),
        ({"maxheight": "2.1 m"}, MOTOR - {"truck", "bus", "coach"} | {"bicycle"}),
    ],
)
def test_access_goes_from_the_general_to_the_particular(tags, users):
    assert allowed(**tags) == users


def test_a_way_that_nobody_may_use_is_left_to_emergency_vehicles():
    assert read_rules({"highway": "cycleway", "access": "no"}).rules.users[0] == {"emergency"}


def test_each_direction_has_rules_of_its_own():
    tags = {"motor_vehicle__backward": "no", "maxspeed": "50", "maxspeed__backward": "30"}
    assert allowed(0, **tags) == MOTOR | {"bicycle"}
    assert allowed(1, **tags) == {"bicycle"}
    reading = read_rules({"highway": "residential", "maxspeed": "50", "maxspeed:backward": "30"})
    assert reading.rules.speeds == pytest.approx((50 / 3.6, 30 / 3.6))
    assert reading.rules.sides_differ
    against = read_rules({"highway": "residential", "oneway": "-1", "maxspeed:backward": "20"})
    assert against.oneway == "-1"
    assert against.rules.speeds[0] == pytest.approx(20 / 3.6)


@pytest.mark.parametrize(
    ("tags", "oneway"),
    [
        ({"oneway": "yes"}, "yes"),
        ({"oneway": "1"}, "yes"),
        ({"oneway": "-1"}, "-1"),
        ({"oneway": "reverse"}, "-1"),
        ({"oneway": "reversible"}, "no"),
        ({"oneway": "alternating"}, "no"),
        ({"junction": "roundabout"}, "yes"),
        ({"junction": "roundabout", "oneway": "no"}, "no"),
        ({"highway": "motorway"}, "yes"),
        ({"oneway:motor_vehicle": "yes"}, "yes"),
        ({"oneway:bicycle": "yes"}, "no"),
    ],
)
def test_oneway(tags, oneway):
    assert read_rules({"highway": "residential", **tags}).oneway == oneway


def test_a_lane_against_the_traffic_is_for_those_whom_the_map_names():
    """Such as a bus lane on the other side of a one-way street."""
    tags = {"oneway": "yes", "lanes": "2", "lanes:forward": "1", "lanes:backward": "1"}
    reading = read_rules({"highway": "secondary", **tags, "oneway:psv": "no"})
    assert reading.oneway == "no"
    assert reading.rules.users[0] == frozenset(nets.MOTOR.split())
    assert reading.rules.users[1] == {"bus", "taxi", "emergency"}
    assert road_rules.CONTRAFLOW_NOTE not in reading.notes
    assert read_rules({"highway": "secondary", **tags}).oneway == "yes"


@pytest.mark.parametrize(
    ("text", "km_h"),
    [
        ("50", 50),
        ("30.5", 30.5),
        ("50 km/h", 50),
        ("30 mph", 48.28032),
        ("30mph", 48.28032),
        ("10 knots", 18.52),
        ("50;30", 30),
        ("none", 130),
        ("walk", 7),
        ("DE:urban", 50),
        ("de:rural", 100),
        ("FR:rural", 80),
        ("BY:urban", 60),
        ("DE:zone:30", 30),
        ("DE:zone30", 30),
        ("FR:zone30", 30),
        ("DE:30", 30),
        ("GB:nsl_single", 60 * 1.609344),
        ("GB:20", 20 * 1.609344),
    ],
)
def test_speeds_in_all_units(text, km_h):
    assert parse_speed(text) == pytest.approx(km_h / 3.6, abs=1e-4)


@pytest.mark.parametrize(
    "text", ["fast", "0", "-5", "50 furlongs", "XX:urban", "DE:bergab", "", "5000", "50;fast"]
)
def test_speeds_that_are_none(text):
    assert parse_speed(text) is None


def test_a_source_or_zone_tells_the_limit_where_none_is_given():
    zone = {"highway": "residential", "source:maxspeed": "DE:urban"}
    assert read_rules(zone).rules.speeds[0] == pytest.approx(50 / 3.6)
    assert read_rules({**zone, "maxspeed": "30"}).rules.speeds[0] == pytest.approx(30 / 3.6)
    assert read_rules({**zone, "source:maxspeed": "sign"}) == read_rules({"highway": "residential"})


@pytest.mark.parametrize(
    ("tags", "note"),
    [
        ({"motor_vehicle": "destination"}, road_rules.LOCAL_NOTE),
        ({"motor_vehicle:conditional": "no @ (22:00-06:00)"}, road_rules.HOURS_NOTE),
        ({"maxspeed:conditional": "30 @ (22:00-06:00)"}, road_rules.HOURS_NOTE),
        ({"bus:lanes": "yes|designated"}, road_rules.OWN_LANES_NOTE),
        ({"lanes:psv": "1"}, road_rules.OWN_LANES_NOTE),
        ({"busway:right": "lane"}, road_rules.OWN_LANES_NOTE),
        ({"cycleway:right": "lane"}, road_rules.OWN_LANES_NOTE),
        ({"hov": "designated"}, road_rules.OWN_LANES_NOTE),
        ({"turn:lanes": "left|through"}, road_rules.ARROWS_NOTE),
        ({"oneway": "yes", "oneway:bicycle": "no"}, road_rules.CONTRAFLOW_NOTE),
        ({"oneway": "yes", "cycleway": "opposite"}, road_rules.CONTRAFLOW_NOTE),
        ({"oneway": "yes", "oneway:psv": "no"}, road_rules.CONTRAFLOW_NOTE),
        ({"oneway": "T"}, road_rules.DIRECTION_NOTE),
        ({"oneway": "reversible"}, road_rules.EITHER_NOTE),
        ({"access": "sometimes"}, road_rules.UNREAD_NOTE),
        ({"maxspeed": "fast"}, road_rules.UNREAD_SPEED_NOTE),
        ({"maxspeed": "70|100"}, road_rules.UNREAD_SPEED_NOTE),
        ({"maxspeed": "signals"}, road_rules.VARIABLE_NOTE),
        ({"maxspeed:hgv": "60"}, road_rules.SPEEDS_NOTE),
        ({"lanes": "2;3"}, road_rules.LANES_NOTE),
        ({"lanes:both_ways": "1"}, road_rules.MIDDLE_NOTE),
        ({"lanes": "1"}, road_rules.SINGLE_NOTE),
        ({"width": "3.5"}, road_rules.WIDTHS_UNUSED_NOTE),
        ({"incline": "10%"}, road_rules.SLOPES_NOTE),
        ({"maxweight": "3.5"}, road_rules.SIZES_NOTE),
        ({"bicycle_road": "yes"}, road_rules.CYCLE_ROAD_NOTE),
        ({"access": "no"}, road_rules.CLOSED_NOTE),
    ],
)
def test_what_is_not_used_is_said(tags, note):
    assert note in read_rules({"highway": "residential", **tags}).notes


def test_ordinary_tags_need_no_word():
    tags = {
        "maxspeed": "50",
        "lanes": "2",
        "surface": "asphalt",
        "lit": "yes",
        "cycleway": "no",
        "sidewalk": "both",
    }
    assert read_rules({"highway": "residential", **tags}).notes == ()


@pytest.mark.parametrize(
    ("tags", "barred"),
    [
        ({"barrier": "bollard"}, True),
        ({"barrier": "bollard", "motor_vehicle": "yes"}, False),
        ({"barrier": "gate"}, False),
        ({"barrier": "gate", "access": "private"}, True),
        ({"barrier": "gate", "locked": "yes"}, True),
        ({"barrier": "block"}, True),
        ({"barrier": "lift_gate", "motor_vehicle": "no"}, True),
        ({"barrier": "cattle_grid"}, False),
        ({"barrier": "sump_buster"}, True),
        ({"motor_vehicle": "no"}, True),
        ({"highway": "crossing", "motor_vehicle": "no"}, False),
        ({"highway": "traffic_signals"}, False),
    ],
)
def test_barriers(tags, barred):
    assert is_barred(tags) is barred


def write_map(folder: Path, *ways, nodes=None, relations: str = "", centre=CENTRE) -> Path:
    """A main road along x and a side street along y, 400 m each, that cross at the centre (node
    1)."""
    spots = {
        1: (0, 0),
        2: (-200, 0),
        3: (200, 0),
        4: (0, 200),
        5: (0, -200),
        6: (0, 20),
        7: (0, -20),
    }
    text = ['<osm version="0.6">']
    for number, xy in spots.items():
        ((longitude, latitude),) = inverse_project(np.array([xy], float), centre)
        tags = "".join(
            f'<tag k="{k}" v="{v}"/>' for k, v in ((nodes or {}).get(number) or {}).items()
        )
        text.append(f'<node id="{number}" lat="{latitude:.8f}" lon="{longitude:.8f}">{tags}</node>')
    for number, (references, tags) in enumerate(ways, start=1):
        inside = "".join(f'<nd ref="{k}"/>' for k in references)
        inside += "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())
        text.append(f'<way id="{number}">{inside}</way>')
    path = folder / "town.osm"
    path.write_text("\n".join([*text, relations, "</osm>"]), "utf-8")
    return path


MAIN = ((2, 1, 3), {"highway": "secondary"})


def side_street(**tags: str):
    return (4, 6, 1, 7, 5), {"highway": "residential", **tags}


def read_site(path: Path, centre=CENTRE, **options):
    """Site and the texts of its notes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        site = import_osm(MapPiece(path, centre, (80, 80)), **options)
    return site, [str(each.message) for each in caught]


def list_cars(site, frames: int = 8):
    rows = []
    for snapshot in simulate(site, catalogue(), frames=frames, seed=1):
        is_car = np.isin(snapshot.objects.labels, [VEHICLE, HEAVY])
        rows.append(snapshot.objects.boxes[is_car])
    return np.concatenate(rows)


def test_no_car_drives_where_motor_vehicles_may_not(tmp_path: Path):
    site, notes = read_site(write_map(tmp_path, MAIN, side_street(motor_vehicle="no")))
    boxes = list_cars(site)
    assert len(boxes) > 20
    assert not (np.abs(boxes[:, 1]) > 10).any()
    assert any("roads closed to cars, as the map says: 1" in note for note in notes)


def edges_of(site) -> dict[str, list[ElementTree.Element]]:
    """Vehicle lanes of each edge in the network."""
    edges: dict[str, list[ElementTree.Element]] = {}
    for edge, lane in nets.list_lanes(site.network):
        if nets.list_users(lane) - {"pedestrian"}:
            edges.setdefault(str(edge.get("id")), []).append(lane)
    return edges


def heading(lane: ElementTree.Element) -> tuple[int, int]:
    x, y = np.sign(np.diff(nets.parse_shape(lane)[[0, -1]], axis=0)[0].round()).astype(int)
    return int(x), int(y)


def test_directions_have_their_users_and_limits(tmp_path: Path):
    tags = {"motor_vehicle:backward": "no", "maxspeed": "20 mph", "maxspeed:backward": "DE:urban"}
    site, _ = read_site(write_map(tmp_path, MAIN, side_street(**tags)))
    lanes = [lane for some in edges_of(site).values() for lane in some]
    south = [lane for lane in lanes if heading(lane) == (0, -1)]  # the way runs from north to south
    north = [lane for lane in lanes if heading(lane) == (0, 1)]
    assert south
    assert north
    for lane in south:
        assert "passenger" in nets.list_users(lane)
        assert float(lane.get("speed", 0)) == pytest.approx(20 * 0.44704, abs=0.01)
    for lane in north:
        assert nets.list_users(lane) == {"bicycle", "emergency"}
        assert float(lane.get("speed", 0)) == pytest.approx(50 / 3.6, abs=0.01)
    assert {round(float(lane.get("speed", 0)), 1) for lane in lanes if heading(lane)[0]} == {13.9}


def connections(site) -> set[tuple[str, str]]:
    root = ElementTree.fromstring(site.network)
    pairs = {(str(each.get("from")), str(each.get("to"))) for each in root.iter("connection")}
    return {pair for pair in pairs if ":" not in "".join(pair)}


def test_turns_that_the_map_forbids_are_not_made(tmp_path: Path):
    ways = [((2, 1), {"highway": "secondary"}), ((1, 3), {"highway": "secondary"})]
    ways += [((4, 1), {"highway": "residential"}), ((1, 5), {"highway": "residential"})]
    free, _ = read_site(write_map(tmp_path, *ways))
    free_turns = {target for origin, target in connections(free) if origin == "1"}
    assert len(free_turns) == 3
    rule = relation(4, "restriction", "no_right_turn")
    forbidden, notes = read_site(write_map(tmp_path, *ways, relations=rule))
    (lost,) = free_turns - {target for origin, target in connections(forbidden) if origin == "1"}
    assert lost == "4"
    assert not notes
    rule = relation(2, "restriction", "only_straight_on")
    only, _ = read_site(write_map(tmp_path, *ways, relations=rule))
    assert {target for origin, target in connections(only) if origin == "1"} == {"2"}
    rule = relation(4, "restriction:conditional", "no_right_turn @ (07:00-09:00)")
    assert "restriction:conditional" in read_site(write_map(tmp_path, *ways, relations=rule))[1][0]
    rule = relation(4, "restriction", "no_right_turn").replace(
        'type="node" ref="1"', 'type="way" ref="3"'
    )
    assert "lead over ways" in read_site(write_map(tmp_path, *ways, relations=rule))[1][0]


def relation(target: int, key: str, value: str) -> str:
    members = "".join(
        f'<member type="{kind}" ref="{ref}" role="{role}"/>'
        for kind, ref, role in (("way", 1, "from"), ("node", 1, "via"), ("way", target, "to"))
    )
    return (
        f'<relation id="1">{members}<tag k="type" v="restriction"/><tag k="{key}" '
        f'v="{value}"/></relation>'
    )


def test_a_bollard_parts_a_street(tmp_path: Path):
    site, notes = read_site(
        write_map(tmp_path, MAIN, side_street(), nodes={6: {"barrier": "bollard"}})
    )
    lanes = [lane for some in edges_of(site).values() for lane in some if heading(lane)[1]]
    ends = [nets.parse_shape(lane)[:, 1] for lane in lanes]
    assert not any(
        y.min() < 19.5 and y.max() > 20.5 for y in ends
    )  # none passes the bollard at y = 20
    assert any("barriers on roads that cars cannot pass" in note for note in notes)
    open_street, notes = read_site(
        write_map(tmp_path, MAIN, side_street(), nodes={6: {"barrier": "lift_gate"}})
    )
    ends = [
        nets.parse_shape(lane)[:, 1] for some in edges_of(open_street).values() for lane in some
    ]
    assert any(y.min() < 19.5 and y.max() > 20.5 for y in ends)
    assert not notes


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("centre", "tags", "options", "is_left"),
    [
        (CENTRE, {}, {}, False),
        (LONDON, {}, {}, True),
        (LONDON, {}, {"lefthand": False}, False),
        (CENTRE, {}, {"lefthand": True}, True),
        (CENTRE, {"driving_side": "left"}, {}, True),
    ],
    ids=["Germany", "Britain", "asked right", "asked left", "tagged left"],
)
def test_traffic_keeps_the_side_of_the_place(tmp_path: Path, centre, tags, options, is_left):
    road = ((2, 1, 3), {"highway": "secondary", **tags})
    site, notes = read_site(write_map(tmp_path, road, centre=centre), centre, **options)
    boxes = list_cars(site, frames=4)
    moving = boxes[(np.abs(boxes[:, 1]) < 3.5)]
    assert len(moving) > 10
    is_west = np.cos(moving[:, 6]) < 0
    assert (
        (is_west == (moving[:, 1] < 0)).all() if is_left else (is_west == (moving[:, 1] > 0)).all()
    )
    assert any("keeps left" in note for note in notes) == (is_left and not options)


PLACES = {
    "left": (
        *(
            (-0.1, 51.5),
            (-6.3, 53.3),
            (139.7, 35.7),
            (151.2, -33.9),
            (72.9, 19.1),
            (100.5, 13.75),
            (114.17, 22.3),
        ),
        *(
            (36.8, -1.3),
            (18.4, -33.9),
            (28.3, -15.4),
            (14.5, 35.9),
            (33.4, 35.2),
            (-76.8, 18.0),
            (-55.2, 5.85),
        ),
        *(
            (178.4, -18.1),
            (-171.8, -13.8),
            (1.31, 51.12),
            (102.75, 17.87),
            (71.5, 34.0),
            (174.8, -36.9),
        ),
    ),
    "right": (
        *(
            (13.4, 52.5),
            (1.85, 50.95),
            (-74.0, 40.7),
            (69.2, 34.5),
            (96.2, 16.8),
            (102.6, 17.97),
            (114.06, 22.55),
        ),
        *(
            (38.7, 9.0),
            (30.06, -1.95),
            (13.2, -8.8),
            (47.5, -18.9),
            (121.0, 14.6),
            (127.0, 37.5),
            (-66.1, 18.46),
        ),
        *(
            (-61.05, 14.6),
            (-52.3, 4.9),
            (-5.35, 36.14),
            (-170.7, -14.3),
            (166.4, -22.3),
            (55.45, -20.9),
        ),
    ),
}


@pytest.mark.parametrize("side", PLACES)
def test_countries(side):
    for place in PLACES[side]:
        assert find_driving_side(*place).is_left == (side == "left"), place
    assert not find_driving_side(-0.1, 51.5).is_near_border
    assert find_driving_side(
        102.75, 17.87
    ).is_near_border  # on the Mekong between Thailand and Laos


def test_a_roundabout_that_runs_the_other_way_is_said(tmp_path: Path):
    # counter-clockwise
    ring = ((3, 4, 2, 5, 3), {"highway": "secondary", "junction": "roundabout"})
    _, notes = read_site(write_map(tmp_path, ring, MAIN), lefthand=True)
    assert any("roundabouts that run against" in note and "--righthand" in note for note in notes)
    _, notes = read_site(write_map(tmp_path, ring, MAIN))
    assert not any("roundabouts" in note for note in notes)


def test_what_is_no_road_here_is_named(tmp_path: Path):
    ways = [
        MAIN,
        ((6, 1), {"highway": "track"}),
        ((7, 1), {"highway": "service", "service": "driveway"}),
    ]
    ways += [
        ((6, 4), {"highway": "construction"}),
        ((7, 5), {"highway": "pedestrian", "bus": "yes"}),
    ]
    ways += [((2, 6), {"railway": "tram"})]
    nodes = {7: {"highway": "stop"}, 1: {"highway": "mini_roundabout"}}
    _, notes = read_site(write_map(tmp_path, *ways, nodes=nodes))
    text = "\n".join(notes)
    assert "no roads are made of: 1 track, 1 driveway" in text
    assert "pedestrian streets open to some vehicles" in text
    assert "stop and give-way signs, not used" in text
    assert "mini-roundabouts, driven as plain junctions: 1" in text
    assert "tracks of trams and trains, which do not run here: 1" in text


def test_a_map_across_the_antimeridian_is_whole(tmp_path: Path):
    """180 and -180 degrees are one meridian (RFC 7946, 3.1.9); Taveuni in Fiji lies on it."""
    centre = (179.9999, -16.8)
    site, notes = read_site(write_map(tmp_path, MAIN, side_street(), centre=centre), centre)
    assert any("traffic keeps left" in note for note in notes)
    assert not any("leap" in note for note in notes)
    lengths = [
        np.hypot(*np.diff(nets.parse_shape(lane), axis=0).T).sum()
        for _, lane in nets.list_lanes(site.network)
    ]
    assert 60 < max(lengths) < 150


def write_streets(path: Path, *ways, centre=CENTRE):
    """Write a map of ways: points (m) and tags. Equal points are one node."""
    points = list(dict.fromkeys(tuple(point) for line, _ in ways for point in line))
    degrees = inverse_project(np.array(points, np.float64), centre)
    text = "".join(
        f'<node id="{i + 1}" lon="{x:.9f}" lat="{y:.9f}"/>' for i, (x, y) in enumerate(degrees)
    )
    for i, (line, tags) in enumerate(ways, start=1):
        inside = "".join(f'<nd ref="{points.index(tuple(point)) + 1}"/>' for point in line)
        inside += "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
        text += f'<way id="{i}">{inside}</way>'
    path.write_text(f'<osm version="0.6">{text}</osm>', "utf-8")
    return path


EAST = [(-200, 0), (0, 0), (200, 0)]
NORTH = [(0, -200), (0, -50), (0, 50), (0, 200)]  # no node in common with EAST


def test_a_road_of_another_layer_is_no_junction(tmp_path: Path):
    """Key:layer: without a bridge or tunnel it is another storey too; at one layer, roads need a
    common node."""
    main = (EAST, {"highway": "secondary"})
    for tags, lanes in (({"layer": "-1"}, 2), ({"layer": "1"}, 2), ({"layer": "0"}, 4)):
        path = write_streets(
            tmp_path / "layers.osm", main, (NORTH, {"highway": "residential", **tags})
        )
        site, notes = read_site(path)
        assert len(edges_of(site)) == lanes
        text = (
            "tunnels or bridges over a road"
            if lanes == 2
            else "cross without a junction in the map, .*: 1"
        )
        assert any(re.search(text, note) for note in notes)
    site, notes = read_site(
        write_streets(tmp_path / "alone.osm", (NORTH, {"highway": "residential", "layer": "1"}))
    )
    assert len(edges_of(site)) == 2


def test_a_road_that_is_in_the_map_twice_is_one(tmp_path: Path):
    path = write_streets(
        tmp_path / "twice.osm",
        (EAST, {"highway": "secondary"}),
        (EAST[::-1], {"highway": "tertiary"}),
    )
    site, notes = read_site(path)
    assert len(edges_of(site)) == 2
    assert any("1 roads that are in the map twice were left out" in note for note in notes)


def test_lanes_of_each_direction_count_before_their_sum(tmp_path: Path):
    """Key:lanes: a middle lane for turning is no lane of one direction (valhalla/valhalla#6297)."""
    for tags, note in (
        (
            {"lanes": "3", "lanes:forward": "1", "lanes:backward": "1", "lanes:both_ways": "1"},
            road_rules.MIDDLE_NOTE,
        ),
        ({"lanes": "5", "lanes:forward": "1", "lanes:backward": "1"}, road_rules.SUM_NOTE),
    ):
        site, notes = read_site(
            write_streets(tmp_path / "lanes.osm", (EAST, {"highway": "secondary", **tags}))
        )
        assert [len(lanes) for lanes in edges_of(site).values()] == [1, 1]
        assert any(note in text for text in notes)
    assert (
        road_rules.SUM_NOTE
        not in read_rules({"highway": "primary", "lanes": "2", "lanes:forward": "1"}).notes
    )


def test_arcs_of_a_roundabout_run_one_way(tmp_path: Path):
    """Tag:junction=roundabout: also of several ways, each in the direction of traffic."""
    ring = [(15, 0), (0, -15), (-15, 0), (0, 15), (15, 0)]  # clockwise
    tags = {"highway": "secondary", "junction": "roundabout"}
    arms = [
        ([(-200, 0), (-15, 0)], {"highway": "secondary"}),
        ([(15, 0), (200, 0)], {"highway": "secondary"}),
    ]
    for turned, warned in ((ring, True), (ring[::-1], False)):
        path = write_streets(tmp_path / "arcs.osm", *arms, (turned[:3], tags), (turned[2:], tags))
        _, notes = read_site(path)
        assert (
            any(
                "roundabouts that run against traffic that keeps right: 1" in note for note in notes
            )
            == warned
        )


def test_limits_of_size_in_other_words():
    """Key:maxweightrating, Key:maxheight:physical, and limits of trucks only."""
    assert not allowed(maxweightrating="3.5") & {"truck", "bus"}
    assert not allowed(maxheight__physical="3.0") & {"truck", "bus"}
    assert allowed(maxweight__hgv="3.5") & {"truck", "bus"} == {"bus"}
    assert allowed(maxheight="11'9\"") >= {"truck"}  # 3.58 m
    assert (
        road_rules.UNREAD_NOTE
        in read_rules({"highway": "residential", "access": "designated"}).notes
    )  # osrm-backend#866


def test_the_antimeridian_is_no_border():
    assert find_driving_side(179.9999, -16.8) == (True, False)


def test_one_way_for_some_users_only():
    """`oneway:USER` holds for that user alone (Key:oneway)."""
    both = MOTOR | {"bicycle"}
    assert [allowed(side, oneway__bus="yes") for side in (0, 1)] == [both, both - {"bus"}]
    assert [allowed(side, oneway__psv="-1") for side in (0, 1)] == [both - {"bus", "taxi"}, both]
    assert [allowed(side, oneway__bicycle="yes") for side in (0, 1)] == [both, both - {"bicycle"}]
    assert allowed(1, oneway__psv="yes", oneway__bus="no") == both - {"taxi"}
    against = read_rules({"highway": "residential", "oneway": "yes", "oneway:bus": "-1"})
    assert against.rules.users[0] == frozenset(nets.MOTOR.split()) - {"bus"}
    assert road_rules.SOME_AGAINST_NOTE in against.notes
    assert (
        road_rules.DIRECTION_NOTE
        in read_rules({"highway": "residential", "oneway:bus": "peak"}).notes
    )
    assert (
        road_rules.CONTRAFLOW_NOTE
        in read_rules({"highway": "residential", "oneway:motor_vehicle": "yes"}).notes
    )
    assert not read_rules({"highway": "residential", "oneway": "yes", "oneway:bus": "yes"}).notes


@pytest.mark.parametrize(
    ("value", "note"), [("shared", True), ("designated", True), ("no", False), ("separate", False)]
)
def test_a_busway_of_another_value_is_said(value, note):
    reading = read_rules({"highway": "secondary", "busway:right": value})
    assert (road_rules.OWN_LANES_NOTE in reading.notes) == note


def test_hours_of_barriers_are_said(tmp_path: Path):
    """Key:barrier takes access as roads do, also for some hours (Conditional restrictions)."""
    gate = {"barrier": "lift_gate", "motor_vehicle:conditional": "no @ (20:00-06:00)"}
    _, notes = read_site(write_map(tmp_path, MAIN, side_street(), nodes={6: gate}))
    assert any(f"{road_rules.BARRIER_HOURS_NOTE}: 1" in note for note in notes)
    _, notes = read_site(
        write_map(tmp_path, MAIN, side_street(), nodes={6: {"barrier": "gate", "access": "key"}})
    )
    assert any(road_rules.BARRIER_UNREAD_NOTE in note for note in notes)


def test_older_keys_and_roads_for_emergencies():
    """access:USER (Key:access, older), maxspeed:both (Forward & backward),
    service=emergency_access."""
    assert allowed(access__motor_vehicle="no") == {"bicycle"}
    assert allowed(access="no", access__bus="yes") == {"bus"}
    assert allowed(access__hgv="no", hgv="yes") == MOTOR | {"bicycle"}
    assert is_barred({"barrier": "gate", "access:motor_vehicle": "no"})
    assert read_rules({"highway": "residential", "maxspeed:both": "20"}).rules.speeds[
        1
    ] == pytest.approx(20 / 3.6)
    assert allowed(highway="service", service="emergency_access") == set()
    assert allowed(highway="service", service="emergency_access", bicycle="yes", vehicle="no") == {
        "bicycle"
    }


def list_driven(site) -> list[tuple[int, float]]:
    """Direction along x, and y (m), of the lanes for cars."""
    lanes = [
        lane for some in edges_of(site).values() for lane in some if "bus" in nets.list_users(lane)
    ]
    return sorted(
        (heading(lane)[0], round(float(nets.parse_shape(lane)[0, 1]), 1)) for lane in lanes
    )


@pytest.mark.parametrize(("oneway", "direction"), [("yes", 1), ("-1", -1)])
def test_lanes_against_a_one_way_street_carry_no_cars(tmp_path: Path, oneway, direction):
    """lanes:backward runs against the line of the way (Key:lanes), so for oneway=-1 it is
    driven."""
    driven, against = ("backward", "forward") if oneway == "-1" else ("forward", "backward")
    tags = {
        "highway": "secondary",
        "oneway": oneway,
        f"lanes:{driven}": "2",
        f"lanes:{against}": "1",
    }
    path = tmp_path / "town.osm"
    write_streets(path, (((-80, 0), (80, 0)), {**tags, "lanes": "3"}))
    site, notes = read_site(path)
    assert [way for way, _ in list_driven(site)] == [direction] * 2
    assert any(road_rules.LANES_AGAINST_NOTE in note for note in notes)


@pytest.mark.parametrize(
    ("oneway", "tagged"), [("yes", "left"), ("-1", "left"), ("yes", "right"), ("-1", "right")]
)
def test_footways_are_on_their_side_of_the_way(tmp_path: Path, oneway, tagged):
    """Left and right are as the way is drawn, also where it runs against its line
    (Key:sidewalk)."""
    path = tmp_path / "town.osm"
    write_streets(
        path, (((-80, 0), (80, 0)), {"highway": "secondary", "oneway": oneway, "sidewalk": tagged})
    )
    site, _ = read_site(path)
    (driven,) = {y for _, y in list_driven(site)}
    walked = [
        lane for _, lane in nets.list_lanes(site.network) if nets.list_users(lane) == {"pedestrian"}
    ]
    assert walked
    for lane in walked:
        assert (nets.parse_shape(lane)[0, 1] > driven) == (tagged == "left")


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("tags", "sides"),
    [
        ({"sidewalk:both": "no"}, set()),
        ({"sidewalk:left": "no", "sidewalk:right": "no"}, set()),
        ({"sidewalk:left": "no"}, {"right"}),
        ({"sidewalk:left": "no", "oneway": "-1"}, {"right"}),
        ({"sidewalk:right": "none"}, {"left"}),
        ({}, {"left", "right"}),
    ],
)
def test_a_footway_that_the_map_denies_is_not_built(tmp_path: Path, tags, sides):
    """Key:sidewalk, tagged for each side."""
    path = tmp_path / "town.osm"
    write_streets(path, (((-80, 0), (80, 0)), {"highway": "secondary", **tags}))
    site, _ = read_site(path)
    middle = np.mean([y for _, y in list_driven(site)])
    walked = [
        lane for _, lane in nets.list_lanes(site.network) if nets.list_users(lane) == {"pedestrian"}
    ]
    assert {
        "left" if nets.parse_shape(lane)[0, 1] > middle else "right" for lane in walked
    } == sides


@pytest.mark.parametrize("tags", [{"location": "underground"}, {"indoor": "yes"}])
def test_a_road_under_ground_carries_no_cars_above(tmp_path: Path, tags):
    """Key:location and Key:indoor: such as the road of a garage without a tunnel tag."""
    garage = (((-80, 20), (80, 20)), {"highway": "service", **tags})
    path = tmp_path / "town.osm"
    write_streets(path, (((-80, 0), (80, 0)), {"highway": "secondary"}), garage)
    site, notes = read_site(path)
    assert max(y for _, y in list_driven(site)) < 5.0
    assert any("1 tunnels" in note for note in notes)


def test_a_road_drawn_along_one_of_its_lanes_is_said():
    """Key:placement."""
    tags = {"highway": "secondary", "oneway": "yes", "lanes": "2", "placement": "right_of:1"}
    assert road_rules.PLACEMENT_NOTE in read_rules(tags).notes
