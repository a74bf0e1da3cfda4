"""Searches that prove something: every set of few candidates, integer programmes with bounds, greedy's certificate."""

from typing import TYPE_CHECKING

from toolkit.runtime.lazy import lazily

if not TYPE_CHECKING:
    __getattr__, __dir__, __all__ = lazily(__name__, {})
