"""Continuous traffic: frames of ways through a site that never overlap.

Frames may be any number of steps of 0.1 s apart. A road user that would overlap another, a parked
vehicle or a solid waits or steps aside (`toolkit.traffic.right_of_way`), or sets out later. A body
too long for a turn is replaced by a shorter one. A road user is refused as a whole if nothing
helps, so that nobody appears or vanishes inside the view."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import shapely

from toolkit.arrays import Bool, Float64, Int64
from toolkit.boxes import footprints
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE, Objects
from toolkit.sites.site import Site
from toolkit.traffic.body_motion import change_length
from toolkit.traffic.course import Course
from toolkit.traffic.flow import Flow
from toolkit.traffic.obstacles import LevelBoxes, Obstacles
from toolkit.traffic.occupancy import Occupancy, size_boxes
from toolkit.traffic.parked import Parked
from toolkit.traffic.right_of_way import give_way, is_impassable
from toolkit.traffic.road_lanes import distance_to_area, outline_view
from toolkit.traffic.sumo import FINE_STEP_S
from toolkit.traffic.supply import Supply
from toolkit.traffic.ways import Journey, Traveller, simulate_ways

# by which a road user that finds no way through sets out later, one tried after the other
DELAYS_STEPS = (0, 50, 100, 200, 400)
# rank of each class; lower ones do not give way to higher ones
RANK = {VEHICLE: 0, HEAVY: 0, CYCLIST: 1, PEDESTRIAN: 2}


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
        begin: First row of each frame, and n at the end: one more than frames.
        traveller: Index in `travellers` of each row.
        boxes: Box of each row, on level ground.
        labels: Class of each body that traffic was given."""

    site: Site
    interval: float
    travellers: tuple[Traveller, ...]
    refused: int
    parked_boxes: Float64[np.ndarray, "p 7"]
    parked_ids: Int64[np.ndarray, " p"]
    parked_bodies: Int64[np.ndarray, " p"]
    begin: Int64[np.ndarray, " starts"]
    traveller: Int64[np.ndarray, " n"]
    boxes: LevelBoxes
    labels: Int64[np.ndarray, " bodies"]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.begin) - 1

    def objects(self, k: int) -> tuple[Objects, Int64[np.ndarray, " m"]]:
        """Objects of frame k on the ground of the site, parked ones first, and the body of each."""
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
    parked_boxes = parked.boxes(supply)
    last = max(0, frames - 1) * stride  # number of the last step
    occupancy = Occupancy(site.area, obstacles, parked_boxes, last)
    way_count = len(ways)
    travellers: dict[int, Traveller] = {}  # by number of the way
    frame_parts: dict[int, Int64[np.ndarray, " k"]] = {}
    box_parts: dict[int, LevelBoxes] = {}
    for number, way in _keep_apart(ways, supply, occupancy):
        # only what is seen is kept, since the poses of all steps would take much memory
        steps = way.first + np.arange(len(way.poses))
        rows = np.flatnonzero((steps % stride == 0) & (steps >= 0) & (steps < frames * stride))
        boxes = size_boxes(way.poses[rows], supply.sizes[way.traveller.body])
        is_seen = _mask_seen(boxes, site.area)
        travellers[number] = way.traveller
        frame_parts[number] = steps[rows][is_seen] // stride
        box_parts[number] = boxes[is_seen]
    numbers = sorted(travellers)  # in the order in which they set out
    frame = np.concatenate([np.zeros(0, np.int64), *(frame_parts[number] for number in numbers)])
    order = np.argsort(frame, kind="stable")  # by frame; within one, who set out first comes first
    frame = frame[order]
    boxes = np.concatenate([np.zeros((0, 7)), *(box_parts[number] for number in numbers)])[order]
    row_counts = [len(box_parts[number]) for number in numbers]
    way_of_row = np.repeat(np.array(numbers, np.int64), row_counts)[order]
    seen_ways = np.unique(way_of_row)
    return ContinuousTraffic(
        site=site,
        interval=interval,
        travellers=tuple(travellers[number] for number in seen_ways.tolist()),
        refused=way_count - len(travellers),
        parked_boxes=parked_boxes,
        parked_ids=parked.ids,
        parked_bodies=parked.bodies,
        begin=np.searchsorted(frame, np.arange(frames + 1)),
        traveller=np.searchsorted(seen_ways, way_of_row),
        boxes=boxes,
        labels=supply.labels,
    )


def _mask_seen(boxes: LevelBoxes, area: Float64[np.ndarray, "4"]) -> Bool[np.ndarray, " n"]:
    """Mask of boxes that touch the view of an area.

    area: xmin, ymin, xmax, ymax (m)."""
    view = outline_view(area)
    distances = distance_to_area(boxes[:, :2], np.array(view.bounds))
    is_seen = distances <= 0  # the middle is within
    # outlines decide for the others, unless they are farther than a body is long
    is_open = ~is_seen & (distances <= np.hypot(boxes[:, 3], boxes[:, 4]))
    outlines = shapely.polygons(footprints(boxes[is_open]))
    is_seen[is_open] = shapely.intersects(outlines, view)
    return is_seen


def _keep_apart(
    ways: list[Journey], supply: Supply, occupancy: Occupancy
) -> Iterator[tuple[int, Journey]]:
    """Yield ways without overlaps, and the number of each; some find no way through.

    Vehicles go before cyclists and these before pedestrians, in each class who set out first. Who
    finds no way through sets out later, with a shorter body if the turn is too tight for this one.

    ways: all ways, taken out of the list one after the other."""
    bodies = [way.traveller.body for way in ways]
    order = sorted(range(len(ways)), key=lambda number: RANK[int(supply.labels[bodies[number]])])
    ways_by_number = dict(enumerate(ways))
    ways.clear()
    for number in order:
        way = ways_by_number.pop(number)
        placed = _place(way, supply, occupancy)
        if placed is None:
            shortened = _shorten_body(way, supply, occupancy)
            placed = None if shortened is None else _place(shortened, supply, occupancy)
        if placed is not None:
            yield number, placed


def _place(way: Journey, supply: Supply, occupancy: Occupancy) -> Journey | None:
    """Way that meets nobody, which may set out later; None if there is no way through.

    occupancy: the others, to which the body is added."""
    for delay in DELAYS_STEPS:
        first = way.first + delay
        poses = give_way(_make_course(way._replace(first=first), supply), occupancy)
        if poses is not None:
            return way._replace(first=first, poses=poses)
    return None


def _shorten_body(way: Journey, supply: Supply, occupancy: Occupancy) -> Journey | None:
    """Way with the longest shorter body of its kind that can take all turns.

    None for a pedestrian, for a body that can take them itself, and if none can."""
    body = way.traveller.body
    if supply.labels[body] == PEDESTRIAN:
        return None
    if not is_impassable(_make_course(way, supply), occupancy):
        return None
    lengths = supply.sizes[:, 0]
    is_alike = np.array([name == supply.classes[body] for name in supply.classes])
    shorter = np.flatnonzero(is_alike & (lengths < lengths[body]))
    longest_first = shorter[np.argsort(-lengths[shorter], kind="stable")]
    for row in longest_first.tolist():
        poses = change_length(way.poses, float(lengths[body]), float(lengths[row]))
        shortened = way._replace(traveller=way.traveller._replace(body=row), poses=poses)
        if not is_impassable(_make_course(shortened, supply), occupancy):
            return shortened
    return None


def _make_course(way: Journey, supply: Supply) -> Course:
    """Course of the body of a way."""
    body = way.traveller.body
    return Course(way.first, way.poses, supply.sizes[body], label=int(supply.labels[body]))
