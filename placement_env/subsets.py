"""Sets of candidates as rows of booleans: all of them, and sums over the members of many sets."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from toolkit.arrays import Bool, Float64, Shaped

Sets = Bool[np.ndarray, "n C"]  # sensor sets, a row of candidates each
SetFunction = Callable[[Sets], Float64[np.ndarray, " n"]]  # a figure of each set
MAX_LISTED_SENSORS = 16  # with 65536 sets
BLOCK_FIGURES = 1 << 17  # figures in one step, so that they stay in the processor's cache


def all_subsets(sensors: int) -> Bool[np.ndarray, "sets n"]:
    """List all 2^n sets of n sensors; sensor i is in set k if bit i of k is 1."""
    if not 0 <= sensors <= MAX_LISTED_SENSORS:
        rule = f"too many sets: they are listed for at most {MAX_LISTED_SENSORS} sensors"
        raise ValueError(f"{rule}, got {sensors}; choose some, or use estimate_worth")
    return (np.arange(2**sensors)[:, None] >> np.arange(sensors) & 1).astype(bool)


def find_index(member: object, names: Sequence[str]) -> int:
    """Candidate that an index or name means. Raises ValueError for any other value."""
    if isinstance(member, str) and member in names:
        return names.index(member)
    if (
        isinstance(member, int | np.integer)
        and not isinstance(member, bool)
        and 0 <= member < len(names)
    ):
        return int(member)
    raise ValueError(
        f"candidates are 0 to {len(names) - 1}, or their names such as {names[0]!r}; got {member!r}"
    )


class MemberSums:
    """Sums of the rows (C, w) of each set's members, in the type of the rows.

    A set's sum does not depend on the other sets. Raises ValueError unless sets are rows of one
    boolean per candidate.
    """

    def __init__(self, rows: Shaped[np.ndarray, "C w"]) -> None:
        # the last row is for no member
        self._rows = np.concatenate([rows, np.zeros((1, rows.shape[1]), rows.dtype)])

    @property
    def rows(self) -> Shaped[np.ndarray, "C w"]:
        """Given rows."""
        return self._rows[:-1]

    def __call__(self, subsets: Sets) -> Shaped[np.ndarray, "n w"]:
        """Sum of each set."""
        n, candidates = subsets.shape
        owner, member = np.divmod(
            np.flatnonzero(np.ascontiguousarray(subsets).ravel()), max(candidates, 1)
        )
        sizes = np.bincount(owner, minlength=n)
        # members of each set, at least one column
        members = np.full((n, max(1, int(sizes.max(initial=0)))), candidates)
        members[owner, np.arange(len(owner)) - np.repeat(np.cumsum(sizes) - sizes, sizes)] = member
        sums = self._rows[members[:, 0]]
        for column in members.T[1:]:
            sums += self._rows.take(column, axis=0)
        return sums

    def blocks(self, subsets: Sets) -> Iterator[tuple[slice, Shaped[np.ndarray, "m w"]]]:
        """Yield slices of as many sets as fit the processor's cache, and their sums."""
        candidates = len(self.rows)
        if subsets.ndim != 2 or subsets.shape[1] != candidates or subsets.dtype != np.bool_:
            rule = f"sets must be rows of {candidates} booleans, one for each candidate"
            raise ValueError(f"{rule}, got {subsets.dtype} {subsets.shape}")
        step = max(1, BLOCK_FIGURES // max(1, self._rows.shape[1]))
        blocks = (slice(first, first + step) for first in range(0, len(subsets), step))
        return ((block, self(subsets[block])) for block in blocks)
