"""`Surround`: the view from one place in some frames, its strips in order of azimuth, for one sensor after another."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.occlusion import worth
from placement_env.fidelity.panorama import ray_table
from placement_env.fidelity.traffic import Traffic, build_renderer, scored
from toolkit.arrays import Float32, Float64, Int32, Int64, UInt8
from toolkit.points import Crop, has_centre_inside
from toolkit.rendering.renderer import Moment, Renderer
from toolkit.rendering.strips import BEYOND, WITHIN, Counted, Strips, SuccessiveStrips, concatenate_strips
from toolkit.sensors.sensor import NEAR, SensorModel
from toolkit.sites.site import Site
from toolkit.traffic.snapshots import Snapshot

ASIDE = 16  # places of azimuth by which slightly more tilt may move a strip
MOST_MOMENTS = 64  # frames whose scenes are kept
CHANCE_STEPS = np.float32(250.0)  # steps of chances, so that one half is exact


class ScoredItems(NamedTuple):
    """Scored objects among all of some frames.

    place: of each object its index among the scored ones, or their number if not scored; frame: of each object; items,
    frames: numbers of scored objects and frames.
    """

    place: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    items: int
    frames: int

    @staticmethod
    def of(traffic: Traffic, snapshots: Sequence[Snapshot], labels: Sequence[int]) -> ScoredItems:
        """Scored objects of some classes (numbers) in some frames."""
        masks = [scored(each.objects, traffic.site, labels) for each in snapshots]
        counts = np.concatenate([np.zeros(0, np.bool_), *masks])
        frame = np.repeat(np.arange(len(masks)), list(map(len, masks)))
        return ScoredItems(np.where(counts, np.cumsum(counts) - 1, counts.sum()), frame, int(counts.sum()), len(masks))


@dataclass(frozen=True, eq=False)
class Surround:
    """Strips of one place, ready for lookup.

    item: of each strip among the scored ones, or the number of these; frame: of each; widest: of all strips (places);
    gains: by model, of a ray in each strip over the background: points sent, and far ones; stills: background by model.
    """

    scored: ScoredItems
    rectangles: ray_table.Rectangles
    item: Int32[np.ndarray, " n"]
    frame: Int32[np.ndarray, " n"]
    widest: float
    gains: dict[SensorModel, tuple[np.ndarray, np.ndarray]]
    stills: dict[SensorModel, Still]

    @staticmethod
    def of(strips: Strips, scored: ScoredItems, stills: dict[SensorModel, Still]) -> Surround:
        """Surround of the strips of one place. stills: standing scene seen from there, by sensor model."""
        rectangles = ray_table.Rectangles.of(strips.left, strips.right, strips.bottom, strips.top)
        turns = np.floor(rectangles.left / ray_table.AZIMUTHS) * ray_table.AZIMUTHS
        rectangles = rectangles._replace(left=rectangles.left - turns, right=rectangles.right - turns)
        order = np.argsort(rectangles.left, kind="stable")
        rectangles = ray_table.Rectangles(*(each[order] for each in rectangles))
        strips = Strips(*(each[order] for each in strips))
        counts, far = strips.shows >= WITHIN, strips.shows == BEYOND
        gains = {}
        for model, still in stills.items():
            behind = still.behind((strips.left + strips.right) / 2, (strips.bottom + strips.top) / 2)
            gains[model] = (counts - behind[0], far - behind[1])
        most = float((rectangles.right - rectangles.left).max(initial=0))
        item, frame = np.where(counts, scored.place[strips.item], scored.items), scored.frame[strips.item]
        return Surround(scored, rectangles, item.astype(np.int32), frame.astype(np.int32), most, gains, stills)

    @cached_property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        pairs = [*self.gains.values(), *((still.sent, still.far) for still in self.stills.values())]
        return sum(each.nbytes for each in (*self.rectangles, self.item, self.frame, *sum(pairs, ())))

    def seen(
        self, lookup: ray_table.Lookup
    ) -> tuple[Float64[np.ndarray, " items"], Float64[np.ndarray, " frames"], Float64[np.ndarray, " frames"]]:
        """Points of a sensor on each scored object, points sent in each frame, and the far ones among them."""
        table, items, frames = lookup.table, self.scored.items + 1, self.scored.frames
        points, more_sent, more_far = np.zeros(items), *self.gains[lookup.model]
        sent, far = (np.full(frames, each) for each in self.stills[lookup.model].alone(lookup))
        for part in self._ahead(table, float(lookup.heading)):
            some = ray_table.Rectangles(*(each[part] for each in self.rectangles))
            held, rays = table.counts(some, lookup.heading, lookup.more)
            points += np.bincount(self.item[part].take(held), rays, items)
            frame = self.frame[part].take(held)
            sent += np.bincount(frame, rays * more_sent[part].take(held), frames)
            far += np.bincount(frame, rays * more_far[part].take(held), frames)
        return points[:-1], np.maximum(sent, 0), np.maximum(far, 0)

    def _ahead(self, table: ray_table.RayTable, heading: float) -> list[slice]:
        """Strips that rays of a table may fall on."""
        before = self.widest + ASIDE
        length = table.columns + before + ASIDE
        if length >= ray_table.AZIMUTHS:
            return [slice(0, len(self.item))]
        first = (table.first_column + heading - before) % ray_table.AZIMUTHS
        ends = [(first, first + length), (0.0, first + length - ray_table.AZIMUTHS)]
        return [slice(*np.searchsorted(self.rectangles.left, end).tolist()) for end in ends if end[1] > end[0]]


def successive_strips(traffic: Traffic, places: Float64[np.ndarray, "V 3"]) -> SuccessiveStrips:
    """Finder of strips seen from places."""
    return SuccessiveStrips(build_renderer(traffic), places, Counted(Crop.of(traffic.site), traffic.site.hybrid_radius))


def find_place_strips(
    successive: SuccessiveStrips, traffic: Traffic, frames: Iterable[int], places: int
) -> list[Strips]:
    """Strips of each place in some frames."""
    parts, first = [], 0
    for k in frames:
        fine = has_centre_inside(traffic.snapshots[k].objects.boxes, traffic.site.area)
        strips = successive.of(build_moment(traffic, k), fine)
        parts.append(strips._replace(item=strips.item + np.int32(first)))
        first += len(fine)
    whole = concatenate_strips(parts)
    order = np.argsort(whole.viewpoint, kind="stable")
    ends = np.searchsorted(whole.viewpoint[order], np.arange(places + 1))
    return [Strips(*(each[order[begin:end]] for each in whole)) for begin, end in pairwise(ends)]


@lru_cache(maxsize=MOST_MOMENTS)
def build_moment(traffic: Traffic, k: int) -> Moment:
    """Scene of what moves in a frame, made once for the latest ones."""
    return build_renderer(traffic).moment(traffic.snapshots[k])


@dataclass(frozen=True, eq=False)
class Still:
    """Chances of a point to be sent, and to be sent and far, in 250ths, for each cell (of `ray_table`)."""

    sent: UInt8[np.ndarray, " cells"]
    far: UInt8[np.ndarray, " cells"]

    @staticmethod
    def of(renderer: Renderer, site: Site, viewpoint: Float64[np.ndarray, "3"], model: SensorModel) -> Still:
        """Chances seen from a viewpoint, with a model's noise. The noise is the same everywhere in its image."""
        rays, mean = _directions(), _mean_length(model)
        images, place = np.zeros((2, len(rays)), np.uint8), viewpoint.astype(np.float32)
        lines = np.concatenate([place + np.float32(NEAR) * rays, rays], axis=1)
        length = renderer.cast_still(lines) + np.float32(NEAR)
        some = np.flatnonzero(length < model.max_range)
        length, toward = length[some], rays[some]
        spread = (mean * np.abs(toward[:, 2]) * model.deviation(length / mean)).astype(np.float32)
        points = toward * length[:, None] + place
        chances = worth(points, spread, np.broadcast_to(place[:2], (len(some), 2)), site)
        images[:, some] = np.rint(CHANCE_STEPS * np.array(chances))
        return Still(*images)

    def alone(self, lookup: ray_table.Lookup) -> tuple[float, float]:
        """Points that a sensor sends in a still scene, and the far ones."""
        table = lookup.table
        columns = round(float(lookup.heading) * ray_table.CELL_COLUMNS / ray_table.AZIMUTHS) % ray_table.CELL_COLUMNS
        cell = table.cells + columns * ray_table.CELL_ROWS
        each = (float(table.cell_rays @ image.take(cell, mode="wrap")) for image in (self.sent, self.far))
        sent, far = (rays / float(CHANCE_STEPS) for rays in each)
        return sent, far

    def behind(
        self, azimuth: Float32[np.ndarray, " n"], elevation: Float32[np.ndarray, " n"]
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Chances of the scene in some directions (rad)."""
        column, row = ray_table.find_cells(azimuth, elevation)
        cell = column * ray_table.CELL_ROWS + row
        return self.sent.take(cell) / CHANCE_STEPS, self.far.take(cell) / CHANCE_STEPS


@lru_cache(maxsize=8)
def _mean_length(model: SensorModel) -> np.floating:
    """Metres along a ray per unit of measurement, on average."""
    return np.linalg.norm(model.rays(), axis=-1).mean()


@lru_cache(maxsize=1)
def _directions() -> Float32[np.ndarray, "cells 3"]:
    """Directions through the middle of each cell."""
    azimuth = (np.arange(ray_table.CELL_COLUMNS) + 0.5)[:, None] * (2 * np.pi / ray_table.CELL_COLUMNS) - np.pi
    elevation = ray_table.cell_elevations()
    flat = np.cos(elevation)
    axes = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth)
    return np.stack(axes, axis=-1).reshape(-1, 3).astype(np.float32)
