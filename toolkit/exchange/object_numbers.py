"""Numbers of 16 bits for road users, whose ids may be larger."""

from collections.abc import Sequence

NUMBER_COUNT = 2**16


class ObjectNumbers:
    """Numbers from 0 to 65,535 by id, each kept as long as possible.

    An id gets its last 16 bits, or the next number that is free. If all are taken, the road user
    that has been gone longest loses its number. At most `NUMBER_COUNT` road users may be there
    together.

    >>> numbers = ObjectNumbers()
    >>> numbers.assign([7, 65_543])
    [7, 8]
    >>> numbers.assign([65_543])
    [8]
    """

    def __init__(self) -> None:
        """Begin without ids."""
        self._number_by_id: dict[int, int] = {}  # the id that was used last is the last one
        self._taken: set[int] = set()

    def assign(self, ids: Sequence[int]) -> list[int]:
        """Return the number of each road user of one instant. ids: from 0, each once."""
        known_ids = [track_id for track_id in ids if track_id in self._number_by_id]
        for track_id in known_ids:  # so that none of this instant is the one that is gone longest
            self._number_by_id[track_id] = self._number_by_id.pop(track_id)
        for track_id in ids:
            if track_id not in self._number_by_id:
                self._number_by_id[track_id] = self._find_free(track_id)
        return [self._number_by_id[track_id] for track_id in ids]

    def _find_free(self, track_id: int) -> int:
        """Take a number for a new id."""
        if len(self._taken) == NUMBER_COUNT:
            oldest_id = next(iter(self._number_by_id))
            return self._number_by_id.pop(oldest_id)
        number = track_id % NUMBER_COUNT
        while number in self._taken:
            number = (number + 1) % NUMBER_COUNT
        self._taken.add(number)
        return number
