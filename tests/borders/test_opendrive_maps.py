"""What an OpenDRIVE map says of frames, sides, limits, users and heights, by the ASAM standard 1.4
to 1.8."""

import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyproj
import pytest
import shapely

from toolkit.bodies.fleet import catalogue
from toolkit.objects import HEAVY, VEHICLE
from toolkit.sites import network as nets
from toolkit.sites.georeference import bearing_deg, longitude_latitude, site_geojson
from toolkit.sites.maps.opendrive_site import import_opendrive
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.network import MOTOR
from toolkit.sites.opendrive.lane_rules import USERS
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import simulate

UTM32 = "<geoReference>+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs</geoReference>"
_CENTRE = '<center><lane id="0" type="none"/></center>'


def lane(
    number: int, kind: str = "driving", width: float = 3.5, inside: str = "", attributes: str = ""
) -> str:
    """A <lane> of constant width."""
    shape = f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>'
    return f'<lane id="{number}" type="{kind}" level="false" {attributes}>{inside}{shape}</lane>'


def section(left: str, right: str, s: float = 0.0, attributes: str = "") -> str:
    """A <laneSection>."""
    sides = (
        (f"<left>{left}</left>" if left else "")
        + _CENTRE
        + (f"<right>{right}</right>" if right else "")
    )
    return f'<laneSection s="{s}" {attributes}>{sides}</laneSection>'


def street(
    *,
    name: str = "1",
    start: tuple[float, float] = (-150.0, 0.0),
    heading: float = 0.0,
    length: float = 300.0,
    geometry: str = "<line/>",
    sections: str = "",
    inside: str = "",
    junction: str = "-1",
    attributes: str = "",
) -> str:
    """A <road> of one geometry, with a lane of 3.5 m on each side. inside: further elements of the
    road."""
    place = f's="0" x="{start[0]}" y="{start[1]}" hdg="{heading}" length="{length}"'
    lanes = sections or section(lane(1), lane(-1))
    return (
        f'<road name="" length="{length}" id="{name}" junction="{junction}" {attributes}>{inside}'
        f"<planView><geometry {place}>{geometry}</geometry></planView><lanes>{lanes}</lanes></road>"
    )


def rising(slope: float) -> str:
    """Elevation of a road that rises by `slope` (m per m) from 0 at its start."""
    return f'<elevationProfile><elevation s="0" a="0" b="{slope}" c="0" d="0"/></elevationProfile>'


def limited(*rows: tuple[float, str]) -> str:
    """<type>s of a road, whose limits begin at s; a row gives s and the attributes of <speed>."""
    return "".join(f'<type s="{s}" type="town"><speed {limit}/></type>' for s, limit in rows)


def write_map(path: Path, roads: str, header: str = "", minor: int = 6) -> Path:
    """Write a map of OpenDRIVE 1.`minor`."""
    text = f'<header revMajor="1" revMinor="{minor}">{header}</header>{roads}'
    path.write_text(f'<?xml version="1.0"?>\n<OpenDRIVE>{text}</OpenDRIVE>', encoding="utf-8")
    return path


def read_lanes(site: Site) -> list[tuple[set[str], float, np.ndarray]]:
    """Users, limit (m/s) and middle line, from where traffic enters, of all lanes of a site's
    network."""
    lanes = [element for _, element in nets.list_lanes(site.network)]
    return [(nets.list_users(e), float(e.get("speed", "0")), nets.parse_shape(e)) for e in lanes]


def find_lane(site: Site, y: float, x: float = 0.0) -> tuple[set[str], float, np.ndarray]:
    """Lane of a site whose middle line passes within 0.3 m of a place."""
    for users, limit, line in read_lanes(site):
        low, high = sorted((line[0, 0], line[-1, 0]))
        if (
            low - 0.1 <= x <= high + 0.1
            and abs(np.interp(x, *line[np.argsort(line[:, 0])].T) - y) < 0.3
        ):
            return users, limit, line
    raise AssertionError(f"no lane at {x:g}, {y:g}")


SIZE_M = (80.0, 40.0)
UTM_OFFSET = '<offset x="692000" y="5336000" z="0" hdg="{}"/>'
CARS = set(MOTOR.split())


@pytest.fixture
def imported(tmp_path: Path):
    """Function that imports a map of the roads it is given: the site, and the notes."""

    def read(roads, header="", minor=6, centre=(0.0, 0.0), size=SIZE_M, name="street.xodr"):
        path = write_map(tmp_path / name, roads, header, minor)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            site = import_opendrive(MapPiece(path, centre, size))
        return site, [str(warning.message).partition(": ")[2] for warning in caught]

    return read


# Frames: 1.8, 8.4 and 8.5


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("minor", "heading"), [(4, 0.0), (6, 0.5), (8, -np.pi / 2)])
def test_offset_of_the_header_leads_to_the_projection(imported, minor, heading):
    """A point is turned by hdg, then moved by x and y (1.8, 8.5). pyproj is the oracle."""
    site, _ = imported(street(), UTM32 + UTM_OFFSET.format(heading), minor)
    to_earth = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4326", always_xy=True)
    ahead = np.array([692000 + 100 * np.cos(heading), 5336000 + 100 * np.sin(heading)])
    expected = [to_earth.transform(692000, 5336000), to_earth.transform(*ahead)]
    np.testing.assert_allclose(
        longitude_latitude(site, np.array([[0.0, 0.0], [100.0, 0.0]])), expected, atol=1e-8
    )
    assert bearing_deg(site, 0.0) == pytest.approx(np.rad2deg(np.pi / 2 - heading) % 360)
    assert '"bbox": [11.58' in site_geojson(site).replace("11.57", "11.58")


def test_coordinates_of_a_projection_are_no_damage(imported):
    far, _ = imported(street(start=(691850.0, 5336000.0)), UTM32, centre=(692000.0, 5336000.0))
    near, _ = imported(street(), UTM32 + UTM_OFFSET.format(0))
    degrees = [longitude_latitude(site, np.array([[7.0, -3.0]])) for site in (far, near)]
    np.testing.assert_allclose(*degrees, atol=1e-9)
    assert shapely.equals_exact(
        *(shapely.MultiPolygon([shapely.Polygon(p) for p in s.lanes]) for s in (far, near))
    )
    lanes = zip(read_lanes(far), read_lanes(near), strict=True)
    assert all(np.abs(a[2] - b[2]).max() < 2e-3 for a, b in lanes)


