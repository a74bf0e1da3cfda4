"""Places along lines."""

import numpy as np
import shapely

from toolkit.arrays import Float, Float64

Bays = Float64[np.ndarray, "n 3"]  # x, y (m), yaw (rad)


def along(lines: shapely.Geometry, step: float) -> Float64[np.ndarray, "n 3"]:
    """Rows x, y (m), direction (rad from +x) every `step` m along lines.

    Lines that meet end to end count as one; those shorter than two steps are left out."""
    rows = [np.zeros((0, 3))]
    for line in shapely.get_parts(shapely.line_merge(lines)):
        if line.geom_type == "LineString" and line.length >= 2 * step:
            at = np.arange(step / 2, line.length - step / 2, step)
            points = shapely.get_coordinates(line.interpolate(at))
            ahead = shapely.get_coordinates(line.interpolate(at + step / 2))
            # [::-1]: arctan2 takes y first
            rows.append(np.column_stack([points, np.arctan2(*(ahead - points).T[::-1])]))
    return np.concatenate(rows)


def place_along(line: shapely.LineString, at: Float[np.ndarray, " n"], half: float) -> Bays:
    """Rows x, y (m), heading (rad from +x) of things placed along a line.

    at: distances (m) of the middles along the line; half: half the length (m) of a thing, both
    ends of which are on the line."""
    rear = shapely.get_coordinates(line.interpolate(at - half)).reshape(-1, 2)
    front = shapely.get_coordinates(line.interpolate(at + half)).reshape(-1, 2)
    return np.column_stack([(rear + front) / 2, np.arctan2(*(front - rear).T[::-1])])
