"""Intervals of shares and quantiles of independent objects."""

import math
from collections.abc import Sequence
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


def quantile_interval(
    values: Sequence[float], share: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Lower and upper end of the interval of a quantile, by order statistics.

    The number of values below the quantile is binomial, whatever their distribution (Conover 1999,
    section 3.2). An end that too few values leave open is 0 or infinite.

    Args:
        values: Independent values from 0 up, perhaps infinite.
        share: Share of the values below the quantile, such as 0.5 for the median.
        confidence: Level of the interval.

    >>> quantile_interval([1, 2, 3, 4, 5, 6, 7, 8], 0.5)
    (1.0, 8.0)
    >>> quantile_interval([1, 2, 3], 0.5)
    (0.0, inf)
    """
    from scipy.stats import quantile_test

    if not values:
        return 0.0, math.inf
    test = quantile_test(values, p=share)
    low, high = test.confidence_interval(confidence)
    return 0.0 if math.isnan(low) else float(low), math.inf if math.isnan(high) else float(high)
