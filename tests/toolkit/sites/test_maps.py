import os
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import catalogue
from toolkit.boxes import footprints
from toolkit.geometry import transform
from toolkit.objects import VEHICLE
from toolkit.points import has_centre_inside
from toolkit.sites import furniture, georeference
from toolkit.sites.files import document, parse
from toolkit.sites.maps.furnishing import furnish_site, redraw
from toolkit.sites.maps.legs import find_legs
from toolkit.sites.maps.map_bays import find_free_bays, lay_bays
from toolkit.sites.maps.opendrive_site import import_opendrive
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.maps.road_surface import junction_corners, kerbstones, whole_road
from toolkit.sites.maps.tracks import find_tracks, find_turns
from toolkit.sites.osm.raw_map import RawMap
from toolkit.sites.site import Mount, Solid
from toolkit.sites.surroundings.things import count_things
from toolkit.traffic.snapshots import simulate

CENTRE = (13.4, 52.505)
SHARED = Path(os.environ.get("COVIEW_SHARED", Path(__file__).parents[4] / "shared"))
carla = pytest.mark.skipif(not (SHARED / "carla").is_dir(), reason="the CARLA maps are not here")


@carla
def test_tjunction_of_the_paper(tmp_path, check_site, union, on_lanes):
    site = import_opendrive(
        MapPiece(
            SHARED / "carla" / "Town01.xodr", centre=(104, -196), size=(80, 40), heading=np.pi / 2
        )
    )
    check_site(site, tmp_path)
    # The through road at b = 13.6 ± 4.3, the side road at a = -0.8 ± 4 going down, in the published
    # picture's axes.
    for a in np.arange(-39, 40, 3.0):
        assert on_lanes(site, a, 13.6 - 4.0)
        assert on_lanes(site, a, 13.6 + 4.0)
        assert not on_lanes(site, a, 13.6 + 4.6)
        assert abs(a + 0.8) < 11 or not on_lanes(site, a, 13.6 - 4.6)
    for b in np.arange(-19, 5, 3.0):
        assert on_lanes(site, -0.8 - 3.8, b)
        assert on_lanes(site, -0.8 + 3.8, b)
        assert not on_lanes(site, -0.8 + 4.6, b)
    walk = union(site.footways)
    assert walk.contains(shapely.Point(30, 13.6 + 4.4 + 3.5))
    assert not walk.contains(shapely.Point(30, 13.6 + 4.4 + 4.5))
    np.testing.assert_allclose(
        transform(site.map_SE3_site, np.array([[0.0, 13.6, 0.0]]))[0], [90.4, -196, 0], atol=0.1
    )
    assert site.geo_reference is not None
    assert "+proj=tmerc" in site.geo_reference
    assert len(site.network) < 100_000


@carla
def test_roundabout_of_the_paper(tmp_path, check_site, on_lanes):
    with pytest.warns(
        UserWarning, match=r"Town03.xodr: its geoReference names no projection \('\+lat_0=4\.9"
    ):
        site = import_opendrive(
            MapPiece(SHARED / "carla" / "Town03.xodr", centre=(0, 0), size=(96, 96))
        )
    assert site.geo_reference is None
    check_site(site, tmp_path)
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    assert np.mean([on_lanes(site, 20.95 * np.cos(a), 20.95 * np.sin(a)) for a in angles]) > 0.98
    assert not any(on_lanes(site, 12 * np.cos(a), 12 * np.sin(a)) for a in angles)
    for x, y in ((44, 6), (44, -6), (-44, 1), (3, 44), (-4, 44), (5, -45), (-7, -45)):
        assert on_lanes(site, x, y), (x, y)


