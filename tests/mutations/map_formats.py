"""A small OpenDRIVE map, its reading, and damage that knows maps: units, frames, offsets, sides of
the road."""

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely
from mutants import Mutation

from toolkit.runtime.reading import name_errors
from toolkit.sites.maps.piece import MapPiece
from toolkit.sites.opendrive.ground_plane import find_plane
from toolkit.sites.opendrive.lane_surfaces import outline_lanes
from toolkit.sites.opendrive.map_file import read_opendrive
from toolkit.sites.opendrive.map_problems import describe_problems
from toolkit.sites.opendrive.map_projection import find_placement, find_projection
from toolkit.sites.opendrive.map_roads import find_near_roads
from toolkit.sites.opendrive.plain_map import write_plain
from toolkit.sites.opendrive.road_objects import read_road_objects

_REFERENCE = "<geoReference>+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs</geoReference>"
_ROAD = (
    '<road name="" length="{length}" id="{i}" junction="-1" rule="RHT"><link><successor '
    'elementType="junction" elementId="9"/></link><type s="0" type="town"><speed max="50" '
    'unit="km/h"/></type><planView><geometry s="0" x="{x}" y="{y}" hdg="{hdg}" '
    'length="{length}"><line/></geometry></planView><elevationProfile><elevation s="0" a="0" '
    'b="0" c="0" d="0"/></elevationProfile><lateralProfile><superelevation s="0" a="0.01" b="0" '
    'c="0" d="0"/></lateralProfile><lanes><laneOffset s="0" a="0" b="0" c="0" '
    'd="0"/><laneSection s="0"><left><lane id="1" type="driving" level="false"><border '
    'sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></left><center><lane id="0" type="none" '
    'level="false"/></center><right><lane id="-1" type="driving" level="false" '
    'direction="standard"><link><successor id="-1"/></link><width sOffset="0" a="3.5" b="0" '
    'c="0" d="0"/><speed sOffset="20" max="30" unit="km/h"/><access sOffset="0" rule="deny" '
    'restriction="truck"/></lane></right></laneSection></lanes><objects><object type="building" '
    'id="7" s="5" t="12" zOffset="0" hdg="0.1" length="8" width="6" height="5"/><object '
    'type="tree" id="8" s="3" t="9" radius="1.5" height="6"><repeat s="3" length="30" '
    'distance="10" tStart="9" tEnd="9"/></object></objects><signals><signal id="9" s="4" t="-4" '
    'zOffset="2.5" height="0.6" width="0.6" dynamic="no" orientation="+" '
    'type="1000001"><validity fromLane="-1" toLane="-1"/></signal></signals></road>'
)
_JUNCTION = (
    '<junction id="9" name="" type="direct"><connection id="0" incomingRoad="1" linkedRoad="2" '
    'contactPoint="end"><laneLink from="-1" to="1"/></connection></junction>'
)


def make_opendrive(path: Path) -> None:
    """Write a map of two roads that a direct junction joins."""
    roads = [
        _ROAD.format(i=1, x=-60, y=0, hdg=0, length=120),
        _ROAD.format(i=2, x=60, y=20, hdg=3.1, length=120),
    ]
    header = (
        f'<header revMajor="1" revMinor="8">{_REFERENCE}<offset x="692000" y="5336000" z="500" '
        'hdg="0.1"/></header>'
    )
    path.write_text(
        "\n".join(
            ['<?xml version="1.0"?>', f"<OpenDRIVE>{header}", *roads, _JUNCTION, "</OpenDRIVE>"]
        )
    )


def read_whole_map(path: Path) -> None:
    """Run all of `import_opendrive` but SUMO's netconvert."""
    MapPiece(path, centre=(0.0, 0.0), size=(60, 60))
    with name_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        root = read_opendrive(path, (0.0, 0.0))
        find_placement(root)
        find_projection(root, path.name)
        plain = write_plain(root)
        window = shapely.box(-80, -80, 80, 80)
        roads, _ = find_near_roads(root, window, 0.0, 3.5)
        for road in roads:
            list(outline_lanes(road))
        find_plane(roads, window, np.eye(4))
        read_road_objects(roads)
        describe_problems(plain, roads)


