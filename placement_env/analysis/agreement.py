"""Agreement of the stages of a search or plan on one set of sensors.

Stages are prediction, race, comparison and judgement. Each scores on separate traffic, so figures
differ by chance. If they exclude each other, one stage is wrong, and no set is recommended.
"""

from collections.abc import Sequence
from typing import NamedTuple

from placement_env.analysis.intervals import Interval, share_interval
from toolkit.display import format_share
from toolkit.traffic.spawner import LIFE

CERTAIN_SHARE = 0.9999  # level of the intervals by which stages check each other
CERTAIN_ERRORS = 6.0  # standard errors beyond any error of a prediction


class StageFigure(NamedTuple):
    """AP of one set at one stage of planning.

    Attributes:
        stage: Name of the stage.
        ap: Average precision.
        objects: Number of objects.
        frames: Number of frames.
        spread: Standard error in addition to sampling of objects, 0 for a detector.
    """

    stage: str
    ap: float
    objects: int
    frames: int
    spread: float = 0.0

    @property
    def certain_interval(self) -> Interval:
        """Interval of the AP that holds practically always (`CERTAIN_SHARE`).

        It is Wilson's for independent objects that live `LIFE` frames each, widened by the
        spread.
        """
        share = min(max(self.ap, 0.0), 1.0)  # a predicted AP may be a little beyond
        independent_objects = max(self.objects / LIFE, 1.0)
        low, high = share_interval(share, independent_objects, CERTAIN_SHARE)
        margin = CERTAIN_ERRORS * self.spread
        return Interval(low=max(0.0, low - margin), high=min(1.0, high + margin))


def check_agreement(sensors: Sequence[str], earlier: StageFigure, later: StageFigure) -> None:
    """Raise ValueError if two stages give one set figures that exclude each other.

    Args:
        sensors: Names of the sensors of the set, for the error.
        earlier: Figure of the earlier stage.
        later: Figure of the later stage."""
    earlier_interval = earlier.certain_interval
    later_interval = later.certain_interval
    if earlier_interval.low <= later_interval.high and later_interval.low <= earlier_interval.high:
        return
    raise ValueError(
        f"the stages contradict each other on the set {', '.join(sensors)}: "
        f"{_describe_stage(earlier)}, but {_describe_stage(later)}. No chance explains that, so no "
        "set is recommended: check that the detector gives the same points the same boxes"
    )


def _describe_stage(figure: StageFigure) -> str:
    """Words for the AP of a stage and what it rests on."""
    ap = format_share(figure.ap, figure.objects)
    return f"AP {ap} {figure.stage} ({figure.objects} to find in {figure.frames} frames)"
