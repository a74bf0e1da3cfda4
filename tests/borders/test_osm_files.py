"""Kinds of OpenStreetMap files: XML, compressed, JSON of Overpass, drafts of JOSM, cut and
incomplete ones.

https://wiki.openstreetmap.org/wiki/OSM_XML, .../OSM_JSON, .../JOSM_file_format,
.../Overpass_API/Overpass_QL (out)."""

import bz2
import gzip
import json
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from toolkit.sites.georeference import inverse_project
from toolkit.sites.maps.osm_site import import_osm
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.osm.map_reader import read_map

CENTRE = (8.0, 49.5)
SPOTS = {1: (0, 0), 2: (-150, 0), 3: (150, 0), 4: (0, 150), 5: (0, -150)}
WAYS = {
    11: ((2, 1, 3), {"highway": "secondary", "maxspeed": "50"}),
    12: ((4, 1, 5), {"highway": "residential"}),
}


def degrees(number: int) -> dict[str, float]:
    ((longitude, latitude),) = inverse_project(np.array([SPOTS[number]], float), CENTRE)
    return {"lat": round(float(latitude), 8), "lon": round(float(longitude), 8)}


def xml(*more: str, nodes=SPOTS, sign: int = 1) -> str:
    text = ['<osm version="0.6" generator="hand">']
    for number in nodes:
        at = degrees(number)
        text.append(f'<node id="{sign * number}" lat="{at["lat"]}" lon="{at["lon"]}"/>')
    for number, (references, tags) in WAYS.items():
        inside = "".join(f'<nd ref="{sign * k}"/>' for k in references)
        inside += "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
        text.append(f'<way id="{sign * number}">{inside}</way>')
    return "\n".join([*text, *more, "</osm>"])


def overpass(*, geometry: bool = False, **members) -> str:
    elements = [] if geometry else [{"type": "node", "id": k, **degrees(k)} for k in SPOTS]
    for number, (references, tags) in WAYS.items():
        way = {"type": "way", "id": number, "nodes": list(references), "tags": tags}
        elements.append({**way, "geometry": [degrees(k) for k in references]} if geometry else way)
    return json.dumps(
        {"version": 0.6, "generator": "Overpass API", "elements": elements, **members}
    )


def import_text(folder: Path, name: str, content: str | bytes):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        site = import_osm(MapPiece(path, CENTRE, (80, 80)))
    return site, "\n".join(str(each.message) for each in caught)


def test_all_kinds_give_the_same_network(tmp_path: Path):
    plain, _ = import_text(tmp_path, "town.osm", xml())
    kinds: dict[str, str | bytes] = {
        "town.osm.gz": gzip.compress(xml().encode(), mtime=0),
        "town.osm.bz2": bz2.compress(xml().encode()),
        "bom.osm": b"\xef\xbb\xbf" + xml().encode(),
        "town.json": overpass(),
        "geometry.json": overpass(geometry=True),
        "draft.osm": xml(sign=-1),
        "out-geom.osm": "\n".join(
            [
                '<osm version="0.6">',
                *(
                    f'<way id="{number}">'
                    + "".join(
                        f'<nd ref="{k}" lat="{degrees(k)["lat"]}" lon="{degrees(k)["lon"]}"/>'
                        for k in nodes
                    )
                    + "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
                    + "</way>"
                    for number, (nodes, tags) in WAYS.items()
                ),
                "</osm>",
            ]
        ),
    }
    for name, content in kinds.items():
        site, notes = import_text(tmp_path, name, content)
        assert site.network == plain.network, name
        assert not notes, name


def test_deleted_elements_are_no_part_of_the_map(tmp_path: Path):
    extra = (
        (
            '<way id="13" action="delete"><nd ref="4"/><nd ref="3"/><tag k="highway" '
            'v="primary"/></way>'
        ),
        (
            '<way id="14" visible="false"><nd ref="4"/><nd ref="2"/><tag k="highway" '
            'v="primary"/></way>'
        ),
        '<way id="15"><nd ref="5"/><nd ref="2"/><tag k="highway" v="primary"/></way>',
        '<way id="15" version="2" visible="false"/>',  # a later version, as in a file with history
    )
    plain, _ = import_text(tmp_path, "town.osm", xml())
    assert import_text(tmp_path, "town.osm", xml(*extra))[0].network == plain.network


