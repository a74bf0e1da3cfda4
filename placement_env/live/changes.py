"""Changes of a variant by hand: sensors moved, added, removed, locked or failed, and keep-out
areas.

Each function takes the yard and the variant, and returns the variant that follows."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from placement_env.live.variant import (
    TILT_SPAN_RAD,
    Corners,
    LiveSensor,
    PoleOrSpot,
    Variant,
    Yard,
    check_keep_out,
    check_name,
    name_on_pole,
)

DEFAULT_TILT_RAD = 0.26  # tilt of a new sensor below the horizon


class VariantChange(NamedTuple):
    """Variant after a change, and words for the change, such as "pole 3 moved"."""

    variant: Variant
    what: str


def move_sensor(
    yard: Yard,
    variant: Variant,
    name: str,
    *,
    heading: float | None = None,
    tilt: float | None = None,
    height: float | None = None,
    position: PoleOrSpot | None = None,
) -> VariantChange:
    """Turn, tilt, raise or carry a sensor to another pole.

    Heights stay within the range of the pole, tilts within `TILT_SPAN_RAD`, or as far beyond as the
    sensor is. name: name of the sensor; heading: counter-clockwise from the site's +x (rad); tilt:
    below the horizon (rad); height: above the foot of the pole (m); position: name of a pole, or x
    and y of a place (m); each None for no change. Raises ValueError for an unknown or locked
    sensor, a tilt beyond straight down, and a place that no pole may use."""
    sensor = variant.find_unlocked(name)
    if position is not None:
        mount, variant = yard.find_or_add_pole(variant, position)
        if mount.name != sensor.mount:
            yard.check_room(variant, mount.name)
            x, y, _ = mount.position.tolist()
            sensor = replace(sensor, mount=mount.name, x=x, y=y)
    mount = yard.find_mount(variant, sensor.mount)  # the present pole, or the one just taken
    new_height = sensor.height if height is None else _check_finite("height", height)
    new_heading = sensor.heading if heading is None else _check_finite("heading", heading)
    new_tilt = sensor.tilt if tilt is None else _check_tilt(tilt)
    min_tilt, max_tilt = TILT_SPAN_RAD
    min_height, max_height = mount.min_height, mount.max_height
    if position is None:  # a sensor may stay where it is, beyond the heights of its pole
        min_height = min(min_height, sensor.height)
        max_height = max(max_height, sensor.height)
    is_turned = new_heading != sensor.heading
    moved_sensor = replace(
        sensor,
        height=float(np.clip(new_height, min_height, max_height)),
        heading=math.remainder(new_heading, math.tau) if is_turned else new_heading,
        tilt=float(np.clip(new_tilt, min(min_tilt, sensor.tilt), max(max_tilt, sensor.tilt))),
    )
    return VariantChange(variant.with_sensor(moved_sensor), f"{name} moved")


def mount_sensor(
    yard: Yard,
    variant: Variant,
    mount: PoleOrSpot,
    heading: float = 0.0,
    tilt: float = DEFAULT_TILT_RAD,
    height: float | None = None,
    *,
    model: str | None = None,
    name: str | None = None,
) -> VariantChange:
    """Mount a new sensor on a pole, or at a place on a pole that is added.

    mount: name of a pole, or x and y of a place (m); heading: counter-clockwise from the site's +x
    (rad); tilt: below the horizon (rad); height: above the foot of the pole (m), None for the
    highest; model: name of a model in the stock, None for the first; name: name of the sensor, None
    for an unused one. Raises ValueError for a place that no pole may use, a pole without room, an
    unknown model, and a name that is taken."""
    model = model or next(iter(yard.models))
    if name is not None and name in {sensor.name for sensor in variant.sensors}:
        raise ValueError(f"there is a sensor {name!r} already: give another name")
    pole, variant_with_pole = yard.find_or_add_pole(variant, mount)
    name = check_name(name) if name else name_on_pole(variant, pole.name)
    yard.check_room(variant_with_pole, pole.name)
    new_height = pole.max_height
    if height is not None:
        new_height = float(np.clip(height, pole.min_height, pole.max_height))
    x, y, _ = pole.position.tolist()
    min_tilt, max_tilt = TILT_SPAN_RAD
    new_tilt = float(np.clip(_check_tilt(tilt), min_tilt, max_tilt))
    new_sensor = LiveSensor(
        name=name,
        model=model,
        mount=pole.name,
        x=x,
        y=y,
        height=new_height,
        heading=_check_finite("heading", heading),
        tilt=new_tilt,
    )
    sensors = (*variant_with_pole.sensors, new_sensor)
    new_variant = yard.check(replace(variant_with_pole, sensors=sensors))
    return VariantChange(new_variant, f"{name} added")


def remove_sensor(yard: Yard, variant: Variant, name: str) -> VariantChange:
    """Remove the named sensor. Raises ValueError for an unknown or locked one."""
    variant.find_unlocked(name)  # raises for an unknown or locked one
    return VariantChange(variant.without_sensor(name), f"{name} removed")


def duplicate_sensor(yard: Yard, variant: Variant, name: str) -> VariantChange:
    """Mount a copy of the named sensor on the nearest pole with room.

    It has the same model, aim and, within the range of the pole, height. yard: site and its poles;
    variant: sensors so far. Raises ValueError if no pole has room, or for an unknown sensor."""
    sensor = variant.find(name)
    poles = (*yard.stock.mounts, *variant.poles)
    free_poles = [pole for pole in poles if yard.has_room(variant, pole.name)]
    if not free_poles:
        raise ValueError(
            "no pole has room for another sensor: remove one, or give a place of its own"
        )
    spot = (sensor.x, sensor.y)
    nearest = min(free_poles, key=lambda pole: float(np.hypot(*(pole.position[:2] - spot))))
    return mount_sensor(
        yard,
        variant,
        nearest.name,
        heading=sensor.heading,
        tilt=sensor.tilt,
        height=sensor.height,
        model=sensor.model,
    )


def lock_sensor(yard: Yard, variant: Variant, name: str, locked: bool = True) -> VariantChange:
    """Keep a sensor from being moved, or, with locked=False, let it be moved again."""
    sensor = replace(variant.find(name), locked=locked)
    return VariantChange(variant.with_sensor(sensor), f"{name} {'' if locked else 'un'}locked")


def fail_sensor(yard: Yard, variant: Variant, name: str, failed: bool = True) -> VariantChange:
    """Let a sensor fail (it sees and sends nothing), or, with failed=False, work again."""
    sensor = replace(variant.find(name), failed=failed)
    return VariantChange(
        variant.with_sensor(sensor), f"{name} {'failed' if failed else 'works again'}"
    )


def keep_out_of(yard: Yard, variant: Variant, areas: Iterable[Corners]) -> VariantChange:
    """Replace the variant's keep-out areas, which no pole may use; its sensors stay.

    areas: corners (x, y in m) of each. Raises ValueError for corners that form no area."""
    return VariantChange(
        replace(variant, keep_out=tuple(map(check_keep_out, areas))), "keep-out areas"
    )


def _check_finite(name: str, value: float) -> float:
    """Return the value as a float. Raises ValueError, with the name, unless it is finite."""
    if not np.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {value}")
    return float(value)


def _check_tilt(tilt: float) -> float:
    """Return the tilt (rad) as a float. Raises ValueError beyond straight up and straight down."""
    if not abs(_check_finite("tilt", tilt)) <= np.pi / 2 + 1e-9:  # rounding is forgiven
        raise ValueError(
            f"a tilt must lie within pi/2 rad of the horizon, got {tilt:g}: give degrees as "
            "np.deg2rad(25)"
        )
    return float(tilt)
