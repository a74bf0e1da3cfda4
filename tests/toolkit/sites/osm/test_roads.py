"""Roads, paths and bridges of an OpenStreetMap extract."""

import numpy as np
import pytest
import shapely

from toolkit.sites.maps import import_osm

CENTRE = (13.4, 52.505)


def test_one_way_and_its_reverse(tmp_path, empty_map, imported):
    for value, sign in (("yes", 1), ("-1", -1)):
        draft = empty_map()
        draft.way((-300, 0), (300, 0), highway="residential", oneway=value, sidewalk="no")
        site = imported(draft, tmp_path)
        (tmp_path / "net.xml").write_text(site.network)
        shapes = [line for line in site.network.splitlines() if "<lane" in line and 'index="0"' in line]
        assert len(shapes) == 1
        first, *_, last = shapes[0].partition('shape="')[2].partition('"')[0].split()
        assert sign * (float(last.split(",")[0]) - float(first.split(",")[0])) > 200


def test_roundabout_and_cycleway(tmp_path, empty_map, imported, on_lanes):
    draft = empty_map()
    ring = [(round(18 * np.cos(a), 2), round(18 * np.sin(a), 2)) for a in np.linspace(0, 2 * np.pi, 17)[:-1]]
    draft.way(*ring, ring[0], highway="tertiary", junction="roundabout")
    for k in (0, 4, 8, 12):
        far = tuple(float(c) * 15 for c in ring[k])
        draft.way(ring[k], far, highway="tertiary")
    draft.way((-200, 30), (200, 30), highway="cycleway")
    site = imported(draft, tmp_path)
    assert not on_lanes(site, 0, 0)
    assert np.mean([on_lanes(site, x, y) for x, y in ring]) == 1
    assert on_lanes(site, 39, 0)


def test_bridges_and_tunnels_leave_the_ground_clear(tmp_path, crossroads, put, on_lanes):
    draft = crossroads()
    draft.way((-200, 20), (200, 20), highway="primary", bridge="yes", layer="1")
    draft.way((-200, -20), (200, -20), highway="primary", tunnel="yes", layer="-1")
    path = put(draft, tmp_path)
    with pytest.warns(UserWarning, match="2 tunnels or bridges over a road were left out"):
        site = import_osm(path, centre=CENTRE, size=(80, 60))
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
    site = imported(draft, tmp_path)
    walk = union(site.footways)
    assert walk.contains(shapely.Point(25, 20))
    assert walk.contains(shapely.Point(-30, 21.3))
    assert not walk.contains(shapely.Point(-30, 22))


def test_streets_that_cross_without_a_junction_keep_their_footways_off_each_other(
    tmp_path, crossroads, imported, on_lanes
):
    draft = crossroads()
    draft.way((-100, -40), (100, 44), highway="tertiary")
    draft.way((20, 30), (20, -30), (21, 30), highway="residential")
    site = imported(draft, tmp_path)
    assert on_lanes(site, 36, 2 + 36 * 0.42 - 0.5)


def test_no_bicycle_on_a_motorway(tmp_path, crossroads, imported):
    draft = crossroads()
    draft.way((-300, 25), (300, 25), highway="motorway", oneway="yes", lanes="3")
    lanes = [lane for lane in imported(draft, tmp_path).network.split("<lane ")[1:] if 'speed="36.1' in lane]
    assert len(lanes) == 3
    assert not any("bicycle" in lane.partition('allow="')[2].partition('"')[0] for lane in lanes)
    assert all("passenger" in lane.partition('allow="')[2].partition('"')[0] for lane in lanes)