def test_height_of_the_header_is_of_the_map(imported):
    site, _ = imported(
        street(inside=rising(0.0)), UTM32 + '<offset x="0" y="0" z="512.5" hdg="0"/>'
    )
    assert site.map_SE3_site[2, 3] == 512.5


@pytest.mark.parametrize(
    ("header", "remedy"),
    [
        (
            UTM32 + UTM_OFFSET.format(0),
            "these are coordinates of its projection, in the file it is --centre 0 0",
        ),
        (UTM32, "give --centre X Y inside it, as --centre 0 0"),
    ],
)
def test_a_centre_in_the_projection_is_told_its_place(imported, header, remedy):
    with pytest.raises(ValueError, match=f"centre 692000 5336000 lies outside the map, .*{remedy}"):
        imported(street(), header, centre=(692000.0, 5336000.0))


def test_a_centre_in_degrees_is_told_its_place(imported):
    near = r"these are degrees, in the file it is --centre (692000|691999\.99)\d* (5336000|5335999\.99)"
    with pytest.raises(ValueError, match=near):
        imported(street(start=(691850.0, 5336000.0)), UTM32, centre=(11.5813804, 48.1482452))


def test_a_missing_grid_of_shifts_leaves_metres(imported):
    """The map is in metres, whatever PROJ can say of its place."""
    reference = "+proj=utm +zone=32 +ellps=bessel +nadgrids=not_installed.gsb +units=m +no_defs"
    site, notes = imported(street(), f"<geoReference><![CDATA[{reference}]]></geoReference>")
    assert site.geo_reference is None
    assert any(
        "needs the grid 'not_installed.gsb': install it for PROJ and import again" in note
        for note in notes
    )
    assert len(read_lanes(site)) == 2


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("reference", "reason"),
    [
        ("+lat_0=4.9e+1 +lon_0=8", "names no projection"),
        ("EPSG:4326", "is in degrees"),
        ("EPSG:4978", "is a Geocentric CRS"),
        ("+proj=nosuch +units=m", "is no projection that PROJ knows"),
        ("EPSG:9999999", "is no projection that PROJ knows"),
    ],
)
def test_a_reference_that_leads_nowhere_is_noted(imported, reference, reason):
    site, notes = imported(street(), f"<geoReference>{reference}</geoReference>")
    assert site.geo_reference is None
    assert any(reason in note and "does not say where on earth" in note for note in notes)


FEET_UTM = "+proj=lcc +lat_0=36.5 +lon_0=-120.5 +lat_1=38.43 +lat_2=37.07 +x_0=2000000 +y_0=500000"
FEET_UTM += " +datum=NAD83 +units=us-ft +no_defs"


@pytest.mark.one_in(3)
@pytest.mark.parametrize("reference", [FEET_UTM, "EPSG:2048", "EPSG:2154"])
def test_degrees_next_to_the_origin_are_told_their_place(imported, reference):
    """Also on a map with an offset, whose coordinates are as small as degrees; in feet, or with
    axes west and south."""
    header = f'<geoReference>{reference}</geoReference><offset x="{{}}" y="{{}}" z="0" hdg="0"/>'
    header = header.format(*((-60000, -3700000) if "2048" in reference else (1830000, 640000)))
    site, _ = imported(street(start=(-150.0, 300.0)), header, centre=(0.0, 300.0))
    degrees = longitude_latitude(site, np.zeros((1, 2)))
    assert degrees is not None
    longitude, latitude = degrees[0].tolist()
    place = r"these are degrees, in the file it is --centre -?0(\.0\d)? (300|299\.9\d)"
    with pytest.raises(ValueError, match=place):
        imported(street(start=(-150.0, 300.0)), header, centre=(longitude, latitude))


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "reference", ["+init=epsg:25833", "proj=utm zone=33 ellps=GRS80", "ESRI:102092"]
)
def test_a_projection_under_any_name_of_proj_needs_no_word(imported, reference):
    header = (
        f'<geoReference>{reference}</geoReference><offset x="390000" y="5820000" z="0" hdg="0"/>'
    )
    site, notes = imported(street(inside=limited((0, 'max="50" unit="km/h"'))), header)
    assert site.geo_reference == reference
    assert not [note for note in notes if "stretches" not in note and "names no datum" not in note]


def test_odd_headers_are_noted(imported):
    two = "<geoReference>EPSG:25832</geoReference><geoReference>EPSG:25833</geoReference>"
    site, notes = imported(street(), two + '<offset x="692000" y="5336000" z="0" hdg="90"/>')
    assert site.geo_reference == "EPSG:25832"
    assert any("2 geoReferences that differ" in note for note in notes)
    assert any("hdg = 90 rad, more than a full turn" in note for note in notes)
    site, _ = imported(
        "<geoReference>EPSG:25832</geoReference>" + street(start=(691850, 5336000)),
        centre=(692e3, 5336e3),
    )
    assert site.geo_reference == "EPSG:25832"


def test_names_of_files_are_free(imported):
    site, _ = imported(street(), name="a,b 信号.xodr")
    assert site.name == "a,b 信号"


# Sides of the road: 1.8, 10.1 and 11.4


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("rule", "direction"), [("", 1), ('rule="RHT"', 1), ('rule="LHT"', -1)])
def test_traffic_keeps_to_the_side_of_the_map(imported, rule, direction):
    site, _ = imported(street(attributes=rule))
    for y, sign in ((-1.75, direction), (1.75, -direction)):
        _, _, line = find_lane(site, y)
        assert np.sign(line[-1, 0] - line[0, 0]) == sign
    assert ('lefthand="true"' in site.network) == (direction < 0)


def test_left_hand_traffic_keeps_lanes_and_links_apart(imported):
    """Two lanes on the left become one behind a section, and the sidewalk stays where it is."""
    on = '<link><successor id="1"/></link>'
    back = '<link><predecessor id="1"/></link>'
    first = section(lane(2) + lane(1, inside=on), lane(-1) + lane(-2, "sidewalk", 2.0))
    second = section(lane(1, inside=back), lane(-1) + lane(-2, "sidewalk", 2.0), s=150)
    site, _ = imported(street(sections=first + second, attributes='rule="LHT"'))
    assert find_lane(site, -4.5, -50)[0] == {"pedestrian"}
    for y, x, sign in ((5.25, -50, 1), (1.75, -50, 1), (1.75, 50, 1), (-1.75, 50, -1)):
        users, _, line = find_lane(site, y, x)
        assert users == CARS
        assert np.sign(line[-1, 0] - line[0, 0]) == sign
    root = ElementTree.fromstring(site.network)
    ahead = [
        c for c in root.iter("connection") if c.get("from") == "-1#0" and c.get("to") == "-1#1"
    ]
    assert [(c.get("fromLane"), c.get("toLane")) for c in ahead if c.get("fromLane") == "1"] == [
        ("1", "0")
    ]


