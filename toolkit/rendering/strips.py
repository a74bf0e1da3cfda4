"""Upright strips of what is seen of moving objects: a panorama that keeps nothing but the objects.

From a viewpoint, an object is cut into columns of equal azimuth between the two tangents at its
footprint. In each column some rays are cast, evenly spaced in elevation; where two neighbours
differ in what they show of the object bisection finds the edge between them. A strip is between
two such edges. Other objects and the static scene hide as they do in `toolkit.rendering.renderer`,
ray for ray; only below `STRIP_WIDTH` is anything lost.

Successive frames share strips: an object that stands where it stood, and all that may hide it, is
not cast again. What may hide an object is taken generously: whatever overlaps with it in azimuth
and elevation and begins no farther off than the object ends, with circles for footprints. Bodies
that stick in each other are cast every time, since it is chance which one a ray meets."""

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float32, Float64, Int32, Int64, Mask
from toolkit.bodies.body import Body
from toolkit.points import Crop
from toolkit.rendering.renderer import Footprints, Moment, Renderer
from toolkit.sensors.sensor import NEAR

# rad between columns of objects to look at finely; rays in a column are about twice as far apart
STRIP_WIDTH = float(np.deg2rad(0.4))
COARSE = float(np.deg2rad(1.0))  # the same for other objects, which are not scored
# fewest and most columns of an object, fewest and most rays of a column
COLUMNS = (6, 48)
ROWS = (5, 20)
HALVINGS = 3  # bisections of the interval between two rays, to find an edge
EDGE = 1e-3  # m by which rectangles are widened
RAYS_AT_ONCE = 400_000  # rays cast together, which limits memory
OVERLAP_SLACK = 1e-3  # rad, and m, within which objects are taken to overlap
PAIRS_AT_ONCE = 1_000_000  # pairs of objects compared together, which limits memory
# what a strip shows: object points outside the crop; in the crop and within the radius; in the crop
# and beyond the radius (see `Counted`)
OUTSIDE = 1
WITHIN = 2
BEYOND = 3

Eyes = Float64[np.ndarray, "viewpoints 3"]  # viewpoints x, y, z (m, world frame)
# kind of view of each ray, 0 if it misses its object; arguments: row of the ray's sector, azimuth
# and elevation (rad)
Shows = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Strips(NamedTuple):
    """Upright strips of the visible parts of objects, one per row."""

    viewpoint: Int32[np.ndarray, " n"]  # row of the viewpoint
    item: Int32[np.ndarray, " n"]  # row of the object in its moment
    # azimuths of its sides (rad, world frame, counter-clockwise from +x), left < right; left is -2
    # pi or more, and neither is wrapped
    left: Float32[np.ndarray, " n"]
    right: Float32[np.ndarray, " n"]
    # elevations of its ends (rad above the horizon), bottom < top
    bottom: Float32[np.ndarray, " n"]
    top: Float32[np.ndarray, " n"]
    shows: Int32[np.ndarray, " n"]  # `OUTSIDE`, `WITHIN` or `BEYOND`

    def take(self, rows: Int64[np.ndarray, " m"]) -> "Strips":
        """Choose strips by row."""
        return Strips(*(column.take(rows) for column in self))


class Counted(NamedTuple):
    """Limits by which points of objects count.

    Points outside `crop` do not count; the others are far if more than `radius` (m, seen from
    above) from the viewpoint."""

    crop: Crop
    radius: float


class Sectors(NamedTuple):
    """Sectors of azimuth that objects fill, one row per pair of viewpoint and object."""

    viewpoint: Int64[np.ndarray, " p"]  # row of the viewpoint
    item: Int64[np.ndarray, " p"]  # row of the object in its moment
    start: Float64[np.ndarray, " p"]  # azimuth at which the first column begins (rad)
    width: Float64[np.ndarray, " p"]  # width of one column (rad)
    columns: Int64[np.ndarray, " p"]  # number of columns
    step: Float64[np.ndarray, " p"]  # about how far apart the rays of a column are (rad)

    def take(self, pairs: Int64[np.ndarray, " q"]) -> "Sectors":
        """Choose sectors; pairs: their rows."""
        return Sectors(*(column.take(pairs) for column in self))


class _Columns(NamedTuple):
    """Columns of rays, sector after sector.

    Ray k of a column, k from 1 to `rows`, has the elevation low + k * step."""

    window: Int64[np.ndarray, " c"]  # row of its sector
    azimuth: Float64[np.ndarray, " c"]  # azimuth of its middle (rad)
    low: Float64[np.ndarray, " c"]  # elevation one step below its lowest ray (rad)
    step: Float64[np.ndarray, " c"]  # between its rays (rad)
    rows: Int64[np.ndarray, " c"]  # number of rays

    def take(self, part: slice) -> "_Columns":
        """Choose successive columns."""
        return _Columns(*(column[part] for column in self))


