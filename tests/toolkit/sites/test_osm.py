import gzip

import numpy as np
import pytest
import shapely

from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.osm.map_reader import read_map
from toolkit.sites.streets import find_street_names

CENTRE = (13.4, 52.505)


def test_multipolygons_and_building_parts(tmp_path, crossroads, imported, top, box):
    draft = crossroads()
    half = draft.way((15, 15), (35, 15), (35, 28))
    rest = draft.way((35, 28), (15, 28), (15, 15))
    court = draft.way(*box(22, 19, 28, 24))
    draft.relation(
        [(half, "outer"), (rest, "outer"), (court, "inner")],
        type="multipolygon",
        building="yes",
        height="10",
    )
    torn = draft.way((-15, 15), (-35, 15), (-35, 28))
    draft.relation([(torn, "outer"), (999999, "outer")], type="multipolygon", building="yes")
    site = imported(draft, tmp_path)
    assert top(site, 18, 17) == [10.0]
    assert top(site, 25, 21.5) == []
    assert top(site, -25, 18) == []
    draft = crossroads()
    draft.way(*box(15, 15, 35, 25), building="yes", height="8")
    draft.way(*box(15, 15, 25, 25), building__part="yes", height="20")
    site = imported(draft, tmp_path)
    assert top(site, 20, 20) == [20.0]
    assert top(site, 30, 20) == [8.0]


def test_gzip_and_wrong_formats(tmp_path, crossroads):
    path = tmp_path / "town.osm.gz"
    path.write_bytes(gzip.compress(str(crossroads()).encode()))
    assert import_osm(MapPiece(path, centre=CENTRE, size=(60, 60))).name == "town"
    whole = path.read_bytes()
    path.write_bytes(whole[:150] + bytes(60) + whole[210:])
    with pytest.raises(ValueError, match="damaged gzip"):
        import_osm(MapPiece(path, centre=CENTRE, size=(60, 60)))
    path.write_bytes(whole[:200])
    with pytest.raises(ValueError, match="damaged gzip"):
        import_osm(MapPiece(path, centre=CENTRE, size=(60, 60)))
    (tmp_path / "town.pbf").write_bytes(b"1")
    with pytest.raises(ValueError, match=r"only \.osm, \.osm\.xml and \.osm\.gz are read"):
        import_osm(MapPiece(tmp_path / "town.pbf", centre=CENTRE, size=(60, 60)))


def test_entities_are_refused(tmp_path, put):
    bomb = (
        '<?xml version="1.0"?><!DOCTYPE osm [<!ENTITY a "aaaa">]><osm><node id="1" lat="0" '
        'lon="0"/></osm>'
    )
    with pytest.raises(ValueError, match="not OpenStreetMap XML"):
        import_osm(MapPiece(put(bomb, tmp_path), centre=(0, 0), size=(60, 60)))


@pytest.mark.parametrize(
    ("bomb", "limit", "value"),
    [
        ("<!--" + 300_000 * "x" + "-->", "MAX_SILENT_BYTES", 200_000),
        (f"<way>{2_100 * '<tag/>'}</way>", "MAX_ELEMENT_TAGS", 2_000),
        (20_000 * "<node/>", "MAX_MAP_BYTES", 100_000),
    ],
    ids=["silence", "tags", "bytes"],
)
def test_maps_that_would_take_long_are_refused(tmp_path, crossroads, bomb, limit, value, limits):
    limits("toolkit.sites.osm.elements", _CHUNK_BYTES=8192, **{limit: value})
    path = tmp_path / "town.osm.gz"
    path.write_bytes(
        gzip.compress(str(crossroads()).replace("<node", f"{bomb}<node", 1).encode(), 1)
    )
    with pytest.raises(ValueError, match=r"town.osm.gz: more than .*: cut out the site first"):
        import_osm(MapPiece(path, centre=CENTRE, size=(60, 60)))


def test_places_that_are_not_on_earth_are_left_out(tmp_path, crossroads, put):
    draft = crossroads()
    for k, (lon, lat) in enumerate(
        (("1e308", "52.5"), ("13.4", "1e308"), ("13.4", "90"), ("inf", "nan"), ("x", "1"))
    ):
        draft.text.append(f'<node id="{k}" lon="{lon}" lat="{lat}"/>')
    draft.way(
        (-200, 20), (-150, 20), missing=range(5), highway="residential", layer="-" + 5000 * "9"
    )
    with pytest.warns(UserWarning, match="5 nodes that are no place on earth were left out"):
        assert import_osm(MapPiece(put(draft, tmp_path), CENTRE, (80, 60))).lanes