def heads(site: Site, y: float, x: float = 0.0) -> float:
    """1 if traffic at a place runs towards +x, -1 if towards -x."""
    _, _, line = find_lane(site, y, x)
    return float(np.sign(line[-1, 0] - line[0, 0]))


def test_a_road_that_keeps_to_the_other_side_than_most(imported):
    other = street(name="2", start=(-150.0, 12.0), attributes='rule="LHT"')
    site, _ = imported(street() + street(name="3", start=(-150.0, -12.0)) + other)
    assert [heads(site, y) for y in (13.75, 10.25, 1.75, -1.75)] == [1, -1, -1, 1]
    assert 'lefthand="true"' not in site.network


AGAINST = 'direction="reversed"'


@pytest.mark.one_in(2)
@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_lanes_against_the_direction_of_their_side(imported, rule):
    """1.8, 11.4: standard, reversed and both."""
    right = lane(-1, attributes=AGAINST) + lane(-2) + lane(-3, "sidewalk", 2.0)
    lanes = section(lane(2, attributes=AGAINST) + lane(1), right)
    site, _ = imported(street(sections=lanes, attributes=f'rule="{rule}"'), minor=8)
    sign = 1 if rule == "RHT" else -1
    for y, direction in ((5.25, 1), (1.75, -1), (-1.75, -1), (-5.25, 1)):
        lines = [
            line
            for users, _, line in read_lanes(site)
            if users == CARS and abs(line[:, 1] - y).max() < 0.1
        ]
        assert [np.sign(line[-1, 0] - line[0, 0]) for line in lines] == [direction * sign], y
    assert find_lane(site, -8.0)[0] == {"pedestrian"}


def test_a_lane_between_reversed_ones_goes_its_way(imported):
    """Lane -2 of three runs on into the next road, the two around it come back."""
    on, back = '<link><successor id="{0}"/></link>', '<link><predecessor id="{0}"/></link>'
    first = [
        lane(n, inside=on.format(n), attributes=AGAINST if n != -2 else "") for n in (-1, -2, -3)
    ]
    second = [
        lane(n, inside=back.format(n), attributes=AGAINST if n != -2 else "") for n in (-1, -2, -3)
    ]
    ahead = joined_to("successor", "road", "2", 'contactPoint="start"')
    behind = joined_to("predecessor", "road", "1", 'contactPoint="end"')
    roads = street(length=150.0, sections=section("", "".join(first)), inside=ahead)
    roads += street(
        name="2",
        start=(0.0, 0.0),
        length=150.0,
        sections=section("", "".join(second)),
        inside=behind,
    )
    site, _ = imported(roads, minor=8)
    root = ElementTree.fromstring(site.network)
    links = [c for c in root.iter("connection") if c.get("from", ":")[0] != ":"]
    open_links = {(c.get("from"), c.get("fromLane"), c.get("to")) for c in links}
    assert ("-1", "0", "-2") in open_links
    assert {("2.right", "0", "1.right"), ("2.right", "2", "1.right")} <= open_links
    lines = {y: [] for y in (-1.75, -5.25, -8.75)}
    for users, _, line in read_lanes(site):
        for y, directions in lines.items():
            if users == CARS and np.abs(line[:, 1] - y).max() < 0.1:
                directions.append(np.sign(line[-1, 0] - line[0, 0]))
    assert lines == {-1.75: [-1, -1], -5.25: [1, 1], -8.75: [-1, -1]}


def test_a_lane_for_both_directions_is_closed_or_noted(imported):
    two = lane(-1) + lane(-2, attributes='direction="both"')
    site, notes = imported(street(sections=section(lane(1), two)), minor=8)
    assert find_lane(site, -5.25)[0] == set()
    assert "1 lanes for both directions (turning lanes) are closed to through traffic" in notes
    one = section("", lane(-1, attributes='direction="both"'))
    site, notes = imported(street(sections=one), minor=8)
    assert heads(site, -1.75) == 1
    assert "1 lanes for both directions are driven in the direction of their side only" in notes


def test_reversed_lanes_are_joined_along_sections_and_roads(imported):
    """Two roads of two sections each, their only lane reversed: traffic runs through all four,
    towards -x."""

    def lanes():
        on, back = '<successor id="-1"/>', '<predecessor id="-1"/>'
        row = lane(-1, inside=f"<link>{back}{on}</link>", attributes=AGAINST)
        return section("", row) + section("", row, s=75)

    first = joined_to("successor", "road", "2", 'contactPoint="start"')
    second = joined_to("predecessor", "road", "1", 'contactPoint="end"')
    roads = street(length=150.0, sections=lanes(), inside=first)
    roads += street(name="2", start=(0.0, 0.0), length=150.0, sections=lanes(), inside=second)
    site, _ = imported(roads, minor=8)
    root = ElementTree.fromstring(site.network)
    ways = [
        (c.get("from"), c.get("to"))
        for c in root.iter("connection")
        if c.get("from", ":")[0] != ":"
    ]
    assert len(ways) == 3
    lines = [line for _, _, line in read_lanes(site)]
    assert len(lines) == 4
    assert all(
        line[-1, 0] < line[0, 0] and np.abs(line[:, 1] + 1.75).max() < 0.01 for line in lines
    )


def joined_to(where: str, kind: str, name: str, contact: str = "") -> str:
    """<link> of a road to one element."""
    return f'<link><{where} elementType="{kind}" elementId="{name}" {contact}/></link>'


