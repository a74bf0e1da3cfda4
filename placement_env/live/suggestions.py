"""Changes that raise the AP most, chosen among the poses of the stock and turned until nothing
helps."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from placement_env.live.changes import VariantChange, remove_sensor
from placement_env.live.figures import LiveAnswer, Meter
from placement_env.live.variant import TILT_SPAN, LiveSensor, Variant, Yard, name_on_pole
from placement_env.live.views import SensorViews

MIN_HELPFUL_GAIN_AP = 1e-4  # a change that gains less does not help
# rad of heading and tilt that a suggestion is turned by
TURNS_RAD = ((0.2, 0.0), (-0.2, 0.0), (0.0, 0.09), (0.0, -0.09))


@dataclass(frozen=True)
class Suggestion:
    """Change that raises the AP.

    Attributes:
        kind: add, move or remove.
        sensor: Sensor after the change, or the one to remove.
        answer: Figures after the change.
        considered: Number of poses of the stock that were compared.
    """

    kind: str
    sensor: LiveSensor
    answer: LiveAnswer
    considered: int


class Suggester:
    """Suggest changes of a variant. estimate: figures of any variant."""

    def __init__(
        self,
        yard: Yard,
        meter: Meter,
        views: SensorViews,
        estimate: Callable[[Variant], LiveAnswer],
    ) -> None:
        self._yard = yard
        self._meter = meter
        self._views = views
        self._estimate = estimate

    def suggest(
        self, variant: Variant, kind: str, name: str | None, *, count: int, patience: float
    ) -> tuple[Suggestion, ...]:
        """Return the best changes of a kind, see `LivePlanner.suggest`."""
        if kind == "remove":
            suggestions = self._suggest_removals(variant)[:count]
        elif kind not in ("add", "move") or (kind == "move" and name is None):
            raise ValueError(
                f"kind must be add, remove, or move with the name of a sensor, got {kind!r} and "
                f"{name!r}"
            )
        elif kind == "add" or name is None:
            suggestions = self._suggest_poses(variant, None, count, patience)
        else:
            carried = variant.find_unlocked(name)
            base = variant.without_sensor(name)
            suggestions = self._suggest_poses(base, carried, count, patience)
        return tuple(suggestions)

    def _suggest_removals(self, variant: Variant) -> list[Suggestion]:
        suggestions = []
        for sensor in variant.sensors:
            if not sensor.locked:
                answer = self._estimate(variant.without_sensor(sensor.name))
                suggestions.append(Suggestion("remove", sensor, answer, 0))
        return sorted(suggestions, key=_loss)

    def _suggest_poses(
        self, base: Variant, carried: LiveSensor | None, count: int, patience: float
    ) -> list[Suggestion]:
        """Best poses for one more sensor, on different poles. carried: the sensor, None for a new
        one."""
        kind = "add" if carried is None else "move"
        view = self._views.see(base)
        stock = self._yard.stock
        has_room = [self._yard.has_room(base, mount.name) for mount in stock.mounts]
        is_allowed = [not self._yard.bars(base, mount) for mount in stock.mounts]
        is_free = np.logical_and(has_room, is_allowed)
        ranked = list[int]()
        more = True
        while more and not ranked:
            more = self._views.stock.at_least_coarse(patience, is_free)
            ranked = self._views.stock.rank(
                view.candidates, view.seen, view.is_working, self._meter.objective
            )
        suggestions: list[Suggestion] = []
        poles = set[int]()
        for candidate in ranked:
            mount = int(stock.mount[candidate])
            if mount in poles or not is_free[mount]:
                continue
            poles.add(mount)
            suggestions.append(self.improve(kind, base, self._hang(base, candidate, carried)))
            if len(suggestions) == count:
                break
        return sorted(suggestions, key=_loss)

    def _hang(self, base: Variant, candidate: int, carried: LiveSensor | None) -> LiveSensor:
        """Candidate of the stock as a sensor."""
        (sensor,) = self._yard.place([self._yard.stock.sensors[candidate]]).sensors
        if carried is not None:
            return replace(sensor, name=carried.name, failed=carried.failed)
        return replace(sensor, name=name_on_pole(base, sensor.mount))

    def improve(self, kind: str, base: Variant, sensor: LiveSensor) -> Suggestion:
        """Suggestion of a sensor, turned and tilted while that helps and makes no problem."""

        def judge(candidate: LiveSensor) -> tuple[float, int]:
            view = self._views.see(replace(base, sensors=(*base.sensors, candidate)))
            return self._meter.judge(view.candidates, view.seen, view.is_working)

        ap, problems = judge(sensor)
        better = True
        while better:
            better = False
            for turn, down in TURNS_RAD:
                turned = replace(sensor, heading=sensor.heading + turn, tilt=sensor.tilt + down)
                if not TILT_SPAN[0] <= turned.tilt <= TILT_SPAN[1]:
                    continue
                turned_ap, turned_problems = judge(turned)
                if turned_ap > ap + MIN_HELPFUL_GAIN_AP and turned_problems <= problems:
                    sensor = turned
                    ap = turned_ap
                    problems = turned_problems
                    better = True
        answer = self._estimate(replace(base, sensors=(*base.sensors, sensor)))
        return Suggestion(kind, sensor, answer, self._views.stock.known)


def apply_suggestion(yard: Yard, variant: Variant, suggestion: Suggestion) -> VariantChange:
    """Make a suggested change. Raises ValueError if the variant has changed so that it does not
    fit."""
    sensor = suggestion.sensor
    if suggestion.kind == "remove":
        return remove_sensor(yard, variant, sensor.name)
    if suggestion.kind == "move":
        variant.find_unlocked(sensor.name)
        yard.check_room(variant.without_sensor(sensor.name), sensor.mount)
        return VariantChange(variant.with_sensor(sensor), f"{sensor.name} moved")
    yard.check_room(variant, sensor.mount)
    added = replace(sensor, name=name_on_pole(variant, sensor.mount))
    after = replace(variant, sensors=(*variant.sensors, added))
    return VariantChange(after, f"{added.name} added")


def _loss(suggestion: Suggestion) -> float:
    return -suggestion.answer.ap