_OTHERS: dict[
    str, tuple[str, ...]
] = {  # attributes that say how a map is meant, and what else stands in files
    "rule": ("LHT", "RHT", "lht", "", "both"),
    "unit": ("mph", "m/s", "km/h", "kmh", "", "ft/s"),
    "max": ("no limit", "undefined", "0", "-1", "1e9", "fifty", "inf"),
    "type": (
        "bus",
        "bidirectional",
        "special1",
        "Driving",
        "",
        "virtual",
        "crossing",
        "default",
        "1000001",
    ),
    "direction": ("reversed", "both", "standard", "backwards"),
    "restriction": ("bus", "none", "throughTraffic", "", "BUS"),
    "contactPoint": ("start", "end", "", "middle"),
    "elementType": ("road", "junction", "", "station"),
    "hdg": ("3.141592653589793", "90", "-0.1", "7e7"),
    "id": ("-1", "1", "2", "a,b", "", "1.5"),
    "from": ("1", "0", "-2", "x"),
    "level": ("true", "1", "maybe"),
}
_FRAMES = (
    "<offset/>",
    '<offset x="1e7" y="-1e7" z="9000" hdg="180"/>',
    '<offset x="692,000" y="5,336,000" z="0" hdg="0"/>',
    "<geoReference>+proj=utm +zone=32 +ellps=bessel +nadgrids=not_here.gsb</geoReference>",
    "<geoReference>+proj=utm +zone=32 +units=us-ft</geoReference>",
    "<geoReference>EPSG:4326</geoReference>",
    "<geoReference><![CDATA[PROJCS[]]></geoReference>",
)


def opendrive_change(content: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """Another meaning of a map: its units, frame, offset, side of the road, users, or what its
    links lead to."""
    text = content.decode(errors="replace")
    name = str(rng.choice(list(_OTHERS)))
    other = str(rng.choice(_OTHERS[name]))
    frame = str(rng.choice(_FRAMES))
    shift = float(rng.choice([1e5, 5336000.0, 1e8, 1e9, -1e7]))
    every = re.compile(rf'\b{name}="[^"]*"')
    frames = re.compile("<geoReference>.*?</geoReference>|<offset[^>]*>")
    changes: dict[str, Callable[[], str]] = {
        f"every {name} is {other!r}": lambda: every.sub(f'{name}="{other}"', text),
        f"one {name} is {other!r}": lambda: every.sub(
            f'{name}="{other}"', text, count=int(rng.integers(1, 4))
        ),
        f"no {name}": lambda: every.sub("", text),
        f"a header with {frame[:40]}": lambda: frames.sub(frame, text, count=1),
        f"roads {shift:g} m away": lambda: re.sub(
            r'\b(x|y)="([-\d.]+)"', lambda m: _moved(m, shift), text
        ),
        "metres as feet": lambda: re.sub(
            r'\b(x|y|s|length|a)="([-\d.]+)"', lambda m: _scaled(m, 3.28084), text
        ),
        "metres as millimetres": lambda: re.sub(
            r'\b(x|y|s|length|a)="([-\d.]+)"', lambda m: _scaled(m, 1e3), text
        ),
        "sides exchanged": lambda: (
            text.replace("left>", "~>").replace("right>", "left>").replace("~>", "right>")
        ),
        "sections of one side": lambda: text.replace(
            "<laneSection", '<laneSection singleSide="true"'
        ),
        "no junction": lambda: re.sub("<junction.*?</junction>", "", text),
        "no partner": lambda: re.sub(
            '<road name="" length="120" id="2".*?</road>', "", text, flags=re.S
        ),
        "no widths": lambda: re.sub("<(width|border)[^>]*>", "", text),
        "borders crossed": lambda: re.sub(
            '<border sOffset="0" a="3.5"', '<border sOffset="0" a="-9"', text
        ),
    }
    what = str(rng.choice(list(changes)))
    return what, changes[what]().encode(errors="replace")


def _moved(found: re.Match[str], by: float) -> str:
    return f'{found[1]}="{float(found[2]) + by!r}"'


def _scaled(found: re.Match[str], by: float) -> str:
    return f'{found[1]}="{float(found[2]) * by!r}"'


OPENDRIVE: tuple[Mutation, ...] = (opendrive_change,)
