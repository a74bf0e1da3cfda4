"""Clock of ETSI's messages (TimestampIts of TS 102 894-2): milliseconds since 2004 with leap
seconds."""

from toolkit.exchange.writer import nanoseconds

ITS_EPOCH_S = 1_072_915_200  # 2004-01-01 UTC, in seconds since 1970
LEAPS_S = (  # ends of the leap seconds since then: 2006, 2009, July 2012, July 2015, 2017
    1_136_073_600,
    1_230_768_000,
    1_341_100_800,
    1_435_708_800,
    1_483_228_800,
)


def count_its_ms(time_s: float) -> int:
    """Return the milliseconds that elapsed from 2004-01-01 UTC to a time (s since 1970).

    Leap seconds count: 2017 and later are 5 s ahead of UTC. A time before 2004 is of a clock that
    begins with its recording, such as a simulation's; it is counted from 2004. Raises ValueError
    for a time before 1970 or after 2262.

    >>> count_its_ms(1_167_609_600)  # 2007, the example of the standard
    94694401000
    """
    time_ms = round(nanoseconds(time_s) / 1e6)
    if time_ms < 1000 * ITS_EPOCH_S:
        return time_ms
    leaps = sum(time_ms >= 1000 * leap_s for leap_s in LEAPS_S)
    return time_ms + 1000 * (leaps - ITS_EPOCH_S)
