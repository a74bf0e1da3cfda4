"""What an OpenDRIVE map says stands beside its roads: <object> and <signal> as solids on level ground, and bays.

OpenDRIVE 1.7, chapters 11 and 12. An object's place is s, t on its road, turned by hdg against it; its shape is an
outline, a radius or a length and width. What is flat (crosswalks, markings) is no solid.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites import furniture as f
from toolkit.sites.opendrive.extract import MapRoad
from toolkit.sites.opendrive.reference_line import number
from toolkit.sites.site import Solid

# type of object: kind of solid, height where the map gives none (m)
SOLIDS = {
    "building": ("building", 6.0),
    "tree": ("tree", 7.0),
    "vegetation": ("hedge", 1.2),
    "bush": ("hedge", 1.2),
    "pole": ("post", 4.0),
    "streetLamp": ("post", 6.0),
    "streetlamp": ("post", 6.0),
    "barrier": ("wall", 0.9),
    "wall": ("wall", 1.8),
    "soundBarrier": ("wall", 3.0),
    "railing": ("fence", 1.0),
    "fence": ("fence", 1.2),
    "gantry": ("post", 6.0),
    "trafficIsland": ("island", 0.15),
    "obstacle": ("bin", 1.0),
}
FLAT = ("crosswalk", "roadMark", "roadSurface", "patch", "crack", "none", "signalReference")
LAMPS = ("streetLamp", "streetlamp")
UNSAID = ("-1", "")  # types that say nothing, as CARLA's maps have them
MOST = 2000  # repeats of one object
HEAD_BELOW = 2.1  # m, lowest place for the lower edge of a sign or a signal head
_FLATTEST = 0.02  # m


@dataclass
class Standing:
    """What stands there, in the map's frame: groups of solids that stand or fall together, bays x, y, yaw, street
    lamps; and how many objects of which type were understood or not."""

    groups: list[list[Solid]] = field(default_factory=list)
    bays: list[tuple[float, float, float]] = field(default_factory=list)
    lamps: list[tuple[float, float]] = field(default_factory=list)
    understood: Counter[str] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)


def standing_beside(roads: Sequence[MapRoad]) -> Standing:
    """All objects and signals of `roads`. Raises ValueError where a number among them is none."""
    found = Standing()
    for road in roads:
        for element in road.element.findall("objects/object"):
            _add_object(found, road, element)
        for element in road.element.findall("signals/signal"):
            found.groups.append(signal(road, element))
            found.understood["signal"] += 1
    return found


def signal(road: MapRoad, element: ElementTree.Element) -> list[Solid]:
    """The post of a signal and on it a sign, or a signal head where it is dynamic."""
    x, y, heading = _place(road, number(element, "s"), number(element, "t"), number(element, "hOffset", 0.0))
    facing = heading + (np.pi if element.get("orientation", "+") == "+" else 0.0)
    is_head = element.get("dynamic") == "yes"
    height = float(np.clip(number(element, "height", 0.0) or (0.9 if is_head else 0.6), 0.2, 4.0))
    width = float(np.clip(number(element, "width", 0.0) or (0.3 if is_head else 0.6), 0.2, 4.0))
    low = min(max(number(element, "zOffset", 0.0), HEAD_BELOW), 12.0)
    half = width / 2 * np.array([-np.sin(facing), np.cos(facing)])
    start, end = (float(x - half[0]), float(y - half[1])), (float(x + half[0]), float(y + half[1]))
    plate = Solid(f.bar(start, end, 0.3 if is_head else 0.06), round(low, 3), round(low + height, 3), "sign")
    return [f.post(x, y, round(low, 3), 0.06), plate]


def _add_object(found: Standing, road: MapRoad, element: ElementTree.Element) -> None:
    kind = element.get("type", "") or "none"
    if kind == "parkingSpace":
        for x, y, heading, _ in _places(road, element):
            length, width = number(element, "length", 0.0), number(element, "width", 0.0)
            found.bays.append((x, y, heading if length >= width else heading + np.pi / 2))
    elif kind in FLAT:
        pass
    elif kind in SOLIDS:
        found.groups += _solids(road, element, *SOLIDS[kind])
        if kind in LAMPS:
            found.lamps += [(x, y) for x, y, *_ in _places(road, element)]
    else:
        name = element.get("name", "") if kind in UNSAID else ""
        found.unknown[f"{kind} {name}".strip()] += 1
        return
    found.understood[kind] += 1


def _solids(road: MapRoad, element: ElementTree.Element, kind: str, usual: float) -> Iterator[list[Solid]]:
    height = min(number(element, "height", 0.0) or usual, 200.0)
    radius, length, width = (number(element, key, 0.0) for key in ("radius", "length", "width"))
    repeats = element.findall("repeat")
    outlines = [] if repeats else [*element.findall("outline"), *element.findall("outlines/outline")]
    if any(number(repeat, "distance", 0.0) == 0 for repeat in repeats):
        yield from ([bar] for repeat in repeats for bar in _continuous(road, repeat, kind, height, max(width, 0.2)))
        return
    for x, y, heading, base in _places(road, element):
        rings = [_ring(road, outline, (x, y, heading)) for outline in outlines]
        if kind == "tree" and not outlines:
            crown = radius or max(length, width) / 2 or 1.6
            yield f.tree(x, y, max(height, 2.0), min(max(crown, 0.3), 8.0), min(2.3, 0.4 * height))
        elif outlines:
            yield [Solid(r, base, base + height, kind) for r in rings if shapely.Polygon(r).area > 1e-3]
        elif kind == "post" or radius > 0:
            yield [Solid(f.disc(x, y, min(radius or max(length, width) / 2 or 0.1, 20.0)), base, base + height, kind)]
        else:
            ahead = max(length, 0.3) / 2 * np.array([np.cos(heading), np.sin(heading)])
            start, end = (float(x - ahead[0]), float(y - ahead[1])), (float(x + ahead[0]), float(y + ahead[1]))
            yield [Solid(f.bar(start, end, max(width, 0.2)), base, base + height, kind)]


def _places(road: MapRoad, element: ElementTree.Element) -> Iterator[tuple[float, float, float, float]]:
    """x, y, direction and height over the road of an object and of what repeats it."""
    turn = number(element, "hdg", 0.0) + (np.pi if element.get("orientation") == "-" else 0.0)
    repeats = element.findall("repeat")
    if not repeats:
        s, t = number(element, "s"), number(element, "t")
        yield *_place(road, s, t, turn), max(number(element, "zOffset", 0.0), 0.0)
    for repeat in repeats:
        start, length, every = number(repeat, "s"), number(repeat, "length", 0.0), number(repeat, "distance", 0.0)
        count = 1 + (int(length / every) if every > 0 else 0)
        if not 0 < count <= MOST:
            raise ValueError(f"<repeat> makes {count} objects: it must be 1 to {MOST}, mend its length or distance")
        first = number(repeat, "tStart", number(element, "t"))
        last = number(repeat, "tEnd", first)
        base = max(number(repeat, "zOffsetStart", 0.0), 0.0)
        for share in np.arange(count) * every / length if length > 0 else [0.0]:
            yield *_place(road, start + share * length, first + share * (last - first), turn), base


def _continuous(road: MapRoad, repeat: ElementTree.Element, kind: str, height: float, width: float) -> Iterator[Solid]:
    """A barrier along the road, in pieces of 4 m."""
    start, length = number(repeat, "s"), min(max(number(repeat, "length", 0.0), 0.0), road.line.length)
    first = number(repeat, "tStart", 0.0)
    s = np.linspace(start, start + length, int(length / 4.0) + 2)
    line = road.line.beside(s, np.linspace(first, number(repeat, "tEnd", first), len(s)))
    top = min(number(repeat, "heightStart", 0.0) or height, 200.0)
    wide = number(repeat, "widthStart", 0.0) or width
    for start_xy, end_xy in pairwise(line):
        if np.hypot(*(end_xy - start_xy)) > 0.05:
            ends = [(float(p[0]), float(p[1])) for p in (start_xy, end_xy)]
            yield Solid(f.bar(ends[0], ends[1], min(wide, 20.0)), 0.0, top, kind)


def _place(road: MapRoad, s: float, t: float, turn: float) -> tuple[float, float, float]:
    ((x, y, heading),) = road.line.at(np.array([s]))
    return round(float(x - t * np.sin(heading)), 3), round(float(y + t * np.cos(heading)), 3), float(heading + turn)


def _ring(road: MapRoad, outline: ElementTree.Element, place: tuple[float, float, float]) -> Float64[np.ndarray, "k 2"]:
    """The corners of an outline, given on the road or about the object; no corners where it makes no polygon."""
    x, y, heading = place
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    corners = []
    for corner in outline:
        if corner.tag == "cornerRoad":
            corners.append(_place(road, number(corner, "s"), number(corner, "t"), 0.0)[:2])
        elif corner.tag == "cornerLocal":
            corners.append(tuple(turn @ [number(corner, "u"), number(corner, "v")] + [x, y]))
    if len(corners) < 3:
        return np.zeros((3, 2))
    valid = shapely.make_valid(shapely.Polygon(corners))
    parts = [p for part in shapely.get_parts(valid) for p in shapely.get_parts(part) if p.geom_type == "Polygon"]
    largest = max(parts, key=shapely.area, default=shapely.Polygon(np.zeros((4, 2))))
    return shapely.get_coordinates(largest.exterior)[:-1].round(3)