def test_reversed_lanes_are_joined_over_a_junction(imported):
    """Road 1 ends in a junction that its reversed lane leaves; a connecting road brings traffic
    from road 2."""
    reverse = section("", lane(-1, attributes=AGAINST))
    inner = '<link><predecessor id="1"/><successor id="-1"/></link>'
    roads = street(length=140.0, sections=reverse, inside=joined_to("successor", "junction", "9"))
    roads += street(
        name="2", start=(10.0, 0.0), length=140.0, inside=joined_to("predecessor", "junction", "9")
    )
    bend = '<link><predecessor elementType="road" elementId="2" contactPoint="start"/>'
    bend += '<successor elementType="road" elementId="1" contactPoint="end"/></link>'
    back = section("", lane(-1, inside=inner))
    roads += street(
        name="3",
        start=(10.0, 0.0),
        heading=np.pi,
        length=20.0,
        sections=back,
        inside=bend,
        junction="9",
    )
    way = (
        '<connection id="0" incomingRoad="2" connectingRoad="3" contactPoint="start"><laneLink '
        'from="1" to="-1"/>'
    )
    site, _ = imported(f'{roads}<junction id="9" name="">{way}</connection></junction>', minor=8)
    root = ElementTree.fromstring(site.network)
    ways = [
        (c.get("from"), c.get("to"))
        for c in root.iter("connection")
        if c.get("from", ":")[0] != ":"
    ]
    assert ways == [("2", "1.right")]


# Limits: 1.8, 10.4 and 11.9


LIMITS = {
    'max="8.33" unit="m/s"': 8.33,
    'max="8.33"': 8.33,
    'max="30" unit="km/h"': 8.333,
    'max="65" unit="mph"': 29.058,
    'max="no limit"': 36.11,
    'max="undefined"': 13.89,
    'max="50" unit="kmh"': 13.89,
    'max="-1" unit="km/h"': 13.89,
    'max="55"': 55.0,
}


def test_limits_of_roads(imported):
    places = dict(zip(LIMITS, 15.0 * np.arange(len(LIMITS)), strict=True))
    roads = [
        street(name=f"r{y:g}", start=(-150.0, y), inside=limited((0, limit)))
        for limit, y in places.items()
    ]
    site, notes = imported("".join(roads), size=(80.0, 280.0))
    for limit, y in places.items():
        assert find_lane(site, y - 1.75)[1] == pytest.approx(LIMITS[limit], abs=1e-3)
    assert set(notes) >= {
        "2 limits of 'no limit' count as 130 km/h",
        "3 roads without a limit in the map are driven at 50 km/h",
        "2 limits of '50' in 'kmh' are no speeds and were left out",
        "2 limits of '-1' in 'km/h' are no speeds and were left out",
        "2 limits of 55 m/s (no unit is given) are 198 km/h",
    }


def test_limits_change_along_the_road_and_by_lane(imported):
    slow = lane(-1, inside='<speed sOffset="200" max="5" unit="m/s"/>')
    walk = lane(-2, "sidewalk", 2.0)
    limits = limited((0, 'max="50" unit="km/h"'), (100, 'max="30" unit="km/h"'))
    site, notes = imported(street(sections=section(lane(1), slow + walk), inside=limits))
    for y, x, speed in (
        (-1.75, -60, 13.889),
        (-1.75, 0, 8.333),
        (-1.75, 100, 5.0),
        (1.75, 100, 8.333),
        (-4.5, 0, 2.78),
    ):
        assert find_lane(site, y, x)[1] == pytest.approx(speed, abs=1e-3)
    assert not any("limit" in note for note in notes)


def test_limits_of_the_header_by_type_of_road(imported):
    """1.8, 8.6: <defaultRegulations>."""
    semantics = '<semantics><speed type="maximum" value="100" unit="km/h"/></semantics>'
    rules = (
        "<defaultRegulations><roadRegulations "
        f'type="rural">{semantics}</roadRegulations></defaultRegulations>'
    )
    site, _ = imported(street(inside='<type s="0" type="rural"/>'), rules, minor=8)
    assert find_lane(site, -1.75)[1] == pytest.approx(27.778, abs=1e-3)


# Users: 1.8, 11.7 and 11.10


def test_types_of_lanes_say_who_uses_them(imported):
    """What is unknown is closed; no type is open to everybody but `driving`, ramps and `shared`."""
    kinds = [*USERS, "special1", "special2", "special3", "pavement"]
    lanes = [lane(-2 - i, kind, 2.0) for i, kind in enumerate(kinds)]
    site, notes = imported(
        street(sections=section(lane(1), lane(-1) + "".join(lanes))), size=(80.0, 180.0)
    )
    for i, kind in enumerate(kinds):
        users = "" if kind == "bidirectional" else USERS.get(kind, "")
        assert find_lane(site, -4.5 - 2.0 * i)[0] == set(users.split()), kind
    for kind in ("special1", "special2", "special3", "pavement"):
        assert f"1 lanes of type {kind!r} are closed, as the type is unknown" in notes
    for kind in ("restricted", "stop", "roadWorks"):
        assert f"1 lanes of type {kind!r} are closed to traffic" in notes
    assert "1 lanes for both directions (turning lanes) are closed to through traffic" in notes
    assert "1 HOV lanes are open to buses, taxis and motorcycles only" in notes


ONLY = '<access sOffset="0" rule="allow" restriction="{}"/>'
ACCESS = '<access sOffset="{}" {} restriction="{}"/>'


RULES = [
    (ONLY.format("bus"), {"bus", "coach"}),
    (ONLY.format("bus") + ONLY.format("bicycle"), {"bus", "coach", "bicycle"}),
    (ACCESS.format(0, 'rule="deny"', "trucks"), CARS - {"truck"}),
    (ACCESS.format(0, 'rule="deny"', "passengerCar"), CARS - {"passenger"}),
    (ONLY.format("autonomousTraffic"), set()),
    (ACCESS.format(0, 'rule="deny"', "none"), CARS),
    (ACCESS.format(0, "", "passengerCar"), CARS - {"passenger"}),
    (ACCESS.format(250, 'rule="deny"', "passengerCar"), CARS),
    (
        (
            '<access sOffset="0" rule="allow"><restriction type="bus"/><restriction '
            'type="taxi"/></access>'
        ),
        {"bus", "coach", "taxi"},
    ),
]


def test_access_to_lanes(imported):
    """1.4 to 1.7: an attribute each; 1.8: <restriction>s of one <access>."""
    roads = ""
    for i, (inside, _) in enumerate(RULES):
        lanes = section(lane(1), lane(-1, inside=inside))
        roads += street(name=f"r{i}", start=(-150.0, 15.0 * i), sections=lanes)
    site, notes = imported(roads, minor=8, size=(80.0, 280.0))
    for i, (inside, users) in enumerate(RULES):
        assert find_lane(site, 15.0 * i - 1.75)[0] == users, inside
    assert "1 <access> rules are for 'autonomousTraffic', which is not simulated" in notes
    assert "1 <access> rules without allow or deny count as deny" in notes


