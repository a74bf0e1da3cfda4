"""Strips of frame after frame: what stands where it stood, and all that may hide it, is not cast again.

Rays show of such an object what they showed in the frame before, so its strips are those of that frame, to the last
bit. What may hide an object is taken generously: whatever overlaps with it in azimuth and elevation, as seen from the
viewpoint, and begins no farther off than the object ends, with circles in place of the footprints. Of bodies that stick
in each other a ray may meet both at once, and which of them it is said to meet is chance: these are cast every time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64
from toolkit.bodies.body import Body
from toolkit.rendering.moment import Footprints, Moment
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.strips import Counted, Sectors, Strips, joined, sectors_of, strips_in

OVERLAP_SLACK = 1e-3  # rad, and m, within which objects are taken to overlap
PAIRS_AT_ONCE = 1_000_000  # of objects, seen from all of some viewpoints

PlacedBody = tuple[Body, bytes, bool]  # a body, its box, and whether it is looked at finely


class _Last(NamedTuple):
    """Of the frame before: its objects, which may hide which (`may_hide`), and its strips."""

    objects: list[PlacedBody]
    hiders: Bool[np.ndarray, "V n n"]
    strips: Strips


class SuccessiveStrips:
    """What `strips_of` finds of one frame after the other, seen from the same viewpoints; counted: as of `strips_of`.
    Which frames were looked at before makes a difference to the time alone."""

    def __init__(self, renderer: Renderer, viewpoints: Float64[np.ndarray, "V 3"], counted: Counted) -> None:
        self._renderer, self._viewpoints, self._counted = renderer, viewpoints, counted
        self._last: _Last | None = None

    def of(self, moment: Moment, fine: Bool[np.ndarray, " n"]) -> Strips:
        """Strips of a frame; fine: as of `strips_of`."""
        boxes = [box.tobytes() for box in moment.boxes]
        objects = list(zip(moment.bodies, boxes, fine.tolist(), strict=True))
        sectors = sectors_of(moment.ground, self._viewpoints, fine)
        hiders = may_hide(moment.ground, self._viewpoints, sectors)
        kept, again = self._unchanged(objects, hiders, ~touching(moment.ground))
        some = sectors.take(np.flatnonzero(~kept))
        strips = strips_in(self._renderer, moment, self._viewpoints, self._counted, some)
        if len(again.item):
            strips = joined([again, strips])
            pair = strips.viewpoint.astype(np.int64) * len(objects) + strips.item
            order = np.argsort(pair, kind="stable")
            strips = Strips(*(each.take(order) for each in strips))
        alike = len(set(objects)) < len(objects)  # one in the other: which of them is which cannot be said
        self._last = None if alike else _Last(objects, hiders, strips)
        return strips

    def _unchanged(self, objects: list[PlacedBody], hiders: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, Strips]:
        """Which pairs of viewpoint and object show what they showed, and the strips of these; free: which objects touch
        no other one."""
        kept, last = np.zeros(hiders.shape[:2], np.bool_), self._last
        if last is None:
            return kept, joined([])
        rows = {each: row for row, each in enumerate(last.objects)}
        before = np.array([rows.get(each, -1) for each in objects], np.int64)
        stands, come = np.flatnonzero(before >= 0), before < 0
        if not len(stands):
            return kept, joined([])
        before = before[stands]
        now = np.full(len(rows), -1, np.int32)
        now[before] = stands
        newly = hiders[:, stands][:, :, come].any(axis=2)
        formerly = last.hiders[:, before][:, :, now < 0].any(axis=2)
        kept[:, stands] = ~(newly | formerly) & free[stands]
        item = now.take(last.strips.item)
        rows_kept = np.flatnonzero((item >= 0) & kept[last.strips.viewpoint, item])
        same = last.strips._replace(item=item)
        return kept, Strips(*(each.take(rows_kept) for each in same))


def may_hide(ground: Footprints, viewpoints: Float64[np.ndarray, "V 3"], sectors: Sectors) -> Bool[np.ndarray, "V n n"]:
    """Whether, seen from a viewpoint, an object (second axis) may be hidden by another one (third axis); sectors: of
    all pairs of viewpoint and object."""
    shape = len(viewpoints), len(ground.low)
    found = np.zeros((*shape, shape[1]), np.bool_)
    half = (sectors.width * sectors.columns / 2).reshape(shape)
    middle = sectors.start.reshape(shape) + half
    step = max(1, PAIRS_AT_ONCE // max(1, shape[1] ** 2))
    for first in range(0, shape[0], step):
        some = slice(first, first + step)
        near, far, low, high = _extents(ground, viewpoints[some])
        apart = np.abs((middle[some, :, None] - middle[some, None] + np.pi) % (2 * np.pi) - np.pi)
        found[some] = apart <= half[some, :, None] + half[some, None] + OVERLAP_SLACK
        found[some] &= near[:, None] <= far[:, :, None] + OVERLAP_SLACK
        found[some] &= low[:, None] <= high[:, :, None] + OVERLAP_SLACK
        found[some] &= high[:, None] >= low[:, :, None] - OVERLAP_SLACK
    found[:, np.arange(shape[1]), np.arange(shape[1])] = False
    return found


def touching(ground: Footprints) -> Bool[np.ndarray, " n"]:
    """Which objects stand so near to another one that the rectangles round their footprints meet: no line between them
    runs along a side of either (the separating axis theorem)."""
    half, cos, sin = ground.rectangles[:, 2:4], ground.rectangles[:, 4], ground.rectangles[:, 5]
    axes = np.stack([np.column_stack([cos, sin]), np.column_stack([-sin, cos])], axis=1)
    offset = ground.rectangles[None, :, :2] - ground.rectangles[:, None, :2]
    reach = half[:, :, None] + np.einsum("iajb,jb->iaj", np.abs(np.einsum("iac,jbc->iajb", axes, axes)), half)
    apart = (np.abs(np.einsum("ijc,iac->iaj", offset, axes)) > reach + OVERLAP_SLACK).any(axis=1)
    meets = ~(apart | apart.T)
    np.fill_diagonal(meets, False)
    return np.asarray(meets.any(axis=1))


def _extents(
    ground: Footprints, viewpoints: Float64[np.ndarray, "v 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """How far off each object begins and ends, seen from above, and its elevations, taken generously."""
    x, y, half_length, half_width, *_ = ground.rectangles.T
    distance = np.hypot(x - viewpoints[:, :1], y - viewpoints[:, 1:2])
    radius = np.hypot(half_length, half_width)
    near, far = np.maximum(distance - radius, 0), distance + radius
    below, above = (each - viewpoints[:, 2:] for each in (ground.low, ground.high))
    low = np.arctan2(below, np.where(below < 0, near, far))
    return near, far, low, np.arctan2(above, np.where(above < 0, far, near))
