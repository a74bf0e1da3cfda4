"""Contents of a plan on continuous traffic: how the chosen set follows and counts road users.

Road users count that move and are in the detection area; each counts once, however many frames it
is in, so intervals are over road users. Frames of one road user are not independent."""

import math
from dataclasses import dataclass

from toolkit.counting.counts import CountError


@dataclass(frozen=True)
class RoadUserFigure:
    """A figure over road users.

    value: NaN if unknown, infinite for a time that does not come; low, high: ends of its 95 %
    interval, NaN if unknown, infinite for an open end."""

    value: float
    low: float = math.nan
    high: float = math.nan


@dataclass(frozen=True)
class FollowedClass:
    """Road users of one class, as live tracks follow them.

    Objects and tracks match as for MOTA (`toolkit.tracking.scores`).

    Attributes:
        label: Name of the class.
        road_users: Number of road users.
        mostly_tracked: Share of road users that are matched in more than 80 % of their frames.
        entering: Number of road users that come in after the first frame.
        first_detection_s: Median time from coming in to the first match (s).
        first_detection_95_s: Time within which 95 % have their first match (s).
        never_detected: Share of entering road users without any match.
        speed_error_km_h: Mean error of speed while a road user is matched (km/h)."""

    label: str
    road_users: int
    mostly_tracked: RoadUserFigure
    entering: int
    first_detection_s: RoadUserFigure
    first_detection_95_s: RoadUserFigure
    never_detected: RoadUserFigure
    speed_error_km_h: RoadUserFigure


@dataclass(frozen=True)
class CountedGroup:
    """Trips of a group of classes, counted as by `coview count`.

    A trip counts if it has an entry and an exit within the recording.

    Attributes:
        group: "vehicles", "cyclists" or "pedestrians".
        count: Number of counted trips.
        true_count: Number of true trips.
        error: Counted minus true trips.
        found: Share of the true trips that are counted with their entry and exit.
        right: Share of the counted trips that are true.
        speed_error_km_h: Counted minus true mean speed of a trip, on average (km/h)."""

    group: str
    count: int
    true_count: int
    error: int
    found: RoadUserFigure
    right: RoadUserFigure
    speed_error_km_h: RoadUserFigure


@dataclass(frozen=True)
class MotionFigures:
    """The chosen set on continuous traffic that no search saw.

    Attributes:
        refusal: Sentence that explains why there are no figures, "" if there are.
        seed: Seed of the traffic.
        frames: Number of frames.
        interval_s: Time between frames (s).
        traffic_sha256: Digest of the traffic, "" without any.
        errors: Name of the error profile of the sensors, which are mounted once.
        classes: Results of each class that the detector knows and that was there.
        counts: Counts of each group with such a class.
        movements: Counts of each class by entry and exit."""

    refusal: str
    seed: int
    frames: int
    interval_s: float
    traffic_sha256: str
    errors: str
    classes: tuple[FollowedClass, ...] = ()
    counts: tuple[CountedGroup, ...] = ()
    movements: tuple[CountError, ...] = ()

    @property
    def seconds(self) -> float:
        """Time from the first to the last frame (s)."""
        return self.interval_s * max(0, self.frames - 1)
