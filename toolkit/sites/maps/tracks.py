"""Ground that vehicles drive on along a network's lanes and over its junctions."""

from xml.etree import ElementTree

import numpy as np
import shapely

from toolkit.arrays import Float, Float64
from toolkit.sites import network as nets

MAX_TRACK_M = 3.5  # width of the track that a vehicle follows over a junction
CORNER_CUT_M = 1.2  # ground with lowered kerbs next to the track of a turning vehicle
TURNING_BODY_M = (5.5, 2.6)  # length and width of a turning vehicle, with room next to it
TURNING_STEP_M = 0.5  # between the places at which a turning vehicle's ground is taken
MIN_BEND_M = 0.3  # deviation from a straight line of a track that counts as bent


def find_tracks(network: str) -> shapely.Geometry:
    """Union of the ground that motor vehicles drive on in a network.

    Over junctions it includes the ground under a turning vehicle. network: net.xml text."""
    tracks = []
    for edge, lane in nets.list_lanes(network, "normal", "internal"):
        if "passenger" in nets.list_users(lane):
            tracks.append(_make_track(lane))
            if edge.get("function") == "internal":
                tracks += _sweep_body(nets.parse_shape(lane))
    return shapely.union_all(tracks)


def find_turns(network: str) -> shapely.Geometry:
    """Ground within `CORNER_CUT_M` of bent tracks over a network's junctions.

    network: net.xml text. Kerbs are lowered there."""
    bent_tracks = []
    for _, lane in nets.list_lanes(network, "internal"):
        if "passenger" in nets.list_users(lane):
            points = nets.parse_shape(lane)
            chord = shapely.LineString([points[0], points[-1]])
            if shapely.LineString(points).hausdorff_distance(chord) > MIN_BEND_M:
                bent_tracks += [_make_track(lane), *_sweep_body(points)]
    return shapely.union_all(bent_tracks).buffer(CORNER_CUT_M)


def _make_track(lane: ElementTree.Element) -> shapely.Geometry:
    """Ground that is driven on along a lane, at most `MAX_TRACK_M` wide; empty without a line."""
    points = nets.parse_shape(lane)
    if len(points) < 2:
        return shapely.Polygon()
    half_width = min(nets.lane_width(lane), MAX_TRACK_M) / 2
    line = shapely.LineString(points).simplify(0.05)
    return line.buffer(half_width, cap_style="flat", quad_segs=4)


def _sweep_body(path: Float[np.ndarray, "k 2"]) -> list[shapely.Geometry]:
    """Rectangles under a vehicle of `TURNING_BODY_M` with both ends on a path, at steps along it.

    The vehicle begins right before the path and ends right after it, on straight extensions. A path
    shorter than a step gives no rectangles. path: rows of x, y (m)."""
    length, width = TURNING_BODY_M
    if shapely.LineString(path).length < TURNING_STEP_M:
        return []
    first_direction = _normalize(path[1] - path[0])
    last_direction = _normalize(path[-1] - path[-2])
    start = path[0] - length * first_direction
    end = path[-1] + length * last_direction
    line = shapely.LineString([start, *path, end])
    # m along the line to the rear of the vehicle
    distances = np.arange(0.0, line.length - length, TURNING_STEP_M)
    rear = shapely.get_coordinates(line.interpolate(distances)).reshape(-1, 2)
    front = shapely.get_coordinates(line.interpolate(distances + length)).reshape(-1, 2)
    # middle line of the vehicle at each step
    middles = shapely.linestrings(np.stack([rear, front], axis=1))
    return list(shapely.buffer(middles, width / 2, cap_style="flat"))


def _normalize(vector: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "2"]:
    """Vector of length 1 in the same direction; a zero vector stays zero."""
    return vector / max(np.hypot(*vector), 1e-9)
