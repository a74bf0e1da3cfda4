"""Elements of OpenStreetMap files: XML, packed or not, or JSON of Overpass.

Only a file that is no map, or one beyond the limits below, is refused.
https://wiki.openstreetmap.org/wiki/OSM_XML https://wiki.openstreetmap.org/wiki/OSM_JSON"""

import bz2
import gzip
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast
from xml.etree import ElementTree

from toolkit.runtime.text_values import parse_json

MAX_MAP_BYTES = 1 << 26  # 64 MiB, unpacked
MAX_ELEMENT_TAGS = 200_000  # in one element of the map
MAX_SILENT_BYTES = 1 << 22  # 4 MiB without a tag

_CHUNK_BYTES = 1 << 20
_HEAD_BYTES = 65536
_OTHER_KINDS = (".pbf", ".o5m", ".o5c", ".zip", ".7z", ".osc", ".osh", ".geojson", ".shp", ".gpkg")
# kind of a file that is no XML: bytes among its first 32
_SIGNATURES = {
    "OSM PBF": b"OSMHeader",
    "o5m": b"o5m2",
    "a zip file": b"PK\x03\x04",
    "SQLite": b"SQLite format 3",
}
_KINDS_IN_XML = ("node", "way", "relation", "bounds")
_KINDS_IN_JSON = ("node", "way", "relation")


def read_elements(path: Path) -> Iterator[ElementTree.Element]:
    """Yield the nodes, ways, relations and bounds of a map file as XML elements, in its order.

    An element is emptied when the next one is read. Raises ValueError if the file is no map, is
    damaged or exceeds a limit."""
    name = path.name.lower().removesuffix(".gz").removesuffix(".bz2")
    if name.endswith(_OTHER_KINDS):
        formats = "only .osm, .osm.xml and .osm.gz are read, also as .bz2, and JSON of Overpass"
        raise ValueError(f"{path}: {formats}: convert it first (osmium cat -o map.osm)")
    try:
        with _open(path) as stream:
            head = stream.read(_HEAD_BYTES)
        is_json = head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")
        yield from _read_json(path) if is_json else _read_xml(path, head)
    except (ElementTree.ParseError, LookupError) as error:
        raise ValueError(f"{path}: damaged XML ({error}): download the map again") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: damaged gzip file ({error}): download the map again") from None


def _open(path: Path) -> BinaryIO:
    """Open a file, packed by gzip or bzip2 or not, to read its content."""
    with path.open("rb") as stream:
        signature = stream.read(3)
    if signature[:2] == b"\x1f\x8b":
        return cast("BinaryIO", gzip.open(path))
    return cast("BinaryIO", bz2.open(path) if signature == b"BZh" else path.open("rb"))


@dataclass
class _Consumption:
    """Bytes and tags of an XML file that were read so far, held against the limits.

    Attributes:
        total_bytes: bytes of the file.
        silent_bytes: bytes since the last tag.
        element_tags: tags since the last element of the map."""

    total_bytes: int = 0
    silent_bytes: int = 0
    element_tags: int = 0

    def add_chunk(self, size_bytes: int) -> None:
        """Count a chunk of the file."""
        self.total_bytes += size_bytes
        self.silent_bytes += size_bytes

    def add_tag(self) -> None:
        """Count a tag, which ends a silence."""
        self.silent_bytes = 0
        self.element_tags += 1

    def check(self, path: Path) -> None:
        """Raise ValueError, which names the file, if a count is beyond its limit."""
        if (
            self.total_bytes > MAX_MAP_BYTES
            or self.silent_bytes > MAX_SILENT_BYTES
            or self.element_tags > MAX_ELEMENT_TAGS
        ):
            limits = (  # bytes >> 20 are MiB
                f"{MAX_MAP_BYTES >> 20} MB, {MAX_SILENT_BYTES >> 20} MB without a tag or "
                f"{MAX_ELEMENT_TAGS} tags in an element"
            )
            raise ValueError(
                f"{path}: more than {limits}: cut out the site first (osmium extract --bbox)"
            )