def test_roads_for_pedestrians_and_bicycles(imported):
    """1.8, 10.4: the type of a road is valid for all of its cross section."""
    roads = street(inside='<type s="0" type="pedestrian"/>') + street(
        name="2", start=(-150.0, 15.0)
    )
    roads += street(
        name="3",
        start=(-150.0, -15.0),
        inside='<type s="0" type="bicycle"/><type s="150" type="town"/>',
    )
    site, notes = imported(roads, size=(80.0, 80.0))
    for y, x, users in (
        (-1.75, 0, {"pedestrian"}),
        (13.25, 0, CARS),
        (-16.75, -40, {"bicycle"}),
        (-16.75, 40, CARS),
    ):
        assert find_lane(site, y, x)[0] == users
    assert "2 lanes of roads of type 'pedestrian' are closed to other traffic" in notes


@pytest.mark.parametrize(
    ("attribute", "text"), [("roadWorks", "closed"), ("dynamicLaneType", "stay as the map")]
)
def test_lanes_that_a_scenario_changes(imported, attribute, text):
    site, notes = imported(
        street(sections=section(lane(1), lane(-1, attributes=f'{attribute}="true"'))), minor=8
    )
    assert (find_lane(site, -1.75)[0] == CARS) == (attribute != "roadWorks")
    assert any(attribute in note and text in note for note in notes)


# Lanes: 1.8, 11.3 to 11.6


def test_a_section_of_one_side_leaves_the_other(imported):
    both = section(lane(1), lane(-1, inside='<link><successor id="-1"/></link>'))
    right = section(
        "",
        lane(-1, inside='<link><predecessor id="-1"/></link>') + lane(-2),
        150,
        'singleSide="true"',
    )
    site, _ = imported(street(sections=both + right))
    road = shapely.union_all([shapely.Polygon(outline) for outline in site.lanes])
    assert (
        road.symmetric_difference(
            shapely.union(shapely.box(-70, -3.5, 70, 3.5), shapely.box(0, -7, 70, 0))
        ).area
        < 4
    )
    for x in (-50, 50):
        _, _, line = find_lane(site, 1.75, x)
        assert line[-1, 0] < line[0, 0]


def border(number: int, a: float, b: float = 0.0) -> str:
    """A lane by its <border>."""
    row = f'<border sOffset="0" a="{a}" b="{b}" c="0" d="0"/>'
    return f'<lane id="{number}" type="driving">{row}</lane>'


def test_lanes_by_their_borders(imported):
    """A border is counted from the reference line, and the lane reaches to the one inside (1.8,
    11.6.2)."""
    lanes = section(border(1, 3.5, 0.01), border(-1, -3.0) + border(-2, -7.0))
    site, _ = imported(street(sections=lanes))
    road = shapely.union_all([shapely.Polygon(outline) for outline in site.lanes])
    wedge = shapely.Polygon([(-70, -7), (70, -7), (70, 3.5 + 2.2), (-70, 3.5 + 0.8)])
    assert road.symmetric_difference(wedge).area < 1
    assert find_lane(site, -5.0)[2][0] == pytest.approx([-150.0, -5.0], abs=0.02)


def test_lanes_in_any_order(imported):
    """Their ids say where they are, not the order of the file."""
    lanes = section(lane(1) + lane(2, "sidewalk", 2.0), lane(-2, "sidewalk", 2.0) + lane(-1))
    site, _ = imported(street(sections=lanes))
    for y, users in ((4.5, {"pedestrian"}), (1.75, CARS), (-1.75, CARS), (-4.5, {"pedestrian"})):
        assert find_lane(site, y)[0] == users


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("shape", "radius"),
    [
        ('<arc curvature="0"/>', np.inf),
        ('<spiral curvStart="0" curvEnd="0"/>', np.inf),
        ('<spiral curvStart="0.005" curvEnd="0.005"/>', 200.0),
        ('<userData code="a"/><arc curvature="-0.005"/>', -200.0),
    ],
)
def test_arcs_and_spirals_at_their_limits(imported, shape, radius):
    """netconvert makes nodes at NaN of them (eclipse-sumo/sumo#17163; pageldev/libOpenDRIVE#60)."""
    site, _ = imported(street(start=(-40.0, 0.0), length=100.0, geometry=shape))
    for _, _, line in read_lanes(site):
        off = (
            np.abs(line[:, 1])
            if np.isinf(radius)
            else np.abs(np.hypot(line[:, 0] + 40, line[:, 1] - radius) - 200)
        )
        np.testing.assert_allclose(off, 1.75, atol=0.05)
        assert np.hypot(*(line[-1] - line[0])) > 95


@pytest.mark.one_in(3)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("geometry", "links"),
    [
        ("", '<laneLink from="{0}" to="{0}"/>'),
        ("", ""),
        (
            '<geometry s="0" x="-10" y="0" hdg="0" length="0"><line/></geometry>',
            '<laneLink from="{0}" to="{0}"/>',
        ),
    ],
)
def test_a_connection_joins_its_roads(imported, geometry, links, sign):
    """Without links, lanes of the same id (1.4, 5.4.2); pieces of no length are none
    (eclipse-sumo/sumo#17163)."""
    rule = 'rule="RHT"' if sign > 0 else 'rule="LHT"'
    roads = street(length=140.0, inside=joined("9", "successor"), attributes=rule)
    roads += street(
        name="2",
        start=(10.0, 0.0),
        length=140.0,
        inside=joined("9", "predecessor"),
        attributes=rule,
    )
    ends = '<link><predecessor elementType="road" elementId="1" contactPoint="end"/>'
    ends += '<successor elementType="road" elementId="2" contactPoint="start"/></link>'
    one = lane(-sign, inside=f'<link><predecessor id="{-sign}"/><successor id="{-sign}"/></link>')
    lanes = section("", one) if sign > 0 else section(one, "")
    inner = street(
        name="3",
        start=(-10.0, 0.0),
        length=20.0,
        sections=lanes,
        inside=ends,
        junction="9",
        attributes=rule,
    )
    roads += inner.replace("<planView>", f"<planView>{geometry}")
    way = '<connection id="0" incomingRoad="1" connectingRoad="3" contactPoint="start">'
    way += f"{links.format(-sign)}</connection>"
    bad = '<connection id="1" incomingRoad="1" contactPoint="start"/>'
    site, notes = imported(f'{roads}<junction id="9" name="">{way}{bad}</junction>')
    root = ElementTree.fromstring(site.network)
    assert ("-1", "-2") in {(c.get("from"), c.get("to")) for c in root.iter("connection")}
    assert heads(site, -1.75 * sign, -60.0) == 1
    assert "1 connections of junctions lead to roads that are not in the file" in notes


