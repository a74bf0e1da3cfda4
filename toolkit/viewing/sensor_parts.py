"""Sensors in a scene: their housing, and the lines of what they look at."""

from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Float32, Float64, ImageRanges
from toolkit.mesh import box
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site
from toolkit.viewing.box_lines import Segments
from toolkit.viewing.scene import Spot
from toolkit.viewing.scene_parts import add_mesh, thin_evenly

if TYPE_CHECKING:
    from viser import SceneApi

REACH_M = 20.0  # greatest horizontal distance between a sensor and its handle
HANDLE_LIFT_M = 0.3  # height of a handle above the ground
RAY_WITHOUT_RETURN_M = 12.0  # length of rays that meet nothing
MAX_OUTLINE_PIXELS = 240  # pixels of the outline of a sensor's view
MAX_EDGE_SHARE = 0.25  # length of an outline's edge as a share of its ray; longer ones are left out


def add_housing(api: "SceneApi", name: str, position: Spot, size: Spot, colour: str) -> None:
    """Add the housing of a sensor that stays where it is: a box along the axes.

    name: path of the node; position: middle (m); size: sizes along x, y and z (m); colour:
    #rrggbb."""
    add_mesh(api, name, mesh=box(size=size, centre=position), colour=colour)


def find_target(site: Site, sensor: Sensor) -> Float64[np.ndarray, "3"]:
    """Find the position (m) of a sensor's handle: the point of the ground that it looks at.

    The handle is on the line of sight, just above the ground, but no farther than `REACH_M`
    horizontally."""
    ahead = sensor.world_SE3_body[:3, 0]  # unit vector along the line of sight
    ground_z = float(site.ground(sensor.position[:2]))
    horizontal_length = max(float(np.hypot(*ahead[:2])), 1e-6)  # `ahead` seen from above
    # distance (m) along the line of sight to the handle's height, very long if it looks up
    distance_to_ground = (sensor.position[2] - ground_z - HANDLE_LIFT_M) / max(
        -float(ahead[2]), 1e-9
    )
    distance = min(distance_to_ground, REACH_M / horizontal_length)
    return np.asarray(sensor.position + ahead * distance)


def draw_view(
    site: Site, sensor: Sensor, target: Float64[np.ndarray, "3"]
) -> Float32[np.ndarray, "n 2 3"]:
    """Lines (start and end, m) that show the view of a sensor.

    They go from the sensor to its handle and its foot, along both sides of its field of view, and
    from the handle to the ends of both sides. A full circle has no sides. target: position of the
    handle (m)."""
    half_angle = min(sensor.model.horizontal_fov / 2, np.pi)
    is_full_circle = half_angle >= np.pi - 1e-6
    x, y, z = target - sensor.position  # vector from the sensor to its handle (m)
    side_ends = []  # both sides of the field of view, as far as the handle
    for turn in () if is_full_circle else (-half_angle, half_angle):
        cos, sin = np.cos(turn), np.sin(turn)
        # the vector to the handle, turned about the vertical
        to_side_end = np.array([cos * x - sin * y, sin * x + cos * y, z])
        side_ends.append(sensor.position + to_side_end)
    foot = np.array([*sensor.position[:2], site.ground(sensor.position[:2])])
    lines = [(sensor.position, end) for end in (target, *side_ends, foot)]
    lines += [(target, end) for end in side_ends]
    return np.array(lines, np.float32)


def view_edges(sensor: Sensor, background: ImageRanges) -> Segments:
    """Return the outline of a sensor's view of the empty site, and four rays that lead to it.

    The outline follows the border of the image, at up to `MAX_OUTLINE_PIXELS` of its pixels; rays
    that meet nothing have a length of at most `RAY_WITHOUT_RETURN_M`. Segments are pairs of points
    in the site's frame (m).

    background: distances (m) at the empty site, 0 without a return."""
    rows, columns = background.shape
    pixel = np.arange(rows * columns).reshape(rows, columns)  # number of each pixel, row by row
    # pixels of the border: top row, right column, bottom row backwards, left column upwards
    border = np.concatenate([pixel[0], pixel[1:, -1], pixel[-1, -2::-1], pixel[-2:0:-1, 0]])
    outline_pixels = thin_evenly(border, MAX_OUTLINE_PIXELS)
    distances = background.ravel()[outline_pixels].astype(np.float64)
    length_without_return = min(sensor.model.max_range, RAY_WITHOUT_RETURN_M)
    lengths = np.where(distances > 0, distances, length_without_return)
    # `world_rays` has a column for each pixel: its direction, in units of the measured distance
    ends = sensor.position + sensor.world_rays.T[outline_pixels] * lengths[:, None]
    next_ends = np.roll(ends, -1, axis=0)
    # an edge that is long for its ray jumps to an object behind, and is left out
    is_jump = np.linalg.norm(next_ends - ends, axis=1) > MAX_EDGE_SHARE * lengths
    outline = np.stack([ends, next_ends], axis=1)[~is_jump]
    ray_ends = ends[np.linspace(0, len(ends), 4, endpoint=False).astype(np.int64)]
    ray_starts = np.broadcast_to(sensor.position, ray_ends.shape)
    return np.concatenate([outline, np.stack([ray_starts, ray_ends], axis=1)])
