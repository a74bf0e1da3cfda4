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
from placement_env.live.variant import TILT_SPAN_RAD, Variant, Yard
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
        seen: View of the sensors on the road users that count, also of failed ones.
        is_working: False for sensors that have failed.
        coarse: True if a view is interpolated between heights.
    """

    candidates: Candidates
    seen: Visibility
    is_working: Bool[np.ndarray, " candidates"]
    coarse: bool


class SensorViews:
    """Views of sensors in one traffic, kept in memory by model and pose.

    A copy has the same views, and goes on without the original. meter: gives the traffic.

    Attributes:
        stock: Views of the poses of the stock.
    """

    def __init__(self, yard: Yard, meter: Meter) -> None:
        """Keep views of sensors in the traffic of a meter, none at first.

        yard: site, with the sensors and poses to choose from; meter: computes figures from views.
        """
        self._yard = yard
        self._meter = meter
        self._preparation = meter.preparation  # its `live` holds panoramas, None without them
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
        """View of sensors, and True if one is interpolated between heights.

        Views are cached by model and pose; an interpolated one is replaced as soon as there is a
        panorama at its very height."""
        panoramas = self._preparation.live
        is_coarse = False
        rows: list[SensorRow] = []
        for k, sensor in enumerate(candidates.sensors):
            key = (sensor.model, sensor.pose.tobytes())
            row, is_exact = self._rows.get(key, (None, False))
            if row is None or (not is_exact and panoramas is not None and panoramas.knows(sensor)):
                # asked before the look, as another thread may add the panorama meanwhile
                is_exact = panoramas is None or panoramas.knows(sensor)
                row = self._look_at(candidates.select([k]))
                while len(self._rows) >= MAX_LIVE_VIEWS:
                    oldest_key = next(iter(self._rows))
                    self._rows.pop(oldest_key, None)
                self._rows[key] = row, is_exact
            rows.append(row)
            is_coarse |= not is_exact
        return join_views(self._meter.unseen, rows), is_coarse

    def _look_at(self, candidate: Candidates) -> SensorRow:
        """View of a single candidate from the nearest panoramas, or from rays without panoramas."""
        panoramas = self._preparation.live
        if panoramas is None:
            labels = self._preparation.setting.counted.labels
            traffic = self._preparation.traffic
            seen = see(traffic, candidate, labels=labels, rendering="full")
        else:
            seen = panoramas.see(candidate, reach="nearest")
        # row 0 is the only candidate
        return seen.points[0], seen.distance[0], seen.sent[0], seen.far[0]

    def refine(self, variant: Variant) -> bool:
        """Make one missing panorama or table of rays; False if none is missing.

        The sensors of the variant come first, then tables of rays of their models, other heights
        of their poles (the nearest first), and at last the stock."""
        panoramas = self._preparation.live
        if panoramas is None:
            return False
        candidates = self._yard.candidates(variant)

        def make_one(sensors: Iterable[tuple[int, Sensor]]) -> bool:
            """Make the first missing panorama for sensors; False if none is missing.

            sensors: pairs of the index of a candidate and its sensor."""
            # `any` ends at the first one that was missing
            return any(make_view(panoramas, candidates, k, sensor) for k, sensor in sensors)

        if make_one(enumerate(candidates.sensors)):
            return True
        min_tilt, max_tilt = TILT_SPAN_RAD
        models = dict.fromkeys(sensor.model for sensor in candidates.sensors)  # each once, in order
        if any(
            make_table_ahead(model, lowest=min_tilt, steepest=max_tilt, around=USUAL_TILT_RAD)
            for model in models
        ):
            return True
        # if memory is full, these would push each other out for ever
        if not panoramas.full and make_one(_raise_sensors(candidates)):
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
        self, list_candidates: Callable[[], list[Candidates]], show: Callable[[Preparation], None]
    ) -> None:
        """Make one missing view of all frames, or show their figures if no view is missing.

        list_candidates: function that returns the sensors whose views are needed, by variant; show:
        function that takes the preparation of all frames, shows its figures and calls `end`."""
        with self.fetching:
            preparation = self.preparation
            if preparation is None:
                return
            panoramas = preparation.live
            if panoramas is not None:
                for candidates in list_candidates():
                    for k, sensor in enumerate(candidates.sensors):
                        if make_view(panoramas, candidates, k, sensor):
                            return
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


def make_view(panoramas: TrafficView, candidates: Candidates, k: int, sensor: Sensor) -> bool:
    """Make the panorama for a sensor on the mount of candidate k; False if it is known."""
    if panoramas.knows(sensor):
        return False
    # keeps the panorama
    panoramas.see(replace(candidates.select([k]), sensors=(sensor,)), reach="own")
    return True


def _raise_sensors(candidates: Candidates) -> Iterator[tuple[int, Sensor]]:
    """Yield the sensors at the other heights of their poles, the nearest heights first.

    Each comes after the index of its candidate. Heading and tilt are 0: panoramas hold for any
    aim."""
    rises: list[tuple[float, int]] = []  # way up (m) from the present height, and candidate
    for k, sensor in enumerate(candidates.sensors):
        mount = candidates.mounts[candidates.mount[k]]
        rise_to_foot = float(mount.position[2] - sensor.position[2])  # negative
        rises += [(rise_to_foot + height, k) for height in list_heights(mount)]
    rises.sort(key=lambda pair: abs(pair[0]))  # in the order of the candidates among equals
    for rise_m, k in rises:
        sensor = candidates.sensors[k]
        position = sensor.position + np.array([0.0, 0.0, rise_m])
        yield k, aim_sensor(sensor, position, heading=0.0, tilt=0.0)
