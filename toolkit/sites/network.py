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

MAX_RUN_S = 60.0  # of netconvert
MAX_MEMORY_BYTES = 1 << 31  # of netconvert
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

XmlAttributes = Mapping[str, Any]
_Rows = Iterable[XmlAttributes]
Polygons = tuple[Float64[np.ndarray, "_ 2"], ...]


def street(
    lanes: int = 1,
    *,
    width: float = 3.5,
    footway: float = 2.0,
    shoulder: float = 0.0,
    speed: float = 13.9,
) -> list[XmlAttributes]:
    """Lanes of one direction, from the kerb inwards."""
    rows: list[XmlAttributes] = [{"width": footway, "allow": FOOT, "speed": 2.8}] if footway else []
    rows += [{"width": shoulder, "disallow": "all", "speed": speed}] if shoulder else []
    return rows + [{"width": width, "allow": MOTOR, "speed": speed} for _ in range(lanes)]


def line(points: Float[np.ndarray, "n 2"] | Sequence[tuple[float, float]]) -> str:
    """Format points as a SUMO shape."""
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in points)


def build_network(nodes: _Rows, edges: _Rows, *, roundabouts: _Rows = ()) -> str:
    """Build the net.xml text of a network. The same rows give the same text.

    nodes: id, x, y, type, radius...; edges: id, from, to, shape, spreadType, priority... and
    `lanes`, a list of rows as `street` makes them; roundabouts: nodes, edges. netconvert guesses
    where pedestrians cross.

    Raises ValueError with netconvert's words if it refuses the rows, ImportError without SUMO."""
    ways = []
    for edge in edges:
        lanes = edge.get("lanes", ())
        inside = "".join(
            format_element("lane", {"index": i, **lane}) for i, lane in enumerate(lanes)
        )
        attributes = {key: value for key, value in edge.items() if key != "lanes"}
        ways.append(format_element("edge", {"numLanes": max(1, len(lanes)), **attributes}, inside))
    ways += [format_element("roundabout", row) for row in roundabouts]
    files = {"node": format_xml("nodes", (format_element("node", row) for row in nodes))}
    files["edge"] = format_xml("edges", ways)
    with tempfile.TemporaryDirectory() as folder:
        for kind, text in files.items():
            Path(folder, kind).write_text(text, encoding="utf-8")
        inputs = [f"--{kind}-files={Path(folder, kind)}" for kind in files]
        return run_netconvert([*inputs, "--crossings.guess"])


def run_netconvert(options: Sequence[str]) -> str:
    """Run netconvert; return the net.xml text without its comments."""
    return run_netconvert_with_warnings(options)[0]


def run_netconvert_with_warnings(options: Sequence[str]) -> tuple[str, list[str]]:
    """Run netconvert; return the net.xml text without its comments, and its warnings."""
    command = [str(netconvert()), *_OPTIONS, *options]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder, "net.xml")
        command = [
            sys.executable,
            "-S",
            "-c",
            _LIMITED,
            str(os.getpid()),
            *command,
            f"--output-file={output}",
        ]
        try:
            run = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=MAX_RUN_S
            )
        except subprocess.TimeoutExpired:
            raise ValueError(
                f"netconvert: no network made in {MAX_RUN_S:g} s: cut out a smaller piece"
            ) from None
        if run.returncode or not output.is_file():
            errors = [text for text in run.stderr.splitlines() if text.startswith("Error")] or [
                "Error: no network made"
            ]
            raise ValueError(f"netconvert: {errors[0].removeprefix('Error: ')}")
        return _COMMENT.sub("", output.read_text(encoding="utf-8")), list_warnings(run.stderr)


def netconvert() -> Path:
    """Path of SUMO's netconvert: in the installed eclipse-sumo, below $SUMO_HOME or on the PATH."""
    package = importlib.util.find_spec("sumo")
    homes = [Path(package.origin).parent] if package and package.origin else []
    homes += [Path(os.environ["SUMO_HOME"])] if "SUMO_HOME" in os.environ else []
    programs = (home / "bin" / "netconvert" for home in homes)
    netconvert_path = next(
        (program for program in programs if program.is_file()), shutil.which("netconvert")
    )
    if not netconvert_path:
        raise ImportError(
            "a road network needs SUMO's netconvert, which is not installed: pip install "
            "coview[sim]"
        )
    return Path(netconvert_path)


