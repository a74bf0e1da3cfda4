"""Counts of groups of classes, such as all vehicles, next to the true ones."""

from dataclasses import dataclass

from toolkit.counting.counts import GROUPS, StreetCounts, match_trips
from toolkit.share_intervals import wilson_interval


@dataclass(frozen=True)
class CountedTotal:
    """Whole trips of a group of classes, as counted and as they were.

    Attributes:
        group: name of the group, a key of `GROUPS`.
        count: number of counted trips.
        speed_km_h: their mean speed while they move (km/h), NaN without trips.
        true_count: number of true trips.
        error: counted minus true trips.
        true_speed_km_h: mean speed of the true trips, NaN without any.
        found_share: share of the true trips that are counted with their entry and exit, NaN without
            true trips.
        found_interval: its 95 % interval over trips.
        right_share: share of the counted trips that are true, NaN without counted trips.
        right_interval: its 95 % interval over trips."""

    group: str
    count: int
    speed_km_h: float
    true_count: int
    error: int
    true_speed_km_h: float
    found_share: float
    found_interval: tuple[float, float]
    right_share: float
    right_interval: tuple[float, float]


def compare_totals(counts: StreetCounts, truth: StreetCounts) -> list[CountedTotal]:
    """Compare the counts of each group of `GROUPS` with the true ones."""
    totals = []
    for group, labels in GROUPS.items():
        matches = match_trips(counts, truth, *labels)
        count = counts.total(*labels)
        true_count = truth.total(*labels)
        total = CountedTotal(
            group=group,
            count=count,
            speed_km_h=counts.mean_speed(*labels),
            true_count=true_count,
            error=count - true_count,
            true_speed_km_h=truth.mean_speed(*labels),
            found_share=matches.found_share,
            found_interval=wilson_interval(matches.found_share, matches.true),
            right_share=matches.right_share,
            right_interval=wilson_interval(matches.right_share, matches.counted),
        )
        totals.append(total)
    return totals