def _read_xml(path: Path, head: bytes) -> Iterator[ElementTree.Element]:
    """Yield the nodes, ways and relations of an XML file, each whole, as it is read.

    head: its first bytes, unpacked."""
    _check_xml(path, head)
    parser: ElementTree.XMLPullParser[ElementTree.Element] = ElementTree.XMLPullParser(
        ("start", "end")
    )
    root: ElementTree.Element | None = None
    consumption = _Consumption()
    with _open(path) as stream:
        while chunk := stream.read(_CHUNK_BYTES):
            parser.feed(chunk)
            consumption.add_chunk(len(chunk))
            events = cast("Iterable[tuple[str, ElementTree.Element]]", parser.read_events())
            for event, element in events:
                # the first tag to start is the root's
                if root is None:
                    root = element
                consumption.add_tag()
                if event == "end" and element.tag == "remark":
                    _check_remark(path, element.text)
                if event == "end" and element.tag in _KINDS_IN_XML:
                    yield element
                    root.clear()  # releases the elements read so far
                    consumption.element_tags = 0  # counts the tags within one element
            consumption.check(path)
    parser.close()


def _check_xml(path: Path, head: bytes) -> None:
    """Raise ValueError for a file that is no OpenStreetMap XML, or has a DOCTYPE.

    head: its first bytes, unpacked."""
    for kind, signature in _SIGNATURES.items():
        if signature in head[:32]:
            raise ValueError(
                f"{path}: the file is {kind}: convert it first (osmium cat -o map.osm)"
            )
    first_tag = re.search(rb"<(?!\?|!)", head)  # after <?xml ...?>, comments and <!DOCTYPE ...>
    is_map = first_tag is not None and re.match(rb"<osm[\s>]", head[first_tag.start() :])
    has_doctype = first_tag is not None and b"<!DOCTYPE" in head[: first_tag.start()]
    if not is_map or has_doctype:
        raise ValueError(
            f"{path}: not OpenStreetMap XML (it does not begin with <osm>): export the map as .osm"
        )


def _check_remark(path: Path, remark: object) -> None:
    """Raise ValueError for a remark of the server Overpass that it could not finish.

    All other remarks pass. remark: text, or another value for a file without one."""
    if remark and "error" in str(remark).lower():
        words = " ".join(str(remark).split())[:90]
        raise ValueError(
            f"{path}: the map is incomplete ({words}): ask Overpass again, for a smaller piece"
        )


def _read_json(path: Path) -> Iterator[ElementTree.Element]:
    """Yield the elements of Overpass's JSON as XML elements of the same content."""
    with _open(path) as stream:
        # one more byte shows that it is too large
        content = stream.read(MAX_MAP_BYTES + 1)
    if len(content) > MAX_MAP_BYTES:
        raise ValueError(
            f"{path}: more than {MAX_MAP_BYTES >> 20} MB: cut out the site first (osmium extract "
            "--bbox)"
        )
    try:
        document = parse_json(content.decode("utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"{path}: damaged JSON ({error}): download the map again") from None
    rows = document.get("elements") if isinstance(document, dict) else None
    if not isinstance(rows, list):
        raise ValueError(
            f"{path}: not OpenStreetMap JSON (it has no list of elements): export the map as .osm"
        )
    _check_remark(path, document.get("remark"))
    for row in rows:
        if isinstance(row, dict) and row.get("type") in _KINDS_IN_JSON:
            yield _convert_row(row)


def _convert_row(row: Mapping[str, Any]) -> ElementTree.Element:
    """Make the XML element of a node, way or relation that is an entry of Overpass's JSON."""
    attributes = {key: str(row[key]) for key in ("id", "lat", "lon", "visible") if key in row}
    if row.get("visible") is False:
        attributes["visible"] = "false"  # as in XML, and not "False"
    element = ElementTree.Element(str(row["type"]), attributes)
    tags = row.get("tags") or ()
    if isinstance(tags, dict):
        for key, value in tags.items():
            ElementTree.SubElement(element, "tag", {"k": str(key), "v": str(value)})
    _add_nodes(element, row.get("nodes") or (), row.get("geometry") or ())
    for member in row.get("members") or ():
        if isinstance(member, dict):
            values = {key: str(member.get(key, "")) for key in ("type", "ref", "role")}
            ElementTree.SubElement(element, "member", values)
    return element


def _add_nodes(element: ElementTree.Element, nodes: Any, positions: Any) -> None:
    """Add a way's nodes to its element: ids, and positions if Overpass gave them ("out geom").

    nodes: list of ids; positions: list of dicts with lat and lon, or of null; either may be empty
    or shorter. A node without an id is named by its position."""
    for k in range(max(len(nodes), len(positions))):
        position = positions[k] if k < len(positions) and isinstance(positions[k], dict) else {}
        lat_lon = {key: str(position[key]) for key in ("lat", "lon") if key in position}
        name = str(nodes[k]) if k < len(nodes) else " ".join(lat_lon.values())
        ElementTree.SubElement(element, "nd", {"ref": name, **lat_lon})
