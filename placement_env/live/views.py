"""Views of the sensors that are moved by hand: in memory, missing, and in all frames while the
figures of few are shown."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from placement_env.candidates.candidates import Candidates, aim_sensor
from placement_env.fidelity.panorama import TrafficView, list_heights
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.ray_table import make_table_ahead
from placement_env.fidelity.seeing import see
from placement_env.fidelity.visibility import Visibility
from placement_env.live.figures import Meter
from placement_env.live.stock_views import StockViews, join_views
from placement_env.live.variant import TILT_SPAN, Variant, Yard
from toolkit.arrays import Bool
from toolkit.sensors.sensor import Sensor

MAX_PANORAMA_BYTES = 190_000_000  # all panoramas in memory
MAX_LIVE_VIEWS = 512  # views of one sensor in memory
USUAL_TILT_RAD = 0.3  # below the horizon, around which tables are made first
# fields of `Visibility` of one sensor: points and distance by object, sent and far by frame
SensorRow = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class VariantView(NamedTuple):
    """View of a variant.

    Attributes:
        candidates: Sensors of the variant, in its order.
        seen: View of these sensors on the road users that count, also of failed ones.
        is_working: False for sensors that have failed.
        coarse: True if a view is interpolated between heights.
    """

    candidates: Candidates
    seen: Visibility
    is_working: Bool[np.ndarray, " C"]
    coarse: bool


class SensorViews:
    """Views of sensors in one traffic, kept in memory by model and pose.

    A copy has the same views, and goes on without the original. meter: gives the traffic.

    Attributes:
        stock: Views of the poses of the stock.
    """

    def __init__(self, yard: Yard, meter: Meter) -> None:
        self._yard = yard
        self._meter = meter
        self._preparation = meter.preparation
        # view by model and pose, the oldest first, and True if it is from the sensor's exact height
        self._rows = dict[object, tuple[SensorRow, bool]]()
        self.stock = StockViews(self._preparation)
        if self._preparation.live is not None:
            self._preparation.live.limit(MAX_PANORAMA_BYTES)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_rows": self._rows.copy()}

    def see(self, variant: Variant) -> VariantView:
        """View of a variant's sensors, from memory or looked up now."""
        candidates = self._yard.candidates(variant)
        seen, coarse = self.look(candidates)
        is_working = np.array([not sensor.failed for sensor in variant.sensors], np.bool_)
        return VariantView(candidates, seen, is_working, coarse)

    def look(self, candidates: Candidates) -> tuple[Visibility, bool]:
        """View of sensors, and True if one is interpolated between heights."""
        live = self._preparation.live
        coarse = False
        rows: list[SensorRow] = []
        for k, sensor in enumerate(candidates.sensors):
            key = (sensor.model, sensor.pose.tobytes())
            row, fine = self._rows.get(key, (None, False))
            if row is None or (not fine and live is not None and live.knows(sensor)):
                # asked before, as another thread may refine
                fine = live is None or live.knows(sensor)
                row = self._look_at(candidates.select([k]))
                while len(self._rows) >= MAX_LIVE_VIEWS:
                    self._rows.pop(next(iter(self._rows)), None)
                self._rows[key] = row, fine
            rows.append(row)
            coarse |= not fine
        return join_views(self._meter.unseen, rows), coarse

    def _look_at(self, candidate: Candidates) -> SensorRow:
        # view of one candidate from the nearest panoramas, or from rays without panoramas
        live = self._preparation.live
        if live is None:
            labels = self._preparation.setting.counted.labels
            traffic = self._preparation.traffic
            seen = see(traffic, candidate, labels=labels, rendering="full")
        else:
            seen = live.see(candidate, reach="nearest")
        return seen.points[0], seen.distance[0], seen.sent[0], seen.far[0]

    def refine(self, variant: Variant) -> bool:
        """Make one missing panorama or table of rays; False if none is missing.

        The sensors of the variant come first, then tables of rays of their models, other heights
        of their poles (the nearest first), and at last the stock."""
        live = self._preparation.live
        if live is None:
            return False
        candidates = self._yard.candidates(variant)

        def make_one(sensors: Iterable[tuple[int, Sensor]]) -> bool:
            return any(make_view(live, candidates, k, sensor) for k, sensor in sensors)

        if make_one(enumerate(candidates.sensors)):
            return True
        models = dict.fromkeys(sensor.model for sensor in candidates.sensors)
        if any(make_table_ahead(model, *TILT_SPAN, USUAL_TILT_RAD) for model in models):
            return True
        # if memory is full, these would push each other out for ever
        if not live.full and make_one(_raise_sensors(candidates)):
            return True
        return self.stock.look_further()


class AllFrames:
    """All frames of traffic, whose views are made while figures of the first few are shown.

    A copy has a lock that is free.

    Attributes:
        preparation: Preparation of all frames, None once their figures are shown.
        fetching: Lock that is held while a view of all frames is made.
    """

    def __init__(self, preparation: Preparation | None) -> None:
        self.preparation = preparation
        self.fetching = Lock()

    def __getstate__(self) -> dict[str, Any]:
        return {"preparation": self.preparation}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.preparation = state["preparation"]
        self.fetching = Lock()

    @property
    def are_awaited(self) -> bool:
        """True while figures of fewer frames are shown."""
        return self.preparation is not None

    def fetch(
        self, candidates: Callable[[], list[Candidates]], show: Callable[[Preparation], None]
    ) -> None:
        """Make one missing view of all frames, or show their figures if no view is missing.

        candidates: function that lists the sensors whose views are needed; show: function that
        takes the preparation of all frames, shows its figures and calls `end`."""
        with self.fetching:
            preparation = self.preparation
            if preparation is None:
                return
            rows = (
                (shown, k, sensor)
                for shown in candidates()
                for k, sensor in enumerate(shown.sensors)
            )
            live = preparation.live
            if live is None or not any(make_view(live, *row) for row in rows):
                show(preparation)

    def end(self) -> None:
        """Await no more frames."""
        self.preparation = None


def hold_back(preparation: Preparation | None, hold: Callable[[], bool]) -> None:
    """Let the making of panoramas pause between frames while `hold()` is true.

    It goes on nevertheless if another thread needs rays. preparation: with the panoramas; None and
    one without panoramas change nothing."""
    if preparation is not None and preparation.live is not None:
        preparation.live.hold = hold


def make_view(live: TrafficView, candidates: Candidates, k: int, sensor: Sensor) -> bool:
    """Make the panorama for a sensor on the mount of candidate k; False if it is known."""
    if live.knows(sensor):
        return False
    live.see(replace(candidates.select([k]), sensors=(sensor,)), reach="own")
    return True


def _raise_sensors(candidates: Candidates) -> Iterator[tuple[int, Sensor]]:
    """Yield the sensors at the other heights of their poles, the nearest heights first.

    Each comes with the index of its candidate. Their aim is 0: panoramas hold for any aim."""
    rises: list[tuple[float, int]] = []
    for k, sensor in enumerate(candidates.sensors):
        mount = candidates.mounts[candidates.mount[k]]
        foot_below = float(mount.position[2] - sensor.position[2])
        rises += [(foot_below + height, k) for height in list_heights(mount)]
    rises.sort(key=lambda rise: abs(rise[0]))
    for up, k in rises:  # way up (m) from the present height
        sensor = candidates.sensors[k]
        yield k, aim_sensor(sensor, sensor.position + np.array([0.0, 0.0, up]), 0.0, 0.0)
