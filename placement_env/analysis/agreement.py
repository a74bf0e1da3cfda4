"""Agreement of the stages of a search or plan on one set of sensors: prediction, race, comparison
and judgement.

Each stage scores on traffic of its own, so figures differ by chance. Where they exclude each other,
one stage is wrong, and no set is recommended."""

from collections.abc import Sequence
from typing import NamedTuple

from placement_env.analysis.intervals import Interval, share_interval
from toolkit.display import format_share
from toolkit.traffic.spawner import LIFE

CERTAIN_SHARE = 0.9999  # level of the intervals by which stages check each other
CERTAIN_ERRORS = 6.0  # standard errors that a prediction is never off by


class StageFigure(NamedTuple):
    """AP of one set at one stage of planning. spread: standard error beyond that of its objects, 0
    for a detector."""

    stage: str
    ap: float
    objects: int
    frames: int
    spread: float = 0.0

    @property
    def ends(self) -> Interval:
        """Ends that hold practically always (`CERTAIN_SHARE`): Wilson's, widened by the spread."""
        share = min(max(self.ap, 0.0), 1.0)
        low, high = share_interval(share, max(self.objects / LIFE, 1.0), CERTAIN_SHARE)
        margin = CERTAIN_ERRORS * self.spread
        return Interval(max(0.0, low - margin), min(1.0, high + margin))


def check_agreement(sensors: Sequence[str], one: StageFigure, other: StageFigure) -> None:
    """Raise ValueError where two stages give one set figures that exclude each other."""
    first = one.ends
    second = other.ends
    if first.low <= second.high and second.low <= first.high:
        return
    said = [
        (
            f"AP {format_share(each.ap, each.objects)} {each.stage} ({each.objects} to find in "
            f"{each.frames} frames)"
        )
        for each in (one, other)
    ]
    raise ValueError(
        f"the stages contradict each other on the set {', '.join(sensors)}: {said[0]}, but "
        f"{said[1]}. No chance explains that, so no set is recommended: check that the detector "
        "gives the same points the same boxes"
    )
