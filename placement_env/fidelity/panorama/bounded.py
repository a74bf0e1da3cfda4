"""`Bounded`: values in memory, of which the longest unused are dropped where they take too many bytes."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any


class Bounded(OrderedDict[Any, Any]):
    """Values with `nbytes`, longest unused first. Threads may read while one adds."""

    @property
    def nbytes(self) -> int:
        """Memory of all values."""
        return sum(each.nbytes for each in list(self.values()))

    def keep(self, values: dict[Any, Any], most: int) -> None:
        """Add or renew values; drop others while all take more than `most` bytes."""
        for key, value in values.items():
            self[key] = value
            self.move_to_end(key)
        while len(self) > len(values) and self.nbytes > most:
            self.popitem(last=False)
