"""Checks of single arguments, in the words of the command line."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

MAX_TURN_DEG = 360.0
Label = Literal["vehicle", "cyclist", "pedestrian", "heavy"]  # `toolkit.objects.LABELS`
Combine = Literal["mean", "worst"]


def check_least(option: str, value: float | None, minimum: float, remedy: str = "") -> None:
    """Raise ValueError for an infinite number or one below its minimum; None passes.

    option: name of the option in the error; remedy: what helps, at the end of the error."""
    if value is not None and not minimum <= value < float("inf"):
        hint = f": {remedy}" if remedy else ""
        raise ValueError(f"{option} must be at least {minimum:g}, got {value:g}{hint}")


def check_positive(option: str, value: float | None) -> None:
    """Raise ValueError for an infinite number or one not above 0; None passes."""
    if value is not None and not 0 < value < float("inf"):
        raise ValueError(f"{option} must be above 0, got {value:g}: leave it out for the default")


def check_turn(angle: float, name: str, meaning: str = "counter-clockwise from east") -> float:
    """Return an angle (degrees). Raises ValueError unless it is within `MAX_TURN_DEG` of 0.

    name: name of the option in the error; meaning: zero and sense of the angle in the error."""
    if not abs(angle) <= MAX_TURN_DEG:
        raise ValueError(
            f"{name} must be degrees {meaning}, from 0 to {MAX_TURN_DEG:g}, got {angle:g}"
        )
    return angle


def check_bearing(angle: float, name: str) -> float:
    """Return a compass bearing (degrees). Raises ValueError beyond a full turn."""
    return check_turn(angle, name, "clockwise from north")


def check_share(option: str, value: float) -> None:
    """Raise ValueError for a number that is not between 0 and 1, both excluded."""
    if not 0 < value < 1:
        raise ValueError(f"{option} must lie between 0 and 1, got {value:g}")


def check_each_once(option: str, values: Sequence[object] | None) -> None:
    """Raise ValueError for an option with nothing after it, or with a value twice; None passes."""
    if values is not None and not values:
        raise ValueError(f"{option} needs one value or several: leave it out for the usual ones")
    if values is not None and len(set(values)) < len(values):
        raise ValueError(
            f"{option} takes each value once, got {' '.join(map(str, values))}: leave the "
            "repetition out"
        )


def check_ious(values: Iterable[float]) -> None:
    """Raise ValueError for a number that is no IoU threshold."""
    for value in values:
        if not 0 < value <= 1:
            raise ValueError(f"--iou must lie above 0 and at most at 1, got {value:g}")


def check_schemes(names: Iterable[str]) -> None:
    """Raise ValueError for an unknown fusion scheme."""
    from toolkit.detection.schemes import SCHEMES

    for name in names:
        if name not in SCHEMES:
            raise ValueError(
                f"there is no fusion scheme {name!r}: choose among {', '.join(SCHEMES)}"
            )


def sensor_set(text: str) -> list[int | str] | None:
    """Parse a sensor set: numbers and names separated by commas, or `all`, which gives None.

    Numbers count sensors from 0. Raises ValueError for a sensor that is named twice."""
    names = [name.strip() for name in text.split(",")]
    if len(set(names)) < len(names):
        raise ValueError(
            f"each sensor may be named once in a set, got {text}: leave the repetition out"
        )
    if names == ["all"]:
        return None
    return [int(name) if name.isdecimal() else name for name in names]


def site_file(site: str | None) -> list[Path]:
    """Return the file that a site is read from as a list, empty for a built-in site or None."""
    return [Path(site)] if site is not None and Path(site).is_file() else []


def check_ending(out: Path, endings: Sequence[str], what: str) -> None:
    """Raise ValueError for a file to write whose name does not end in one of the endings.

    A reader recognises such files by their ending. endings: in lower case, with the dot; what: kind
    of file in the error, with its article."""
    if out.suffix.lower() not in endings:
        raise ValueError(
            f"the name of {what} must end in {' or '.join(endings)}, got {out.name}: it is known "
            "by that"
        )