def test_nodes_and_ways_of_one_id_and_leaps_are_told(tmp_path, crossroads, put):
    draft = crossroads()
    # the same again is no harm
    draft.text.append(next(line for line in draft.text if "<node" in line))
    assert not read_map(put(draft, tmp_path), CENTRE).notes
    draft.text.append('<node id="1001" lat="52.5051" lon="13.4"/>')
    draft.text += ['<node id="7" lat="52.5" lon="13.4"/>', '<node id="8" lat="-52.5" lon="13.4"/>']
    draft.text += ['<way id="9"><nd ref="7"/><nd ref="8"/><tag k="highway" v="service"/></way>'] * 2
    assert read_map(put(draft, tmp_path), CENTRE).notes == (
        "2 nodes or ways of one id are there twice: the last one counts",
        "1 roads or buildings leap more than 10 km from node to node",
    )


def test_truncated_map(tmp_path, put, crossroads):
    text = str(crossroads())
    path = put(text[: len(text) // 2], tmp_path)
    with pytest.raises(ValueError, match="damaged XML"):
        import_osm(MapPiece(path, centre=CENTRE, size=(60, 60)))


def test_one_way_streets_roundabouts_and_cycleways(tmp_path, empty_map, imported, on_lanes):
    for value, sign in (("yes", 1), ("-1", -1)):
        draft = empty_map()
        draft.way((-300, 0), (300, 0), highway="residential", oneway=value, sidewalk="no")
        site = imported(draft, tmp_path)
        (tmp_path / "net.xml").write_text(site.network)
        shapes = [
            line for line in site.network.splitlines() if "<lane" in line and 'index="0"' in line
        ]
        assert len(shapes) == 1
        first, *_, last = shapes[0].partition('shape="')[2].partition('"')[0].split()
        assert sign * (float(last.split(",")[0]) - float(first.split(",")[0])) > 200
    draft = empty_map()
    ring = [
        (round(18 * np.cos(a), 2), round(18 * np.sin(a), 2))
        for a in np.linspace(0, 2 * np.pi, 17)[:-1]
    ]
    draft.way(*ring, ring[0], highway="tertiary", junction="roundabout")
    for k in (0, 4, 8, 12):
        far = tuple(float(c) * 15 for c in ring[k])
        draft.way(ring[k], far, highway="tertiary")
    draft.way((-200, 30), (200, 30), highway="cycleway")
    site = imported(draft, tmp_path)
    assert not on_lanes(site, 0, 0)
    assert np.mean([on_lanes(site, x, y) for x, y in ring]) == 1
    assert on_lanes(site, 39, 0)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("parking", ["no", "lane"])
def test_streets_have_the_names_of_the_map(tmp_path, empty_map, imported, parking):
    draft, name = empty_map(), "St. Mary&apos;s &amp; Co &lt;&quot;A&quot;&gt;"
    draft.way((-300, 0), (0, 0), (300, 0), highway="residential", name=name, parking__both=parking)
    draft.way(
        (0, -300),
        (0, 0),
        (0, 300),
        highway="residential",
        name="Żwirki i Wigury",
        maxspeed__forward="30",
    )
    site = imported(draft, tmp_path)
    names = {street.name for street in find_street_names(site, site.area[:2], site.area[2:])}
    assert names == {'St. Mary\'s & Co <"A">', "Żwirki i Wigury"}


def test_bridges_and_tunnels_leave_the_ground_clear(tmp_path, crossroads, put, on_lanes):
    draft = crossroads()
    draft.way((-200, 20), (200, 20), highway="primary", bridge="yes", layer="1")
    draft.way((-200, -20), (200, -20), highway="primary", tunnel="yes", layer="-1")
    path = put(draft, tmp_path)
    with pytest.warns(UserWarning, match="2 tunnels or bridges over a road were left out"):
        site = import_osm(MapPiece(path, centre=CENTRE, size=(80, 60)))
    assert not on_lanes(site, 25, 20)
    assert not on_lanes(site, 25, -20)


def test_bridge_that_carries_the_junction_stays(tmp_path, empty_map, on_lanes, imported):
    draft = empty_map()
    draft.way((-300, 0), (-30, 0), highway="primary")
    draft.way((-30, 0), (30, 0), highway="primary", bridge="yes", layer="1")
    draft.way((30, 0), (300, 0), highway="primary")
    assert on_lanes(imported(draft, tmp_path), 0, 1)


def test_paths_and_squares(tmp_path, crossroads, imported, union, box):
    draft = crossroads()
    draft.way(*box(12, 12, 38, 28), highway="pedestrian", area="yes")
    draft.way((-12, 20), (-60, 20), highway="footway", width="3")
    walk = union(imported(draft, tmp_path).footways)
    assert walk.contains(shapely.Point(25, 20))
    assert walk.contains(shapely.Point(-30, 21.3))
    assert not walk.contains(shapely.Point(-30, 22))


def test_streets_that_cross_without_a_junction_keep_their_footways_off_each_other(
    tmp_path, crossroads, imported, on_lanes
):
    draft = crossroads()
    draft.way((-100, -40), (100, 44), highway="tertiary")
    draft.way((20, 30), (20, -30), (21, 30), highway="residential")
    assert on_lanes(imported(draft, tmp_path), 36, 2 + 36 * 0.42 - 0.5)


def test_no_bicycle_on_a_motorway(tmp_path, crossroads, imported):
    draft = crossroads()
    draft.way((-300, 25), (300, 25), highway="motorway", oneway="yes", lanes="3")
    lanes = [
        lane
        for lane in imported(draft, tmp_path).network.split("<lane ")[1:]
        if 'speed="36.1' in lane
    ]
    assert len(lanes) == 3
    assert not any("bicycle" in lane.partition('allow="')[2].partition('"')[0] for lane in lanes)
    assert all("passenger" in lane.partition('allow="')[2].partition('"')[0] for lane in lanes)


def test_buildings_and_their_heights(tmp_path, crossroads, imported, top, box):
    draft = crossroads()
    draft.way(*box(15, 15, 25, 25), building="yes", height="12 m")
    draft.way(*box(-25, 15, -15, 25), building="house", building__levels="3")
    draft.way(*box(-25, -25, -15, -15), building="yes")
    draft.way(*box(28, 15, 34, 25), building="yes", height="40'")
    draft.way(*box(15, -25, 25, -15), building="yes", height="3;4", min_height="1")
    draft.way(*box(28, -25, 34, -15), building="yes", height="tall", building__levels="x")
    draft.way(*box(-38, 15, -30, 25), building="no")
    site = imported(draft, tmp_path)
    assert top(site, 20, 20) == [12.0]
    assert top(site, -20, 20) == [9.0]
    assert top(site, -20, -20) == [6.0]
    assert top(site, 31, 20) == [12.192]
    assert top(site, 20, -20) == [4.0]
    assert top(site, 31, -20) == [6.0]
    assert top(site, -34, 20) == []


def test_buildings_over_the_road_are_cut_back(tmp_path, crossroads, put, check_site, top, box):
    draft = crossroads()
    draft.way(*box(20, -12, 30, 30), building="yes")
    path = put(draft, tmp_path)
    with pytest.warns(UserWarning, match=r"town\.osm: 1 buildings reached over a road"):
        site = import_osm(MapPiece(path, centre=CENTRE, size=(80, 60)))
    check_site(site, tmp_path)
    assert top(site, 25, 20) == [6.0]
    assert top(site, 25, 0) == []


def test_street_furniture(tmp_path, crossroads, imported, of_kind):
    draft = crossroads()
    for x in range(-40, 41, 10):
        draft.node((x, 12.5), highway="street_lamp")
    draft.node((20, 20), natural="tree", height="9", diameter_crown="5")
    draft.node((20, 0.5), natural="tree")
    draft.node((25, 14), amenity="bench")
    draft.way((12, -14), (38, -14), barrier="hedge", height="1.2")
    draft.way((-12, -16), (-38, -16), barrier="wall")
    draft.way((-20, -14), (-20, 14), barrier="fence")
    draft.way((-12, 20), (-38, 20), natural="tree_row")
    site = imported(draft, tmp_path)
    assert len([mount for mount in site.mounts if mount.name.startswith("lamp")]) >= 7
    assert all(not mount.name.startswith("pole") for mount in site.mounts)
    assert {"tree", "trunk", "hedge", "wall", "fence", "bench", "post", "kerb"} <= {
        s.kind for s in site.solids
    }
    assert max(s.top for s in of_kind(site, "tree")) == 9.0
    assert max(s.top for s in of_kind(site, "hedge")) == 1.2
