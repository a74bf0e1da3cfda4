"""Times of a cloud's points in seconds, from a column of an unstated unit.

- A unit at the end of the name counts: `offset_ns`, `time_us`, `timestamp_ms`.
- Numbers since 1970 show their unit: seconds, milli-, micro- or nanoseconds.
- Other whole numbers are nanoseconds, as in Ouster, Livox and Argoverse, others seconds, as in
  Velodyne, Hesai and RoboSense.

A sweep takes a millisecond to ten seconds. If another unit would give that and this one does not,
the unit is not known, and no times are better than wrong ones."""

import re

import numpy as np

from toolkit.arrays import Float64, Shaped

COLUMN = re.compile(r"(?:offset|t|time|timestamp|time_stamp|offset_time)(?:_(s|ms|us|ns))?")
UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
EPOCH_S = (1e8, 4.1e9)  # 1973 to 2099
MIN_SWEEP_S = 1e-3
MAX_SWEEP_S = 10.0
MIN_SWEEP_POINTS = 100  # fewer may be a moment's


def is_time(name: str) -> bool:
    """True for a column that holds times of points."""
    return name != "offset" and COLUMN.fullmatch(name) is not None


def parse_point_times(
    name: str, times: Shaped[np.ndarray, " n"]
) -> Float64[np.ndarray, " n"] | None:
    """Return seconds since the first point, None if the unit of the column is not known.

    >>> parse_point_times("t", np.array([0, 50_000_000], np.uint32))
    array([0.  , 0.05])
    >>> parse_point_times("t", np.arange(0, 100_000, 100)) is None  # microseconds?
    True
    """
    is_whole = times.dtype.kind in "iu"
    ticks = (
        times.astype(np.int64)
        if is_whole
        else np.nan_to_num(times.astype(np.float64), posinf=0.0, neginf=0.0)
    )
    if not len(ticks):
        return np.zeros(0)
    since = ticks - ticks.min()
    unit = _find_unit(name) or _epoch_unit(float(np.median(ticks)))
    if unit is not None:
        return since * unit
    unit = UNITS_S["ns" if is_whole else "s"]
    span = float(since.max())
    plausible = [
        candidate
        for candidate in UNITS_S.values()
        if MIN_SWEEP_S <= span * candidate <= MAX_SWEEP_S
    ]
    too_short = len(ticks) >= MIN_SWEEP_POINTS and bool(plausible) and unit not in plausible
    if too_short or span * unit > MAX_SWEEP_S:
        return None
    return since * unit


def _find_unit(name: str) -> float | None:
    """Seconds in the unit at the end of a column's name, such as 1e-9 for _ns; None without one."""
    parsed = COLUMN.fullmatch(name)
    return UNITS_S[parsed[1]] if parsed is not None and parsed[1] else None


def _epoch_unit(time: float) -> float | None:
    """Seconds in the unit in which a number is a time since 1970; None for no such unit."""
    return next(
        (unit for unit in UNITS_S.values() if EPOCH_S[0] <= time * unit <= EPOCH_S[1]), None
    )
