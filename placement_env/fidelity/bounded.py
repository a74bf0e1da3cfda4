"""`Bounded`: values in memory up to a number of bytes."""

from collections import OrderedDict
from typing import Any


class Bounded(OrderedDict[Any, Any]):
    """Dictionary of values that have `nbytes`, longest unused first.

    Only `keep` counts as use and drops values. Threads may read while one adds."""

    @property
    def nbytes(self) -> int:
        """Bytes of memory of all values together."""
        return sum(value.nbytes for value in list(self.values()))

    def keep(self, values: dict[Any, Any], max_bytes: int) -> None:
        """Add values, or mark them as used; then drop the longest unused others beyond a limit.

        Args:
            values: Values by key; these stay even if they exceed the limit.
            max_bytes: Bytes that all values may take."""
        for key, value in values.items():
            self[key] = value
            self.move_to_end(key)  # last: newest use
        while len(self) > len(values) and self.nbytes > max_bytes:
            self.popitem(last=False)
