"""Road networks, made by SUMO's netconvert of maps or of plain nodes and edges, and road surfaces.

Plain input is rows of attributes, named as SUMO's plain XML names them, in site coordinates.
https://sumo.dlr.de/docs/Networks/PlainXML.html"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites.netconvert_warnings import list_warnings

MOTOR = "passenger taxi bus coach delivery truck emergency motorcycle moped bicycle"
FOOT = "pedestrian"
_RAIL = {"tram", "rail", "rail_urban", "rail_electric", "rail_fast", "subway", "cable_car", "ship"}
_SPECIAL = re.compile(r"""[&<>"'\s]""")  # in an attribute of XML
_COMMENT = re.compile(r"<!--.*?-->\s*", re.DOTALL)
# options of netconvert for every network
_OPTIONS = (
    "--offset.disable-normalization",
    "--no-turnarounds",
    "--walkingareas",
    "--precision=3",
    "--junctions.corner-detail=6",
    "--junctions.internal-link-detail=20",
    "--default.lanewidth=3.5",
    "--aggregate-warnings=-1",
)

MAX_RUN_S = 60.0  # limit for netconvert
MAX_MEMORY_BYTES = 1 << 31  # limit for netconvert
# program that runs netconvert (argv[2:]) with limited memory, unless the parent (process argv[1])
# is gone
_LIMITED = f"""
import os, sys
try:
    import ctypes, resource
    resource.setrlimit(resource.RLIMIT_AS, ({MAX_MEMORY_BYTES}, {MAX_MEMORY_BYTES}))
    ctypes.CDLL(None).prctl(1, 9)  # Linux: to be killed when the parent dies
except Exception:
    pass
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""

XmlAttributes = Mapping[str, Any]  # attributes of one XML element by name
_Rows = Iterable[XmlAttributes]
Polygons = tuple[Float64[np.ndarray, "_ 2"], ...]  # simple, without holes; corners x, y (m)


def street(
    lanes: int = 1,
    *,
    width: float = 3.5,
    footway: float = 2.0,
    shoulder: float = 0.0,
    speed: float = 13.9,
) -> list[XmlAttributes]:
    """Attributes of SUMO's lanes of one direction, from the kerb inwards.

    A row for the footway comes first, then one for the shoulder, then one for each lane. lanes:
    number of lanes for vehicles; width, footway, shoulder: widths (m) of one lane, of the footway
    and of a strip without traffic, 0 to leave out footway or strip; speed: limit (m/s)."""
    rows: list[XmlAttributes] = []
    if footway:
        rows.append({"width": footway, "allow": FOOT, "speed": 2.8})  # m/s, some 10 km/h
    if shoulder:
        rows.append({"width": shoulder, "disallow": "all", "speed": speed})
    return rows + [{"width": width, "allow": MOTOR, "speed": speed} for _ in range(lanes)]


def line(points: Float[np.ndarray, "n 2"] | Sequence[tuple[float, float]]) -> str:
    """Format points x, y (m) as the text of a SUMO shape, on millimetres."""
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in points)


def build_network(nodes: _Rows, edges: _Rows, *, roundabouts: _Rows = ()) -> str:
    """Build the net.xml text of a network. The same rows give the same text.

    Each argument is rows of attributes, named as SUMO's plain XML names them. nodes: id, x, y,
    type, radius...; edges: id, from, to, shape, spreadType, priority... and `lanes`, a list of rows
    from the kerb inwards; roundabouts: nodes, edges. netconvert guesses where pedestrians cross.

    Raises ValueError with netconvert's words if it refuses the rows, ImportError without SUMO."""
    node_elements = [format_element("node", row) for row in nodes]
    edge_elements = []
    for edge in edges:
        lanes = edge.get("lanes", ())
        lane_elements = [
            format_element("lane", {"index": i, **lane}) for i, lane in enumerate(lanes)
        ]
        attributes = {key: value for key, value in edge.items() if key != "lanes"}
        attributes = {"numLanes": max(1, len(lanes)), **attributes}
        edge_elements.append(format_element("edge", attributes, "".join(lane_elements)))
    # SUMO expects roundabouts in the file of the edges
    edge_elements += [format_element("roundabout", row) for row in roundabouts]
    with tempfile.TemporaryDirectory() as folder:
        node_file = Path(folder, "node")
        node_file.write_text(format_xml("nodes", node_elements), encoding="utf-8")
        edge_file = Path(folder, "edge")
        edge_file.write_text(format_xml("edges", edge_elements), encoding="utf-8")
        inputs = [f"--node-files={node_file}", f"--edge-files={edge_file}"]
        return run_netconvert([*inputs, "--crossings.guess"])