# Heights: 1.8, 10.5 to 10.7


@pytest.mark.one_in(2)
@pytest.mark.parametrize("x", [0.0, -540.0])
def test_a_long_road_on_a_slope_has_the_height_of_its_piece(imported, x):
    road = street(start=(-600.0, 0.0), length=1200.0, inside=rising(0.012))
    site, _ = imported(road, centre=(x, 0.0))
    assert site.relief.slope == pytest.approx((0.012, 0.0), abs=1e-4)
    assert site.map_SE3_site[2, 3] == pytest.approx(0.012 * (600.0 + x), abs=0.01)
    assert len(read_lanes(site)) == 2


@pytest.mark.parametrize("slope", [0.04, -0.08])
def test_a_steep_side_street_keeps_its_traffic(imported, slope):
    side = street(name="2", start=(0.0, 3.5), heading=np.pi / 2, length=400.0, inside=rising(slope))
    site, _ = imported(street(inside=rising(0.0)) + side)
    assert sum(abs(line[-1, 1] - line[0, 1]) > 100 for _, _, line in read_lanes(site)) == 2


def test_a_bridge_over_the_road_is_left_out_and_noted(imported):
    flat = '<elevationProfile><elevation s="0" a="6" b="0" c="0" d="0"/></elevationProfile>'
    over = street(name="2", start=(0.0, -150.0), heading=np.pi / 2, inside=flat)
    site, notes = imported(street() + over)
    assert len(read_lanes(site)) == 2
    assert "1 roads more than 3.5 m above or below the site were left out" in notes


def lateral(text: str) -> str:
    return f"<lateralProfile>{text}</lateralProfile>"


def test_superelevation_tilts_the_site(imported):
    """Positive superelevation falls to the right (1.8, 10.5.2)."""
    tilt = lateral('<superelevation s="0" a="0.05" b="0" c="0" d="0"/>')
    site, notes = imported(street(inside=tilt))
    assert site.relief.slope == pytest.approx((0.0, np.sin(0.05)), abs=1e-4)
    assert (
        "the site slopes by 5.0 % as its roads do, which leave that plane by up to 0.00 m" in notes
    )


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    "text",
    [
        '<crossfall side="both" s="0" a="0.04" b="0" c="0" d="0"/>',
        (
            '<shape s="0" t="-3.5" a="-0.14" b="0.04" c="0" d="0"/><shape s="0" t="0" a="0" '
            'b="-0.04" c="0" d="0"/>'
        ),
    ],
)
def test_a_camber_leaves_the_plane_by_as_much_as_is_said(imported, text):
    """1.4, 5.3.6, and 1.8, 10.5.3: edges 0.14 m below the middle; the plane between them is 0.09 m
    from the latter."""
    site, notes = imported(street(inside=rising(0.02) + lateral(text)))
    assert site.relief.slope == pytest.approx((0.02, 0.0), abs=1e-3)
    (note,) = (note for note in notes if "leave that plane" in note)
    assert note.endswith("by up to 0.09 m")


# What stands at the side refuses no file


SIDE = (
    '<objects><object/><object id="1" type="" s="5" t="far"/><bridge/><tunnel s="0" length="9" '
    'type="0"/></objects><signals><signal id="2" type="" s="150" t="-8" orientation="+" '
    'dynamic="no"/><signal id="3" type="-1"/></signals><surface><CRG file="missing.crg" '
    'sStart="0" sEnd="9" orientation="same" mode="attached"/></surface><railroad><switch '
    'name="x"/></railroad><userData code="a" value="b"/><userData><b/></userData>'
)


def test_odd_things_at_the_side_refuse_no_file(imported):
    """netconvert stops at a sign with an empty type."""
    more = '<controller id=""/><station/><junctionGroup/><userData/><include file="x"/>'
    site, notes = imported(street(inside=SIDE) + more)
    assert len(read_lanes(site)) == 2
    text = "; ".join(notes)
    assert (
        "1 damaged objects or signals were left out: <signal> needs a finite number as s, got "
        "'None'"
    ) in text
    for said in ("1 tunnels have no walls", "1 surfaces in OpenCRG files", "2 signs are plates"):
        assert said in text


# Junctions: 1.8, 12


def joined(name: str, at: str) -> str:
    return f'<link><{at} elementType="junction" elementId="{name}"/></link>'


def test_objects_beyond_their_road_are_left_out(imported):
    """s is from 0 to the road's length (1.8, 13.1), also of repeats; an outline has an area
    (13.3)."""
    wall = '<object id="1" type="barrier" s="280" t="9" height="1">'
    wall += '<repeat s="280" length="1000" distance="0" tStart="9" tEnd="9"/></object>'
    trees = '<object id="2" type="tree" s="270" t="15" height="7">'
    trees += '<repeat s="270" length="300" distance="20" tStart="15" tEnd="15"/></object>'
    bad = '<object id="3" type="building" s="330" t="-15" length="10" width="8" height="9"/>'
    bad += (
        '<object id="4" type="building" s="250" t="25" height="9"><outline><cornerLocal u="0" '
        'v="0"/>'
    )
    bad += '<cornerLocal u="9" v="9"/></outline></object>'
    bad += '<object id="5" type="building" s="250" t="25" length="10" width="8" height="-3"/>'
    sign = '<signal id="6" s="1e3" t="-6" type="274" dynamic="no" orientation="+"/>'
    things = f"<objects>{wall}{trees}{bad}</objects><signals>{sign}</signals>"
    site, notes = imported(street().replace("</lanes>", f"</lanes>{things}"), centre=(140.0, 0.0))
    assert any(
        "4 damaged objects or signals were left out: <object> needs an s of 0 to 300, got 330" in n
        for n in notes
    )
    kinds = {solid.kind: solid for solid in site.solids}
    assert "building" not in kinds
    assert kinds["trunk"].footprint.mean(axis=0) == pytest.approx([0.0, 15.0], abs=0.5)
    ends = [solid.footprint[:, 0].max() for solid in site.solids if solid.kind in ("wall", "trunk")]
    assert max(ends) <= 15.0 + 0.1


