"""Packages that load their modules when they are used (SPEC 1), without a dependency: a training machine is bare.

A package's `__init__` names what it offers twice: imported under `TYPE_CHECKING`, so that type checkers and editors
know every name and its type, and as a table for `lazily`, which is what runs. A test keeps the two alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any


def lazily(
    package: str, offered: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package: `offered` lists what it offers of each module below it; the
    modules themselves are offered too."""
    module_of = {name: module for module, names in offered.items() for name in names}

    def load(name: str) -> Any:
        if name in module_of:
            return getattr(import_module(f"{package}.{module_of[name]}"), name)
        if not name.startswith("_") and find_spec(f"{package}.{name}"):
            return import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return load, lambda: sorted(module_of), sorted(module_of)
