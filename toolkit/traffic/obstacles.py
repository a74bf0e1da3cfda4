"""Obstacles in the way of traffic, and boxes kept apart from them and from one another."""

from __future__ import annotations

import numpy as np
import shapely

from toolkit.arrays import Bool, Float64
from toolkit.boxes import footprints
from toolkit.sites.site import Site

_Boxes = Float64[np.ndarray, "n 7"]
GAP = 0.1  # m left between bodies
STEPS_ASIDE = (0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75, 1.0, -1.0)  # m, tried in this order
_WALKABLE = 0.3  # m above the ground; lower solids can be stepped on


class Obstacles:
    """Static solids high enough to be in the way, indexed by place.

    Heights count from the plane of the ground, as those of boxes do until a snapshot puts them on the ground.
    """

    def __init__(self, site: Site) -> None:
        middles = np.array([solid.footprint.mean(axis=0) for solid in site.solids]).reshape(-1, 2)
        above = np.array([solid.top for solid in site.solids]) - site.ground(middles)
        blocking = [solid for solid, height in zip(site.solids, above, strict=True) if height > _WALKABLE]
        places = np.array([solid.footprint.mean(axis=0) for solid in blocking]).reshape(-1, 2)
        self.bases = np.array([solid.base for solid in blocking]) - site.plane(places)
        self.tree = shapely.STRtree([shapely.Polygon(solid.footprint) for solid in blocking])

    def hit(self, boxes: _Boxes) -> Bool[np.ndarray, " n"]:
        """Mask of boxes that touch an obstacle; they pass under one that begins above them, such as a tree's crown."""
        rows, obstacles = self.tree.query(_shapes(boxes), predicate="intersects")
        hit = np.zeros(len(boxes), bool)
        hit[rows[self.bases[obstacles] < boxes[rows, 2] + boxes[rows, 5] / 2]] = True
        return hit


def separate(boxes: _Boxes, obstacles: Obstacles) -> tuple[_Boxes, Bool[np.ndarray, " n"], int]:
    """Separate boxes; return them, a mask of kept rows and the number of changes.

    Earlier rows have precedence. A row in the way steps aside by up to 1 m across its heading, or is dropped.
    """
    kept = np.ones(len(boxes), bool)
    in_the_way = np.flatnonzero(overlaps(boxes).any(axis=0) | obstacles.hit(boxes))
    if not len(in_the_way):
        return boxes, kept, 0
    settled, shapes = boxes.copy(), _shapes(boxes)
    for row in in_the_way:
        kept[row] = False  # so that `kept` are the others
        places = np.tile(boxes[row], (len(STEPS_ASIDE), 1))
        places[:, :2] += np.outer(STEPS_ASIDE, [-np.sin(boxes[row, 6]), np.cos(boxes[row, 6])])
        place_shapes = _shapes(places)
        free = ~obstacles.hit(places) & ~shapely.intersects(place_shapes[:, None], shapes[kept][None]).any(axis=1)
        first = np.argmax(free)
        kept[row], settled[row], shapes[row] = free[first], places[first], place_shapes[first]
    return settled, kept, int((~kept | (settled != boxes).any(axis=1)).sum())


def overlaps(boxes: _Boxes) -> Bool[np.ndarray, "n n"]:
    """Mask of pairs of boxes closer than `GAP`, above the diagonal."""
    radius = np.hypot(boxes[:, 3] + GAP, boxes[:, 4] + GAP) / 2
    gaps = boxes[:, None, :2] - boxes[None, :, :2]
    i, j = np.nonzero(np.triu(np.square(gaps).sum(-1) < np.square(radius[:, None] + radius[None]), 1))
    shapes = _shapes(boxes)
    close = np.zeros((len(boxes), len(boxes)), bool)
    close[i, j] = shapely.intersects(shapes[i], shapes[j])
    return close


def _shapes(boxes: _Boxes) -> np.ndarray:
    widened = boxes.copy()
    widened[:, 3:5] += GAP  # half of it on each side: two neighbours keep one gap
    return shapely.polygons(footprints(widened))
