"""Objects and signals next to OpenDRIVE roads.

Flat objects (crosswalks, markings) are no solids."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Pose
from toolkit.sites import furniture
from toolkit.sites.georeference import map_turn
from toolkit.sites.network import unite
from toolkit.sites.opendrive.cubics import read_number
from toolkit.sites.opendrive.map_roads import MapRoad
from toolkit.sites.opendrive.object_places import check_place, list_places, place_on_road
from toolkit.sites.opendrive.object_shapes import make_object_solids
from toolkit.sites.site import Solid
from toolkit.sites.surroundings.parking_bays import Bay

OBJECT_KINDS = {  # type of object: kind of solid, height without one in the map (m)
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
FLAT_OBJECTS = ("crosswalk", "roadMark", "roadSurface", "patch", "crack", "none", "signalReference")
LAMPS = ("streetLamp", "streetlamp")
UNNAMED_TYPES = ("-1", "")  # types without meaning, as in CARLA's maps
MIN_SIGN_BASE_M = 2.1  # height of the lower edge of a sign or a signal head
MAX_SIGN_BASE_M = 12.0
SIGN_SIZE_M = (0.2, 4.0)  # least and greatest width, and height, of a sign


class _SignalSize(NamedTuple):
    # Usual size (m) of a signal without one in the map; depth: from its face to its back.
    height: float
    width: float
    depth: float


@dataclass
class RoadObjects:
    """Objects next to the roads, in the map's frame or, once moved, in the site's.

    Attributes:
        groups: solids that are kept or left out together.
        bays: x, y (m), yaw (rad) of parking bays.
        lamps: x, y (m) of street lamps.
        understood: number of known objects by type.
        unknown: number of unknown objects by type and name.
        damaged: fault of each object or signal that was left out."""

    groups: list[list[Solid]] = field(default_factory=list)
    bays: list[Bay] = field(default_factory=list)
    lamps: list[tuple[float, float]] = field(default_factory=list)
    understood: Counter[str] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)
    damaged: list[str] = field(default_factory=list)

    def add_object(self, road: MapRoad, element: ElementTree.Element) -> None:
        """Add an <object> of a road, and its repeats, and count it by its type.

        Objects of an unknown type are only counted, flat ones give no solids. Raises ValueError for
        a damaged one."""
        object_type = element.get("type", "") or "none"
        if object_type == "parkingSpace":
            self._add_bays(road, element)
        elif object_type in OBJECT_KINDS:
            solid_kind, usual_height = OBJECT_KINDS[object_type]
            self.groups += list(make_object_solids(road, element, solid_kind, usual_height))
            if object_type in LAMPS:
                self.lamps += [(place.x, place.y) for place in list_places(road, element)]
        elif object_type not in FLAT_OBJECTS:
            # a type without meaning is counted with the object's name
            name = element.get("name", "") if object_type in UNNAMED_TYPES else ""
            self.unknown[f"{object_type} {name}".strip()] += 1
            return
        self.understood[object_type] += 1

    def _add_bays(self, road: MapRoad, element: ElementTree.Element) -> None:
        """Add the parking bays of an <object> of a road, one for each repeat.

        A bay heads along its longer side, whichever the map calls its length."""
        length = read_number(element, "length", 0.0)
        width = read_number(element, "width", 0.0)
        turn = 0.0 if length >= width else np.pi / 2
        places = list(list_places(road, element))
        self.bays += [(place.x, place.y, place.heading + turn) for place in places]

    def add_signal(self, road: MapRoad, element: ElementTree.Element) -> None:
        """Add a <signal> of a road. Raises ValueError for a damaged one."""
        self.groups.append(_make_signal(road, element))
        self.understood["signal"] += 1


def read_road_objects(roads: Sequence[MapRoad]) -> RoadObjects:
    """Read the objects and signals of roads. If one is damaged, only its fault is kept."""
    objects = RoadObjects()
    adders = {"objects/object": objects.add_object, "signals/signal": objects.add_signal}
    for road in roads:
        for path, add in adders.items():
            for element in road.element.findall(path):
                try:
                    check_place(road, element)
                    add(road, element)
                except ValueError as error:
                    objects.damaged.append(str(error))
    return objects


def _make_signal(road: MapRoad, element: ElementTree.Element) -> list[Solid]:
    """Make the post and the plate, or head with lamps, of a <signal> of a road.

    The solids are in the map's frame, with heights above the road (m)."""
    # m along the road
    s = read_number(element, "s")
    # m to the left of its reference line
    t = read_number(element, "t")
    place = place_on_road(road, s, t, turn=read_number(element, "hOffset", 0.0))
    # a signal for traffic along s faces against s
    is_forward = element.get("orientation", "+") == "+"
    facing = place.heading + (np.pi if is_forward else 0.0)
    if element.get("dynamic") == "yes":  # a head with lamps
        usual_size = _SignalSize(height=0.9, width=0.3, depth=0.3)
    else:  # the plate of a sign
        usual_size = _SignalSize(height=0.6, width=0.6, depth=0.06)
    height = float(np.clip(read_number(element, "height", 0.0) or usual_size.height, *SIGN_SIZE_M))
    width = float(np.clip(read_number(element, "width", 0.0) or usual_size.width, *SIGN_SIZE_M))
    base = min(max(read_number(element, "zOffset", 0.0), MIN_SIGN_BASE_M), MAX_SIGN_BASE_M)
    plate = furniture.block(
        (width, usual_size.depth), middle=(place.x, place.y), yaw=facing + np.pi / 2
    )
    return [
        furniture.post(place.x, place.y, height=round(base, 3), radius=0.06),
        Solid(plate, base=round(base, 3), top=round(base + height, 3), kind="sign"),
    ]


