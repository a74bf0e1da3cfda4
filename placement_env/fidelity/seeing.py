"""`see`: visibility of traffic from candidates. It uses rays or panoramas, whichever is quicker and
accurate enough."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple, get_args

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.checks import check_choice
from placement_env.fidelity.occlusion import SeenPoints, look_at
from placement_env.fidelity.ray_table import Lookup
from placement_env.fidelity.still import SentBackground, Still
from placement_env.fidelity.surround import ScoredItems, Surround, place_strips, successive_strips
from placement_env.fidelity.traffic import Traffic, build_renderer
from placement_env.fidelity.visibility import Visibility
from placement_env.setting import Rendering
from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import VEHICLE
from toolkit.rendering.strips import SuccessiveStrips
from toolkit.runtime.cache import code_digest, make_key, recall
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import Sensor, SensorModel
from toolkit.sites.files import format_site

MAX_BLOCK_PIXELS = 4_000_000  # pixels of the sensors handled at once, about 40 bytes each
VIEW_BLOCK_FRAMES = 8  # frames that a process handles before it returns its views from panoramas
MIN_SENSORS_PER_PLACE = 4  # mean number of sensors per place above which panoramas pay
RANGE_MARGIN_M = 10.0  # m above and below all objects that a panorama's sensor must measure
# points of the last look without a cache at a single block, by its key: a look at more frames
# begins with the same block
_LAST_SHORT_LOOK: dict[bytes, SeenPoints] = {}


class Block(NamedTuple):
    """Range of sensors or frames that is handled together.

    Attributes:
        first: Index of the first.
        end: Index after the last."""

    first: int
    end: int


def see(
    traffic: Traffic,
    candidates: Candidates,
    *,
    labels: Sequence[int] = (VEHICLE,),
    run: Run = Run(),
    rendering: Rendering = "auto",
) -> Visibility:
    """Visibility of all scored objects of the traffic from each candidate.

    Args:
        traffic: Frames to look at.
        candidates: Candidates in the order of the result's rows.
        labels: Classes (numbers) of the objects that count.
        run: Processes, progress and cache; the cache keeps finished blocks of candidates or frames,
            so an interrupted run resumes there.
        rendering: "full" casts every ray of every candidate. "panorama" looks once from each place
            and counts the rays of all its sensors in that view; this is much faster if many
            candidates share a place, and nearly always agrees within 3 % or 8 points of an object.
            "auto" uses panoramas if places have at least four candidates on average, as in a pool.
            A candidate whose range ends within the site is always rendered in full.

    Raises ValueError without candidates and for an unknown rendering."""
    if not len(candidates):
        raise ValueError("there must be a candidate to see, got none")
    check_choice("rendering", rendering, get_args(Rendering))
    labels = tuple(sorted(labels))
    sensors = candidates.sensors
    is_quick = choose_quick(sensors, traffic, rendering)
    visibility = Visibility.unseen(traffic, sensors, labels)
    # function that looks, and the mask of the sensors that it looks from
    for look, mask in ((look_round, is_quick), (look_in_full, ~is_quick)):
        if mask.any():
            seen = look(traffic, [sensors[c] for c in np.flatnonzero(mask)], labels, run)
            # rows of the arrays are filled in place
            visibility.points[mask] = seen.points
            visibility.sent[mask] = seen.sent
            visibility.far[mask] = seen.far
    return visibility


def choose_quick(
    sensors: Sequence[Sensor], traffic: Traffic, rendering: Rendering
) -> Bool[np.ndarray, " sensors"]:
    """Mask of the sensors whose view comes from panoramas rather than from casting all their rays.

    Panoramas have no limited range, so only sensors qualify that measure all of the detection area,
    to its farthest corner, and from `RANGE_MARGIN_M` below the middle of the lowest object to that
    above the middle of the highest one, or to the site's highest solid.

    Args:
        sensors: Sensors to choose from.
        traffic: Traffic on the site.
        rendering: "full" for none; "auto" for none unless places have at least
            `MIN_SENSORS_PER_PLACE` sensors on average; "panorama" for all that qualify."""
    places = {sensor.position.round(6).tobytes() for sensor in sensors}
    if rendering == "full" or (
        rendering == "auto" and len(sensors) < MIN_SENSORS_PER_PLACE * len(places)
    ):
        return np.zeros(len(sensors), np.bool_)
    xmin, ymin, xmax, ymax = traffic.site.area.tolist()
    corners = np.array([[x, y] for x in (xmin, xmax) for y in (ymin, ymax)])
    positions = np.array([sensor.position for sensor in sensors]).reshape(-1, 3)
    # horizontal distance to the farthest corner, axes before the maximum: sensor, corner
    horizontal = np.linalg.norm(positions[:, None, :2] - corners, axis=2).max(axis=1)
    object_z = np.concatenate(
        [snapshot.objects.boxes[:, 2] for snapshot in traffic.snapshots] or [np.zeros(0)]
    )
    lowest_z = object_z.min(initial=0) - RANGE_MARGIN_M
    highest_z = max(object_z.max(initial=0) + RANGE_MARGIN_M, traffic.site.height)
    sensor_z = positions[:, 2]
    vertical = np.maximum(np.abs(sensor_z - lowest_z), np.abs(sensor_z - highest_z))
    return np.hypot(horizontal, vertical) < [sensor.model.max_range for sensor in sensors]


def look_in_full(
    traffic: Traffic, sensors: Sequence[Sensor], labels: Sequence[int], run: Run = Run()
) -> SeenPoints:
    """Points of sensors on objects and in the crop, in all frames, by casting all their rays.

    Sensors are handled in blocks of at most `MAX_BLOCK_PIXELS` pixels, or one by one if larger.

    Args:
        traffic: Frames to look at.
        sensors: One or more sensors, in the order of the result's rows.
        labels: Classes (numbers) of the scored objects.
        run: Processes, progress, and the cache that keeps finished blocks."""
    blocks = list[Block]()
    first = 0
    pixels = 0  # in the block that begins at sensor `first`
    for c, sensor in enumerate(sensors):
        sensor_pixels = math.prod(sensor.model.shape)
        if pixels and pixels + sensor_pixels > MAX_BLOCK_PIXELS:
            blocks.append(Block(first, end=c))
            first = c
            pixels = 0
        pixels += sensor_pixels
    blocks.append(Block(first, end=len(sensors)))
    look = _FullLook(traffic, tuple(sensors), tuple(labels))
    seen = look.see(blocks, run, total=len(sensors))
    # points, sent and far of all blocks, each joined along the sensors
    return SeenPoints(*(np.concatenate(parts) for parts in zip(*seen, strict=True)))


def look_round(
    traffic: Traffic, sensors: Sequence[Sensor], labels: Sequence[int], run: Run = Run()
) -> SeenPoints:
    """Points of sensors on objects and in the crop, in all frames, from panoramas.

    Each place is rendered once for all sensors there, in blocks of `VIEW_BLOCK_FRAMES` frames.

    Args:
        traffic: Frames to look at.
        sensors: Sensors that measure all of the detection area, in the order of the result's rows.
        labels: Classes (numbers) of the scored objects.
        run: Processes, progress, and the cache that keeps finished blocks."""
    blocks = [
        Block(first=k, end=min(k + VIEW_BLOCK_FRAMES, len(traffic)))
        for k in range(0, len(traffic), VIEW_BLOCK_FRAMES)
    ]
    look = RoundLook(traffic, tuple(sensors), tuple(labels))
    seen = look.see(blocks, run, total=len(traffic))
    # points, sent and far of all blocks, each joined along the objects or frames
    return SeenPoints(*(np.concatenate(parts, axis=1) for parts in zip(*seen, strict=True)))


@dataclass(frozen=True, eq=False)
class _Look:
    """Points of sensors in traffic, computed block by block.

    Each worker process gets a copy without cached properties. A subclass defines a block, of
    sensors or frames: calling it with one returns its points, `key` its cache key."""

    traffic: Traffic
    sensors: tuple[Sensor, ...]
    labels: tuple[int, ...]

    def see(self, blocks: Sequence[Block], run: Run, total: int) -> list[SeenPoints]:
        """Points in each block, from the run's cache or computed now by its processes.

        Args:
            blocks: Blocks of sensors or frames, ascending without gaps.
            run: Processes, progress and cache.
            total: End of the last block; the share that is done gives the progress, in sensors."""
        report = run.stage("poses rendered", len(self.sensors))
        keys = [*map(self.key, blocks)]
        first_seen = _LAST_SHORT_LOOK.get(keys[0]) if run.memo is None else None
        seen = [] if first_seen is None else [first_seen]
        new_blocks = blocks[len(seen) :]
        new_keys = keys[len(seen) :]

        def compute(missing: list[int]) -> Iterator[SeenPoints]:
            # points in the new blocks with these indices, in parallel
            return self.look_at_blocks([new_blocks[k] for k in missing], run)

        for block, arrays in zip(new_blocks, recall(run.memo, new_keys, compute), strict=True):
            seen.append(SeenPoints(*arrays))
            if report:
                report(len(self.sensors) * block.end // total)
        if len(blocks) == 1 and run.memo is None:
            _LAST_SHORT_LOOK.clear()
            _LAST_SHORT_LOOK[keys[0]] = seen[0]
        return seen

    def look_at_blocks(self, blocks: Sequence[Block], run: Run) -> Iterator[SeenPoints]:
        """Points in each block, computed by the processes of the run."""
        return run.map(self, blocks)

    def __call__(self, block: Block) -> SeenPoints:
        raise NotImplementedError

    def key(self, block: Block) -> bytes:
        raise NotImplementedError

    def _depends_on(self, sensors: Sequence[Sensor]) -> tuple[object, ...]:
        """Parts of a cache key: source code, sensors and classes."""
        code = code_digest(__name__, *sorted({type(sensor.model).__module__ for sensor in sensors}))
        return code, [sensor.digest for sensor in sensors], self.labels

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.traffic, self.sensors, self.labels)


class _FullLook(_Look):
    """Points in all frames, by casting all rays; a block is a range of sensors."""

    def __call__(self, block: Block) -> SeenPoints:
        """Points of a block of sensors on objects and in the crop, in all frames."""
        sensors = self.sensors[block.first : block.end]
        return look_at(self.traffic, build_renderer(self.traffic), sensors, self.labels)

    def key(self, block: Block) -> bytes:
        sensors = self.sensors[block.first : block.end]
        return make_key("seen", self.traffic.digest(), *self._depends_on(sensors))


class RoundLook(_Look):
    """Points of all sensors, from panoramas; a block is a range of frames."""

    def look_at_blocks(self, blocks: Sequence[Block], run: Run) -> Iterator[SeenPoints]:
        """Points in each block; each process of the run looks from a share of the places.

        It looks at the static scene there once, and need not look again at what does not move."""
        places, place_of_sensor = self._places
        count = 1 if run.ray is not None else min(run.count, len(places))
        if count == 1:
            yield from run.map(self, blocks)
            return
        rows = [np.flatnonzero(place_of_sensor % count == share) for share in range(count)]
        looks = [self._choose_sensors(indices) for indices in rows]
        tasks = [(block, share) for block in blocks for share in range(count)]
        parts = run.map(_SharedLook(tuple(looks)), tasks, home=lambda task: task[1])
        order = np.argsort(np.concatenate(rows))
        for _ in blocks:
            seen = zip(*(next(parts) for _ in range(count)), strict=True)
            yield SeenPoints(*(np.concatenate(arrays)[order] for arrays in seen))

    def _choose_sensors(self, rows: Int64[np.ndarray, " n"]) -> "RoundLook":
        """Look from some of the sensors, given by their rows."""
        return replace(self, sensors=tuple(self.sensors[c] for c in rows.tolist()))

    def __call__(self, block: Block) -> SeenPoints:
        """Points of all sensors on objects and in the crop, in a block of frames.

        Each place is looked at once; all sensors there are looked up in that view."""
        snapshots = self.traffic.snapshots[block.first : block.end]
        scored = ScoredItems.from_snapshots(self.traffic, snapshots, self.labels)
        places, place_of_sensor = self._places
        count = len(self.sensors)
        seen = SeenPoints(
            points=np.zeros((count, scored.items), np.float32),
            sent=np.zeros((count, scored.frames), np.float32),
            far=np.zeros((count, scored.frames), np.float32),
        )
        strips_of_places = place_strips(
            self._strips,
            self.traffic,
            range(block.first, block.end),
            len(places),
            looks_again=False,
        )
        for place, strips in enumerate(strips_of_places):
            surround = Surround.from_strips(strips, scored, self._stills[place])
            for sensor in np.flatnonzero(place_of_sensor == place).tolist():
                sensor_points = surround.seen(self._lookups[sensor], self._backgrounds[sensor])
                seen.points[sensor] = sensor_points.points
                seen.sent[sensor] = sensor_points.sent
                seen.far[sensor] = sensor_points.far
        return seen

    def key(self, block: Block) -> bytes:
        """Key of a block's points in a cache."""
        traffic = self.traffic.part(block.first, block.end)
        return make_key("panoramas", traffic.digest(), self._depends_on(self.sensors))

    @cached_property
    def _places(self) -> tuple[Float64[np.ndarray, "places 3"], Int64[np.ndarray, " sensors"]]:
        """Distinct places of the sensors (m, to 1e-6 m), and the index of each sensor's place."""
        positions = np.array([sensor.position for sensor in self.sensors]).round(6)
        places, place_of_sensor = np.unique(positions, axis=0, return_inverse=True)
        return places, place_of_sensor.ravel()

    @cached_property
    def _lookups(self) -> list[Lookup]:
        # aim of each sensor in its table of rays
        return [Lookup.from_sensor(sensor) for sensor in self.sensors]

    @cached_property
    def _backgrounds(self) -> list[SentBackground]:
        # points that each sensor sends without objects, which are the same in all frames
        _, place_of_sensor = self._places
        return [
            self._stills[place][lookup.model].count_background(lookup)
            for place, lookup in zip(place_of_sensor.tolist(), self._lookups, strict=True)
        ]

    @cached_property
    def _strips(self) -> SuccessiveStrips:
        # kept from block to block: it reuses strips of objects that do not move
        return successive_strips(self.traffic, self._places[0])

    @cached_property
    def _stills(self) -> list[dict[SensorModel, Still]]:
        """Static scene seen from each place, by model of the sensors there.

        It is computed once in a process for all traffic of the same site."""
        site = self.traffic.site
        cached_stills = _known_stills(format_site(site))
        places, place_of_sensor = self._places
        stills: list[dict[SensorModel, Still]] = [{} for _ in places]
        # models of the sensors at each place, by index of the place
        place_models = {
            (place, sensor.model)
            for place, sensor in zip(place_of_sensor.tolist(), self.sensors, strict=True)
        }
        for place, model in place_models:
            key = places[place].tobytes(), model
            if key not in cached_stills:
                cached_stills[key] = Still.from_renderer(
                    build_renderer(self.traffic), site, places[place], model
                )
            stills[place][model] = cached_stills[key]
        return stills


@dataclass(frozen=True)
class _SharedLook:
    """Looks from shares of the places, which do not look from the same place.

    It is called with a block of frames and the index of a share."""

    looks: tuple[RoundLook, ...]

    def __call__(self, task: tuple[Block, int]) -> SeenPoints:
        block, share = task
        return self.looks[share](block)


@lru_cache(maxsize=1)
def _known_stills(site: str) -> dict[tuple[bytes, SensorModel], Still]:
    """Dictionary of the static scenes known for a site, by bytes of the place and by model.

    The caller adds to it. `lru_cache` returns the same one until another site is asked for.

    site: Text of the site's file."""
    return {}


def forget_stills() -> None:
    """Free the static scenes that looks keep, some 300 kB for each place and model."""
    _known_stills.cache_clear()
