"""`ScoreMemory`: figures of sets by a fidelity, which scores no set twice."""

from copy import copy
from typing import NamedTuple, cast

import numpy as np

from placement_env.classes import VEHICLES, Classes
from placement_env.protocol import ByClass, Estimate, Fidelity
from placement_env.subsets import Sets
from toolkit.arrays import Float64, Mask

MAX_REMEMBERED = 200_000  # sets in memory, which is emptied when there are more


class SetFigures(NamedTuple):
    """Figures of n sets.

    Attributes:
        ap: Average precision.
        recall: Recall.
        kbit: Data that all sensors of a set send in a frame.
        class_ap: Average precision of each of k classes.
        cache_hit: Whether a set was scored before.
        scored: Number of different sets that were scored now.
    """

    ap: Float64[np.ndarray, " n"]
    recall: Float64[np.ndarray, " n"]
    kbit: Float64[np.ndarray, " n"]
    class_ap: Float64[np.ndarray, "n k"]
    cache_hit: Mask
    scored: int


class ScoreMemory:
    """Figures of sets of some candidates by a fidelity. The empty set has AP 0 and sends nothing.

    A pickled copy forgets the sets.
    """

    def __init__(self, fidelity: Fidelity, candidates: int) -> None:
        self.classes: Classes = getattr(fidelity, "classes", VEHICLES)
        self._fidelity = fidelity
        self._empty_set = bytes(-(-candidates // 8))
        class_count = len(self.classes.names) if isinstance(fidelity, ByClass) else 1
        self._width = 3 if class_count == 1 else 3 + class_count
        # AP, recall, kbit and the AP of several classes, by a set's bits
        self._known: dict[bytes, tuple[float, ...]] = self._list_empty_set()

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_known": self._list_empty_set()}

    def _list_empty_set(self) -> dict[bytes, tuple[float, ...]]:
        return {self._empty_set: (0.0,) * self._width}

    def forget(self) -> None:
        """Forget all sets but the empty one."""
        self._known = self._list_empty_set()

    def fork(self) -> "ScoreMemory":
        """Memory of the same sets that goes on separately."""
        memory = copy(self)
        memory._known = dict(self._known)
        return memory

    def figures(self, subsets: Sets) -> SetFigures:
        """Figures of sets; only new sets are scored.

        Raises ValueError if there is no object to detect."""
        if len(self._known) > MAX_REMEMBERED:
            self.forget()
        keys = [key.tobytes() for key in np.packbits(subsets, axis=1)]
        cache_hit = np.fromiter((key in self._known for key in keys), np.bool_, len(keys))
        new_rows = {key: row for row, key in enumerate(keys) if not cache_hit[row]}
        if new_rows:
            columns = self._score(subsets[list(new_rows.values())])
            for key, row in zip(new_rows, columns.tolist(), strict=True):
                self._known[key] = tuple(row)
        rows = np.array([self._known[key] for key in keys], np.float64).reshape(-1, self._width)
        return SetFigures(
            ap=rows[:, 0],
            recall=rows[:, 1],
            kbit=rows[:, 2],
            class_ap=rows[:, 3:] if self._width > 3 else rows[:, :1],
            cache_hit=cache_hit,
            scored=len(new_rows),
        )

    def _score(self, subsets: Sets) -> Float64[np.ndarray, "n w"]:
        """AP, recall, kbit and the AP of several classes of each set."""
        class_columns: tuple[np.ndarray, ...] = ()
        if self._width == 3:
            estimate = self._fidelity(subsets)
        else:
            estimates = cast(ByClass, self._fidelity).by_class(subsets)
            estimate = estimates.combined(self.classes)
            class_columns = tuple(estimates.ap.T)
        self._check(estimate)
        return np.stack([estimate.ap, estimate.recall, estimate.kbit, *class_columns], axis=1)

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
