"""Changes that raise the AP most, chosen among the poses of the stock and turned until nothing
helps."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from placement_env.live.changes import VariantChange, remove_sensor
from placement_env.live.figures import LiveAnswer, Meter
from placement_env.live.variant import TILT_SPAN_RAD, LiveSensor, Variant, Yard, name_on_pole
from placement_env.live.views import SensorViews

MIN_HELPFUL_GAIN_AP = 1e-4  # a change that gains less AP does not help
# steps (heading, tilt) in rad by which a suggested sensor is turned while that helps
TURNS_RAD = ((0.2, 0.0), (-0.2, 0.0), (0.0, 0.09), (0.0, -0.09))


@dataclass(frozen=True)
class Suggestion:
    """Change that raises the AP.

    Attributes:
        kind: "add", "move" or "remove".
        sensor: Sensor in its pose after the change, or the one to remove.
        answer: Figures of the variant after the change.
        considered: Number of poses of the stock that were compared, 0 to remove a sensor.
    """

    kind: str
    sensor: LiveSensor
    answer: LiveAnswer
    considered: int


class Suggester:
    """Suggest changes of a variant that raise its AP.

    yard: site and stock of poses; meter: scores sensors whose views are known; views: views of
    sensors and of the stock's poses; estimate: function that returns the figures of a variant."""

    def __init__(
        self,
        yard: Yard,
        meter: Meter,
        views: SensorViews,
        estimate: Callable[[Variant], LiveAnswer],
    ) -> None:
        """Suggest changes with the sensors and poses that a site offers."""
        self._yard = yard  # site and stock of poses
        self._meter = meter  # scores sensors whose views are known
        self._views = views
        self._estimate = estimate  # returns the figures of a variant

    def suggest(
        self, variant: Variant, kind: str, name: str | None, *, count: int, patience: float
    ) -> tuple[Suggestion, ...]:
        """Return up to `count` changes of a kind, the greatest AP first.

        kind: "add", "move" or "remove"; name: sensor to move, None for other kinds; patience: time
        (s) to make views from poles that have none yet, extended until a pose fits. Raises
        ValueError for another kind, and an unknown or locked sensor to move."""
        if kind == "remove":
            suggestions = self._suggest_removals(variant)[:count]
        elif kind == "add":
            suggestions = self._suggest_poses(
                base=variant, carried=None, count=count, patience=patience
            )
        elif kind == "move" and name is not None:
            suggestions = self._suggest_poses(
                base=variant.without_sensor(name),
                carried=variant.find_unlocked(name),
                count=count,
                patience=patience,
            )
        else:
            raise ValueError(
                f"kind must be add, remove, or move with the name of a sensor, got {kind!r} and "
                f"{name!r}"
            )
        return tuple(suggestions)

    def _suggest_removals(self, variant: Variant) -> list[Suggestion]:
        """Removal of each sensor that is not locked, the greatest remaining AP first."""
        suggestions = []
        for sensor in variant.sensors:
            if not sensor.locked:
                answer = self._estimate(variant.without_sensor(sensor.name))
                suggestions.append(Suggestion("remove", sensor, answer, considered=0))
        return sorted(suggestions, key=_negative_ap)

    def _suggest_poses(
        self, base: Variant, carried: LiveSensor | None, count: int, patience: float
    ) -> list[Suggestion]:
        """Best poses for one more sensor, on different poles, the greatest AP first.

        base: variant without this sensor; carried: sensor that is moved, None for a new one; count:
        greatest number of poses; patience: time (s) to make views, extended until a pose fits."""
        kind = "add" if carried is None else "move"
        view = self._views.see(base)
        stock = self._yard.stock
        has_room = [self._yard.has_room(base, mount.name) for mount in stock.mounts]
        is_allowed = [not base.keeps_out(mount) for mount in stock.mounts]
        is_free = np.logical_and(has_room, is_allowed)  # by mount of the stock
        ranked_poses = list[int]()  # indices in the stock, the best first
        views_are_missing = True
        while views_are_missing and not ranked_poses:
            views_are_missing = self._views.stock.view_free_poles(patience, is_free)
            ranked_poses = self._views.stock.rank(
                view.candidates, view.seen, view.is_working, self._meter.objective
            )
        suggestions: list[Suggestion] = []
        used_mounts = set[int]()
        for candidate in ranked_poses:
            mount = int(stock.mount[candidate])
            if mount in used_mounts or not is_free[mount]:
                continue
            used_mounts.add(mount)
            sensor = self._sensor_in_pose(base, candidate, carried)
            suggestions.append(self.improve(kind, base, sensor))
            if len(suggestions) == count:
                break
        return sorted(suggestions, key=_negative_ap)

    def _sensor_in_pose(
        self, base: Variant, candidate: int, carried: LiveSensor | None
    ) -> LiveSensor:
        """Sensor in the pose of a candidate of the stock.

        base: variant that it joins, for a free name; candidate: index in the stock; carried: sensor
        whose name and failure it keeps, None for a new one."""
        (sensor,) = self._yard.place([self._yard.stock.sensors[candidate]]).sensors
        if carried is not None:
            return replace(sensor, name=carried.name, failed=carried.failed)
        return replace(sensor, name=name_on_pole(base, sensor.mount))

    def improve(self, kind: str, base: Variant, sensor: LiveSensor) -> Suggestion:
        """Suggestion of one more sensor, turned and tilted while that helps.

        A turn helps if AP rises by more than `MIN_HELPFUL_GAIN_AP` and no problem is added. kind:
        "add" or "move", for the suggestion; base: variant without the sensor."""

        def measure_candidate(candidate: LiveSensor) -> tuple[float, int]:
            """AP of the base with this sensor, and number of problems of building all of them."""
            view = self._views.see(replace(base, sensors=(*base.sensors, candidate)))
            return self._meter.measure_ap(view.candidates, view.seen, view.is_working)

        min_tilt, max_tilt = TILT_SPAN_RAD
        # a turn that helps is kept, and all turns are tried again from there
        ap, problems = measure_candidate(sensor)
        has_improved = True
        while has_improved:
            has_improved = False
            for turn, tilt in TURNS_RAD:
                turned_sensor = replace(
                    sensor, heading=sensor.heading + turn, tilt=sensor.tilt + tilt
                )
                if not min_tilt <= turned_sensor.tilt <= max_tilt:
                    continue
                turned_ap, turned_problems = measure_candidate(turned_sensor)
                if turned_ap > ap + MIN_HELPFUL_GAIN_AP and turned_problems <= problems:
                    sensor = turned_sensor
                    ap = turned_ap
                    problems = turned_problems
                    has_improved = True
        answer = self._estimate(replace(base, sensors=(*base.sensors, sensor)))
        return Suggestion(kind, sensor, answer, considered=self._views.stock.known)


def apply_suggestion(yard: Yard, variant: Variant, suggestion: Suggestion) -> VariantChange:
    """Make a suggested change of a variant, which may have changed since.

    A sensor to add gets a free name. Raises ValueError if the suggestion no longer fits: its sensor
    is missing or locked, or its pole has no room."""
    sensor = suggestion.sensor
    if suggestion.kind == "remove":
        return remove_sensor(yard, variant, sensor.name)
    if suggestion.kind == "move":
        variant.find_unlocked(sensor.name)  # raises for an unknown or locked one
        yard.check_room(variant.without_sensor(sensor.name), sensor.mount)
        return VariantChange(variant.with_sensor(sensor), f"{sensor.name} moved")
    yard.check_room(variant, sensor.mount)
    new_sensor = replace(sensor, name=name_on_pole(variant, sensor.mount))
    new_variant = replace(variant, sensors=(*variant.sensors, new_sensor))
    return VariantChange(new_variant, f"{new_sensor.name} added")


def _negative_ap(suggestion: Suggestion) -> float:
    """Key by which the greatest AP is sorted first."""
    return -suggestion.answer.ap