def run_netconvert(options: Sequence[str]) -> str:
    """Run netconvert with the usual options and then `options`; return the net.xml text.

    Its comments, which hold the date and paths, are removed. Raises ValueError with netconvert's
    words if it makes no network, ImportError without SUMO."""
    return run_netconvert_with_warnings(options)[0]


def run_netconvert_with_warnings(options: Sequence[str]) -> tuple[str, list[str]]:
    """Run netconvert with some options; return the net.xml text and netconvert's warnings.

    The warnings are lines without their prefix. Raises the errors of `run_netconvert`."""
    netconvert_command = [str(netconvert()), *_OPTIONS, *options]
    # a small Python program that limits its memory and then becomes netconvert; -S: no packages
    launcher = [sys.executable, "-S", "-c", _LIMITED, str(os.getpid())]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder, "net.xml")
        command = [*launcher, *netconvert_command, f"--output-file={output}"]
        try:
            run = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=MAX_RUN_S
            )
        except subprocess.TimeoutExpired:
            raise ValueError(
                f"netconvert: no network made in {MAX_RUN_S:g} s: cut out a smaller piece"
            ) from None
        if run.returncode or not output.is_file():
            errors = [text for text in run.stderr.splitlines() if text.startswith("Error")]
            first_error = errors[0] if errors else "Error: no network made"
            raise ValueError(f"netconvert: {first_error.removeprefix('Error: ')}")
        network = _COMMENT.sub("", output.read_text(encoding="utf-8"))
        return network, list_warnings(run.stderr)


def netconvert() -> Path:
    """Path of SUMO's netconvert: in the installed eclipse-sumo, below $SUMO_HOME or on the PATH.

    Raises ImportError if it is nowhere."""
    homes = []  # folders of SUMO installations
    package = importlib.util.find_spec("sumo")
    if package and package.origin:
        homes.append(Path(package.origin).parent)
    if "SUMO_HOME" in os.environ:
        homes.append(Path(os.environ["SUMO_HOME"]))
    for home in homes:
        program = home / "bin" / "netconvert"
        if program.is_file():
            return program
    program_on_path = shutil.which("netconvert")
    if not program_on_path:
        raise ImportError(
            "a road network needs SUMO's netconvert, which is not installed: pip install "
            "coview[sim]"
        )
    return Path(program_on_path)


def road_polygons(
    network: str, area: Float[np.ndarray, "4"] | Sequence[float], margin: float = 30.0
) -> tuple[Polygons, Polygons]:
    """Ground of the lanes, and of the footways, in a net.xml text.

    Lanes include shoulders, junctions and crossings; footways are sidewalks and walking areas.
    Polygons are cut at the edge of a window. area: xmin ymin xmax ymax (m); margin: m from the area
    to the edge of the window."""
    xmin, ymin, xmax, ymax = area
    window = shapely.box(xmin - margin, ymin - margin, xmax + margin, ymax + margin)
    lanes: list[shapely.Geometry] = []
    footways: list[shapely.Geometry] = []
    for edge, lane in list_lanes(network, "normal", "crossing", "walkingarea", "connector"):
        users = list_users(lane)
        function = edge.get("function")
        if function == "walkingarea":
            footways.append(enclose(lane))
        elif not users <= _RAIL or not users:  # no lanes of trains only; without users: a shoulder
            middle = shapely.LineString(parse_shape(lane))
            half_width = lane_width(lane) / 2
            strip = middle.buffer(half_width, cap_style="flat", join_style="mitre", mitre_limit=2)
            is_for_feet = "pedestrian" in users and "passenger" not in users
            if is_for_feet and function != "crossing":
                footways.append(strip)
            else:
                lanes.append(strip)
    footway_ground = shapely.union_all(footways)
    for junction in ElementTree.fromstring(network).iter("junction"):
        if junction.get("type") != "internal":  # internal: no junction, but a place within one
            lanes.append(enclose(junction).difference(footway_ground))
    return cut_polygons(lanes, window), cut_polygons(footways, window)


def shoulders(network: str) -> dict[str, tuple[Float64[np.ndarray, "_ 2"], float]]:
    """Strips without traffic of a net.xml text, by the id of their edge.

    Each is its middle line, points x, y (m) in the direction of the edge's traffic, and its width
    (m). If an edge has two strips, the inner one counts."""
    strips = {}
    for edge, lane in list_lanes(network):  # from the kerb inwards: a later strip replaces it
        if not list_users(lane):
            strips[str(edge.get("id"))] = (parse_shape(lane), lane_width(lane))
    return strips


