"""Checker of array shapes for `make test-all`. Other types are for mypy: tests hand over wrong ones
on purpose."""

import typing
from collections.abc import Callable

import jaxtyping
from beartype import BeartypeConf, beartype

_checked = beartype(conf=BeartypeConf(is_pep484_tower=True))  # a whole number is a float too


def check(function: Callable) -> Callable:
    """Check the arguments and the result of a function whose annotations hold an array."""
    kept = {name: hint for name, hint in function.__annotations__.items() if _holds_array(hint)}
    if not kept:
        return function
    function.__annotations__ = kept
    return _checked(function)


def _holds_array(hint: object) -> bool:
    if isinstance(hint, type) and issubclass(hint, jaxtyping.AbstractArray):
        return True
    return any(map(_holds_array, typing.get_args(hint)))
