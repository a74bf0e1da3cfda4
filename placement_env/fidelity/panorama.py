"""`Surround`: the view from one place in some frames, its strips in order of azimuth, for one
sensor after another.

`RayTable`: number of rays in rectangles of azimuth and elevation, for a sensor model at a tilt.

Counts of rays up to a place of a fine grid are summed over both angles once (Crow 1984, a
summed-area table). A rectangle then costs four of these sums, however many rays it holds. Azimuth
is measured from the sensor's heading. A sensor tilted slightly more than a table is looked up in
that table, with the rectangles turned by the difference.

`LiveView`: immediate views of moving sensors.

Sensors may be turned, tilted, raised and lowered on their mounts. Panoramas of all frames are made
at every half metre of a mount's height when one of its sensors is first requested. Between two of
these heights the view is interpolated; heading and tilt are looked up."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from threading import Lock
from typing import Any, Literal, NamedTuple

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.occlusion import worth
from placement_env.fidelity.traffic import Traffic, build_renderer, scored
from placement_env.fidelity.visibility import Visibility, distances
from toolkit.arrays import Float, Float32, Float64, Int32, Int64, Shaped, UInt8
from toolkit.geometry import pose
from toolkit.objects import VEHICLE
from toolkit.points import Crop, has_centre_inside
from toolkit.rendering.renderer import Moment, Renderer
from toolkit.rendering.strips import (
    BEYOND,
    WITHIN,
    Counted,
    Strips,
    SuccessiveStrips,
    concatenate_strips,
)
from toolkit.runtime.cache import Cache, code_digest, make_key, recall
from toolkit.sensors.sensor import NEAR, Sensor, SensorModel
from toolkit.sites.site import Mount, Site
from toolkit.traffic.snapshots import Snapshot

AZIMUTHS = 3600  # places of azimuth in a turn
ELEVATIONS = 3600  # places of elevation from straight down to straight up
TABLE_TILTS = float(np.deg2rad(1.0))  # rad between the tilts of tables
MOST_TABLE_BYTES = 220_000_000  # of the tables kept at a time, 3 to 12 MB each
CELL_COLUMNS = 240  # columns of cells over all directions, for the standing scene
# finest towards the horizon
CELL_EDGES = np.deg2rad(np.r_[-90.0:-30.0:0.5, -30.0:5.0:0.1, 5.0:90.5:0.5])
CELL_ROWS = len(CELL_EDGES) - 1

PI, PER_TURN, PER_STEEP = (
    np.float32(each) for each in (np.pi, AZIMUTHS / (2 * np.pi), ELEVATIONS / np.pi)
)

Angles = Float[np.ndarray, " n"]
Counts = Shaped[np.ndarray, " m"]  # of rays


class Bounded(OrderedDict[Any, Any]):
    """Values with `nbytes`, longest unused first. Threads may read while one adds."""

    @property
    def nbytes(self) -> int:
        """Memory of all values."""
        return sum(value.nbytes for value in list(self.values()))

    def keep(self, values: dict[Any, Any], max_bytes: int) -> None:
        """Add or renew values; drop others while all take more than `max_bytes` bytes."""
        for key, value in values.items():
            self[key] = value
            self.move_to_end(key)
        while len(self) > len(values) and self.nbytes > max_bytes:
            self.popitem(last=False)


class Aim(NamedTuple):
    """Heading, tilt below the horizon and roll about the viewing direction (rad)."""

    heading: float
    tilt: float
    roll: float


def compute_aim(sensor: Sensor) -> Aim:
    """Aim of a sensor; one that looks straight down or up takes its heading from the top of its
    image."""
    turn = sensor.world_SE3_body[:3, :3]
    tilt = float(np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0])))
    if np.hypot(turn[0, 0], turn[1, 0]) < 1e-6:
        return Aim(float(np.arctan2(-turn[0, 1], turn[1, 1])), tilt, 0.0)
    return Aim(
        float(np.arctan2(turn[1, 0], turn[0, 0])), tilt, float(np.arctan2(turn[2, 1], turn[2, 2]))
    )


class Lookup(NamedTuple):
    """Table of a sensor, and its aim there. tilt, roll: of the table (rad); heading: places of
    azimuth; more: places of elevation by which the sensor is tilted more than the table."""

    model: SensorModel
    tilt: float
    roll: float
    heading: np.float32
    more: np.float32

    @staticmethod
    def of(sensor: Sensor) -> "Lookup":
        """Lookup in the table of nearest tilt."""
        aim = compute_aim(sensor)
        tilt = round(aim.tilt / TABLE_TILTS) * TABLE_TILTS
        more = aim.tilt - tilt if abs(aim.tilt - tilt) >= 1e-6 else 0.0
        turned = np.float32(aim.heading) * PER_TURN
        further = np.float32(more) * PER_STEEP
        return Lookup(sensor.model, tilt, round(aim.roll, 4) + 0.0, turned, further)

    @property
    def table(self) -> "RayTable":
        """The table, made once."""
        return ray_table(self.model, self.tilt, self.roll)


class RayTable:
    """Rays of a model, tilted and rolled (rad).

    first_column, columns: places of azimuth with rays; first_row: the lowest of elevation; cells,
    cell_rays: cells with rays (column after column, azimuth from the heading), for uses that need
    no fine grid, and number of rays in each; nbytes: of memory."""

    def __init__(self, model: SensorModel, tilt: float, roll: float) -> None:
        turn = pose(pitch=tilt, roll=roll)[:3, :3] @ model.body_SE3_sensor[:3, :3]
        x, y, z = (model.rays().reshape(-1, 3) @ turn.T).T
        azimuth = np.arctan2(y, x)
        elevation = np.arctan2(z, np.hypot(x, y))
        column = np.floor((azimuth + np.pi) * (AZIMUTHS / (2 * np.pi))).astype(np.int64) % AZIMUTHS
        row = np.clip(
            np.floor((elevation + np.pi / 2) * (ELEVATIONS / np.pi)), 0, ELEVATIONS - 1
        ).astype(np.int64)
        self.first_column = int(column.min())
        self.first_row = int(row.min())
        shape = int(column.max()) - self.first_column + 1, int(row.max()) - self.first_row + 1
        self.columns = shape[0]
        kind = np.uint32 if len(column) >> 16 else np.uint16
        self._sums = np.zeros((shape[0] + 1, shape[1] + 1), kind)
        flat_cell = (column - self.first_column + 1) * (shape[1] + 1) + row - self.first_row + 1
        np.add.at(self._sums.ravel(), flat_cell, kind(1))
        for before, after in pairwise(
            self._sums
        ):  # row by row, as accumulate along this axis is five times slower
            np.add(before, after, out=after)
        np.add.accumulate(self._sums, axis=1, out=self._sums)
        column, row = find_cells(azimuth, elevation)
        rays = np.bincount(column * CELL_ROWS + row)
        self.cells = np.flatnonzero(rays)
        self.cell_rays = rays[self.cells].astype(np.float32)
        self.nbytes = self._sums.nbytes + self.cells.nbytes + self.cell_rays.nbytes

    def counts(
        self, rectangles: "Rectangles", heading: np.float32, more: np.float32
    ) -> tuple[Int64[np.ndarray, " m"], Counts]:
        """Rectangles that hold rays, and their number. heading, more: of the sensor, as of
        `Lookup`."""
        left, right, low, high = rectangles.list_places(heading, more)
        begin = np.rint(left).astype(np.int32)
        width = np.rint(right).astype(np.int32) - begin
        begin %= AZIMUTHS
        begin -= self.first_column
        low, up = (np.rint(bound).astype(np.int32) - self.first_row for bound in (low, high))
        last_column = self._sums.shape[0] - 1
        last_row = self._sums.shape[1] - 1
        reached = (begin < last_column) & (begin + width > 0) | (begin + width > AZIMUTHS)
        reachable = np.flatnonzero(reached & (up > 0) & (low < last_row))
        begin = begin.take(reachable)
        low = np.maximum(low.take(reachable), 0)
        up = np.minimum(up.take(reachable), last_row)
        end = begin + width.take(reachable)
        counts = self._within(np.maximum(begin, 0), np.minimum(end, last_column), low, up)
        wrapped = np.flatnonzero(end > AZIMUTHS)  # across the seam behind the sensor
        if len(wrapped):
            wrapped_end = np.minimum(end[wrapped] - AZIMUTHS, last_column)
            counts[wrapped] += self._within(
                np.zeros_like(wrapped_end), wrapped_end, low[wrapped], up[wrapped]
            )
        hit = np.flatnonzero(counts)
        return reachable[hit], counts[hit]

    def _within(
        self, begin: np.ndarray, end: np.ndarray, low: np.ndarray, up: np.ndarray
    ) -> Counts:
        flat = self._sums.ravel()
        across = self._sums.shape[1]
        begin = np.minimum(begin, end) * across
        end = end * across
        counts: Counts = flat.take(end + up) - flat.take(end + low)
        counts -= flat.take(begin + up) - flat.take(begin + low)
        return counts


_TABLES = Bounded()  # by model, tilt and roll
_LOCK = Lock()


def ray_table(model: SensorModel, tilt: float, roll: float) -> RayTable:
    """Return the table of a model, tilted and rolled (rad), made once as long as `MOST_TABLE_BYTES`
    hold it."""
    key = model, tilt, roll
    with _LOCK:
        table: RayTable = _TABLES.get(key) or RayTable(*key)
        _TABLES.keep({key: table}, MOST_TABLE_BYTES)
        return table


def make_table_ahead(model: SensorModel, lowest: float, steepest: float, around: float) -> bool:
    """Make one of the tables that lack between two tilts (rad), the nearest to `around` first.
    False where none lacks, or memory is full."""
    steps = range(round(lowest / TABLE_TILTS), round(steepest / TABLE_TILTS) + 1)
    for step in sorted(steps, key=lambda tilt_step: abs(tilt_step - around / TABLE_TILTS)):
        if (
            key := (model, step * TABLE_TILTS, 0.0)
        ) not in _TABLES and _TABLES.nbytes < 0.85 * MOST_TABLE_BYTES:
            ray_table(*key)
            return True
    return False


class Rectangles(NamedTuple):
    """Rectangles of azimuth and elevation of the world.

    left, right: in places of azimuth, right up to a turn farther; low, high: in places of
    elevation; cos, sin: of the azimuth of the middle; tan: of its elevation, but no steeper than
    3."""

    left: Float32[np.ndarray, " n"]
    right: Float32[np.ndarray, " n"]
    low: Float32[np.ndarray, " n"]
    high: Float32[np.ndarray, " n"]
    cos: Float32[np.ndarray, " n"]
    sin: Float32[np.ndarray, " n"]
    tan: Float32[np.ndarray, " n"]

    @staticmethod
    def of(
        left: np.ndarray, right: np.ndarray, bottom: np.ndarray, top: np.ndarray
    ) -> "Rectangles":
        """Build from angles (n,) (rad, float32)."""
        middle = (left + right) / 2
        tan = np.clip(np.tan((bottom + top) / 2), -3, 3)
        azimuths = (left + PI) * PER_TURN, (right + PI) * PER_TURN
        elevations = (bottom + PI / 2) * PER_STEEP, (top + PI / 2) * PER_STEEP
        return Rectangles(*azimuths, *elevations, np.cos(middle), np.sin(middle), tan)

    def list_places(self, heading: np.float32, more: np.float32) -> tuple[np.ndarray, ...]:
        """Left, right, low and high from the heading on, to first order in the extra tilt of the
        middle."""
        left = self.left - heading
        right = self.right - heading
        if not more:
            return left, right, self.low, self.high
        angle = heading / PER_TURN
        cos, sin = np.cos(angle), np.sin(angle)
        up = more * (self.cos * cos + self.sin * sin)
        aside = (more * PER_TURN / PER_STEEP) * self.tan * (self.sin * cos - self.cos * sin)
        return left + aside, right + aside, self.low + up, self.high + up


def find_cells(
    azimuth: Angles, elevation: Angles
) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
    """Column and row of the cells of directions."""
    column = (
        np.floor((azimuth + np.pi) * (CELL_COLUMNS / (2 * np.pi))).astype(np.int64) % CELL_COLUMNS
    )
    return column, np.clip(
        np.searchsorted(CELL_EDGES, elevation, side="right") - 1, 0, CELL_ROWS - 1
    )


def cell_elevations() -> Float64[np.ndarray, " rows"]:
    """Elevations of the middle of each row of cells."""
    return (CELL_EDGES[1:] + CELL_EDGES[:-1]) / 2


ASIDE = 16  # places of azimuth by which slightly more tilt may move a strip
MOST_MOMENTS = 64  # frames whose scenes are kept
CHANCE_STEPS = np.float32(250.0)  # steps of chances, so that one half is exact


class ScoredItems(NamedTuple):
    """Scored objects among all of some frames. place: of each object its index among the scored
    ones, or their number if not scored; frame: of each object; items, frames: numbers of scored
    objects and frames."""

    place: Int64[np.ndarray, " n"]
    frame: Int64[np.ndarray, " n"]
    items: int
    frames: int

    @staticmethod
    def of(traffic: Traffic, snapshots: Sequence[Snapshot], labels: Sequence[int]) -> "ScoredItems":
        """Scored objects of some classes (numbers) in some frames."""
        masks = [scored(snapshot.objects, traffic.site, labels) for snapshot in snapshots]
        counts = np.concatenate([np.zeros(0, np.bool_), *masks])
        frame = np.repeat(np.arange(len(masks)), list(map(len, masks)))
        return ScoredItems(
            np.where(counts, np.cumsum(counts) - 1, counts.sum()),
            frame,
            int(counts.sum()),
            len(masks),
        )


@dataclass(frozen=True, eq=False)
class Surround:
    """Strips of one place, ready for lookup.

    item: of each strip among the scored ones, or the number of these; frame: of each; widest: of
    all strips (places); gains: by model, of a ray in each strip over the background: points sent,
    and far ones; stills: background by model.
    """

    scored: ScoredItems
    rectangles: Rectangles
    item: Int32[np.ndarray, " n"]
    frame: Int32[np.ndarray, " n"]
    widest: float
    gains: dict[SensorModel, tuple[np.ndarray, np.ndarray]]
    stills: "dict[SensorModel, Still]"

    def __deepcopy__(self, memo: dict[int, Any]) -> "Surround":
        return self  # never changed, and up to 10 MB

    @staticmethod
    def of(strips: Strips, scored: ScoredItems, stills: "dict[SensorModel, Still]") -> "Surround":
        """Surround of the strips of one place. stills: standing scene seen from there, by sensor
        model."""
        rectangles = Rectangles.of(strips.left, strips.right, strips.bottom, strips.top)
        turns = np.floor(rectangles.left / AZIMUTHS) * AZIMUTHS
        rectangles = rectangles._replace(
            left=rectangles.left - turns, right=rectangles.right - turns
        )
        order = np.argsort(rectangles.left, kind="stable")
        rectangles = Rectangles(*(column[order] for column in rectangles))
        strips = Strips(*(column[order] for column in strips))
        counts = strips.shows >= WITHIN
        far = strips.shows == BEYOND
        gains = {}
        for model, still in stills.items():
            behind = still.behind(
                (strips.left + strips.right) / 2, (strips.bottom + strips.top) / 2
            )
            gains[model] = (counts - behind[0], far - behind[1])
        widest = float((rectangles.right - rectangles.left).max(initial=0))
        item = np.where(counts, scored.place[strips.item], scored.items)
        frame = scored.frame[strips.item]
        return Surround(
            scored, rectangles, item.astype(np.int32), frame.astype(np.int32), widest, gains, stills
        )

    @cached_property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        pairs = [*self.gains.values(), *((still.sent, still.far) for still in self.stills.values())]
        return sum(
            array.nbytes for array in (*self.rectangles, self.item, self.frame, *sum(pairs, ()))
        )

    def seen(
        self, lookup: Lookup
    ) -> tuple[
        Float64[np.ndarray, " items"],
        Float64[np.ndarray, " frames"],
        Float64[np.ndarray, " frames"],
    ]:
        """Points of a sensor on each scored object, points sent in each frame, and the far ones
        among them."""
        table = lookup.table
        items = self.scored.items + 1
        frames = self.scored.frames
        points, more_sent, more_far = np.zeros(items), *self.gains[lookup.model]
        sent, far = (np.full(frames, chance) for chance in self.stills[lookup.model].alone(lookup))
        for rows in self._ahead(table, float(lookup.heading)):
            ahead = Rectangles(*(chance[rows] for chance in self.rectangles))
            hit, rays = table.counts(ahead, lookup.heading, lookup.more)
            points += np.bincount(self.item[rows].take(hit), rays, items)
            frame = self.frame[rows].take(hit)
            sent += np.bincount(frame, rays * more_sent[rows].take(hit), frames)
            far += np.bincount(frame, rays * more_far[rows].take(hit), frames)
        return points[:-1], np.maximum(sent, 0), np.maximum(far, 0)

    def _ahead(self, table: RayTable, heading: float) -> list[slice]:
        """Strips that rays of a table may fall on."""
        before = self.widest + ASIDE
        length = table.columns + before + ASIDE
        if length >= AZIMUTHS:
            return [slice(0, len(self.item))]
        first = (table.first_column + heading - before) % AZIMUTHS
        ends = [(first, first + length), (0.0, first + length - AZIMUTHS)]
        return [
            slice(*np.searchsorted(self.rectangles.left, end).tolist())
            for end in ends
            if end[1] > end[0]
        ]


def successive_strips(traffic: Traffic, places: Float64[np.ndarray, "V 3"]) -> SuccessiveStrips:
    """Finder of strips seen from places."""
    return SuccessiveStrips(
        build_renderer(traffic), places, Counted(Crop.of(traffic.site), traffic.site.hybrid_radius)
    )


def place_strips(
    successive: SuccessiveStrips, traffic: Traffic, frames: Iterable[int], places: int
) -> list[Strips]:
    """Strips of each place in some frames."""
    parts = []
    first = 0
    for k in frames:
        fine = has_centre_inside(traffic.snapshots[k].objects.boxes, traffic.site.area)
        strips = successive.of(build_moment(traffic, k), fine)
        parts.append(strips._replace(item=strips.item + np.int32(first)))
        first += len(fine)
    strips_of_all = concatenate_strips(parts)
    order = np.argsort(strips_of_all.viewpoint, kind="stable")
    ends = np.searchsorted(strips_of_all.viewpoint[order], np.arange(places + 1))
    return [strips_of_all.take(order[begin:end]) for begin, end in pairwise(ends)]


@lru_cache(maxsize=MOST_MOMENTS)
def build_moment(traffic: Traffic, k: int) -> Moment:
    """Scene of what moves in a frame, made once for the latest ones."""
    return build_renderer(traffic).moment(traffic.snapshots[k])


@dataclass(frozen=True, eq=False)
class Still:
    """Chances of a point to be sent, and to be sent and far, in 250ths, for each cell."""

    sent: UInt8[np.ndarray, " cells"]
    far: UInt8[np.ndarray, " cells"]

    @staticmethod
    def of(
        renderer: Renderer, site: Site, viewpoint: Float64[np.ndarray, "3"], model: SensorModel
    ) -> "Still":
        """Chances seen from a viewpoint, with a model's noise. The noise is the same everywhere in
        its image."""
        rays = _directions()
        mean = _mean_length(model)
        images = np.zeros((2, len(rays)), np.uint8)
        origin = viewpoint.astype(np.float32)
        lines = np.concatenate([origin + np.float32(NEAR) * rays, rays], axis=1)
        length = renderer.cast_still(lines) + np.float32(NEAR)
        returning = np.flatnonzero(length < model.max_range)
        length = length[returning]
        directions = rays[returning]
        spread = (mean * np.abs(directions[:, 2]) * model.deviation(length / mean)).astype(
            np.float32
        )
        points = directions * length[:, None] + origin
        chances = worth(points, spread, np.broadcast_to(origin[:2], (len(returning), 2)), site)
        images[:, returning] = np.rint(CHANCE_STEPS * np.array(chances))
        return Still(*images)

    def alone(self, lookup: Lookup) -> tuple[float, float]:
        """Points that a sensor sends in a still scene, and the far ones."""
        table = lookup.table
        columns = round(float(lookup.heading) * CELL_COLUMNS / AZIMUTHS) % CELL_COLUMNS
        cell = table.cells + columns * CELL_ROWS
        sums = (
            float(table.cell_rays @ image.take(cell, mode="wrap"))
            for image in (self.sent, self.far)
        )
        sent, far = (rays / float(CHANCE_STEPS) for rays in sums)
        return sent, far

    def behind(
        self, azimuth: Float32[np.ndarray, " n"], elevation: Float32[np.ndarray, " n"]
    ) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
        """Chances of the scene in some directions (rad)."""
        column, row = find_cells(azimuth, elevation)
        cell = column * CELL_ROWS + row
        return self.sent.take(cell) / CHANCE_STEPS, self.far.take(cell) / CHANCE_STEPS


@lru_cache(maxsize=8)
def _mean_length(model: SensorModel) -> np.floating:
    """Metres along a ray per unit of measurement, on average."""
    return np.linalg.norm(model.rays(), axis=-1).mean()


@lru_cache(maxsize=1)
def _directions() -> Float32[np.ndarray, "cells 3"]:
    """Directions through the middle of each cell."""
    azimuth = (np.arange(CELL_COLUMNS) + 0.5)[:, None] * (2 * np.pi / CELL_COLUMNS) - np.pi
    elevation = cell_elevations()
    flat = np.cos(elevation)
    axes = (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation) + 0 * azimuth)
    return np.stack(axes, axis=-1).reshape(-1, 3).astype(np.float32)


HEIGHT_STEP = 0.5  # m between the panoramas of a mount
CLOSE = 1.5  # m of height within which a first view is taken from another panorama
MOST_BYTES = 600_000_000  # of the panoramas kept in memory

Place = tuple[float, float, float]
_Wanted = list[tuple[Place, Mount]]
Reach = Literal["mount", "own", "nearest"]


def _never() -> bool:
    return False


class LiveView:
    """Look at traffic from mounts, with sensors that measure all of the detection area
    (`seeing.choose_quick`).

    A copy, also one that is pickled, keeps the panoramas and goes on without the original: nobody
    waits for it.

    labels: classes (numbers) of the objects that count; cache: where panoramas are kept and shared
    with other processes, None for this object's memory."""

    def __init__(
        self, traffic: Traffic, labels: Sequence[int] = (VEHICLE,), cache: Cache | None = None
    ) -> None:
        self.traffic = traffic
        self._cache = cache
        self._unseen = Visibility.unseen(traffic, (), labels)
        self._scored = ScoredItems.of(traffic, traffic.snapshots, labels)
        # surrounds by place
        self._kept = Bounded()
        self._most = MOST_BYTES
        self._stand_alone()

    def _stand_alone(self) -> None:
        """Begin without threads that cast, wait or are waited for."""
        self.casting = Lock()  # held while rays are cast: others may look at what is there
        # one for each thread that waits to cast; a list, as threads may change it
        self._queue: list[None] = []
        self.hold: Callable[[], bool] = (
            _never  # asked before each frame of a panorama: true to wait
        )

    def __getstate__(self) -> dict[str, Any]:
        with self.casting:  # no panorama is added meanwhile
            state = {**self.__dict__, "_kept": self._kept.copy()}
        for name in ("casting", "_queue", "hold"):
            del state[name]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._stand_alone()

    def see(self, candidates: Candidates, *, reach: Reach = "mount") -> Visibility:
        """View of candidates. The first from a mount makes panoramas of all its heights.

        reach: "own" makes one at each sensor's own height alone; "nearest" takes the next within
        `CLOSE` where those of its own height and of the half metres below and above are unknown,
        else makes one at the nearest half metre.
        """
        sensors = candidates.sensors
        mounts = [candidates.mounts[index] for index in candidates.mount.tolist()]
        shares = [
            _between(sensor.position, mount) for sensor, mount in zip(sensors, mounts, strict=True)
        ]
        if reach != "mount":
            at_height = [[(_place(*sensor.position.tolist()), 1.0)] for sensor in sensors]
            for s, sensor in enumerate(sensors):
                if reach == "own" or self.knows(sensor):
                    shares[s] = at_height[s]
                elif not self._knows(shares[s], sensor.model):
                    x, y, z = at_height[s][0][0]
                    near = [
                        place
                        for place in list(self._kept)
                        if place[:2] == (x, y) and abs(place[2] - z) <= CLOSE
                    ]
                    near = [place for place in near if self._knows([(place, 1.0)], sensor.model)]
                    nearest_half = max(shares[s], key=lambda pair: pair[1])[0]
                    shares[s] = [
                        (min(near, key=lambda place: abs(place[2] - z), default=nearest_half), 1.0)
                    ]
        places = [
            (place, mount) for pair, mount in zip(shares, mounts, strict=True) for place, _ in pair
        ]
        surrounds = self._prepare(
            places, {sensor.model for sensor in sensors}, all_heights=reach == "mount"
        )
        points = np.zeros((len(sensors), self._scored.items))
        sent, far = np.zeros((2, len(sensors), self._scored.frames))
        for s, sensor in enumerate(sensors):
            lookup = Lookup.of(sensor)
            for place, share in shares[s]:
                for total, figures in zip(
                    (points, sent, far), surrounds[place].seen(lookup), strict=True
                ):
                    total[s] += share * figures
        seen = {
            "points": points.astype(np.float32),
            "sent": sent.astype(np.float32),
            "far": far.astype(np.float32),
        }
        return replace(self._unseen, distance=distances(sensors, self._unseen.boxes), **seen)

    def knows(self, sensor: Sensor) -> bool:
        """True where the view from a sensor's own height needs no panorama."""
        return self._knows([(_place(*sensor.position.tolist()), 1.0)], sensor.model)

    def limit(self, max_bytes: int) -> None:
        """Keep panoramas of at most so many bytes in memory."""
        self._most = max_bytes

    @property
    def full(self) -> bool:
        """True where memory has hardly room for another panorama."""
        return self._kept.nbytes > 0.9 * self._most

    def _knows(self, shares: list[tuple[Place, float]], model: SensorModel) -> bool:
        return all(place in self._kept and model in self._kept[place].stills for place, _ in shares)

    def _prepare(
        self, places: _Wanted, models: set[SensorModel], *, all_heights: bool
    ) -> dict[Place, Surround]:
        """Views from places, made where they lack."""
        requested = dict.fromkeys(place for place, _ in places)
        # held, whatever is dropped
        surrounds = {place: self._kept[place] for place in requested if place in self._kept}
        if len(surrounds) == len(requested) and all(
            models <= surround.stills.keys() for surround in surrounds.values()
        ):
            return surrounds
        self._queue.append(None)
        with self.casting:
            self._queue.pop()
            return surrounds | self._make(places, models, all_heights=all_heights)

    def _in_turn(self) -> Iterator[int]:
        """Frames, each when nobody is to be answered first."""
        for k in range(len(self.traffic)):
            while self.hold() and not self._queue:
                time.sleep(0.001)
            yield k

    def _make(
        self, wanted_places: _Wanted, models: set[SensorModel], *, all_heights: bool
    ) -> dict[Place, Surround]:

        def lacks(place: Place) -> bool:
            return place not in self._kept or not models <= self._kept[place].stills.keys()

        requested = dict.fromkeys(place for place, _ in wanted_places)
        renderer = build_renderer(self.traffic)
        other_heights = {
            height_place
            for place, mount in wanted_places
            if all_heights and lacks(place)
            for height_place in _places(place, mount)
        }
        places = sorted(filter(lacks, {*requested, *other_heights}))
        for place, strips in zip(places, self._panoramas(places), strict=True):
            stills = dict(self._kept[place].stills) if place in self._kept else {}
            for model in models - stills.keys():
                stills[model] = Still.of(renderer, self.traffic.site, np.array(place), model)
            self._kept[place] = Surround.of(strips, self._scored, stills)
        surrounds = {place: self._kept[place] for place in requested}
        self._kept.keep(surrounds, self._most)
        return surrounds

    def _panoramas(self, places: list[Place]) -> list[Strips]:

        def make(missing: list[int]) -> list[Strips]:
            successive = successive_strips(self.traffic, np.array(places)[missing])
            return place_strips(successive, self.traffic, self._in_turn(), len(missing))

        keys = [b"" for _ in places]  # which take long, so they are made for a cache alone
        if self._cache is not None:
            keys = [
                make_key("panorama", code_digest(__name__), self.traffic.digest(), place)
                for place in places
            ]
        return [Strips(*arrays) for arrays in recall(self._cache, keys, make)]


