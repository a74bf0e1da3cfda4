"""Networks turned from a map's coordinates into a site's frame."""

from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float64, Pose
from toolkit.sites import network as nets


def move_network_to_site(network: str, map_SE3_site: Pose) -> str:
    """Turn a net.xml text from the map's coordinates into the site's, without heights.

    map_SE3_site: pose of the site in the map; only x, y and the heading count. Outlines of
    junctions and walking areas that cross themselves are repaired."""
    # the site's origin in the map (m)
    origin = map_SE3_site[:2, 3]
    rotation = map_SE3_site[:2, :2]
    # rows of points: (xy - origin) @ rotation turns by the transpose, from the map to the site
    root = ElementTree.fromstring(network)
    for element in root.iter():
        if "shape" in element.attrib:
            points = (nets.parse_shape(element) - origin) @ rotation
            # SUMO names a walking area :JUNCTION_wNUMBER
            is_walking_area = "_w" in element.get("id", "").partition(":")[2]
            is_closed = element.tag == "junction" or is_walking_area
            if is_closed and len(points) > 2:
                points = _repair_outline(points)
            element.set("shape", " ".join(f"{x:.3f},{y:.3f}" for x, y in points))
        if element.tag == "junction":
            place = np.array([float(element.get("x", 0)), float(element.get("y", 0))])
            site_x, site_y = (place - origin) @ rotation
            element.attrib |= {"x": f"{site_x:.3f}", "y": f"{site_y:.3f}"}
            element.attrib.pop("z", None)
        if element.tag == "location":
            origin_x, origin_y = origin
            element.set("netOffset", f"{-origin_x:.3f},{-origin_y:.3f}")
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _repair_outline(ring: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "_ 2"]:
    """Largest part of an outline that crosses itself; a sound outline comes back unchanged.

    An outline without area becomes a strip 0.1 m wide. ring: corners x, y (m)."""
    shape = shapely.Polygon(ring.round(3))
    if shape.is_valid:
        return ring
    valid_shape = shapely.set_precision(shapely.make_valid(shape), 1e-3)
    polygons = [polygon for polygon in nets.list_polygons(valid_shape) if polygon.area > 0]
    strip = shapely.LineString(ring).buffer(0.05, cap_style="square", join_style="mitre")
    largest_polygon = max(polygons, key=shapely.area, default=strip.convex_hull)
    return shapely.get_coordinates(largest_polygon.exterior)[:-1]  # the last corner is the first
