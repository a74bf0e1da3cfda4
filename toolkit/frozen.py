"""Values that a frozen dataclass sets while it is built: parsed fields, and known properties."""

from collections.abc import Set as AbstractSet
from dataclasses import fields
from functools import cache, cached_property


def set_fields(instance: object, **values: object) -> None:
    """Set fields of a frozen dataclass to parsed values, in its `__post_init__` or a new copy.

    Raises AttributeError for a name that is not a field."""
    _write(instance, values, _field_names(type(instance)))  # type: ignore[arg-type]


@cache
def _field_names(kind: type) -> frozenset[str]:
    """Return the names of a dataclass's fields, which every new object would list again."""
    return frozenset(field.name for field in fields(kind))


def set_cached(instance: object, **values: object) -> None:
    """Set cached properties of a new object to values that are known already.

    Raises AttributeError for a name that is not a cached property."""
    names = {
        name for name in values if isinstance(getattr(type(instance), name, None), cached_property)
    }
    _write(instance, values, names)


def _write(instance: object, values: dict[str, object], names: AbstractSet[str]) -> None:
    if unknown := sorted(values.keys() - names):
        raise AttributeError(f"{type(instance).__name__} has no such value: {', '.join(unknown)}")
    vars(instance).update(values)