@pytest.mark.one_in(2)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_direct_junction_joins_its_roads(imported, sign):
    """1.7, 10.7: an exit of a two-lane carriageway, and the other direction through the same
    connection."""
    rule = 'rule="RHT"' if sign > 0 else 'rule="LHT"'
    main, side, ramp = (lane(-sign), lane(sign), lane(-2 * sign))
    sides = (side, main + ramp) if sign > 0 else (ramp + main, side)
    first = street(
        length=150.0, sections=section(*sides), inside=joined("9", "successor"), attributes=rule
    )
    second = street(
        name="2", start=(0.0, 0.0), length=150.0, inside=joined("9", "predecessor"), attributes=rule
    )
    only = section("", lane(-1)) if sign > 0 else section(lane(1), "")
    third = street(
        name="3",
        start=(0.0, -3.5 * sign),
        heading=-0.1 * sign,
        length=150.0,
        sections=only,
        inside=joined("9", "predecessor"),
        attributes=rule,
    )
    links = f'<laneLink from="{-sign}" to="{-sign}"/><laneLink from="{sign}" to="{sign}"/>'
    exit_ = f'<laneLink from="{-2 * sign}" to="{-sign}" overlapZone="20"/>'
    junction = (
        '<junction id="9" name="" type="direct">'
        f'<connection id="0" incomingRoad="1" linkedRoad="2" contactPoint="start">{links}</connection>'
        f'<connection id="1" incomingRoad="1" linkedRoad="3" contactPoint="start">{exit_}'
        "</connection></junction>"
    )
    site, _ = imported(first + second + third + junction, minor=7)
    root = ElementTree.fromstring(site.network)
    ways = {
        (c.get("from"), c.get("to"))
        for c in root.iter("connection")
        if c.get("from", ":")[0] != ":"
    }
    assert ways == {("-1", "-2"), ("-1", "-3"), ("2", "1")}


def test_a_virtual_junction_leaves_the_main_road_whole(imported):
    """1.8, 12.6: the main road goes on; who branches off within it is noted."""
    branch = (
        '<link><predecessor elementType="road" elementId="1" elementS="145" elementDir="+"/></link>'
    )
    inner = street(
        name="3", start=(-5.0, -1.75), heading=-0.9, length=8.0, inside=branch, junction="9"
    )
    side = street(name="2", start=(0.0, -8.0), heading=-np.pi / 2, length=80.0)
    connection = '<connection id="0" incomingRoad="1" connectingRoad="3" contactPoint="start"/>'
    about = 'type="virtual" mainRoad="1" sStart="140" sEnd="160" orientation="none"'
    site, notes = imported(
        street() + inner + side + f'<junction id="9" name="" {about}>{connection}</junction>'
    )
    assert find_lane(site, -1.75)[2][[0, -1], 0] == pytest.approx([-150, 150])
    assert any("virtual junctions are left out" in note for note in notes)


def test_a_crossing_junction_is_noted(imported):
    rail = street(
        name="2",
        start=(0.0, -100.0),
        heading=np.pi / 2,
        length=200.0,
        sections=section("", lane(-1, "rail")),
    )
    parts = '<roadSection id="0" roadId="1" sStart="140" sEnd="160"/>'
    site, notes = imported(
        street() + rail + f'<junction id="9" name="" type="crossing">{parts}</junction>', minor=8
    )
    assert "1 crossing junctions are left out: traffic there does not give way" in notes
    assert find_lane(site, -1.75)[0] == CARS


def test_links_that_lead_nowhere_are_counted(imported):
    out = '<link><successor elementType="road" elementId="77" contactPoint="start"/></link>'
    connection = '<connection id="0" incomingRoad="8" connectingRoad="9" contactPoint="start"/>'
    site, notes = imported(street(inside=out) + f'<junction id="5" name="">{connection}</junction>')
    assert len(read_lanes(site)) == 2
    assert "1 roads are linked to what is not in the file" in notes


def test_what_contradicts_itself_is_noted(imported):
    """netconvert's own warnings are read as well: of a gap in a reference line."""
    gap = '<geometry s="0" x="-150" y="0" hdg="0" length="150"><line/></geometry>'
    road = street(start=(0.0, 2.0), length=150.0).replace("<planView>", f"<planView>{gap}")
    road = road.replace('<geometry s="0" x="0.0"', '<geometry s="150" x="0.0"')
    twice = street(
        name="2", start=(-150.0, 15.0), sections=section(lane(1) + lane(1), lane(-1) + lane(2))
    )
    short = street(name="3", start=(-150.0, -15.0)).replace('length="300', 'length="30', 1)
    row = 'aU="0" bU="60" cU="0" dU="0" aV="0" bV="0" cV="0" dV="0"'
    curve = f'<paramPoly3 pRange="normalized" {row}/>'
    long = street(name="4", start=(-20.0, 30.0), length=30.0, geometry=curve)
    _, notes = imported(road + twice + short + long, size=(80.0, 80.0))
    assert any(
        "Mismatched geometry for edge '1' between geometry segments 0 and 1" in note
        for note in notes
    )
    assert set(notes) >= {
        "1 lanes have the id of another lane beside them",
        "1 lanes have an id of the other side, where they are drawn",
        "2 roads are not as long as their geometry, which counts",
        "1 curves are not as long as their geometry says",
    }


def test_roads_that_carry_no_traffic_are_noted(imported):
    bare = street(name="2", start=(-150.0, 30.0)).replace(section(lane(1), lane(-1)), "")
    lost = street(name="3", start=(-150.0, -15.0), junction="77")
    site, notes = imported(street() + street(start=(-150.0, 15.0)) + bare + lost, size=(80.0, 80.0))
    assert len(read_lanes(site)) == 4
    assert "1 roads are part of a junction that is not in the file" in notes
    assert "1 roads have the id of another one and carry no traffic" in notes
    assert "1 roads have no lanes" in notes


def test_ids_of_roads_are_free(imported):
    """SUMO's ids are not: -5 is the other direction of 5, a comma parts a list."""
    names = ("5", "a,b;c 1", "-5", "5#1", "", "Unter den Linden 信号", "a:b|c")
    roads = [street(name=name, start=(-150.0, 15.0 * i)) for i, name in enumerate(names)]
    site, _ = imported("".join(roads), size=(80.0, 200.0))
    assert len(read_lanes(site)) == 14


