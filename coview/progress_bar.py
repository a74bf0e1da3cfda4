"""Progress bar on stderr, and the callbacks that move it.

It is hidden without a terminal and for JSON.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm


class Bar:
    """Bar moved to absolute counts by the toolkit's callbacks."""

    def __init__(self, bar: Any, hidden: bool) -> None:
        self._bar, self._hidden, self._stage = bar, hidden, ""

    def to(self, done: int) -> None:
        """Show `done` items."""
        self._bar.update(done - self._bar.n)

    def of(self, done: int, total: int) -> None:
        """Show `done` of `total` items."""
        self._bar.total = total
        self.to(done)

    def stage(self, name: str, done: int, total: int | None) -> None:
        """Show progress of a stage; a new stage restarts the bar."""
        if name != self._stage:
            self._stage = name
            self._bar.reset(total)
            self._bar.set_description(name, refresh=False)
        self.to(done)

    def figures(self, values: dict[str, float]) -> None:
        """Show figures behind the bar."""
        self._bar.set_postfix({name: f"{value:.3f}" for name, value in values.items()}, refresh=False)

    def line(self, text: str) -> None:
        """Print a line above the bar."""
        if not self._hidden:
            self._bar.write(text, file=sys.stderr)


@contextmanager
def progress_bar(unit: str, total: int | None = None, *, hidden: bool = False) -> Iterator[Bar]:
    """Show a bar while the block runs."""
    with tqdm(total=total, unit=unit, disable=hidden or None, smoothing=0.1) as bar:
        yield Bar(bar, hidden)