@carla
def test_turned_site_is_the_same_place_and_needs_a_road(tmp_path, on_lanes):
    town = SHARED / "carla" / "Town01.xodr"
    straight = import_opendrive(MapPiece(town, centre=(104, -196), size=(60, 60)))
    turned = import_opendrive(MapPiece(town, centre=(104, -196), size=(60, 60), heading=0.6))
    spot = np.array([[-13.6, 5.0, 0.0]])
    assert on_lanes(straight, *spot[0, :2])
    moved = transform(np.linalg.inv(turned.map_SE3_site), transform(straight.map_SE3_site, spot))
    assert on_lanes(turned, *moved[0, :2])
    with pytest.raises(ValueError, match="no road within the area about 200 -260"):
        import_opendrive(
            MapPiece(SHARED / "carla" / "Town01.xodr", centre=(200, -260), size=(20, 20))
        )
    with pytest.raises(
        ValueError, match=r"centre 9000 0 lies outside the map, .*: give --centre X Y"
    ):
        import_opendrive(
            MapPiece(SHARED / "carla" / "Town01.xodr", centre=(9000, 0), size=(20, 20))
        )


@pytest.mark.parametrize("reader", [import_opendrive, import_osm])
@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\x00\x01\x02", b"<html></html>", b"<osm", b"{}", b"<osm></osm>"]
)
def test_no_map(tmp_path, reader, content):
    (tmp_path / "bad.osm").write_bytes(content)
    with pytest.raises(ValueError, match=r"bad\.osm: .*: (give|download|export|it )") as raised:
        reader(MapPiece(tmp_path / "bad.osm", centre=(0, 0), size=(50, 50)))
    assert "\n" not in str(raised.value)


def test_missing_file_and_bad_place(tmp_path, put, crossroads):
    with pytest.raises(FileNotFoundError, match="no map"):
        import_osm(MapPiece(tmp_path / "none.osm", centre=CENTRE, size=(50, 50)))
    path = put(crossroads(), tmp_path)
    with pytest.raises(ValueError, match="size must be two lengths above 0"):
        import_osm(MapPiece(path, centre=CENTRE, size=(50, -1)))
    with pytest.raises(ValueError, match="centre must be two finite numbers"):
        import_osm(MapPiece(path, centre=(np.nan, 0.0), size=(50, 50)))


def test_crossroads(tmp_path, imported, crossroads, on_lanes, union):
    site = imported(crossroads(), tmp_path)
    for spot in ((0, 0), (35, 2), (-35, -2), (0, 28), (0, -28)):
        assert on_lanes(site, *spot)
    assert not on_lanes(site, 25, 25)
    assert not on_lanes(site, 35, 9)
    assert union(site.footways).intersection(shapely.box(*site.area)).area > 100
    assert 'type="traffic_light"' in site.network
    assert 'function="crossing"' in site.network
    # traffic can come from at least 60 m beyond the area
    assert (
        np.max([np.abs(lane).max(axis=0) for lane in (np.array(p) for p in site.lanes)], axis=0)[0]
        >= 60
    )
    assert "300" not in site.network.partition("convBoundary")[2][:40]


def test_a_place_on_earth_and_left_hand_traffic(tmp_path, imported, on_lanes, crossroads):
    """The site's geo-reference and pose lead back to longitude and latitude."""
    site = imported(crossroads(), tmp_path, heading=0.3)
    assert site.geo_reference.startswith("+proj=tmerc +lat_0=52.505 +lon_0=13.4 ")
    east = transform(np.linalg.inv(site.map_SE3_site), np.array([[38.0, 2.0, 0.0]]))[0]
    assert on_lanes(site, *east[:2])
    site = imported(crossroads(), tmp_path, lefthand=True)
    assert 'lefthand="true"' in site.network
    assert on_lanes(site, 30, 2)


def test_what_real_extracts_contain(tmp_path, crossroads, imported):
    """Clipped ways, unknown values, deleted things, text where numbers belong."""
    draft = crossroads()
    draft.way(
        (60, 0),
        (60, 50),
        missing=("77", "78"),
        highway="residential",
        lanes="2;3",
        maxspeed="DE:urban",
    )
    draft.way((40, 30), missing=("79",), highway="residential")
    draft.way((-40, -30), (-40, 40), highway="proposed")
    draft.way((-45, -30), (-45, 40), highway="yes", oneway="maybe")
    draft.way((-30, 0), (-30, 60), highway="service", service="driveway")
    draft.way((5, 5), (6, 6), (5, 6), (6, 5), (5, 5), building="yes", height="-3")
    draft.way((30, 30), (30, 30), building="yes")
    draft.node((3, 30), natural="tree", height="ca. 5")
    draft.text.append(
        '<node id="5"/><node id="6" lat="north" lon="1"/><way id="7"/><relation id="8"/>'
    )
    draft.text.append('<way id="9" action="delete"><nd ref="5"/></way><note>made by hand</note>')
    imported(draft, tmp_path)