def move_objects_to_site(objects: RoadObjects, map_SE3_site: Pose) -> RoadObjects:
    """Return objects of the map's frame in the site's frame. Heights remain as they are.

    map_SE3_site: pose of the site in the map."""
    rotation = map_SE3_site[:2, :2]
    origin = map_SE3_site[:2, 3]
    site_yaw = map_turn(map_SE3_site)
    # rows of points: (xy - origin) @ rotation turns by the transpose, from the map to the site

    def move_solid(solid: Solid) -> Solid:
        return replace(solid, footprint=((solid.footprint - origin) @ rotation).round(3))

    def move_bay(bay: Bay) -> Bay:
        map_x, map_y, map_yaw = bay  # m, m, rad
        x, y = (([map_x, map_y] - origin) @ rotation).tolist()
        return x, y, float(map_yaw - site_yaw)

    return replace(
        objects,
        groups=[list(map(move_solid, group)) for group in objects.groups],
        bays=list(map(move_bay, objects.bays)),
        lamps=[tuple((np.array(lamp) - origin) @ rotation) for lamp in objects.lamps],
    )


def select_solids(
    objects: RoadObjects,
    window: shapely.Geometry,
    lanes: Sequence[np.ndarray],
    tracks: shapely.Geometry,
) -> tuple[list[Solid], list[str]]:
    """Select the solids within `window` and off the road; return them and notes of all others.

    window: ground in the site's frame, as the objects are; lanes: polygons of the carriageway;
    tracks: ground that vehicles drive on. A group with any solid on the road is left out."""
    road_ground = unite(lanes).union(tracks).buffer(-1e-3)  # shrunk: solids may touch its edge
    shapely.prepare(road_ground)
    solids: list[Solid] = []
    count_on_road = 0
    for group in objects.groups:
        group_ground = unite(solid.footprint for solid in group)
        if not group or not group_ground.intersects(window):
            continue
        if road_ground.intersects(group_ground):
            count_on_road += 1
        else:
            solids += group
    notes = []
    if count_on_road:
        notes.append(
            f"{count_on_road} objects or signals stand on the carriageway and were left out"
        )
    if objects.unknown:
        rows = sorted(objects.unknown.items())[:12]
        types = ", ".join(f"{count} {kind[:30]!r}" for kind, count in rows)
        notes.append(f"objects of types that are not known were left out: {types}")
    if objects.damaged:
        reason = objects.damaged[0].removesuffix(": export it again")
        notes.append(f"{len(objects.damaged)} damaged objects or signals were left out: {reason}")
    return solids, notes
