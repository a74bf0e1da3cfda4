"""Parking along the kerbs of an OpenStreetMap extract.

Both tagging schemes are read, parking:SIDE with parking:SIDE:orientation and the older
parking:lane:SIDE, and areas of amenity=parking next to a road.
https://wiki.openstreetmap.org/wiki/Street_parking"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import shapely

from toolkit.arrays import Float64
from toolkit.sites.osm.extract import Extract
from toolkit.sites.osm.road_rules import Tags

Angle = int | None  # degrees between bay and kerb, of `BAY_DEPTHS_M`; None: no parking

MAX_PARKING_GAP_M = 8.0  # from a lane to its road's line, and to an area of parking next to it
MIN_ALIGNMENT = 0.85  # cosine between a lane and its road

# value of orientation: degrees between bay and kerb
_ORIENTATIONS = {"parallel": 0, "diagonal": 45, "perpendicular": 90}
_NEXT_TO_ROAD = ("lane", "street_side", "on_kerb", "half_on_kerb", "shoulder", "layby")
_FORBIDDEN = ("no_parking", "no_stopping", "no_standing")


class Sides(NamedTuple):
    """Parking on both sides of a lane: angle between bays and kerb, None for no parking.

    kerb: on the right if traffic keeps right; inner: on the other side."""

    kerb: Angle = None
    inner: Angle = None


class ParkingRoad(NamedTuple):
    """Line of a road, and the parking to its left and right, as the line runs in the map."""

    line: shapely.LineString
    left: Angle
    right: Angle


@dataclass(frozen=True)
class Parking:
    """Parking along roads.

    Attributes:
        roads: roads with their parking, and roads without.
        areas: areas of parking next to roads, and their angles (degrees) between bay and kerb.
        lefthand: True if traffic keeps left."""

    roads: tuple[ParkingRoad, ...]
    areas: tuple[tuple[shapely.Polygon, int], ...] = ()
    lefthand: bool = False

    def __bool__(self) -> bool:
        has_parking = [road.left is not None or road.right is not None for road in self.roads]
        return bool(self.areas) or any(has_parking)

    def find_sides(self, lane: shapely.LineString, distance: float) -> Sides:
        """Find the parking on both sides of a lane at a distance (m) along it.

        lane: in the direction of traffic. The nearest road along the lane counts, and on a side
        without parking there the first area of parking within `MAX_PARKING_GAP_M`."""
        spot = lane.interpolate(distance)
        ahead = _find_direction(lane, distance)
        left, right = self._find_road_angles(spot, ahead)
        to_left = MAX_PARKING_GAP_M * np.array([-ahead[1], ahead[0]])
        if left is None:
            left = self._find_area_angle(spot, to_left)
        if right is None:
            right = self._find_area_angle(spot, -to_left)
        if self.lefthand:
            return Sides(kerb=left, inner=right)
        return Sides(kerb=right, inner=left)

    def _find_road_angles(
        self, spot: shapely.Point, ahead: Float64[np.ndarray, "2"]
    ) -> tuple[Angle, Angle]:
        """Angles left and right of the nearest road that runs along a direction or against it.

        spot: middle of the search, up to `MAX_PARKING_GAP_M`; ahead: unit vector of the direction,
        to whose left and right the angles belong. None for a side without parking."""
        angles: tuple[Angle, Angle] = (None, None)
        min_distance = MAX_PARKING_GAP_M
        near_roads = self._tree.query(spot, predicate="dwithin", distance=MAX_PARKING_GAP_M)
        for number in near_roads.tolist():
            road = self.roads[number]
            road_ahead = _find_direction(road.line, road.line.project(spot))
            cosine = float(ahead @ road_ahead)
            distance = float(road.line.distance(spot))
            if distance < min_distance and abs(cosine) > MIN_ALIGNMENT:
                angles = (road.left, road.right) if cosine > 0 else (road.right, road.left)
                min_distance = distance
        return angles

    def _find_area_angle(self, spot: shapely.Point, across: Float64[np.ndarray, "2"]) -> Angle:
        """Angle of the first area of parking from a spot up to the end of a vector; None without.

        spot: place on the lane; across: vector x, y (m) to the side of the lane."""
        end = shapely.get_coordinates(spot)[0] + across
        ray = shapely.LineString([spot, shapely.Point(end)])
        hits: list[tuple[float, int]] = []  # distance (m) and angle of areas that the ray meets
        for shape, angle in self.areas:
            distance = float(ray.intersection(shape).distance(spot))
            if np.isfinite(distance):  # NaN without an intersection
                hits.append((distance, angle))
        if not hits:
            return None
        _, nearest_angle = min(hits)
        return nearest_angle

    @cached_property
    def _tree(self) -> shapely.STRtree:
        # lines of `roads`, by their index there, to find the near ones fast
        return shapely.STRtree([road.line for road in self.roads])


def find_parking(
    extract: Extract, kinds: Collection[str], window: shapely.Geometry, *, lefthand: bool
) -> Parking:
    """Read the parking along the roads of `kinds` (highway=...) that reach into `window`.

    lefthand: traffic keeps left."""
    near_roads = []
    for way in extract.ways:
        if way.tags.get("highway") not in kinds:
            continue
        line = shapely.LineString(way.line)
        if line.intersects(window):
            # degrees between bays and road, None for a side without bays
            left_angle = _read_angle(way.tags, "left")
            right_angle = _read_angle(way.tags, "right")
            near_roads.append(ParkingRoad(line, left_angle, right_angle))
    near_areas = []  # shape, and angle of the bays to the road (degrees)
    for shape, tags in extract.areas:
        if _is_next_to_road(tags) and shape.intersects(window):
            near_areas.append((shape, _ORIENTATIONS.get(tags.get("orientation", ""), 0)))
    return Parking(tuple(near_roads), tuple(near_areas), lefthand)


def _is_next_to_road(tags: Tags) -> bool:
    """True for the tags of an area of parking that is part of a street."""
    return tags.get("amenity") == "parking" and tags.get("parking") in _NEXT_TO_ROAD


def _find_direction(line: shapely.LineString, distance: float) -> Float64[np.ndarray, "2"]:
    """Unit vector along a line, over 1 m at a distance (m) from its start."""
    spots = line.interpolate([max(distance - 0.5, 0.0), distance + 0.5])
    start, end = shapely.get_coordinates(spots)
    ahead = end - start
    return ahead / max(float(np.hypot(*ahead)), 1e-9)


def _read_angle(tags: Tags, side: str) -> Angle:
    """Angle of parking on one side of a road (degrees), None for no parking.

    Tags are today's, as parking:left=lane, or the older ones, as parking:lane:left=parallel. side:
    "left" or "right"."""
    parking = _read_side_tag(tags, "parking", side)
    if _read_side_tag(tags, "parking", side, ":restriction") in _FORBIDDEN:
        return None
    if not parking:
        older_value = _read_side_tag(tags, "parking:lane", side)
        return 0 if older_value == "marked" else _ORIENTATIONS.get(older_value)
    if parking not in (*_NEXT_TO_ROAD, "yes"):
        return None
    orientation = _read_side_tag(tags, "parking", side, ":orientation")
    return _ORIENTATIONS.get(orientation, 0)


def _read_side_tag(tags: Tags, key: str, side: str, suffix: str = "") -> str:
    """Value of a tag KEY:SIDE or, without it, KEY:both, in lower case; "" without both.

    suffix: text after the side in the name of the tag."""
    text = tags.get(f"{key}:{side}{suffix}") or tags.get(f"{key}:both{suffix}") or ""
    return text.strip().lower()
