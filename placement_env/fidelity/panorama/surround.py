"""`Surround`: the view from one place in all frames.

It is packed for disk and laid out for use by one sensor after another. Strips are kept in order of azimuth, so a sensor
looks only at those ahead of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.panorama.ray_table import (
    AZIMUTHS,
    PER_STEEP,
    PER_TURN,
    PI,
    RayTable,
    Rectangles,
)
from placement_env.fidelity.panorama.still import Still
from toolkit.arrays import Float32, Float64, Int64, Shaped
from toolkit.rendering.strips import BEYOND, WITHIN, Strips
from toolkit.sensors.sensor import SensorModel

FINENESS = 16  # parts of a place of azimuth or elevation, for the sides
ASIDE = 16  # places of azimuth by which slightly more tilt may move a strip


class Packed(NamedTuple):
    """Strips of one place, by left side.

    left, width, low and high are in parts of a place (`FINENESS`); item: the object of each, numbered through all
    frames; shows: what it shows.
    """

    left: Shaped[np.ndarray, " n"]
    width: Shaped[np.ndarray, " n"]
    low: Shaped[np.ndarray, " n"]
    high: Shaped[np.ndarray, " n"]
    item: Shaped[np.ndarray, " n"]
    shows: Shaped[np.ndarray, " n"]

    @staticmethod
    def of(strips: Strips) -> Packed:
        """Strips of one viewpoint."""
        left, right = (
            np.rint((each + PI) * PER_TURN * FINENESS).astype(np.int64) for each in (strips.left, strips.right)
        )
        low, high = (np.rint((each + PI / 2) * PER_STEEP * FINENESS) for each in (strips.bottom, strips.top))
        begin = left % (AZIMUTHS * FINENESS)
        order = np.argsort(begin, kind="stable")
        angles = (begin, right - left, np.maximum(low, 0), high)
        begin, width, low, high = (each[order].astype(np.uint16) for each in angles)
        return Packed(
            begin, width, low, high, strips.item[order].astype(np.uint32), strips.shows[order].astype(np.uint8)
        )


class ScoredItems(NamedTuple):
    """Scored objects among all.

    place: of each object, numbered through all frames, its index among the scored ones, or their number if not scored;
    frame: of each object; items, frames: numbers of scored objects and frames.
    """

    place: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    items: int
    frames: int


@dataclass(frozen=True, eq=False)
class Surround:
    """Strips of one place, ready for lookup.

    item: of each strip among the scored ones, or the number of these; frame: of each; widest: of all strips (places);
    counts, far: whether its points count, and are far.
    """

    rectangles: Rectangles
    item: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    widest: float
    gains: dict[SensorModel, tuple[np.ndarray, np.ndarray]]
    stills: dict[SensorModel, Still]

    @staticmethod
    def of(packed: Packed, scored: ScoredItems, stills: dict[SensorModel, Still]) -> Surround:
        """Surround of packed strips. stills: standing scene seen from this place alone, by sensor model."""
        left, width, low, high = (each.astype(np.float32) / np.float32(FINENESS) for each in packed[:4])
        bottom, top = (each / PER_STEEP - PI / 2 for each in (low, high))
        azimuth = left / PER_TURN - PI
        rectangles = Rectangles.of(azimuth, (left + width) / PER_TURN - PI, bottom, top)
        item = packed.item.astype(np.int64)
        counts, far = packed.shows >= WITHIN, packed.shows == BEYOND
        middle = azimuth + width / (2 * PER_TURN), (bottom + top) / 2
        gains = {}
        for model, still in stills.items():
            sent, far_off = still.behind(np.zeros(len(item), np.int32), *middle)
            gains[model] = (counts - sent, far - far_off)
        place = np.where(counts, scored.place[item], scored.items)
        widest = float(width.max(initial=0))
        return Surround(rectangles, place, scored.frame[item], widest, gains, stills)

    def seen(
        self, model: SensorModel, table: RayTable, heading: float, more: float, scored: ScoredItems
    ) -> tuple[Float64[np.ndarray, " items"], Float64[np.ndarray, " frames"], Float64[np.ndarray, " frames"]]:
        """Points on each scored object, and points sent.

        Points sent are per frame; the far ones among them come too. heading, more: as of `RayTable.counts`.
        """
        points = np.zeros(scored.items + 1)
        alone = self.stills[model].of_cells(0, table.cells, heading / float(PER_TURN))
        sent, far = (np.full(scored.frames, each) for each in alone)
        more_sent, more_far = self.gains[model]
        for part in self._ahead(table, heading):
            rectangles = self.rectangles.part(part)
            held, rays = table.counts(rectangles, np.float32(heading), np.float32(more))
            points += np.bincount(self.item[part].take(held), rays, scored.items + 1)
            frame = self.frame[part].take(held)
            sent += np.bincount(frame, rays * more_sent[part].take(held), scored.frames)
            far += np.bincount(frame, rays * more_far[part].take(held), scored.frames)
        return points[:-1], np.maximum(sent, 0), np.maximum(far, 0)

    def _ahead(self, table: RayTable, heading: float) -> list[slice]:
        """Strips that rays of a table may fall on."""
        count, before = len(self.item), self.widest + ASIDE
        length = table.columns + before + ASIDE
        if length >= AZIMUTHS:
            return [slice(0, count)]
        first = (table.first_column + heading - before) % AZIMUTHS
        ends = [(first, min(first + length, AZIMUTHS)), (0.0, first + length - AZIMUTHS)]
        left: Float32[np.ndarray, " n"] = self.rectangles.left
        return [slice(*np.searchsorted(left, end).tolist()) for end in ends if end[1] > end[0]]