def cast_strips(
    renderer: Renderer, moment: Moment, viewpoints: Eyes, counted: Counted, windows: Sectors
) -> Strips:
    """Cast rays in sectors and return the visible strips of their objects.

    Args:
        renderer: gives the static scene, which hides objects.
        moment: objects, which also hide each other.
        windows: sectors to cast, each seen from a viewpoint and towards an object; strips follow
            their order."""
    columns = _columns(moment.ground, viewpoints, windows)
    item = windows.item.astype(np.int32)
    start = viewpoints[windows.viewpoint].astype(np.float32)

    def shows(window: np.ndarray, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """Kind of view of each ray on its object: `OUTSIDE`, `WITHIN`, `BEYOND`, 0 if not seen.

        window: row in `windows` of each ray's sector, whose object counts as seen; azimuth,
        elevation: direction of each ray (rad)."""
        # start x, y, z, and direction
        lines = np.empty((len(window), 6), np.float32)
        lines[:, :3] = start.take(window, axis=0)
        horizontal_length = np.cos(elevation)  # horizontal part of the unit direction
        np.multiply(horizontal_length, np.cos(azimuth), out=lines[:, 3])
        np.multiply(horizontal_length, np.sin(azimuth), out=lines[:, 4])
        np.sin(elevation, out=lines[:, 5])
        # item that each line meets first, and the length (m) up to it
        met_item, length = moment.met(lines)
        on_object = np.flatnonzero((met_item == item.take(window)) & (length > NEAR))
        ray_kinds = np.zeros(len(window), np.uint8)
        if not len(on_object):
            return ray_kinds
        lines = lines.take(on_object, axis=0)
        length = length.take(on_object)
        points = lines[:, 3:] * length[:, None] + lines[:, :3]
        is_beyond = length * horizontal_length.take(on_object) > counted.radius
        kinds = np.where(is_beyond, np.uint8(BEYOND), np.uint8(WITHIN))
        kinds[~counted.crop.holds(points)] = OUTSIDE
        # from here on ways from `NEAR` in front of the viewpoint to the point on the object
        lines[:, :3] += np.float32(NEAR) * lines[:, 3:]
        lines[:, 3:] *= (length - np.float32(NEAR))[:, None]
        kinds[renderer.still_hides(lines)] = 0
        ray_kinds[on_object] = kinds
        return ray_kinds

    # parts of whole columns with about `RAYS_AT_ONCE` rays each
    ends = np.cumsum(columns.rows)
    cuts = np.searchsorted(
        ends, np.arange(RAYS_AT_ONCE, ends[-1] if len(ends) else 0, RAYS_AT_ONCE)
    )
    parts = [slice(*cut) for cut in pairwise([0, *cuts, len(ends)]) if cut[1] > cut[0]]
    return concatenate_strips([_strips(shows, windows, columns.take(rows)) for rows in parts])


def concatenate_strips(parts: list[Strips]) -> Strips:
    """Join parts one after the other, or return strips of length 0 if there are no parts."""
    if not parts:
        integers = np.zeros(0, np.int32)
        numbers = np.zeros(0, np.float32)
        return Strips(
            viewpoint=integers,
            item=integers,
            left=numbers,
            right=numbers,
            bottom=numbers,
            top=numbers,
            shows=integers,
        )
    return Strips(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def find_sectors(ground: Footprints, viewpoints: Eyes, fine: Mask) -> Sectors:
    """Sector of each object seen from each viewpoint, object after object within a viewpoint.

    fine: mask of the objects to cut into columns of `STRIP_WIDTH`; others get `COARSE` ones."""
    if not len(ground.low) or not len(viewpoints):
        integers = np.zeros(0, np.int64)
        numbers = np.zeros(0)
        return Sectors(
            viewpoint=integers,
            item=integers,
            start=numbers,
            width=numbers,
            columns=integers,
            step=numbers,
        )
    begin = ground.first[:-1]
    sizes = np.diff(ground.first)
    # middle of each footprint's corners, (viewpoint, object, x y) counted from the viewpoint;
    # below, (viewpoint, corner) for `offset`, `ahead` and `angle`
    middle = (
        np.add.reduceat(ground.points, begin, axis=0) / sizes[:, None] - viewpoints[:, None, :2]
    )
    offset = ground.points - viewpoints[:, None, :2]
    middle[np.abs(middle).max(axis=2) < EDGE] = EDGE, 0  # right below, any direction will do
    ahead = np.repeat(middle, sizes, axis=1)
    cross = ahead[..., 0] * offset[..., 1] - ahead[..., 1] * offset[..., 0]
    angle = np.arctan2(cross, (ahead * offset).sum(axis=2))
    # angles of the two tangents to each footprint, from the direction to its middle
    first, last = (
        reduction.reduceat(angle, begin, axis=1) for reduction in (np.minimum, np.maximum)
    )
    is_around = last - first >= np.pi  # the viewpoint is above or within the object
    first = np.where(is_around, -np.pi, first)
    last = np.where(is_around, np.pi, last)
    grid = np.broadcast_to(np.where(fine, STRIP_WIDTH, COARSE), first.shape)
    down = (ground.low + ground.high) / 2 - viewpoints[:, 2:]
    across = np.linalg.norm(middle, axis=2)
    # looking down steeply, a degree of azimuth is a shorter arc: fewer columns, but at least a
    # tenth
    flatness = np.maximum(across / np.maximum(np.hypot(across, down), 1e-9), 0.1)
    columns = np.clip(np.ceil((last - first) * flatness / grid), *COLUMNS).astype(np.int64)
    start = np.arctan2(middle[..., 1], middle[..., 0]) + first
    viewpoint, item = np.indices(first.shape).reshape(2, -1)
    width = (last - first) / columns
    return Sectors(
        viewpoint,
        item,
        start=start.ravel(),
        width=width.ravel(),
        columns=columns.ravel(),
        step=2 * grid.ravel(),
    )


def _columns(ground: Footprints, viewpoints: np.ndarray, windows: Sectors) -> _Columns:
    """Columns of rays that cover each sector's object from bottom to top.

    An object counts as an upright prism on its footprint's rectangle. viewpoints: x, y, ... (m) of
    each place that is looked from."""
    window = np.repeat(np.arange(len(windows.columns)), windows.columns)
    azimuth = windows.start[window] + (counting(windows.columns) + 0.5) * windows.width[window]
    # distances at which each column's ray enters and leaves its rectangle, seen from above
    x, y, half_length, half_width, cos, sin = ground.rectangles[windows.item].T
    away = viewpoints[windows.viewpoint, :2] - np.stack([x, y], axis=1)
    along = away[:, 0] * cos + away[:, 1] * sin
    aside = away[:, 1] * cos - away[:, 0] * sin
    ahead = np.cos(azimuth)
    left = np.sin(azimuth)
    cos = cos[window]
    sin = sin[window]
    near_distance = np.zeros(len(window))
    far_distance = np.full(len(window), np.inf)
    # for each axis of the rectangle: place of the viewpoint and direction of the ray along it, and
    # half the rectangle's side
    axes = (
        (along, ahead * cos + left * sin, half_length),
        (aside, left * cos - ahead * sin, half_width),
    )
    for start, direction, half_side in axes:
        direction = np.where(np.abs(direction) < 1e-9, 1e-9, direction)
        # distances along the ray between the rectangle's two sides: middle - reach to middle +
        # reach
        middle = -start[window] / direction
        reach = half_side[window] / np.abs(direction)
        near_distance = np.maximum(near_distance, middle - reach)
        far_distance = np.minimum(far_distance, middle + reach)
    near_distance = np.maximum(near_distance - EDGE, 0)
    far_distance = np.maximum(far_distance, near_distance) + EDGE
    eye = viewpoints[windows.viewpoint, 2]
    below, above = ((height[windows.item] - eye)[window] for height in (ground.low, ground.high))
    # a bottom below the eye is seen lowest at its near end, one above the eye at its far end
    low = np.arctan2(below, np.where(below < 0, near_distance, far_distance))
    high = np.arctan2(above, np.where(above < 0, far_distance, near_distance))
    rows = np.clip(np.ceil((high - low) / windows.step[window]), *ROWS).astype(np.int64)
    # Bisection narrows an edge down to this share of a step. Columns begin half a share lower, so
    # that the object's very bottom and top are in the middle of such a last interval.
    edge_share = 0.5**HALVINGS
    step = (high - low) / (rows + 1 - edge_share)
    return _Columns(window, azimuth, low - step * edge_share / 2, step, rows)


def _strips(shows: Shows, windows: Sectors, columns: _Columns) -> Strips:
    """Strips of some columns of rays.

    Their rays are cast, the edges between rays that show different things are found by bisection,
    and each edge is paired with the next above. shows: gives the kind of view of rays on the object
    of their sector; windows: sectors of the columns."""
    window = columns.window
    azimuth = columns.azimuth.astype(np.float32)
    rows = columns.rows
    # `seen` has an entry for each ray and, at `first`, one below each column, which stays 0:
    # nothing is seen below and above a column
    first = np.cumsum(rows + 1) - (rows + 1)
    seen = np.zeros(int((rows + 1).sum()) + 1, np.uint8)
    ray_column = np.repeat(np.arange(len(window)), rows)  # column of each ray
    height = counting(rows) + 1  # number of each ray in its column, from 1 for the lowest
    elevation = (columns.low.take(ray_column) + height * columns.step.take(ray_column)).astype(
        np.float32
    )
    seen[first.take(ray_column) + height] = shows(
        window.take(ray_column), azimuth.take(ray_column), elevation
    )
    edge = np.flatnonzero(seen[1:] != seen[:-1])  # entry below each edge; the next one is above it
    below = seen[edge]
    above = seen[edge + 1]
    edge_column = np.searchsorted(first, edge, side="right") - 1  # column of each edge
    # the edge is between `low` and `low` + `step`, which the loop halves
    step = columns.step[edge_column].astype(np.float32)
    low = (
        columns.low[edge_column] + (edge - first[edge_column]) * columns.step[edge_column]
    ).astype(np.float32)
    for _ in range(HALVINGS):
        step *= np.float32(0.5)
        middle = low + step
        low = np.where(
            shows(window[edge_column], azimuth[edge_column], middle) == below, middle, low
        )
    edge_elevation = low + step / 2
    starts = np.flatnonzero(above)  # edges at which something begins; the next edge ends it
    strip_column = edge_column[starts]
    strip_window, half = window[strip_column], windows.width[window[strip_column]] / 2
    left, right = (columns.azimuth[strip_column] + side for side in (-half, half))
    pair = (
        windows.viewpoint[strip_window].astype(np.int32),
        windows.item[strip_window].astype(np.int32),
    )
    bounds = (
        left.astype(np.float32),
        right.astype(np.float32),
        edge_elevation[starts],
        edge_elevation[starts + 1],
    )
    return Strips(*pair, *bounds, above[starts].astype(np.int32))


def counting(lengths: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " m"]:
    """Count 0, 1, 2 ... below each length, one length after the other: [2, 3] gives 0 1 0 1 2."""
    return np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)


class _Last(NamedTuple):
    """Frame before: its objects, what may hide them, and its strips."""

    objects: list[tuple[Body, bytes, bool]]  # body, bytes of its box, True if looked at finely
    hiders: Bool[np.ndarray, "viewpoints n n"]  # as from `may_hide`
    strips: Strips


class SuccessiveStrips:
    """Strips of successive frames from the same viewpoints.

    Strips of the frame before are used again if nothing about them changed. That saves time and
    changes no result."""

    def __init__(self, renderer: Renderer, viewpoints: Eyes, counted: Counted) -> None:
        """Begin before the first frame, without strips.

        renderer: gives the static scene, which hides objects; viewpoints: places to look from;
        counted: the points that count."""
        self._renderer = renderer
        self._viewpoints = viewpoints
        self._counted = counted
        self._last = self._none = _Last(
            [], np.zeros((len(viewpoints), 0, 0), np.bool_), concatenate_strips([])
        )

    def find_next(self, moment: Moment, fine: Mask) -> Strips:
        """Strips of the next frame, by viewpoint, then object.

        moment: objects of the frame; fine: mask of the objects to cut into columns of
        `STRIP_WIDTH`; others get `COARSE` ones."""
        boxes = [box.tobytes() for box in moment.boxes]
        objects = list(zip(moment.bodies, boxes, fine.tolist(), strict=True))
        sectors = find_sectors(moment.ground, self._viewpoints, fine)
        hiders = may_hide(moment.ground, self._viewpoints, sectors)
        is_kept = np.zeros(hiders.shape[:2], np.bool_)
        last = self._last
        rows = {key: row for row, key in enumerate(last.objects)}
        # row of each object in the frame before, -1 for a new one; then only the rows of `standing`
        before = np.array([rows.get(key, -1) for key in objects], np.int64)
        standing = np.flatnonzero(before >= 0)
        is_new = before < 0
        before = before[standing]
        # row in this frame of each object of the frame before, -1 if it is gone
        now = np.full(len(rows), -1, np.int32)
        now[before] = standing
        # (viewpoint, standing object): a new object may hide it, a gone one may have hidden it
        newly = hiders[:, standing][:, :, is_new].any(axis=2)
        formerly = last.hiders[:, before][:, :, now < 0].any(axis=2)
        is_kept[:, standing] = ~(newly | formerly) & ~find_touching(moment.ground)[standing]
        kept_strips = last.strips._replace(item=now.take(last.strips.item))
        kept_strips = kept_strips.take(np.flatnonzero(kept_strips.item >= 0))
        kept_strips = kept_strips.take(
            np.flatnonzero(is_kept[kept_strips.viewpoint, kept_strips.item])
        )
        new_sectors = sectors.take(np.flatnonzero(~is_kept))
        strips = cast_strips(
            renderer=self._renderer,
            moment=moment,
            viewpoints=self._viewpoints,
            counted=self._counted,
            windows=new_sectors,
        )
        if len(kept_strips.item):
            strips = concatenate_strips([kept_strips, strips])
            pair = strips.viewpoint.astype(np.int64) * len(objects) + strips.item
            strips = strips.take(np.argsort(pair, kind="stable"))
        # equal bodies in equal boxes cannot be told apart, so the next frame starts afresh
        has_twins = len(set(objects)) < len(objects)
        self._last = self._none if has_twins else _Last(objects, hiders, strips)
        return strips


def may_hide(
    ground: Footprints, viewpoints: Eyes, sectors: Sectors
) -> Bool[np.ndarray, "viewpoints n n"]:
    """Mask (viewpoint, object, other): True if the other may hide the object from there.

    It is generous: footprints count as circles. sectors: all pairs of viewpoint and object, in
    the order of `find_sectors`."""
    viewpoint_count = len(viewpoints)
    objects = np.arange(len(ground.low))
    mask = np.zeros((viewpoint_count, len(objects), len(objects)), np.bool_)
    # azimuths (viewpoint, object): half the width and the middle of each object
    half_width = (sectors.width * sectors.columns / 2).reshape(viewpoint_count, len(objects))
    middle = sectors.start.reshape(half_width.shape) + half_width
    x_y = ground.rectangles[:, :2]
    radius = np.hypot(
        ground.rectangles[:, 2], ground.rectangles[:, 3]
    )  # from half length and half width
    step = max(1, PAIRS_AT_ONCE // max(1, len(objects) ** 2))
    for start in range(0, viewpoint_count, step):
        block = slice(start, start + step)
        dx, dy = (x_y - viewpoints[block, None, :2]).transpose(2, 0, 1)
        distance = np.hypot(dx, dy)
        near_distance = np.maximum(distance - radius, 0)
        far_distance = distance + radius
        below = ground.low - viewpoints[block, 2:]
        above = ground.high - viewpoints[block, 2:]
        low = np.arctan2(below, np.where(below < 0, near_distance, far_distance))
        high = np.arctan2(above, np.where(above < 0, far_distance, near_distance))
        # [:, :, None] is of the object, [:, None] of the other
        turn = middle[block, :, None] - middle[block, None]
        azimuth_gap = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)  # 0 to pi
        reach = half_width[block, :, None] + half_width[block, None]
        mask[block] = azimuth_gap <= reach + OVERLAP_SLACK
        mask[block] &= near_distance[:, None] <= far_distance[:, :, None] + OVERLAP_SLACK
        mask[block] &= low[:, None] <= high[:, :, None] + OVERLAP_SLACK
        mask[block] &= high[:, None] >= low[:, :, None] - OVERLAP_SLACK
    mask[:, objects, objects] = False  # no object hides itself
    return mask


def find_touching(ground: Footprints) -> Mask:
    """Mask of objects whose footprint's rectangle meets the rectangle of another."""
    middle = ground.rectangles[:, :2]
    half_sizes = ground.rectangles[:, 2:4]
    cos = ground.rectangles[:, 4]
    sin = ground.rectangles[:, 5]
    # unit vectors along the sides of each rectangle, (object, axis, x y)
    axes = np.stack([np.column_stack([cos, sin]), np.column_stack([-sin, cos])], axis=1)
    # from object i to object j, (i, j, x y)
    offset = middle[None] - middle[:, None]
    # Separating axes: two rectangles are apart if they are apart along a side of either one.
    # `cosines` of the angles between axis a of object i and axis b of object j: (i, a, j, b)
    cosines = np.abs(np.einsum("iac,jbc->iajb", axes, axes))
    # (i, a, j): sum of the half extents of i and j along axis a of i, and distance of their middles
    # along that axis
    reach = half_sizes[:, :, None] + np.einsum("iajb,jb->iaj", cosines, half_sizes)
    distance = np.abs(np.einsum("ijc,iac->iaj", offset, axes))
    is_apart = (distance > reach + OVERLAP_SLACK).any(axis=1)
    meets = ~(is_apart | is_apart.T)
    np.fill_diagonal(meets, False)
    return np.asarray(meets.any(axis=1))
