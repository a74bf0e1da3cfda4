"""Some samples of a recording by number, also of one that can only be read from its beginning, as a bag."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Protocol, runtime_checkable

from toolkit.datasets.records.fields import Samples
from toolkit.datasets.sample import Sample


@runtime_checkable
class Indexed(Protocol):
    """Samples that are read by number."""

    def __getitem__(self, index: int) -> Sample: ...


class ChosenSamples:
    """Every so many of a recording's samples, and only the first of these: `frames`, all when None.

    Raises ValueError where that is none.
    """

    def __init__(self, samples: Samples, *, frames: int | None = None, every: int = 1) -> None:
        if every < 1:
            raise ValueError(f"every must be at least 1, got {every}: 1 takes all samples")
        if frames is not None and frames < 1:
            raise ValueError(f"frames must be at least 1, got {frames}: leave it out for all")
        if not len(samples):
            raise ValueError("there is no sample to view: check the path and the layout")
        self.samples, self.every = samples, every
        count = -(-len(samples) // every)
        self.count = count if frames is None else min(frames, count)
        self._ahead: Iterator[Sample] = iter(())
        self._next: int | None = None  # what `_ahead` gives next

    def __len__(self) -> int:
        return self.count

    def __iter__(self) -> Iterator[Sample]:
        return map(self.at, range(self.count))

    def at(self, number: int) -> Sample:
        """The sample of this number among the chosen, from 0. Raises ValueError where there is none, and what reading
        raises."""
        if not 0 <= number < self.count:
            raise ValueError(f"there is no sample {number}: {self.count} are chosen, counted from 0")
        index = number * self.every
        if isinstance(self.samples, Indexed):
            return self.samples[index]
        if self._next is None or index < self._next:
            self._ahead, self._next = iter(self.samples), 0
        sample = next(islice(self._ahead, index - self._next, None), None)
        if sample is None:
            self._next = None
            raise ValueError(f"the recording ends before its sample {index}")
        self._next = index + 1
        return sample