def test_a_deleted_relation_removes_no_way_of_its_number(tmp_path, crossroads, put):
    draft = crossroads()
    numbers = RawMap.read(put(draft, tmp_path)).ways.keys()
    draft.text += [f'<relation id="{number}" action="delete"/>' for number in numbers]
    assert RawMap.read(put(draft, tmp_path)).ways.keys() == numbers


def test_centre_outside_and_off_the_road(tmp_path, put, empty_map, crossroads, box):
    path = put(crossroads(), tmp_path)
    with pytest.raises(
        ValueError, match=r"centre 52.505 13.4 lies outside the map, which spans longitude 13\.39"
    ):
        import_osm(MapPiece(path, centre=CENTRE[::-1], size=(60, 60)))
    (aside,) = georeference.inverse_project(np.array([[120.0, 120.0]]), CENTRE)
    with pytest.raises(ValueError, match="no road within the area"):
        import_osm(MapPiece(path, centre=tuple(aside), size=(20, 20)))
    draft = empty_map()
    draft.way(*box(0, 0, 20, 20), building="yes")
    draft.way((-30, -30), (30, 30), highway="footway")
    with pytest.raises(ValueError, match="no road within the area"):
        import_osm(MapPiece(put(draft, tmp_path), centre=CENTRE, size=(20, 20)))


def straight(folder, inside=""):
    """An OpenDRIVE street 300 m long, two lanes and footways, written by hand."""
    lane = '<lane id="{}" type="{}"><width sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
    left = lane.format(2, "sidewalk", 2) + lane.format(1, "driving", 3.5)
    right = (
        lane.format(-1, "driving", 3.5)
        + lane.format(-2, "parking", 2.5)
        + lane.format(-3, "sidewalk", 2)
    )
    path = folder / "street.xodr"
    path.write_text(
        '<OpenDRIVE><header revMajor="1" revMinor="4"/><road name="" length="300" id="1" junction="-1"><planView>'
        '<geometry s="0" x="-150" y="0" hdg="0" length="300"><line/></geometry></planView><elevationProfile>'
        f'<elevation s="0" a="0" b="0.01" c="0" d="0"/></elevationProfile><lanes><laneSection s="0"><left>{left}</left>'
        f'<center><lane id="0" type="none"/></center><right>{right}</right></laneSection></lanes>{inside}</road>'
        "</OpenDRIVE>"
    )
    return path


def test_an_opendrive_street_with_what_stands_there(tmp_path, of_kind, union, check_site):
    objects = (
        '<object id="2" type="building" s="150" t="20" hdg="0" length="8" width="6" height="5"/>'
        '<object type="pole" s="160" t="0" radius="0.1" height="5"/><object type="dragon" s="5" '
        't="9"/>'
    )
    sign = '<signal id="9" type="274" s="170" t="-8.5" zOffset="2.5" dynamic="no" orientation="+"/>'
    path = straight(tmp_path, f"<objects>{objects}</objects><signals>{sign}</signals>")
    with pytest.warns(UserWarning, match=r"street\.xodr: ") as caught:
        site = import_opendrive(MapPiece(path, centre=(0, 0), size=(80, 40)))
    assert [str(each.message).partition(": ")[2] for each in caught] == [
        "1 objects or signals stand on the carriageway and were left out",
        "objects of types that are not known were left out: 1 'dragon'",
        "the site slopes by 1.0 % as its roads do, which leave that plane by up to 0.00 m",
        "1 roads without a limit in the map are driven at 50 km/h",
        "1 signs are plates, which traffic does not obey",
    ]
    assert site.relief.slope == pytest.approx((0.01, 0.0))
    (house,), (plate,) = of_kind(site, "building"), of_kind(site, "sign")
    np.testing.assert_allclose(house.footprint.mean(axis=0), [0, 20])
    np.testing.assert_allclose(plate.footprint.mean(axis=0), [20, -8.5], atol=1e-3)
    assert union(site.lanes).bounds == pytest.approx((-70, -6, 70, 3.5), abs=0.02)
    assert union(site.footways).bounds == pytest.approx((-70, -8, 70, 5.5), abs=0.02)
    assert len(site.parking) == 21  # every 6.4 m from -63.6 to 64.4
    np.testing.assert_allclose(site.parking[:, 1:], np.tile([-4.75, 0.0], (21, 1)), atol=0.01)
    check_site(site, tmp_path)