def list_lanes(
    network: str, *functions: str
) -> Iterator[tuple[ElementTree.Element, ElementTree.Element]]:
    """Yield edge and lane for each lane of a net.xml text, from the kerb inwards on each edge.

    functions: SUMO's functions of the edges to take, such as "internal" for edges within junctions;
    only "normal" ones if none is given."""
    for edge in ElementTree.fromstring(network).iter("edge"):
        if edge.get("function", "normal") in (functions or ("normal",)):
            for lane in edge.iter("lane"):
                yield edge, lane


def lane_width(lane: ElementTree.Element) -> float:
    """Width of a lane (m); 3.2 m, SUMO's default, for a lane without one."""
    return float(lane.get("width", "3.2"))


def list_users(lane: ElementTree.Element) -> set[str]:
    """Vehicle classes of SUMO that may use a lane, pedestrians and trains included.

    A lane without rules is open to all; the empty set is a lane without traffic."""
    allowed_users = set(lane.get("allow", "").split()) or {"all"}
    forbidden_users = set(lane.get("disallow", "").split())
    if "all" in forbidden_users:
        return set()
    if "all" in allowed_users:
        allowed_users = set(f"{MOTOR} {FOOT}".split()) | _RAIL
    return allowed_users - forbidden_users


def enclose(element: ElementTree.Element) -> shapely.Geometry:
    """Area that the shape of a lane or junction encloses, empty below three corners.

    A shape that crosses itself gives the union of all its parts."""
    corners = parse_shape(element)
    if len(corners) < 3:
        return shapely.Polygon()
    valid_shape = shapely.make_valid(shapely.Polygon(corners))
    if valid_shape.geom_type in ("Polygon", "MultiPolygon"):
        return valid_shape
    return shapely.union_all(list_polygons(valid_shape))  # without its lines and points


def parse_shape(element: ElementTree.Element) -> Float64[np.ndarray, "_ 2"]:
    """Points x, y (m) of the shape of a lane or junction, (k, 2), without heights.

    (0, 2) for an element without a shape."""
    points = [text.split(",")[:2] for text in element.get("shape", "").split()]
    return np.array(points, np.float64).reshape(-1, 2)


def unite(polygons: Iterable[Float[np.ndarray, "_ 2"]]) -> shapely.Geometry:
    """Union of the ground within outlines, each of corners x, y (m)."""
    return shapely.union_all([shapely.Polygon(outline) for outline in polygons])


def cut_polygons(shapes: Iterable[shapely.Geometry], window: shapely.Geometry) -> Polygons:
    """Corners x, y (m) of the simple polygons of `shapes` within `window`, on a grid of 1 mm.

    Shapes with holes are cut in several; pieces of 0.1 m² and less are left out."""
    pieces: list[shapely.Polygon] = []
    for shape in shapes:
        for polygon in list_polygons(shapely.set_precision(shape.intersection(window), 1e-3)):
            pieces += _cut_through_holes(polygon)
    # [:-1]: the last corner repeats the first
    return tuple(
        shapely.get_coordinates(piece.exterior)[:-1] for piece in pieces if piece.area > 0.1
    )


def list_polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Polygons of any geometry, also of nested collections."""
    return [
        piece
        for piece in shapely.get_parts(shapely.get_parts(shape))
        if piece.geom_type == "Polygon"
    ]


def _cut_through_holes(polygon: shapely.Polygon) -> list[shapely.Polygon]:
    """Cut a polygon through its holes until no hole is left; return the pieces."""
    if not polygon.interiors:
        return [polygon]
    # the cut runs along y through the first hole
    cut_x = shapely.Polygon(polygon.interiors[0]).centroid.x
    xmin, ymin, xmax, ymax = polygon.bounds
    pieces: list[shapely.Polygon] = []
    for side in (shapely.box(xmin, ymin, cut_x, ymax), shapely.box(cut_x, ymin, xmax, ymax)):
        for half in list_polygons(polygon.intersection(side)):
            pieces += _cut_through_holes(half)
    return pieces


def format_xml(root: str, elements: Iterable[str]) -> str:
    """XML text of a root element with elements, which are XML texts, one on each line.

    root: tag of the root."""
    return f"<{root}>\n" + "\n".join(elements) + f"\n</{root}>\n"


def format_element(tag: str, attributes: XmlAttributes, inside: str = "") -> str:
    """XML text of an element with quoted attributes. inside: XML text of its content."""
    written = " ".join(f"{key}={_quote(str(value))}" for key, value in attributes.items())
    return f"<{tag} {written}>{inside}</{tag}>"


def _quote(text: str) -> str:
    # Value of an attribute in quotes, escaped only if it needs to be.
    return quoteattr(text) if _SPECIAL.search(text) else f'"{text}"'
