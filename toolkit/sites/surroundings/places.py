"""Places along lines."""

import numpy as np
import shapely

from toolkit.arrays import Float, Float64

Bays = Float64[np.ndarray, "n 3"]


def along(lines: shapely.Geometry, step: float) -> Float64[np.ndarray, "n 3"]:
    """Points x, y and direction (rad) every `step` m along `lines`."""
    rows = [np.zeros((0, 3))]
    for line in shapely.get_parts(shapely.line_merge(lines)):
        if line.geom_type == "LineString" and line.length >= 2 * step:
            at = np.arange(step / 2, line.length - step / 2, step)
            points = shapely.get_coordinates(line.interpolate(at))
            ahead = shapely.get_coordinates(line.interpolate(at + step / 2))
            rows.append(np.column_stack([points, np.arctan2(*(ahead - points).T[::-1])]))
    return np.concatenate(rows)


def place_along(line: shapely.LineString, at: Float[np.ndarray, " n"], half: float) -> Bays:
    """Places x, y and headings `at` metres along a line.

    Both ends, `half` m from each middle, are on the line."""
    rear = shapely.get_coordinates(line.interpolate(at - half)).reshape(-1, 2)
    front = shapely.get_coordinates(line.interpolate(at + half)).reshape(-1, 2)
    return np.column_stack([(rear + front) / 2, np.arctan2(*(front - rear).T[::-1])])