def test_a_bare_street_is_furnished_from_a_seed(tmp_path, of_kind):
    path = straight(tmp_path)
    with pytest.warns(
        UserWarning, match=r"street\.xodr: drawn from seed 2, in no map: .* building.* tree"
    ):
        site = import_opendrive(MapPiece(path, centre=(0, 0), size=(80, 40), seed=2))
    assert of_kind(site, "building")
    assert site.relief.amplitude > 0


def test_damaged_objects_are_left_out_and_counted(tmp_path):
    path = straight(tmp_path, '<objects><object type="tree" s="x" t="9"/></objects>')
    reason = "<object> needs a finite number as s, got 'x'"
    with pytest.warns(
        UserWarning, match=rf"street\.xodr: 1 damaged objects or signals were left out: {reason}$"
    ):
        import_opendrive(MapPiece(path, centre=(0, 0), size=(80, 40)))


def test_parking_spaces_of_openstreetmap(tmp_path, imported, crossroads):
    draft = crossroads()
    draft.way((20, 15), (25, 15), (25, 17.5), (20, 17.5), (20, 15), amenity="parking_space")
    draft.way((20, 25), (40, 25), (40, 28), (20, 28), (20, 25), amenity="parking_space")
    draft.way((20, -1), (25, -1), (25, 1), (20, 1), (20, -1), amenity="parking_space")
    site = imported(draft, tmp_path)
    assert len(site.parking) == 1
    np.testing.assert_allclose(site.parking[0, :2], [22.5, 16.25], atol=0.05)
    assert abs(np.sin(site.parking[0, 2])) < 0.01


DOCS = Path(__file__).parents[3] / "docs"
carla_imported = pytest.mark.skipif(
    not (SHARED / "carla_imported").is_dir(), reason="the CARLA maps are not here"
)
NET = (
    '<net><edge id="a"><lane id="a_0" index="0" allow="pedestrian" width="2" shape="-80,-5 '
    '0,-5"/><lane id="a_1" index="1" width="3" shape="-80,-2 0,-2"/></edge><edge id="b"><lane '
    'id="b_0" index="0" width="3" disallow="all" shape="0,40 80,40"/></edge><edge id=":c_0" '
    'function="internal"><lane id=":c_0_0" index="0" width="5" shape="0,-2 20,-2"/></edge><edge '
    'id=":c_w0" function="walkingarea"><lane id=":c_w0_0" index="0" allow="pedestrian" '
    'shape="0,-6 8,-6 8,-2 0,-2"/></edge><junction id="c" type="priority" shape="0,-8 9,-8 9,0 '
    '0,0"/><junction id="d" type="dead_end" shape="90,-8 99,-8 99,0"/></net>'
)
WINDOW = shapely.box(-50, -50, 50, 50)


def shape(polygons):
    return shapely.union_all([shapely.Polygon(p) for p in polygons])


def test_tracks_cover_lanes_and_what_a_body_needs_beyond():
    # the internal lane is 3.5 m wide at most, and a body of 5.5 m goes on from it
    tracks = find_tracks(NET)
    assert tracks.bounds == pytest.approx((-80, -3.75, 25.5, -0.25), abs=0.5)
    assert tracks.area == pytest.approx(80 * 3 + 20 * 3.5 + 5.5 * 2.6, abs=1.5)


def test_corners_of_junctions_belong_to_lanes_and_footways():
    carriageway, footway = junction_corners(NET)
    assert footway.bounds == (0, -6, 8, -2)
    assert carriageway.area == pytest.approx(72 - 32)


