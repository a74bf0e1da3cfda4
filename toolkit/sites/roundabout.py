"""The paper's roundabout: the one in the middle of CARLA Town03, in the axes of the published overview picture.

Site frame: a (x) = x_carla to the right, b (y) = -y_carla up, zero in the middle of the island. Widths, the lines of
the four legs and the sensor posts are the published ones; heights of buildings and the furniture are made up.

The tilt is not published. The paper's early fusion sends 674 kbit per sensor and frame; here it is about 600, 640,
675 and 700 at 0, 5, 8 and 10 degrees (40 frames of traffic, noise on, cropped to 0 < z < 4), so the tilt is 8. At
each of these all eight sensors together see every vehicle, and 3 sees most of them, then 5 and 7. The relief's seed
was picked, among 150, for a mean over the area close to zero and for these figures.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.geometry import look
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites import furniture as f
from toolkit.sites.network import XmlAttributes, build_network, line, road_polygons, street
from toolkit.sites.site import Mount, Relief, Site, Solid

_AREA = (-48.0, -48.0, 48.0, 48.0)
_RELIEF = Relief(amplitude=0.08, seed=6)

RADIUS, _LANE, _SHOULDER, _FOOTWAY = 20.95, 3.5, 0.5, 2.6  # the reference line lies between the ring's two lanes
INNER, OUTER = RADIUS - _LANE, RADIUS + _LANE
MOUTH, BEND, CROSSING, END = 27.5, 34.0, 43.0, 112.0  # m from the centre along a leg
CUT = 24.0  # half the angle (degrees) of the ring that belongs to a junction

_HEIGHT = 8.0
_TILT_DEG = 8.0
_POSTS = ((29.0, -2.0), (-28.0, 1.0), (0.0, 30.0), (-1.5, -30.0))  # on the east, west, north and south splitter island


_PARKING = np.array(  # x, y, yaw: forecourts of the terrace, the glazed and the courtyard building
    [(25.5, b, np.pi / 2) for b in (22.0, 28.5, 35.0, 41.5)]
    + [(a, -15.5, 0.0) for a in (-43.0, -36.5, -30.0)]
    + [(a, -18.4, 0.0) for a in (27.0, 33.5, 40.0, 46.5)]
)


class _Leg(NamedTuple):
    """A leg outwards at `angle` (degrees), `lanes` each way; exit and entry: how far the carriageway's island side lies
    left of the leg's axis (m), at the leg's end and at its mouth."""

    name: str
    angle: float
    lanes: int
    exit: tuple[float, float]
    entry: tuple[float, float]

    def place(self, along: float, left: float) -> tuple[float, float]:
        """Site coordinates of a point `along` m out on the leg's axis and `left` m beside it."""
        c, s = np.cos(np.deg2rad(self.angle)), np.sin(np.deg2rad(self.angle))
        return round(float(c * along - s * left), 3), round(float(s * along + c * left), 3)

    def edge(self, side: tuple[float, float], start: float, end: float) -> list[tuple[float, float]]:
        """The island side of a carriageway from `start` to `end` m from the centre."""
        places = (start, *(a for a in (BEND, CROSSING - 4) if start < a < end), end)
        lefts = np.interp(places, (MOUTH, CROSSING - 4), side[::-1])
        return [self.place(along, left) for along, left in zip(places, lefts, strict=True)]


LEGS = (
    _Leg("east", 0.0, 2, (-2.7, -2.7), (2.7, 2.9)),
    _Leg("north", 90.0, 2, (-2.3, -4.0), (1.2, 2.6)),
    _Leg("west", 180.0, 1, (-1.2, -5.2), (-0.9, 0.8)),
    _Leg("south", 270.0, 2, (-4.8, -6.0), (-0.3, 1.4)),
)
QUADRANTS = ("northeast", "northwest", "southwest", "southeast")


def build() -> Site:
    """The site, its network made by netconvert."""
    net = _network()
    lanes, footways = road_polygons(net, _AREA)
    beside = f.clear_of_road([*_buildings(), *_street_furniture(), *islands()], lanes, footways, gap=0.15)
    solids = f.settle([*beside, *f.kerbs(lanes, footways)], _RELIEF)
    return Site(
        name="roundabout",
        area=np.array(_AREA),
        lanes=lanes,
        footways=footways,
        solids=solids,
        mounts=_mounts(lanes, footways, solids),
        sensors=_sensors(),
        parking=_PARKING,
        network=net,
        map_SE3_site=np.eye(4),
        relief=_RELIEF,
        hybrid_radius=12.0,  # m, paper section IV-B
    )


