"""`Bounded`: values in memory up to a number of bytes."""

from collections import OrderedDict
from typing import Any


class Bounded(OrderedDict[Any, Any]):
    """Values with `nbytes`, longest unused first. Threads may read while one adds."""

    @property
    def nbytes(self) -> int:
        """Memory of all values."""
        return sum(value.nbytes for value in list(self.values()))

    def keep(self, values: dict[Any, Any], max_bytes: int) -> None:
        """Add or renew values; drop others while all take more than `max_bytes` bytes."""
        for key, value in values.items():
            self[key] = value
            self.move_to_end(key)
        while len(self) > len(values) and self.nbytes > max_bytes:
            self.popitem(last=False)
