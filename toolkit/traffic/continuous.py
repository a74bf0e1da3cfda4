"""Continuous traffic: frames of ways that lead through a site, none of which overlap.

Frames may be any number of steps of 0.1 s apart. A road user that would overlap one who set out
before, a parked vehicle or a solid is refused as a whole, so that nobody is moved aside, appears or
vanishes inside the view."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely

from toolkit.arrays import Bool, Int64
from toolkit.boxes import footprints
from toolkit.objects import Objects
from toolkit.sites.site import Site
from toolkit.traffic.flow import Flow
from toolkit.traffic.obstacles import LevelBoxes, Obstacles, overlaps, place_boxes
from toolkit.traffic.parked import Parked
from toolkit.traffic.road_lanes import outline_view
from toolkit.traffic.sumo import FINE_STEP_S
from toolkit.traffic.supply import Supply
from toolkit.traffic.ways import Traveller, simulate_ways


@dataclass(frozen=True, eq=False)
class ContinuousTraffic:
    """All frames of continuous traffic, n poses of moving road users in all.

    Attributes:
        site: Site.
        interval: Time between frames (s).
        travellers: Moving road users that are seen, without those that were refused.
        refused: Number of ways refused because bodies would have overlapped.
        parked_boxes: Boxes of parked vehicles, on level ground; they stay all the time.
        parked_ids: Ids of parked vehicles.
        parked_bodies: Their bodies, as rows of the bodies that traffic was given.
        begin: First row of each frame, and n at the end.
        traveller: Index in `travellers` of each row.
        boxes: Box of each row, on level ground.
        labels: Class of each body that traffic was given."""

    site: Site
    interval: float
    travellers: tuple[Traveller, ...]
    refused: int
    parked_boxes: LevelBoxes
    parked_ids: Int64[np.ndarray, " p"]
    parked_bodies: Int64[np.ndarray, " p"]
    begin: Int64[np.ndarray, " frames+1"]
    traveller: Int64[np.ndarray, " n"]
    boxes: LevelBoxes
    labels: Int64[np.ndarray, " bodies"]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.begin) - 1

    def objects(self, k: int) -> tuple[Objects, Int64[np.ndarray, " m"]]:
        """Objects of frame k, on the ground of the site, and the body of each."""
        rows = slice(*self.begin[k : k + 2].tolist())
        moving = [self.travellers[index] for index in self.traveller[rows].tolist()]
        moving_ids = np.array([traveller.id for traveller in moving], np.int64)
        moving_bodies = np.array([traveller.body for traveller in moving], np.int64)
        ids = np.append(self.parked_ids, moving_ids)
        bodies = np.append(self.parked_bodies, moving_bodies)
        boxes = np.concatenate([self.parked_boxes, self.boxes[rows]])
        boxes[:, 2] += self.site.ground(footprints(boxes)).mean(axis=1)
        return Objects(boxes, self.labels[bodies], ids), bodies


def simulate_continuously(
    site: Site,
    supply: Supply,
    *,
    frames: int,
    interval: float,
    max_parked: int,
    flow: Flow | None = None,
    progress: Callable[[int], None] | None = None,
) -> ContinuousTraffic:
    """Simulate all frames of continuous traffic.

    Args:
        site: Site with a network.
        supply: Gives bodies, ids and random numbers.
        frames: Number of frames.
        interval: Time between frames (s), a whole number of steps of `FINE_STEP_S`.
        max_parked: Largest number of parked vehicles.
        flow: Demand, None to draw it.
        progress: Called with the number of simulated seconds.

    Raises the errors of `toolkit.traffic.ways.simulate_ways`."""
    obstacles = Obstacles(site)
    parked = Parked.draw(site, obstacles, supply, max_parked=max_parked)
    seconds = max(0, frames - 1) * interval
    ways = simulate_ways(site, supply, seconds=seconds, flow=flow, progress=progress)
    stride = round(interval / FINE_STEP_S)
    view = outline_view(site.area)
    frame_parts = [np.zeros(0, np.int64)]
    box_parts = [np.zeros((0, 7))]
    way_parts = [np.zeros(0, np.int64)]
    for number, way in enumerate(ways):
        steps = way.first + np.arange(len(way.poses))
        rows = np.flatnonzero((steps % stride == 0) & (steps >= 0) & (steps < frames * stride))
        sizes = np.tile(supply.sizes[way.traveller.body], (len(rows), 1))
        boxes = place_boxes(way.poses[rows], sizes)
        is_seen = shapely.intersects(shapely.polygons(footprints(boxes)), view)
        frame_parts.append(steps[rows][is_seen] // stride)
        box_parts.append(boxes[is_seen])
        way_parts.append(np.full(int(is_seen.sum()), number))
    frame = np.concatenate(frame_parts)
    order = np.argsort(frame, kind="stable")  # by frame; within one, who set out first comes first
    frame = frame[order]
    boxes = np.concatenate(box_parts)[order]
    way_of_row = np.concatenate(way_parts)[order]
    begin = np.searchsorted(frame, np.arange(frames + 1))
    parked_boxes = parked.boxes(supply)
    is_refused = _refuse(begin, way_of_row, boxes, len(ways), parked_boxes, obstacles)
    is_kept = ~is_refused[way_of_row]
    seen_ways = np.unique(way_of_row[is_kept])
    return ContinuousTraffic(
        site=site,
        interval=interval,
        travellers=tuple(ways[number].traveller for number in seen_ways.tolist()),
        refused=int(is_refused.sum()),
        parked_boxes=parked_boxes,
        parked_ids=parked.ids,
        parked_bodies=parked.bodies,
        begin=np.searchsorted(frame[is_kept], np.arange(frames + 1)),
        traveller=np.searchsorted(seen_ways, way_of_row[is_kept]),
        boxes=boxes[is_kept],
        labels=supply.labels,
    )


def _refuse(
    begin: Int64[np.ndarray, " frames+1"],
    way: Int64[np.ndarray, " n"],
    boxes: LevelBoxes,
    ways: int,
    parked_boxes: LevelBoxes,
    obstacles: Obstacles,
) -> Bool[np.ndarray, " ways"]:
    """Mask of ways that overlap a way that is kept, a parked vehicle or a solid, in any frame.

    Args:
        begin: First row of each frame, and n at the end.
        way: Number of each row's way, ascending within a frame.
        boxes: Box of each row, on level ground.
        ways: Number of ways.
        parked_boxes: Boxes of parked vehicles, on level ground.
        obstacles: Solids in the way."""
    is_refused = np.zeros(ways, np.bool_)
    is_refused[way[obstacles.hit(boxes)]] = True
    pairs: set[tuple[int, int]] = set()
    parked = len(parked_boxes)
    for first, last in zip(begin[:-1].tolist(), begin[1:].tolist(), strict=True):
        close = overlaps(np.concatenate([parked_boxes, boxes[first:last]]))
        earlier, later = np.nonzero(close)
        for row, other in zip(earlier.tolist(), later.tolist(), strict=True):
            if other < parked:
                continue  # both are parked
            later_way = int(way[first + other - parked])
            if row < parked:
                is_refused[later_way] = True
            else:
                pairs.add((int(way[first + row - parked]), later_way))
    by_later: dict[int, list[int]] = {}
    for earlier_way, later_way in pairs:
        by_later.setdefault(later_way, []).append(earlier_way)
    for later_way in sorted(by_later):
        is_refused[later_way] |= not is_refused[by_later[later_way]].all()
    return is_refused
