"""Times that names of clouds state: seconds, milli-, micro- or nanoseconds since 1970.

A name is a whole number, a number of seconds with decimals, or seconds and their fraction of 3, 6
or 9 digits with `_` between them (`1688625741_047447463`, as TUM Traffic has them). Only times
between 1973 and 2100 are believed, so that neither a frame's number nor a date such as
20230515101530 is taken for one.

Clouds of several sensors are one frame if they were measured together (`group_by_time`), whatever
their order and number. Sensors that run freely are apart by a lag that stays; each cloud belongs to
the one that it follows by it."""

import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime

import numpy as np

from toolkit.arrays import Float64, Int64

_WHOLE = re.compile(r"\d{9,19}")
_DECIMAL = re.compile(r"\d{9,10}\.\d+")
# seconds and their fraction, and maybe a sensor's name
_PARTED = re.compile(r"(\d{9,10})_(\d{3}|\d{6}|\d{9})(?:_[A-Za-z].*)?")
_TICKS_PER_SECOND = (1, 10**3, 10**6, 10**9)
EARLIEST_S = 1e8  # since 1970
LATEST_S = 4.1e9  # since 1970
MAX_MICROSECONDS = LATEST_S * 1e6  # since 1970; larger numbers have a smaller unit
# share of the fastest sensor's period by which two clouds of one frame differ from the sensors' lag
MAX_JITTER_SHARE = 0.5
MAX_PERIOD_S = 0.2  # for a sensor that always measures; slower recordings are samples
UNPAIRED = "frames that lack the cloud of some sensor at their time"
BY_ORDER = "frames put together by the order of their clouds, whose names are no times"

# clouds of one frame: name of each sensor and index of its cloud in its times
Group = dict[str, int]


def parse_epoch(name: str) -> float:
    """Parse a name as seconds since 1970, NaN for a name without a time.

    A time is a whole number of seconds, milli-, micro- or nanoseconds, seconds with decimals, or
    seconds and their fraction with `_` between them.

    >>> parse_epoch("1700000000004")
    1700000000.004
    >>> parse_epoch("1688625741_047447463")
    1688625741.0474474
    >>> parse_epoch("000017")
    nan
    """
    number = name
    if parts := _PARTED.fullmatch(name):  # seconds and their fraction
        number = f"{parts[1]}.{parts[2]}"
    if _DECIMAL.fullmatch(number):
        seconds = float(number)
        return seconds if EARLIEST_S <= seconds < LATEST_S else float("nan")
    if not _WHOLE.fullmatch(number):
        return float("nan")
    ticks = int(number)
    # the unit is the one that makes it a time from 1973 to 2100
    for rate in _TICKS_PER_SECOND:
        if EARLIEST_S * rate <= ticks < LATEST_S * rate:
            return ticks / rate
    return float("nan")


def parse_time(value: object, name: str) -> float | None:
    """Parse a time that a file states, as seconds; None if it is missing or empty.

    Numbers, also as text, are seconds, or smaller units since 1970 if they are that large; other
    text is a date and time by ISO 8601, UTC unless it has a zone. An infinite number counts as
    missing. name: what errors call the time. Raises ValueError for anything else."""
    if value is None or value == "":
        return None
    text = str(value).strip()
    try:
        seconds = float(text)
    except ValueError:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise ValueError(
                f"{name} must be seconds or a date and time of ISO 8601, got {text[:40]!r}"
            ) from None
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if not math.isfinite(seconds):
        return None
    if seconds < LATEST_S:
        return seconds
    # whole numbers as they are written, since a float has lost their last digits
    epoch = parse_epoch(text if text.isdigit() else f"{seconds:.0f}")
    if math.isnan(epoch):
        raise ValueError(f"{name} must be a time in s, ms, us or ns since 1970, got {text[:40]}")
    return epoch


def parse_microseconds(ticks: float) -> float:
    """Return the seconds of a time from a format that states it as a number of microseconds.

    Numbers too large for microseconds since 1970 count as nanoseconds.

    >>> parse_microseconds(500000), parse_microseconds(1700000000250000000)
    (0.5, 1700000000.25)"""
    epoch_s = None if ticks < MAX_MICROSECONDS else find_epoch(str(round(ticks)))
    return ticks * 1e-6 if epoch_s is None else epoch_s


def find_epoch(name: str) -> float | None:
    """Return the time of a name (s since 1970), None for a name without a time."""
    seconds = parse_epoch(name)
    return None if math.isnan(seconds) else seconds


