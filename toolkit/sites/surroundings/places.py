"""Places along lines."""

import numpy as np
import shapely

from toolkit.arrays import Float, Float64

Bays = Float64[np.ndarray, "n 3"]  # x, y (m), yaw (rad)
FreeBays = Float64[np.ndarray, "free 3"]  # those of them that nothing stands in


def points_along(lines: shapely.Geometry, step: float) -> Float64[np.ndarray, "n 3"]:
    """Rows x, y (m), direction of the line (rad from +x) every `step` m along lines.

    Lines that meet end to end count as one; lines shorter than two steps are left out. Other types
    of geometry in `lines` are ignored."""
    rows = [np.zeros((0, 3))]
    for line in shapely.get_parts(shapely.line_merge(lines)):
        if line.geom_type == "LineString" and line.length >= 2 * step:
            distances = np.arange(step / 2, line.length - step / 2, step)
            points = shapely.get_coordinates(line.interpolate(distances))
            points_ahead = shapely.get_coordinates(line.interpolate(distances + step / 2))
            dx, dy = (points_ahead - points).T
            rows.append(np.column_stack([points, np.arctan2(dy, dx)]))
    return np.concatenate(rows)


def place_along(line: shapely.LineString, distances: Float[np.ndarray, " n"], half: float) -> Bays:
    """Rows x, y (m), heading (rad from +x) of objects placed along a line.

    distances: m along the line to the middle of each object; half: half the length (m) of an
    object, whose ends are both on the line."""
    rear = shapely.get_coordinates(line.interpolate(distances - half)).reshape(-1, 2)
    front = shapely.get_coordinates(line.interpolate(distances + half)).reshape(-1, 2)
    dx, dy = (front - rear).T
    return np.column_stack([(rear + front) / 2, np.arctan2(dy, dx)])
