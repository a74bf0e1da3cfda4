"""`JsonObject`: JSON object whose members are checked as they are taken, by their path in the
document."""

import sys
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

Json = dict[str, Any]
_WORDS = {
    str: "a text",
    int: "a whole number",
    bool: "true or false",
    list: "a list",
    dict: "an object {...}",
}
_MAX_TURN_DEG = 3600.0  # drawn sites hold some beyond a full turn
_MAX_LISTED = 12  # choices that messages name
_MAX_TEXT = 60  # characters of a value that messages quote


class JsonObject:
    """Members of a JSON object, checked as they are taken.

    Every method raises ValueError that names the member, the rule and the value.

    >>> JsonObject({"a": {"b": True}}, "file").node("a").get("b", int)
    Traceback (most recent call last):
    ValueError: file.a.b must be a whole number, got 'True'"""

    def __init__(self, value: Any, path: str = "") -> None:
        """Keep a value, which errors call by its path. Raises ValueError if it is no object."""
        if not isinstance(value, dict):
            raise ValueError(
                f"{path or 'it'} must be an object {{...}}, got {str(value)[:_MAX_TEXT]}"
            )
        self.value: Json = value
        self.path = path

    def where(self, key: str) -> str:
        """Path of a member."""
        return f"{self.path}.{key}" if self.path else key

    def get(self, key: str, kind: type) -> Any:
        """Return the member of a key, which must be of a kind: str, int, bool, list or dict.

        Raises ValueError, which names its place, if it is missing or of another kind."""
        if key not in self.value:
            raise ValueError(f"{self.where(key)} is missing: add it, or save the file again")
        value = self.value[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise ValueError(
                f"{self.where(key)} must be {_WORDS[kind]}, got {str(value)[:_MAX_TEXT]!r}"
            )
        return value

    def node(self, key: str) -> "JsonObject":
        """Member that is an object."""
        return JsonObject(self.get(key, dict), self.where(key))

    def nodes(self, key: str, max_count: int) -> "Iterator[JsonObject]":
        """Yield the objects of a member that is a list of at most `max_count` objects.

        Each one names its place in errors. Raises ValueError for another member."""
        rows = self.get(key, list)
        if len(rows) > max_count:
            raise ValueError(f"{self.where(key)} must hold at most {max_count}, got {len(rows)}")
        for i, row in enumerate(rows):
            yield JsonObject(row, f"{self.where(key)}[{i}]")

    def number(self, key: str, low: float = -np.inf, high: float = np.inf) -> float:
        """Member that is a finite number from `low` to `high`."""
        value = _check_number(self.value.get(key), self.where(key))
        if not low <= value <= high:
            raise ValueError(f"{self.where(key)} must be from {low:g} to {high:g}, got {value:g}")
        return value

    def whole(self, key: str, low: int, high: int) -> int:
        """Member that is a whole number from `low` to `high`."""
        value: int = self.get(key, int)
        if not low <= value <= high:
            raise ValueError(
                f"{self.where(key)} must be a whole number from {low} to {high}, got {value!s:.30}"
            )
        return value

    def choice(self, key: str, choices: Collection[str]) -> str:
        """Return the member of a key, which must be one of some texts.

        Raises ValueError, which names its place, for another value."""
        value: str = self.get(key, str)
        if value not in choices:
            listed_choices = ", ".join([*choices][:_MAX_LISTED])
            if len(choices) > _MAX_LISTED:
                listed_choices += " or others"
            raise ValueError(
                f"{self.where(key)} must be one of {listed_choices}, got {value[:_MAX_TEXT]!r}"
            )
        return value

    def texts(self, key: str) -> list[str]:
        """Return the member of a key, which must be a list of texts.

        Raises ValueError, which names its place, for another value."""
        row = self.get(key, list)
        for i, value in enumerate(row):
            if not isinstance(value, str):
                raise ValueError(
                    f"{self.where(key)}[{i}] must be a text, got {str(value)[:_MAX_TEXT]!r}"
                )
        return list(row)

    def angle(self, key: str) -> float:
        """Return a member in degrees as radians.

        Raises ValueError that names the member if it is not a number, or farther than
        `_MAX_TURN_DEG` from 0."""
        value = self.number(key)
        if abs(value) > _MAX_TURN_DEG:
            raise ValueError(
                f"{self.where(key)} must lie within {_MAX_TURN_DEG:g} degrees of 0, got {value:g}"
            )
        return float(np.deg2rad(value))

    def numbers(self, key: str, count: int | None = None) -> list[float]:
        """Member that is a list of `count` finite numbers."""
        row = self.get(key, list)
        if count is not None and len(row) != count:
            raise ValueError(f"{self.where(key)} must be {count} numbers, got {len(row)}")
        return [_check_number(value, f"{self.where(key)}.{i}") for i, value in enumerate(row)]

    def check_keys(self, allowed: Collection[str]) -> None:
        """Refuse a member of another name."""
        for key in self.value:
            if key not in allowed:
                raise ValueError(
                    f"{self.where(key[:_MAX_TEXT])} is unknown: it has {', '.join(allowed)}"
                )


def _check_number(value: object, where: str) -> float:
    """Finite number. where: its path in the document, for the ValueError."""
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not abs(value) <= sys.float_info.max
    ):
        raise ValueError(f"{where} must be a finite number, got {str(value)[:_MAX_TEXT]}")
    return float(value)
