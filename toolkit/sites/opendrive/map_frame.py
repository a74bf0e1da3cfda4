"""Shapes between the frame of a map and a site."""

import shapely
import shapely.affinity

from toolkit.arrays import Pose


def move_shape_to_site(shape: shapely.Geometry, map_SE3_site: Pose) -> shapely.Geometry:
    """Shape of the map in the site's frame."""
    return shapely.transform(shape, lambda xy: (xy - map_SE3_site[:2, 3]) @ map_SE3_site[:2, :2])


def move_shape_to_map(shape: shapely.Geometry, map_SE3_site: Pose) -> shapely.Geometry:
    """Shape of the site in the map's frame."""
    return shapely.transform(shape, lambda xy: xy @ map_SE3_site[:2, :2].T + map_SE3_site[:2, 3])
