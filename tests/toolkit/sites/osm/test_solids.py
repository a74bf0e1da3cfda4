"""Buildings, barriers, trees and furniture of an OpenStreetMap extract."""

import pytest

from toolkit.sites.maps import import_osm

CENTRE = (13.4, 52.505)


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


def test_building_parts_replace_the_outline_where_they_are(tmp_path, crossroads, imported, top, box):
    draft = crossroads()
    draft.way(*box(15, 15, 35, 25), building="yes", height="8")
    draft.way(*box(15, 15, 25, 25), building__part="yes", height="20")
    site = imported(draft, tmp_path)
    assert top(site, 20, 20) == [20.0]
    assert top(site, 30, 20) == [8.0]


def test_buildings_over_the_road_are_cut_back(tmp_path, crossroads, put, check_site, top, box):
    draft = crossroads()
    draft.way(*box(20, -12, 30, 30), building="yes")
    path = put(draft, tmp_path)
    with pytest.warns(UserWarning, match=r"town\.osm: 1 buildings reached over a road"):
        site = import_osm(path, centre=CENTRE, size=(80, 60))
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
    assert {"tree", "trunk", "hedge", "wall", "fence", "bench", "post", "kerb"} <= {s.kind for s in site.solids}
    assert max(s.top for s in of_kind(site, "tree")) == 9.0
    assert max(s.top for s in of_kind(site, "hedge")) == 1.2
