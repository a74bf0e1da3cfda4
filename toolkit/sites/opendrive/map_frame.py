"""Shapes between the frame of a map and a site."""

import shapely
import shapely.affinity

from toolkit.arrays import Pose


def move_shape_to_site(shape: shapely.Geometry, map_SE3_site: Pose) -> shapely.Geometry:
    """Turn a shape from the map's frame into the site's.

    map_SE3_site: pose of the site in the map; only x, y and the heading count."""
    return shapely.transform(shape, lambda xy: (xy - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2])


def move_shape_to_map(shape: shapely.Geometry, map_SE3_site: Pose) -> shapely.Geometry:
    """Turn a shape from the site's frame into the map's, the inverse of `move_shape_to_site`."""
    return shapely.transform(shape, lambda xy: xy @ map_SE3_site[:2, :2].T + map_SE3_site[:2, 3])
