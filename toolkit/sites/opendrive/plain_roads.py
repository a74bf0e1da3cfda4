"""Text of a road for netconvert: links, geometry and lanes in OpenDRIVE 1.4."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from xml.etree import ElementTree

from toolkit.sites.network import format_element
from toolkit.sites.opendrive.carriageways import Carriageway, PlainWriter
from toolkit.sites.opendrive.cubics import read_cubics, read_number
from toolkit.sites.opendrive.plain_lanes import write_cubics, write_sections
from toolkit.sites.opendrive.plain_links import find_links
from toolkit.sites.opendrive.plain_names import name_junction
from toolkit.sites.opendrive.plain_signals import write_plain_signals

MIN_CURVATURE_PER_M = 1e-10  # less curvature is ignored
MIN_GEOMETRY_M = 1e-6  # a shorter piece of a reference line is left out

_GEOMETRY_KEYS = ("s", "x", "y", "hdg", "length")
# shape of a <geometry>: its numbers
_SHAPE_KEYS: dict[str, tuple[str, ...]] = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}


def write_plain_road(
    writer: PlainWriter, road: Carriageway, left_out: Collection[str], defaults: Mapping[str, float]
) -> str:
    """Text of the <road> of OpenDRIVE 1.4 for a carriageway.

    writer: the uses of lanes and the problems are added to it; left_out: ids of junctions that
    netconvert does not get; defaults: limits (m/s) by type of road."""
    # id of the road in the file, which may be several carriageways; `road.name` is the new id
    file_id = road.element.get("id", "")
    problems = writer.problems[file_id]
    is_first = writer.roads[file_id][0] is road
    # problems of links and signals count once for a road, however many carriageways it has
    links = dict(find_links(writer, road, left_out, problems if is_first else Counter()))
    row = {
        "id": road.name,
        "length": road.length,
        "name": road.element.get("name", ""),
        "junction": "-1" if road.junction == "-1" else name_junction(road.junction),
    }
    parts = []  # texts of the elements in the <road>
    if links:
        link_texts = [link.write(direction) for direction, link in links.items()]
        parts.append(format_element("link", {}, "".join(link_texts)))
    parts.append(format_element("planView", {}, "".join(_write_geometry(road.element))))
    heights = read_cubics(road.element.findall("elevationProfile/elevation"))
    parts.append(format_element("elevationProfile", {}, write_cubics("elevation", "s", heights)))
    offset = write_cubics("laneOffset", "s", road.offset)
    sections = "".join(write_sections(writer, road, links, defaults, problems))
    parts.append(format_element("lanes", {}, offset + sections))
    if is_first:
        signals = "".join(write_plain_signals(road.element, writer.sign))
        parts.append(format_element("signals", {}, signals))
    return format_element("road", row, "".join(parts))


def _write_geometry(road: ElementTree.Element) -> Iterator[str]:
    """Yield the texts of the <geometry> elements of a <road>, in order of s.

    Elements without length are left out, unless all are."""
    pieces = sorted(road.findall("planView/geometry"), key=lambda piece: read_number(piece, "s"))
    long_pieces = [piece for piece in pieces if read_number(piece, "length") > MIN_GEOMETRY_M]
    for piece in long_pieces or pieces[:1]:
        row: dict[str, object] = {key: read_number(piece, key) for key in _GEOMETRY_KEYS}
        shapes = [child for child in piece if child.tag in _SHAPE_KEYS]
        shape = shapes[0] if shapes else ElementTree.Element("line")
        yield format_element("geometry", row, _write_shape(shape))


def _write_shape(shape: ElementTree.Element) -> str:
    """Text of the shape inside a <geometry>.

    Spirals of even curvature become arcs, and arcs that do not bend become lines, since netconvert
    takes such bends for none."""
    kind = shape.tag
    values = {key: read_number(shape, key, 0.0) for key in _SHAPE_KEYS[kind]}
    if kind == "spiral":
        change = abs(values["curvEnd"] - values["curvStart"])
        if change < MIN_CURVATURE_PER_M:
            kind = "arc"
            values = {"curvature": values["curvStart"]}
    if kind == "arc" and abs(values["curvature"]) < MIN_CURVATURE_PER_M:
        kind = "line"
        values = {}
    attributes: dict[str, object] = {**values}
    if kind == "paramPoly3":
        is_length = shape.get("pRange") == "arcLength"
        attributes["pRange"] = "arcLength" if is_length else "normalized"
    return format_element(kind, attributes)