def test_a_body_cuts_the_corner_of_a_bend():
    bend = "0,0 1,0 2,0.2 3,0.6 4,1.2 4.8,2 5.4,3 5.8,4 6,5 6,6"
    lane = f'<lane id=":c_0_0" index="0" width="2" shape="{bend}"/>'
    turn = find_tracks(f'<net><edge id=":c_0" function="internal">{lane}</edge></net>')
    assert turn.contains(
        shapely.Point(3.2, 2.6)
    )  # 1.3 m off the chord from one end of the body to the other
    assert not turn.contains(shapely.Point(1.0, 5.0))
    assert (
        find_turns(f'<net><edge id=":c_0" function="internal">{lane}</edge></net>')
        .buffer(1.0)
        .contains(turn)
    )


def test_legs_go_on_from_the_lanes_and_nothing_turns_on_a_straight_road():
    assert find_turns(NET).is_empty
    paths, widths = find_legs(NET)
    assert widths == [(3.5, 3.5)]  # 5 m of lanes, from the middle of the inner one
    np.testing.assert_allclose(paths[0], [[-80, -2], [0, -2], [130, -2]])


def test_a_slot_across_the_road_is_closed():
    lanes = [shapely.box(-60, -4, -0.8, 4), shapely.box(0.8, -4, 60, 4)]
    footways = [shapely.box(-60, 4, 60, 6), shapely.box(-0.8, 1, 0.8, 5)]
    track = shapely.box(-60, -3, 60, 0)
    road, walk = (shape(each) for each in whole_road(lanes, footways, track, WINDOW))
    assert (
        road.symmetric_difference(shapely.box(-50, -4, 50, 4)).area < 4.0
    )  # the far side of the slot may stay open
    assert road.contains(shapely.box(-0.7, 1.1, 0.7, 3.9))
    assert walk.symmetric_difference(shapely.box(-50, 4, 50, 6)).area < 0.1
    assert road.intersection(walk).area < 1e-6


def test_a_slot_along_the_road_is_closed_up_to_the_window():
    lanes = [
        shapely.box(-80, -4, 80, -0.1),
        shapely.box(-80, 0.1, 80, 4),
        shapely.box(-20, 20, 20, 20.6),
    ]
    footways = [shapely.box(-80, 4.2, 80, 6), shapely.box(10, -4.3, 30, -4)]
    road, walk = (shape(each) for each in whole_road(lanes, footways, shapely.Polygon(), WINDOW))
    assert road.bounds[0::2] == walk.bounds[0::2] == (-50, 50)
    assert road.symmetric_difference(shapely.box(-50, -4, 50, 4)).area < 0.5
    assert walk.bounds[1] >= 4.0


def test_islets_become_road_and_refuges_stay():
    lanes = [shapely.box(-60, -8, 60, 8).difference(shapely.box(0, -2, 4, 2))]
    islet, refuge = shapely.box(0, -2, 4, 2), shapely.box(-40, 8, 40, 12)
    track = shapely.box(-60, 7, 60, 9)
    road, walk = (shape(each) for each in whole_road(lanes, [islet, refuge], track, WINDOW))
    assert road.contains(islet.buffer(-0.05))
    assert walk.bounds == pytest.approx((-40, 9, 40, 12), abs=0.02)


def test_fillings_become_road_or_footway():
    lanes, walk = [shapely.box(-60, -4, 60, 4)], [shapely.box(-60, 4, 60, 6)]
    fillings = shapely.box(-10, -12, 10, 5), shapely.box(-10, -14, 10, -12)
    lanes_there, footways = whole_road(lanes, walk, shapely.Polygon(), WINDOW, fillings=fillings)
    assert shape(lanes_there).contains(shapely.box(-9.9, -11.9, 9.9, 0))
    assert shape(footways).contains(shapely.box(-9.9, 4.1, 9.9, 5.9))
    assert shape(footways).contains(shapely.box(-9.9, -13.9, 9.9, -12.1))


