"""`ScoreMemory`: figures of sets by a fidelity, which scores no set twice."""

from copy import copy
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from placement_env.classes import Classes
from placement_env.defaults import VEHICLES
from placement_env.protocol import ByClass, Estimate, Fidelity
from placement_env.subsets import Sets, list_set_members
from toolkit.arrays import Float64, Mask

MAX_REMEMBERED = 200_000  # sets in memory, which is emptied when there are more
EMPTY_SET = b""  # its key
MIN_LISTED_TOGETHER = 10  # sets; the members of fewer are listed set by set, which is quicker


class SetFigures(NamedTuple):
    """Figures of n sets, in their order.

    Attributes:
        ap: Average precision (0 to 1) of all classes combined.
        recall: Recall (0 to 1) of all classes combined.
        kbit: Data that all sensors of a set send in a frame, averaged over frames.
        class_ap: Average precision of each of k classes, NaN for a class without objects.
        cache_hit: True for a set that was in memory before the call.
        scored: Number of different sets that were scored now.
    """

    ap: Float64[np.ndarray, " n"]
    recall: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]
    class_ap: Float64[np.ndarray, "n k"]
    cache_hit: Mask
    scored: int


class ScoreMemory:
    """Figures of sets of candidates by a fidelity, scored once and then taken from memory.

    The empty set has AP 0 and sends nothing; it is never scored. A pickled copy forgets the sets.

    Attributes:
        classes: Classes that the fidelity combines, vehicles if it has none.
    """

    def __init__(self, fidelity: Fidelity) -> None:
        """Begin with the empty set. fidelity: scores sets that are not in memory."""
        self.classes: Classes = getattr(fidelity, "classes", VEHICLES)
        self._fidelity = fidelity
        class_count = len(self.classes.names) if isinstance(fidelity, ByClass) else 1
        # figures of a set: AP, recall, kbit and, if there are several classes, the AP of each
        self._width = 3 if class_count == 1 else 3 + class_count
        # figures of each set by its key, both as bytes, which take a third of the memory of numbers
        self._rows: dict[bytes, bytes] = self._list_empty_set()

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_rows": self._list_empty_set()}

    def _list_empty_set(self) -> dict[bytes, bytes]:
        # memory at the start: all figures of the empty set are 0
        return {EMPTY_SET: np.zeros(self._width).tobytes()}

    def forget(self) -> None:
        """Forget all sets but the empty one."""
        self._rows = self._list_empty_set()

    def fork(self) -> "ScoreMemory":
        """Copy of the memory with the same sets; sets scored later are not shared."""
        memory = copy(self)
        memory._rows = dict(self._rows)
        return memory

    def figures(self, subsets: Sets) -> SetFigures:
        """Figures of sets in their order; only sets that are not in memory are scored.

        Raises ValueError if there is no object to detect."""
        if len(self._rows) > MAX_REMEMBERED:
            self.forget()
        keys = _list_keys(subsets)
        cache_hit = np.fromiter((key in self._rows for key in keys), np.bool_, len(keys))
        # index of a set for each new key, each key once
        new_sets = {key: index for index, key in enumerate(keys) if not cache_hit[index]}
        if new_sets:
            new_figures = self._score(subsets[list(new_sets.values())])
            for key, row in zip(new_sets, new_figures, strict=True):
                self._rows[key] = row.tobytes()
        # a bytearray, unlike bytes, makes an array that can be written
        figures = bytearray().join([self._rows[key] for key in keys])
        rows = np.frombuffer(figures, np.float64).reshape(-1, self._width)
        return SetFigures(
            ap=rows[:, 0],
            recall=rows[:, 1],
            kbit=rows[:, 2],
            # from column 3 on the AP of each class; the AP of a single class is the combined one
            class_ap=rows[:, 3:] if self._width > 3 else rows[:, :1],
            cache_hit=cache_hit,
            scored=len(new_sets),
        )

    def _score(self, subsets: Sets) -> Float64[np.ndarray, "n w"]:
        """Columns to remember of each set: AP, recall, kbit and the AP of each of several classes.

        The last are left out if there is one class, whose AP is the first column."""
        class_columns: tuple[np.ndarray, ...] = ()
        if self._width == 3:  # one class
            estimate = self._fidelity(subsets)
        else:
            estimates = cast(ByClass, self._fidelity).by_class(subsets)
            estimate = estimates.combined(self.classes)
            class_columns = tuple(estimates.ap.T)
        self._check(estimate)
        columns = [estimate.ap, estimate.recall, estimate.kbit, *class_columns]
        return np.stack(columns, axis=1).astype(np.float64, copy=False)

    def _check(self, estimate: Estimate) -> None:
        """Raise ValueError unless AP and kbit are finite."""
        if not np.isfinite(estimate.ap).all():
            nouns = " or ".join(self.classes.names)
            raise ValueError(
                f"there is no {nouns} to find in these frames: say more --frames, or another --seed"
            )
        if not np.isfinite(estimate.kbit).all():
            raise ValueError(
                f"kbit must be finite, fidelity {self._fidelity.name!r} says "
                f"{estimate.kbit.tolist()[:3]}"
            )


def _list_keys(subsets: Sets) -> list[bytes]:
    """Key of each set: the indices of its members, as bytes."""
    if len(subsets) < MIN_LISTED_TOGETHER:
        return [np.flatnonzero(row).astype(np.uint32).tobytes() for row in subsets]
    # the same keys for many sets, sliced from the bytes of all members
    members = list_set_members(subsets)
    indices = members.candidate.astype(np.uint32)
    sizes = np.bincount(members.row, minlength=len(subsets))
    ends = np.cumsum(sizes) * indices.itemsize
    index_bytes = indices.tobytes()
    return [index_bytes[first:end] for first, end in pairwise([0, *ends.tolist()])]
