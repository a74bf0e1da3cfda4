"""Intervals of shares of independent objects."""

import math
from statistics import NormalDist


def wilson_interval(share: float, count: float, confidence: float = 0.95) -> tuple[float, float]:
    """Lower and upper end of Wilson's score interval of a share (JASA 22, 1927); 0 to 1 of none.

    Args:
        share: Observed share, 0 to 1; any value without objects.
        count: Number of objects, not always whole.
        confidence: Level of the interval.

    >>> [round(bound, 3) for bound in wilson_interval(0.9, 10)]
    [0.596, 0.982]
    """
    if not count:
        return 0.0, 1.0
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    middle = share + z**2 / (2 * count)
    spread = z * math.sqrt(share * (1 - share) / count + (z / (2 * count)) ** 2)
    scale = 1 + z**2 / count
    return max(0.0, (middle - spread) / scale), min(1.0, (middle + spread) / scale)