def test_kerbs_lie_between_lanes_and_footways_and_are_lowered():
    driven, footways = (
        (furniture.rectangle(-10.0, -4.0, 10.0, 4.0),),
        (furniture.rectangle(-10.0, 4.0, 10.0, 6.0),),
    )
    stones = kerbstones(driven, footways, shapely.Polygon())
    assert shape([s.footprint for s in stones]).bounds == pytest.approx(
        (-10, 4.01, 10, 4.15), abs=0.011
    )
    assert [(s.base, s.top, s.kind) for s in stones] == [(0.0, 0.12, "kerb")] * 5
    assert kerbstones(driven, (), shapely.Polygon()) == []
    lowered = shape([s.footprint for s in kerbstones(driven, footways, shapely.box(-3, 0, 3, 9))])
    assert lowered.area == pytest.approx(14 * 0.14, abs=0.1)
    assert not lowered.intersects(shapely.box(-2.9, 0, 2.9, 9))


def test_bays_are_free_of_posts_and_lanes():
    bays = [(0.0, 9.0, 0.0), (10.0, 9.0, 0.0), (20.0, 9.0, 0.0), (38.0, 9.0, 0.0)]
    window = shapely.box(-40, -40, 40, 40)
    rows = find_free_bays(
        bays, window, [furniture.post(10.0, 9.0, 3.0)], shapely.box(18, 0, 22, 20)
    )
    np.testing.assert_allclose(rows, [[0, 9, 0]])
    # the front of a slanted bay may reach over a lane's edge
    strip, lane = (4.8, shapely.box(-40, -3.3, 40, 0))
    assert len(find_free_bays([(0.0, strip / 2, 0.25 * np.pi)], window, [], lane)) == 1
    assert len(find_free_bays([(0.0, strip / 2 - 0.5, 0.25 * np.pi)], window, [], lane)) == 0


def test_bays_are_laid_along_a_line():
    along = lay_bays(np.array([[0.0, 0], [0, 20]]))
    np.testing.assert_allclose(
        along, [(0, 3.2, np.pi / 2), (0, 9.6, np.pi / 2), (0, 16.0, np.pi / 2)]
    )
    assert lay_bays(np.array([[0.0, 0], [5, 0]])) == []


@pytest.fixture(scope="module")
def bare():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_osm(MapPiece(DOCS / "own-junction.osm", centre=(8.0, 49.5), size=(70, 50)))


def on_lanes(solids, lanes):
    """The largest area of a lane on which something stands; crowns of trees may be over it."""
    return max(shapely.Polygon(s.footprint).intersection(lanes).area for s in solids)


def low(site, below):
    """The solids that begin less than `below` m above the ground."""
    feet = site.ground(np.array([s.footprint.mean(axis=0) for s in site.solids]))
    return [s for s, foot in zip(site.solids, feet, strict=True) if s.base - foot < below]


@pytest.mark.slow
def test_what_is_drawn_keeps_off_what_the_map_has(bare):
    house = Solid(furniture.rectangle(10.0, 10.0, 30.0, 30.0), 0.0, 7.0)
    lamp = Mount("lamp99", np.array([9.0, 9.0, 0.0]))
    made, said = furnish_site(bare, [*bare.mounts, lamp], [house], 3)
    again, _ = furnish_site(bare, [*bare.mounts, lamp], [house], 3)
    other, _ = furnish_site(bare, [*bare.mounts, lamp], [house], 4)
    assert made == again
    assert made != other
    ours = shapely.box(10, 10, 30, 30)
    assert sum(ours.buffer(0.15).intersects(shapely.Polygon(s.footprint)) for s in made.solids) == 1
    lanes = shape(made.lanes)
    assert on_lanes(low(made, 2.0), lanes) < 1e-3
    assert {"building", "tree"} <= {s.kind for s in made.solids}
    assert 0 < made.relief.amplitude <= 0.12
    assert said.startswith("drawn from seed 3, in no map: ")
    counts = count_things(made)
    assert counts["drawn"]["tree"] == sum(s.kind == "trunk" for s in made.solids)
    assert (counts["mapped"]["building"], counts["mapped"]["pole"]) == (1, len(made.mounts))
    assert [s.origin for s in made.solids[:1]] == ["mapped"]
    assert {s.origin for s in made.solids[1:]} == {"drawn"}
    assert said.endswith(f", ground within {made.relief.amplitude} m")
    feet = np.array([m.position for m in made.mounts])
    np.testing.assert_allclose(feet[:, 2], made.ground(feet[:, :2]), atol=1e-3)
    with pytest.raises(ValueError, match="seed must be a whole number from 0 up, got -1"):
        furnish_site(bare, bare.mounts, [], -1)