def group_by_time(times_s: Mapping[str, Float64[np.ndarray, " n"]]) -> list[Group]:
    """Group the clouds of several sensors by time, in order of time.

    times_s: times (s, one clock) of each sensor's clouds, in any order. A group has at most one
    cloud of each sensor; a cloud without partners is a group of one.

    >>> stamps = {"north": np.array([0.0, 0.1, 0.3]), "south": np.array([0.104, 0.204, 0.304])}
    >>> group_by_time(stamps)
    [{'north': 0}, {'north': 1, 'south': 0}, {'south': 1}, {'north': 2, 'south': 2}]
    """
    order = {
        sensor: np.argsort(times, kind="stable") for sensor, times in times_s.items() if len(times)
    }
    if not order:
        return []
    periods = {sensor: _find_period(times_s[sensor][rows]) for sensor, rows in order.items()}
    # Sensors are matched one after the other with the groups so far, the fastest sensor's first.
    reference = min(order, key=lambda sensor: periods[sensor])
    period = periods[reference]
    groups: list[Group] = [{reference: int(row)} for row in order[reference]]
    centres = times_s[reference][order[reference]]
    for sensor, rows in order.items():
        if sensor == reference:
            continue
        times = times_s[sensor][rows]
        partners = _find_partners(times, centres, period)
        for row, partner in zip(rows.tolist(), partners.tolist(), strict=True):
            if partner >= 0:
                groups[partner][sensor] = row
        unpaired_rows = rows[partners < 0]
        centres = np.concatenate([centres, times_s[sensor][unpaired_rows]])
        groups += [{sensor: row} for row in unpaired_rows.tolist()]
        in_order = np.argsort(centres, kind="stable")
        centres = centres[in_order]
        groups = [groups[index] for index in in_order]
    return [_sort_group(group, list(times_s)) for group in groups]


def _sort_group(group: Group, sensors: list[str]) -> Group:
    """Return the group with its sensors in the order of the list."""
    return {sensor: group[sensor] for sensor in sensors if sensor in group}


def _find_period(times: Float64[np.ndarray, " n"]) -> float:
    """Median time (s) between successive clouds of a sensor, at most `MAX_PERIOD_S`.

    times: s, rising. The result is `MAX_PERIOD_S` for fewer than two different times."""
    steps = np.diff(times)
    steps = steps[steps > 0]
    return min(float(np.median(steps)), MAX_PERIOD_S) if len(steps) else MAX_PERIOD_S


def _find_partners(
    times: Float64[np.ndarray, " n"], centres: Float64[np.ndarray, " m"], period: float
) -> Int64[np.ndarray, " n"]:
    """Index of the group that each cloud of a sensor belongs to, -1 for no group.

    A group gets at most one cloud, the closest after the sensor's usual lag is taken off. times:
    times of the clouds (s, rising); centres: times of the groups (s, rising); period: time between
    two clouds of the fastest sensor (s)."""
    differences = times - centres[_find_nearest(times, centres)]
    lag = _find_lag(differences, period)
    nearest_groups = _find_nearest(times - lag, centres)
    distances = np.abs(times - lag - centres[nearest_groups])
    groups = np.where(distances < MAX_JITTER_SHARE * period, nearest_groups, -1)
    closest_first = np.argsort(distances, kind="stable")
    groups_in_use: set[int] = set()
    for cloud in closest_first.tolist():
        group = int(groups[cloud])
        if group in groups_in_use:
            groups[cloud] = -1
        groups_in_use.add(group)
    return groups


def _find_nearest(
    times: Float64[np.ndarray, " n"], centres: Float64[np.ndarray, " m"]
) -> Int64[np.ndarray, " n"]:
    """Index of the centre nearest to each time; the earlier one if two are equally near.

    times: s; centres: times to choose from (s, rising), one at least."""
    if len(centres) == 1:
        return np.zeros(len(times), np.int64)
    # the two centres around each time, or the first or last two
    after = np.clip(np.searchsorted(centres, times), 1, len(centres) - 1)
    before = after - 1
    return np.where(times - centres[before] <= centres[after] - times, before, after)


def _find_lag(differences: Float64[np.ndarray, " n"], period: float) -> float:
    """Lag (s) that a sensor's clouds usually have, at most half a period either way.

    It is a circular mean, as for angles, with a period (s) as the full turn: a cloud one period
    later fits as well. differences: from the time of the nearest group of clouds to each cloud's
    time (s); longer ones than a period do not count. 0 if there are no others."""
    lags = differences[np.abs(differences) <= period]
    if not len(lags):
        return 0.0
    points_on_circle = np.exp(2j * np.pi * lags / period)
    return float(np.angle(points_on_circle.mean()) * period / (2 * np.pi))