def test_remedies_name_what_was_found(imported):
    rail = street(sections=section("", lane(-1, "rail")))
    with pytest.raises(
        ValueError, match="have no carriageway, but lanes of the types rail: give --centre X Y"
    ):
        imported(rail)
    with pytest.raises(
        ValueError,
        match="no road within the area about 0 140: move --centre onto a road, as --centre 0 ",
    ):
        imported(street(), centre=(0.0, 140.0), size=(20.0, 20.0))


# Lanes whose width or offset changes: 1.8, 11.4 and 11.6

OPENING = ((0, 0.0, 0.0, 0.0, 0.0), (120, 0.0, 3.5 / 60, 0.0, 0.0), (180, 3.5, 0.0, 0.0, 0.0))


def shaped(number: int, rows, kind: str = "driving") -> str:
    """A <lane> whose widths begin at sOffset; a row gives sOffset and the coefficients."""
    widths = "".join(
        f'<width sOffset="{s}" a="{a}" b="{b}" c="{c}" d="{d}"/>' for s, a, b, c, d in rows
    )
    return f'<lane id="{number}" type="{kind}" level="false">{widths}</lane>'


def list_lines(site):
    """Middle lines of the lanes for cars."""
    lanes = (
        element
        for _, element in nets.list_lanes(site.network)
        if "passenger" in nets.list_users(element)
    )
    return [nets.parse_shape(element) for element in lanes]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("sign", "rule"), [(-1, "RHT"), (1, "LHT"), (1, "RHT")])
def test_a_lane_that_opens_moves_those_outside_it(imported, sign, rule):
    """Lane 1 opens from 0 to 3.5 m between s = 120 and 180; lane 2 goes through outside it
    (eclipse-sumo/sumo#5823)."""
    sides = [shaped(sign, OPENING) + lane(2 * sign), lane(-sign)]
    site, _ = imported(
        street(sections=section(*sides[::sign]), attributes=f'rule="{rule}"', inside=rising(0.01))
    )
    beside = [line for line in list_lines(site) if line[:, 1].mean() * sign > 0]
    assert len(beside) >= 3
    for line in beside:
        x, y = line[np.hypot(*line.T) < 149.0].T
        inner = np.clip((x + 150 - 120) * 3.5 / 60, 0.0, 3.5)
        off = np.minimum(np.abs(sign * y - inner - 1.75), np.abs(sign * y - inner / 2))
        assert off.max() < 0.1
    for snapshot in simulate(site, catalogue(), frames=4, seed=1):
        boxes = snapshot.objects.boxes[np.isin(snapshot.objects.labels, [VEHICLE, HEAVY])]
        # where only the outer lane is there
        outside = boxes[(boxes[:, 1] * sign > 0) & (boxes[:, 0] < -32)]
        assert not len(outside) or np.abs(outside[:, 1] * sign - 1.75).max() < 1.0


def find_offset(x):
    return 7 * np.polyval([-2, 3, 0, 0], np.clip((x + 50) / 100, 0, 1))


def test_an_offset_of_lanes_is_a_cubic_on_the_road_too(imported):
    """All lanes move 7 m to the left between s = 100 and 200, along 3 u² − 2 u³."""
    offset = (
        f'<laneOffset s="0" a="0" b="0" c="0" d="0"/><laneOffset s="100" a="0" b="0" c="{21e-4}" '
        f'd="{-14e-6}"/>'
    )
    offset += '<laneOffset s="200" a="7" b="0" c="0" d="0"/>'
    site, _ = imported(street(sections=offset + section(lane(1), lane(-1))))
    for line in list_lines(site):
        x, y = line.T
        assert np.abs(np.abs(y - find_offset(x)) - 1.75).max() < 0.05
    road = nets.unite(site.lanes)
    for x in (-30.0, -20.0, 20.0, 30.0):
        _, low, _, high = road.intersection(shapely.LineString([(x, -30), (x, 30)])).bounds
        assert (low, high) == pytest.approx((find_offset(x) - 3.5, find_offset(x) + 3.5), abs=0.08)


def test_a_lane_too_narrow_to_drive_on_is_closed(imported):
    site, _ = imported(street(sections=section(lane(1), shaped(-1, OPENING) + lane(-2))))
    users = [nets.list_users(element) for _, element in nets.list_lanes(site.network)]
    assert set() in users
    assert not any("authority" in allowed for allowed in users)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_pieces_of_a_road_do_not_overlap(imported, rule):
    """A lane opens outside, while all lanes move aside (eclipse-sumo/sumo#6184: splits of narrow
    lanes)."""
    offset = '<laneOffset s="0" a="0.5" b="0.01" c="0" d="0"/>'
    opening = shaped(2, [(0, 0.0, 0.03, 0.0, 0.0)])
    sections = section(lane(1) + opening, lane(-1)) + section(
        lane(1) + lane(2, width=3.0), lane(-1), s=100
    )
    site, _ = imported(street(sections=offset + sections, attributes=f'rule="{rule}"'))
    innermost = {
        edge.get("id", ""): nets.parse_shape(element)
        for edge, element in nets.list_lanes(site.network)
    }
    for is_forward in (True, False):
        pieces = [line for name, line in innermost.items() if name.startswith("-") == is_forward]
        assert len(pieces) >= 2
        assert sum(float(np.ptp(line[:, 0])) for line in pieces) < 301.0


def test_ground_and_network_of_a_wide_lane_agree(imported):
    """A width has no upper bound (11.6.1); 60 m are ground and lane alike."""
    site, notes = imported(
        street(sections=section(lane(1), lane(-1, width=60.0))), size=(80.0, 160.0)
    )
    assert find_lane(site, -30.0)[0] >= {"passenger"}
    ground = nets.unite(site.lanes)
    assert ground.covers(shapely.Point(0.0, -59.0))
    assert not ground.covers(shapely.Point(0.0, -61.0))
    assert any("lanes wider than 50 m" in note for note in notes)


def test_a_lane_of_negative_width_carries_no_cars(imported):
    """A width is zero or more (11.6.1)."""
    site, notes = imported(street(sections=section(lane(1), lane(-1) + lane(-2, width=-3.5))))
    assert {round(float(line[:, 1].mean()), 2) for _, _, line in read_lanes(site)} == {1.75, -1.75}
    assert any("1 lanes have a width below zero" in note for note in notes)


def test_a_lane_section_beyond_the_end_is_said(imported):
    """A section's s is on its road (11.4)."""
    beyond = section(lane(1), lane(-1)) + section(lane(1) + lane(2), lane(-1), s=500.0)
    _, notes = imported(street(sections=beyond))
    assert any("1 lane sections begin beyond" in note for note in notes)