def _between(position: Float64[np.ndarray, "3"], mount: Mount) -> list[tuple[Place, float]]:
    """Panorama places below and above a position on a mount."""
    x, y, z = position.tolist()
    foot = float(mount.position[2])
    steps = round((z - foot) / HEIGHT_STEP, 6)
    below = int(np.floor(steps))
    share = steps - below
    weighted_steps = [(below, 1 - share), (below + 1, share)]
    return [
        (_place(x, y, foot + step * HEIGHT_STEP), weight)
        for step, weight in weighted_steps
        if weight > 0
    ]


def _places(place: Place, mount: Mount) -> list[Place]:
    """Panorama places for all heights of a sensor on a mount."""
    return [_place(*place[:2], float(mount.position[2]) + height) for height in list_heights(mount)]


def list_heights(mount: Mount) -> list[float]:
    """Heights of panoramas above a mount's foot (m), which hold all of its sensors between them."""
    low, high = (h / HEIGHT_STEP for h in (mount.min_height, mount.max_height))
    steps = range(int(np.floor(low + 1e-6)), int(np.ceil(high - 1e-6)) + 1)
    return [step * HEIGHT_STEP for step in steps]


def _place(x: float, y: float, z: float) -> Place:
    return round(x, 6), round(y, 6), round(z, 6)
