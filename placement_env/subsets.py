"""Sets of candidates as rows of booleans: all of them, and sums over the members of many sets."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from toolkit.arrays import Bool, Float64, Int64, Shaped

Sets = Bool[np.ndarray, "n candidates"]  # sensor sets, a row of candidates each
SetFunction = Callable[[Sets], Float64[np.ndarray, " n"]]  # a figure of each set
MAX_LISTED_SENSORS = 16  # with 65536 sets
BLOCK_FIGURES = 1 << 17  # figures in one step, so that they stay in the processor's cache
BLOCK_SETS = 64  # sets whose booleans become numbers in one step, for the same reason


def all_subsets(sensors: int) -> Bool[np.ndarray, "sets n"]:
    """List all 2^n sets of n sensors; sensor i is in set k if bit i of k is 1.

    sensors: n. Raises ValueError for more than `MAX_LISTED_SENSORS`."""
    if not 0 <= sensors <= MAX_LISTED_SENSORS:
        rule = f"too many sets: they are listed for at most {MAX_LISTED_SENSORS} sensors"
        raise ValueError(f"{rule}, got {sensors}; choose some, or use estimate_worth")
    set_numbers = np.arange(2**sensors)[:, None]
    # bit i of k, as an array [k, i]: shifted to the last place, and all others cleared
    return (set_numbers >> np.arange(sensors) & 1).astype(bool)


def find_index(member: object, names: Sequence[str]) -> int:
    """Index of a candidate that is given by its index or name.

    names: names of all candidates. Raises ValueError for any other value, also a negative index or
    a bool."""
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


class SetMembers(NamedTuple):
    """Members of n sets, set after set, in ascending order within each.

    Attributes:
        row: Row of each member's set.
        candidate: Index of the candidate."""

    row: Int64[np.ndarray, " m"]
    candidate: Int64[np.ndarray, " m"]


def list_set_members(subsets: Sets) -> SetMembers:
    """List the members of n sets, as `subsets.nonzero()` does, in a tenth of its time."""
    _, candidates = subsets.shape
    flat_positions = np.flatnonzero(np.ascontiguousarray(subsets).ravel())
    row, candidate = np.divmod(flat_positions, max(candidates, 1))
    return SetMembers(row=row, candidate=candidate)


def sum_figures(
    subsets: Sets, figures: Float64[np.ndarray, " candidates"]
) -> Float64[np.ndarray, " n"]:
    """Sum of the members' figures for each of n sets.

    The result is `subsets @ figures`, which turns all booleans into numbers together and takes four
    times as long.

    figures: one for each candidate."""
    blocks = max(1, len(subsets) // BLOCK_SETS)
    # the last block has the remaining rows too: a single row would be rounded in another way
    ends = [*(block * BLOCK_SETS for block in range(1, blocks)), len(subsets)]
    sums = np.empty(len(subsets))
    for first, end in pairwise([0, *ends]):
        sums[first:end] = subsets[first:end] @ figures
    return sums


class MemberSums:
    """Sum of the rows of each set's members, in the type of the rows.

    rows: w figures of each candidate. A set's sum is rounded alike, with any other sets in
    the call: members are always added in ascending order.
    """

    def __init__(self, rows: Shaped[np.ndarray, "candidates w"]) -> None:
        # the last row is zero: it fills places of sets with fewer members
        self._rows = np.concatenate([rows, np.zeros((1, rows.shape[1]), rows.dtype)])

    @property
    def rows(self) -> Shaped[np.ndarray, "candidates w"]:
        """Given rows: w figures of each candidate."""
        return self._rows[:-1]

    def __call__(self, subsets: Sets) -> Shaped[np.ndarray, "n w"]:
        """Sum of the members' rows for each of n sets, 0 for the empty set."""
        n, candidates = subsets.shape
        owner, member = list_set_members(subsets)
        sizes = np.bincount(owner, minlength=n)
        # position of a member within its set: its running number minus the first of the set
        first_numbers = np.cumsum(sizes) - sizes
        position = np.arange(len(owner)) - np.repeat(first_numbers, sizes)
        # members of each set from the left, ascending; the rest of a row is `candidates`, which
        # points at a last row of zeros in `_rows`
        members = np.full((n, max(1, int(sizes.max(initial=0)))), candidates)
        members[owner, position] = member
        # by their position in the sets
        first_members, *later_members = members.T
        sums = self._rows[first_members]
        for column in later_members:
            sums += self._rows.take(column, axis=0)
        return sums

    def blocks(self, subsets: Sets) -> Iterator[tuple[slice, Shaped[np.ndarray, "m w"]]]:
        """Yield slices of as many sets as fit the processor's cache, and the sums of their members.

        Each pair is a slice of the sets and the sums of its sets. Raises ValueError unless sets are
        rows of one boolean for each candidate."""
        candidates = len(self.rows)  # a row of figures each
        if subsets.ndim != 2 or subsets.shape[1] != candidates or subsets.dtype != np.bool_:
            rule = f"sets must be rows of {candidates} booleans, one for each candidate"
            raise ValueError(f"{rule}, got {subsets.dtype} {subsets.shape}")
        _, width = self._rows.shape
        set_count = max(1, BLOCK_FIGURES // max(1, width))
        blocks = (slice(first, first + set_count) for first in range(0, len(subsets), set_count))
        return ((block, self(subsets[block])) for block in blocks)