def _sensors() -> tuple[Sensor, ...]:
    """The paper's eight depth cameras, named d0..d7 by its ids: two on each post, the even one facing outwards along
    the leg, the odd one facing the centre."""
    outwards = np.deg2rad([0.0, 180.0, 90.0, 270.0])
    headings = [h for (a, b), out in zip(_POSTS, outwards, strict=True) for h in (out, np.arctan2(-b, -a))]
    return tuple(
        Sensor(f"d{i}", DepthCamera(), look((*_POSTS[i // 2], _HEIGHT), float(heading), np.deg2rad(_TILT_DEG)))
        for i, heading in enumerate(headings)
    )


def _buildings() -> list[Solid]:
    """The buildings of the published picture; `build` cuts off what would stand on the street."""
    return [
        f.building(29.0, 6.0, 48.0, 56.0, 9.0),  # terrace of houses
        f.building(-49.0, -55.0, -12.0, -19.0, 10.0),  # glazed building
        f.building(8.0, -31.0, 58.0, -22.0, 8.0),  # courtyard building: four wings
        f.building(8.0, -46.0, 17.0, -31.0, 8.0),
        f.building(49.0, -46.0, 58.0, -31.0, 8.0),
        f.building(8.0, -55.0, 58.0, -46.0, 8.0),
    ]


def islands() -> list[Solid]:
    """The central island with its low solids, and the splitter islands with signs and the sensors' posts."""
    beds = [_arc(11.5, at, at + 50.0, 4) for at in (20.0, 110.0, 200.0, 290.0)]
    shrubs = _arc(14.5, 10.0, 370.0, 13)[:-1]
    return [
        Solid(f.disc(0.0, 0.0, INNER - 0.3, 48), 0.0, 0.15, "island"),
        Solid(f.disc(0.0, 0.0, 4.0, 24), 0.15, 0.7, "wall"),
        Solid(f.disc(0.0, 0.0, 1.2, 12), 0.7, 1.9, "wall"),
        *(h for bed in beds for h in f.hedge([(x, y) for x, y in bed.tolist()], 0.8, 1.6)),
        *(
            Solid(f.disc(x, y, 0.6 + 0.1 * (i % 3)), 0.0, 1.1 + 0.1 * (i % 4), "hedge")
            for i, (x, y) in enumerate(shrubs)
        ),
        *(Solid(splitter(leg), 0.0, 0.15, "island") for leg in LEGS),
        *(f.post(a, b, _HEIGHT - 0.2, 0.1) for a, b in _POSTS),
        *(s for leg in LEGS for s in f.sign(*leg.place(36.5, (leg.exit[0] + leg.entry[0]) / 2), np.deg2rad(leg.angle))),
    ]


def _street_furniture() -> list[Solid]:
    """The park, and trees, hedges, walls, lamps, signs and bins behind the footways."""
    park = [(a, b) for a in (-46.0, -40.0, -34.0, -29.0) for b in (30.0, 36.5, 43.0)]
    verge = [(18.5, 33.0), (19.5, 41.0), (-17.5, 38.0), (-19.0, 45.0), (-20.5, 22.5), (-38.0, 12.0), (-46.0, 10.5)]
    verge += [(-24.9, -16.8), (22.4, -18.6), (36.7, -15.9), (49.5, -15.8), (-17.8, 31.0)]
    lamps = [(a, b) for a in (-14.5, 15.8) for b in (34.0, 47.0)] + [(-17.6, -40.0), (11.2, -40.0)]
    lamps += [(a, b) for a in (35.0, 47.0) for b in (13.4, -13.4)] + [(-36.0, 8.6), (-47.0, -6.4), (-34.0, -7.4)]
    trees = [*park, *verge]
    return [
        *(
            s
            for i, place in enumerate(trees)
            for s in f.tree(*place, height=6.0 + i % 5 * 0.8, crown=1.5 + i % 3 * 0.3)
        ),
        *(f.post(a, b, 8.5, 0.1) for a, b in lamps),
        *f.hedge([(-49.0, 26.5), (-26.5, 26.5), (-26.5, 47.0)], 1.1),
        *f.hedge([(-49.0, 16.5), (-30.0, 18.5)], 1.3),
        *f.railing([(-19.5, 25.0), (-15.5, 30.0), (-15.0, 48.0)]),
        *f.wall([(28.5, 15.5), (23.5, 17.5), (20.0, 24.0)], 0.9),
        *f.railing([(16.5, 30.0), (16.2, 48.0)]),
        *f.hedge([(-48.0, -8.5), (-31.0, -9.5)], 0.9),
        *f.bollards((-28.4, -10.8), (-24.4, -17.6), 5),
        *f.railing([(18.8, -21.2), (22.5, -17.0), (26.5, -14.6), (48.0, -14.4)]),
        *f.shelter(-46.0, 8.0, -41.5, 9.5),
        *f.sign(16.8, -21.8, -np.pi / 2),
        *f.sign(-27.5, 12.0, np.pi),
        *(f.litter_bin(a, b) for a, b in ((15.8, 27.0), (-29.0, -8.6), (-40.5, 8.4), (30.0, -13.6), (27.5, 14.0))),
        *(f.bench(a, b) for a, b in ((-37.0, 33.0), (-31.5, 40.0), (-43.0, 40.0), (20.5, 30.0))),
    ]


def _mounts(lanes: f.Outlines, footways: f.Outlines, solids: tuple[Solid, ...]) -> tuple[Mount, ...]:
    """Where sensors may hang: the present posts, poles behind the footways every 8 m, and corners of buildings."""
    corners = [(28.9, 13.3), (28.9, 30.0), (48.1, 13.3), (-30.0, -18.9), (-49.0, -18.9), (30.0, -21.9), (48.0, -21.9)]
    places = f.kerbside(lanes, footways, behind=0.3, spacing=8.0)
    return (
        *f.poles(_POSTS, _RELIEF, "post", top=10.0),
        *f.poles(f.free_places(places, solids, _AREA, 6.0), _RELIEF, "pole", top=10.0),
        *f.poles(corners, _RELIEF, "corner", top=7.5, price=0.6, capacity=1000.0),
    )


def _network() -> str:
    """The ring as four junctions, one in each quadrant, where one leg's traffic enters and the next leg's leaves."""
    road, corner_walks = surface()
    paved = shapely.union_all([road, *(shapely.Polygon(walk) for walk in corner_walks)])
    nodes: list[XmlAttributes] = [
        {
            "id": name,
            "x": round(x, 3),
            "y": round(y, 3),
            "type": "priority",
            "shape": line(_quadrant(paved, 45.0 + 90 * i)),
        }
        for i, name in enumerate(QUADRANTS)
        for x, y in _arc(RADIUS, 45.0 + 90 * i, 45.0 + 90 * i, 1)
    ]
    edges: list[XmlAttributes] = []
    walks: list[XmlAttributes] = []
    for i, leg in enumerate(LEGS):
        before, after, crossing = QUADRANTS[i - 1], QUADRANTS[i], f"{leg.name}_crossing"
        for name, along in ((leg.name, END), (crossing, CROSSING)):
            x, y = leg.place(along, (leg.exit[0] + leg.entry[0]) / 2)
            nodes.append({"id": name, "x": x, "y": y, "radius": 1})
        ring = _arc(INNER, leg.angle - 45.0 + CUT, leg.angle + 45.0 - CUT)
        edges += [
            _one_way(
                f"ring_{leg.name}",
                before,
                after,
                ring,
                street(2, width=_LANE, shoulder=_SHOULDER, footway=0.0, speed=8.3),
                priority=5,
            ),
            *_legs_edges(leg, before, after, crossing),
        ]
        walks.append(
            {"node": after, "edges": f"entry_{leg.name} exit_{LEGS[i - 3].name}", "shape": line(corner_walks[i])}
        )
    return build_network(
        nodes,
        edges,
        crossings=[{"node": f"{g.name}_crossing", "edges": f"exit_{g.name} entry_{g.name}", "width": 3} for g in LEGS],
        walking_areas=walks,
        roundabouts=[{"nodes": " ".join(QUADRANTS), "edges": " ".join(f"ring_{leg.name}" for leg in LEGS)}],
    )


def surface() -> tuple[shapely.Geometry, list[np.ndarray]]:
    """The road surface between the legs' ends, and the footway round each of the four corners."""
    carriageways = [shapely.Point(0, 0).buffer(OUTER + _SHOULDER, 32)]
    for leg in LEGS:
        width = leg.lanes * _LANE + _SHOULDER
        for side, outward in ((leg.exit, -width), (leg.entry, width)):
            inner = [leg.place(15.0, side[1]), *leg.edge(side, MOUTH, END)]
            outer = [
                leg.place(15.0, side[1] + outward),
                *leg.edge((side[0] + outward, side[1] + outward), MOUTH, END),
            ]
            carriageways.append(shapely.Polygon([*inner, *outer[::-1]]))
    filled = shapely.union_all([*carriageways, *(shapely.Polygon(splitter(leg)) for leg in LEGS)])
    filled = filled.buffer(9).buffer(-9)  # rounds the corners between legs
    holes = [shapely.Point(0, 0).buffer(INNER, 32), *(shapely.Polygon(splitter(leg)) for leg in LEGS)]
    walks = filled.buffer(_FOOTWAY).difference(filled)
    corners = [shapely.intersection(walks, _wedge(45.0 + 90 * i)) for i in range(4)]
    return filled.difference(shapely.union_all(holes)), [_ring(corner) for corner in corners]


def splitter(leg: _Leg) -> Float64[np.ndarray, "k 2"]:
    """The island between a leg's carriageways, from the ring to the crossing."""
    sides = [*leg.edge(leg.exit, MOUTH, CROSSING - 4), *leg.edge(leg.entry, MOUTH, CROSSING - 4)[::-1]]
    island = shapely.Polygon([leg.place(20.0, leg.exit[1]), *sides, leg.place(20.0, leg.entry[1])])
    island = island.difference(shapely.Point(0, 0).buffer(OUTER + _SHOULDER, 32))
    return _ring(island.buffer(-0.45).buffer(0.4))


def _legs_edges(leg: _Leg, before: str, after: str, crossing: str) -> list[XmlAttributes]:
    lanes = street(leg.lanes, width=_LANE, shoulder=_SHOULDER, footway=_FOOTWAY, speed=11.1)
    out = leg.edge(leg.exit, MOUTH, CROSSING), leg.edge(leg.exit, CROSSING, END)
    back = leg.edge(leg.entry, CROSSING, END)[::-1], leg.edge(leg.entry, MOUTH, CROSSING)[::-1]
    return [
        _one_way(f"exit_{leg.name}", before, crossing, out[0], lanes, priority=1),
        _one_way(f"exit_{leg.name}_on", crossing, leg.name, out[1], lanes, priority=1),
        _one_way(f"entry_{leg.name}_on", leg.name, crossing, back[0], lanes, priority=1),
        _one_way(f"entry_{leg.name}", crossing, after, back[1], lanes, priority=1),
    ]


def _one_way(
    name: str, start: str, end: str, left_side: object, lanes: list[XmlAttributes], *, priority: int
) -> XmlAttributes:
    shape = line(left_side)  # type: ignore[arg-type]
    ends = {"id": name, "from": start, "to": end, "priority": priority}
    return {**ends, "spreadType": "right", "shape": shape, "lanes": lanes}


def _arc(radius: float, start: float, end: float, points: int = 13) -> Float64[np.ndarray, "n 2"]:
    angles = np.deg2rad(np.linspace(start, end, points))
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _wedge(middle: float) -> shapely.Geometry:
    """The quarter plane about `middle` degrees, inside the legs' mouths."""
    quarter = shapely.Polygon([(0, 0), *_arc(200.0, middle - 45.0, middle + 45.0, 3)])
    a = MOUTH
    return quarter.intersection(shapely.box(-a, -a, a, a))


def _quadrant(paved: shapely.Geometry, middle: float) -> np.ndarray:
    """The part of the paved surface that is the junction about `middle` degrees."""
    ring = shapely.Point(0, 0).buffer(OUTER + _SHOULDER, 32)
    slice_ = shapely.Polygon([(0, 0), *_arc(60.0, middle - CUT, middle + CUT, 3)])
    return _ring(paved.intersection(_wedge(middle)).difference(ring.difference(slice_)))


def _ring(shape: shapely.Geometry) -> np.ndarray:
    """The outline of the largest part of `shape`, on millimetres."""
    largest = max(shapely.get_parts(shape), key=lambda part: part.area)
    return np.round(shapely.get_coordinates(largest.exterior.simplify(0.02))[:-1], 3)
