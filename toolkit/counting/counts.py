"""Counts of a street: turning movements, speeds, dwell times and queues, with their errors.

Counts from tracks and from the truth are made by the same functions, so that they differ only as
the tracks do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Float64
from toolkit.counting.arms import Arm
from toolkit.counting.trajectories import Trajectory
from toolkit.counting.trips import Trip, find_trips, mask_inside
from toolkit.objects import HEAVY, LABELS, VEHICLE
from toolkit.sites.site import Site

QUEUED_M_S = 5 / 3.6  # slower vehicles queue
GROUPS = {  # names of classes that are counted together, by the name of the group
    "vehicles": ("vehicle", "heavy"),
    "cyclists": ("cyclist",),
    "pedestrians": ("pedestrian",),
}
MAX_TRIP_OFFSET_S = 3.0  # between entries, and between exits, of a trip and its true one


class MovementKey(NamedTuple):
    """Trips that are counted together.

    Attributes:
        label: name of their class.
        entry: name of the arm at which they come in.
        exit: name of the arm at which they leave."""

    label: str
    entry: str
    exit: str


@dataclass(frozen=True)
class MovementCount:
    """Trips of one class from one arm to another.

    Attributes:
        label: name of the class.
        entry: name of the arm at which they come in.
        exit: name of the arm at which they leave.
        count: number of trips.
        speed_km_h: mean speed while they move (km/h).
        dwell_s: mean time in the area (s)."""

    label: str
    entry: str
    exit: str
    count: int
    speed_km_h: float
    dwell_s: float

    @property
    def key(self) -> MovementKey:
        """Names of class, entry and exit."""
        return MovementKey(self.label, self.entry, self.exit)


class QueueCount(NamedTuple):
    """Vehicles that queue after they came in at an arm.

    Attributes:
        entry: name of the arm.
        mean: mean number of them.
        longest: largest number of them at a time."""

    entry: str
    mean: float
    longest: int


@dataclass(frozen=True)
class StreetCounts:
    """Counts of a stretch of time.

    Attributes:
        seconds: length of the stretch.
        trips: all trips, also those whose entry or exit is unknown.
        movements: counted trips by class, entry and exit.
        partial: number of trips by class whose entry or exit is unknown, without standing ones.
        queues: queues by entry."""

    seconds: float
    trips: tuple[Trip, ...]
    movements: tuple[MovementCount, ...]
    partial: dict[str, int]
    queues: tuple[QueueCount, ...]

    def total(self, *labels: str) -> int:
        """Number of whole trips of some classes."""
        return sum(movement.count for movement in self.movements if movement.label in labels)

    def mean_speed(self, *labels: str) -> float:
        """Mean speed (km/h) of whole trips of some classes, while they move; NaN without trips."""
        return _mean([trip.speed_km_h for trip in self.trips if _is_counted(trip, labels)])


def count_street(
    trajectories: Sequence[Trajectory], site: Site, arms: Sequence[Arm], times: Sequence[float]
) -> StreetCounts:
    """Count the road users of a stretch of time.

    Args:
        trajectories: Road users, one after the other.
        site: Site with the area in which they count.
        arms: Arms of the site.
        times: Time of each frame (s), ascending."""
    trips = find_trips(trajectories, arms, site.area)
    groups: dict[MovementKey, list[Trip]] = {}
    partial = dict.fromkeys(LABELS, 0)
    for trip in trips:
        if trip.entry is not None and trip.exit is not None:
            key = MovementKey(LABELS[trip.label], trip.entry, trip.exit)
            groups.setdefault(key, []).append(trip)
        elif trip.moving_s > 0:
            partial[LABELS[trip.label]] += 1
    movements = []
    for key in sorted(groups, key=_order_of_movement):
        movement = MovementCount(
            label=key.label,
            entry=key.entry,
            exit=key.exit,
            count=len(groups[key]),
            speed_km_h=_mean([trip.speed_km_h for trip in groups[key]]),
            dwell_s=_mean([trip.dwell_s for trip in groups[key]]),
        )
        movements.append(movement)
    seconds = np.asarray(times, np.float64)
    return StreetCounts(
        seconds=float(seconds[-1] - seconds[0]) if len(seconds) else 0.0,
        trips=tuple(trips),
        movements=tuple(movements),
        partial=partial,
        queues=_count_queues(trajectories, trips, site, seconds),
    )


def _count_queues(
    trajectories: Sequence[Trajectory],
    trips: Sequence[Trip],
    site: Site,
    seconds: Float64[np.ndarray, " frames"],
) -> tuple[QueueCount, ...]:
    """Queues of vehicles whose entry is known, by the name of the entry.

    Args:
        trajectories: Road users.
        trips: Their trips.
        site: Site with the area in which they queue.
        seconds: Time of each frame (s), ascending, with all times of the trajectories."""
    vehicles = {user.id: user for user in trajectories if user.label in (VEHICLE, HEAVY)}
    queues: dict[str, np.ndarray] = {}  # by entry: number of queued vehicles in each frame
    for trip in trips:
        if trip.entry is None or trip.id not in vehicles:
            continue
        vehicle = vehicles[trip.id]
        is_queued = mask_inside(vehicle, site.area) & (vehicle.speeds < QUEUED_M_S)
        is_queued &= (vehicle.times >= trip.begin) & (vehicle.times <= trip.end)
        frames = np.searchsorted(seconds, vehicle.times[is_queued])
        queues.setdefault(trip.entry, np.zeros(len(seconds), np.int64))[frames] += 1
    return tuple(
        QueueCount(entry=entry, mean=float(lengths.mean()), longest=int(lengths.max()))
        for entry, lengths in sorted(queues.items())
    )


@dataclass(frozen=True)
class CountError:
    """Count of a movement, next to the true one.

    Attributes:
        label: name of the class.
        entry: name of the arm of entry.
        exit: name of the arm of exit.
        count: number of trips that were counted.
        true_count: number of true trips.
        speed_km_h: mean speed of the counted ones (km/h), NaN without any.
        true_speed_km_h: mean speed of the true ones.
        dwell_s: mean time in the area of the counted ones (s).
        true_dwell_s: mean time in the area of the true ones."""

    label: str
    entry: str
    exit: str
    count: int
    true_count: int
    speed_km_h: float
    true_speed_km_h: float
    dwell_s: float
    true_dwell_s: float


def compare_counts(counts: StreetCounts, truth: StreetCounts) -> list[CountError]:
    """Compare each movement that was counted or took place, sorted by class, entry and exit."""
    counted = {movement.key: movement for movement in counts.movements}
    true = {movement.key: movement for movement in truth.movements}
    nan = float("nan")
    no_trips = MovementCount(label="", entry="", exit="", count=0, speed_km_h=nan, dwell_s=nan)
    errors = []
    for key in sorted(counted.keys() | true.keys(), key=_order_of_movement):
        estimate = counted.get(key, no_trips)
        actual = true.get(key, no_trips)
        error = CountError(
            label=key.label,
            entry=key.entry,
            exit=key.exit,
            count=estimate.count,
            true_count=actual.count,
            speed_km_h=estimate.speed_km_h,
            true_speed_km_h=actual.speed_km_h,
            dwell_s=estimate.dwell_s,
            true_dwell_s=actual.dwell_s,
        )
        errors.append(error)
    return errors


class TripMatches(NamedTuple):
    """Numbers of trips of some classes that were counted as they were.

    Attributes:
        right: number of counted trips with a true one of the same movement at the same time.
        counted: number of counted trips.
        true: number of true trips."""

    right: int
    counted: int
    true: int

    @property
    def found_share(self) -> float:
        """Share of the true trips that are counted, NaN without any."""
        return self.right / self.true if self.true else float("nan")

    @property
    def right_share(self) -> float:
        """Share of the counted trips that are true, NaN without any."""
        return self.right / self.counted if self.counted else float("nan")


def match_trips(counts: StreetCounts, truth: StreetCounts, *labels: str) -> TripMatches:
    """Match whole trips of some classes (names) with true ones, by entry and exit.

    Their begins and their ends are at most `MAX_TRIP_OFFSET_S` apart, and each has at most one
    partner."""
    pairs = pair_trips(counts, truth, *labels)
    counted = sum(_is_counted(trip, labels) for trip in counts.trips)
    true = sum(_is_counted(trip, labels) for trip in truth.trips)
    return TripMatches(len(pairs), counted, true)


class TripPair(NamedTuple):
    """Trip that was counted, and the true one that it matches."""

    counted: Trip
    true: Trip


def pair_trips(counts: StreetCounts, truth: StreetCounts, *labels: str) -> list[TripPair]:
    """Pair whole trips of some classes (names) with true ones of the same entry and exit.

    Their begins and their ends are at most `MAX_TRIP_OFFSET_S` apart, and each has at most one
    partner. As many trips as possible have one; among such pairings, the offsets are smallest in
    all."""
    from scipy.optimize import linear_sum_assignment

    counted = [trip for trip in counts.trips if _is_counted(trip, labels)]
    true = [trip for trip in truth.trips if _is_counted(trip, labels)]
    pairs = []
    for gates in sorted({(str(trip.entry), str(trip.exit)) for trip in counted}):
        trips = _select_movement(counted, gates)
        true_trips = _select_movement(true, gates)
        offsets = np.abs(_list_spans(trips)[:, None] - _list_spans(true_trips)).max(axis=2)
        is_pair = offsets <= MAX_TRIP_OFFSET_S
        # 1000 less for a pair, so that more pairs cost less than any with smaller offsets
        rows, columns = linear_sum_assignment(np.where(is_pair, offsets - 1e3, 0.0))
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            if is_pair[row, column]:
                pairs.append(TripPair(trips[row], true_trips[column]))
    return pairs


def _select_movement(trips: Sequence[Trip], gates: tuple[str, str]) -> list[Trip]:
    """Trips of one movement. gates: names of entry and exit."""
    return [trip for trip in trips if (trip.entry, trip.exit) == gates]


def _list_spans(trips: Sequence[Trip]) -> Float64[np.ndarray, "n 2"]:
    """Begin and end (s) of each trip."""
    spans = [[trip.begin, trip.end] for trip in trips]
    return np.array(spans, np.float64).reshape(-1, 2)


def _order_of_movement(key: MovementKey) -> tuple[int, str, str]:
    """Key that sorts movements by class, in the order of `LABELS`, then by entry and exit."""
    return LABELS.index(key.label), key.entry, key.exit


def _is_counted(trip: Trip, labels: Sequence[str]) -> bool:
    """True for a whole trip (entry and exit known) of one of some classes (names)."""
    return trip.is_whole and LABELS[trip.label] in labels


def _mean(values: Sequence[float]) -> float:
    """Mean of the values that are finite, NaN without any."""
    finite = [value for value in values if np.isfinite(value)]
    return float(np.mean(finite)) if finite else float("nan")