def test_another_drawing_keeps_what_is_mapped(bare):
    house = Solid(furniture.rectangle(10.0, 10.0, 30.0, 30.0), 0.0, 7.0)
    made, _ = furnish_site(bare, bare.mounts, [house], 3)
    assert redraw(made, 3).mounts == made.mounts
    others = [redraw(made, seed) for seed in (5, 5, 6)]
    assert others[0] == others[1] != others[2]
    for other in others:
        assert other.relief == made.relief
        assert [s for s in other.solids if s.origin == "mapped"] == [
            s for s in made.solids if s.origin == "mapped"
        ]
        assert count_things(other)["mapped"] == count_things(made)["mapped"]
        assert parse(document(other)) == other
    light, _ = furnish_site(bare, bare.mounts, [house], 3, "light")
    assert not {"building", "fence", "container", "wall"} & set(count_things(light)["drawn"])
    assert "tree" in count_things(light)["drawn"]
    with pytest.raises(ValueError, match="no furnishing to draw again"):
        redraw(bare, 3)


def touched(site, frames, interval) -> np.ndarray:
    """How many vehicles of some traffic touch a solid that begins below 1.5 m, in the area; how
    many a kerb, onto which a vehicle drives that makes room for another; and how many there are."""
    solids = low(site, 1.5)
    kerb = np.array([s.kind == "kerb" for s in solids])
    tree = shapely.STRtree([shapely.Polygon(s.footprint) for s in solids])
    hits = np.zeros(3, int)
    for snapshot in simulate(site, catalogue(), frames=frames, seed=1, interval=interval):
        here = (snapshot.objects.labels == VEHICLE) & has_centre_inside(
            snapshot.objects.boxes, site.area
        )
        boxes = snapshot.objects.boxes[here]
        vehicle, solid = tree.query(shapely.polygons(footprints(boxes)), predicate="intersects")
        hits += [len(set(vehicle[~kerb[solid]])), len(set(vehicle[kerb[solid]])), len(boxes)]
    return hits


def junctions(town):
    """Middles of the map's junctions."""
    starts = {}
    for road in ElementTree.parse(town).getroot().iter("road"):
        for piece in road.findall("planView/geometry") if road.get("junction") != "-1" else ():
            starts.setdefault(road.get("junction"), []).append(
                [float(piece.get(key)) for key in "xy"]
            )
    return [
        tuple(np.mean([np.min(xy, axis=0), np.max(xy, axis=0)], axis=0)) for xy in starts.values()
    ]


def whole(town, centre):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        site = import_opendrive(
            MapPiece(SHARED / "carla_imported" / town, centre=centre, size=(80, 70), seed=0)
        )
    lanes = shape(site.lanes)
    assert on_lanes(low(site, 2.0), lanes) < 1e-3
    assert shape(site.footways).intersection(lanes).area < 0.1
    assert (
        find_tracks(site.network)
        .intersection(shapely.box(*site.area))
        .difference(lanes.buffer(0.05))
        .area
        < 0.5
    )
    assert len(site.mounts) >= 6
    kinds = {solid.kind for solid in site.solids}
    assert {"building", "tree", "kerb", "post"} <= kinds
    return site


@carla_imported
@pytest.mark.parametrize(
    ("town", "centre"), [("Town01.xodr", (95.9, -197.3)), ("Town03.xodr", (0.0, 0.0))]
)
def test_no_solid_is_in_the_way(town, centre):
    assert touched(whole(town, centre), 8, 5.0)[:2].tolist() == [0, 0]


@carla_imported
@pytest.mark.slow
@pytest.mark.parametrize("town", ["Town01.xodr", "Town03.xodr"])
def test_no_solid_is_in_the_way_at_any_junction(town):
    hits = {
        centre: touched(whole(town, centre), 30, 2.0)
        for centre in junctions(SHARED / "carla_imported" / town)
    }
    solids, kerbs, vehicles = np.sum(list(hits.values()), axis=0)
    assert solids == 0, hits
    assert kerbs < 0.002 * vehicles, hits
