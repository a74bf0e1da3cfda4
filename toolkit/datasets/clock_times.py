"""Times that names of clouds state: seconds, milli-, micro- or nanoseconds since 1970.

A name is a whole number, a number of seconds with decimals, or seconds and their fraction of 3, 6 or 9 digits with `_`
between them (`1688625741_047447463`, as TUM Traffic has them). Only times between 1973 and 2100 are believed, so that
neither a frame's number nor a date such as 20230515101530 is taken for one."""

import math
import re
from datetime import UTC, datetime

_WHOLE = re.compile(r"\d{9,19}")
_DECIMAL = re.compile(r"\d{9,10}\.\d+")
_PARTED = re.compile(r"(\d{9,10})_(\d{3}|\d{6}|\d{9})(?:_[A-Za-z].*)?")
_TICKS_PER_SECOND = (1, 10**3, 10**6, 10**9)
EARLIEST_S, LATEST_S = 1e8, 4.1e9  # since 1970


def parse_epoch(name: str) -> float:
    """Parse a name as seconds since 1970, NaN for a name without a time.

    >>> parse_epoch("1700000000004")
    1700000000.004
    >>> parse_epoch("1688625741_047447463")
    1688625741.0474474
    >>> parse_epoch("000017")
    nan
    """
    if parted := _PARTED.fullmatch(name):
        name = f"{parted[1]}.{parted[2]}"
    if _DECIMAL.fullmatch(name):
        seconds = float(name)
        return seconds if EARLIEST_S <= seconds < LATEST_S else float("nan")
    if not _WHOLE.fullmatch(name):
        return float("nan")
    ticks = int(name)
    for rate in _TICKS_PER_SECOND:
        if EARLIEST_S * rate <= ticks < LATEST_S * rate:
            return ticks / rate
    return float("nan")


def parse_time(value: object, name: str) -> float | None:
    """Parse a time that a file states, as seconds; None if it is missing or empty.

    Numbers, also as text, are seconds, or smaller units since 1970 if they are that large; other text is a date and
    time by ISO 8601, UTC unless it says otherwise. Raises ValueError for anything else."""
    if value is None or value == "":
        return None
    text = str(value).strip()
    try:
        seconds = float(text)
    except ValueError:
        try:
            moment = datetime.fromisoformat(text)
        except ValueError:
            raise ValueError(f"{name} must be seconds or a date and time of ISO 8601, got {text[:40]!r}") from None
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if not math.isfinite(seconds):
        return None
    if seconds < LATEST_S:
        return seconds
    epoch = parse_epoch(text if text.isdigit() else f"{seconds:.0f}")
    if math.isnan(epoch):
        raise ValueError(f"{name} must be a time in s, ms, us or ns since 1970, got {text[:40]}")
    return epoch


def find_epoch(name: str) -> float | None:
    """Return the time of a name (s since 1970), None for a name without a time."""
    seconds = parse_epoch(name)
    return None if math.isnan(seconds) else seconds