def road_polygons(
    network: str, area: Float[np.ndarray, "4"] | Sequence[float], margin: float = 30.0
) -> tuple[Polygons, Polygons]:
    """Road polygons of a net.xml text within `margin` (m) around `area`: for wheels, and for feet.
    Wheels: lanes, shoulders, junctions, crossings; feet: sidewalks, walking areas."""
    xmin, ymin, xmax, ymax = area
    window = shapely.box(xmin - margin, ymin - margin, xmax + margin, ymax + margin)
    lanes: list[shapely.Geometry] = []
    footways: list[shapely.Geometry] = []
    for edge, lane in list_lanes(network, "normal", "crossing", "walkingarea", "connector"):
        users = list_users(lane)
        function = edge.get("function")
        if function == "walkingarea":
            footways.append(enclose(lane))
        elif not users <= _RAIL or not users:
            line = shapely.LineString(parse_shape(lane))
            half = lane_width(lane) / 2
            strip = line.buffer(half, cap_style="flat", join_style="mitre", mitre_limit=2)
            only_feet = (
                function != "crossing" and "pedestrian" in users and "passenger" not in users
            )
            (footways if only_feet else lanes).append(strip)
    corners = shapely.union_all(footways)
    junctions = [
        enclose(j)
        for j in ElementTree.fromstring(network).iter("junction")
        if j.get("type") != "internal"
    ]
    lanes += [junction.difference(corners) for junction in junctions]
    return cut_polygons(lanes, window), cut_polygons(footways, window)


def shoulders(network: str) -> dict[str, tuple[Float64[np.ndarray, "_ 2"], float]]:
    """Strips of a net.xml text without traffic, by edge: middle line (k, 2) as traffic goes, and
    width (m)."""
    unused = [
        (str(edge.get("id")), lane) for edge, lane in list_lanes(network) if not list_users(lane)
    ]
    return {edge: (parse_shape(lane), lane_width(lane)) for edge, lane in unused}


def list_lanes(
    network: str, *functions: str
) -> Iterator[tuple[ElementTree.Element, ElementTree.Element]]:
    """Edges and lanes of a net.xml text. functions: of the edges, normal ones by default."""
    for edge in ElementTree.fromstring(network).iter("edge"):
        if edge.get("function", "normal") in (functions or ("normal",)):
            yield from ((edge, lane) for lane in edge.iter("lane"))


def lane_width(lane: ElementTree.Element) -> float:
    """Width of a lane (m)."""
    return float(lane.get("width", "3.2"))


def list_users(lane: ElementTree.Element) -> set[str]:
    """Users of a net.xml text's lane, in SUMO's words."""
    allowed = set(lane.get("allow", "").split()) or {"all"}
    forbidden = set(lane.get("disallow", "").split())
    if "all" in forbidden:
        return set()
    return (set(f"{MOTOR} {FOOT}".split()) | _RAIL if "all" in allowed else allowed) - forbidden


def enclose(element: ElementTree.Element) -> shapely.Geometry:
    """Area that an element's shape encloses, all parts of it."""
    coordinates = parse_shape(element)
    if len(coordinates) < 3:
        return shapely.Polygon()
    valid = shapely.make_valid(shapely.Polygon(coordinates))
    return valid if "Polygon" in valid.geom_type else shapely.union_all(list_polygons(valid))


def parse_shape(element: ElementTree.Element) -> Float64[np.ndarray, "_ 2"]:
    """Shape (k, 2) of a lane or junction, without heights."""
    points = [p.split(",")[:2] for p in element.get("shape", "").split()]
    return np.array(points, np.float64).reshape(-1, 2)


def unite(polygons: Iterable[Float[np.ndarray, "_ 2"]]) -> shapely.Geometry:
    """Union of outlines."""
    return shapely.union_all([shapely.Polygon(outline) for outline in polygons])


def cut_polygons(shapes: Iterable[shapely.Geometry], window: shapely.Geometry) -> Polygons:
    """Simple polygons of `shapes` in `window`, 0.1 m² and more, on a grid of 1 mm."""
    simple: list[shapely.Polygon] = []
    for shape in shapes:
        for polygon in list_polygons(shapely.set_precision(shape.intersection(window), 1e-3)):
            simple += _without_holes(polygon)
    return tuple(
        shapely.get_coordinates(piece.exterior)[:-1] for piece in simple if piece.area > 0.1
    )


def list_polygons(shape: shapely.Geometry) -> list[shapely.Polygon]:
    """Polygons of any geometry, also of nested collections."""
    return [
        piece
        for piece in shapely.get_parts(shapely.get_parts(shape))
        if piece.geom_type == "Polygon"
    ]


def _without_holes(polygon: shapely.Polygon) -> list[shapely.Polygon]:
    """Cut a polygon through its holes until none is left."""
    if not polygon.interiors:
        return [polygon]
    x = shapely.Polygon(polygon.interiors[0]).centroid.x
    xmin, ymin, xmax, ymax = polygon.bounds
    pieces: list[shapely.Polygon] = []
    for side in (shapely.box(xmin, ymin, x, ymax), shapely.box(x, ymin, xmax, ymax)):
        for half in list_polygons(polygon.intersection(side)):
            pieces += _without_holes(half)
    return pieces


def format_xml(root: str, elements: Iterable[str]) -> str:
    """XML text of a root with elements, one a line."""
    return f"<{root}>\n" + "\n".join(elements) + f"\n</{root}>\n"


def format_element(tag: str, attributes: XmlAttributes, inside: str = "") -> str:
    """XML text of an element."""
    written = " ".join(f"{key}={_quote(str(value))}" for key, value in attributes.items())
    return f"<{tag} {written}>{inside}</{tag}>"


def _quote(text: str) -> str:
    return quoteattr(text) if _SPECIAL.search(text) else f'"{text}"'