def test_a_way_is_cut_at_nodes_that_are_missing(tmp_path: Path):
    text = xml().replace('<nd ref="2"/><nd ref="1"/>', '<nd ref="2"/><nd ref="77"/><nd ref="1"/>')
    site, notes = import_text(tmp_path, "town.osm", text)
    assert "1 roads lack nodes on their way, and are cut there" in notes
    edges = {
        edge.get("from")
        for edge in ElementTree.fromstring(site.network).iter("edge")
        if edge.get("from")
    }
    assert len(edges) == 4  # the road from node 2 has one node left, so it ends at node 1
    assert (
        "lack nodes" not in import_text(tmp_path, "town.osm", xml(nodes=[1, 3, 4, 5]))[1]
    )  # cut off at the end


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        (
            "town.osm.pbf",
            b"\x00\x00\x00\x0d\x0a\x09OSMHeader",
            r"only \.osm.* are read.*osmium cat",
        ),
        ("town.osc.gz", gzip.compress(b"<osmChange/>", mtime=0), r"only \.osm.* are read"),
        (
            "really-pbf.osm",
            b"\x00\x00\x00\x0d\x0a\x09OSMHeader",
            "the file is OSM PBF: convert it first",
        ),
        ("really-zip.osm", b"PK\x03\x04" + bytes(60), "the file is a zip file"),
        ("history.osh", xml(), r"only \.osm.* are read"),
        ("change.osm", "<osmChange version='0.6'></osmChange>", r"does not begin with <osm>"),
        ("town.json", '{"type": "FeatureCollection", "features": []}', "has no list of elements"),
        ("town.json", '{"version": 0.6, "elements": [', "damaged JSON"),
        ("town.json", overpass(remark="runtime error: Query timed out"), "map is incomplete"),
        (
            "town.osm",
            xml("<remark> runtime error: Query ran out of memory </remark>"),
            "map is incomplete",
        ),
        ("town.json", '{"elements": []}', "the map is empty"),
    ],
)
def test_other_kinds_are_refused_by_name(tmp_path: Path, name, content, reason):
    with pytest.raises(ValueError, match=reason):
        import_text(tmp_path, name, content)


def test_numbers_of_json_may_be_negative_or_text(tmp_path: Path):
    rows = [
        {"type": "node", "id": -k, **{key: str(value) for key, value in degrees(k).items()}}
        for k in SPOTS
    ]
    rows.append({"type": "way", "id": -11, "nodes": [-2, -1, -3], "tags": {"highway": "secondary"}})
    path = tmp_path / "town.json"
    path.write_text(json.dumps({"elements": rows}), "utf-8")
    extract = read_map(path, CENTRE)
    assert [way.nodes for way in extract.ways] == [("-2", "-1", "-3")]
    assert extract.ways[0].line == pytest.approx(
        np.array([[-150.0, 0.0], [0.0, 0.0], [150.0, 0.0]]), abs=2e-3
    )


def centred(folder: Path, centre, size=(20, 20)) -> str:
    """What is said of a piece about a centre that has no road."""
    path = folder / "town.osm"
    footway = '<way id="20"><nd ref="4"/><nd ref="3"/><tag k="highway" v="footway"/></way>'
    path.write_text(xml(footway), "utf-8")
    with pytest.raises(ValueError, match=r"town\.osm") as raised:
        import_osm(MapPiece(path, centre, size))
    return str(raised.value)


def test_remedies_name_what_was_found(tmp_path: Path):
    assert "longitude comes first, give --centre 8 49.5" in centred(tmp_path, CENTRE[::-1])
    assert "not metres of a projection" in centred(tmp_path, (427590.0, 5483530.0))
    ((longitude, latitude),) = inverse_project(np.array([[140.0, 140.0]]), CENTRE)
    said = centred(tmp_path, (longitude, latitude))
    assert "no road within the area" in said
    assert "there is 1 footway; the nearest road is 140 m away, at 8.0" in said
    ((longitude, latitude),) = inverse_project(np.array([[40.0, 40.0]]), CENTRE)
    assert "nothing is tagged highway there; the nearest road is 40 m away" in centred(
        tmp_path, (longitude, latitude)
    )


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", ["a,b.osm", "Straße;5 (neu).osm", "信号 灯.osm", "-x=y.osm"])
def test_a_file_may_have_any_name(tmp_path: Path, name):
    """netconvert's options part lists of files at commas."""
    site, _ = import_text(tmp_path, name, xml())
    assert site.name == name.removesuffix(".osm")
    assert len(site.lanes) > 2
