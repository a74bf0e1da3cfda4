"""`RoadClass`: usual values of a class of road in OpenStreetMap."""

from typing import NamedTuple


class RoadClass(NamedTuple):
    """Usual values of a class of road.

    Attributes:
        lanes: lanes each way.
        speed: speed limit (m/s).
        priority: SUMO's priority; the higher one goes first.
        has_footways: True if there are footways on both sides unless tags state otherwise."""

    lanes: int
    speed: float
    priority: int
    has_footways: bool
