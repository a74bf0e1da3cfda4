"""`Surround`: moving objects seen from one place, as strips in order of azimuth."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from placement_env.fidelity.occlusion import Chances
from placement_env.fidelity.ray_table import Lookup, RayTable
from placement_env.fidelity.rectangles import AZIMUTHS, Rectangles
from placement_env.fidelity.still import SentBackground, Still
from placement_env.fidelity.traffic import Traffic, build_renderer, scored
from toolkit.arrays import Float64, Int32, Int64
from toolkit.points import Crop, has_centre_inside
from toolkit.rendering.renderer import Moment
from toolkit.rendering.strips import (
    BEYOND,
    WITHIN,
    Counted,
    Strips,
    SuccessiveStrips,
    concatenate_strips,
)
from toolkit.sensors.sensor import SensorModel
from toolkit.traffic.snapshots import Snapshot

TILT_MARGIN_COLUMNS = 16  # places of azimuth by which slightly more tilt may move a strip
MAX_MOMENTS = 64  # frames whose scenes are kept


class SensorPoints(NamedTuple):
    """Points of one sensor on some objects, and in some frames.

    Attributes:
        points: Points on each scored object.
        sent: Points sent in each frame.
        far: The ones beyond the site's hybrid radius among these."""

    points: Float64[np.ndarray, " items"]
    sent: Float64[np.ndarray, " frames"]
    far: Float64[np.ndarray, " frames"]


class ScoredItems(NamedTuple):
    """Scored objects among all n objects of some frames, frame after frame.

    Attributes:
        place: Index of each object among the scored ones, or `items` if it is not scored.
        frame: Frame of each object, counted from the first one here.
        items: Number of scored objects.
        frames: Number of frames."""

    place: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    items: int
    frames: int

    @staticmethod
    def from_snapshots(
        traffic: Traffic, snapshots: Sequence[Snapshot], labels: Sequence[int]
    ) -> "ScoredItems":
        """Scored objects of some classes.

        Args:
            traffic: Traffic on the site in whose area scored objects are centred.
            snapshots: Frames that are searched.
            labels: Classes (numbers) of the scored objects."""
        masks = [scored(snapshot.objects, traffic.site, labels) for snapshot in snapshots]
        # objects frame after frame; an empty mask comes first, as there may be no frame
        is_scored = np.concatenate([np.zeros(0, np.bool_), *masks])
        items = is_scored.sum()
        return ScoredItems(
            place=np.where(is_scored, np.cumsum(is_scored) - 1, items),
            frame=np.repeat(np.arange(len(masks)), list(map(len, masks))),
            items=int(items),
            frames=len(masks),
        )


@dataclass(frozen=True, eq=False)
class Surround:
    """Moving objects of all frames seen from one place, as n upright strips by azimuth.

    Points of any sensor at this place are counted from it, without another cast of rays.

    Attributes:
        scored: Scored objects of the frames.
        rectangles: Azimuth and elevation of each strip, left edges ascending within one turn.
        item: Index of each strip's object among the scored ones; `scored.items` if the object is
            not scored or the strip is outside the crop.
        frame: Frame of each strip.
        widest: Width of the widest strip, in places of azimuth.
        gains: By sensor model, points sent and far points that a ray in each strip adds to the
            static scene's behind it, -1 to 1 each.
        stills: Static scene seen from this place, by sensor model."""

    scored: ScoredItems
    rectangles: Rectangles
    item: Int32[np.ndarray, " n"]
    frame: Int32[np.ndarray, " n"]
    widest: float
    gains: dict[SensorModel, Chances]
    stills: "dict[SensorModel, Still]"

    def __deepcopy__(self, memo: dict[int, Any]) -> "Surround":
        return self  # never changed, and up to 10 MB

    @staticmethod
    def from_strips(
        strips: Strips, scored: ScoredItems, stills: "dict[SensorModel, Still]"
    ) -> "Surround":
        """Sort the strips seen from one place, and compare them with the static scene behind.

        Args:
            strips: Strips of all frames; `item` counts the objects frame after frame.
            scored: Scored objects among these.
            stills: Static scene seen from the same place, by sensor model."""
        rectangles = Rectangles.from_edges(strips.left, strips.right, strips.bottom, strips.top)
        # whole turns are taken off, so that all left edges are within the first turn
        full_turns = np.floor(rectangles.left / AZIMUTHS) * AZIMUTHS
        rectangles = rectangles._replace(
            left=rectangles.left - full_turns, right=rectangles.right - full_turns
        )
        order = np.argsort(rectangles.left, kind="stable")
        rectangles = Rectangles(*(column[order] for column in rectangles))
        strips = Strips(*(column[order] for column in strips))
        # strips of parts that show points in the crop, within the hybrid radius or beyond it
        is_in_crop = strips.shows >= WITHIN
        is_far = strips.shows == BEYOND
        gains = {}
        for model, still in stills.items():
            background = still.behind(
                azimuth=(strips.left + strips.right) / 2, elevation=(strips.bottom + strips.top) / 2
            )
            gains[model] = Chances(sent=is_in_crop - background.sent, far=is_far - background.far)
        item = np.where(is_in_crop, scored.place[strips.item], scored.items)
        frame = scored.frame[strips.item]
        return Surround(
            scored=scored,
            rectangles=rectangles,
            item=item.astype(np.int32),
            frame=frame.astype(np.int32),
            widest=float((rectangles.right - rectangles.left).max(initial=0)),
            gains=gains,
            stills=stills,
        )

    @cached_property
    def nbytes(self) -> int:
        """Bytes of memory of the arrays, by which `Bounded` limits how many are kept."""
        arrays = [*self.rectangles, self.item, self.frame]
        for gains in self.gains.values():
            arrays += [gains.sent, gains.far]
        for still in self.stills.values():
            arrays += [still.sent, still.far]
        return sum(array.nbytes for array in arrays)

    def seen(self, lookup: Lookup, background: SentBackground | None = None) -> SensorPoints:
        """Points of a sensor at this place on each scored object, and points sent in each frame.

        The rays of the sensor that fall on each strip (upright part of an object, seen from here)
        are counted. Points sent are the static scene's and what the objects add to these.

        Args:
            lookup: Aim of the sensor; its model must be in `stills`.
            background: Points of the static scene that the sensor sends without objects, None to
                count them here."""
        table = lookup.table  # numbers of rays by direction, for heading 0
        items = self.scored.items + 1  # the last one gathers strips that are not scored
        frames = self.scored.frames
        gains = self.gains[lookup.model]
        if background is None:
            background = self.stills[lookup.model].count_background(lookup)
        points = np.zeros(items)
        sent = np.full(frames, background.sent)
        far = np.full(frames, background.far)
        for rows in self._list_slices_ahead(table, float(lookup.heading)):
            rectangles_ahead = Rectangles(*(column[rows] for column in self.rectangles))
            # strips (within `rows`) that rays fall on, and the number of rays on each
            hit_strips, rays = table.counts(rectangles_ahead, lookup.heading, lookup.extra_tilt)
            points += np.bincount(self.item[rows].take(hit_strips), rays, items)
            frame = self.frame[rows].take(hit_strips)
            sent += np.bincount(frame, rays * gains.sent[rows].take(hit_strips), frames)
            far += np.bincount(frame, rays * gains.far[rows].take(hit_strips), frames)
        return SensorPoints(points=points[:-1], sent=np.maximum(sent, 0), far=np.maximum(far, 0))

    def _list_slices_ahead(self, table: RayTable, heading: float) -> list[slice]:
        """Ranges of strips that the rays of a sensor may fall on: two across the seam of azimuth.

        Strips are ordered by their left edges, in places of azimuth (`AZIMUTHS` to a turn).

        Args:
            table: Rays of the sensor at heading 0.
            heading: Heading of the sensor, in places of azimuth."""
        # a strip that begins before the rays may reach into them, by the width of the widest
        before = self.widest + TILT_MARGIN_COLUMNS
        length = table.columns + before + TILT_MARGIN_COLUMNS
        if length >= AZIMUTHS:
            return [slice(0, len(self.item))]
        first = (table.first_column + heading - before) % AZIMUTHS
        # begin and end, in places of azimuth: the second is left over beyond a whole turn
        intervals = [(first, first + length), (0.0, first + length - AZIMUTHS)]
        return [
            slice(*np.searchsorted(self.rectangles.left, (begin, end)).tolist())
            for begin, end in intervals
            if end > begin
        ]


def successive_strips(
    traffic: Traffic, places: Float64[np.ndarray, "places 3"]
) -> SuccessiveStrips:
    """Finder of the strips seen from places (x, y, z; m, world frame), frame after frame.

    Each strip shows an object outside the crop, in it, or in it and beyond the hybrid radius."""
    limits = Counted(crop=Crop.from_place(traffic.site), radius=traffic.site.hybrid_radius)
    return SuccessiveStrips(build_renderer(traffic), places, limits)


def place_strips(
    successive: SuccessiveStrips,
    traffic: Traffic,
    frames: Iterable[int],
    places: int,
    *,
    looks_again: bool = True,
) -> list[Strips]:
    """Strips seen from each place in some frames.

    Args:
        successive: Finder of strips from these places.
        traffic: Traffic with the frames.
        frames: Indices of frames, ascending; the next is taken when the one before is done.
        places: Number of places.
        looks_again: True if these frames are likely to be seen from other places soon; their scenes
            are kept.

    Returns:
        Strips of each place; `item` counts all their objects, frame after frame."""
    renderer = build_renderer(traffic)
    parts = []
    first_item = 0  # number of the frame's first object among the objects of all frames
    for k in frames:
        # objects centred in the area are cut into narrow strips
        snapshot = traffic.snapshots[k]
        is_fine = has_centre_inside(snapshot.objects.boxes, traffic.site.area)
        moment = build_moment(traffic, k) if looks_again else renderer.moment(snapshot)
        strips = successive.find_next(moment, is_fine)
        parts.append(strips._replace(item=strips.item + np.int32(first_item)))
        first_item += len(is_fine)
    all_strips = concatenate_strips(parts)
    order = np.argsort(all_strips.viewpoint, kind="stable")
    bounds = np.searchsorted(all_strips.viewpoint[order], np.arange(places + 1))
    return [all_strips.take(order[begin:end]) for begin, end in pairwise(bounds)]


@lru_cache(maxsize=MAX_MOMENTS)
def build_moment(traffic: Traffic, k: int) -> Moment:
    """Scene of the moving objects in frame k; the last `MAX_MOMENTS` are kept."""
    return build_renderer(traffic).moment(traffic.snapshots[k])
